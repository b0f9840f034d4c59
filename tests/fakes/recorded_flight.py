"""Replays a recorded MAVLink session into PHM's link code by a real socket; the real checks and tracker evaluate it.

The clock of PHM is moved from frame to frame, so a session of minutes takes seconds.
"""

from __future__ import annotations

import gzip
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm import testing
from phm.core.model import FaultClosed, FaultOpened, Level, Transition
from phm.probes.links import Links
from phm.recovery.safety.armed_state import ArmedState, assess
from phm.transport.mavlink import MavlinkHub
from tests.fakes.path_world import PathWorld
from tests.fakes.until import until

FOLDER = Path(__file__).parent.parent / "recorded" / "ardupilot"
STEP_S = 0.5
PHM = (1, 193)


def frames(name: str) -> Iterator[tuple[float, bytes]]:
    """Time in seconds from the start of the file, and the frame."""
    data, at, start = gzip.decompress((FOLDER / name).read_bytes()), 0, None
    while at < len(data):
        (micros,) = struct.unpack_from(">Q", data, at)
        assert data[at + 8] == 0xFD, "a frame of MAVLink 2"
        end = at + 8 + 12 + data[at + 9]
        start = micros if start is None else start
        yield (micros - start) / 1e6, data[at + 8 : end]
        at = end


def source(frame: bytes) -> tuple[int, int]:
    """System and component of the sender."""
    return frame[5], frame[6]


class RecordedFlight(PathWorld):
    """`play` until a time of the recording. closes: when the connection closes; it can be opened again immediately."""

    def __init__(self, name: str, *closes: float, **mavlink: Any) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        url = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        super().__init__(url=url, agent={"id": 1}, mavlink={"gcs_timeout": 10, **mavlink})
        self._name, self._closes = self.settings.mavlink.endpoints[0].key, list(closes)
        self._frames = [(at, frame) for at, frame in frames(name) if source(frame) != PHM]
        self._start, self._sent = self.clock.mono(), 0
        self.hub = MavlinkHub(self.settings.mavlink, 1, self.clock)
        self.probe = Links(self.hub, 1, self.settings.mavlink, self.clock, lambda: None)
        self.world = testing.world(
            clock=self.clock, links=self.probe, ros=self.ros, devices=self.devices, docker=self.docker
        )
        self.hub.start()
        self._connect()

    def close(self) -> None:
        self.hub.close()
        self._peer.close()
        self._server.close()

    def play(self, until_s: float) -> None:
        while self._frames and self._frames[0][0] <= until_s:
            at, frame = self._frames.pop(0)
            self._pass(at)
            self._peer.sendall(frame)
            self._sent += len(frame)
            self._read()
            self._rerun({"autopilot", "gcs"})
        self._pass(until_s)

    @property
    def now_s(self) -> float:
        return self.clock.mono() - self._start

    def _pass(self, until_s: float) -> None:
        while self._closes and self._closes[0] <= until_s:
            self._silent(self._closes.pop(0))
            self._peer.close()
            until(lambda: not self._open(), "the link to be closed")
            self.clock.advance(0.2)
            self._connect()
        self._silent(until_s)

    def _silent(self, until_s: float) -> None:
        while (left_s := until_s - self.now_s) > 1e-6:
            self.clock.advance(min(STEP_S, left_s))
            self._read()
            self._rerun({unit for check in self._due_checks() for unit in self._units(check)})
            self._rerun(self._take(self.tracker.tick(self.clock.stamp())))

    def _connect(self) -> None:
        self._peer, _ = self._server.accept()
        until(self._open, "the link to be open")

    def _open(self) -> bool:
        return any(link.open for link in self.hub.links())

    def _read(self) -> None:
        """Wait until PHM has read all data at the present time."""
        now = self.clock.mono()

        def done() -> bool:
            for endpoint in self.hub._endpoints:
                endpoint._ring()
            return self.hub.traffic()[self._name].bytes_in >= self._sent and self.hub.read_at(self._name) == now

        until(done, "PHM to have read the frames", poll_s=0.0005)

    # ------------------------------------------------------------ what was published

    @property
    def armed_state(self) -> ArmedState:
        """What recovery relies on."""
        return assess(self.probe.autopilot(), self.settings.mavlink.autopilot_timeout).state

    def published(self) -> list[tuple[float, str]]:
        """Faults and warnings with their times."""
        found = [(event.at.mono - self._start, _words(event)) for event in self.events if _words(event)]
        return [(round(at, 1), words) for at, words in found]


def _words(event: Any) -> str:
    if isinstance(event, FaultOpened):
        return f"{event.fault.unit} fault {event.fault.result.condition}"
    if isinstance(event, FaultClosed):
        return f"{event.fault.unit} {event.fault.outcome.value} by {event.fault.by}"
    if isinstance(event, Transition) and event.state.level is Level.WARN:
        return f"{event.state.unit} warning {event.state.result.brief}"
    return ""
