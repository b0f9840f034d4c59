"""With `--flight` PHM's own figures are those of the flight, and what the record cannot say of a part of it is not known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Note
from phm.review import page, table_rows
from phm.review.cost import MOST, Cost
from phm.runtime.reloader import ReloadOutcome
from tests.review.records import T0, Ground, flown, report

LINE = {"v": 2, "agent": "agent_1", "agent_id": 1, "boot_id": "b", "kind": "PHM"}
CALM, BUSY = 0.01, 0.5
"""CPU seconds per second on the ground and in flight."""


def recorded(path: Path) -> None:
    """From 0 to 1000 s with a report and a cost every 20 s; armed from 400 to 600 s, when all costs more."""
    cpu_s, sent, lines = 0.0, 0, list[dict[str, Any]]()
    for at in range(0, 1001, 20):
        flying = 400 < at <= 600
        cpu_s, sent = cpu_s + 20 * (BUSY if flying else CALM), sent + (2000 if flying else 20)
        lines.append({"event": "report", "number": at, "took_s": 2.0 if flying else 0.1, "at": at})
        memory = 90_000_000 if flying else 40_000_000
        lines.append(
            {"event": "cost", "cpu_s": cpu_s, "memory_bytes": memory, "sent_bytes": {"ground": sent}, "at": at}
        )
        if at in (400, 600):
            duration = {} if at == 400 else {"duration_s": 200.0}
            lines.append({"event": "flight", "number": 1, "began": at == 400, "at": at, **duration})
    with path.open("w") as file:
        for seq, line in enumerate(lines, 1):
            at = line.pop("at")
            file.write(json.dumps({**LINE, "seq": seq, "mono": 50.0 + at, "utc_s": T0 + at, **line}) + "\n")


def test_cost_and_reports_of_a_flight_are_those_of_the_flight(tmp_path: Path) -> None:
    """The margin of 2 s on both sides is calm: its share is interpolated."""
    recorded(tmp_path / "phm.jsonl")
    (whole,), (flight,) = report(tmp_path)["phm"]["agents"], report(tmp_path, flight=1)["phm"]["agents"]
    expected = 100 * (200 * BUSY + 4 * CALM) / 204
    assert flight["cpu_percent"] == pytest.approx(expected, abs=0.01)
    assert flight["sent_bytes"] == 10 * 2000 + 4
    assert (flight["reports"], flight["report_longest_s"]) == (11, 2.0)
    assert flight["report_mean_s"] == pytest.approx((10 * 2.0 + 0.1) / 11, abs=1e-4)
    assert flight["memory_bytes"] == 90_000_000
    assert whole["cpu_percent"] == pytest.approx(100 * (200 * BUSY + 800 * CALM) / 1000)
    assert (whole["sent_bytes"], whole["reports"]) == (10 * 2000 + 40 * 20, 51)


def test_the_most_memory_of_a_flight_is_not_that_of_another_time(tmp_path: Path) -> None:
    """Neither what PHM needed before the flight nor after it counts."""
    recorded(tmp_path / "phm.jsonl")
    text = (tmp_path / "phm.jsonl").read_text().splitlines()
    first = json.loads(text[1])
    text[1] = json.dumps({**first, "memory_bytes": 500_000_000})
    (tmp_path / "phm.jsonl").write_text("\n".join(text) + "\n")
    assert report(tmp_path)["phm"]["agents"][0]["memory_bytes"] == 500_000_000
    assert report(tmp_path, flight=1)["phm"]["agents"][0]["memory_bytes"] == 90_000_000


def test_text_bytes_of_a_flight_are_those_that_the_ground_received_in_it(tmp_path: Path) -> None:
    """Lines before and after do not count; each has its four bytes of MAVLink fields, as in the whole record."""
    recorded(tmp_path / "phm.jsonl")
    ground = Ground(tmp_path / "ground.jsonl")
    for at in (100, 500, 550, 900):
        ground.text(at, 1, 6, "node_1 dead")
    ground.close()
    size = len("A01 FAIL 6 node_1 dead") + 4
    assert report(tmp_path)["phm"]["agents"][0]["text_bytes"] == 4 * size
    assert report(tmp_path, flight=1)["phm"]["agents"][0]["text_bytes"] == 2 * size


def test_figures_that_the_record_of_a_flight_lacks_are_unknown(tmp_path: Path) -> None:
    """A log without cost, and times of checks, which are sums of whole runs; the page says so in words."""
    recorded(tmp_path / "phm.jsonl")
    kept = [line for line in (tmp_path / "phm.jsonl").read_text().splitlines() if '"cost"' not in line]
    (tmp_path / "phm.jsonl").write_text("\n".join(kept) + "\n")
    made = report(tmp_path, flight=1)
    (row,) = made["phm"]["agents"]
    unknown = ("cpu_percent", "memory_bytes", "sent_bytes", "check_mean_ms", "text_bytes")
    assert [row[key] for key in unknown] == [None] * 5
    assert "not known" in page.render(made)


def test_a_reload_of_the_configuration_is_not_a_restart(tmp_path: Path) -> None:
    """It begins a run, too, whose log says so. A reload that changes nothing begins none, and one that was refused neither."""
    nothing, refused = ReloadOutcome(True, restart=("mavlink",)), ReloadOutcome(False, why="an action is in progress")
    for place, outcome in enumerate((None, ReloadOutcome(True, ("log",), ("mavlink",)), nothing, refused, None)):
        with flown(tmp_path, boot=f"boot000{place}", start=200.0 * place) as made:
            if outcome is not None:
                made.log.handle(Note(made.at, "PHM", outcome.text()))
            made.until(200.0 * place + 100)
    (row,) = report(tmp_path)["phm"]["agents"]
    assert (row["restarts"], row["reloads"]) == (3, 1)
    assert table_rows.phm(row)[2:4] == ("3", "1")


def test_samples_of_the_cost_are_limited_and_totals_stay_right() -> None:
    """A run of weeks keeps as many samples as one of hours, in one piece or in merged ones."""
    parts = [Cost() for _ in range(4)]
    for number in range(40_000):
        parts[number // 10_000].add(number * 20.0, number * 1.0, number * 100, 999 if number == 20_001 else 5)
    whole = Cost()
    for part in parts:
        whole.merge(part)
    assert len(whole.samples) <= MOST
    seconds, cpu_s, sent = whole.between(100_000.0, 500_000.0) or (0.0, 0.0, 0.0)
    assert seconds == 400_000.0 and cpu_s == pytest.approx(20_000.0) and sent == pytest.approx(2_000_000)
    assert whole.memory(0.0, 1e9) == 999
    assert whole.between(1e6, 2e6) is None and Cost().between(0.0, 1.0) is None


def test_the_most_memory_is_kept_whichever_sample_has_it() -> None:
    """Samples are thinned as soon as there is one too many: none of them may lose its memory."""
    for peak in (0, 1, MOST // 2, MOST - 2, MOST - 1, MOST):
        cost = Cost()
        for number in range(MOST + 1):
            cost.add(number * 20.0, number * 1.0, number * 100, 999 if number == peak else 5)
        assert len(cost.samples) <= MOST and cost.memory(0.0, 1e9) == 999, peak


def test_a_flight_has_the_versions_and_runs_that_were_in_it(tmp_path: Path) -> None:
    """PHM was updated between two flights."""
    for number in range(2):
        with flown(tmp_path, boot=f"boot000{number}", start=1000.0 * number) as made:
            made.arm(True)
            made.until(1000.0 * number + 100)
            made.arm(False)
            made.until(1000.0 * number + 200)
    log = tmp_path / "phm.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    starts = [place for place, line in enumerate(lines) if '"event":"start"' in line]
    lines[starts[0]] = json.dumps({**json.loads(lines[starts[0]]), "version": "0.0.1"}) + "\n"
    log.write_text("".join(lines))
    new = json.loads(lines[starts[1]])["version"]
    found = [report(tmp_path, flight=flight)["agents"][0] for flight in (1, 2, None)]
    assert [row["versions"] for row in found] == [["0.0.1"], [new], ["0.0.1", new]]
    assert [[run["boot_id"][-1] for run in row["runs"]] for row in found] == [["0"], ["1"], ["0", "1"]]


@pytest.mark.parametrize("armed", [False, True])
@pytest.mark.parametrize(("boots", "known"), [(("m1", "m2"), True), (("m1", "m1"), False), (("m1", ""), False)])
def test_the_time_in_which_the_computer_was_off_is_not_one_in_which_phm_did_not_run(
    tmp_path: Path, armed: bool, boots: tuple[str, str], known: bool
) -> None:
    """Only between two known starts of the machine, and not in flight: then the computer was lost."""
    for number, machine_boot in enumerate(boots):
        start = 1000.0 * number
        with flown(tmp_path, boot=f"boot000{number}", start=start, machine_boot=machine_boot) as made:
            made.arm(armed and number == 0)
            made.until(start + 100)
    (agent,) = report(tmp_path)["agents"]
    assert agent["uptime"] == (1.0 if known and not armed else pytest.approx(200 / 1100, abs=1e-5))
    assert agent["down"] == [[T0 + 100, T0 + 1000]]
