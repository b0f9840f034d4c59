"""`phm once`: one pass over all checks, without recovery, reports, joined networks or open MAVLink endpoints."""

from __future__ import annotations

import threading
from dataclasses import replace

from phm.checking.pipeline import Pipeline
from phm.core import threads
from phm.core.clock import Clock, SystemClock
from phm.core.model import Result, UnitState
from phm.probes.cpu_usage import SHORTEST_S
from phm.runtime.components import Components, ProcessParts
from phm.runtime.configuration import Configuration

MEASURED_S = 1.25 * SHORTEST_S
"""From here on the shares of CPU and waiting, which the probes began to measure when they were built, are known."""


def run_once(configuration: Configuration, clock: Clock | None = None) -> tuple[UnitState, ...]:
    """Changes nothing. Waits until every unit has a level, at most the longest grace, settle time and deadline together. A bad
    result that must last longer than that is reported as it was found.

    configuration: read without links.
    """
    clock = clock or SystemClock()
    components = Components(configuration.settings, ProcessParts(clock), plan=configuration.plan)
    plan, scheduler, pipeline = components.plan, components.scheduler, components.pipeline
    longest_s = max((entry.unit.grace_s + entry.unit.settle_s for entry in plan.tracked), default=0.0)
    tick = threading.Event()
    try:
        components.probes.start_ros()
        clock.wait(tick, MEASURED_S)
        limit_s = longest_s + plan.pass_limit_s
        end = clock.mono() + limit_s
        scheduler.start()
        while clock.mono() < end:
            threads.retry()
            scheduler.report_overdue()
            pipeline.tick()
            if not set(pipeline.undecided()) - _found(pipeline, limit_s).keys():
                break
            clock.wait(tick, 0.05)
        found = _found(pipeline, limit_s)
        states = pipeline.states()
        return tuple(
            replace(state, level=found[state.unit].level, result=found[state.unit]) if state.unit in found else state
            for state in states
        )
    finally:
        scheduler.stop(0.5)
        components.probes.close()


def _found(pipeline: Pipeline, limit_s: float) -> dict[str, Result]:
    """By undecided unit: the bad result that must last longer than `limit_s` before it is published (`Result.settle_s`)."""
    newest = {unit: pipeline.newest(unit) for unit in pipeline.undecided()}
    return {
        unit: result
        for unit, result in newest.items()
        if result is not None and result.level.bad and (result.settle_s or 0.0) > limit_s
    }
