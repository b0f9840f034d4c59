"""What a record keeps of what agents report between their events: sampled, bounded, and plotted by a replay."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Stamp
from phm.gcs import samples as module
from phm.gcs.frames import ComputerStatus, Frame, Heartbeat, NamedValue, RadioStatus, TunnelPayload
from phm.gcs.recorder import Recorder
from phm.gcs.samples import EACH_S, Samples
from phm.gcs.station import GroundStation, Received
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.replay import record
from phm.gcs.web.replay.page import ReplayPage
from phm.gcs.web.replay.record import RecordError, load
from phm.transport.dialect import mavlink
from phm.wire import json_log
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.until import until
from tests.gcs.bench import Wire, phm_heartbeat
from tests.gcs.test_received import links
from tests.gcs.web.swarm import Client


def received(frame: Frame, at: float) -> Received:
    return Received(frame, b"", "udp", Stamp(1e9 + at, at), isinstance(frame, Heartbeat))


def add(made: Samples, at: float, *frames: Frame) -> None:
    for frame in frames:
        made.add(received(frame, at))


def test_the_newest_value_and_the_longest_gap_are_kept() -> None:
    """One sample of each series in an interval; a heartbeat that arrives on two links makes none."""
    made = Samples()
    add(made, 0.0, phm_heartbeat(7))
    add(made, 1.0, phm_heartbeat(7), ComputerStatus(7, 193, 40, 50.5, None), NamedValue(7, 193, "scan", 9.5))
    add(made, 1.05, phm_heartbeat(7))
    add(made, 5.05, phm_heartbeat(7), ComputerStatus(7, 193, 60, 50.5, 71))
    add(made, 6.0, phm_heartbeat(7), RadioStatus(51, 68, 190, 180, 40, 41, 99))
    assert made.take(6.0) == {
        "A07": {"gap": 4.0, "cpu": 60.0, "memory": 50.5, "temperature": 71.0, "topic scan": 9.5},
        "link:udp": {"rssi": 190.0, "remrssi": 180.0, "noise": 40.0, "remnoise": 41.0, "txbuf": 99.0},
    }
    add(made, 7.0, phm_heartbeat(7))
    assert made.take(6.0 + EACH_S - 0.1) == {}
    assert made.take(6.0 + EACH_S) == {"A07": {"gap": 1.0}}
    add(made, 8.0, phm_heartbeat(7))
    assert made.take(17.0) == {}
    assert made.take(17.0, last=True) == {"A07": {"gap": 1.0}}


def test_what_is_not_known_is_left_out() -> None:
    """Frames of senders without a heartbeat, values that are not finite, and frames of other kinds."""
    made = Samples()
    add(made, 0.0, ComputerStatus(7, 193, 40, 50.0, 60), phm_heartbeat(8), TunnelPayload(8, 193, 1, b""))
    add(made, 1.0, NamedValue(8, 193, "scan", None), NamedValue(8, 193, "", 1.0), ComputerStatus(8, 193, None, None, 5))
    assert made.take(1.0) == {"A08": {"temperature": 5.0}}


def test_what_a_radio_does_not_measure_is_left_out() -> None:
    """255 is `unknown` in RADIO_STATUS, for one value or for all; a replay keeps it so."""
    made = Samples()
    add(made, 0.0, RadioStatus(51, 68, None, 180, None, 41, 99))
    assert made.take(0.0) == {"link:udp": {"remrssi": 180.0, "remnoise": 41.0, "txbuf": 99.0}}
    radio = {"rssi": None, "remrssi": 180, "noise": None, "remnoise": 41, "txbuf": 99}
    assert record._radio(radio) == RadioStatus(51, 68, None, 180, None, 41, 99)


def test_a_defect_in_samples_does_not_end_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Events are recorded, and a snapshot at the end."""

    def fail(samples: Samples, one: Received) -> None:
        raise TypeError("float")

    monkeypatch.setattr(Samples, "add", fail)
    path = _record(tmp_path)
    kinds = {line["event"] for line in json_log.read(path)}
    assert {"agent", "snapshot"} <= kinds
    assert "recording samples or a snapshot failed" in caplog.text


def test_senders_and_series_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names come from the air, so their number is limited: a new one takes the place of the one that was silent for the longest time."""
    monkeypatch.setattr(module, "MAX_SERIES", 3)
    monkeypatch.setattr(module, "MAX_SENDERS", 2)
    made = Samples()
    add(made, 0.0, *(phm_heartbeat(number) for number in (1, 2)))
    add(made, 1.0, *(phm_heartbeat(number) for number in (1, 3)))
    add(made, 2.0, *(phm_heartbeat(number) for number in (1, 3)), NamedValue(2, 193, "t0", 1.0))
    add(made, 2.0, *(NamedValue(1, 193, f"t{number}", 1.0) for number in range(10)), NamedValue(1, 193, "t0", 2.0))
    assert made.take(2.0) == {"A01": {"gap": 1.0, "topic t0": 2.0}, "A03": {"gap": 1.0}}


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    return _record(tmp_path)


def _record(tmp_path: Path) -> Path:
    """A record of a station that has received two heartbeats of agent 7, its load, and the rate of a topic."""
    port = free_port(socket.SOCK_DGRAM)
    station, path = GroundStation(links(port), 254, SystemClock()), tmp_path / "ground.jsonl"
    book = Recorder(str(path), station, SystemClock())
    station.start()
    book.start()
    wire, sender = Wire(port), Sender(7, 193)
    try:
        until(lambda: station.snapshot()[1].body["links"], "the link")
        wire.send(sender.frame(heartbeat(1 << 30)))
        until(lambda: station.snapshot()[1].body["agents"], "the agent")
        end = time.monotonic() + 0.2  # a shorter gap would count as a copy
        until(lambda: time.monotonic() > end, "time to pass")
        for message in (
            mavlink.MAVLink_named_value_float_message(1000, b"scan", 9.5),
            heartbeat(1 << 30),
            mavlink.MAVLink_radio_status_message(190, 180, 99, 40, 41, 0, 0),
        ):
            wire.send(sender.frame(message))
        until(lambda: station.snapshot()[1].body["radios"], "the last frame")
    finally:
        station.close()
        book.close()
        wire.sock.close()
    return path


def _series(path: Path) -> dict[str, set[str]]:
    """The recorded series by sender."""
    found: dict[str, set[str]] = {}
    for line in json_log.read(path):
        if line["event"] == "samples":
            for name, values in line["samples"].items():
                found.setdefault(name, set()).update(values)
    return found


def test_a_replay_plots_what_was_recorded(recorded: Path) -> None:
    """Gaps, rates and radios have their series on the page; the numbering of the events has no hole."""
    (link,) = (name for name in _series(recorded) if name.startswith("link:"))
    assert {"gap", "topic scan"} <= _series(recorded)["A07"]
    assert _series(recorded)[link] == {"rssi", "remrssi", "noise", "remnoise", "txbuf"}
    page = ReplayPage(load(recorded), ListenOptions(port=0), SystemClock())
    try:
        page.start()
        client = Client(page.address)
        client.session()
        client.post("/api/replay", {"do": "pause"})
        client.post("/api/replay", {"do": "seek", "utc": 4e9})

        def points(name: str, kind: str) -> list[Any]:
            return list(client.get(f"/api/history/series?agent={name}&kind={kind}")["points"])

        (rate,) = until(lambda: points("A07", "topic%20scan"), "the rate")
        assert rate[1] == 9.5
        gaps = until(lambda: [value for _, value, _ in points("A07", "gap") if value is not None], "the gaps")
        assert all(value > 0.1 for value in gaps)
        assert until(lambda: points(link.replace(":", "%3A"), "rssi"), "the radio")[-1][1] == 190
    finally:
        page.close()


@pytest.mark.parametrize(
    "values",
    [
        {"A07": 5},
        {"A07": {"gap": "1"}},
        {"A07": {"gap": None}},
        [1],
        {"A07": [1]},
        {"A" * 101: {"gap": 1}},
        {"A07": {"gap": 1e300}},
    ],
)
def test_damaged_samples_are_left_out(recorded: Path, values: Any) -> None:
    """Of the wrong type, or too long or too large; what else the record has is shown."""
    lines = recorded.read_text().splitlines()
    places = [place for place, line in enumerate(lines) if '"samples"' in line]  # several on a busy machine
    known = len(load(recorded).entries)
    for place in places:
        lines[place] = json.dumps({**json.loads(lines[place]), "samples": values})
    recorded.write_text("\n".join(lines) + "\n")
    found = load(recorded)
    assert places and known - len(places) <= len(found.entries) <= known
    assert not any(entry.samples for entry in found.entries)


def test_a_record_of_too_many_samples_is_refused(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are held in memory."""
    monkeypatch.setattr("phm.gcs.web.replay.record.MAX_SAMPLES", 1)
    with pytest.raises(RecordError, match="more than 1 samples; split it"):
        load(recorded)
