"""The current generation of a container, who started it, and whether attempts are reset."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import testing
from phm.facts import CannotTell, ContainerFact
from phm.recovery.ownership import (
    UNFINISHED_S,
    Generation,
    GenerationTracker,
    StartedBy,
    next_generation,
    resets_attempts,
)

LASTING_S = 30.0
FIRST = testing.container("app", id="one", started_at="t1")


class Watch:
    """Lives of `app` on a fake clock; `fact` is the engine's answer."""

    def __init__(self, fact: ContainerFact | None = FIRST) -> None:
        self.clock, self.fact, self.silent = testing.FakeClock(), fact, False
        self.lives = GenerationTracker(self._observe, self.clock, LASTING_S)

    def _observe(self, key: str) -> ContainerFact | None:
        if self.silent:
            raise CannotTell("the engine is busy")
        return self.fact

    def change(self, **fields: object) -> None:
        assert self.fact is not None
        self.fact = replace(self.fact, **fields)  # type: ignore[arg-type]

    @property
    def by(self) -> StartedBy | None:
        generation = self.lives.current("app")
        return generation.by if generation is not None else None

    @property
    def phm_for(self) -> str:
        generation = self.lives.current("app")
        return generation.phm_for if generation is not None else ""

    def resets(self, after_s: float = 0.0) -> bool:
        self.clock.advance(after_s)
        return self.lives.external_start("app") is not None


def test_the_first_generation_is_attributed_to_no_one() -> None:
    """However long it lasts, nothing has happened."""
    watch = Watch()
    assert watch.by is StartedBy.FOUND
    assert not watch.resets(after_s=1000)


def test_a_new_container_resets_attempts_immediately_and_once() -> None:
    """`docker compose up` after a change: attempts on the old container say nothing about the new one."""
    watch = Watch()
    watch.resets()
    watch.clock.advance(5)
    watch.change(id="two", started_at="t2")
    now = watch.clock.mono()
    assert watch.lives.external_start("app") == now
    assert not watch.resets()
    assert not watch.resets(after_s=LASTING_S)
    assert watch.by is StartedBy.COUNTED


def test_a_container_that_is_recreated_repeatedly_is_a_crash_loop() -> None:
    """A supervisor that runs a new container after each crash counts once, until one stays up."""
    watch = Watch()
    watch.resets()
    counted = []
    for number in range(20):
        watch.change(id=f"id{number}", started_at=f"s{number}")
        counted += [watch.resets(after_s=1.0) for _ in range(10)]
    assert sum(counted) == 1
    assert sum(watch.resets(after_s=1.0) for _ in range(60)) == 1


def test_a_manual_start_resets_attempts_when_it_lasts() -> None:
    """The same container: possibly nothing was fixed, so it must first show that it runs."""
    watch = Watch()
    watch.resets()
    watch.change(started_at="t2")
    begun = watch.clock.mono()
    assert not watch.resets()
    assert not watch.resets(after_s=LASTING_S - 1)
    watch.clock.advance(1)
    assert watch.lives.external_start("app") == begun
    assert not watch.resets(after_s=LASTING_S)


def test_a_short_life_never_resets_attempts() -> None:
    """A container that has ended keeps the timestamp of its last start."""
    watch = Watch()
    watch.resets()
    watch.change(started_at="t2")
    watch.resets()
    watch.change(status="exited")
    assert not watch.resets(after_s=10 * LASTING_S)


def test_the_restart_policy_never_resets_attempts() -> None:
    """A crash loop with lives of a minute must not make PHM restart it permanently."""
    watch = Watch()
    watch.resets()
    for number in range(1, 20):
        watch.change(started_at=f"p{number}", restart_count=number)
        assert watch.by is StartedBy.ENGINE
        assert not watch.resets(after_s=60.0)
    watch.change(started_at="by hand", restart_count=0)
    assert watch.by is StartedBy.OTHERS
    assert watch.resets(after_s=LASTING_S)


def test_phms_own_starts_never_reset_attempts() -> None:
    """Whether seen during the action or after it; a later life is external again."""
    watch = Watch()
    watch.resets()
    with watch.lives.acting("app", "app"):
        watch.change(started_at="t2")
    assert watch.phm_for == "app"
    assert not watch.resets(after_s=LASTING_S)
    watch.change(started_at="t3")
    assert watch.by is StartedBy.OTHERS


def test_a_cached_fact_is_not_the_outcome_of_an_action() -> None:
    """Just after the action the old life is still shown for a moment: the new one is still attributed to PHM."""
    watch = Watch()
    watch.resets()
    with watch.lives.acting("app", "owner"):
        pass
    assert watch.by is StartedBy.FOUND
    watch.clock.advance(0.3)
    watch.change(started_at="t2")
    life = watch.lives.current("app")
    assert life is not None
    assert life.phm_for == "owner"


def test_a_start_before_phms_action_is_external() -> None:
    """Started by an operator a moment before: detected at the latest when PHM begins."""
    watch = Watch()
    watch.resets()
    watch.change(started_at="t2")
    with watch.lives.acting("app", "app"):
        assert watch.by is StartedBy.OTHERS


def test_a_new_container_is_always_external() -> None:
    """PHM creates no containers, so a new id is external also while PHM acts."""
    watch = Watch()
    watch.resets()
    with watch.lives.acting("app", "app"):
        watch.change(id="two", started_at="t2")
        assert watch.by is StartedBy.RECREATED


def test_an_interrupted_action_may_still_be_finished_by_the_engine() -> None:
    """A restart continues without PHM: a start in time is attributed to PHM, a later one is not."""
    watch = Watch()
    watch.resets()
    watch.lives.add_unfinished("app", "app")
    watch.clock.advance(60.0)
    watch.change(started_at="t2")
    assert watch.phm_for == "app"
    watch.clock.advance(20.0)
    assert watch.phm_for == "app"
    watch.change(started_at="t3")
    assert watch.by is StartedBy.OTHERS


def late(watch: Watch) -> None:
    """An action whose call has no answer within its deadline."""
    with watch.lives.acting("app", "app", lambda: 1):
        pass


def test_a_start_after_the_deadline_is_attributed_to_phm() -> None:
    """Each unanswered call may cause one start, however late; the next one is external."""
    watch = Watch()
    watch.resets()
    for _ in range(2):
        late(watch)
        watch.clock.advance(5.0)
        assert watch.by is StartedBy.FOUND
    for number in (2, 3):
        watch.clock.advance(60.0)
        watch.change(started_at=f"t{number}")
        assert watch.phm_for == "app"
        assert not watch.resets(after_s=LASTING_S)
    watch.change(started_at="t4")
    assert watch.by is StartedBy.OTHERS


def test_an_unanswered_call_is_valid_for_ten_minutes() -> None:
    """A start after attempts have expired is external."""
    watch = Watch()
    watch.resets()
    late(watch)
    assert watch.by is StartedBy.FOUND
    watch.clock.advance(UNFINISHED_S)
    assert watch.by is StartedBy.FOUND
    watch.change(started_at="t2")
    assert watch.by is StartedBy.OTHERS


def test_an_unfinished_action_is_known_after_a_restart_of_phm() -> None:
    """During an action and after an unanswered call, not after an answered one."""
    watch = Watch()
    assert watch.lives.unfinished() == {}
    with watch.lives.acting("app", "owner"):
        assert watch.lives.unfinished() == {"app": "owner"}
    assert watch.lives.unfinished() == {}
    late(watch)
    assert watch.lives.unfinished() == {"app": "app"}


@pytest.mark.parametrize("what", ["silent", "missing"])
def test_the_known_generation_is_kept_without_an_answer(what: str) -> None:
    """An engine that does not answer, or a missing container, is not a new life."""
    watch = Watch()
    watch.resets()
    known = watch.lives.current("app")
    watch.silent, watch.fact = what == "silent", None if what == "missing" else watch.fact
    assert watch.lives.current("app") == known
    assert not watch.resets(after_s=LASTING_S)


def test_a_life_continues_over_a_restart_of_phm() -> None:
    """What was seen before counts; a container recreated meanwhile is detected at the first check."""
    first = Watch()
    first.resets()
    first.change(started_at="t2")
    first.resets()
    second = Watch(first.fact)
    second.lives.restore(first.lives.snapshot())
    assert second.resets(after_s=LASTING_S)
    third = Watch(replace(FIRST, id="two"))
    third.lives.restore(second.lives.snapshot())
    assert third.resets()


def test_the_record_does_not_change_during_a_life() -> None:
    """Each change of it is written to the disk."""
    life = next_generation(None, FIRST, 5.0, LASTING_S)
    assert next_generation(life, replace(FIRST, status="paused"), 50.0, LASTING_S) is life
    assert not resets_attempts(Generation("one", "t1", None, None, StartedBy.OTHERS), FIRST, 1e9, LASTING_S)


def test_a_start_while_there_were_no_attempts_resets_nothing_later() -> None:
    """An operator restarted it hours ago, unobserved: the first attempt since then is made on this life."""
    watch = Watch()
    watch.resets()
    watch.lives.forget("app")
    watch.change(started_at="t2")
    assert watch.by is StartedBy.FOUND
    assert not watch.resets(after_s=LASTING_S)
