"""The reporters of this PHM: those installed and wanted, each with a queue of its own on the bus."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from phm.checking import registry
from phm.core.bus import Bus
from phm.reporters.base import Reporter, ReporterContext

logger = logging.getLogger(__name__)


class ReporterManager:
    """Builds and closes them. Each is a plug-in: what one raises costs that one alone."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._reporters: list[Reporter] = []

    def start(self, context: ReporterContext) -> None:
        """Before the first result, so that nobody misses it."""
        for found in registry.find(registry.REPORTERS, Reporter):
            if found.loaded is None:
                continue
            try:
                kind: type[Reporter] = found.loaded
                reporter = kind.build(context)
            except Exception:  # the others report all the same
                logger.exception("reporter %s could not be built", found.name)
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
        """By name, of those that have something to say."""
        return {reporter.name: report for reporter in self._reporters if (report := reporter.report())}

    def closers(self, *, last: bool = True) -> tuple[tuple[str, Callable[[], None]], ...]:
        """What ends each, by name: to be called after the bus, which hands out what is queued. `last`: PHM ends with them."""
        return tuple((each.name, each.close if last else each.hand_over) for each in self._reporters)
