"""The figures of a soak, from recorded samples and runs."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from phm.core.trend import line
from sitl.campaign.trial import ABORTED, NOMINAL, Trial, to_json
from sitl.faults import all_faults
from sitl.soak import report
from sitl.soak.alarms import count
from sitl.soak.main import main
from sitl.soak.process_tree import Wakeups, descriptors, memory_mb, tree
from sitl.soak.runner import draws, load as load_runs, soak_faults
from sitl.soak.sample import Sample, from_json, load, to_json as sample_to_json
from sitl.soak.slopes import MEASUREMENTS, Row, restarts, rows
from tests.fakes.campaign_trials import alarm, injection, trial

SETTING = {
    "seconds": 7200.0,
    "every_s": 600.0,
    "period_s": 10.0,
    "agents": 2,
    "seed": 1,
    "commit": "0123abc",
    "machine": "x86_64, 2 cores",
    "profile": "shipped",
}
PERIOD_S = 10.0


def sample(agent: int, at_s: float, run: str = "1/7", memory_mb: float = 60.0, wakeups: int = 0) -> Sample:
    return Sample(1000 + at_s, 1e9 + at_s, agent, run, memory_mb + 10, memory_mb, 20, 9, at_s / 100, wakeups, 1000)


def samples(memory: Callable[[int, float], float], hours: float = 2.0, agents: int = 2) -> list[Sample]:
    """Of two hours; memory: of an agent at a time, in MB."""
    times = [place * PERIOD_S for place in range(int(hours * 3600 / PERIOD_S))]
    return [
        sample(agent, at_s, memory_mb=memory(agent, at_s), wakeups=int(5 * at_s))
        for at_s in times
        for agent in range(1, agents + 1)
    ]


def noise(size: float) -> Callable[[], float]:
    draw = random.Random(3)
    return lambda: draw.gauss(0, size)


def row(name: str, found: list[Row]) -> Row:
    return next(each for each in found if each.measurement.name == name)


def test_a_leak_is_found_with_its_rate_and_its_agent() -> None:
    """0.5 MB an hour in one of two agents, in noise of 0.1 MB; what is constant has no trend."""
    more = noise(0.1)
    found = rows(samples(lambda agent, at_s: 60 + (0.5 * at_s / 3600 if agent == 2 else 0) + more()))
    private = row("memory, private", found)
    assert private.of[2].slope == pytest.approx(0.5, abs=0.1) and private.of[2].verdict == "grows"
    assert private.all.slope == pytest.approx(0.25, abs=0.08) and private.worst == 2
    assert private.of[1].low is not None and private.of[1].low < 0.1
    assert (row("threads", found).all.slope, row("threads", found).all.verdict) == (0.0, "no trend")


def test_a_counter_is_shown_as_a_rate() -> None:
    """CPU of 1 % of a core and five wake-ups a second, without a trend."""
    found = rows(samples(lambda agent, at_s: 60.0))
    assert row("CPU", found).all.mean == pytest.approx(1.0, rel=0.01)
    assert row("wake-ups", found).all.mean == pytest.approx(5.0, rel=0.01)
    assert row("CPU", found).all.slope == pytest.approx(0.0, abs=1e-6)


def test_the_start_of_a_program_is_not_a_leak() -> None:
    """Growth in its first minutes is not counted."""
    found = rows(samples(lambda agent, at_s: 60 + 20 * min(1.0, at_s / 300)))
    assert row("memory, private", found).all.verdict == "no trend"


def test_a_restart_does_not_hide_a_leak() -> None:
    """The slope is that of the longest run; restarts are counted."""
    taken = [
        sample(
            1, at_s, run="1/7" if at_s < 1800 else "1/9", memory_mb=60 + (at_s % 1800 if at_s < 1800 else at_s) / 3600
        )
        for at_s in (place * PERIOD_S for place in range(720))
    ]
    assert row("memory, private", rows(taken)).all.slope == pytest.approx(1.0, rel=0.01)
    assert restarts(taken) == 1


def test_few_samples_have_no_slope() -> None:
    """A soak that was interrupted immediately says so, and one without samples has a report, too."""
    few = samples(lambda agent, at_s: 60.0, hours=0.01)
    assert {each.all.verdict for each in rows(few)} == {"too short"}
    for taken in ([], few):
        found = report.document(taken, [], SETTING)
        assert len(report.table(found)) == len(MEASUREMENTS) and "NOT COMPLETE" in report.sentences(found)[0]


def test_a_line_has_its_slope_within_its_interval() -> None:
    """Of points on a line the interval is that slope; of too few there is none."""
    found = line([(float(at), 3.0 * at + 1) for at in range(20)])
    assert found is not None and (found.low, found.slope, found.high) == pytest.approx((3.0, 3.0, 3.0))
    assert line([(0.0, 1.0), (1.0, 2.0)]) is None


def quiet(seconds: float, agents: int = 8, **more: object) -> Trial:
    made = Trial(NOMINAL, 0, agents, began=100.0, utc=0.0, ended=100.0 + seconds)
    for name, value in more.items():
        setattr(made, name, value)
    return made


def test_false_alarms_are_counted_per_agent_hour() -> None:
    """All alarms of quiet runs, of interrupted ones too; those of injected faults are not false."""
    one = alarm(50.0, "nodes/x", agent=2)
    cut = quiet(900, kind=ABORTED, alarms=[one])
    found = count([quiet(1800), cut, trial(injections=[injection()])])
    hours = (8 * 2700 + trial().agents * trial().seconds) / 3600
    assert (found.false, found.injected, found.not_seen) == (1, 1, ())
    assert found.per_agent_hour == pytest.approx(1 / hours)
    assert found.low < 1 / hours < found.high
    assert "A02 nodes/x" in found.listed[0] and "nothing injected" in found.listed[0]


def test_a_fault_that_an_interrupt_cut_short_is_not_missed() -> None:
    """Its run is observed time, but it says nothing about detection."""
    cut = trial(kind=ABORTED, injections=[injection()], alarms=[])
    assert count([trial(injections=[injection()], alarms=[])]).missed == 1
    found = count([cut])
    assert (found.injected, found.missed, found.agent_hours > 0) == (0, 0, True)


def test_few_hours_without_an_alarm_have_an_upper_limit() -> None:
    """The upper limit is that of Poisson's distribution: 3.69 events when none was seen."""
    found = count([quiet(3600)])
    assert (found.false, found.low) == (0, 0.0) and found.high == pytest.approx(3.689 / 8, rel=0.001)
    assert count([]).per_agent_hour is None


def test_only_faults_that_leave_phm_running_are_injected() -> None:
    """None of PHM itself, of its configuration or of the whole machine; each once before one comes again."""
    names = soak_faults(all_faults(), 8)
    assert not names.keys() & {
        "phm_killed",
        "phm_stopped",
        "power_loss",
        "engine_restarted",
        "cpu_hog",
        "clock_stepped",
    }
    assert {"node_killed", "container_killed", "gcs_radio_cut"} <= names.keys()
    drawn = list(itertools.islice(draws(names, 8, 5), 2 * len(names)))
    assert sorted(each.fault for each in drawn[: len(names)]) == sorted(names)
    assert drawn == list(itertools.islice(draws(names, 8, 5), 2 * len(names)))
    assert {each.agent for each in drawn} <= set(range(1, 9))


def test_samples_and_runs_are_read_as_written_and_torn_lines_are_skipped(tmp_path: Path) -> None:
    """A kill in the middle of a line loses that line alone."""
    file, runs = tmp_path / "samples.jsonl", tmp_path / "runs.jsonl"
    file.write_text(
        f"{sample_to_json(sample(1, 0.0))}\n" + '{"mono": 3, "ag\n' + sample_to_json(sample(2, 1.0)), "ascii"
    )
    assert load(file) == [sample(1, 0.0), sample(2, 1.0)]
    runs.write_text(f'{to_json(quiet(5))}\n{{"v"\n{to_json(quiet(6))}\n', "ascii")
    assert [each.seconds for each in load_runs(runs)] == [5, 6]
    assert load(tmp_path / "none") == [] and load_runs(tmp_path / "none") == []


@pytest.mark.parametrize(
    "line", ["7", "{", "{}", '{"mono": "x"}', sample_to_json(sample(1, 0)).replace('"1/7"', "null")]
)
def test_an_invalid_sample_is_rejected(line: str) -> None:
    """ValueError for any content."""
    with pytest.raises(ValueError):
        from_json(line)


def process(proc: Path, pid: int, parent: int, name: str, switches: dict[int, int]) -> None:
    """What /proc has of a process."""
    folder = proc / str(pid)
    (folder / "fd").mkdir(parents=True, exist_ok=True)
    (folder / "fd" / "0").touch()
    (folder / "comm").write_text(f"{name}\n")
    (folder / "stat").write_text(f"{pid} ({name}) ) S {parent} 1 1 0\n")
    (folder / "smaps_rollup").write_text(
        "0 r\nRss: 2000 kB\nPrivate_Clean: 100 kB\nPrivate_Dirty: 400 kB\n".replace("0 r\n", "")
    )
    for thread, made in switches.items():
        (folder / "task" / str(thread)).mkdir(parents=True, exist_ok=True)
        (folder / "task" / str(thread) / "status").write_text(f"Name:\tx\nvoluntary_ctxt_switches:\t{made}\n")


def test_a_health_check_is_not_counted_as_phm(tmp_path: Path) -> None:
    """It is in the container, and no descendant of its first process."""
    process(tmp_path, 50, 1, "tini", {50: 1})
    process(tmp_path, 60, 50, "python", {60: 10, 61: 5})
    process(tmp_path, 70, 60, "python", {70: 0})
    process(tmp_path, 80, 1, "phm health", {80: 9})
    found = tree(50, [50, 60, 70, 80], tmp_path)
    assert (list(found.pids), found.daemon) == ([50, 60, 70], "50/60")
    assert memory_mb(found.pids, tmp_path) == pytest.approx((3 * 2000 * 1024 / 1e6, 3 * 500 * 1024 / 1e6))
    assert descriptors(found.pids, tmp_path) == 3
    with pytest.raises(LookupError, match="has ended"):
        tree(51, [60], tmp_path)


def test_wakeups_never_fall_when_a_thread_ends(tmp_path: Path) -> None:
    """A new thread counts from its start; the first count begins at 0."""
    process(tmp_path, 60, 1, "python", {60: 10, 61: 500})
    meter = Wakeups()
    assert (meter.take([60], tmp_path), meter.total) == (2, 0)
    process(tmp_path, 60, 1, "python", {60: 15, 62: 3})
    (tmp_path / "60" / "task" / "61" / "status").unlink()
    assert (meter.take([60], tmp_path), meter.total) == (2, 8)


def test_the_report_is_made_again_from_the_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--report-only writes page and document of an interrupted soak, and its exit code says that it is not complete."""
    taken = samples(lambda agent, at_s: 60 + at_s / 3600, hours=0.5)
    (tmp_path / "samples.jsonl").write_text("".join(f"{sample_to_json(each)}\n" for each in taken), "ascii")
    (tmp_path / "runs.jsonl").write_text(to_json(quiet(1800, agents=2)) + "\n", "ascii")
    (tmp_path / "setting.json").write_text(json.dumps(SETTING))
    assert main(["--report-only", "--json", "--out", str(tmp_path)]) == 75
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads((tmp_path / "soak.json").read_text("utf-8"))
    slopes = {each["measurement"]: each["all"] for each in found["slopes"]}
    assert slopes["memory, private"]["slope"] == pytest.approx(1.0, rel=0.01)
    assert found["alarms"]["agent_hours"] == pytest.approx(1.0)
    page = (tmp_path / "soak.html").read_text("utf-8")
    assert "0 false alarms in 1.00 agent hours" in page and "NOT COMPLETE" in page and "unsafe-inline" not in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--report-only"], "has no record of a soak"),
        (["2", "--minutes", "5"], "not both"),
        (["0.001"], "allowed are 1 minute to 7 days"),
        (["1", "--period", "0"], "allowed are 1 to 600 s"),
        (["1", "--every", "90"], "allowed are 10 s"),
        (["1", "--agents", "99"], "allowed are 1 to"),
    ],
)
def test_invalid_options_are_refused_before_a_swarm_is_started(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    """With a sentence that says what is allowed, and exit code 2."""
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_another_soak_is_not_continued_by_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The record says with which options it was begun."""
    (tmp_path / "setting.json").write_text(json.dumps(SETTING))
    assert main(["5", "--out", str(tmp_path)]) == 2
    assert "is the record of another soak" in " ".join(capsys.readouterr().err.split())
