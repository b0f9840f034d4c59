"""Export as MCAP: two independent readers accept the file, and the Foxglove layout finds what it shows."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from phm.cli import group
from phm.core.model import Slot
from phm.review import cdr
from tests.fakes.records import unit
from tests.review.records import T0, Flown, Ground
from tests.review.test_document import one_flight

LAYOUT = Path(__file__).parents[2] / "config" / "examples" / "foxglove" / "phm-layout.json"
JAZZY = get_typestore(Stores.ROS2_JAZZY)


def export(folder: Path, *words: str) -> Path:
    file = folder / "out.mcap"
    result = CliRunner().invoke(group, ["report", str(folder), "--mcap", str(file), *words])
    assert result.exit_code == 0, result.output
    return file


def with_rosbags(file: Path) -> list[tuple[float, str, dict[str, Any]]]:
    """Seconds since T0, topic, and statuses by name; decoded with the definition in the file."""
    with AnyReader([file]) as reader:
        return [
            (stamp / 1e9 - T0, connection.topic, {status.name: status for status in decoded.status})
            for connection, stamp, raw in reader.messages()
            for decoded in [cast(Any, reader.deserialize(raw, connection.msgtype))]
        ]


def test_rosbags_reads_levels_and_faults(tmp_path: Path) -> None:
    """Each fault opens and ends on its topic; the unit is ERROR between, and the summary counts it."""
    one_flight(tmp_path).close()
    read = with_rosbags(export(tmp_path))
    faults = [
        (t, status.level, name) for t, topic, found in read if topic == "/phm/faults" for name, status in found.items()
    ]
    ids = {name for _, _, name in faults}
    assert ids and all(re.fullmatch(r"phm/agent_1/fault: 0001-\d+", name) for name in ids)
    unit = "phm/agent_1/ros: nodes/node_1"
    levels = [found[unit].level for _, topic, found in read if topic == "/diagnostics" and unit in found]
    assert 2 in levels and levels[0] != 2
    opened = next(t for t, level, _ in faults if level == 2)
    at_once = next(
        found for t, topic, found in read if topic == "/diagnostics" and abs(t - opened) < 0.01 and unit in found
    )
    keys = {pair.key: pair.value for pair in at_once["phm/agent_1: summary"].values}
    assert (keys["error"], at_once["phm/agent_1: summary"].level) == ("1", 2)


def test_the_reader_of_mcap_accepts_it_with_its_checksums(tmp_path: Path) -> None:
    """In the order of time, with the profile of ROS 2 and the definition of the message."""
    one_flight(tmp_path).close()
    with export(tmp_path).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        rows = [(schema, channel, message) for schema, channel, message in reader.iter_messages(log_time_order=False)]
        times = [message.log_time for _, _, message in rows]
    assert times == sorted(times) and len(rows) > 40
    assert {(schema.name, schema.encoding, channel.message_encoding) for schema, channel, _ in rows if schema} == {
        ("diagnostic_msgs/msg/DiagnosticArray", "ros2msg", "cdr")
    }


def test_the_encoding_is_that_of_an_independent_serializer() -> None:
    """Byte for byte, with odd lengths and characters of several bytes."""
    types = JAZZY.types
    status, pair, header = (
        types["diagnostic_msgs/msg/DiagnosticStatus"],
        types["diagnostic_msgs/msg/KeyValue"],
        types["std_msgs/msg/Header"],
    )
    stamp = types["builtin_interfaces/msg/Time"](sec=1_772_366_400, nanosec=250_000_000)
    for length in range(5):
        mine = cdr.Status(2, "n" * length, "Übel", "h", (("k" * length, "v"), ("", "w")))
        theirs = status(
            level=2, name=mine.name, message=mine.message, hardware_id="h", values=[pair(*each) for each in mine.values]
        )
        whole = types["diagnostic_msgs/msg/DiagnosticArray"](
            header=header(stamp=stamp, frame_id=""), status=[theirs, theirs]
        )
        expected = bytes(JAZZY.serialize_cdr(whole, "diagnostic_msgs/msg/DiagnosticArray"))
        assert cdr.diagnostic_array(1_772_366_400.25, [mine, mine]) == expected


def test_the_layout_of_foxglove_shows_it(tmp_path: Path) -> None:
    """Its topics of diagnostics and its status names are in the file."""
    one_flight(tmp_path).close()
    read = with_rosbags(export(tmp_path))
    panels = json.loads(LAYOUT.read_text("utf-8"))["configById"].values()
    topics = {panel["topicToRender"] for panel in panels if "topicToRender" in panel}
    names = {panel["selectedName"] for panel in panels if "selectedName" in panel}
    assert topics <= {topic for _, topic, _ in read} and names <= {name for _, _, found in read for name in found}


def test_no_status_is_old_enough_to_be_shown_as_stale(tmp_path: Path) -> None:
    """Foxglove, Lichtblick and diagnostic_aggregator show a status as STALE that is not repeated within 5 s."""
    one_flight(tmp_path).close()
    stamps: dict[str, list[float]] = {}
    for t, topic, found in with_rosbags(export(tmp_path)):
        for name in found if topic == "/diagnostics" else ():
            stamps.setdefault(name, []).append(t)
    assert stamps
    for name, times in stamps.items():
        assert max(later - t for t, later in pairwise(times)) < 5.0, name


def test_the_summary_does_not_count_units_with_nothing_to_evaluate(tmp_path: Path) -> None:
    """As on the live topic."""
    made = Flown(tmp_path)
    made.states["rates/topic_2"] = unit("rates/topic_2", Slot.RATES, bypass=True)
    made.until(60)
    made.close()
    arrays = [found for _, _, found in with_rosbags(export(tmp_path)) if "phm/agent_1/ros: rates/topic_2" in found]
    summaries = [found["phm/agent_1: summary"] for found in arrays]
    assert {summary.message for summary in summaries} == {"3 of 3 units are OK", "PHM does not run"}
    keys = {pair.key: pair.value for pair in summaries[0].values}
    assert (keys["ok"], keys["not_applicable"]) == ("3", "1")


def test_a_flight_begins_with_all_units(tmp_path: Path) -> None:
    """Levels from before the window are known in it, and nothing is outside of it."""
    one_flight(tmp_path).close()
    made = json.loads(CliRunner().invoke(group, ["report", str(tmp_path), "--flight", "1", "--json"]).output)
    read = with_rosbags(export(tmp_path, "--flight", "1"))
    assert read[0][0] == pytest.approx(made["window"]["begin"] - T0, abs=0.001)
    assert read[-1][0] == pytest.approx(made["window"]["end"] - T0, abs=0.001)
    assert {name.partition(": ")[2] for name in read[0][2]} >= {"summary", "nodes/node_1", "container/ros_app"}


def test_an_agent_that_does_not_run_is_stale(tmp_path: Path) -> None:
    """From the end of its log on; one that only the ground received has its summary."""
    first, second = Flown(tmp_path / "a", 1), Flown(tmp_path / "b", 2)
    first.until(60)
    first.close()
    second.until(300)
    second.close()
    ground = Ground(tmp_path / "ground.jsonl")
    ground.event(20, "presence", agent=3, name="agent_3", presence="alive", was="never received", silent_s=None)
    ground.close()
    read = with_rosbags(export(tmp_path))
    last = read[-1][2]
    assert last["phm/agent_1: summary"].level == 3 and last["phm/agent_1/docker: container/ros_app"].level == 3
    assert "phm/agent_3: summary" in last
    middle = next(found for t, _, found in read if t > 200 and "phm/agent_2: summary" in found)
    assert middle["phm/agent_2: summary"].level == 0


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    """A sentence and exit code 1; nothing is left behind."""
    one_flight(tmp_path).close()
    result = CliRunner().invoke(group, ["report", str(tmp_path), "--mcap", str(tmp_path / "missing" / "x.mcap")])
    assert result.exit_code == 1 and "cannot write" in result.output
