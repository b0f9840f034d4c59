"""Numbers of the report against the same numbers counted by hand, where a record is not as tidy as usual."""

from __future__ import annotations

import gzip
import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli.report import command
from phm.core.model import Level
from phm.review import comparison
from tests.review.records import T0, Flown, report


def flight(folder: Path, faults: int = 0, boot: str = "boot0001") -> Path:
    """2000 s with this many faults of one unit."""
    made = Flown(folder, boot=boot)
    for _ in range(faults):
        made.until(made.now + 50)
        made.fail("nodes/node_1")
    made.until(2000)
    made.report()
    made.close()
    return folder


def test_a_record_without_any_fault_was_observed_all_the_same(tmp_path: Path) -> None:
    """Twenty faults against none in the same time are no chance, for the unit as for its check."""
    made = comparison.build(report(flight(tmp_path / "a", 20)), report(flight(tmp_path / "b")))
    for row in (made["checks"][0], made["faults"][0]):
        assert (row["verdict"], row["observed_s"], row["chance"]) == ("gone", [2000.0, 2000.0], False)
        assert row["probability"] == pytest.approx(2 * 0.5**20, abs=1e-6)


def test_a_check_that_one_record_does_not_have_was_not_observed_there(tmp_path: Path) -> None:
    """Its faults have no rate there to be compared with."""
    second = flight(tmp_path / "b") / "phm.jsonl"
    second.write_text("".join(line for line in second.read_text().splitlines(True) if '"nodes' not in line))
    row = comparison.build(report(flight(tmp_path / "a", 20)), report(second))["checks"][0]
    assert (row["check"], row["observed_s"], row["probability"], row["chance"]) == ("nodes", [2000.0, 0.0], None, True)


def test_an_agent_that_was_stopped_after_it_disarmed_was_not_lost(tmp_path: Path) -> None:
    """Only a log that ends while the autopilot is armed counts as not running from there on."""
    for number, disarms in ((1, True), (2, False)):
        made = Flown(tmp_path / str(number), number)
        made.arm(True)
        made.until(200)
        if disarms:
            made.arm(False)
        made.report()
        made.close()
    other = Flown(tmp_path / "3", 3)
    other.until(400)
    other.close()
    assert [agent["uptime"] for agent in report(tmp_path)["agents"]] == [1.0, 0.5, 1.0]


def test_a_fault_that_is_open_over_two_flights_counts_in_the_one_in_which_it_opened(tmp_path: Path) -> None:
    """It is listed in both, and MTBF of the second one is not made worse."""
    made = Flown(tmp_path)
    made.until(50)
    made.arm(True)
    made.until(80)
    made.fail("nodes/node_1", lasts=None)
    made.until(100)
    made.arm(False)
    made.until(200)
    made.arm(True)
    made.until(300)
    made.arm(False)
    made.until(320)
    made.report()
    made.close()
    first, second = (report(tmp_path, flight=number) for number in (1, 2))
    assert [len(each["faults"]) for each in (first, second)] == [1, 1]
    assert [sum(row["faults"] for row in each["checks"]) for each in (first, second)] == [1, 0]
    assert [each["agents"][0]["faults"] for each in (first, second)] == [1, 0]
    assert second["sentences"][1] == "No fault opened."


def over_the_landing(folder: Path) -> None:
    """Armed from 100 to 200 s; node_1 fails at 150 s and is OK again at 230 s."""
    made = Flown(folder)
    made.until(100)
    made.arm(True)
    made.until(150)
    made.fail("nodes/node_1", lasts=None)
    made.until(200)
    made.arm(False)
    made.until(230)
    log = made.close()
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    opened = next(line for line in lines if line["event"] == "fault_opened")
    ended = {"event": "fault_closed", "outcome": "resolved", "by": "restart", "duration_s": 80.0}
    times = {"seq": lines[-1]["seq"] + 1, "mono": opened["mono"] + 80, "utc_s": opened["utc_s"] + 80}
    failed = next(line for line in lines if line["event"] == "transition" and line["level"] == "ERROR")
    with log.open("a") as file:
        file.write(json.dumps({**opened, **times, **ended}) + "\n")
        file.write(json.dumps({**failed, **times, "seq": times["seq"] + 1, "old": "ERROR", "level": "OK"}) + "\n")


def test_a_fault_that_ended_after_the_flight_was_open_at_its_end(tmp_path: Path) -> None:
    """It did not recover in the flight. In the whole record it did."""
    over_the_landing(tmp_path)
    flown, whole = report(tmp_path, flight=1), report(tmp_path)
    assert flown["sentences"][1:3] == [
        "There was 1 fault: 0 ended by an action of PHM and 0 otherwise.",
        "1 fault was open at the end (agent_1 nodes/node_1 gone), and PHM gave up on 0.",
    ]
    assert flown["sentences"][4] == "Before the next flight, on agent_1 (nodes/node_1): restart it and check its log."
    for made, expected in (
        (flown, ("open", None, "", 80.0, 0, None)),
        (whole, ("resolved", T0 + 230, "restart", 80.0, 1, 80.0)),
    ):
        fault, check = made["faults"][0], next(row for row in made["checks"] if row["check"] == "nodes")
        ended = (fault["outcome"], fault["closed"], fault["by"], fault["lasted_s"])
        assert (*ended, check["resolved"], check["mttr_s"]) == expected
    assert whole["sentences"][2] == "No fault was open at the end, and PHM gave up on none."


@pytest.mark.parametrize("source", ["flight", "autopilot", "silent"])
def test_a_flight_that_a_loss_of_power_cut_ends_with_its_log(tmp_path: Path, source: str) -> None:
    """The computer is on again a day later, disarmed, or without an autopilot; what another agent flew in between is its own flight."""
    first = Flown(tmp_path / "1", boot="boot0001", machine_boot="m1")
    first.until(100)
    first.arm(False)
    first.arm(True)
    first.until(400)
    first.report()
    logs = [first.close()]
    second = Flown(tmp_path / "1", boot="boot0002", machine_boot="m2", start=86_400, mono=-86_300)
    second.until(86_420)
    if source != "silent":
        second.arm(False)
    second.until(86_600)
    logs.append(second.close())
    if source == "autopilot":
        for log in logs:
            said = {"check": "autopilot", "unit": "autopilot", "event": "unit", "slot": 8, "level": "OK"}
            text = [json.loads(line) for line in log.read_text().splitlines()]
            for line in text:
                if line["event"] == "flight":
                    line.update(said, values={"armed": line["began"]})
            log.write_text("".join(json.dumps(line) + "\n" for line in text))
    other = Flown(tmp_path / "2", 2, boot="boot0003", start=50_000, mono=-49_900)
    other.until(50_100)
    other.arm(True)
    other.until(50_400)
    other.arm(False)
    other.close()
    made = report(tmp_path)
    assert [(one["begin"] - T0, one["end"] - T0, one["agents"]) for one in made["flights"]] == [
        (100.0, 400.0, ["agent_1"]),
        (50_100.0, 50_400.0, ["agent_2"]),
    ]


def test_a_restart_of_phm_in_flight_does_not_end_the_flight(tmp_path: Path) -> None:
    """The next run that knows the autopilot continues it; one in between was too short to know it."""
    first = Flown(tmp_path, boot="boot0001")
    first.until(100)
    first.arm(True)
    first.until(200)
    first.close()
    Flown(tmp_path, boot="boot0002", start=210).close()
    third = Flown(tmp_path, boot="boot0003", start=220)
    third.arm(True)
    third.until(300)
    third.arm(False)
    third.until(320)
    third.close()
    assert [(one["begin"] - T0, one["end"] - T0) for one in report(tmp_path)["flights"]] == [(100.0, 300.0)]


def test_an_arming_in_the_last_line_before_a_loss_of_power_is_not_a_flight(tmp_path: Path) -> None:
    """Nothing is known of how long it lasted, and the next start of the computer does not end it."""
    first = Flown(tmp_path, boot="boot0001", machine_boot="m1")
    first.until(100)
    first.arm(True)
    first.close()
    second = Flown(tmp_path, boot="boot0002", machine_boot="m2", start=86_400)
    second.arm(False)
    second.until(86_500)
    second.close()
    made = report(tmp_path)
    assert (made["flights"], made["agents"][0]["armed_s"]) == ([], 0.0)


def test_without_the_line_start_the_interval_is_that_of_the_reports(tmp_path: Path) -> None:
    """The oldest file was rotated away, and reports are a minute apart: PHM ran between them."""
    made = Flown(tmp_path)
    made.until(3600, every=60)
    log = made.close()
    lines = [line for line in log.read_text().splitlines(True) if '"event":"start"' not in line]
    assert len(lines) == len(log.read_text().splitlines()) - 1
    log.write_text("".join(lines[3:]))
    whole = report(tmp_path)
    assert (whole["agents"][0]["uptime"], whole["agents"][0]["down"]) == (1.0, [])
    assert {row["observed_s"] for row in whole["checks"]} == {3540.0}
    log.write_text("".join(lines[3 : len(lines) // 2] + lines[len(lines) * 3 // 4 :]))
    assert len(report(tmp_path)["agents"][0]["down"]) == 1


def test_a_fault_that_the_next_run_does_not_know_has_ended(tmp_path: Path) -> None:
    """PHM was restarted without its state, and the unit is OK: the fault ended at an unknown time."""
    first = Flown(tmp_path)
    first.until(100)
    first.fail("nodes/node_1", lasts=None)
    first.until(140)
    first.close()
    second = Flown(tmp_path, boot="boot0002", start=200)
    second.until(600)
    second.close()
    made = report(tmp_path)
    fault = made["faults"][0]
    assert (fault["outcome"], fault["lasted_s"]) == ("unknown", 40.0)
    assert made["sentences"][2] == "No fault was open at the end, and PHM gave up on none."
    nodes = next(row for row in made["checks"] if row["check"] == "nodes")
    assert (nodes["faults"], nodes["resolved"], nodes["mttr_s"]) == (1, 0, None)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")])
def test_of_two_copies_the_longer_one_is_read(tmp_path: Path, names: tuple[str, str], packed: bool) -> None:
    """A log that was copied while it grew hides nothing of what came later, in whatever order they are found."""
    made = Flown(tmp_path / names[0])
    made.until(100)
    made.fail("nodes/node_1")
    made.until(200)
    copy = tmp_path / names[1]
    copy.mkdir()
    shutil.copy(tmp_path / names[0] / "phm.jsonl", copy)
    made.fail("nodes/node_1")
    made.until(400)
    log = made.close()
    if packed:
        log.with_name("phm.jsonl.1.gz").write_bytes(gzip.compress(log.read_bytes()))
        log.unlink()
    assert len(report(tmp_path)["faults"]) == 2


def test_lines_that_come_twice_count_once(tmp_path: Path) -> None:
    """Also reports, and the time that they took."""
    log = flight(tmp_path, 2) / "phm.jsonl"
    expected = report(tmp_path)["phm"]["agents"]
    log.write_text("".join(line + line for line in log.read_text().splitlines(True)))
    assert report(tmp_path)["phm"]["agents"] == expected


def test_an_injection_into_node_10_is_not_one_into_node_1(tmp_path: Path) -> None:
    """A name is found in the note as a whole."""
    made = Flown(tmp_path)
    made.until(50)
    made.note("INJECT kill node_10")
    made.fail("nodes/node_1")
    made.states["nodes/node_10"] = made._state("nodes/node_10", Level.OK)
    right = made.fail("nodes/node_10")
    made.until(100)
    made.close()
    assert [one["fault"] for one in report(tmp_path)["injection_metrics"]["injections"]] == [right]


@pytest.mark.extras
def test_agents_whose_names_are_not_for_paths_do_not_replace_each_other_in_a_dataset(tmp_path: Path) -> None:
    """The time of both is in it."""
    for number, name in ((1, "\u00c4"), (2, "\u00d6")):
        log = flight(tmp_path / "logs" / str(number), boot=f"boot000{number}") / "phm.jsonl"
        log.write_text(log.read_text().replace('"agent":"agent_1"', f'"agent":"{name}"'))
    result = CliRunner().invoke(command, [str(tmp_path / "logs"), "--parquet", str(tmp_path / "set"), "--json"])
    assert {row["observed_s"] for row in json.loads(result.output)["dataset"]["checks"]} == {4000.0}


@pytest.mark.extras
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("slot", "5000000000"),
        ("slot", "9" * 30),
        ("attempt", "99999999999"),
        ("took_s", "1e308"),
        ("duration_ms", "1.7e308"),
        ("hz", "1.7e308"),
    ],
)
def test_numbers_that_cannot_be_do_not_stop_any_output(tmp_path: Path, key: str, value: str) -> None:
    """The page, the dataset and JSON are written, and the JSON has numbers only."""
    log = flight(tmp_path / "log", 2) / "phm.jsonl"
    text, count = re.subn(rf'"{key}":[-\d.e]+', f'"{key}":{value}', log.read_text())
    assert count > 1
    log.write_text(text)
    options = ["--json", "--parquet", str(tmp_path / "set"), "--html", str(tmp_path / "page.html")]
    result = CliRunner().invoke(command, [str(tmp_path / "log"), *options])
    assert result.exit_code == 0, result.output
    assert not re.search(r"\b(?:Infinity|NaN)\b", result.output)
