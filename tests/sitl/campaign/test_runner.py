"""The runs of a campaign on a swarm that does not exist: what is recorded, and in which order things are done."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from phm_checks.container import UNSTARTED_ALONE_S
from sitl.campaign import irregular, runner as campaign_runner
from sitl.campaign.busy import LASTS_S, RENEW_S
from sitl.campaign.groups import groups
from sitl.campaign.pacing import WINDOW_S, Pacing
from sitl.campaign.plan import Draw, TrialPlan
from sitl.campaign.profiles import ALL
from sitl.campaign.runner import NotOk, Runner
from sitl.campaign.trial import ABORTED, Load, Trial
from sitl.faults.base import Agent, Fault
from sitl.faults.memory_leak import LASTS_S as LEAK_S
from tests.fakes.campaign_trials import T0, injection, started, trial

PLAN = TrialPlan(4, (Draw("planned", 1),))


class Planned(Fault):
    """Is reported nowhere, and does nothing."""

    name, title, unit, condition, layer, cause = "planned", "planned", "", "", "companion", "a test"

    def inject(self, agent: Agent) -> float:
        return time.monotonic()


class Steps:
    """What the runner did, in order."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def keep(self) -> None:
        self.done.append("load")

    def note(self, what: str) -> bool:
        self.done.append(what)
        return True

    def stop(self) -> None:
        """Nothing runs."""


@pytest.fixture
def steps() -> Steps:
    return Steps()


@pytest.fixture
def runner(tmp_path: Path, steps: Steps, monkeypatch: pytest.MonkeyPatch) -> Runner:
    """One agent, all is OK immediately, and no wait lasts."""
    agent = Mock(number=1, record=tmp_path / "phm.jsonl")
    agent.name = "agent_1"
    swarm = Mock(agents=[agent], ground_url="udpin:127.0.0.1:0")
    made = Runner(swarm, {"planned": Planned()}, ALL["shipped"], lambda words: None, steps)  # type: ignore[arg-type]
    made.meter = Mock(costs=list)
    made.injector._world = Mock()  # there is nothing to observe
    monkeypatch.setattr(made, "_wait", lambda wanted, limit_s: wanted() or True)
    monkeypatch.setattr(made, "_healthy", lambda limit_s: None)
    monkeypatch.setattr(made, "_rest", lambda draws: steps.done.append("rest"))
    monkeypatch.setattr(made, "_configure", lambda agents, changes: steps.done.append("configure"))
    begin, inject = made._begin, made._inject
    monkeypatch.setattr(made, "_begin", lambda *words: steps.note("begin") and begin(*words))
    monkeypatch.setattr(made, "_inject", lambda *words: steps.note("inject") and inject(*words))
    return made


def test_a_trial_is_complete_before_the_swarm_is_made_ready(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """`on_end` has it although the swarm does not recover."""
    found: list[Trial] = []
    runner.on_end = found.append

    def not_ok(limit_s: float) -> None:
        raise NotOk("not OK")

    monkeypatch.setattr(runner, "_healthy", not_ok)
    monkeypatch.setattr(campaign_runner, "restore", lambda swarm, agent: None)
    with pytest.raises(NotOk):
        runner.trial(PLAN)
    assert [(each.number, each.healthy_after, bool(each.injections)) for each in found] == [(4, None, True)]


def test_an_agent_that_only_suffered_from_a_fault_is_restored_too(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An overload of the machine is injected on one agent; what it did to the others must not end the campaign."""
    restored: list[object] = []
    runner.agents = {number: Mock(number=number) for number in (1, 2, 3)}
    monkeypatch.setattr(runner, "_healthy", Mock(side_effect=NotOk("not OK")))
    monkeypatch.setattr(runner.watch, "not_ok", lambda: {3: ["consensus is WARN"]})
    monkeypatch.setattr(campaign_runner, "restore", lambda swarm, agent: restored.append(agent.number))
    assert not runner._recover([1])
    assert restored == [1, 3]


def test_an_aborted_run_has_what_was_observed(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its kind, the error, its injections; one that was not begun has none of them."""
    runner.setting = {"seed": 7}
    error = KeyboardInterrupt()
    monkeypatch.setattr(runner, "_recover", Mock(side_effect=error))
    with pytest.raises(KeyboardInterrupt):
        runner.trial(PLAN)
    made = runner.aborted("trial", 4, error)
    assert (made.kind, made.number, made.aborted) == (ABORTED, 4, "trial: KeyboardInterrupt: ")
    assert [each.fault for each in made.injections] == ["planned"]
    assert made.ended >= made.began
    early = runner.aborted("trial", 5, NotOk("not OK"))
    assert (early.number, early.aborted, early.injections) == (5, "trial: NotOk: not OK", [])
    assert early.setting == {"seed": 7}


def test_the_events_of_the_last_trial_are_kept(runner: Runner, tmp_path: Path) -> None:
    """Those of its time alone, by agent, until the next one begins: the campaign keeps them if the trial has a problem."""

    def log(*moments: float) -> None:
        lines = [json.dumps({"event": "received", "mono": moment}) + "\n" for moment in moments]
        with (tmp_path / "phm.jsonl").open("a") as file:
            file.writelines(lines)

    log(time.monotonic())
    first = runner._begin("trial", 1)
    log(first.began - 1, first.began + 1)
    runner._end(first, healthy=True)
    log(first.began + 2)
    runner.watch.update()
    assert runner.watch.events == {1: [{"event": "received", "mono": first.began + 1}]}
    runner._begin("trial", 2)
    assert runner.watch.events == {1: []}


def test_a_trial_has_what_was_recorded_only_after_the_fault(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """While PHM's log is read-only, its record is kept in memory: the trial ends when it is written."""
    levels, late = runner.watch.levels[1], []

    def wait(wanted: Callable[[], bool], limit_s: float) -> bool:
        if limit_s == campaign_runner.RECORD_LIMIT_S:
            late.append(wanted())
            levels.take({"event": "received", "mono": time.monotonic()})
            late.append(wanted())
        return True

    monkeypatch.setattr(runner, "_wait", wait)
    runner.trial(PLAN)
    assert late == [True, True], "nothing is awaited of other faults"
    late.clear()
    monkeypatch.setattr(Planned, "delays_record", True)
    runner.trial(PLAN)
    assert late == [False, True]


def test_the_load_is_renewed_after_the_pause(runner: Runner, steps: Steps) -> None:
    """A pause may last as long as the load; also before a nominal run, during it, and before the run with recovery off."""
    runner.trial(PLAN)
    assert steps.done[:3] == ["rest", "load", "begin"]
    steps.done.clear()
    runner.nominal(1.0)
    assert steps.done == ["load", "begin", "load"]
    steps.done.clear()
    runner.faults = {}
    with pytest.raises(KeyError):
        runner.off(1)
    assert steps.done[:2] == ["load", "configure"]


def test_the_load_outlasts_a_trial() -> None:
    """Also the longest one: PHM's restart until all is OK, a slow injection, recovery, and until all is OK again."""
    assert (
        3 * campaign_runner.HEALTHY_LIMIT_S + 2 * LEAK_S + ALL["as-found"].recovered_limit_s + campaign_runner.AFTER_S
        <= LASTS_S - RENEW_S
    )


def test_with_recovery_off_the_world_is_compared_with_that_of_the_injection(
    runner: Runner, steps: Steps, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What PHM changes until the detection counts as a change."""
    states = iter(({"id": "old"}, {"id": "new"}))

    def state(agent: Any) -> dict[str, str]:
        steps.done.append("look")
        return next(states)

    monkeypatch.setattr(campaign_runner, "container_state", state)
    monkeypatch.setattr(campaign_runner, "LEFT_ALONE", ("planned",))
    monkeypatch.setattr(runner, "_wait", lambda wanted, limit_s: steps.note("wait"))
    made = runner.off(1)
    after = steps.done.index("inject")
    assert steps.done[after : after + 5] == ["inject", "wait", "look", "wait", "wait"]
    assert made.changed == ["A01: id: old became new"]


def test_slow_faults_have_longer_to_recover(runner: Runner) -> None:
    """A HEALTHCHECK every 30 s, as in `as-found`, delays detection and the proof of recovery; so does one that hangs."""
    made = trial(injections=[injection(fault="made_up", evidence_s=33.0), injection(evidence_s=None)])
    assert runner._recovered_limit_s(made) == 90.0 + 33.0
    runner.profile = ALL["as-found"]
    assert runner._recovered_limit_s(made) == 150.0 + 33.0
    created = trial(injections=[injection(fault="container_created", evidence_s=0.1)])
    assert runner._recovered_limit_s(created) > 150.0 + UNSTARTED_ALONE_S, "PHM waits for its creator"


def test_a_fault_that_an_outage_of_the_engine_hides_is_awaited_longer(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PHM can report it only when the engine is back."""
    monkeypatch.setattr(time, "monotonic", lambda: T0 + 40.0)
    for hidden_s, done in ((0.0, True), (25.0, False)):
        made = trial(injections=[injection(world=None, evidence_s=0.1, hidden_s=hidden_s)], alarms=[], acts=[])
        assert runner._done(made) is done


def test_a_campaign_on_a_running_swarm_knows_its_last_actions(runner: Runner) -> None:
    """The budget of PHM was not renewed because the campaign was stopped."""
    act, now = started(0.0, agent=1), time.monotonic()
    act.mono = now - 1.0
    runner._pacing = Pacing(0)
    runner.resume([trial(acts=[act], began=now - 2.0, utc=time.time() - 2.0)])
    assert runner._pacing.ready_at([(1, "nodes/a")], now) == act.mono + WINDOW_S


def test_a_busy_run_without_its_load_is_listed() -> None:
    """By the mean of the machine's samples of the run alone; without samples it is not known."""

    def made(load: str, *used: float) -> Trial:
        samples = [Load(each, cpu, 10.0, 10.0) for each, cpu in zip((50.0, 100.0, 110.0), (0.0, *used), strict=False)]
        return trial(setting={"profile": "shipped", "load": load, "seed": 1}, machine=samples)

    assert not irregular.unloaded(made("busy", 99.0, 96.0))
    assert irregular.unloaded(made("busy", 99.0, 20.0))
    assert irregular.unloaded(made("busy"))
    assert not irregular.unloaded(made("quiet", 10.0, 10.0))
    found = groups([made("busy", 10.0), made("quiet", 10.0)])
    assert irregular.rows(found)[1][1:] == ("-", "1")


def test_a_trial_has_the_differences_that_it_made(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each fault that needs a configuration, also in an aborted trial."""

    class Special(Planned):
        needs = frozenset({"configuration"})

        def configuration(self, agent: Agent) -> dict[str, str]:
            return {"a": "b"}

    runner.faults = {"planned": Special()}
    runner.injector = Mock(planned=Mock(return_value=[]))
    monkeypatch.setattr(
        campaign_runner, "of_fault", lambda fault, agent, changes, options, environment: [{"key": changes["a"]}]
    )
    monkeypatch.setattr(campaign_runner, "environment_of", lambda container: {})
    assert runner.trial(PLAN).differences == [{"key": "b"}]
    error = RuntimeError("no")
    monkeypatch.setattr(runner, "_inject", Mock(side_effect=error))
    with pytest.raises(RuntimeError):
        runner.trial(PLAN)
    assert runner.aborted("trial", 4, error).differences == [{"key": "b"}]


def test_a_fault_is_not_cleared_before_everything_is_decided(
    runner: Runner, steps: Steps, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An alarm of what the recovery left behind must come before the clearing."""

    def wait(wanted: Callable[[], bool], limit_s: float) -> bool:
        return steps.note(f"decided {wanted()}") if limit_s == campaign_runner.DECIDED_LIMIT_S else True

    monkeypatch.setattr(runner, "_wait", wait)
    monkeypatch.setattr(runner, "_clear", lambda made: steps.done.append("clear"))
    levels = runner.watch.levels[1]
    for event in ({"event": "report"}, {"event": "unit", "unit": "consensus", "level": "STALE"}):
        levels.take({"mono": time.monotonic(), **event})
    runner.trial(PLAN)
    levels.take({"mono": time.monotonic(), "event": "transition", "unit": "consensus", "level": "OK"})
    runner.trial(PLAN)
    assert [each for each in steps.done if each.startswith(("decided", "clear"))] == [
        "decided False",
        "clear",
        "decided True",
        "clear",
    ]
