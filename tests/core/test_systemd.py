"""Notifications to systemd, received by a real Unix socket."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from phm.core.systemd import SystemdNotifier
from phm.testing import FakeClock


def test_each_notification_is_one_datagram_in_the_format_of_sd_notify(tmp_path: Path) -> None:
    """The socket's name is not passed on to child processes."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(path)
        systemd.settimeout(10)
        clock = FakeClock()
        environ = {"NOTIFY_SOCKET": path, "HOME": "/"}
        notifier = SystemdNotifier(clock, environ)
        notifier.ready()
        notifier.watchdog()
        notifier.reloading()
        notifier.stopping()
        received = [systemd.recv(4096).decode() for _ in range(4)]
    reload = f"RELOADING=1\nMONOTONIC_USEC={int(clock.mono() * 1e6)}"
    assert received == ["READY=1", "WATCHDOG=1", reload, "STOPPING=1"]
    assert environ == {"HOME": "/"}, "a child process could send notifications for the daemon"


def test_an_abstract_socket_is_reached() -> None:
    """systemd writes the null byte of its name as `@`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("")  # the kernel chooses an abstract name
        systemd.settimeout(10)
        name = systemd.getsockname().decode().replace("\0", "@", 1)
        SystemdNotifier(FakeClock(), {"NOTIFY_SOCKET": name}).ready()
        assert systemd.recv(4096) == b"READY=1"


@pytest.mark.parametrize("path", ["", "relative/path", "/nowhere/at/all", "vsock:2:1234"])
def test_without_a_usable_socket_nothing_is_sent_and_nothing_raises(path: str) -> None:
    """Neither without NOTIFY_SOCKET nor with one that does not exist."""
    notifier = SystemdNotifier(FakeClock(), {"NOTIFY_SOCKET": path} if path else {})
    notifier.ready()
    notifier.watchdog()


def test_a_full_socket_does_not_block(tmp_path: Path) -> None:
    """Notifications that systemd does not read are dropped."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(path)
        notifier = SystemdNotifier(FakeClock(), {"NOTIFY_SOCKET": path})
        for _ in range(5000):
            notifier.watchdog()
