"""Type `mavlink`: a message of the vehicle arrives, and a field of it is within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from phm import api
from phm.api import Level
from phm_checks._command_path import all_closed, link_id, to_autopilot
from phm_checks._custom.base import CustomCheck, Finding, bad
from phm_checks._custom.limits import Reading, judge
from phm_checks._text import span


class Mavlink(CustomCheck):
    """Messages count on links that lead to the autopilot. While the autopilot is lost, that is the fault."""

    def __init__(self, entry: Any, settings: api.Settings) -> None:
        super().__init__(entry, settings)
        self._since: float | None = None
        """When it first looked (monotonic seconds): after a reload of the configuration nothing has been received, either."""

    @property
    def units(self) -> Sequence[api.Unit]:
        (unit,) = super().units
        links = tuple(link_id(entry) for entry in to_autopilot(self.settings))
        return (replace(unit, needs=(*unit.needs, *links, "autopilot")),)

    def observe(self, world: api.World) -> Finding:
        entry, name = self.entry, self.entry.message
        self._since = world.clock.mono() if self._since is None else self._since
        values = world.messages.values(name, entry.field, component=entry.component, instance=entry.instance)
        if not values and entry.component == 1 and world.links.autopilot() is None:
            raise api.CannotTell(f"no {name}: no autopilot has been received")
        if all_closed(world, to_autopilot(self.settings)):
            raise api.CannotTell(f"{name} unknown: every link to the autopilot is closed")
        if not values:
            return self._never(world.clock.mono() - self._since)
        findings = [self._judge(value, several=len(values) > 1) for value in values]
        known = [found for found in findings if isinstance(found, Finding)]
        worst = max(known, key=lambda found: found.level.severity, default=None)
        unknown = [found for found in findings if isinstance(found, str)]
        if worst is not None and (worst.level is not Level.OK or not unknown):
            return worst
        raise api.CannotTell(unknown[0])

    def _never(self, watched_s: float) -> Finding:
        entry = self.entry
        if watched_s < max(entry.max_age, entry.grace):
            raise api.CannotTell(f"no {entry.message} received yet")
        which = "" if entry.instance is None else f" of instance {entry.instance}"
        instead = "" if entry.request else ": let the autopilot send it, or request it with 'request'"
        return bad(
            f"{entry.message}{which} was never received from component {entry.component}{instead}", "never received"
        )

    def _judge(self, value: api.MessageValue, *, several: bool) -> Finding | str:
        """The finding about one instance, or why its value is not known."""
        entry = self.entry
        which = f" {value.instance}" if several and value.instance is not None else ""
        what, age_s = f"{entry.field} of {entry.message}{which}", round(value.silent_s, 1)
        if value.silent_s > entry.max_age:
            words = f"{entry.message}{which} was last received {span(age_s)} ago, expected within {span(entry.max_age)}"
            return bad(words, "not received", age_s=age_s)
        if value.unknown:
            return f"{what} is not known: the sender reports {value.text}, which means that it does not know the value"
        return judge(entry, what, Reading(value.number, value.number, text=value.text, unit=value.unit), age_s=age_s)
