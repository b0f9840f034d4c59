"""The threads of the checks: one runs them all, and none delays the others."""

from __future__ import annotations

import random
import string
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator

import pytest

from phm import api, testing
from phm.checking.check_turns import LONG_FOR_S, LONG_S, CheckRun, CheckTurns, ScheduledCheck
from phm.checking.scheduler import CheckScheduler
from phm.core.clock import Clock
from tests.fakes.until import until

LIMIT_S = 60.0
PERIOD_S = 20.0


class Listed(api.Check):
    """A check that notes its runs and their threads. While `free` is cleared its run does not end."""

    name, slot, layer = "listed", api.Slot.USER_1, api.Layer.CUSTOM

    def __init__(self, name: str) -> None:
        self.title = name
        self.threads: list[str] = []
        self.free = threading.Event()
        self.free.set()
        self.during: Callable[[], None] = lambda: None

    @property
    def units(self) -> tuple[api.Unit, ...]:
        return (api.Unit(self.title),)

    def run(self, world: api.World) -> api.Result:
        self.threads.append(threading.current_thread().name)
        self.free.wait()
        self.during()
        return api.ok(self.title)


class Rig:
    """The checks a, b, c and so on of one period, on a fake clock."""

    def __init__(self, hanging: str = "", number: int = 3) -> None:
        self.clock = testing.FakeClock()
        self.checks = [Listed(name) for name in string.ascii_letters[:number]]
        self.a, self.b, self.c = self.checks[:3]
        for each in self.checks:
            if each.title in hanging:
                each.free.clear()
        self.runs: list[CheckRun] = []
        self.scheduler = scheduler(self.checks, self.clock, self.runs)
        self.scheduler.start()
        until(lambda: len(self.scheduler._threads._idle) == number - 1, "the threads that wait")

    def counts(self) -> list[int]:
        return [len(each.threads) for each in self.checks]

    def expect(self, *counts: int) -> None:
        """So many runs of a, b and c have begun, and no more are due."""
        until(lambda: self.counts() == list(counts), f"{counts} runs")
        self.ends()
        self.clock.wait_for_sleepers(1, LIMIT_S)
        assert self.counts() == list(counts)

    def ends(self) -> None:
        """Wait until no check runs, except those that hang or whose thread has ended."""
        stuck = {each.title for each in self.checks if not each.free.is_set()}
        stuck |= {each.units[0] for each in self.scheduler._threads.ended()}
        until(
            lambda: all(each.taken_at is None or each.units[0] in stuck for each in self.scheduler.turns),
            "the end of the runs",
        )

    def next_turn(self) -> None:
        self.clock.wait_for_sleepers(1, LIMIT_S)
        self.clock.advance(PERIOD_S)

    def close(self) -> None:
        for each in self.checks:
            each.free.set()
        self.scheduler.stop(0.1)
        self.clock.advance(1000)


def scheduler(checks: list[Listed], clock: Clock, runs: list[CheckRun]) -> CheckScheduler:
    return CheckScheduler(
        [ScheduledCheck(each, PERIOD_S, 60.0) for each in checks], testing.world(), clock, runs.append
    )


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.close()


@pytest.fixture
def hanging() -> Iterator[Rig]:
    """The first run of b does not end."""
    rig = Rig("b")
    yield rig
    rig.close()


def test_one_thread_runs_all_checks(rig: Rig) -> None:
    """One wake-up for all of one period; each has its own wake-ups and results."""
    rig.expect(1, 1, 1)
    rig.next_turn()
    rig.expect(2, 2, 2)
    assert [list(run.units) for run in rig.runs] == [[each] for each in "abcabc"]
    rig.clock.advance(1.0)
    rig.scheduler.wake_units(["b"], "test")
    rig.expect(2, 3, 2)
    assert rig.runs[-1].reason == "test"
    assert len({name for each in rig.checks for name in each.threads}) == 1


def test_checks_behind_one_that_waits_get_another_thread(hanging: Rig) -> None:
    """The main loop asks for it; it does not wait for the deadline."""
    until(lambda: hanging.counts() == [1, 1, 0], "the run that waits")
    assert hanging.scheduler.report_overdue() == pytest.approx(LONG_S)
    assert hanging.counts() == [1, 1, 0]
    hanging.clock.advance(2 * LONG_S)
    hanging.scheduler.report_overdue()
    hanging.expect(1, 1, 1)
    assert hanging.c.threads != hanging.b.threads
    hanging.next_turn()
    hanging.expect(2, 1, 2)


def test_checks_that_wait_for_the_same_delay_the_others_together() -> None:
    """An engine that hangs: the main loop looks once, not once for each check."""
    rig = Rig("ab")
    until(lambda: rig.counts() == [1, 0, 0], "the first run that waits")
    rig.clock.advance(2 * LONG_S)
    rig.scheduler.report_overdue()
    rig.expect(1, 1, 1)
    rig.close()


def test_a_check_that_is_woken_does_not_wait_for_another(hanging: Rig) -> None:
    """An event is handled while a run takes long, before the main loop looks."""
    until(lambda: hanging.counts() == [1, 1, 0], "the run that waits")
    hanging.clock.advance(2 * LONG_S)
    hanging.scheduler.wake_units(["a"], "event")
    hanging.expect(2, 1, 1)


def test_checks_that_an_event_has_woken_are_first() -> None:
    """In a long look, e.g. for a report. However often others are woken, and also if they just run or pause after a run."""
    rig = Rig(number=20)
    rig.expect(*[1] * 20)
    order: list[str] = []
    places: list[str] = []

    def during(name: str) -> None:
        order.append(name)
        places.append(threading.current_thread().name)
        if name == "c" and order.count("c") == 1:
            rig.scheduler.wake_units(["t"], "event")
            for _ in range(30):
                rig.scheduler.wake_units(["a", "c"], "event")
        rig.clock.advance(0.3 * LONG_S)

    for each in rig.checks:
        each.during = lambda name=each.title: during(name)  # type: ignore[misc]
    rig.next_turn()
    until(lambda: len(order) >= 22, "a run of each, and of a and c again")
    assert order[:4] == ["a", "b", "c", "t"]
    assert order.index("a", 1) < 15 and order.index("c", 3) < 15
    assert len(set(places[:4])) == 1
    assert len(set(places)) > 1  # the look has taken long
    rig.close()


def test_a_check_is_not_taken_again_just_after_its_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another thread looks at it in the moment in which its run ends."""
    rig = Rig("b")
    until(lambda: rig.counts() == [1, 1, 0], "the run that waits")
    turns, lock = rig.scheduler.turns[1], rig.scheduler._threads._lock
    due = CheckTurns.__dict__["due"].fget
    looked = threading.Event()

    def run_ends_meanwhile(self: CheckTurns) -> float:
        before: float = due(self)
        if self is turns and threading.current_thread().name.startswith("phm-check-") and not looked.is_set():
            looked.set()
            rig.b.free.set()
            until(lambda: len(rig.runs) >= 2 and (turns.taken_at is None or lock.locked()), "the end of the run")
        return before

    monkeypatch.setattr(CheckTurns, "due", property(run_ends_meanwhile))
    rig.clock.advance(2 * LONG_S)
    rig.scheduler.report_overdue()
    until(lambda: rig.counts()[2] == 1, "another thread, which then looks at b")
    rig.clock.wait_for_sleepers(1, LIMIT_S)
    rig.b.free.set()
    rig.expect(1, 1, 1)
    rig.close()


def test_a_check_that_took_long_delays_the_others_only_once(hanging: Rig) -> None:
    """The others get their thread before it runs, for as long as one of its runs took long in the last minute."""
    until(lambda: hanging.counts() == [1, 1, 0], "the run that waits")
    hanging.clock.advance(2 * LONG_S)
    hanging.b.free.set()
    hanging.expect(1, 1, 1)
    hanging.b.free.clear()
    hanging.next_turn()
    hanging.expect(2, 2, 2)
    assert hanging.c.threads[-1] != hanging.b.threads[-1]
    hanging.b.free.set()
    until(lambda: len(hanging.runs) == 6, "the result")
    hanging.ends()
    hanging.clock.advance(LONG_FOR_S)
    hanging.expect(3, 3, 3)
    hanging.b.free.clear()
    hanging.next_turn()
    until(lambda: len(hanging.b.threads) == 4, "the run that waits")
    # Its thread is the one that looks for the next turn.
    assert hanging.scheduler.report_overdue() == pytest.approx(LONG_S)


def test_a_check_that_is_woken_while_it_runs_runs_again(hanging: Rig) -> None:
    """Also if another thread looks for the next turn by then."""
    until(lambda: hanging.counts() == [1, 1, 0], "the run that waits")
    hanging.clock.advance(2 * LONG_S)
    hanging.scheduler.report_overdue()
    hanging.expect(1, 1, 1)
    hanging.scheduler.wake_units(["b"], "again")
    hanging.expect(1, 1, 1)
    hanging.b.free.set()
    until(lambda: len(hanging.runs) == 3, "its result")
    hanging.ends()
    hanging.clock.wait_for_sleepers(1, LIMIT_S)
    hanging.clock.advance(2 * LONG_S)
    hanging.expect(1, 2, 1)
    assert hanging.runs[-1].reason == "again"


def test_results_count_from_the_moment_when_the_thread_looked(rig: Rig) -> None:
    """So one reading is enough for all checks that are due. A check that is woken later counts from the wake-up."""
    rig.expect(1, 1, 1)

    def during() -> None:
        rig.clock.advance(0.01)
        rig.scheduler.wake_units(["c"], "event")
        rig.clock.advance(0.01)

    rig.a.during = during
    rig.next_turn()
    rig.expect(2, 2, 2)
    looked_at = rig.runs[3].started
    assert rig.runs[3].duration_s == pytest.approx(0.02)
    assert rig.runs[4].started == pytest.approx(looked_at + 0.01) and rig.runs[4].reason == "event"
    assert rig.runs[5].started == looked_at and rig.runs[5].units.keys() == {"b"}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_ends_stops_only_its_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM reports that it does not know the state of this one, whatever the reason; the others continue."""
    run = CheckTurns.run
    monkeypatch.setattr(CheckTurns, "run", lambda self, at: sys.exit() if self.units == ("b",) else run(self, at))
    rig = Rig()
    until(lambda: rig.scheduler.overdue() == ("b",), "the end of the thread")
    rig.scheduler.report_overdue()
    rig.expect(1, 0, 1)
    rig.next_turn()
    rig.expect(2, 0, 2)
    assert rig.scheduler.overdue() == ("b",)
    rig.close()


def test_no_check_runs_twice_at_a_time_and_none_is_forgotten() -> None:
    """Checks of every length, woken at any moment by several threads."""
    chance, clock, over = random.Random(20), testing.FakeClock(), threading.Event()
    running: Counter[str] = Counter()
    twice: list[str] = []

    class Lasting(Listed):
        def run(self, world: api.World) -> api.Result:
            running[self.title] += 1
            if running[self.title] > 1:
                twice.append(self.title)
            clock.wait(over, chance.choice((0.0, 0.0, 0.0, 0.001, 0.02, 2 * LONG_S)))
            running[self.title] -= 1
            return super().run(world)

    checks: list[Listed] = [Lasting(name) for name in "abcdefgh"]
    engine = scheduler(checks, clock, [])

    def wake() -> None:
        for _ in range(500):
            engine.wake_units([chance.choice(checks).title], "test")
            engine.report_overdue()

    def step() -> None:
        engine.wake_units([chance.choice(checks).title], "test")
        engine.report_overdue()
        clock.advance(chance.uniform(0.0, 0.02))

    engine.start()
    wakers = [threading.Thread(target=wake) for _ in range(3)]
    for each in wakers:
        each.start()
    until(lambda: all(len(each.threads) >= 20 for each in checks), "20 runs of each check", step=step)
    for each in wakers:
        each.join()
    before = [len(each.threads) for each in checks]
    engine.wake_units("abcdefgh", "last")
    until(
        lambda: all(len(each.threads) > n for each, n in zip(checks, before, strict=True)),
        "one more run of each",
        step=lambda: clock.advance(0.01),
    )
    engine.end()
    over.set()  # also for a check that begins only now
    engine.stop(LIMIT_S)
    assert twice == []
    assert not [each for each in threading.enumerate() if each.name.startswith("phm-check-")]
