"""The worker thread of one target: decides, acts, verifies; one action at a time.

A fault is recovered only when its own check has said OK in a run that began after the action. Until then the tracker holds
the target: what fails because of the action is not a separate fault. Each target has its own thread, so that a container
that cannot be stopped does not delay the recovery of others.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial

from phm.core import threads
from phm.core.model import Event, Fault, Level, Phase
from phm.recovery.attempt import Attempt
from phm.recovery.base import Target, TargetKind, ladder_of
from phm.recovery.fault_cases import (
    ActionReporter,
    AttemptRecord,
    ExternalChanges,
    FaultCase,
    FaultCases,
    History,
    PersistedCase,
    UnfinishedAction,
)
from phm.recovery.ladders import DOWN, RESTORE
from phm.recovery.operator.approval import NotApprovable
from phm.recovery.operator.requests import RESTART, OperatorRequests
from phm.recovery.ownership import Shared
from phm.recovery.policy import PAUSED, Act, ActionRules, Advise, Decision, GiveUp, Wait, decide

logger = logging.getLogger(__name__)

POLL_S = 0.05
ANY_TIME = float("-inf")
RETRY_S = 0.5
"""How often PHM checks again a target on which another attempt acts, and a fault that a new run must confirm."""
FILE_FAULT_S = 1.5
"""After the end of an action, a fault of the files that was hidden by it is reported within this time."""
INTERRUPTED_S = 20.0
"""A target whose action was interrupted is held this long, beyond the unit's grace, unless it recovers before."""
MISSING_S = 1.0
"""While something that an action needs is missing, PHM checks for it this often; usually an event comes first."""
ENDED = ("exited", "oom")
"""Conditions of a container that an operator may have stopped; for one that may have been paused see `PAUSED`."""
NOT_STARTED = "not_started"
"""The condition of a container that was created and waits for its first start (`phm_checks.container`)."""
NOT_STARTED_S = 60.0
"""While the state of such a container is unknown, it counts as not started for this long: its creator has no more time anyway."""
ENGINE, CONTAINER, FILES, ENGINE_DOWN = "engine", "container/", "files/", "engine_down"
"""The unit of the Docker Engine, units of containers, and the condition of an engine that does not respond."""
GENERATION_S = 2.0
"""While attempts on the container count, it is checked this often whether something else has started it again."""


class TargetWorker:
    """The thread of one target. Invariant: at most one action on the target at any time.

    `history` is changed by the thread alone. new_attempt: makes an `Attempt` for a target, a fault and an action.
    """

    def __init__(
        self,
        target: Target,
        history: History,
        shared: Shared,
        rules: ActionRules,
        new_attempt: Callable[..., Attempt],
        publish: Callable[[Event], None],
    ) -> None:
        self._target, self._name, self._history, self._shared, self._rules = target, target.name, history, shared, rules
        self._catalog, self._new_attempt = rules.catalog, new_attempt
        self._pipeline, self._clock, self._locks = shared.pipeline, shared.clock, shared.locks
        self._grace_s, self._generations = shared.grace_s, shared.generations
        self._cases = FaultCases(self._name, self._over)
        self._changes = ExternalChanges(self._name, history, shared)
        self._reporter = ActionReporter(self._name, shared.clock, publish)
        self._requests: OperatorRequests | None = None
        self._lock = threading.Lock()
        self._under_way: UnfinishedAction | None = None
        self._left_down: dict[str, FaultCase] = {}
        self._not_started_at: float | None = None
        """When its container was last known to wait for its first start (monotonic seconds); None: it does not."""
        self._wake = threading.Event()
        self._stopping = False
        threads.start(threading.Thread(target=self._loop, name=f"phm-recover-{self._name}", daemon=True))

    def opened(self, fault: Fault) -> None:
        """A fault of the target was opened, or its condition has changed."""
        self._cases.opened(fault)
        self._wake.set()

    def closed(self, fault: Fault) -> None:
        """A fault of the target was closed."""
        self._cases.closed(fault.unit)
        self._wake.set()

    def _over(self, case: FaultCase) -> None:
        if case.interrupted:
            self._locks.end_action(self._name, case, worked=True)

    def dependency_recovered(self, units: Collection[str], down_from: float) -> None:
        """Something that these units of the target need has recovered, after it was down from then on."""
        self._changes.dependency_recovered(units, down_from)
        self._wake.set()

    def wake(self) -> None:
        """Something that decisions depend on has changed."""
        self._wake.set()

    def stop(self) -> None:
        """Begin nothing more."""
        self._stopping = True
        self._wake.set()

    # ------------------------------------------------------------ over a restart of PHM

    def restored(self, fault: Fault, case: PersistedCase, interrupted: UnfinishedAction | None) -> None:
        """A fault of an earlier run of PHM: what was reported is not reported again, and a new run must confirm it first.

        interrupted: an action for it that was under way when PHM stopped. The target is held for what it broke.
        """
        grace_s = self._grace_s(fault.unit)
        recheck_from = self._clock.mono() + grace_s
        mine = self._cases.restore(fault, case, recheck_from, interrupted=interrupted is not None)
        if case.approved:
            self._operator().approvals.expire(mine, case.approved, "PHM has been restarted or reloaded")
        if interrupted is not None:
            action, at_most_s = interrupted.attempt.action, grace_s + INTERRUPTED_S
            known = self._catalog.get(action)
            leaves_running = known is not None and known.leaves_running
            self._locks.begin_action(self._name, mine, fault.unit, action, at_most_s, leaves_running=leaves_running)
        self._wake.set()

    def persisted(self) -> tuple[dict[str, PersistedCase], UnfinishedAction | None]:
        """For the state file: the cases by fault id, and the action under way."""
        return self._cases.persisted(), self._under_way

    def in_progress(self) -> str:
        """The action under way, or requested by an operator without a fault; empty: none."""
        under_way, requests = self._under_way, self._requests
        if under_way is not None:
            return under_way.attempt.action
        return RESTART if requests is not None and requests.pending else ""

    # ------------------------------------------------------------ requests of an operator

    def approve(self, fault_id: str) -> str:
        """An operator approves what is advised. Returns what will be done. Raises NotApprovable, and NotNow when it may be possible
        later."""
        self._current()
        case = self._cases.find(fault_id)
        if case is None:
            raise NotApprovable(f"{fault_id} is not being handled by recovery")
        unapproved, approved = (self._decide(case.fault, approved=given) for given in (False, True))
        under_way = self._under_way
        busy = under_way.attempt.action if under_way is not None else ""
        detail = self._operator().approvals.approve(case, unapproved, approved, busy=busy)
        self._wake.set()
        return detail

    def restart(self, by: str) -> str:
        """An operator requests a restart. Returns what will be done. Raises NotAllowed, and NotNow when it may be possible later."""
        accepted = self._operator().restart(by, busy=self._under_way is not None)
        self._wake.set()
        return accepted

    def _operator(self) -> OperatorRequests:
        """Made for the first request: mostly there is none."""
        with self._lock:
            if self._requests is None:
                self._requests = OperatorRequests(
                    self._target, self._history, self._shared, self._rules, self._forbids, self._reporter
                )
            return self._requests

    # ------------------------------------------------------------ deciding

    def _loop(self) -> None:
        while not self._stopping:
            self._wake.clear()
            try:
                wait_s = self._next()
            except BaseException:  # a defect or plug-in, even SystemExit, must not end recovery of this target for good
                logger.exception("recovery of %s failed unexpectedly", self._name)
                wait_s = 5.0
            if wait_s != 0:
                self._clock.wait(self._wake, wait_s)

    def _next(self) -> float | None:
        """Handle the most upstream fault first. Returns the seconds to wait (0: decide again now, None: until woken)."""
        starting = self._waits_for_start()  # while nothing is decided, too
        cases = self._current()
        waits = [GENERATION_S] if self._changes.update(cases) else []
        if starting:
            # Only its check can end that, and while a fault is open it has no other reason to run again so soon.
            self._pipeline.recheck(f"{CONTAINER}{self._name}")
            waits.append(MISSING_S)
        if self._requests is not None and self._requests.pending:
            waits.append(self._restart_manually(self._requests))
        for case in self._in_order(cases):
            if 0 in waits:
                return 0
            waits += self._check_approval(case)
            if not case.refused:
                waits += self._handle(case)
        return 0 if 0 in waits else self._keep_starting(waits)

    def _in_order(self, cases: list[FaultCase]) -> list[FaultCase]:
        """Most upstream first. Before that what takes nothing down: an action on PHM itself, and the restoring of a file, which may be the
        cause. But they do not delay the first attempt to bring back a container that is down or paused.
        """
        down = [case.fault for case in cases if case.fault.result.condition in (*DOWN, PAUSED)]
        tried = self._history.attempts
        if not all(any(made.unit == fault.unit and made.at >= fault.opened.mono for made in tried) for fault in down):
            return cases
        first = {RESTORE, *self._catalog.unrestricted}

        def follows(case: FaultCase) -> bool:
            if not self._may_call(case, first):
                return True
            try:
                decision = self._decide(case.fault, approved=case.approval is not None)
            except Exception:  # of an action's own code: it must not keep the others from their turn
                logger.exception("deciding about %s failed", case.fault.unit)
                return True
            return not (isinstance(decision, Act) and decision.action in first)

        return sorted(cases, key=follows)

    def _may_call(self, case: FaultCase, actions: Collection[str]) -> bool:
        """Whether one of these is in its ladder: to decide may ask the engine, and this does not."""
        return not set(ladder_of(case.fault.result.condition, self._rules.settings)).isdisjoint(actions)

    def _handle(self, case: FaultCase) -> list[float]:
        """Act on one fault or wait. Returns the seconds until it must be decided again; empty: only an event can change it."""
        self._changes.note_hold(case, on_hold=self._on_hold())
        recheck_from = self._changes.unconfirmed_since(case)
        if recheck_from is not None:
            return [self._wait_for_confirmation(case.fault.unit, recheck_from)]
        case.recheck_from = None
        decision = self._decide(case.fault, approved=case.approval is not None)
        if not isinstance(decision, Act):
            return self._wait_until(self._report(case, decision))
        if decision.action not in self._catalog.unrestricted and self._changes.generation_changed(case):
            return [0]  # a run must find the fault in this generation
        if not self._pipeline.confirmed_bad(case.fault.unit, ANY_TIME):
            # The decision waited, and the fault may be over: it stays open while its unit is unknown or only a warning.
            return [self._wait_for_confirmation(case.fault.unit, ANY_TIME)]
        if self._lacks_a_file(case):
            return [RETRY_S]
        return [self._perform(case, decision, lambda: self._outdated(case, decision))]

    def _lacks_a_file(self, case: FaultCase) -> bool:
        """Whether a file that PHM can restore was found missing during the attempt that has just failed to bring back the container:
        its fault is about to open, and the file must be there at the next start."""
        tried = [made for made in self._history.attempts if made.unit == case.fault.unit]
        newest = self._pipeline.newest(f"{FILES}{self._name}")
        if case.fault.result.condition not in DOWN or not tried or newest is None or newest.level is not Level.ERROR:
            return False
        just = self._clock.mono() < tried[-1].at + tried[-1].took_s + FILE_FAULT_S
        return just and RESTORE in ladder_of(newest.condition, self._rules.settings)

    def _outdated(self, case: FaultCase, act: Act) -> bool:
        """Whether something has started the container again since the fault was found, or a newer run does not confirm the fault."""
        if act.action not in self._catalog.unrestricted and self._changes.generation_changed(case):
            return True
        return not self._pipeline.confirmed_bad(case.fault.unit, ANY_TIME)

    def _restart_manually(self, requests: OperatorRequests) -> float:
        case = requests.next()
        wait_s = self._perform(case, Act(RESTART, 1)) if case is not None else 0
        if wait_s == 0:
            requests.end()
        return wait_s

    def _keep_starting(self, waits: list[float]) -> float | None:
        """Try from time to time to start a container that is down, also after recovery has given up. Returns as `_next`."""
        down = self._changes.left_down()
        self._left_down = {fault.id: self._left_down.get(fault.id, FaultCase(fault)) for fault in down}
        for fault in down:
            decision = self._decide(fault, approved=False, given_up=True)
            if isinstance(decision, Act):
                waits.append(self._perform(self._left_down[fault.id], decision))
                if waits[-1] == 0:
                    return 0
                continue
            until = decision.until if isinstance(decision, Wait) else getattr(decision, "again_at", None)
            waits += self._wait_until(until)
        return min(waits, default=None)

    def _wait_until(self, until: float | None) -> list[float]:
        return [] if until is None else [max(POLL_S, until - self._clock.mono())]

    def _check_approval(self, case: FaultCase) -> list[float]:
        """When to check its approval again, in seconds; empty: it has none, or it has just expired."""
        if case.approval is None:
            return []
        decision = self._decide(case.fault, approved=True)
        return self._operator().approvals.check(case, decision.action if isinstance(decision, Act) else "")

    def _current(self) -> list[FaultCase]:
        """The open cases, as the tracker has them now: its events may still be on their way through the bus."""
        return self._cases.current(self._pipeline.open_faults)

    def _another_calls(self, case: FaultCase) -> bool:
        """Whether another fault of the target calls for an action."""
        return any(True for _ in self._other_acts(case))

    def _phm_first(self, case: FaultCase, act: Act) -> bool:
        """Whether another fault, confirmed by its newest run, calls for an action on PHM itself, and `act` is not one."""
        own = self._catalog.unrestricted
        return act.action not in own and any(
            other.action in own and self._pipeline.confirmed_bad(unit, ANY_TIME)
            for unit, other in self._other_acts(case, own)
        )

    def _other_acts(self, case: FaultCase, among: frozenset[str] = frozenset()) -> Iterator[tuple[str, Act]]:
        """The actions for which other faults of the target call, with their units. among: only faults with one of these in their ladder."""
        for other in self._current():
            if other.fault.id == case.fault.id or other.refused or self._changes.unconfirmed_since(other) is not None:
                continue
            if among and not self._may_call(other, among):
                continue
            decision = self._decide(other.fault, approved=other.approval is not None)
            if isinstance(decision, Act):
                yield other.fault.unit, decision

    def _wait_for_confirmation(self, unit: str, recheck_from: float) -> float:
        now = self._clock.mono()
        if (hold := self._rules.hold_status(self._name, now).hold) is not None:
            return hold.until - now  # until then its units are STALE, whatever their checks find
        left_s = recheck_from - now
        if left_s > 0:
            return min(left_s, RETRY_S)
        self._pipeline.recheck(unit, *self._pipeline.failing_dependents(unit, recheck_from))
        return RETRY_S

    def _decide(self, fault: Fault, *, approved: bool, given_up: bool = False) -> Decision:
        now, rules = self._clock.stamp(), self._rules
        condition = fault.result.condition
        status = rules.hold_status(self._name, now.mono, ended=condition in ENDED, paused=condition == PAUSED)
        return decide(
            fault,
            self._history,
            now.mono,
            target=self._target,
            forbids=self._forbids,
            settings=rules.settings,
            unrestricted=self._catalog.unrestricted,
            usable=self._catalog.usable(self._target, fault),
            start_s=rules.start_s,
            approved=approved,
            given_up=given_up,
            container_wide=self._catalog.container_wide,
            starved=self._pipeline.starved_by(fault.unit),
            hold=(status.hold.until, status.hold.words(now)) if status.hold is not None else None,
            undecided=status.undecided,
            stopped_by_hand=status.stopped_by_hand,
        )

    def _forbids(self, action: str) -> str:
        """Why the action must wait until the vehicle is disarmed; empty: it need not."""
        guard = self._rules.guard
        return guard.forbids(self._name, self._catalog.impact(action)) if guard is not None else ""

    def _forbidden_now(self, action: str) -> bool:
        return action not in self._catalog.unrestricted and bool(self._forbids(action))

    def _on_hold(self) -> bool:
        status = self._rules.hold_status(self._name, self._clock.mono())
        return status.hold is not None or status.undecided is not None

    def _report(self, case: FaultCase, decision: Decision) -> float | None:
        """Report a decision other than Act, once. Returns when to decide again; None: when an event arrives."""
        name = self._name
        if isinstance(decision, Advise):
            words = f"advised: {decision.action} {name} ({decision.why})"
            self._reporter.report_once(case, decision.action, Phase.ADVISED, words)
        elif isinstance(decision, Wait) and decision.report:
            words = f"no action on {name} for now: {decision.why}"
            self._reporter.report_once(case, decision.subject, Phase.REFUSED, words)
        elif isinstance(decision, GiveUp):
            words = f"gave up on {name}: {decision.why}; {self._target.manual_step()}"
            self._reporter.report_once(case, decision.action, Phase.ESCALATED, words)
            case.refused = True
            self._pipeline.escalate(case.fault.id)
        if isinstance(decision, Wait):
            return decision.until
        return decision.again_at if isinstance(decision, Advise) else None

    # ------------------------------------------------------------ acting

    def _perform(self, case: FaultCase, act: Act, outdated: Callable[[], bool] = lambda: False) -> float:
        """Seconds to wait before deciding again. outdated: whether what was decided no longer holds."""
        fault, action = case.fault, self._catalog.get(act.action)
        if action is None or not self._target.configured:
            what = f"no installed package provides the action {act.action!r}: correct recovery.ladders"
            self._reporter.report_once(case, act.action, Phase.FAILED, what)
            case.refused = True
            return 0
        # In flight the next step may be forbidden: it does not follow, and this one, done again, would change nothing.
        last = all(self._forbidden_now(step) for step in self._catalog.following(self._target, fault, act.action))
        approved_at = case.approval.situation.armed if case.approval is not None else None
        attempt = self._new_attempt(self._target, fault, action, last=last, approved_at=approved_at, alone=act.alone)
        away = self._engine_away()
        if case.engine_was_down and not away:
            # What was known without the engine may be over, or look different with it.
            case.engine_was_down = False
            case.recheck_after(self._clock.mono() + self._grace_s(fault.unit))
            return POLL_S
        case.engine_was_down = bool(away)
        missing = away or self._waits_for_start() or attempt.waits_for()
        if away:
            # An engine that was suspended answers again without an event, and its check has a long period.
            self._pipeline.recheck(ENGINE, f"{CONTAINER}{self._name}")
        if missing:
            self._reporter.report_once(case, act.action, Phase.REFUSED, f"no action on {self._name} for now: {missing}")
            return MISSING_S
        if outdated():
            return POLL_S  # a slow engine may have taken seconds to answer `waits_for`
        record = AttemptRecord(self._clock.mono(), fault.unit, fault.result.condition, act.action, worked=False)
        if not attempt.begin():
            return RETRY_S  # another attempt restarts this container: decided again when that has ended
        if act.action not in self._catalog.unrestricted and self._on_hold():
            attempt.release(worked=False)  # put on hold, or stopped by an operator, since the decision
            return RETRY_S
        case.approval, case.interrupted = None, False
        self._under_way = UnfinishedAction(fault.id, record)
        return self._carry_out(case, act, attempt, record)

    def _engine_away(self) -> str:
        """Why no action on the container can succeed now, as a sentence; empty: the Docker Engine answers. An attempt would only fail.

        It may answer others: a container whose own state is known from elsewhere was not described by it.
        """
        if self._target.kind is not TargetKind.CONTAINER:
            return ""
        newest, own = self._pipeline.newest(ENGINE), self._pipeline.newest(f"{CONTAINER}{self._name}")
        if newest is not None and newest.condition == ENGINE_DOWN:
            return "the Docker Engine does not respond"
        without = own is not None and own.level is Level.ERROR and own.evidence.conclusive
        return "the Docker Engine does not report its state" if without else ""

    def _waits_for_start(self) -> str:
        """Why no action may start the container, as a sentence; empty: it has been started, or nothing is known.

        One request that the engine did not answer does not show that it has been started.
        """
        own, now = self._pipeline.newest(f"{CONTAINER}{self._name}"), self._clock.mono()
        if own is None:
            return ""
        if own.condition == NOT_STARTED:
            self._not_started_at = now
            return own.summary
        if own.level is not Level.STALE:
            self._not_started_at = None
        if self._not_started_at is None or now - self._not_started_at >= NOT_STARTED_S:
            return ""
        return f"it was created, and it is not known whether it has been started: {own.summary}"

    def _carry_out(self, case: FaultCase, act: Act, attempt: Attempt, record: AttemptRecord) -> float:
        """Seconds to wait before deciding again."""
        worked, before = False, self._generations.current(self._name)
        publish = partial(self._reporter.report, case.fault, act.action, attempt=act.attempt)

        def report(phase: Phase, detail: str) -> None:
            if phase is Phase.DONE and self._under_way is not None:
                self._under_way = replace(self._under_way, returned=True)
            publish(phase, detail)

        try:
            outcome = attempt.run(
                report, lambda: self._stopping, lambda: self._another_calls(case), lambda: self._phm_first(case, act)
            )
            if self._stopping and not outcome.worked:
                return 0  # interrupted by the end of PHM: the state file still says that it is under way
            worked = outcome.worked or outcome.undecided
            case.refused = outcome.refused
            self._changes.attempted(
                self._current(), case, before, superseded=outcome.superseded, undecided=outcome.undecided
            )
            took_s = self._clock.mono() - record.at
            done = replace(
                record, worked=outcome.worked, not_counted=outcome.not_counted, partly=outcome.partly, took_s=took_s
            )
            self._end(None if outcome.postponed else done)
            report(outcome.phase, outcome.detail)
            return MISSING_S if outcome.postponed else 0
        finally:
            if self._under_way is not None and not self._stopping:
                self._end(record)
            attempt.release(worked=worked)

    def _end(self, record: AttemptRecord | None) -> None:
        """Count the attempt before it is published, so that it is not lost when PHM is killed in between. None: not tried."""
        if record is not None:
            self._history.add(record)
            if self._requests is not None:
                self._requests.approvals.attempt_ended()
        self._under_way = None
