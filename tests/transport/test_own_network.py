"""Tests for phm.transport.own_network."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from phm.transport.own_network import gateway, is_loopback, is_private


def interfaces(folder: Path, **pairs: tuple[int, int]) -> str:
    """Files of /sys/class/net: ifindex and iflink of each interface."""
    for name, (index, link) in {"lo": (1, 1), **pairs}.items():
        (folder / name).mkdir()
        (folder / name / "ifindex").write_text(f"{index}\n")
        (folder / name / "iflink").write_text(f"{link}\n")
    return str(folder)


def test_a_bridged_container_has_only_ends_of_pairs(tmp_path: Path) -> None:
    """Its interfaces have their other end in another namespace, so the network is private."""
    assert is_private(interfaces(tmp_path, eth0=(7, 8), eth1=(9, 12)), ("/",))


def test_a_container_on_the_network_of_the_host_sees_real_interfaces(tmp_path: Path) -> None:
    """So the network is not private."""
    net = interfaces(tmp_path, eth0=(2, 2), docker0=(3, 3), veth1=(8, 7))
    assert not is_private(net, ("/",))


def test_outside_of_a_container_nothing_is_private(tmp_path: Path) -> None:
    """Without the marker of a container, or without interfaces, the network is the host's."""
    net = interfaces(tmp_path, eth0=(7, 8))
    assert not is_private(net, (str(tmp_path / "missing"),))
    assert not is_private(str(tmp_path / "missing"), ("/",))


@pytest.mark.parametrize(
    ("url", "stays"),
    [
        ("udpout:127.0.0.1:14550", True),
        ("tcp:localhost:5760", True),
        ("udpout:[::1]:14550", True),
        ("udpin:127.0.0.1:14550", False),
        ("udpout:host.docker.internal:14550", False),
        ("/dev/ttyS0", False),
    ],
)
def test_only_loopback_urls_stay_on_the_machine(url: str, stays: bool) -> None:
    """A destination on this machine is loopback; a listening port, another host or a serial port is not."""
    assert is_loopback(url) is stays


ROUTES = """\
Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT
eth1\t00000000\t{other}\t0003\t0\t0\t100\t00000000\t0\t0\t0
eth0\t00000000\t{first}\t0003\t0\t0\t0\t00000000\t0\t0\t0
eth0\t{net}\t00000000\t0001\t0\t0\t0\t0000FFFF\t0\t0\t0
"""


def as_kernel(address: str) -> str:
    """An address as in /proc/net/route: hexadecimal, in the byte order of the machine."""
    return f"{int.from_bytes(socket.inet_aton(address), sys.byteorder):08X}"


def test_the_gateway_is_that_of_the_first_default_route(tmp_path: Path) -> None:
    """By metric; without a default route, or without the file, there is none."""
    routes = tmp_path / "route"
    text = ROUTES.format(first=as_kernel("172.20.0.1"), other=as_kernel("172.21.0.1"), net=as_kernel("172.20.0.0"))
    routes.write_text(text)
    assert gateway(str(routes)) == "172.20.0.1"
    routes.write_text("".join(line for line in text.splitlines(keepends=True) if "\t0003\t" not in line))
    assert gateway(str(routes)) == ""
    assert gateway(str(tmp_path / "missing")) == ""
