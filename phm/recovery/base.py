"""What a recovery action is, what it acts on and may use, and which ones are installed.

An action is one step on one target, idempotent, with a deadline. Found through the entry-point group ``phm.actions``; the
entry point's name is the name used in ladders.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, Protocol

from phm.core.clock import Clock, SystemClock
from phm.core.model import Fault
from phm.core.settings import ContainerSettings, HostSettings, NodeSettings, RecoverySettings
from phm.facts import Attachment, AutopilotFact, CannotTell, ContainerFact, LinkFact
from phm.recovery.ladders import LADDERS
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.transport.docker import DockerEngine


class TargetKind(str, Enum):
    """The kind of a target; disks and links are named with it as a prefix, e.g. ``disk:/data``."""

    CONTAINER = "container"
    DISK = "disk"
    LINK = "link"


@dataclass(frozen=True, slots=True)
class Target:
    """One target of recovery.

    key:       the container's key in the configuration, the disk's path, or the endpoint's name.
    opted_in:  whether the configuration allows actions on it: `recover: true` of a container. A disk always has: an action
               removes only files that the configuration names. A link never has: only actions on PHM itself apply to it.
    container: the container's settings; None for other kinds and for a container that is not configured.
    """

    kind: TargetKind
    key: str
    opted_in: bool = False
    container: ContainerSettings | None = None

    @classmethod
    def parse(cls, name: str, containers: Iterable[ContainerSettings]) -> Target:
        """The target that a result names (`Result.target`). containers: those of the configuration."""
        for kind in (TargetKind.DISK, TargetKind.LINK):
            key = name.removeprefix(f"{kind.value}:")
            if key and key != name:
                return cls(kind, key, opted_in=kind is TargetKind.DISK)
        container = next((entry for entry in containers if entry.key == name), None)
        return cls.of(container) if container is not None else cls(TargetKind.CONTAINER, name)

    @classmethod
    def of(cls, container: ContainerSettings) -> Target:
        """The target that is a configured container."""
        return cls(TargetKind.CONTAINER, container.key, container.recover, container)

    @property
    def name(self) -> str:
        """As in `Result.target`, events and logs: a container's key, ``disk:PATH`` or ``link:NAME``."""
        return self.key if self.kind is TargetKind.CONTAINER else f"{self.kind.value}:{self.key}"

    @property
    def configured(self) -> bool:
        """False for a container that is not in the configuration."""
        return self.kind is not TargetKind.CONTAINER or self.container is not None

    def manual_step(self) -> str:
        """What an operator can do after PHM has given up."""
        if self.kind is TargetKind.DISK:
            return f"free space on {self.key} manually: old logs, bags and images (`docker system df`)"
        if self.kind is TargetKind.LINK:
            return f"check the device behind {self.key}: power, cable, settings"
        name = self.container.name if self.container is not None and self.container.name else self.key
        return f"check it manually: docker logs --tail 50 {name}"


class Impact(Enum):
    """What an action takes down for a moment, beside what it does to its target.

    OTHERS:    not the target; calls on other containers are checked one by one.
    NOTHING:   no other container.
    NETWORK:   the network, also of the containers that share the target's network namespace.
    CONTAINER: the target, and with it the containers that depend on it (`phm.recovery.actions.restart.dependents`).
    """

    OTHERS = "others"
    NOTHING = "nothing"
    NETWORK = "network"
    CONTAINER = "container"


class NotNeeded(str):
    """What `Action.run` returns when no action was needed: a recovery is then not credited to the action."""

    __slots__ = ()


class ActionFailed(Exception):
    """The action failed; the message says why and what an operator can do."""


class NotYet(ActionFailed):
    """Something that the action needs is missing, and nothing was changed that has to be verified. The action is done later; this is
    not an attempt.

    The message says what is missing.
    """


class FlightCriticalError(CannotTell):
    """Not done, because something flight-critical would be disturbed while the vehicle may be armed."""


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


def _no_lock(key: str, fault: Fault, action: str, at_most_s: float) -> AbstractContextManager[None]:
    return nullcontext()


MAX_SHARES, MAX_WEIGHT = 262144, 10000
"""The largest CPU weights of the kernel, on cgroup v1 and v2."""


@dataclass(frozen=True, slots=True)
class LoweredWeight:
    """One container whose CPU weight was `shares` before PHM lowered it because of unit `unit`. id: the engine's.

    weight: the kernel's weight on cgroup v2 if the container had no shares; 0: it had, or the weight is not known.
    """

    key: str
    id: str
    shares: int
    unit: str
    weight: int = 0


class CpuRelief(Protocol):
    """Lowers CPU weights and restores them later; `phm.recovery.actions.cpu_weights.CpuWeights` is one."""

    def lower(self, key: str, fact: ContainerFact, unit: str, engine: DockerEngine) -> bool: ...

    def restore(self, lowered: Iterable[LoweredWeight]) -> None: ...

    def kept(self) -> tuple[LoweredWeight, ...]: ...


@dataclass(frozen=True, slots=True)
class ActionSettings:
    """The sections of the configuration that recovery and its actions receive (`phm.runtime.sections`).

    host:        limits of the disks and what may be deleted on them.
    nodes:       the configured ROS nodes of each container, by its key.
    start_s:     how long a start may take (`ros.grace`).
    heartbeat_s: time between two of PHM's own heartbeats on the links (`mavlink.heartbeat`).
    options:     `checks.NAME.options` by the name of the check: for an action that belongs to such a check.
    """

    containers: Sequence[ContainerSettings]
    recovery: RecoverySettings
    host: HostSettings
    nodes: Mapping[str, Sequence[NodeSettings]]
    start_s: float
    heartbeat_s: float
    options: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class ActionContext:
    """What an action may use.

    engine:     refuses calls that would disturb something flight-critical while armed (`phm.recovery.attempt.GuardedEngine`).
    container:  the engine's view of a configured container now, or None when there is none.
    own_container: PHM's own container, or None when it runs on the host.
    last_attachment: how a container was attached to a network when that was last observed.
    own_attachment: the same for PHM's own container.
    reachable:  whether an address responds now, to one ping. Raises CannotTell.
    listed_nodes: ROS nodes in the graph now, with how often each is listed. Raises CannotTell.
    link:       the MAVLink endpoint of this name now, or None when there is none.
    autopilot:  the vehicle's autopilot now, or None when it was never received.
    reopen:     closes and opens the MAVLink endpoint of this name; whether it was open again within this many seconds.
    armed:      the armed state of the vehicle now.
    relief:     lowers CPU weights and restores them later.
    alone:      dependents of the target are left alone: this action is repeated for as long as the container is down.
    restart_ros: starts PHM's own ROS process again, for the reason given; the application is not touched.
    on_hold:    why a container must not be restarted as a dependent: it is on hold, or somebody stops or has stopped it; empty: it may.
    lock_dependent: locks a dependent; inside this context, failures of the dependent are consequences of this recovery. It may be
                waited for, and then acted on, for the given time each, by which the action may take longer.
    """

    engine: DockerEngine
    settings: ActionSettings
    container: Callable[[str], ContainerFact | None]
    own_container: Callable[[], ContainerFact | None]
    last_attachment: Callable[[str, str], Attachment | None]
    own_attachment: Callable[[str], Attachment | None] = lambda network: None
    reachable: Callable[[str], bool] = lambda address: False
    listed_nodes: Callable[[], Mapping[str, int]] = _no_graph
    link: Callable[[str], LinkFact | None] = _no_link_fact
    autopilot: Callable[[], AutopilotFact | None] = _no_autopilot
    clock: Clock = field(default_factory=SystemClock)
    reopen: Callable[[str, float], bool] = _no_link
    lock_dependent: Callable[[str, Fault, str, float], AbstractContextManager[None]] = _no_lock
    on_hold: Callable[[str], str] = lambda key: ""
    armed: Callable[[], ArmedStatus] = _not_known_armed
    relief: CpuRelief | None = None
    restart_ros: Callable[[str], None] = lambda reason: None
    alone: bool = False


class Action(ABC):
    """One step. `on_phm_itself` marks actions on PHM's own container or MAVLink endpoints, which need no opt-in."""

    name: ClassVar[str]
    deadline_s: ClassVar[float] = 20.0
    on_phm_itself: ClassVar[bool] = False
    impact: ClassVar[Impact] = Impact.CONTAINER
    """What the action takes down for a moment; it is not done while armed if that includes something flight-critical."""
    starts: ClassVar[bool] = True
    """Whether it may start or restart its container. The engine may do that late, also after PHM was stopped."""
    leaves_running: ClassVar[bool] = False
    """Whether it ends no process of its target, unless it restarts the target afterwards: then the stop is reported first."""
    verify_after_s: ClassVar[float] = 0.0
    """The unit and everything that needs it must be found OK by runs that began this long after the action: for actions after
    which all looks OK for a moment (a container that starts and exits again, a node that is listed but cut off)."""

    still_bad_after_s: float | None = None
    """A run of the unit's check that began this long after the action and is still ERROR says that it has not helped: for
    actions that work immediately or never. None: the unit's grace and two seconds."""
    dependents_within_s: float | None = None
    """What needs the unit must have recovered this long after the action: for actions after which nothing has to start. None: its grace
    and two seconds, and `verify_after_s`."""

    proven_by_unit: ClassVar[bool] = False
    """Whether the unit alone verifies the action: for actions that only change what PHM sees. What needs the unit then gets its grace
    and is a separate fault if it does not recover."""

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
        """Whether the configuration has what this step needs; a step that does not apply is left out of the ladder."""
        return True

    def limit_s(self, context: ActionContext) -> float:
        """How long `run` may take before it is abandoned, without what `lock_dependent` adds for each dependent.

        For actions whose calls to the engine may last longer if the configuration says so.
        """
        return self.deadline_s

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


def ladder_of(condition: str, settings: RecoverySettings) -> tuple[str, ...]:
    """The user's ladder for the condition, else the built-in one, else none."""
    return tuple(settings.ladders.get(condition, LADDERS.get(condition, ())))


class ActionCatalog:
    """By the names used in ladders.

    unrestricted:   actions on PHM's own container and links: mode, opt-in and armed state do not apply to them.
    container_wide: actions on an entire container, which would recover all of its faults.
    """

    def __init__(self, actions: Mapping[str, type[Action]], settings: ActionSettings) -> None:
        self._actions, self._settings = actions, settings
        self.unrestricted = frozenset(name for name, action in actions.items() if action.on_phm_itself)
        self.container_wide = frozenset(
            name for name, action in actions.items() if action.impact is Impact.CONTAINER and not action.on_phm_itself
        )

    def get(self, name: str) -> type[Action] | None:
        """The action of this name; None when no installed package provides it."""
        return self._actions.get(name)

    def impact(self, name: str) -> Impact:
        """What the action takes down; an action that is not installed counts as taking its container down."""
        action = self.get(name)
        return action.impact if action is not None else Impact.CONTAINER

    def may_start(self, name: str) -> bool:
        """Whether the action may start its container; True also for one that is no longer installed."""
        action = self.get(name)
        return action is None or action.starts

    def usable(self, target: Target, fault: Fault) -> frozenset[str] | None:
        """The steps of the fault's ladder that apply to it; None when the target is not configured.

        A step that is not installed stays, so that it is reported.
        """
        return frozenset(self._steps(target, fault)) if target.configured else None

    def following(self, target: Target, fault: Fault, name: str) -> tuple[str, ...]:
        """The steps of the fault's ladder that follow this one."""
        steps = self._steps(target, fault)
        return steps[steps.index(name) + 1 :] if name in steps else ()

    def _steps(self, target: Target, fault: Fault) -> tuple[str, ...]:
        """The fault's ladder without steps that do not apply; all of it when the target is not configured."""
        ladder = ladder_of(fault.result.condition, self._settings.recovery)
        return tuple(step for step in ladder if not target.configured or self._applies(step, target, fault))

    def _applies(self, step: str, target: Target, fault: Fault) -> bool:
        action = self.get(step)
        return action is None or action.applies(target, fault, self._settings)


def container_settings(target: Target) -> ContainerSettings:
    """The settings of a container. Raises ActionFailed for another kind of target."""
    if target.container is None:
        raise ActionFailed(f"{target.name} is not a configured container: correct recovery.ladders")
    return target.container


def present(target: Target, context: ActionContext) -> ContainerFact:
    """The engine's view of the target. Raises ActionFailed when there is none."""
    key = container_settings(target).key
    fact = context.container(key)
    if fact is None:
        raise ActionFailed(f"there is no container {key}: create it, e.g. docker compose up -d")
    return fact
