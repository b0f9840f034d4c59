"""The public interface for checks, both PHM's own and those of plug-ins.

A check is a class that evaluates what probes report about one or more *units*. It is found through the
entry-point group ``phm.checks``; the entry point's name is the check's name::

    from phm import api

    class Battery(api.Check):
        "The battery that feeds the companion computer."
        name, slot, layer = "battery", api.Slot.USER_1, api.Layer.CUSTOM

        def run(self, world: api.World) -> api.Result:
            volts = read_volts()
            if volts < 14.0:
                return api.error(f"battery at {volts:.1f} V, expected 14.0 V or more: land and swap it",
                                 brief=f"battery {volts:.1f} V", condition="battery_low")
            return api.ok(f"battery at {volts:.1f} V", values={"battery_v": volts})

`run` may block, raise and be slow: other checks continue meanwhile. Its runs may be in different threads, never two at a time.
An exception or an exceeded deadline becomes STALE, a statement about PHM and never a fault of the vehicle.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from phm.core.model import Evidence, HostReadings, Layer, Level, NodeVotes, Result, Slot, Value, Values
from phm.core.settings import (
    ContainerSettings,
    DataSettings,
    DeviceSettings,
    EndpointSettings,
    FileSettings,
    HostSettings,
    Limit,
    NodeReadySettings,
    NodeSettings,
    PressureSettings,
    ReadySettings,
    RosSettings,
    Settings,
    TopicSettings,
    TrendSettings,
    WatchedDiagnosticSettings,
)
from phm.core.trend import Forecast, Trend
from phm.facts import (
    AnswerFact,
    Attachment,
    AutopilotFact,
    BeaconFact,
    CannotTell,
    CgroupState,
    ConnectionFact,
    ConsumerFact,
    ContainerFact,
    DataFact,
    DeviceFact,
    DeviceMapping,
    DiagnosticFact,
    DiskFact,
    EndpointFact,
    EnvironmentDifference,
    FieldFact,
    FileFact,
    GcsFact,
    HealthcheckFact,
    HostFact,
    HttpFact,
    LineFact,
    LinkFact,
    LogFact,
    LogMemory,
    MessageValue,
    Mount,
    NameFact,
    NeighbourFact,
    NoAccess,
    NoResponse,
    NotPermitted,
    OtherContainer,
    OutsideFact,
    PeerFact,
    PressureFact,
    ProcessFact,
    ProgramFact,
    RadioFact,
    RateFact,
    Reception,
    RosFact,
    SelfFact,
    SenderFact,
    SerialFact,
    StallFact,
    SwarmFact,
    TopicFact,
    TreeFact,
    World,
)

__all__ = [
    "AnswerFact",
    "Attachment",
    "AutopilotFact",
    "BeaconFact",
    "CannotTell",
    "CgroupState",
    "Check",
    "ConnectionFact",
    "ConsumerFact",
    "ContainerFact",
    "ContainerSettings",
    "DataFact",
    "DataSettings",
    "DeviceFact",
    "DeviceMapping",
    "DeviceSettings",
    "DiagnosticFact",
    "DiskFact",
    "EndpointFact",
    "EndpointSettings",
    "EnvironmentDifference",
    "Evidence",
    "FieldFact",
    "FileFact",
    "FileSettings",
    "Forecast",
    "GcsFact",
    "HealthcheckFact",
    "HostFact",
    "HostReadings",
    "HostSettings",
    "HttpFact",
    "Layer",
    "Level",
    "Limit",
    "LineFact",
    "LinkFact",
    "LogFact",
    "LogMemory",
    "MessageValue",
    "Mount",
    "NameFact",
    "NeighbourFact",
    "NoAccess",
    "NoResponse",
    "NodeReadySettings",
    "NodeSettings",
    "NodeVotes",
    "NotPermitted",
    "OtherContainer",
    "OutsideFact",
    "PeerFact",
    "PressureFact",
    "PressureSettings",
    "ProcessFact",
    "ProgramFact",
    "RadioFact",
    "RateFact",
    "ReadySettings",
    "Reception",
    "Result",
    "RosFact",
    "RosSettings",
    "SelfFact",
    "SenderFact",
    "SerialFact",
    "Settings",
    "Slot",
    "StallFact",
    "SwarmFact",
    "TopicFact",
    "TopicSettings",
    "TreeFact",
    "Trend",
    "TrendSettings",
    "Unit",
    "Value",
    "Values",
    "WatchedDiagnosticSettings",
    "World",
    "bypass",
    "error",
    "ok",
    "stale",
    "topic_id",
    "warn",
    "worst",
]


@dataclass(frozen=True, slots=True)
class Unit:
    """One subject with its own level; a node of the dependency graph.

    id:     ``check`` or ``check/subject``, e.g. ``container/ros_app``, ``nodes/agent_1/node_1``.
    needs:  ids of units that this one depends on. Units that are not configured are ignored.
            When a dependency is bad, this unit is STALE `blocked_by` it instead of a separate fault.
    target: name of the container that a recovery for this unit acts on, or empty. During an action on a
            target, no unit with that target opens a fault.
    settle_s: how long a bad result must last before it is reported, for evidence that arrives before that of
            its cause (a topic falls silent before discovery notices that its node is dead). A result that knows
            better has its own `settle_s`.
    grace_s: how long a bad result counts as `not known yet` after PHM's start, after a dependency recovered, after a
            start of the target and after an action on it (discovery needs seconds to fill the graph).
    memory_s: how long its check may still report OK after the subject is gone (a topic counts as silent only after a while).
            Grace ends early for a unit that has been OK, but not before it has been for longer than this.
    suspect: while this unit is ERROR, each fault that opens names it as a possible cause. It blocks nothing:
            for what can be behind anything but need not be (a full disk, memory used up).
    node:   full name of the ROS node that the action `relaunch` starts for this unit, or empty. Of a topic, its first
            publisher.
    """

    id: str
    needs: tuple[str, ...] = ()
    target: str = ""
    settle_s: float = 0.0
    grace_s: float = 0.0
    memory_s: float = 0.0
    suspect: bool = False
    node: str = ""


class Check(ABC):
    """Base class of checks. Subclass it, name it, and return results for its units from `run`.

    Attributes of the class, or of an instance where no ClassVar: `name` (as in the entry point), `slot`, `layer`; `period_s` how often it runs between
    the passes (None: at each pass only); `deadline_s` after which it is overdue; `failures` how many runs
    in a row must be bad before it is reported. A user may override these three in the configuration.
    """

    name: ClassVar[str]
    slot: Slot
    layer: ClassVar[Layer]
    period_s: float | None = None
    deadline_s: float = 10.0
    failures: int = 1

    @classmethod
    def build(cls, settings: Settings) -> Iterable[Check]:
        """The instances for this configuration. Default: one.

        settings: all of the configuration, because a check may need any section of it.
        """
        return [cls()]

    @property
    def subject(self) -> str:
        """What distinguishes instances of the class, e.g. the container's name; empty for a single instance."""
        return ""

    @property
    def units(self) -> Sequence[Unit]:
        """The units that `run` evaluates. Default: one, named like the check."""
        return (Unit(f"{self.name}/{self.subject}" if self.subject else self.name),)

    @property
    def wakes(self) -> frozenset[str]:
        """Subjects whose events wake this check: ``container:NAME``, ``network``, ``engine``, ``ros``, ``file``, ``device``, ``link``."""
        return frozenset()

    @abstractmethod
    def run(self, world: World) -> Result | Mapping[str, Result]:
        """One result for the only unit, or a result by unit id. A unit left out is STALE."""


def ok(summary: str, *, values: Values | None = None) -> Result:
    """The unit is OK. values: measurements for the log; the name of each has its unit, e.g. ``{"battery_v": 14.8}``."""
    return Result(Level.OK, summary, values=dict(values or {}))


def bypass(summary: str, *, values: Values | None = None) -> Result:
    """Nothing to evaluate: shown as n/a, logged as BYPASS. Alone it leaves its slot unused."""
    return Result(Level.OK, summary, values=dict(values or {}), bypass=True)


def warn(summary: str, *, brief: str, condition: str = "", target: str = "", values: Values | None = None) -> Result:
    """A warning: it opens no fault and starts no recovery. Arguments: as of `error`; `condition` may be empty."""
    return Result(Level.WARN, summary, brief, condition, target, dict(values or {}))


def error(summary: str, *, brief: str, condition: str, target: str = "", values: Values | None = None) -> Result:
    """An error, which opens a fault.

    summary:   for the log: what is wrong, what was expected, what to do.
    brief:     for the operator's line, at most 38 characters, e.g. ``battery 13.2 V``.
    condition: one word such as ``battery_low``; `recovery.ladders` selects the actions by it.
    target:    what an action is applied to: the key of a container, or ``disk:PATH``; empty: no action.
    values:    as of `ok`.
    """
    return Result(Level.ERROR, summary, brief, condition, target, dict(values or {}))


def stale(summary: str, *, brief: str = "", values: Values | None = None) -> Result:
    """The state could not be determined. Never opens a fault and never triggers recovery."""
    return Result(Level.STALE, summary, brief, values=dict(values or {}))


def worst(results: Iterable[Result]) -> Result:
    """The first of the worst results: ERROR, WARN, STALE, OK."""
    return max(results, key=lambda result: result.level.severity)


def topic_id(name: str) -> str:
    """A ROS name as it appears in a unit id: ``/agent_1/node_1`` -> ``agent_1/node_1``."""
    return name.lstrip("/")
