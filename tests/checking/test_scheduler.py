"""The scheduler: turns, deadlines, and isolated crashes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from phm import api, testing
from phm.checking.check_turns import CheckRun, CheckTurns, ScheduledCheck
from phm.checking.scheduler import CheckScheduler
from tests.fakes.until import until

LIMIT_S = 60.0


class Scripted(api.Check):
    """A check whose run is given by the test."""

    name, slot, layer = "scripted", api.Slot.USER_1, api.Layer.CUSTOM

    def __init__(self, run: Callable[[], api.Result | Mapping[str, api.Result]], name: str = "scripted") -> None:
        self._run, self._name = run, name

    @property
    def units(self) -> tuple[api.Unit, ...]:
        return (api.Unit(self._name), api.Unit(f"{self._name}/second"))

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({f"subject:{self._name}"})

    def run(self, world: api.World) -> api.Result | Mapping[str, api.Result]:
        return self._run()


class Rig:
    """A scheduler on a fake clock, and its results."""

    def __init__(self) -> None:
        self.clock = testing.FakeClock()
        self.batches: list[CheckRun] = []
        self.engines: list[CheckScheduler] = []

    def start(self, *checks: api.Check, period_s: float = 20.0, deadline_s: float = 5.0) -> CheckScheduler:
        scheduled = [ScheduledCheck(check, period_s, deadline_s) for check in checks]
        engine = CheckScheduler(scheduled, testing.world(), self.clock, self.batches.append)
        self.engines.append(engine)
        engine.start()
        until(lambda: len(engine._threads._idle) == len(checks) - 1, "the threads that wait")
        return engine

    def between_runs(self) -> None:
        """Wait until no check runs, and one thread waits for the next turn."""
        until(
            lambda: all(each.taken_at is None for engine in self.engines for each in engine.turns),
            "the end of all runs",
        )
        self.clock.wait_for_sleepers(1, LIMIT_S)

    def summaries(self, unit: str) -> list[str]:
        return [batch.units[unit].summary for batch in self.batches if unit in batch.units]


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    for engine in rig.engines:
        engine.stop(0.1)
    rig.clock.advance(1000)


def test_a_check_runs_at_start_and_then_every_period(rig: Rig) -> None:
    """The first result does not wait for the first period."""
    rig.start(Scripted(lambda: api.ok("fine")), period_s=20.0)
    until(lambda: len(rig.batches) == 1, "the first result")
    for count in (2, 3):
        rig.clock.wait_for_sleepers(1, LIMIT_S)
        rig.clock.advance(0.05)
        rig.clock.wait_for_sleepers(1, LIMIT_S)
        rig.clock.advance(20.0)
        until(lambda count=count: len(rig.batches) == count, "the next result")  # type: ignore[misc]


@pytest.mark.parametrize(
    "answer",
    [
        None,
        "x",
        [],
        {"scripted": api.Level.OK},
        {"scripted": None},
        api.Result(2, "fine"),  # type: ignore[arg-type]
        api.Result(api.Level.OK, None),  # type: ignore[arg-type]
        api.Result(api.Level.OK, "fine", values=None),  # type: ignore[arg-type]
        api.Result(api.Level.OK, "fine", values={1: 2}),  # type: ignore[dict-item]
        api.Result(api.Level.OK, "fine", values={"voltage_v": object()}),  # type: ignore[dict-item]
        api.Result(api.Level.ERROR, "bad", settle_s="2"),  # type: ignore[arg-type]
        api.Result(api.Level.ERROR, "bad", settle_s=float("nan")),
        api.Result(api.Level.ERROR, "bad", decides_s=[]),  # type: ignore[arg-type]
        api.Result(api.Level.ERROR, "bad", age_s=None),  # type: ignore[arg-type]
        api.Result(api.Level.ERROR, "bad", age_s=float("nan")),
        api.Result(api.Level.ERROR, "bad", age_s=float("-inf")),
        api.Result(api.Level.ERROR, "bad", evidence=None),  # type: ignore[arg-type]
        api.Result(api.Level.ERROR, "bad", readings=1),  # type: ignore[arg-type]
        api.Result(api.Level.ERROR, "bad", votes=None),  # type: ignore[arg-type]
        api.Result(api.Level.OK, "fine", rate_hz=True),
    ],
)
def test_a_check_that_returns_no_result_is_unknown_and_runs_again(answer: Any, rig: Rig) -> None:
    """Its thread would end, or the tracker fail at each tick, with the alarms of all other units."""
    rig.start(Scripted(lambda: answer if not rig.batches else api.ok("fine")), period_s=20.0)
    until(lambda: len(rig.batches) == 1, "the first result")
    assert {result.level for result in rig.batches[0].units.values()} == {api.Level.STALE}
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(0.05)
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(20.0)
    until(lambda: rig.summaries("scripted")[1:] == ["fine"], "the next result")


def test_a_wake_runs_only_the_checks_of_its_subject(rig: Rig) -> None:
    """An event runs only the affected checks, not an entire pass."""
    engine = rig.start(Scripted(lambda: api.ok("a"), "a"), Scripted(lambda: api.ok("b"), "b"))
    until(lambda: len(rig.batches) == 2, "the second result")
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(0.05)
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    engine.wake_subject("subject:a")
    until(lambda: len(rig.summaries("a")) == 2, "the second result of a")
    assert len(rig.summaries("b")) == 1


def test_a_check_that_is_woken_all_the_time_leaves_a_gap(rig: Rig) -> None:
    """All wake-ups in between cause one run, after the gap."""
    engine = rig.start(Scripted(lambda: api.ok("fine")))
    for count in (1, 2, 3):
        until(lambda count=count: len(rig.batches) == count, "the next result")  # type: ignore[misc]
        rig.clock.wait_for_sleepers(1, LIMIT_S)
        engine.wake_units(["scripted"], "test")
        engine.wake_units(["scripted"], "test")
        rig.clock.wait_for_sleepers(1, LIMIT_S)
        assert len(rig.batches) == count
        rig.clock.advance(0.05)


def test_a_crash_makes_a_unit_stale_and_the_check_continues(rig: Rig) -> None:
    """A check's own crash is never a fault of the vehicle, not even SystemExit from a plug-in."""
    answers: list[BaseException | None] = [ValueError("boom"), SystemExit(3), None]

    def run() -> api.Result:
        answer = answers.pop(0) if answers else None
        if answer is not None:
            raise answer
        return api.ok("fine again")

    engine = rig.start(Scripted(run))
    for count in (1, 2, 3):
        until(lambda count=count: len(rig.batches) >= count, "the next result")  # type: ignore[misc]
        rig.clock.wait_for_sleepers(1, LIMIT_S)
        rig.clock.advance(0.05)
        engine.wake_units(["scripted"], "test")
    first, second, third = (batch.units["scripted"] for batch in rig.batches[:3])
    assert first.level is second.level is api.Level.STALE
    assert "ValueError: boom" in first.summary and "SystemExit" in second.summary
    assert third.level is api.Level.OK


class Unprintable(Exception):
    def __str__(self) -> str:
        raise IndexError


@pytest.mark.parametrize("kind", [Unprintable, type("CannotSay", (Unprintable, api.CannotTell), {})])
def test_an_exception_without_a_text_does_not_end_the_thread(kind: type[BaseException], rig: Rig) -> None:
    """Otherwise the unit would keep its last level for good."""
    answers: list[BaseException] = [kind()]

    def run() -> api.Result:
        if answers:
            raise answers.pop()
        return api.ok("fine again")

    engine = rig.start(Scripted(run))
    until(lambda: len(rig.batches) == 1, "the first result")
    assert rig.batches[0].units["scripted"].level is api.Level.STALE
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(0.05)
    engine.wake_units(["scripted"], "test")
    until(lambda: rig.summaries("scripted")[1:] == ["fine again"], "the next result")


def test_cannot_tell_is_stale_with_the_text_of_the_probe(rig: Rig) -> None:
    """The log has the reason."""

    def run() -> api.Result:
        raise api.CannotTell("the engine did not answer in 5 s")

    rig.start(Scripted(run))
    until(lambda: len(rig.batches) == 1, "the first result")
    assert rig.batches[0].units["scripted"] == api.stale("the engine did not answer in 5 s")


def test_a_unit_without_a_result_is_stale(rig: Rig) -> None:
    """Silence is never OK."""
    rig.start(Scripted(lambda: {"scripted": api.ok("fine")}))
    until(lambda: len(rig.batches) == 1, "the first result")
    assert rig.batches[0].units["scripted"].level is api.Level.OK
    assert rig.batches[0].units["scripted/second"].level is api.Level.STALE


def test_a_hung_check_makes_only_its_own_units_stale(rig: Rig) -> None:
    """The deadline is reported once, the other checks continue, and a late result is delivered."""
    begun, hung = threading.Event(), threading.Event()

    def hang() -> api.Result:
        begun.set()
        hung.wait()
        return api.ok("back")

    engine = rig.start(Scripted(hang, "hung"), Scripted(lambda: api.ok("b"), "other"))
    until(begun.is_set, "the run that hangs")
    rig.clock.advance(0.1)
    engine.report_overdue()
    until(lambda: len(rig.summaries("other")) == 1, "the result of the other")
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(5.0)
    engine.report_overdue()
    engine.report_overdue()
    assert [("deadline of 5 s" in text) for text in rig.summaries("hung")] == [True]
    assert engine.overdue() == ("hung",)
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(14.9)
    until(lambda: len(rig.summaries("other")) == 2, "its next turn")
    hung.set()
    until(lambda: rig.summaries("hung")[-1] == "back", "the result of the check that hung")
    assert engine.overdue() == ()
    rig.between_runs()
    rig.clock.advance(20.0)
    until(lambda: rig.summaries("hung")[1:] == ["back", "back"], "its next turn")


def test_a_wait_for_a_thread_begins_with_the_wake_up(rig: Rig) -> None:
    """Not with the end of the last run; and another wake-up does not extend it."""
    engine = rig.start(Scripted(lambda: api.ok("fine")), period_s=20.0, deadline_s=5.0)
    until(lambda: len(rig.batches) == 1, "the first result")
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(10.0)
    turns = engine.turns[0]
    turns.wake("pass")  # no thread learns of it
    engine.report_overdue()
    assert len(rig.batches) == 1 and engine.overdue() == ()
    rig.clock.advance(4.0)
    turns.wake("again")
    rig.clock.advance(0.9)
    engine.report_overdue()
    assert len(rig.batches) == 1
    rig.clock.advance(0.2)
    engine.report_overdue()
    assert rig.batches[-1].overdue and engine.overdue() == ("scripted",)
    assert rig.batches[-1].started == pytest.approx(rig.clock.mono() - 5.1)  # before the result that follows
    engine.end()
    engine.report_overdue()
    assert len(rig.batches) == 2 and engine.overdue() == ()


def test_a_check_that_is_taken_while_its_wait_is_reported_is_reported_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The report of the wait must not be taken for one of the run."""
    engine = rig.start(Scripted(lambda: api.ok("fine")), period_s=100.0, deadline_s=5.0)
    until(lambda: len(rig.batches) == 1, "the first result")
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(10.0)
    turns, left_s = engine.turns[0], CheckTurns.left_s
    turns.wake("pass")
    rig.clock.advance(6.0)

    def taken_meanwhile(self: CheckTurns, now: float) -> float:
        before = left_s(self, now)
        self.running_since = now
        return before

    monkeypatch.setattr(CheckTurns, "left_s", taken_meanwhile)
    engine.report_overdue()
    monkeypatch.undo()
    rig.clock.advance(6.0)
    engine.report_overdue()
    assert [batch.units["scripted"].summary for batch in rig.batches[1:]] == [
        "the check has waited 5 s for a thread",
        "the check exceeded its deadline of 5 s; it is still running",
    ]


def test_a_defect_behind_the_sink_does_not_end_the_thread(rig: Rig) -> None:
    """A lost result must not mean that the unit is never checked again."""
    calls: list[CheckRun] = []

    def sink(batch: CheckRun) -> None:
        calls.append(batch)
        raise RuntimeError("defect")

    engine = CheckScheduler(
        [ScheduledCheck(Scripted(lambda: api.ok("fine")), 20.0, 5.0)], testing.world(), rig.clock, sink
    )
    rig.engines.append(engine)
    engine.start()
    until(lambda: len(calls) == 1, "the first call")
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.clock.advance(0.05)
    engine.wake_units(["scripted"], "test")
    until(lambda: len(calls) == 2, "the second call")
