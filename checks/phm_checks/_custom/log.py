"""Type `log`: new lines of a log do not match a pattern."""

from __future__ import annotations

from typing import Any

from phm import api
from phm.api import Level
from phm_checks._custom.base import CustomCheck, Finding
from phm_checks._text import span


class Log(CustomCheck):
    """A pattern that was found is a failure until it has not been found for `quiet`."""

    def __init__(self, entry: Any, settings: api.Settings) -> None:
        super().__init__(entry, settings)
        if "failures" not in entry.model_fields_set:
            self.failures = 1  # the line is there; a second look finds nothing new
        self._found: dict[int, tuple[float, int, str]] = {}
        """By number of the pattern: when it was last found (monotonic seconds), how often since it was quiet, the newest line."""
        self._generation = ""

    def look(self, world: api.World) -> Finding:
        entry = self.entry
        fact = world.logs.follow(
            entry.name,
            patterns=[one.pattern for one in entry.patterns],
            timeout_s=entry.timeout,
            path=entry.path or "",
            container=entry.container or "",
        )
        now = world.clock.mono()
        self._found = {number: seen for number, seen in self._found.items() if now - seen[0] < entry.quiet}
        for number, (count, line) in enumerate(zip(fact.counts, fact.last, strict=True)):
            if count:
                self._found[number] = (now, count + self._found.get(number, (0.0, 0, ""))[1], line)
        if self._restarted(world):
            self._found.clear()
        values: dict[str, api.Value] = {"lines": fact.lines}
        if fact.skipped:
            values["skipped_bytes"] = fact.skipped
        if not self._found:
            return Finding(Level.OK, f"no pattern found in {fact.lines} new lines", values=values)
        number = min(self._found, key=lambda one: (entry.patterns[one].level == "warn", one))
        _, count, line = self._found[number]
        level = Level.WARN if entry.patterns[number].level == "warn" else Level.ERROR
        pattern = entry.patterns[number].pattern
        text = f"{pattern[:80]!r} found, expected not within {span(entry.quiet)}; newest line: {line[:200]}"
        return Finding(level, text, "log match", {**values, "matches": count})

    def _restarted(self, world: api.World) -> bool:
        """Whether the container that recovery acts on was started since the last run. What was found until now is of its former
        run: it must not let the restart fail, or cause another one."""
        if not self._acts_on:
            return False
        try:
            fact = world.docker.container(self._acts_on)
        except api.CannotTell:
            return False
        if fact is None or not fact.running:
            return False
        before, self._generation = self._generation, fact.generation
        return before not in ("", fact.generation)
