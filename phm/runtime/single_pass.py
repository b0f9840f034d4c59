"""`phm once`: one pass over all checks, without recovery, reports, joined networks or open MAVLink endpoints."""

from __future__ import annotations

import threading

from phm.core import threads
from phm.core.clock import Clock, SystemClock
from phm.core.model import UnitState
from phm.runtime.components import Components, ProcessParts
from phm.runtime.configuration import Configuration


def run_once(configuration: Configuration, clock: Clock | None = None) -> tuple[UnitState, ...]:
    """Changes nothing. Waits until every unit has a level, at most the longest grace, settle time and deadline together.

    configuration: read without links.
    """
    clock = clock or SystemClock()
    components = Components(configuration.settings, ProcessParts(clock), plan=configuration.plan)
    plan, scheduler, pipeline = components.plan, components.scheduler, components.pipeline
    longest_s = max((entry.unit.grace_s + entry.unit.settle_s for entry in plan.tracked), default=0.0)
    end = clock.mono() + longest_s + plan.pass_limit_s
    try:
        components.probes.start_ros()
        scheduler.start()
        tick = threading.Event()
        while clock.mono() < end:
            threads.retry()
            scheduler.report_overdue()
            pipeline.tick()
            if not pipeline.undecided():
                break
            clock.wait(tick, 0.05)
        return pipeline.states()
    finally:
        scheduler.stop(0.5)
        components.probes.close()
