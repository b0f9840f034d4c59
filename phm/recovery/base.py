"""What a recovery action is: one step on one target, idempotent, with a deadline.

Found through the entry-point group ``phm.actions``; the entry point's name is the name used in ladders.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import ClassVar

from phm.core.clock import Clock, SystemClock
from phm.core.model import Fault
from phm.core.settings import ContainerSettings, Settings
from phm.facts import Attachment, AutopilotFact, CannotTell, ContainerFact, LinkFact
from phm.recovery.containers.cpu_weights import CpuWeights
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.recovery.safety.flight_critical import Impact
from phm.recovery.target import Target
from phm.transport.docker import DockerEngine


class NotNeeded(str):
    """What `Action.run` returns when there was nothing to do: a recovery is then not credited to the action."""

    __slots__ = ()


class ActionFailed(Exception):
    """The action failed; the message says why and what an operator can do."""


class NotYet(ActionFailed):
    """Something that the action needs is missing, and nothing was changed: it is done later, and this does not count as an attempt.

    The message says what is missing.
    """


def container_settings(target: Target) -> ContainerSettings:
    """The settings of a container. Raises ActionFailed for another kind of target."""
    if target.container is None:
        raise ActionFailed(f"{target.name} is not a configured container: correct recovery.ladders")
    return target.container


def _no_graph() -> Mapping[str, int]:
    raise CannotTell("no ROS graph is watched")


def _no_link(link: str, timeout_s: float) -> bool:
    return False


def _no_link_fact(link: str) -> LinkFact | None:
    return None


def _no_autopilot() -> AutopilotFact | None:
    return None


def _not_known_armed() -> ArmedStatus:
    return ArmedStatus(ArmedState.UNKNOWN, "no autopilot is watched")


def _no_hold(key: str, fault: Fault, action: str, at_most_s: float) -> AbstractContextManager[None]:
    return nullcontext()


@dataclass(frozen=True)
class ActionContext:
    """What an action may use. Actions are plug-ins and may read any section of the configuration, so `settings` is all of it.

    engine:     refuses calls that would disturb something flight-critical while armed (`phm.recovery.safety.guarded_engine`).
    container:  the engine's view of a configured container now, or None when there is none.
    own_container: PHM's own container, or None when it runs on the host.
    last_attachment: how a container was attached to a network when that was last observed.
    listed_nodes: ROS nodes in the graph now, with how often each is listed. Raises CannotTell.
    link:       the MAVLink endpoint of this name now, or None when there is none.
    autopilot:  the vehicle's autopilot now, or None when it was never received.
    reopen:     closes and opens the MAVLink endpoint of this name; whether it was open again within this many seconds.
    armed:      the armed state of the vehicle now.
    relief:     lowers CPU weights and restores them later.
    on_hold:    why a container must not be restarted as a dependent: it is on hold, or an operator stopped it; empty: it may.
    lock_dependent: locks a dependent; while it is entered, what fails there follows from the recovery of this fault.
    """

    engine: DockerEngine
    settings: Settings
    container: Callable[[str], ContainerFact | None]
    own_container: Callable[[], ContainerFact | None]
    last_attachment: Callable[[str, str], Attachment | None]
    listed_nodes: Callable[[], Mapping[str, int]] = _no_graph
    link: Callable[[str], LinkFact | None] = _no_link_fact
    autopilot: Callable[[], AutopilotFact | None] = _no_autopilot
    clock: Clock = field(default_factory=SystemClock)
    reopen: Callable[[str, float], bool] = _no_link
    lock_dependent: Callable[[str, Fault, str, float], AbstractContextManager[None]] = _no_hold
    on_hold: Callable[[str], str] = lambda key: ""
    armed: Callable[[], ArmedStatus] = _not_known_armed
    relief: CpuWeights | None = None


class Action(ABC):
    """One step. `on_phm_itself` marks actions on PHM's own container or MAVLink endpoints, which need no opt-in."""

    name: ClassVar[str]
    deadline_s: ClassVar[float] = 20.0
    on_phm_itself: ClassVar[bool] = False
    impact: ClassVar[Impact] = Impact.CONTAINER
    """What the action takes down for a moment; it is not done while armed if that includes something flight-critical."""
    starts: ClassVar[bool] = True
    """Whether it may start or restart its container. The engine may do that late, also after PHM was stopped."""
    verify_after_s: ClassVar[float] = 0.0
    """The unit and everything that needs it must be found OK by runs that began this long after the action: for actions after
    which all looks OK for a moment (a container that starts and exits again, a node that is listed but cut off)."""

    still_bad_after_s: float | None = None
    """A run of the unit's check that began this long after the action and is still ERROR says that it has not helped: for
    actions that work immediately or never. None: the unit's grace and two seconds."""
    dependents_within_s: float | None = None
    """What needs the unit must have recovered this long after the action: for actions after which nothing has to start. None: its grace
    and two seconds, and `verify_after_s`."""

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: Settings) -> bool:
        """Whether the configuration has what this step needs; a step that does not apply is left out of the ladder."""
        return True

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        """What the step needs and is missing, as a sentence; empty: nothing.

        Called before the step is begun, up to once a second, so it must return soon. Raises CannotTell.
        """
        return ""

    @abstractmethod
    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        """Do it; return a sentence for the log. Raises ActionFailed, NotYet, NotPermitted or CannotTell.

        Called again after a failure or a restart of PHM: doing it twice must be harmless. An action that found nothing to
        do returns its sentence as `NotNeeded`.
        """

    def other_cause(self, target: Target, fault: Fault, context: ActionContext) -> str:
        """Called on the same object once the unit is OK again after `run`: what else has made it OK, as a clause for the log.

        Empty: the action is credited. Raises CannotTell, which counts as empty.
        """
        return ""
