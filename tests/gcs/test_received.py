"""The record has the heartbeats by which the report compares clocks, in the numbering of the agents' logs."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import MavlinkSettings
from phm.gcs import station as station_module
from phm.gcs.recorder import Recorder
from phm.gcs.station import COMPONENT, GroundStation
from phm.gcs.web.replay import record
from phm.reporters import received_heartbeats
from phm.review import record_reader
from phm.wire import json_log
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.until import until
from tests.gcs.bench import Wire


def links(*ports: int) -> MavlinkSettings:
    """Listens on these ports."""
    urls = [{"url": f"udpin:127.0.0.1:{port}", "budget": 0} for port in ports]
    return MavlinkSettings.model_validate({"endpoints": urls, "component_id": COMPONENT})


@pytest.fixture
def ground(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[GroundStation, list[Wire]]]:
    """A station with two links that records each heartbeat immediately, and a program at each link."""
    monkeypatch.setattr(received_heartbeats, "EACH", 1)
    monkeypatch.setattr(received_heartbeats, "WRITE_S", 0.0)
    monkeypatch.setattr(station_module, "HEARTBEAT_S", 0.05)
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(2)]
    station, wires = GroundStation(links(*ports), 254, SystemClock()), [Wire(port) for port in ports]
    station.start()
    until(lambda: len(station.snapshot()[1].body["links"]) == 2, "the links")
    yield station, wires
    station.close()
    for wire in wires:
        wire.sock.close()


def frames(path: Path) -> set[tuple[int, int, int]]:
    """System, component and frame number of the heartbeats in the record."""
    lines = [line for line in json_log.read(path) if line["event"] == "received"]
    return {(system, component, number) for line in lines for system, component, number, _ in line["frames"]}


def five(wire: Wire) -> list[Any]:
    """At least so many messages that arrive there."""
    found = list[Any]()

    def enough() -> bool:
        found.extend(wire.receive())
        return len(found) >= 5

    until(enough, "heartbeats")
    return found


def test_heartbeats_that_the_ground_sends_and_receives_are_in_its_record(
    ground: tuple[GroundStation, list[Wire]], tmp_path: Path
) -> None:
    """With the numbers that receivers see, on each link; the report reads them, and a replay has no event of them."""
    station, wires = ground
    path = tmp_path / "ground.jsonl"
    book = Recorder(str(path), station, SystemClock())
    book.start()
    sender, seen = Sender(7, 193), list[Any]()
    for place, wire in enumerate(wires):
        for _ in range(3 - place):
            wire.send(sender.frame(heartbeat(1 << 30)))
        seen += five(wire)
    sent = {
        (one.get_srcSystem(), one.get_srcComponent(), one.get_seq()) for one in seen if one.get_type() == "HEARTBEAT"
    }
    assert len(sent) >= 5 and {one[:2] for one in sent} == {(254, 190)}
    until(lambda: sent <= frames(path), "what was sent")
    until(lambda: len([one for one in frames(path) if one[:2] == (7, 193)]) == 5, "what was received")
    book.close()
    (run,) = record_reader.read(record_reader.find([str(path)])).grounds.values()
    assert run.received.keys() >= sent and all(times == sorted(times) for times in run.received.values())
    assert len(run.numbers.spans) == 1, "these lines do not count"
    assert "received" not in {entry.line["event"] for entry in record.load(path).entries if entry.line}


def test_a_silent_station_records_what_it_receives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It sends nothing, so it records nothing that it sent."""
    monkeypatch.setattr(received_heartbeats, "WRITE_S", 0.0)
    port = free_port(socket.SOCK_DGRAM)
    station = GroundStation(links(port), 254, SystemClock(), silent=True)
    book = Recorder(str(tmp_path / "ground.jsonl"), station, SystemClock())
    station.start()
    book.start()
    wire, sender = Wire(port), Sender(7, 193)
    until(lambda: station.snapshot()[1].body["links"], "the link")
    for _ in range(17):
        wire.send(sender.frame(heartbeat(1 << 30)))
    until(lambda: len(frames(tmp_path / "ground.jsonl")) >= 2, "the frames")
    station.close()
    book.close()
    wire.sock.close()
    found = frames(tmp_path / "ground.jsonl")
    assert {one[:2] for one in found} == {(7, 193)} and all(one[2] % 8 == 0 for one in found)
