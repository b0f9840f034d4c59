"""Carries out one action: in a thread of its own, within its deadline, on containers that nobody else has in hand."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

from phm.core import threads
from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, NotPermitted
from phm.recovery.base import Action, ActionFailed, NotNeeded, NotYet
from phm.recovery.safety.armed_state import ArmedState
from phm.recovery.safety.flight_critical import FlightCriticalError, Impact
from phm.recovery.safety.guarded_engine import GuardedEngine
from phm.recovery.safety.target_locks import TargetBusy
from phm.recovery.shop import Shop
from phm.transport.docker import DockerEngine

logger = logging.getLogger(__name__)

ASK_S = 5.0
"""An action says within this time what else has helped."""


@dataclass(frozen=True, slots=True)
class ActionResult:
    """What came of it: a sentence for the log, whether the step was done, and whether it was not permitted.

    forbidden: the vehicle was armed between the decision and the call to the engine.
    postponed: nothing was done because something that it needs is not there.
    unneeded:  there was nothing to do.
    """

    detail: str
    ok: bool = False
    refused: bool = False
    forbidden: bool = False
    postponed: bool = False
    unneeded: bool = False


class Acting:
    """One action on `target` for `fault`. Its owner has the target in hand; dependants are taken as they are needed.

    approved_at: the armed state at which an operator has approved it; None: not approved.
    """

    def __init__(
        self, shop: Shop, target: ContainerSettings, fault: Fault, action: Action, approved_at: ArmedState | None = None
    ) -> None:
        self._approved_at = approved_at
        self._shop, self._target, self._fault, self._action = shop, target, fault, action
        self._engine = GuardedEngine(shop.context.engine, shop.flight_critical_guard, self._forbids)
        self._given_up = False
        self._outcome: list[ActionResult] = []
        self._go, self._finished = threading.Event(), threading.Event()

    def begin(self) -> bool:
        """Take the target in hand; False when another container's repair is restarting it, or somebody is stopping it: it must
        not be killed before the time is over that it was given to end. False also when no thread can be started: an action
        that cannot even begin does not count as an attempt.
        """
        if self._shop.pipeline.is_stopping(self._target.key) or not self._shop.hands.take(self._target.key, self):
            return False
        name = f"phm-act-{self._action.name}-{self._target.key}"
        if threads.start_now(threading.Thread(target=self._in_thread, name=name, daemon=True)):
            return True
        self.release_target()
        return False

    def run(self) -> ActionResult:
        """Do it, and let the target go. A plug-in that hangs costs its deadline and no more."""
        self._go.set()
        try:
            if self._shop.clock.wait(self._finished, self._action.deadline_s):
                return self._outcome[0]
            return ActionResult(f"{self._action.name} has not come back within {self._action.deadline_s:g} s")
        finally:
            self.release_target()

    def other_cause(self) -> str:
        """What else has made the unit OK, see `Action.other_cause`. A plug-in that hangs or crashes costs ASK_S, and says nothing."""
        said: list[str] = []

        def ask() -> None:
            with contextlib.suppress(CannotTell):
                said.append(self._action.other_cause(self._target, self._fault, self._shop.context))

        name = f"phm-credit-{self._action.name}-{self._target.key}"
        thread = threading.Thread(target=ask, name=name, daemon=True)
        if threads.start_now(thread):
            thread.join(ASK_S)
        return said[0] if said else ""

    def release_target(self) -> None:
        """From now on, others may act on the target; what still runs begins nothing more."""
        self._given_up = True
        self._go.set()
        self._shop.hands.release_target(self._target.key, self)

    def _in_thread(self) -> None:
        self._go.wait()
        try:
            if not self._given_up:
                self._outcome.append(self._work())
        finally:
            self._finished.set()

    def _work(self) -> ActionResult:
        engine = self._engine
        context = replace(self._shop.context, engine=cast(DockerEngine, engine), holding=self._holding)
        try:
            with self._life(engine):
                said = self._action.run(self._target, self._fault, context)
            return ActionResult(str(said), ok=True, unneeded=isinstance(said, NotNeeded))
        except FlightCriticalError as error:
            return ActionResult(str(error), forbidden=True)
        except NotPermitted as error:
            return ActionResult(f"healing not permitted: {error}; PHM only reports this fault", refused=True)
        except NotYet as error:
            return ActionResult(str(error), postponed=True)
        except (ActionFailed, CannotTell) as error:
            return ActionResult(str(error))
        except BaseException as error:  # plug-in code, which may also exit: its thread is ours, and the attempt failed
            logger.exception("action %s crashed", self._action.name)
            return ActionResult(f"the action crashed: {type(error).__name__}: {error}")

    def _life(self, engine: GuardedEngine) -> contextlib.AbstractContextManager[None]:
        """What an operator starts or stops while an action is at work that starts nothing is not PHM's doing."""
        key = self._target.key
        return (
            self._shop.lives.acting(key, key, engine.take_unanswered)
            if self._action.starts
            else contextlib.nullcontext()
        )

    def _forbids(self, key: str, reach: Impact) -> str:
        return self._shop.flight_critical_guard.forbids(key, reach, self._approved_at)

    @contextlib.contextmanager
    def _holding(self, key: str, fault: Fault, action: str, at_most_s: float) -> Iterator[None]:
        """A dependant is in this repair's hand, raises no fault of its own meanwhile, and its new life is PHM's doing."""
        hands = self._shop.hands
        with hands.on(key, self, at_most_s):
            if self._given_up:
                raise TargetBusy(f"{action} of {self._target.key} was given up meanwhile")
            if self._shop.pipeline.is_stopping(key):
                raise TargetBusy(f"{key} is being stopped")
            hands.hold(key, self, fault.unit, action, at_most_s)
            try:
                with self._shop.lives.acting(key, self._target.key, self._engine.take_unanswered):
                    yield
            finally:
                hands.release(key, self, worked=True)
