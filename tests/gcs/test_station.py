"""The ground station: one bad frame, and frames that only a sender with the key may send."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest

from phm.commands.responses import computer
from phm.core.clock import SystemClock
from phm.core.model import Stamp
from phm.core.settings import MavlinkSettings
from phm.gcs.frames import ComputerStatus, Frame
from phm.gcs.samples import MAX_SENDERS
from phm.gcs.station import COMPONENT, GroundStation, Received
from phm.gcs.web.feed import StationFeed
from phm.gcs.web.view import View
from phm.transport.dialect import mavlink
from tests.gcs.bench import phm_heartbeat

LOADED = computer([], mono=0.0, utc=0.0)
RATE = mavlink.MAVLink_named_value_float_message(1000, b"scan", 9.5)


def station(key: Path | None = None) -> GroundStation:
    """Not started: the test is its threads."""
    settings = {"endpoints": [], "component_id": COMPONENT, "signing": {"key": str(key) if key else None}}
    return GroundStation(MavlinkSettings.model_validate(settings), 254, SystemClock())


def received(frame: Frame, raw: bytes) -> Received:
    clock = SystemClock()
    return Received(frame, raw, "udp", Stamp(clock.utc(), clock.mono()))


def agents(ground: GroundStation) -> set[int]:
    return {agent["agent"] for agent in ground.snapshot()[1].body["agents"]}


def test_a_frame_that_cannot_be_processed_loses_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of all agents wait together."""
    ground = station()
    receive = ground._store.receive

    def fail(frame: Any, link: str, at: Stamp) -> Any:
        if frame.system == 7:
            raise ValueError("0 is not a valid Slot")
        return receive(frame, link, at)

    monkeypatch.setattr(ground._store, "receive", fail)
    for agent in (7, 8):
        ground._frames.put(received(phm_heartbeat(agent), bytes([agent])))
    ground._turn()
    assert agents(ground) == {8}


@pytest.mark.parametrize("message", [LOADED, RATE], ids=["load", "rate"])
@pytest.mark.parametrize(("keyed", "signed", "taken"), [(True, False, 0), (True, True, 1), (False, False, 1)])
def test_with_a_key_unsigned_measurements_are_not_the_agents(
    tmp_path: Path, message: Any, keyed: bool, signed: bool, taken: int
) -> None:
    """Load and rates are shown beside its status, which must be signed, too."""
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    ground = station(key if keyed else None)
    message.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=193))
    message._signed = signed
    ground._receive(message, "udp")
    assert len(ground._frames.take(0.0)) == taken


def test_the_load_of_another_component_is_not_the_agents() -> None:
    """An autopilot or a camera of the same vehicle may send it, too. The number of senders is limited: the newest count."""
    feed = StationFeed(station(), View(SystemClock()), SystemClock(), cast(Any, None))
    feed._frame(received(ComputerStatus(7, 100, 99, None, None), b""))
    assert feed._values.get("A07", {}) == {}
    feed._frame(received(ComputerStatus(7, 193, 40, None, None), b""))
    assert feed._values["A07"]["cpu"] == 40
    for component in range(1, 251):
        for system in range(1, 11):
            feed._frame(received(ComputerStatus(system, component, 1, None, None), b""))
        feed._frame(received(ComputerStatus(7, 193, 41, None, None), b""))
    feed._frame(received(ComputerStatus(8, 193, 50, None, None), b""))
    assert len(feed._values) == MAX_SENDERS
    assert (feed._values["A07"]["cpu"], feed._values["A08"]["cpu"]) == (41, 50)
