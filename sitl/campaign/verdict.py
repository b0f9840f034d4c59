"""What is known about one injected fault after scoring. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from sitl.campaign.trial import Alarm, Injection, RaisedWarning, Trial

BESIDE = "host/"
"""All agents share one machine: any of them may report its load."""
PEERS = "peers/"
"""Every other agent keeps the same unit about an agent that it misses; together they are one alarm."""

ACTION, PHM, DOCKER, INJECTOR, ITSELF = (
    "action of PHM",
    "restart or watchdog of PHM",
    "restart policy of Docker",
    "timer of the injector",
    "itself",
)
ENDINGS = (ACTION, PHM, DOCKER, INJECTOR, ITSELF)
"""What can end a fault before the campaign clears it."""
EARLY_S = 1.0
"""PHM's claim may be this much earlier than the observation from outside, which takes time, too."""
FLOOR_S = 0.1
"""A shorter evidence limit, e.g. of an event of the kernel, counts as this: a ratio of milliseconds says nothing."""


@dataclass
class Verdict:
    """One injected fault. Seconds since it began, `Injection.moment`; None: it did not happen."""

    trial: int
    kind: str
    injection: Injection
    expected: int
    alarms: list[Alarm] = field(default_factory=list)
    after: list[Alarm] = field(default_factory=list)
    """Alarms after it was cleared that clearing has not caused, e.g. of damage by its recovery: too many, and they detect nothing."""
    detected_s: float | None = None
    response_s: float | None = None
    logged_s: float | None = None
    """Detection as the paper defines it: PHM's response was complete and in its log."""
    published_s: float | None = None
    """Response as the paper defines it: the next periodic report after the detection was published."""
    published_due: bool = False
    """That report came after the end of the trial, and `published_s` is when it was due."""
    listed_s: float | None = None
    """A periodic report that lists the fault as bad was published."""
    claimed_s: float | None = None
    """PHM's record says that the fault is over."""
    world_s: float | None = None
    """The injector observed that the world is restored."""
    by: str = ""
    """What PHM's record says has ended it: an action, or words."""
    ended_by: str = ""
    """One of ENDINGS; empty: PHM's record does not say that it is over."""
    disturbed: bool = False
    """Between the fault and its detection the agent was busy with something else (`sitl.campaign.disturbance`)."""
    wrong: str = ""
    """Why the reported cause is wrong, in words; empty: it is right, or nothing was reported."""
    cause: Verdict | None = None
    """The fault on the same agent that explains this one: one alarm, at the cause, reports both."""

    @property
    def since(self) -> list[Alarm]:
        """The alarms since the fault began."""
        return [alarm for alarm in self.alarms if alarm.mono >= (self.injection.moment or 0.0)]

    @property
    def before(self) -> list[Alarm]:
        """Alarms of side effects of the injection: the fault did not exist yet."""
        return [alarm for alarm in self.alarms if alarm not in self.since]

    @property
    def missed(self) -> bool:
        """Not reported. The alarm of the fault that explains it reports it for as long as that one lasts; when that one
        is over and this one is not, nothing has reported this one.
        """
        if self.cause is not None and not self.since:
            lasts = self.observed and self.world_s is None
            return self.cause.missed or (lasts and self.cause.claimed_s is not None)
        return self.detected_s is None and not self.since

    @property
    def right(self) -> bool:
        if self.cause is not None and not self.since:
            return self.cause.right and not self.missed
        return not self.missed and not self.wrong

    @property
    def through_cause(self) -> bool:
        """It was reported by the alarm of the fault that explains it alone, so it has no times of detection."""
        return self.cause is not None and self.detected_s is None and not self.cause.missed and not self.missed

    @property
    def count(self) -> int:
        """The number of alarms; reports of several agents about the same peer count once."""
        return counted(self.alarms) + counted(self.after)

    @property
    def excess(self) -> int:
        """Alarms more than expected."""
        return max(0, counted(self.alarms) - self.expected) + counted(self.after)

    @property
    def lacking(self) -> list[str]:
        """Units at which an alarm is expected of the agent or, for `others`, of another one, and none was raised. A
        fault whose condition is a warning may be reported by that alone.
        """
        fault = self.injection
        if not self.expected or self.missed:
            return []
        own = {alarm.unit for alarm in self.since if alarm.agent == fault.agent}
        others = {alarm.unit for alarm in self.since if alarm.agent != fault.agent}
        units = places(fault) if fault.level == "ERROR" else []
        return [unit for unit in units if unit not in own] + [
            unit for unit in (fault.others,) if unit and unit not in others
        ]

    @property
    def evidence_limit_s(self) -> float | None:
        """The moment, on average, at which anything on board could know of the fault: it begins at any moment of a period. What only the
        engine knows is known at the end of its outage at the earliest.
        """
        fault = self.injection
        return None if fault.evidence_s is None else max(fault.evidence_s - fault.evidence_period_s / 2, fault.hidden_s)

    @property
    def evidence_ratio(self) -> float | None:
        """The detection divided by the moment, on average, at which anything on board could know of the fault."""
        if self.evidence_limit_s is None or self.detected_s is None:
            return None
        return self.detected_s / max(self.evidence_limit_s, FLOOR_S)

    @property
    def observed(self) -> bool:
        """The injector could observe the world."""
        return self.injection.world_seen

    @property
    def recovered_s(self) -> float | None:
        """PHM's claim, confirmed from outside: the later of the two."""
        if self.claimed_s is None or self.world_s is None or not self.seen_broken:
            return None
        return max(self.claimed_s, self.world_s)

    @property
    def seen_broken(self) -> bool:
        """The world was observed to be broken, before it was observed to be restored."""
        broken, restored = self.injection.world_broken, self.injection.world
        return broken is not None and (restored is None or broken <= restored)

    @property
    def never_broken(self) -> bool:
        """PHM's record says that an action has ended the fault, and the world was only ever seen as before."""
        return self.ended_by == ACTION and self.observed and not self.seen_broken

    @property
    def by_action_possible(self) -> bool:
        """An action of PHM can end it: neither a restart of PHM nor a timer of the injector does."""
        fault = self.injection
        return fault.healable and bool(fault.unit) and not (fault.phm or fault.passes)

    @property
    def by_action(self) -> bool:
        """Self-resolved as the paper counts it: an action of PHM ended the fault, confirmed from outside."""
        return self.ended_by == ACTION and self.recovered_s is not None

    @property
    def difference_s(self) -> float | None:
        """Seconds from the observation to PHM's claim; negative: PHM said so first."""
        if self.claimed_s is None or self.world_s is None:
            return None
        return self.claimed_s - self.world_s

    @property
    def claimed_wrongly(self) -> bool:
        """PHM says that the fault is over; the world says that it is not."""
        return self.observed and self.claimed_s is not None and self.world_s is None

    @property
    def claimed_early(self) -> bool:
        difference_s = self.difference_s
        return difference_s is not None and difference_s < -EARLY_S

    @property
    def unnoticed(self) -> bool:
        """The world is restored before the fault was cleared; PHM does not say so."""
        return self.world_s is not None and self.claimed_s is None


@dataclass
class ScoredTrial:
    """A trial: its faults and the alarms that belong to none of them: false ones; `beside`, about the shared machine, that its
    measured load confirms; `app_broken`, about an application that was observed not to work without a fault; and those that
    clearing has caused, and warnings at the unit of the fault after it: a fault that was not recovered is mostly cleared by a restart.
    """

    trial: Trial
    verdicts: list[Verdict]
    false: list[Alarm]
    beside: list[Alarm]
    app_broken: list[Alarm]
    clearing: list[Alarm | RaisedWarning]


def counted(alarms: Sequence[Alarm]) -> int:
    """The number of alarms that an operator sees."""
    own = sum(not alarm.unit.startswith(PEERS) for alarm in alarms)
    reported = Counter((alarm.unit, alarm.agent) for alarm in alarms if alarm.unit.startswith(PEERS))
    most: dict[str, int] = {}
    for (unit, _), number in reported.items():
        most[unit] = max(most.get(unit, 0), number)
    return own + sum(most.values())


def places(injection: Injection) -> list[str]:
    """Units at which an alarm is expected."""
    return [unit for unit in (injection.unit, *injection.also) if unit]


def until(injection: Injection) -> float:
    """When it was cleared, on the monotonic clock; infinite: not yet. What comes later neither detects nor reports it."""
    return injection.cleared if injection.cleared is not None else math.inf


def due(injection: Injection) -> int:
    """The number of alarms that a fault is expected to raise: none for a warning, unless an alarm comes before it, and
    none where another explains it.
    """
    if injection.explained_by:
        return 0
    units = set(places(injection) if injection.level == "ERROR" or injection.earlier else ()) | {injection.others}
    return len(units - {""})


def expects(injection: Injection, alarm: Alarm) -> bool:
    """Whether the fault is expected to raise this alarm: on its agent, or on the others."""
    if alarm.agent == injection.agent:
        return alarm.unit in places(injection)
    return bool(injection.others) and alarm.unit == injection.others
