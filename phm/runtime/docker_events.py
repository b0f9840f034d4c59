"""Applies Docker events: to the log, to holds, to the tracker, to links, and as wake-ups of checks."""

from __future__ import annotations

from collections.abc import Callable

from phm.checking.pipeline import Pipeline
from phm.checking.scheduler import CheckScheduler
from phm.probes.docker_event import DockerEvent
from phm.recovery.holds.hold_service import HoldService


class DockerEventRouter:
    """container_started: called with a configured container that was started."""

    def __init__(
        self,
        pipeline: Pipeline,
        scheduler: CheckScheduler,
        holds: HoldService,
        container_started: Callable[[str], None],
    ) -> None:
        self._pipeline, self._scheduler, self._holds = pipeline, scheduler, holds
        self._container_started = container_started

    def apply(self, event: DockerEvent) -> None:
        self._pipeline.note("DOCKER", str(event))
        if event.kind == "container" and not event.harmless:
            self._holds.happened(event.key, "start" if event.starts else event.action, event.detail, event.id)
        if event.end_s:
            self._pipeline.expect_stop(event.key, event.end_s)
        if event.exits:
            self._pipeline.container_ended(event.key)
        if event.starts:
            self._pipeline.container_started(event.key)
            self._container_started(event.key)
        for subject in event.subjects:
            self._scheduler.wake_subject(subject)
