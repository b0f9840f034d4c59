"""Builds the installed reporters that are configured, each with its own queue on the bus."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from phm.checking import registry
from phm.core.bus import Bus
from phm.reporters.base import Reporter, ReporterContext

logger = logging.getLogger(__name__)


class ReporterManager:
    """Builds and closes reporters. Each is a plug-in: an exception in one does not affect the others."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._reporters: list[Reporter] = []

    def start(self, context: ReporterContext) -> None:
        """Build and subscribe them; call it before the first result, so that none misses it."""
        for found in registry.find(registry.REPORTERS, Reporter):
            if found.loaded is None:
                continue
            try:
                kind: type[Reporter] = found.loaded
                reporter = kind.build(context)
            except Exception:  # the others must still report
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
        return [problem for reporter in self._reporters if (problem := reporter.problem())]

    def reports(self) -> dict[str, dict[str, Any]]:
        """Reports by name, without empty ones."""
        return {reporter.name: report for reporter in self._reporters if (report := reporter.report())}

    def closers(self, *, last: bool = True) -> tuple[tuple[str, Callable[[], None]], ...]:
        """What closes each, by name; call it after the bus is closed, which delivers queued events. `last`: PHM ends, too."""
        return tuple((each.name, each.close if last else each.hand_over) for each in self._reporters)
