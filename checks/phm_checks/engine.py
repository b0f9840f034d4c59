"""Slot 2: the Docker Engine answers, and lets PHM ask."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm import api
from phm.api import Layer, Slot
from phm_checks._text import clean

SETTLE_S = 0.3
"""A lost event stream wakes this check at once, so a refusal need not wait for the next period to be confirmed; a connection that
is lost and found within a moment is no fault."""


class Engine(api.Check):
    """The Docker Engine. Here, unlike everywhere else, getting no answer *is* the fault."""

    name, slot, layer = "engine", Slot.CONTAINER, Layer.DOCKER
    period_s = 5.0
    deadline_s = 15.0
    failures = 2

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        """Nothing to judge when no container is configured."""
        return [cls()] if settings.containers else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.name, settle_s=SETTLE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"engine"})

    def run(self, world: api.World) -> api.Result:
        try:
            version = clean(world.docker.engine(), 40)
        except api.NotPermitted as refusal:
            return api.error(
                f"the Docker Engine denies access to PHM: {clean(str(refusal))}. Give PHM's container the group of the "
                "engine's socket (group_add in the compose file), or allow these calls in the socket proxy",
                brief="Docker denies access to PHM",
                condition="engine_refused",
            )
        except api.CannotTell as silence:
            return api.error(
                f"the Docker Engine does not respond: {clean(str(silence))}. Running containers continue without it, but "
                "they can be neither monitored nor recovered: check `systemctl status docker` and free space on its disk",
                brief="Docker not responding",
                condition="engine_down",
            )
        return api.ok(f"Docker Engine {version} responds", engine_version=version)
