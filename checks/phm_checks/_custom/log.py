"""Type `log`: new lines of a log do not match a pattern."""

from __future__ import annotations

from collections.abc import Iterable
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

    def observe(self, world: api.World) -> Finding:
        entry, memory = self.entry, world.logs.memory(self.entry.name)
        fact = world.logs.follow(
            entry.name,
            patterns=[one.pattern for one in entry.patterns],
            timeout_s=entry.timeout,
            path=entry.path or "",
            container=entry.container or "",
        )
        now = world.clock.mono()
        memory.begun = now if memory.begun is None else memory.begun
        numbers = {one.pattern: number for number, one in enumerate(entry.patterns)}
        for pattern, seen in list(memory.found.items()):
            if pattern not in numbers or now - seen[0] >= entry.quiet:
                del memory.found[pattern]
        for one, count, line in zip(entry.patterns, fact.counts, fact.last, strict=True):
            if count:
                memory.found[one.pattern] = (now, count + memory.found.get(one.pattern, (0.0, 0, ""))[1], line)
        if self._restarted(world, memory):
            memory.found.clear()
            memory.begun = float("-inf")
        values: dict[str, api.Value] = {"lines": fact.lines}
        if fact.skipped:
            values["skipped_bytes"] = fact.skipped
        if not memory.found:
            # After a restart of PHM, what was found before counts until the log has been quiet.
            evidence = api.Evidence(unobserved_of=self._without(numbers) if now - memory.begun < entry.quiet else ())
            return Finding(Level.OK, f"no pattern found in {fact.lines} new lines", values=values, evidence=evidence)
        first = min(map(numbers.__getitem__, memory.found), key=lambda one: (entry.patterns[one].level == "warn", one))
        pattern, level = entry.patterns[first].pattern, entry.patterns[first].level
        _, count, line = memory.found[pattern]
        text = f"{pattern[:80]!r} found, expected not within {span(entry.quiet)}; newest line: {line[:200]}"
        found = Level.WARN if level == "warn" else Level.ERROR
        return Finding(
            found, text, "log match", {**values, "matches": count}, api.Evidence(subjects=self._without(memory.found))
        )

    def _without(self, patterns: Iterable[str]) -> tuple[str, ...]:
        """`Evidence.subjects` of matches: with another log or pattern the failure is over."""
        return tuple(f"{self.entry.path or self.entry.container} without {pattern[:80]!r}" for pattern in patterns)

    def _restarted(self, world: api.World, memory: api.LogMemory) -> bool:
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
        before, memory.generation = memory.generation, fact.generation
        return before not in ("", fact.generation)
