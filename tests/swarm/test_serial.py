"""Two agents whose network is a pair of serial radios in transparent mode (XBee): bytes in small packets, some of them
lost.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.settings import Settings
from phm.facts.swarm import SwarmFact
from phm.runtime.wiring import build_daemon
from phm.simulation.mavlink_port import Pty
from phm.testing import settings
from tests.fakes.until import until

PACKET_BYTES = 72
"""As many bytes as an 802.15.4 radio sends per packet; a frame goes on in the next one."""
LOST = 9
"""One of this many packets is lost, in each direction."""


class Air:
    """Two radios, each behind a serial port; `cut`: they do not receive each other."""

    def __init__(self, paths: list[str]) -> None:
        self._ports = [Pty(path) for path in paths]
        self.cut = False
        self.passed = self.lost = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stopping.set()
        self._thread.join(60)
        for port in self._ports:
            port.close()

    def _run(self) -> None:
        other = dict(zip(self._ports, reversed(self._ports), strict=True))
        while not self._stopping.is_set():
            for port in select.select(self._ports, [], [], 0.05)[0]:
                with contextlib.suppress(BlockingIOError):
                    packet = os.read(port.fileno(), PACKET_BYTES)
                    self.passed += 1
                    if self.cut or self.passed % LOST == 0:
                        self.lost += 1
                    else:
                        other[port].send(packet)


class Pair:
    """Agents 1 and 2, each a real daemon."""

    def __init__(self, folder: Path) -> None:
        paths = [str(folder / f"ttyXB{number}") for number in (1, 2)]
        self.air = Air(paths)
        self.daemons = [build_daemon(_settings(folder, number, path)) for number, path in enumerate(paths, 1)]
        for daemon in self.daemons:
            daemon.start()

    def close(self) -> None:
        for daemon in self.daemons:
            daemon.stop()
        self.air.close()

    def see(self) -> tuple[SwarmFact, SwarmFact]:
        first, second = (daemon.components.probes.world.swarm.snapshot() for daemon in self.daemons)
        return first, second

    def states(self) -> list[str]:
        """How each agent sees the other."""
        return [peer.state for fact in self.see() for peer in fact.peers.values()]


def _settings(folder: Path, number: int, path: str) -> Settings:
    place = folder / str(number)
    return settings(
        agent={"id": number},
        interval=5,
        state_dir=str(place / "state"),
        run_dir=str(place / "run"),
        log={"directory": str(place / "log")},
        swarm={"agents": [1, 2]},
        checks={check: {"enabled": False} for check in ("host", "engine")},
        mavlink={
            "endpoints": [{"url": path, "name": "xbee", "leads_to": "peers", "baud": 9600}],
            "heartbeat": 0.5,
            "refresh": 3,
        },
    )


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    made = Pair(tmp_path)
    yield made
    made.close()


def test_agents_receive_each_other_by_serial_radios(pair: Pair) -> None:
    """Heartbeats and views arrive though every ninth packet is lost; silence and its end are detected on both sides."""
    until(lambda: pair.states() == ["alive", "alive"], "both to be received")
    until(lambda: all(peer.received_by == (1, 2) for fact in pair.see() for peer in fact.peers.values()), "views")
    assert all(fact.links == ("xbee",) for fact in pair.see())
    until(lambda: pair.air.lost >= 3, "packets to be lost")
    pair.air.cut = True
    until(lambda: pair.states() == ["lost", "lost"], "both to be lost")
    pair.air.cut = False
    until(lambda: pair.states() == ["alive", "alive"], "both to be back")
