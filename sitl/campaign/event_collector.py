"""Converts an agent's record into a trial, and tracks the levels of all its units. Pure."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping

from phm.wire.report import OK_LEVELS
from sitl.campaign.trial import Act, Alarm, RaisedWarning, Start, Summary, Trial
from sitl.harness.log_follower import Event

SHARED = "host/"
"""Units about the machine that all agents of a swarm share; their levels say nothing about one agent."""
BAD_LEVELS = ("WARN", "ERROR")
CPU = "host/cpu"
CPU_AFTER_S = 45.0
"""What an overload did to an application that was started in it, PHM has reported up to 25 s after its end."""
MEMORY = ("companion", "WARN")
"""PHM reports for a while that it restarted or was suspended; after this time it is OK again."""


def note(trial: Trial, agent: int, event: Event) -> None:
    """Put one event of an agent's record into the trial. The end of an earlier fault is not part of it."""
    take = _TAKES.get(event["event"])
    if take is not None:
        take(trial, agent, event)


def _opened(trial: Trial, agent: int, event: Event) -> None:
    unit, slot, summary = event["unit"], event["slot"], event["summary"]
    conditions, brief = [event["condition"]], _brief(event)
    trial.alarms.append(Alarm(agent, unit, slot, event["fault"], event["mono"], conditions, summary, brief=brief))


def _brief(event: Event) -> str:
    """As in the event's STATUSTEXT."""
    return str(event.get("brief") or event["unit"])


def _closed(trial: Trial, agent: int, event: Event) -> None:
    for alarm in _alarms(trial, agent, event):
        alarm.closed, alarm.outcome, alarm.by = event["mono"], event["outcome"], event["by"]


def _changed(trial: Trial, agent: int, event: Event) -> None:
    unit, condition = event["unit"], event["condition"]
    lasting = [each for each in trial.warned if (each.agent, each.unit, each.ended) == (agent, unit, None)]
    if event["level"] == "ERROR":
        known = [alarm.conditions for alarm in _alarms(trial, agent, event)]
    elif event["level"] == "WARN":
        known = [each.conditions for each in lasting]
        if event["old"] != "WARN":
            slot, summary = event["slot"], event["summary"]
            trial.warned.append(
                RaisedWarning(agent, unit, slot, event["mono"], [condition], summary, brief=_brief(event))
            )
    else:
        known = []
        for each in lasting if event["level"] in OK_LEVELS else ():
            each.ended = event["mono"]
    for conditions in known:
        if condition not in conditions:
            conditions.append(condition)


def _acted(trial: Trial, agent: int, event: Event) -> None:
    trial.acts.append(Act(agent, event["unit"], event["action"], event["phase"], event["mono"], event["detail"]))


def _started(trial: Trial, agent: int, event: Event) -> None:
    trial.starts.append(Start(agent, event["mono"]))


def _report_started(trial: Trial, agent: int, event: Event) -> None:
    trial.summaries.append(Summary(agent, event["mono"]))


def _listed(trial: Trial, agent: int, event: Event) -> None:
    if event["level"] in BAD_LEVELS:
        for summary in _unfinished(trial, agent):
            summary.bad.append(event["unit"])


def _reported(trial: Trial, agent: int, event: Event) -> None:
    for summary in _unfinished(trial, agent):
        summary.mono = event["mono"]
    for start in trial.starts:
        if start.agent == agent and start.report is None:
            start.report = event["mono"]


def _unfinished(trial: Trial, agent: int) -> list[Summary]:
    """The agent's report in progress. One that a restart interrupted remains unfinished."""
    return [each for each in trial.summaries if each.agent == agent and each.mono is None][-1:]


_TAKES: dict[str, Callable[[Trial, int, Event], None]] = {
    "fault_opened": _opened,
    "fault_closed": _closed,
    "transition": _changed,
    "action": _acted,
    "start": _started,
    "report_started": _report_started,
    "unit": _listed,
    "report": _reported,
}


def _alarms(trial: Trial, agent: int, event: Event) -> list[Alarm]:
    return [alarm for alarm in trial.alarms if event["fault"] and (alarm.agent, alarm.fault) == (agent, event["fault"])]


class Levels:
    """The levels of all units of one agent, from its record. After a restart of PHM nothing is known until its first
    report. busy: the machine is meant to be overloaded, so a unit that is STALE only for that counts as OK.
    """

    def __init__(self, *, busy: bool = False) -> None:
        self._busy = busy
        self.units: dict[str, str] = {}
        self.open: dict[str, str] = {}
        """Unit by id of the open fault."""
        self.reported = False
        self.since = 0.0
        """When this life of PHM began, in seconds of the monotonic clock."""
        self.cpu_high: float | None = None
        """When PHM last said that the CPU of the machine is busy (monotonic seconds)."""
        self._blocked: set[str] = set()
        """Units that wait for the end of a fault elsewhere than at the machine."""
        self.newest = 0.0
        """When its newest event happened (monotonic seconds)."""

    def take(self, event: Event) -> None:
        kind, self.newest = event["event"], event["mono"]
        if kind == "start":
            self.units.clear()
            self.reported, self.since = False, event["mono"]
        elif kind in ("transition", "unit"):
            unit, level, blocked_by = event["unit"], event["level"], str(event.get("blocked_by") or "")
            if unit == CPU and (level in BAD_LEVELS or self.units.get(unit) in BAD_LEVELS):
                self.cpu_high = event["mono"]
            (self._blocked.add if blocked_by and not blocked_by.startswith(SHARED) else self._blocked.discard)(unit)
            self.units[unit] = "OK" if self._busy and blocked_by.startswith(SHARED) else level
        elif kind == "fault_opened":
            self.open[event["fault"]] = event["unit"]
        elif kind == "fault_closed":
            self.open.pop(event["fault"], None)
        elif kind == "report":
            self.reported = True

    def bad(self, unit: str) -> bool:
        """Whether the unit was already reported: then it would not be reported again."""
        return unit in self.open.values()

    def not_ok(self, usual: Mapping[str, str]) -> list[str]:
        """Which units are worse than `usual`, levels by unit name, as text; empty when none is."""
        if not self.reported:
            return ["no report yet"]
        found = [f"{unit} is faulty" for unit in self.open.values() if not unit.startswith(SHARED)]
        found += [
            f"{unit} is {level}"
            for unit, level in self.units.items()
            if level not in (*OK_LEVELS, usual.get(unit, "OK"))
            and not unit.startswith(SHARED)
            and (unit, level) != MEMORY
        ]
        return found + [f"{unit} is not judged" for unit in usual if unit not in self.units]

    def undecided(self, usual: Mapping[str, str], known: Container[str], now: float) -> list[str]:
        """Units that may become a fault, as text: WARN or STALE, other than those of the `known` faults and what these block. For
        CPU_AFTER_S after a busy CPU it is undecided what that did.
        """
        if not self.reported:
            return ["no report yet"]
        found = [
            f"{unit} is {level}"
            for unit, level in self.units.items()
            if level in ("WARN", "STALE")
            and level != usual.get(unit)
            and unit not in known
            and unit not in self._blocked
            and not unit.startswith(SHARED)
            and (unit, level) != MEMORY
        ]
        lasts = self.units.get(CPU) in BAD_LEVELS
        if not self._busy and self.cpu_high is not None and (lasts or now - self.cpu_high < CPU_AFTER_S):
            found.append(f"{CPU} was bad")
        return found

    def as_usual(self) -> dict[str, str]:
        """The present levels, for `not_ok` later: with nothing injected, some units may be unknown permanently."""
        return {unit: level for unit, level in self.units.items() if not unit.startswith(SHARED)}
