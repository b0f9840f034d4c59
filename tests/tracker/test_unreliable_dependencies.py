"""A dependency whose check hangs or fails now and then delays the faults of the units that need it, but never hides them."""

from __future__ import annotations

from random import Random

import pytest

from phm.api import Level, stale
from phm.tracker.rules import UNKNOWN_NEED_S
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

GRACE_S = 8.0
ANSWER_S = 5.0
"""How long a request to the engine may take."""


def test_a_check_that_hangs_does_not_hide_the_faults_of_its_dependents() -> None:
    """Its unit was reported as overdue, and no run that begins later answers."""
    bench = Bench([unit("up"), unit("down", "up")])
    bench.all_healthy()
    hung = bench.now
    bench.now += 4
    bench.see("up", stale("overdue"), started=hung)
    bench.now += 10
    bench.see("down", BAD)
    bench.later(UNKNOWN_NEED_S - 0.5)
    bench.see("down", BAD)
    assert bench.opened == []
    bench.later(1.0)
    assert bench.opened == ["down"]


def test_only_the_check_that_hangs_is_not_waited_for() -> None:
    """A dependency that was OK last is asked all the same, and its answer counts."""
    bench = Bench([unit("hung"), unit("up"), unit("down", "hung", "up")])
    bench.all_healthy()
    bench.see("hung", stale("overdue"))
    bench.now += 10
    bench.see("down", BAD)
    bench.later(UNKNOWN_NEED_S + 1.0)
    assert bench.opened == []
    bench.see("up", BAD)
    bench.see("down", BAD)
    assert bench.opened == ["up"]
    assert bench.blocked_by("down") == "up"


class Flaky:
    """An engine of which some requests get no answer for ANSWER_S, and a node that is bad from the start. Checks run again when the
    tracker asks for it, and after their period."""

    def __init__(self, misses: Random | int, chain: bool) -> None:
        units = [unit("engine", failures=2), unit("container", "engine"), unit("node", "container", grace_s=GRACE_S)]
        self.bench, self.misses, self.chain, self.calls = Bench(units), misses, chain, 0
        self.bench.all_healthy()
        self.missed = False
        self.due = dict.fromkeys(("engine", "container", "node"), self.bench.now)
        self.asked: dict[str, float] = {}
        self.running: tuple[float, float, bool] | None = None
        """The request to the engine: when it began, when it ends, whether it is answered."""

    def run(self, seconds: float) -> None:
        end = self.bench.now + seconds
        while self.bench.now < end:
            self.ask(self.bench.later(0.1))
            self.engine()
            for name in ("container", "node"):
                if self.bench.now >= self.due[name]:
                    self.due[name] = self.bench.now + (5.0 if name == "container" else 1.0)
                    lost = name == "container" and self.chain and self.missed
                    bad = BAD if name == "node" else stale("the engine does not answer") if lost else OK
                    self.ask(self.bench.see(name, bad))

    def ask(self, names: set[str]) -> None:
        for name in names:
            self.due[name] = self.bench.now

    def engine(self) -> None:
        now = self.bench.now
        if self.running is not None and now >= self.running[1]:
            began, _, answered = self.running
            self.running, self.missed = None, not answered
            self.ask(self.bench.see("engine", OK if answered else BAD, started=began))
            if self.chain:
                self.ask({"container"})
        if self.running is None and now >= self.due["engine"]:
            self.due["engine"] = now + 5.0
            answered = not self.misses_next()
            self.running = (now, now if answered else now + ANSWER_S, answered)

    def misses_next(self) -> bool:
        """Never twice in a row, which would be a fault of the engine."""
        self.calls += 1
        if isinstance(self.misses, int):
            return self.calls % self.misses == 0
        return not self.missed and self.misses.random() < 0.5


@pytest.mark.parametrize("chain", [False, True])
@pytest.mark.parametrize("every", [2, 3])
def test_an_engine_that_misses_requests_does_not_hide_a_bad_node(every: int, chain: bool) -> None:
    """Its ERROR is never published, so it must not give grace again and again."""
    world = Flaky(every, chain)
    world.run(GRACE_S + 6 * ANSWER_S)
    assert world.bench.opened == ["node"]
    assert world.bench.level("engine") is Level.OK


@pytest.mark.parametrize("seed", range(40))
def test_random_misses_delay_a_fault_only_for_a_time(seed: int) -> None:
    world = Flaky(Random(seed), chain=seed % 2 == 0)
    world.run(GRACE_S + 12 * ANSWER_S)
    assert world.bench.opened == ["node"]


def test_a_unit_that_was_ok_meanwhile_gets_grace_again() -> None:
    """Each failure of the dependency that was never published may have broken it."""
    bench = Bench([unit("engine", failures=2), unit("node", "engine", grace_s=GRACE_S)])
    bench.all_healthy()
    bench.later(20)
    for _ in range(3):
        bench.see("engine", BAD)
        bench.see("node", BAD)
        bench.later(1)
        bench.see("engine", OK)
        bench.see("node", BAD)
        bench.later(GRACE_S - 1)
        bench.see("node", BAD)
        bench.see("engine", OK)
        bench.later(0.5)
        bench.see("node", OK)
        bench.later(5)
    assert bench.opened == []


def test_an_error_that_was_published_gives_grace_each_time() -> None:
    bench = Bench([unit("engine"), unit("node", "engine", grace_s=GRACE_S)])
    bench.all_healthy()
    bench.later(20)
    for _ in range(3):
        bench.see("engine", BAD)
        bench.see("node", BAD)
        bench.later(1)
        bench.see("engine", OK)
        bench.later(GRACE_S - 1)
        bench.see("engine", OK)
        bench.see("node", BAD)
    assert bench.opened == ["engine"] * 3


def test_each_unit_that_a_published_error_blocked_gives_grace_when_it_is_back() -> None:
    """The container and its network were blocked by the engine, and are back one after the other."""
    bench = Bench([unit("engine"), unit("a", "engine"), unit("b", "engine"), unit("node", "a", "b", grace_s=GRACE_S)])
    bench.all_healthy()
    bench.later(20)
    bench.see("engine", BAD)
    for name in ("a", "b", "node"):
        bench.see(name, BAD)
    bench.later(5)
    for name in ("engine", "a", "b"):
        bench.later(GRACE_S - 1)
        bench.see(name, OK)
        bench.see("node", BAD)
    bench.later(GRACE_S - 1)
    bench.see("node", BAD)
    assert bench.opened == ["engine"]
