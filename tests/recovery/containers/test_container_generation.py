"""The current generation of a container, who started it, and whether attempts are reset."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import testing
from phm.facts import CannotTell, ContainerFact
from phm.recovery.containers.container_generation import (
    COUNTED,
    ENGINE,
    FOUND,
    OTHERS,
    RECREATED,
    UNFINISHED_S,
    Generation,
    GenerationTracker,
    by_phm,
    next_generation,
    resets_attempts,
)

LASTING_S = 30.0
FIRST = testing.container("app", id="one", started_at="t1")


class Watch:
    """Lives of `app` on a fake clock; `fact` is what the engine would say."""

    def __init__(self, fact: ContainerFact | None = FIRST) -> None:
        self.clock, self.fact, self.silent = testing.FakeClock(), fact, False
        self.lives = GenerationTracker(self._look, self.clock, LASTING_S)

    def _look(self, key: str) -> ContainerFact | None:
        if self.silent:
            raise CannotTell("the engine is busy")
        return self.fact

    def change(self, **fields: object) -> None:
        assert self.fact is not None
        self.fact = replace(self.fact, **fields)  # type: ignore[arg-type]

    @property
    def by(self) -> str:
        life = self.lives.current("app")
        return life.by if life is not None else ""

    def resets(self, after_s: float = 0.0) -> bool:
        self.clock.advance(after_s)
        return self.lives.external_start("app") is not None


def test_the_first_generation_is_attributed_to_no_one() -> None:
    """However long it lasts, nothing has happened."""
    watch = Watch()
    assert watch.by == FOUND
    assert not watch.resets(after_s=1000)


def test_a_new_container_counts_at_once_and_once() -> None:
    """`docker compose up` after a change: what was tried on the old one says nothing about the new one."""
    watch = Watch()
    watch.resets()
    watch.clock.advance(5)
    watch.change(id="two", started_at="t2")
    now = watch.clock.mono()
    assert watch.lives.external_start("app") == now
    assert not watch.resets()
    assert not watch.resets(after_s=LASTING_S)
    assert watch.by == COUNTED


def test_a_container_that_is_recreated_repeatedly_is_a_crash_loop() -> None:
    """A supervisor that runs a fresh container after each crash counts once, until one stays."""
    watch = Watch()
    watch.resets()
    counted = []
    for number in range(20):
        watch.change(id=f"id{number}", started_at=f"s{number}")
        counted += [watch.resets(after_s=1.0) for _ in range(10)]
    assert sum(counted) == 1
    assert sum(watch.resets(after_s=1.0) for _ in range(60)) == 1


def test_started_again_by_hand_counts_when_it_lasts() -> None:
    """The same container: nothing need have been fixed, so it must have shown that it runs."""
    watch = Watch()
    watch.resets()
    watch.change(started_at="t2")
    begun = watch.clock.mono()
    assert not watch.resets()
    assert not watch.resets(after_s=LASTING_S - 1)
    watch.clock.advance(1)
    assert watch.lives.external_start("app") == begun
    assert not watch.resets(after_s=LASTING_S)


def test_a_short_life_never_counts_however_long_ago_it_began() -> None:
    """A container that has ended keeps the stamp of its last start."""
    watch = Watch()
    watch.resets()
    watch.change(started_at="t2")
    watch.resets()
    watch.change(status="exited")
    assert not watch.resets(after_s=10 * LASTING_S)


def test_the_engines_restart_policy_never_counts() -> None:
    """A crash loop with lives of a minute must not make PHM restart it permanently."""
    watch = Watch()
    watch.resets()
    for number in range(1, 20):
        watch.change(started_at=f"p{number}", restart_count=number)
        assert watch.by == ENGINE
        assert not watch.resets(after_s=60.0)
    watch.change(started_at="by hand", restart_count=0)
    assert watch.by == OTHERS
    assert watch.resets(after_s=LASTING_S)


def test_phms_own_doing_never_counts() -> None:
    """Seen while it acts or after; a later life is again somebody else's."""
    watch = Watch()
    watch.resets()
    with watch.lives.acting("app", "app"):
        watch.change(started_at="t2")
    assert watch.by == by_phm("app")
    assert not watch.resets(after_s=LASTING_S)
    watch.change(started_at="t3")
    assert watch.by == OTHERS


def test_what_the_probe_remembers_is_not_taken_for_the_outcome() -> None:
    """Right after the action the old life is still shown for a moment: the new one is PHM's all the same."""
    watch = Watch()
    watch.resets()
    with watch.lives.acting("app", "owner"):
        pass
    assert watch.by == FOUND
    watch.clock.advance(0.3)
    watch.change(started_at="t2")
    life = watch.lives.current("app")
    assert life is not None
    assert life.whose == "owner"


def test_what_happened_before_phm_acted_is_not_phms_doing() -> None:
    """Started by an operator a moment before: seen at the latest when PHM begins."""
    watch = Watch()
    watch.resets()
    watch.change(started_at="t2")
    with watch.lives.acting("app", "app"):
        assert watch.by == OTHERS


def test_phm_makes_no_containers() -> None:
    """A new id is somebody else's also while PHM acts."""
    watch = Watch()
    watch.resets()
    with watch.lives.acting("app", "app"):
        watch.change(id="two", started_at="t2")
        assert watch.by == RECREATED


def test_an_action_that_phms_end_cut_short_may_still_be_finished_by_the_engine() -> None:
    """A restart goes on without PHM: what comes of it in time is PHM's, what comes later is not."""
    watch = Watch()
    watch.resets()
    watch.lives.add_unfinished("app", "app")
    watch.clock.advance(60.0)
    watch.change(started_at="t2")
    assert watch.by == by_phm("app")
    watch.clock.advance(20.0)
    assert watch.by == by_phm("app")
    watch.change(started_at="t3")
    assert watch.by == OTHERS


def late(watch: Watch) -> None:
    """An action whose call has no answer within its deadline."""
    with watch.lives.acting("app", "app", lambda: 1):
        pass


def test_what_the_engine_does_after_the_deadline_is_phms_doing() -> None:
    """Each call without an answer may cause one start, however late; the next one is somebody else's."""
    watch = Watch()
    watch.resets()
    for _ in range(2):
        late(watch)
        watch.clock.advance(5.0)
        assert watch.by == FOUND
    for number in (2, 3):
        watch.clock.advance(60.0)
        watch.change(started_at=f"t{number}")
        assert watch.by == by_phm("app")
        assert not watch.resets(after_s=LASTING_S)
    watch.change(started_at="t4")
    assert watch.by == OTHERS


def test_a_call_without_an_answer_is_waited_for_ten_minutes() -> None:
    """Who starts it when attempts no longer count is somebody else."""
    watch = Watch()
    watch.resets()
    late(watch)
    assert watch.by == FOUND
    watch.clock.advance(UNFINISHED_S)
    assert watch.by == FOUND
    watch.change(started_at="t2")
    assert watch.by == OTHERS


def test_what_is_unfinished_is_known_to_the_next_phm() -> None:
    """While an action is at work and after a call without an answer, not after one that has come back."""
    watch = Watch()
    assert watch.lives.unfinished() == {}
    with watch.lives.acting("app", "owner"):
        assert watch.lives.unfinished() == {"app": "owner"}
    assert watch.lives.unfinished() == {}
    late(watch)
    assert watch.lives.unfinished() == {"app": "app"}


@pytest.mark.parametrize("what", ["silent", "missing"])
def test_without_an_answer_the_known_generation_remains(what: str) -> None:
    """An engine that does not answer, a container that is not there: no new life."""
    watch = Watch()
    watch.resets()
    known = watch.lives.current("app")
    watch.silent, watch.fact = what == "silent", None if what == "missing" else watch.fact
    assert watch.lives.current("app") == known
    assert not watch.resets(after_s=LASTING_S)


def test_over_a_restart_of_phm_a_life_goes_on() -> None:
    """What was seen before counts; a container recreated meanwhile is noticed at the first look."""
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


def test_the_record_does_not_change_while_the_life_goes_on() -> None:
    """It is written to the disk whenever it does."""
    life = next_generation(None, FIRST, 5.0, LASTING_S)
    assert next_generation(life, replace(FIRST, status="paused"), 50.0, LASTING_S) is life
    assert not resets_attempts(Generation("one", "t1", None, None, OTHERS), FIRST, 1e9, LASTING_S)


def test_what_happened_while_nothing_counted_is_not_made_up_for() -> None:
    """An operator restarted it hours ago, and nobody looked: the first attempt since then is made on this life."""
    watch = Watch()
    watch.resets()
    watch.lives.forget("app")
    watch.change(started_at="t2")
    assert watch.by == FOUND
    assert not watch.resets(after_s=LASTING_S)
