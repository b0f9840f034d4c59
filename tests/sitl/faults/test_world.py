"""Observations of the world without PHM, on recorded answers of the engine."""

from __future__ import annotations

import io
import socket
import subprocess
import tarfile
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from docker.errors import NotFound

from sitl.faults import _docker_proxy, _volumes, _world
from sitl.faults.base import Agent
from sitl.faults.file_deleted import CONTENT, critical_file_is_intact
from sitl.faults.healthcheck_hangs import HANG, HANGS, PROGRAM

RUNNING = {"Running": True, "Paused": False, "Restarting": False}


def container(**attrs: Any) -> Any:
    return mock.Mock(id="abc", attrs={"State": RUNNING, **attrs})


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        ({}, True),
        ({"Health": {"Status": "healthy"}}, True),
        ({"Health": {"Status": "starting"}}, True),
        ({"Health": {"Status": "unhealthy"}}, False),
        ({"Running": False}, False),
        ({"Paused": True}, False),
        ({"Restarting": True}, False),
    ],
)
def test_a_container_runs(state: dict[str, Any], expected: bool) -> None:
    """It runs, is neither paused nor being restarted, and its HEALTHCHECK does not fail."""
    assert _world.runs(container(State={**RUNNING, **state})) is expected


@pytest.mark.parametrize(
    ("content", "mode", "whole"), [(CONTENT, 0o755, True), (CONTENT, 0o644, False), (b"", 0o755, False)]
)
def test_the_critical_file_has_its_content_and_mode(content: bytes, mode: int, whole: bool) -> None:
    """As the engine packs it."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        entry = tarfile.TarInfo("critical_file")
        entry.size, entry.mode = len(content), mode
        archive.addfile(entry, io.BytesIO(content))
    app = container()
    app.get_archive.return_value = ([packed.getvalue()], {})
    assert critical_file_is_intact(mock.Mock(app=app)) is whole


def test_a_missing_file_is_not_whole() -> None:
    """The engine says 404."""
    app = container()
    app.get_archive.side_effect = NotFound("no such file")
    assert not critical_file_is_intact(mock.Mock(app=app))
    assert not _world.exists(app, "/tmp/unhealthy")


def networks(network_id: str, address: str = "127.0.0.1") -> dict[str, Any]:
    return {"Networks": {"net": {"NetworkID": network_id, "IPAddress": address}}}


@pytest.mark.parametrize(("mine", "members", "expected"), [("1", ["abc"], True), ("0", [], False), ("1", [], False)])
def test_a_container_is_attached_to_the_network_of_now(mine: str, members: list[str], expected: bool) -> None:
    """Not to one that had the name before."""
    client = mock.Mock()
    client.networks.get.return_value = mock.Mock(id="1", attrs={"Containers": dict.fromkeys(members)})
    agent = Agent("phm-test", "agent_1", client)
    assert _world.attached(agent, container(NetworkSettings=networks(mine)), "net") is expected


IGMP = """Idx\tDevice    : Count Querier\tGroup    Users Timer\tReporter
1\tlo        :     2      V3
\t\t\t\t0100FFEF     3 0:00000000\t\t0
\t\t\t\t010000E0     1 0:00000000\t\t0
3722\teth1      :     2      V3
\t\t\t\t%s010000E0     1 0:00000000\t\t0
"""


def test_a_container_connected_again_is_not_found_by_others() -> None:
    """As recorded before and after `docker network disconnect` and `connect`: the new interface has none of the groups."""
    assert not _world.joined(IGMP % "")
    assert _world.joined(IGMP % "0100FFEF     3 0:00000000\t\t0\n\t\t\t\t")


def test_an_address_answers_by_refusing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel that refuses the connection has been reached; silence and no address are no answer."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        unused = server.getsockname()[1]
    monkeypatch.setattr(_world, "UNUSED_PORT", unused)
    assert _world.answers(container(NetworkSettings=networks("1")))
    assert not _world.answers(container(NetworkSettings=networks("1", "")))
    assert not _world.answers(container(NetworkSettings={"Networks": {}}))
    with mock.patch("socket.create_connection", side_effect=TimeoutError):
        assert not _world.answers(container(NetworkSettings=networks("1")))


def test_a_volume_is_found_by_its_place_in_the_container() -> None:
    """Bind or named volume: the engine says where it is on this machine."""
    phm = container(Mounts=[{"Destination": "/var/lib/phm", "Source": "/var/lib/docker/volumes/x/_data"}])
    assert _volumes.behind(phm, "/var/lib/phm") == Path("/var/lib/docker/volumes/x/_data")
    with pytest.raises(LookupError, match="no volume at /var/log/phm"):
        _volumes.behind(phm, "/var/log/phm")


def test_a_proxy_without_an_engine_does_not_respond(tmp_path: Path) -> None:
    """Neither without its socket, nor when the other end closes."""
    assert not _docker_proxy.responds(tmp_path / "none.sock")


@pytest.mark.parametrize(("started", "hangs"), [("this run", "yes"), ("1", "no"), ("", "no")])
def test_a_health_check_that_hangs_is_seen_by_its_program(started: str, hangs: str, tmp_path: Path) -> None:
    """Only in the run of the container in which it was put there."""
    program, first = tmp_path / "test", Path("/proc/1/stat").read_text("ascii").split()[21]
    if started:
        program.write_text(HANG.format(started=first if started == "this run" else started), "ascii")
    asked = HANGS.replace(PROGRAM, str(program))
    assert subprocess.run(["sh", "-c", asked], capture_output=True, text=True, check=True).stdout.strip() == hangs
