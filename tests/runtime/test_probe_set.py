"""What a set of probes leaves behind when it is closed, as at each reload."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from pathlib import Path

from phm import testing
from phm.core.clock import SystemClock
from phm.facts import CannotTell, SelfFact
from phm.runtime.probe_set import ProbeSet, build_probes
from tests.fakes.until import until


def test_closed_probes_leave_no_threads_behind(tmp_path: Path) -> None:
    """PHM's container has a limit of processes, and an agent may be reloaded a hundred times."""
    (tmp_path / "app.log").touch()
    settings = testing.settings(host={"disks": [str(tmp_path)], "dev_root": str(tmp_path)})

    def used() -> ProbeSet:
        probes = build_probes(
            settings,
            SystemClock(),
            wake=lambda unit: None,
            docker_event=lambda event: None,
            note=lambda text: None,
            read_self=lambda: SelfFact(1.0),
        )
        assert not probes.world.host.read().disks[0].problem
        probes.world.devices.serial_ports()
        probes.world.links.users(os.devnull)
        probes.world.logs.follow("app", patterns=["x"], timeout_s=60.0, path=str(tmp_path / "app.log"))
        with socket.create_server(("127.0.0.1", 0)) as server:
            probes.world.sockets.connect("127.0.0.1", server.getsockname()[1], timeout_s=60.0)
        return probes

    before = set(threading.enumerate())
    for _ in range(5):
        probes = used()
        probes.close()
        with contextlib.suppress(CannotTell):  # a check that began before
            probes.world.devices.serial_ports()
    until(lambda: set(threading.enumerate()) <= before, "the end of the threads", threading.enumerate)
