"""Recordings of ROS 2 in the report: diagnostics, errors of nodes, and gaps of topics, from rosbag2 and MCAP."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import CompressionType
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from phm.cli import group
from phm.review import page, tables
from tests.review import bags
from tests.review.records import T0, Flown, Ground, report
from tests.review.test_document import one_flight
from tests.review.test_external_clocks import THREE, clock_of, flown

RECORDED = ("diagnostic", "rosout", "gap")


def said(made: dict[str, Any], *kinds: str) -> list[tuple[float, str, str, str]]:
    rows = [row for row in made["other"]["rows"] if row["what"] in (kinds or RECORDED)]
    return [(round(row["t"] - T0, 3), row["what"], row["text"], row["level"]) for row in rows]


def problems(made: dict[str, Any]) -> dict[str, int]:
    return {row["what"]: row["count"] for row in made["files"]["problems"]}


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize(
    "compression", [None, (CompressionMode.MESSAGE, CompressionFormat.ZSTD)], ids=["plain", "messages packed"]
)
def test_a_bag_says_what_was_recorded(tmp_path: Path, storage: StoragePlugin, compression: Any) -> None:
    """Changes of diagnostics, errors and fatals once, and the gap of a regular topic; under any name, without metadata.yaml."""
    file = bags.rosbag2(tmp_path / "bag", bags.flight(), storage, compression)
    moved = tmp_path / "of the camera"
    file.rename(moved)
    made = report(moved)
    assert said(made) == bags.SAID
    assert list(problems(made)) == ["errors in /rosout that the same node repeated within 10 s, shown once"]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunks", [True, False])
def test_mcap_of_any_recorder_says_the_same(tmp_path: Path, compression: CompressionType, chunks: bool) -> None:
    """Each compression of chunks, and messages without a chunk."""
    file = bags.mcap(tmp_path / "x.mcap", bags.flight(), compression, chunks=chunks)
    made = report(file)
    assert said(made) == bags.SAID
    assert len(problems(made)) == 1


def test_topics_have_their_first_and_last_message(tmp_path: Path) -> None:
    """And one that ends before the recording does is a warning; one that is sent when there is something is not."""
    messages = [bags.scan(number / 10) for number in range(300)]
    messages += [bags.scan(at, topic="/seldom") for at in (2.0, 3.0, 60.0)]
    messages += [bags.scan(number / 2, topic="/odom") for number in range(201)]
    made = report(bags.mcap(tmp_path / "x.mcap", sorted(messages, key=lambda message: message[0])))
    assert said(made, "topic", "gap") == [
        (0.0, "topic", "/odom: first message (std_msgs/msg/String)", ""),
        (0.0, "topic", "/scan: first message (std_msgs/msg/String)", ""),
        (2.0, "topic", "/seldom: first message (std_msgs/msg/String)", ""),
        (29.9, "topic", "/scan: last of 300 messages, median period 0.100 s, 70.1 s before the recording ends", "WARN"),
        (60.0, "topic", "/seldom: last of 3 messages", ""),
        (100.0, "topic", "/odom: last of 201 messages, median period 0.500 s", ""),
    ]


def test_a_file_that_is_compressed_as_a_whole_is_read(tmp_path: Path) -> None:
    """MCAP and databases, by gzip and zstd."""
    file = bags.mcap(tmp_path / "x.mcap", bags.flight())
    shutil.copy(file, tmp_path / "y.mcap")
    options = (CompressionMode.FILE, CompressionFormat.ZSTD)
    packed = bags.rosbag2(tmp_path / "a", bags.flight(), StoragePlugin.MCAP, options)
    database = bags.rosbag2(tmp_path / "b", bags.flight(), StoragePlugin.SQLITE3, options)
    assert packed.suffix == database.suffix == ".zstd"
    shutil.copy(bags.rosbag2(tmp_path / "c", bags.flight(), StoragePlugin.SQLITE3), tmp_path / "y.db3")
    subprocess.run(["gzip", str(tmp_path / "y.mcap"), str(tmp_path / "y.db3")], check=True)
    for each in (tmp_path / "y.mcap.gz", packed, database, tmp_path / "y.db3.gz"):
        made = report(each)
        assert said(made) == bags.SAID, each


@pytest.mark.parametrize("schemas", [True, False])
def test_foreign_encodings_and_missing_types_are_named_and_their_times_read(tmp_path: Path, schemas: bool) -> None:
    """JSON and messages without a schema; never an exception."""
    messages = [(at, topic, kind, b'{"x": 1}') for at, topic, kind, _ in bags.flight()]
    made = report(bags.mcap(tmp_path / "x.mcap", messages, encoding="json", schemas=schemas))
    assert [what for _, what, _, _ in said(made)] == ["gap"]
    assert problems(made)["topics in the encoding 'json': only the times of their messages are read"] == 3
    made = report(bags.mcap(tmp_path / "y.mcap", bags.flight(), schemas=False))
    assert [what for _, what, _, _ in said(made)] == ["gap"]
    assert problems(made)["topics without a type: only the times of their messages are read"] == 3


@pytest.mark.parametrize("write", [bags.mcap, bags.rosbag2])
def test_a_recording_in_simulated_time_is_left_out_with_its_reason(tmp_path: Path, write: Any) -> None:
    """A recorder that was started with `use_sim_time` writes times that begin at 1970."""
    file = write(tmp_path / "bag.mcap", [bags.scan(number / 10 - T0) for number in range(1, 20)])
    result = CliRunner().invoke(group, ["report", str(file)])
    assert result.exit_code == 1
    assert "the clock was never set, or the time is simulated (use_sim_time)" in result.output


def test_our_own_export_can_be_read_again(tmp_path: Path) -> None:
    """Faults and levels of the MCAP file are those of the report that wrote it, of the same agents."""
    (tmp_path / "log").mkdir()
    one_flight(tmp_path / "log").close()
    made, file = report(tmp_path / "log"), tmp_path / "export.mcap"
    assert CliRunner().invoke(group, ["report", str(tmp_path / "log"), "--mcap", str(file)]).exit_code == 0
    again = report(file)
    rows = [row for row in again["other"]["rows"] if row["what"] == "diagnostic"]
    opened = [
        (round(row["t"], 3), row["agent"]) for row in rows if "/fault: " in row["text"] and row["level"] == "ERROR"
    ]
    assert opened == [(fault["opened"], "vehicle 1") for fault in made["faults"]]
    unit = "phm/agent_1/ros: nodes/node_1: "
    levels = [(round(row["t"] - T0), row["level"]) for row in rows if row["text"].startswith(unit)]
    assert levels[:2] == [(150, "ERROR"), (154, "")]
    assert not again["files"]["problems"]


def test_the_export_beside_the_logs_says_nothing_twice(tmp_path: Path) -> None:
    """PHM's own diagnostics of an agent with a log are left out: its log says the same."""
    one_flight(tmp_path).close()
    before = report(tmp_path)
    assert CliRunner().invoke(group, ["report", str(tmp_path), "--mcap", str(tmp_path / "x.mcap")]).exit_code == 0
    made = report(tmp_path)
    assert {row["what"] for row in made["other"]["rows"]} == {"topic"} and made["faults"] == before["faults"]


def test_a_recording_belongs_to_the_agent_of_its_folder(tmp_path: Path) -> None:
    """To the agent with logs in the nearest folder; where that is not one agent it has a separate row, and does not count as an agent."""
    for number in (1, 2):
        made = Flown(tmp_path / f"agent_{number}", number)
        made.until(100)
        made.close()
    bags.rosbag2(tmp_path / "agent_2" / "bags" / "bag", bags.flight())
    bags.mcap(tmp_path / "ground.mcap", bags.flight())
    found = report(tmp_path)
    owners = {(row["file"], row["agent"]) for row in found["other"]["rows"]}
    assert owners == {("bag.db3", "agent_2"), ("ground.mcap", "recording ground.mcap")}
    assert [(row["agent"], row["agent_id"]) for row in found["agents"]] == [
        ("agent_1", 1),
        ("agent_2", 2),
        ("recording ground.mcap", 0),
    ]
    assert "with 2 agents" in found["sentences"][0]
    assert "recording ground.mcap" in page.render(found)


def test_phms_own_diagnostics_in_a_recording_say_whose_it_is(tmp_path: Path) -> None:
    """The summary has the id of the agent; with two of them other entries have no owner."""
    summary = bags.diagnostics(0.5, "phm/agent_7: summary", 0, "fine", agent_id="7")
    made = report(bags.mcap(tmp_path / "x.mcap", [summary, *bags.flight()]))
    assert {row["system"] for row in made["other"]["rows"]} == {7}
    other = bags.diagnostics(0.6, "phm/agent_8: summary", 1, "1 of 2 units is OK", agent_id="8")
    made = report(bags.mcap(tmp_path / "y.mcap", [summary, other, *bags.flight()]))
    assert {(row["system"], row["text"].startswith("phm/")) for row in made["other"]["rows"]} == {(8, True), (0, False)}


def test_a_recording_alone_makes_no_claim_about_faults(tmp_path: Path) -> None:
    """No agent is in the record, and the sentences say so; the table has the entries."""
    file = bags.rosbag2(tmp_path / "bag", bags.flight())
    result = CliRunner().invoke(group, ["report", str(file)], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    assert "Faults are unknown: no agent is in the record." in result.output
    assert "(no log)" not in result.output, "no row that says 0 faults"
    assert "camera: Status: no frames" in result.output and "no message for 4.00 s" in result.output


def test_a_recording_gets_its_time_by_phms_diagnostics_in_it(tmp_path: Path) -> None:
    """Our own export, moved by a minute, is moved back; what else is in a recording of that computer goes with it."""
    folder = tmp_path / "log"
    lines = flown(folder, times=THREE)
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag" / "x.mcap"
    assert CliRunner().invoke(group, ["report", str(folder), "--mcap", str(file)]).exit_code == 0
    moved = bags.mcap(tmp_path / "y.mcap", [*moved_by(file, 60.0), bags.log(170.0, "planner", 40, "no scan")])
    file.unlink()
    made = report(folder, moved)
    clock = clock_of(made, moved)
    assert (clock["applied"], clock["offset_s"]) == (True, pytest.approx(-60.0)) and clock["lines"] >= len(lines)
    (entry,) = [row for row in made["other"]["rows"] if row["what"] == "rosout"]
    assert (entry["t"], entry["agent"]) == (pytest.approx(T0 + 110.0), "agent_1")


def moved_by(file: Path, seconds: float) -> list[bags.Message]:
    with file.open("rb") as stream:
        return [
            (message.log_time / 1e9 - T0 + seconds, channel.topic, bags.ARRAY, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def test_an_agent_that_only_the_ground_received_keeps_its_diagnostics(tmp_path: Path) -> None:
    """They are all that is there of it: only a log says the same."""
    ground = Ground(tmp_path / "ground.jsonl")
    ground.event(0, "presence", agent=7, name="agent_7", presence="alive", was="never received", silent_s=None)
    ground.event(100, "presence", agent=7, name="agent_7", presence="lost", was="alive", silent_s=1.0)
    ground.close()
    messages = [
        bags.diagnostics(0.5, "phm/agent_7: summary", 0, "fine", agent_id="7"),
        bags.diagnostics(20.0, "phm/agent_7/ros: nodes/node_1", 2, "is gone"),
    ]
    bags.mcap(tmp_path / "x.mcap", messages)
    made = report(tmp_path)
    assert said(made) == [(20.0, "diagnostic", "phm/agent_7/ros: nodes/node_1: is gone", "ERROR")]
    assert {row["agent"] for row in made["other"]["rows"]} == {"agent_7"}


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_an_independent_reader_counts_the_same(tmp_path: Path, storage: StoragePlugin) -> None:
    """Messages of each topic with the times of the first and the last one, as rosbags reads them."""
    file = bags.rosbag2(tmp_path / "bag", bags.flight(), storage)
    theirs: dict[str, list[float]] = {}
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, at, _ in reader.messages():
            theirs.setdefault(connection.topic, []).append(at / 1e9 - T0)
    expected = {(topic, len(times), round(times[0], 3), round(times[-1], 3)) for topic, times in theirs.items()}
    rows = said(report(file), "topic")
    last = {text.partition(":")[0]: (t, int(text.split()[3])) for t, _, text, _ in rows if ": last of " in text}
    first = {text.partition(":")[0]: t for t, _, text, _ in rows if ": first message " in text}
    assert {(topic, count, first[topic], t) for topic, (t, count) in last.items()} == expected


def test_recordings_with_the_same_name_have_separate_rows(tmp_path: Path) -> None:
    """Two vehicles with the same folders: the names are as long as it needs to distinguish them."""
    for number in (1, 2):
        folder = tmp_path / f"uav{number}" / "bags"
        folder.mkdir(parents=True)
        bags.mcap(folder / "x.mcap", bags.flight())
    bags.mcap(tmp_path / "y.mcap", bags.flight())
    made = report(tmp_path)
    assert [row["agent"] for row in made["agents"]] == [
        "recording uav1/bags/x.mcap",
        "recording uav2/bags/x.mcap",
        "recording y.mcap",
    ]
    rows = [sum(row["agent"] == agent["agent"] for row in made["other"]["rows"]) for agent in made["agents"]]
    assert rows[0] == rows[1] == rows[2] > 0


def test_entries_that_are_not_shown_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page draws those with a level first, however late they are; tables count what the document left out."""
    bags.mcap(tmp_path / "x.mcap", bags.flight())
    made = report(tmp_path)
    count = len(made["other"]["rows"])
    levels = [row["text"] for row in made["other"]["rows"] if row["level"]]
    monkeypatch.setattr(page, "MOST_OTHER", len(levels))
    drawn = page.render(made)
    data = json.loads(re.findall(r'<script type="application/json" id="data">(.*?)</script>', drawn, re.DOTALL)[0])
    assert [row[3] for row in data["other"]] == levels and f"({count - len(levels)} are not drawn)" in drawn
    monkeypatch.setattr("phm.review.document.MOST_OTHER", count - 3)
    assert "; the last 3 are left out" in tables.markdown(report(tmp_path))
    monkeypatch.setattr("phm.review.lines.MOST_PROBLEMS", 0)
    assert "| problems of other kinds or files | 1 |" in tables.markdown(report(tmp_path))


def test_the_name_of_a_file_without_a_record_steers_no_terminal(tmp_path: Path) -> None:
    """It is shown where nothing else can be."""
    (tmp_path / "a\x1b[2J\n.mcap").write_bytes(b"\x89MCAP0\r\n")
    result = CliRunner().invoke(group, ["report", str(tmp_path)])
    assert result.exit_code == 1 and "the recorder was not stopped" in result.output
    assert "\x1b" not in result.output and result.output.count("\n") == 1


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_name_that_is_not_text_is_read_and_shown(tmp_path: Path, storage: StoragePlugin) -> None:
    """File systems allow any bytes in names."""
    file = bags.rosbag2(tmp_path / "bag", bags.flight(), storage)
    folder = tmp_path / "out"
    folder.mkdir()
    os.rename(file, os.fsencode(folder) + b"/\xff?#" + os.fsencode(file.suffix))
    assert said(report(folder)) == bags.SAID
    result = CliRunner().invoke(group, ["report", str(folder), "--html", str(tmp_path / "x.html")])
    assert result.exit_code == 0, result.output
    assert "udcff" in (tmp_path / "x.html").read_text("utf-8")
