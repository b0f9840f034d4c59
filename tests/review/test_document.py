"""The document says what the records say: faults, flights, availability, uptime, what is missing."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from phm.core.model import Level, Slot, Transition
from phm.review import document
from tests.fakes.records import unit
from tests.review.records import T0, Flown, Ground, report


def one_flight(folder: Path, number: int = 1, **options: object) -> Flown:
    """Armed from 100 to 300 s; node_1 fails at 150 for 4 s; the container fails at 400 and stays so; ends at 500."""
    made = Flown(folder, number, **options)  # type: ignore[arg-type]
    made.until(100)
    made.arm(True)
    made.until(150)
    made.fail("nodes/node_1")
    made.until(300)
    made.arm(False)
    made.until(400)
    made.fail("container/ros_app", lasts=None)
    made.until(500)
    return made


def test_a_fault_has_its_cause_consequences_actions_and_the_lines_around(tmp_path: Path) -> None:
    """All that the log says about a fault is in its row, on one time axis."""
    one_flight(tmp_path).close()
    first, second = report(tmp_path)["faults"]
    assert (first["agent"], first["unit"], first["check"], first["outcome"], first["by"]) == (
        "agent_1",
        "nodes/node_1",
        "nodes",
        "resolved",
        "restart",
    )
    assert (first["opened"], first["closed"], first["lasted_s"]) == (T0 + 150, T0 + 154, 4.0)
    assert [(step["action"], step["phase"]) for step in first["steps"]] == [
        ("restart", "started"),
        ("restart", "verified"),
    ]
    assert first["consequences"] == ["rates"]
    assert first["lines"][0]["text"].startswith("FAILURE: nodes/node_1: nodes/node_1 is gone")
    assert (second["unit"], second["outcome"], second["closed"], second["lasted_s"]) == (
        "container/ros_app",
        "open",
        None,
        100.0,
    )


def test_five_sentences_say_what_matters(tmp_path: Path) -> None:
    """Duration, agents, faults, recovered, open, the worst agent, and what to do before the next flight."""
    one_flight(tmp_path / "a", 1).close()
    quiet = Flown(tmp_path / "b", 2)
    quiet.until(500)
    quiet.close()
    sentences = report(tmp_path)["sentences"]
    assert sentences == [
        "The record lasted 8 min 20 s, from 2026-03-01 12:00:00 to 12:08:20 UTC, with 2 agents and 1 flight.",
        "There were 2 faults: 1 ended by an action of PHM and 0 otherwise, after 4.0 s on average.",
        "1 fault was open at the end (agent_1 container/ros_app gone), and PHM gave up on 0.",
        "agent_1 was worst, with 2 faults and 1 min 44 s in ERROR; PHM ran 100.00 % of the time.",
        "Before the next flight, on agent_1 (container/ros_app): restart it and check its log.",
    ]


def test_the_first_sentence_has_the_date_of_the_end_if_it_is_another(tmp_path: Path) -> None:
    """A record over midnight."""
    midnight = 12 * 3600
    made = Flown(tmp_path, start=midnight - 20)
    made.until(midnight + 40)
    made.close()
    assert "from 2026-03-01 23:59:40 to 2026-03-02 00:00:40 UTC" in report(tmp_path)["sentences"][0]


def test_one_flight_is_chosen_by_its_number(tmp_path: Path) -> None:
    """A flight is from arming to disarming, and what is outside does not count."""
    one_flight(tmp_path).close()
    made = report(tmp_path, flight=1)
    assert [fault["unit"] for fault in made["faults"]] == ["nodes/node_1"]
    assert (made["window"]["begin"], made["window"]["end"]) == (T0 + 98, T0 + 302)
    assert made["sentences"][0].startswith("Flight 1 lasted 3 min 20 s, from 2026-03-01 12:01:40 to 12:05:00 UTC, ")
    with pytest.raises(document.NoFlight, match=r"flight 2 is not in the record: it has flights 1 \(3 min 20 s\)"):
        report(tmp_path, flight=2)


def test_availability_is_the_share_of_the_known_time_without_an_error(tmp_path: Path) -> None:
    """Of each layer, container, node and topic."""
    one_flight(tmp_path).close()
    rows = {(row["kind"], row["name"]): row for row in report(tmp_path)["availability"]}
    assert rows["container", "ros_app"]["availability"] == pytest.approx(0.8)
    assert rows["node", "node_1"]["availability"] == pytest.approx(1 - 4 / 500)
    assert rows["layer", "ros"]["error_s"] == pytest.approx(4.0)
    assert rows["topic", "topic_1"]["availability"] == 1.0
    assert rows["agent", "agent_1"]["error_s"] == pytest.approx(104.0)


def test_each_check_has_mtbf_and_mttr_with_limits(tmp_path: Path) -> None:
    """MTBF is the observed time by the number of faults; the limits are those of a Poisson process."""
    one_flight(tmp_path).close()
    rows = {row["check"]: row for row in report(tmp_path)["checks"]}
    nodes = rows["nodes"]
    assert (nodes["faults"], nodes["observed_s"], nodes["mtbf_s"], nodes["mttr_s"]) == (1, 500.0, 500.0, 4.0)
    assert nodes["mtbf_low_s"] == pytest.approx(500 / 5.5716, rel=1e-3)
    assert nodes["mtbf_high_s"] == pytest.approx(500 / 0.0253, rel=1e-2)
    assert (rows["rates"]["faults"], rows["rates"]["mtbf_s"], rows["rates"]["mtbf_high_s"]) == (0, None, None)


def test_the_time_of_a_check_is_that_of_the_runs_that_had_it(tmp_path: Path) -> None:
    """A check that was added between two flights did not watch the first one."""
    first = Flown(tmp_path, boot="boot0001")
    first.until(100)
    first.close()
    second = Flown(tmp_path, boot="boot0002", start=220.0)
    second.states["devices"] = unit("devices", Slot.DEVICES)
    second.until(320)
    second.close()
    rows = {row["check"]: row["observed_s"] for row in report(tmp_path)["checks"]}
    assert (rows["nodes"], rows["devices"]) == (200.0, 100.0)


def test_a_restart_in_flight_is_a_gap_and_a_fault_over_it_is_one_fault(tmp_path: Path) -> None:
    """Two runs are one agent; PHM's uptime is the time in which it wrote."""
    first = Flown(tmp_path, boot="boot0001")
    first.until(100)
    first.fail("nodes/node_1", lasts=None)
    first.until(120)
    first.close()
    second = Flown(tmp_path, boot="boot0002", start=220.0)
    second.until(320)
    second.close()
    made = report(tmp_path)
    agent = made["agents"][0]
    assert [run["boot_id"] for run in agent["runs"]] == ["boot0001", "boot0002"]
    assert agent["down"] == [[T0 + 120, T0 + 220]]
    assert agent["uptime"] == pytest.approx(1 - 100 / 320, abs=1e-5)
    assert len(made["faults"]) == 1


def test_files_may_be_rotated_compressed_twice_there_and_in_any_folder(tmp_path: Path) -> None:
    """A copy of a file does not count twice, and no file has to have its place."""
    log = one_flight(tmp_path / "a").close()
    expected = report(tmp_path)
    lines = log.read_bytes().splitlines(keepends=True)
    half = len(lines) // 2
    (log.parent / "phm.jsonl.1.gz").write_bytes(gzip.compress(b"".join(lines[:half])))
    log.write_bytes(b"".join(lines[half:]))
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "phm.jsonl.1").write_bytes(b"".join(lines[:half]))
    made = report(tmp_path)
    assert {key: made[key] for key in ("faults", "availability", "checks", "agents")} == {
        key: expected[key] for key in ("faults", "availability", "checks", "agents")
    }
    assert [problem["what"] for problem in made["files"]["problems"]] == [
        "begins with the same line as another file, so it is a copy and was left out"
    ]


def test_missing_lines_are_counted_by_their_numbers(tmp_path: Path) -> None:
    """A file that is gone shows as a gap of the sequence numbers."""
    log = one_flight(tmp_path).close()
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[:30] + lines[41:]))
    assert report(tmp_path)["agents"][0]["missing_lines"] == 11


def test_lines_that_the_log_counts_as_lost_are_not_missing_as_well(tmp_path: Path) -> None:
    """An event `lost` replaces the last of its lines, and explains the gap before it."""
    log = one_flight(tmp_path).close()
    lines = log.read_bytes().splitlines(keepends=True)
    last = json.loads(lines[40])
    kept = {key: last[key] for key in ("v", "agent", "agent_id", "boot_id", "seq", "mono", "utc", "utc_s")}
    lost = json.dumps({**kept, "event": "lost", "kind": "PHM", "lines": 11, "reason": "disk full"}).encode() + b"\n"
    log.write_bytes(b"".join([*lines[:30], lost, *lines[41:]]))
    agent = report(tmp_path)["agents"][0]
    assert (agent["lost_lines"], agent["missing_lines"]) == (11, 0)


def test_unknown_times_of_a_unit_are_listed_with_their_cause(tmp_path: Path) -> None:
    """STALE because of a fault is another thing than not known at all."""
    made = Flown(tmp_path)
    made.until(40)
    state = made._state("rates/topic_1", Level.STALE, "no answer")
    made.log.handle(Transition(made.at, Level.OK, state))
    made.until(60)
    made.log.handle(Transition(made.at, Level.STALE, made._state("rates/topic_1", Level.OK)))
    made.until(100)
    made.close()
    assert report(tmp_path)["unknown"] == [
        {"agent": "agent_1", "unit": "rates/topic_1", "blocked_s": 0.0, "unknown_s": 20.0}
    ]


def test_table_2_of_the_paper_is_made_of_inject_notes(tmp_path: Path) -> None:
    """Detection is until the response is logged, response until the next report, as in the campaign."""
    made = Flown(tmp_path)
    made.until(45)
    made.note("INJECT kill node_1")
    made.until(46, every=100)
    made.fail("nodes/node_1", lasts=3.0)
    made.until(100)
    made.note("INJECT stop ros_app")
    made.until(200)
    made.close()
    table = report(tmp_path)["injection_metrics"]
    assert (table["injected"], table["detected"], table["self_resolved"]) == (2, 1, 0.5)
    assert (table["first_alarm_s"], table["detection_s"]) == (1.0, 4.0)
    assert table["response_s"] == pytest.approx(24.0)
    assert table["phm_uptime"] == 1.0


def test_an_agent_without_a_log_is_shown_as_the_ground_received_it(tmp_path: Path) -> None:
    """Its levels, its link gaps and its arming are those of the ground's record."""
    ground = Ground(tmp_path / "ground.jsonl")
    ground.event(0, "slots", agent=7, name="A07", word=1, state="ACTIVE", slots={"2": "OK", "6": None}, changed={})
    ground.event(1, "autopilot", system=7, presence="alive", armed=False, mode=5, state="ACTIVE", age_s=0.0)
    ground.event(30, "autopilot", system=7, presence="alive", armed=True, mode=5, state="ACTIVE", age_s=0.0)
    ground.event(40, "slots", agent=7, name="A07", word=1, state="ACTIVE", slots={"2": "ERROR"}, changed={})
    ground.event(60, "presence", agent=7, name="A07", presence="lost", was="alive", silent_s=6.0)
    ground.event(80, "presence", agent=7, name="A07", presence="alive", was="lost", silent_s=None)
    ground.event(90, "slots", agent=7, name="A07", word=1, state="ACTIVE", slots={"2": "OK"}, changed={})
    ground.event(100, "end")
    ground.close()
    agent = report(tmp_path)["agents"][0]
    assert (agent["agent"], agent["logged"], agent["uptime"]) == ("A07", False, None)
    assert agent["link_gaps"] == [[T0 + 54, T0 + 80]]
    assert agent["armed"] == [[T0 + 30, T0 + 100]]
    assert agent["levels"] == [
        [T0, T0 + 40, "OK"],
        [T0 + 40, T0 + 54, "ERROR"],
        [T0 + 80, T0 + 90, "ERROR"],
        [T0 + 90, T0 + 100, "OK"],
    ]


def test_the_document_is_json(tmp_path: Path) -> None:
    """Nothing in it needs more than JSON has."""
    one_flight(tmp_path).close()
    made = report(tmp_path)
    assert json.loads(json.dumps(made, allow_nan=False)) == made
    assert made["report"] == 1


def test_the_cost_of_phm_is_the_difference_of_its_counters(tmp_path: Path) -> None:
    """CPU time and bytes count from the start of PHM, over reloads; memory is the most that was used."""
    line = {"v": 2, "agent": "a", "agent_id": 1, "boot_id": "b", "kind": "PHM", "event": "cost"}
    with open(tmp_path / "phm.jsonl", "w") as file:
        for seq, (mono, cpu_s, memory, sent) in enumerate(
            [(10, 5.0, 70, 100), (60, 6.0, 90, 250), (110, 8.0, 80, 600)]
        ):
            cost = {"cpu_s": cpu_s, "memory_bytes": memory, "sent_bytes": {"ground": sent, "peers": sent}}
            file.write(json.dumps({**line, "seq": seq + 1, "mono": mono, "utc_s": T0 + mono, **cost}) + "\n")
    (row,) = report(tmp_path)["phm"]["agents"]
    assert (row["cpu_percent"], row["memory_bytes"], row["sent_bytes"]) == (3.0, 90, 1000)
