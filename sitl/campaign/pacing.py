"""When the next faults may be injected: not before PHM has forgotten enough of the last ones. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

from sitl.campaign.plan import TrialPlan
from sitl.campaign.trial import Trial

LASTING_S = 31.0
"""Longer than `recovery.verify`, 30 s: before that, the same unit's next failure counts as a repair that did not last."""
WINDOW_S = 600.0
"""`recovery.window`: for this long an action counts against `recovery.budget`."""


SAME_CLOCK_S = 60.0
"""The wall clock may have been corrected by this much since the record was written."""


class Pacing:
    """actions: most actions on an agent within `WINDOW_S` before its next fault; None: any number."""

    def __init__(self, actions: int | None) -> None:
        self._actions = actions
        self._ended: dict[tuple[int, str], float] = {}
        self._acted: dict[int, list[float]] = {}

    def ended(self, agent: int, unit: str, mono: float) -> None:
        """A fault at this unit is over."""
        self._ended[agent, unit] = max(mono, self._ended.get((agent, unit), mono))

    def resume(self, trials: Iterable[Trial], now: float, utc: float) -> None:
        """Take over what a record says about this swarm. Trials of before the machine's last boot are of another clock."""
        for trial in trials:
            if abs((utc - now) - (trial.utc - trial.began)) > SAME_CLOCK_S:
                continue
            self.note(trial)
            for each in trial.injections:
                if each.asked is not None:
                    self.ended(each.agent, each.unit, each.cleared or trial.ended)

    def note(self, trial: Trial) -> None:
        """The trial is over."""
        for act in trial.acts:
            if act.phase == "started":
                self._acted.setdefault(act.agent, []).append(act.mono)

    def ready_at(self, units: Collection[tuple[int, str]], now: float) -> float:
        """The time from which faults may be injected at these units of agents; not after `now` when that is already so."""
        times = [self._ended[each] + LASTING_S for each in units if each in self._ended]
        return max([*times, *(self._room_at(agent, now) for agent in {agent for agent, _ in units})], default=now)

    def _room_at(self, agent: int, now: float) -> float:
        recent = sorted(each for each in self._acted.get(agent, ()) if each > now - WINDOW_S)
        if self._actions is None or len(recent) <= self._actions:
            return now
        return recent[-1 - self._actions] + WINDOW_S


def first_ready(waiting: Sequence[TrialPlan], ready_at: Callable[[TrialPlan], float], now: float) -> TrialPlan:
    """The first of the plan that may run now; if all must wait, the one that waits least. Otherwise one agent whose budget is
    used up would hold up all others.
    """
    return min(waiting, key=lambda trial: (max(now, ready_at(trial)), trial.number))
