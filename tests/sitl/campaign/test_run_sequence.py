"""The sequence of a campaign's runs, with a runner that injects nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sitl.campaign import irregular, run_sequence
from sitl.campaign.arguments import parser
from sitl.campaign.groups import groups
from sitl.campaign.plan import Draw, TrialPlan
from sitl.campaign.progress import left
from sitl.campaign.runner import NotOk
from sitl.campaign.schedule import schedule
from sitl.campaign.trial import ABORTED, NOMINAL, OFF, TRIAL, Trial, load
from tests.fakes.campaign_trials import alarm, injection, trial

WORDS = ["--commit", "0123456789" * 4, "--trials", "2", "--seeds", "2"]


class Runner:
    """Its trials succeed, until `stop_at` of them were made: then it is interrupted."""

    swarm = None

    def __init__(self, stop_at: int = 99) -> None:
        self.setting: dict[str, Any] = {}
        self.on_end: Callable[[Trial], None] = lambda trial: None
        self._left = stop_at
        self.watch = SimpleNamespace(events={})
        self.waits: dict[int, float] = {}

    def ready_at(self, draws: Sequence[Draw]) -> float:
        """Seconds from now that each agent needs; see `Pacing.ready_at`."""
        return time.monotonic() + max(self.waits.get(draw.agent, 0.0) for draw in draws)

    def _made(self, kind: str, number: int, **more: Any) -> Trial:
        if not self._left:
            raise KeyboardInterrupt
        self._left -= 1
        made = trial(kind=kind, number=number, setting=dict(self.setting), **more)
        self.on_end(made)
        return made

    def aborted(self, kind: str, number: int, error: BaseException) -> Trial:
        return trial(
            kind=ABORTED, number=number, utc=time.time(), setting=dict(self.setting), aborted=f"{kind}: {error!r}"
        )

    def nominal(self, seconds: float) -> Trial:
        return self._made(NOMINAL, 0, injections=[], alarms=[])

    def off(self, seed: int) -> Trial:
        return self._made(OFF, 0)

    def trial(self, plan: TrialPlan) -> Trial:
        return self._made(
            TRIAL, plan.number, injections=[injection(fault=draw.fault, agent=draw.agent) for draw in plan.draws]
        )


def run(file: Path, runner: Runner, *more: str) -> tuple[bool, list[str]]:
    asked = parser().parse_args([*WORDS, *more])
    said: list[str] = []
    return run_sequence._Sequence(runner, schedule(asked), file, said.append, asked).run(), said  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """There are no containers to compare."""
    monkeypatch.setattr(
        run_sequence, "of_swarm", lambda swarm: [{"of": "configuration", "key": "a.b", "shipped": 1, "here": 2}]
    )


def test_all_seeds_are_run_in_sequence_and_resumed(tmp_path: Path) -> None:
    """A campaign that was interrupted in the second seed continues there. Each trial has its seed, commit, profile and load,
    and the differences from what is shipped.
    """
    file = tmp_path / "trials.jsonl"
    with pytest.raises(KeyboardInterrupt):
        run(file, Runner(6))
    assert [each.kind for each in load(file)][6:] == [ABORTED]
    whole, said = run(file, Runner(2))
    assert whole
    assert [words.partition("[/]")[0] for words in said if "seed" in words] == [
        "[bold]seed 2 of 2, trial 1 of 2",
        "[bold]seed 2 of 2, trial 2 of 2",
    ]
    made = [each for each in load(file) if each.kind != ABORTED]
    assert [(each.setting["index"], each.kind, each.number) for each in made] == [
        (index, kind, number) for index in (0, 1) for kind, number in ((NOMINAL, 0), (OFF, 0), (TRIAL, 1), (TRIAL, 2))
    ]
    assert len({each.setting["seed"] for each in made}) == 2
    for each in made:
        assert (each.setting["profile"], each.setting["load"]) == ("shipped", "quiet")
        assert (each.setting["commit"], each.setting["planned"]) == ("0123456789" * 4, 2)
        assert each.setting["differences"][0]["key"] == "a.b"
        assert "memory_full" in each.setting["excluded"]
    assert run(file, Runner(0))[0], "nothing is left to do"


def test_a_trial_whose_agents_must_wait_lets_the_others_pass(tmp_path: Path) -> None:
    """PHM's budget on one agent does not hold up the campaign; if all must wait, the one with the shortest wait is next."""
    file, runner = tmp_path / "trials.jsonl", Runner()
    plans = schedule(parser().parse_args([*WORDS, "--trials", "12"])).plans[0]
    slow = plans[0].draws[0].agent
    runner.waits = {slow: 900.0}
    assert run(file, runner, "--trials", "12", "--seeds", "1")[0]
    order = [each.number for each in load(file) if each.kind == TRIAL]
    late = [each.number for each in plans if any(draw.agent == slow for draw in each.draws)]
    assert sorted(order) == list(range(1, 13))
    assert order[-len(late) :] == late


def test_another_profile_has_separate_trials(tmp_path: Path) -> None:
    """In the same record, with the same seeds."""
    file = tmp_path / "trials.jsonl"
    run(file, Runner())
    run(file, Runner(), "--profile", "as-found")
    run(file, Runner(), "--load", "busy")
    assert len(load(file)) == 3 * 8
    assert len({each.campaign for each in load(file)}) == 6


def test_no_run_begins_after_the_time_is_over(tmp_path: Path) -> None:
    """`--stop-after`: the rest is made by the next call."""
    file = tmp_path / "trials.jsonl"
    assert not run(file, Runner(), "--stop-after", "-1")[0]
    assert load(file) == []


def test_a_trial_is_recorded_before_the_swarm_is_made_ready_again(tmp_path: Path) -> None:
    """PHM may not come back after a trial, and that trial must count: it is neither dropped nor repeated."""

    class Failing(Runner):
        def trial(self, plan: TrialPlan) -> Trial:
            super().trial(plan)
            raise NotOk("PHM did not start again on A03")

    file = tmp_path / "trials.jsonl"
    with pytest.raises(NotOk):
        run(file, Failing())
    assert [(each.kind, each.number) for each in load(file)] == [(NOMINAL, 0), (OFF, 0), (TRIAL, 1)]
    assert "trial 1 of 2" not in "".join(run(file, Runner())[1]).partition("seed 2 of 2")[0]


def test_the_logs_of_agents_with_a_problem_are_kept(tmp_path: Path) -> None:
    """Beside the record: of an agent with a missed fault, and of another one with a false alarm. Not of the others, and
    nothing of a trial without a problem.
    """

    class Missing(Runner):
        def trial(self, plan: TrialPlan) -> Trial:
            bad = plan.number == 2
            self.watch.events = {agent: [{"event": "report", "agent": agent}] for agent in (3, 4, 5)}
            seen = [alarm(0.4)] if not bad else [alarm(0.4, "nodes/agent_5/node_1", 5)]
            return self._made(TRIAL, plan.number, injections=[injection()], alarms=seen)

    file = tmp_path / "trials.jsonl"
    said = run(file, Missing(), "--seeds", "1")[1]
    kept = tmp_path / "trials-logs" / "shipped-quiet-seed-1-trial-2"
    assert sorted(each for each in (tmp_path / "trials-logs").rglob("*") if each.is_file()) == [
        kept / "A03" / "phm.jsonl",
        kept / "A05" / "phm.jsonl",
    ]
    assert (kept / "A05" / "phm.jsonl").read_text() == '{"event": "report", "agent": 5}\n'
    assert said[-1] == f"  PHM's logs: {kept}"


def test_an_aborted_run_is_recorded_and_counted(tmp_path: Path) -> None:
    """Each attempt has a separate line; none is in a figure."""
    file = tmp_path / "trials.jsonl"
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            run(file, Runner(0))
    run(file, Runner())
    found = load(file)
    assert [each.aborted for each in found if each.kind == ABORTED] == ["nominal: KeyboardInterrupt()"] * 2
    (group,) = groups(found)
    assert (len(group.aborted), len(group.trials)) == (2, 8)
    assert ("runs that were aborted and repeated", "2") in irregular.rows([group])
    assert left(found) == 0
