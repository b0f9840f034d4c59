"""Runs a campaign on a running swarm: nominal run, run with recovery off, trials; each is restored before the next."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from phm.transport.priority import SIZES
from sitl.campaign.agent_restoration import restore
from sitl.campaign.busy import BusyLoad
from sitl.campaign.cost_meter import CostMeter
from sitl.campaign.differences import environment_of, of_fault
from sitl.campaign.evidence import known_s
from sitl.campaign.fault_catalog import LEFT_ALONE, OFF as RECOVERY_OFF
from sitl.campaign.injector import Injector, Note
from sitl.campaign.pacing import LASTING_S, WINDOW_S, Pacing
from sitl.campaign.plan import Draw, TrialPlan
from sitl.campaign.profiles import Profile
from sitl.campaign.scoring import judge
from sitl.campaign.swarm_watcher import GroundListener, SwarmWatcher
from sitl.campaign.trial import ABORTED, NOMINAL, OFF, TRIAL, Trial
from sitl.campaign.verdict import places
from sitl.faults.base import Fault
from sitl.harness.log_queries import container_state
from sitl.swarm import config
from sitl.swarm.swarm import Swarm, SwarmAgent

Progress = Callable[[str], None]
POLL_S = 0.05
INJECTED_LIMIT_S = 90.0
AFTER_S = 10.0
"""How long a trial is watched after its faults are recovered or reported: longer than any grace, so late alarms are caught."""
DECIDED_LIMIT_S = 75.0
"""How long clearing waits after that for a unit that may still become a fault: its alarm would be taken for one of clearing."""
STILL_S = 10.0
"""How long nothing may change with recovery off."""
HEALTHY_LIMIT_S = 120.0
STEADY_S = 3.0
"""All must have been OK for this long before the next injection."""
RECORD_LIMIT_S = 60.0
"""PHM tries a file that it could not write again after at most 30 s, and writes something every 20 s."""
OWN_REPAIRS = ("join_network", "reopen")
"""What PHM does to its own container and its own end of a link, in every mode: nothing of the vehicle is touched."""


class NotOk(RuntimeError):
    """The swarm could not be restored to health: the campaign cannot continue."""


def heartbeat_s(agents: int) -> float:
    """PHM's heartbeat period in a swarm of this size."""
    return next(period_s for most, period_s, _ in SIZES if agents <= most)


class Runner:
    """Runs trials. `progress` is called with status lines. `busy`: a load to keep up meanwhile. `setting` is recorded in
    each trial and may be changed between them. `on_end` is called with each trial as soon as it is complete, before the
    swarm is made ready for the next one. `note`: called just before each injection.
    """

    def __init__(
        self,
        swarm: Swarm,
        faults: Mapping[str, Fault],
        profile: Profile,
        progress: Progress,
        busy: BusyLoad | None = None,
        note: Note | None = None,
    ) -> None:
        self.swarm, self.faults, self.profile, self.progress, self.busy = swarm, faults, profile, progress, busy
        self.setting: dict[str, Any] = {}
        self.on_end: Callable[[Trial], None] = lambda trial: None
        self._current: Trial | None = None
        self.agents = {agent.number: agent for agent in swarm.agents}
        self.watch = SwarmWatcher(self.agents, GroundListener(swarm.ground_url), busy=busy is not None)
        self.meter = CostMeter(self.agents)
        self.injector = Injector(
            faults, self.agents, profile, lambda agent, unit: self.watch.levels[agent].bad(unit), note
        )
        self._pacing = Pacing(profile.actions)

    def start(self) -> None:
        """Listen, and wait until all agents are OK and received by the ground. Leftovers of a killed campaign are
        undone.
        """
        self.watch.start()
        self._keep_busy()
        left = [
            agent
            for agent in self.agents.values()
            if agent.config.read_text("utf-8") != config.text(self.swarm.options, agent.number)
        ]
        if left:
            self._configure(left, {})
        if not self._wait(lambda: self.watch.ground.received() >= self.agents.keys(), HEALTHY_LIMIT_S):
            self.progress(
                f"the ground does not receive {sorted(self.agents.keys() - self.watch.ground.received())}; undoing what is left"
            )
        try:
            self._healthy(HEALTHY_LIMIT_S / 2)
        except NotOk:
            for agent in self.agents.values():
                restore(self.swarm, agent)
            self._healthy(HEALTHY_LIMIT_S)
        self.watch.learn()

    def resume(self, trials: Iterable[Trial]) -> None:
        """Take over when this swarm had its last faults and actions."""
        self._pacing.resume(trials, time.monotonic(), time.time())

    def stop(self) -> None:
        self.injector.stop()
        self.watch.stop()
        if self.busy is not None:
            self.busy.stop()

    def _keep_busy(self) -> None:
        if self.busy is not None:
            self.busy.keep()

    def aborted(self, kind: str, number: int, error: BaseException) -> Trial:
        """The record of the run that this error has ended, with what was observed until then."""
        trial = self._current or self._made(kind, number)
        with contextlib.suppress(Exception):  # the error that is reported must not be replaced by another one
            self.watch.end()
        self._current = None
        trial.ended = trial.ended or time.monotonic()
        trial.kind, trial.aborted = ABORTED, f"{kind}: {type(error).__name__}: {error}"
        return trial

    def nominal(self, seconds: float) -> Trial:
        """Nothing is injected."""

        def renewing() -> bool:
            self._keep_busy()
            return False

        self._keep_busy()
        trial = self._begin(NOMINAL, 0)
        self._wait(renewing, seconds)
        return self._end(trial, healthy=not self.watch.not_ok())

    def off(self, seed: int) -> Trial:
        """Inject faults that would be recovered, with recovery off: nothing may change."""
        victims = random.Random(f"phm-campaign-off/{seed}").sample(
            sorted(self.agents), min(len(LEFT_ALONE), len(self.agents))
        )
        draws = [Draw(name, agent) for name, agent in zip(LEFT_ALONE, victims, strict=False)]
        self._keep_busy()
        self._configure([self.agents[agent] for agent in victims], RECOVERY_OFF)
        self._healthy(HEALTHY_LIMIT_S)
        trial = self._begin(OFF, 0)
        try:
            self._inject(trial, draws)
            before = {agent: container_state(self.agents[agent]) for agent in victims}
            self._wait(
                lambda: all(verdict.detected_s is not None for verdict in judge(trial).verdicts),
                self.profile.seen_limit_s,
            )
            self._wait(lambda: False, STILL_S)
            for agent, was in before.items():
                now = container_state(self.agents[agent])
                trial.changed += [
                    f"A{agent:02d}: {key}: {was[key]} became {now[key]}" for key in was if was[key] != now[key]
                ]
            trial.changed += [
                f"A{act.agent:02d}: {act.action} at {act.unit} {act.phase}"
                for act in trial.acts
                if act.phase == "started" and act.action not in OWN_REPAIRS
            ]
        finally:
            self._clear(trial)
        trial = self._end(trial, healthy=self._recover(victims))
        self._configure([self.agents[agent] for agent in victims], {})
        self._healthy(HEALTHY_LIMIT_S)
        return trial

    def trial(self, plan: TrialPlan) -> Trial:
        """Inject the faults, those of one agent in sequence, observe, clear, and wait until all is OK. Raises NotOk if it does
        not recover.
        """
        faults = [self.faults[draw.fault] for draw in plan.draws]
        special = [
            (fault, self.agents[draw.agent])
            for fault, draw in zip(faults, plan.draws, strict=True)
            if "configuration" in fault.needs
        ]
        self._rest(plan.draws)
        self._keep_busy()
        changes: dict[int, dict[str, str]] = {}
        differences = []
        for fault, agent in special:
            fault.prepare(agent)
            mine = fault.configuration(agent)
            changes.setdefault(agent.number, {}).update(mine)
            differences += of_fault(fault, agent, mine, self.swarm.options, environment_of(agent.sidecar))
        for number, more in changes.items():
            self._configure([self.agents[number]], more)
        if special:
            self._healthy(HEALTHY_LIMIT_S)
        trial = self._begin(TRIAL, plan.number)
        trial.differences = differences
        try:
            self._inject(trial, plan.draws)
            self._wait(partial(self._done, trial), self._recovered_limit_s(trial))
            self._wait(lambda: False, AFTER_S)
            self._wait(partial(self._decided, trial), DECIDED_LIMIT_S)
        finally:
            self._clear(trial)
        self._await_records([draw.agent for draw in plan.draws if self.faults[draw.fault].delays_record])
        healthy = self._recover([draw.agent for draw in plan.draws])
        trial = self._end(trial, healthy=healthy)
        for fault, agent in special:
            fault.dismantle(agent)
        for number in changes:
            self._configure([self.agents[number]], {})
        if special or not healthy:
            self._healthy(HEALTHY_LIMIT_S)
        return trial

    def _begin(self, kind: str, number: int) -> Trial:
        trial = self._current = self._made(kind, number)
        self.meter.begin()
        trial.began = time.monotonic()
        self.watch.begin(trial)
        return trial

    def _made(self, kind: str, number: int) -> Trial:
        agents = len(self.agents)
        began, utc = time.monotonic(), time.time()
        return Trial(kind, number, agents, began, utc, heartbeat_s=heartbeat_s(agents), setting=dict(self.setting))

    def _end(self, trial: Trial, *, healthy: bool) -> Trial:
        self.watch.end()
        self._pacing.note(trial)
        trial.healthy_after = trial.ended - trial.began if healthy else None
        trial.cost = self.meter.costs()
        # Until all is OK again: a restored link must be reopened, and a radio's buffer must be sent.
        trial.blind = [
            (fault.agent, fault.moment, trial.ended)
            for fault in trial.injections
            if fault.blinds and fault.moment is not None
        ]
        self._current = None
        self.on_end(trial)
        return trial

    def _inject(self, trial: Trial, draws: Sequence[Draw]) -> None:
        trial.injections = self.injector.planned(draws)
        self.injector.inject(
            trial.injections, lambda futures: self._wait(lambda: all(each.done() for each in futures), INJECTED_LIMIT_S)
        )

    def _clear(self, trial: Trial) -> None:
        self.injector.clear(trial.injections)
        for each in trial.injections:
            self._pacing.ended(each.agent, each.unit, time.monotonic())

    def _await_records(self, agents: Sequence[int]) -> None:
        """Wait until the records of these agents have something newer than now, thus all before it."""
        now = time.monotonic()
        if not self._wait(lambda: all(self.watch.levels[agent].newest > now for agent in agents), RECORD_LIMIT_S):
            self.progress(f"  no new records after {RECORD_LIMIT_S:g} s: the trial is judged by what there is")

    def _recovered_limit_s(self, trial: Trial) -> float:
        """How long the recovery of its faults may take: some can only be detected late."""
        return self.profile.recovered_limit_s + max(
            (known_s(each.fault, each.evidence_s) for each in trial.injections), default=0.0
        )

    def _done(self, trial: Trial) -> bool:
        """Whether every fault is recovered, or reported where it cannot be recovered, or nothing more can be expected
        of it.
        """
        now = time.monotonic()
        for verdict in judge(trial).verdicts:
            fault, begun = verdict.injection, verdict.injection.moment or now
            if verdict.claimed_s is not None or (fault.explained_by and fault.world is not None):
                continue
            expected = (
                now - begun <= self.profile.seen_limit_s + known_s(fault.fault, fault.evidence_s) + fault.hidden_s
            )
            if verdict.detected_s is None and expected:
                return False
            if fault.others and not any(alarm.unit == fault.others for alarm in verdict.alarms):
                if expected:
                    return False
            elif (fault.healable or fault.passes) and verdict.detected_s is not None:
                return False
        return True

    def _decided(self, trial: Trial) -> bool:
        """Whether no unit of an agent with faults may still become a fault."""
        now = time.monotonic()
        known: dict[int, set[str]] = {}
        for each in trial.injections:
            known.setdefault(each.agent, set()).update(places(each))
        return not any(
            self.watch.levels[agent].undecided(self.watch.usual[agent], units, now) for agent, units in known.items()
        )

    def ready_at(self, draws: Sequence[Draw]) -> float:
        """When these may be injected (monotonic seconds)."""
        return self._pacing.ready_at(
            [(each.agent, each.unit) for each in self.injector.planned(draws)], time.monotonic()
        )

    def _rest(self, draws: Sequence[Draw]) -> None:
        """Wait until these may be injected."""
        now, until = time.monotonic(), self.ready_at(draws)
        if until - now > LASTING_S:
            self.progress(f"  waiting {until - now:.0f} s until PHM's budget of actions has room again")
        self._wait(lambda: time.monotonic() >= until, WINDOW_S)

    def _recover(self, victims: Sequence[int]) -> bool:
        """Whether all recovered once the faults were cleared; otherwise restore by force. Also agents into which nothing was
        injected: in an overload of the machine, nodes of any of them may lose each other for good."""
        try:
            self._healthy(HEALTHY_LIMIT_S)
        except NotOk as error:
            self.progress(f"restoring by force: {error}")
            for agent in sorted({*victims, *self.watch.not_ok()}):
                restore(self.swarm, self.agents[agent])
            return False
        return True

    def _healthy(self, limit_s: float) -> None:
        since: list[float] = []

        def steady() -> bool:
            if self.watch.not_ok():
                since.clear()
            elif not since:
                since.append(time.monotonic())
            return bool(since) and time.monotonic() - since[0] >= STEADY_S

        if not self._wait(steady, limit_s):
            words = [f"A{agent:02d}: {', '.join(why[:4])}" for agent, why in self.watch.not_ok().items()]
            raise NotOk(f"not OK after {limit_s:g} s: {'; '.join(words)}")

    def _configure(self, agents: Sequence[SwarmAgent], changes: Mapping[str, str]) -> None:
        """Start the PHM of these agents with their configuration and the changes, in parallel."""
        mark = time.monotonic()
        with ThreadPoolExecutor(len(agents)) as pool:
            at_work = [pool.submit(self.swarm.configure, agent, changes) for agent in agents]
        for future in at_work:
            future.result()
        if not self._wait(lambda: all(self._started(agent.number, mark) for agent in agents), HEALTHY_LIMIT_S):
            late = [agent.name for agent in agents if not self._started(agent.number, mark)]
            raise NotOk(f"PHM did not start again on {', '.join(late)}; see {agents[0].logs}")

    def _started(self, agent: int, mark: float) -> bool:
        return self.watch.levels[agent].since > mark and self.watch.levels[agent].reported

    def _wait(self, wanted: Callable[[], bool], limit_s: float) -> bool:
        """Poll `wanted`; False on timeout."""
        until = time.monotonic() + limit_s
        while True:
            self.watch.update()
            if wanted():
                return True
            if time.monotonic() >= until:
                return False
            time.sleep(POLL_S)
