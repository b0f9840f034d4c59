"""Builds the installed reporters that are configured, each with its own queue on the bus."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from typing import Any

from phm.checking import registry
from phm.core.bus import Bus
from phm.reporters.base import Reporter, ReporterContext

logger = logging.getLogger(__name__)
_WRONG = "reporter {} cannot be asked for its problem: {!r}"


class ReporterManager:
    """Builds and closes reporters. Each is a plug-in: an exception in one does not affect the others."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._reporters: list[Reporter] = []
        self._failing: set[str] = set()

    def start(self, context: ReporterContext) -> None:
        """Build and subscribe them; call it before the first result, so that none misses it."""
        for found in registry.find(registry.REPORTERS, Reporter):
            if found.loaded is None:
                continue
            try:
                kind: type[Reporter] = found.loaded
                reporter = kind.build(context)
            except (Exception, SystemExit):  # the others must still report
                logger.exception("reporter %s cannot be started", found.name)
                continue
            if reporter is not None:
                self._reporters.append(reporter)
                self._bus.subscribe(
                    reporter.name,
                    reporter.handle,
                    kinds=reporter.kinds,
                    size=reporter.queue_size,
                    tick=reporter.tick,
                    period_s=reporter.period_s,
                )

    def problems(self) -> list[str]:
        """What each reporter cannot do at the moment, also that it cannot be asked."""
        asked = ((each, self._ask(each, each.problem)) for each in self._reporters)
        found = [(each, problem) for each, problem in asked if problem]
        return [problem if isinstance(problem, str) else _WRONG.format(each.name, problem) for each, problem in found]

    def reports(self) -> dict[str, dict[str, Any]]:
        """Reports by name, without empty ones and those that are no JSON."""
        found = {each.name: self._ask(each, each.report) for each in self._reporters}
        return {name: report for name, report in found.items() if report and isinstance(report, dict)}

    def _ask(self, reporter: Reporter, question: Callable[[], Any]) -> Any:
        """The answer, as JSON allows it, or an exception, logged once: it may be a plug-in's, of any kind."""
        try:
            answer = question()
            json.dumps(answer, default=str)
        except BaseException as error:
            if reporter.name not in self._failing:
                logger.exception("reporter %s cannot be asked for its state", reporter.name)
            self._failing.add(reporter.name)
            return error
        return answer

    def closers(self, *, last: bool = True) -> tuple[tuple[str, Callable[[], None]], ...]:
        """What closes each, by name; call it after the bus is closed, which delivers queued events. `last`: PHM ends, too."""
        return tuple((each.name, each.close if last else each.hand_over) for each in self._reporters)
