"""What a campaign observes from outside during a trial: the world, and the cost of the sidecars; and how it waits between."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import Mock

import pytest
from docker.errors import APIError, DockerException

from sitl.campaign.cost_meter import CostMeter
from sitl.campaign.injector import Injector
from sitl.campaign.pacing import LASTING_S, WINDOW_S, Pacing
from sitl.campaign.plan import Draw
from sitl.campaign.profiles import ALL
from sitl.campaign.trial import INTERRUPTION_S, Injection
from sitl.campaign.world import POLL_S, Series, WorldObserver
from sitl.faults._cgroups import cpu_of
from sitl.faults.base import Agent, Fault
from tests.fakes.campaign_trials import T0, injection, trial, verified
from tests.fakes.until import until

LIMIT_S = 60.0


class Observed(Fault):
    """A fault whose observations are given."""

    name, title, unit, condition, layer, cause = "observed", "observed", "nodes/a", "node_missing", "ros", "a test"
    answers: ClassVar[list[bool | Exception | None]] = []

    def __init__(self, *answers: bool | Exception | None) -> None:
        self.given, self.asked = list(answers), 0
        self.agents: list[Agent] = []

    def inject(self, agent: Agent) -> float:
        return time.monotonic()

    def restored(self, agent: Agent) -> bool | None:
        self.agents.append(agent)
        answer = self.given[min(self.asked, len(self.given) - 1)]
        self.asked += 1
        if isinstance(answer, Exception):
            raise answer
        return answer


def unseen(**more: Any) -> Injection:
    """The world was not observed yet."""
    return injection(**{"world_seen": False, "world_broken": None, "world": None, **more})


def series(*observations: tuple[float, bool | None]) -> tuple[Injection, Series]:
    made = unseen()
    found = Series(made)
    for mono, restored in observations:
        found.add(restored, mono)
    return made, found


def test_restored_counts_from_the_last_unbroken_series() -> None:
    """A world that breaks again was not restored; one that cannot be observed says nothing."""
    made, _ = series((1.0, None))
    assert (made.world_seen, made.world_broken, made.world) == (False, None, None)
    made, _ = series((1.0, None), (2.0, True), (3.0, False), (4.0, True), (5.0, False), (7.0, True), (8.0, True))
    assert (made.world_seen, made.world_broken, made.world) == (True, 3.0, 7.0)
    assert (made.interruptions, made.interrupted_s) == (0, 0.0)


def test_a_short_interruption_does_not_delay_the_restoration() -> None:
    """Nor does the next one, if the world was as before for long enough in between."""
    made, found = series((1.0, False), (4.0, True), (6.0, False))
    assert found.interrupted(6.0) and not found.interrupted(8.0)
    assert made.world == 4.0
    for mono, restored in ((7.9, True), (9.9, False), (10.4, True)):
        found.add(restored, mono)
    assert not found.interrupted(10.4)
    assert (made.world, made.interruptions, made.interrupted_s) == (4.0, 2, 2.4)


@pytest.mark.parametrize(
    "broken",
    [
        pytest.param(((6.0, False), (7.0, False), (8.0, False)), id="too long"),
        pytest.param(((5.9, False),), id="too soon"),
        pytest.param(((6.0, False), (6.5, True), (8.4, False)), id="again too soon"),
        pytest.param(((6.0, False), (6.5, True), (6.7, False), (6.9, True), (7.1, False)), id="flickering"),
    ],
)
def test_a_world_that_breaks_again_was_not_restored(broken: Sequence[tuple[float, bool]]) -> None:
    """A fault that looks over now and then stays one."""
    made, found = series((1.0, False), (4.0, True), *broken)
    assert (made.world, found.interrupted(8.4)) == (None, False)


class Flickering(Observed):
    """Restored, and once broken when `breaks` is set."""

    breaks = True

    def restored(self, agent: Agent) -> bool | None:
        answer, self.breaks = not self.breaks, False
        return answer


def test_an_interruption_is_observed_to_its_end() -> None:
    """The end of a trial does not decide whether the world is restored."""
    fault = Flickering()
    made = unseen(fault="observed", asked=time.monotonic(), moment=time.monotonic())
    observer = WorldObserver({"observed": fault}, {3: Agent("p", "agent_3", docker=Mock(), number=3)}, Mock)
    observer.start([made])
    until(lambda: made.world is not None and time.monotonic() - made.world > INTERRUPTION_S + POLL_S)
    restored, fault.breaks = made.world, True
    until(lambda: not fault.breaks)
    observer.stop()
    assert (made.world, made.interruptions) == (restored, 1)


def test_a_world_that_cannot_be_observed_during_an_interruption_ends_the_observation() -> None:
    """It was not observed restored again, and the campaign goes on."""
    fault = Observed(False, True)
    made = unseen(fault="observed", asked=time.monotonic(), moment=time.monotonic())
    observer = WorldObserver({"observed": fault}, {3: Agent("p", "agent_3", docker=Mock(), number=3)}, Mock)
    observer.start([made])
    until(lambda: made.world is not None and time.monotonic() - made.world > INTERRUPTION_S + POLL_S)
    fault.given = [*[True] * (fault.asked + 5), False, None]
    until(lambda: fault.asked > len(fault.given))
    observer.stop()
    assert made.world is None
    assert not any(thread.name == "world observed" for thread in threading.enumerate())


def test_the_world_is_observed_from_the_injection_on() -> None:
    """Not before it begins; with a separate Docker client; until the observer is stopped. An error of Docker is not an answer."""
    fault, clients = Observed(False, APIError("busy"), True), [Mock(), Mock()]
    agent = Agent("p", "agent_3", docker=Mock(), number=3)
    observer = WorldObserver({"observed": fault}, {3: agent}, iter(clients).__next__)
    made = unseen(fault="observed", asked=None, moment=None)
    observer.start([made])
    assert fault.asked == 0
    made.asked = made.moment = time.monotonic()
    until(lambda: made.world is not None)
    observer.stop()
    asked = fault.asked
    assert made.world_broken is not None
    assert made.world is not None
    assert made.moment <= made.world_broken < made.world
    assert {each.docker for each in fault.agents} == {clients[0]}
    clients[0].close.assert_called_once_with()
    assert fault.asked == asked


def test_a_world_that_is_restored_before_the_injection_returns_was_broken() -> None:
    """PHM may reconnect a network while the injector still waits for the engine's answer; that nothing is broken yet, or cannot be
    observed, says nothing meanwhile.
    """
    fault = Observed(True, APIError("busy"), False, True)
    observer = WorldObserver({"observed": fault}, {3: Agent("p", "agent_3", docker=Mock(), number=3)}, Mock)
    made = unseen(fault="observed", asked=time.monotonic(), moment=None)
    observer.start([made])
    until(lambda: fault.asked > 5)
    ended_s, looks = time.monotonic(), fault.asked
    until(lambda: fault.asked > looks + 1)  # the look of this moment may have begun earlier
    assert made.world is None
    made.moment = ended_s
    until(lambda: made.world is not None)
    observer.stop()
    assert made.world_broken is not None
    assert made.world is not None
    assert made.world_broken < made.moment <= made.world


def test_a_fault_that_was_not_injected_is_not_observed() -> None:
    """Its observer ends by itself."""
    fault = Observed(True)
    made = unseen(fault="observed", asked=None, moment=None, error="RuntimeError: refused")
    observer = WorldObserver({"observed": fault}, {3: Agent("p", "agent_3", docker=Mock(), number=3)}, Mock)
    observer.start([made])
    until(lambda: not any(thread.name == "world observed" for thread in threading.enumerate()))
    assert (fault.asked, made.world_seen) == (0, False)


def test_an_unexpected_error_ends_no_observation() -> None:
    """A look that fails says nothing, and interrupts a series of looks at a restored world."""
    fault = Observed(False, True, subprocess.TimeoutExpired("top", 2.0), True)
    made = unseen(fault="observed", asked=time.monotonic(), moment=time.monotonic())
    observer = WorldObserver({"observed": fault}, {3: Agent("p", "agent_3", docker=Mock(), number=3)}, Mock)
    found = Series(made)
    assert [observer._ask(made, Mock(), found) for _ in range(2)] == [False, True]
    made.world = 5.0
    assert observer._ask(made, Mock(), found) is None
    assert [made.world, made.world_broken] == [None, None]
    fault.asked = 0
    observer.start([made])
    until(lambda: fault.asked > 3 and made.world is not None)
    observer.stop()


def test_a_cause_that_was_not_injected_explains_nothing() -> None:
    """Then the fault beside it must be reported by a separate alarm."""

    class Killed(Observed):
        name, unit = "killed", "container/ros_app"

        def inject(self, agent: Agent) -> float:
            raise RuntimeError("refused")

    class Cut(Observed):
        name, unit = "cut", "network/ros_app"

    class Silent(Observed):
        name, unit = "silent", "rates/agent_3/topic_1"

    faults = {"silent": Silent(None), "killed": Killed(None), "cut": Cut(None)}
    agents = {3: Agent("p", "agent_3", docker=Mock(), number=3)}
    injector = Injector(faults, agents, ALL["shipped"], lambda agent, unit: False)
    injector._world = WorldObserver(faults, agents, Mock)  # no engine
    for others, cause in (((), ""), (("cut",), "cut")):
        made = injector.planned([Draw("silent", 3), *(Draw(name, 3) for name in others), Draw("killed", 3)])
        assert made[0].explained_by == "killed"
        injector.inject(made, lambda futures: None)
        assert made[0].explained_by == cause
        injector.stop()


@pytest.mark.parametrize(("after", "renewed"), [("10:02", True), ("10:01", False), (None, None)])
def test_a_clearing_that_starts_a_container_is_recorded(after: str | None, renewed: bool | None) -> None:
    """By the times at which the engine has started the containers of the agent; None: they are not known."""
    app = Mock(id="a", attrs={"State": {"StartedAt": "10:01"}})

    class Cleared(Observed):
        def clear(self, agent: Agent) -> None:
            app.attrs = {"State": {"StartedAt": after}}
            if after is None:
                agent.docker.containers.list.side_effect = DockerException("away")  # type: ignore[attr-defined]

    engine = Mock(**{"containers.list.return_value": [app]})
    agents = {3: Agent("p", "agent_3", docker=engine, number=3)}
    injector = Injector({"node_killed": Cleared(None)}, agents, ALL["shipped"], lambda agent, unit: False)
    injector._world = Mock()
    made = injection(asked=1.0, cleared=None)
    injector.clear([made])
    assert (made.renewed, made.error) == (renewed, "")


def cgroup(folder: Path, cpu_s: float) -> None:
    """A reader never finds a file of a kernel empty, so each is replaced as a whole."""
    folder.mkdir(exist_ok=True)
    for name, number in (("cpuacct.usage", round(cpu_s * 1e9)), ("cgroup.procs", threading.get_native_id())):
        new = folder / f"{name}.new"
        new.write_text(f"{number}\n", "ascii")
        new.replace(folder / name)


def test_the_cost_of_a_restarted_sidecar_is_complete(tmp_path: Path) -> None:
    """CPU time from before the trial does not count; after a restart the counter begins at 0 again."""
    asked = threading.Semaphore(0)

    def find(number: int) -> Path:
        asked.release()
        return tmp_path / str(number)

    cgroup(tmp_path / "1", 100.0)
    meter = CostMeter({1: Mock()}, find)
    meter.begin()
    assert asked.acquire(timeout=LIMIT_S)
    until(lambda: bool(meter._meters[1].rss))
    cgroup(tmp_path / "1", 102.0)
    until(lambda: meter._meters[1].used_s == 2.0)
    cgroup(tmp_path / "1", 0.5)
    until(lambda: meter._meters[1].used_s == 2.5)
    cgroup(tmp_path / "1", 0.75)
    (cost,) = meter.costs()
    assert cost.cpu_s == 2.75
    assert cost.pss_mb is not None
    assert 0 < cost.rss_mb <= (cost.peak_mb or 0)


def test_a_sidecar_that_never_ran_has_no_cost() -> None:
    """It is left out, instead of counted as free."""

    def find(_: int) -> Path:
        raise LookupError("it does not run")

    meter = CostMeter({1: Mock()}, find)
    meter.begin()
    assert meter.costs() == []


def test_cpu_time_of_both_versions_of_cgroups(tmp_path: Path) -> None:
    """Version 1 counts nanoseconds, version 2 microseconds."""
    (tmp_path / "cpu.stat").write_text("usage_usec 1500000\nuser_usec 7\n", "ascii")
    assert cpu_of(tmp_path) == 1.5
    cgroup(tmp_path, 2.5)
    assert cpu_of(tmp_path) == 2.5
    with pytest.raises(OSError, match="No such file"):
        cpu_of(tmp_path / "gone")


def test_a_unit_rests_after_its_fault() -> None:
    """Other units do not wait for it."""
    pacing = Pacing(None)
    pacing.ended(3, "nodes/a", 100.0)
    assert pacing.ready_at([(3, "nodes/a")], 110.0) == 100.0 + LASTING_S
    assert pacing.ready_at([(3, "nodes/b"), (4, "nodes/a")], 110.0) == 110.0
    assert pacing.ready_at([], 110.0) == 110.0


def test_a_resumed_campaign_knows_the_last_trials() -> None:
    """Their faults and actions; those of before the last boot were on another clock."""
    acts = [verified(0.0)]
    acts[0].phase = "started"
    made = trial(acts=acts, injections=[injection(asked=T0, cleared=T0 + 20, unit="nodes/a")])
    offset = made.utc - made.began
    for other_boot, ready in ((0.0, T0 + WINDOW_S), (5000.0, T0 + 30)):
        pacing = Pacing(0)
        pacing.resume([made], T0 + 30, T0 + 30 + offset + other_boot)
        assert pacing.ready_at([(3, "nodes/b")], T0 + 30) == ready
    pacing = Pacing(None)
    pacing.resume([made], T0 + 30, T0 + 30 + offset)
    assert pacing.ready_at([(3, "nodes/a")], T0 + 30) == T0 + 20 + LASTING_S


def test_an_agent_waits_for_its_budget() -> None:
    """With at most two actions in the window, a third one makes it wait until the first has left the window."""
    acts = [verified(after) for after in (0.0, 50.0, 80.0)]
    for act in acts:
        act.phase = "started"
    pacing, free = Pacing(2), Pacing(None)
    for each in (pacing, free):
        each.note(trial(acts=acts))
    first = acts[0].mono
    assert pacing.ready_at([(3, "files/a")], first + 100) == first + WINDOW_S
    assert pacing.ready_at([(4, "files/a")], first + 100) == first + 100
    assert pacing.ready_at([(3, "files/a")], first + WINDOW_S) == first + WINDOW_S
    assert free.ready_at([(3, "files/a")], first + 100) == first + 100
