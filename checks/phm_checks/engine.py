"""Slot 2: the Docker Engine responds and permits PHM's requests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Slot
from phm_checks._text import clean

SETTLE_S = 0.3
"""A connection that is lost and restored within this time is not a fault. A lost event stream wakes this check immediately."""


class Engine(api.Check):
    """The Docker Engine. Unlike in other checks, no response is a fault here, not STALE."""

    name, slot, layer = "engine", Slot.CONTAINER, Layer.DOCKER
    period_s = 5.0
    deadline_s = 15.0
    failures = 2

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        """One check if any container is configured, or unknown ones are looked for, else none."""
        return [cls()] if settings.containers or settings.docker.unknown_containers.level != "off" else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.name, settle_s=SETTLE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"engine"})

    def run(self, world: api.World) -> api.Result:
        began_s = world.clock.mono()
        try:
            version = clean(world.docker.engine(), 40)
        except api.NotPermitted as refusal:
            return api.error(
                f"the Docker Engine denies access to PHM: {clean(str(refusal))}. Give PHM's container the group of the "
                "engine's socket (group_add in the compose file), or allow these calls in the socket proxy",
                brief="Docker denies access to PHM",
                condition="engine_refused",
            )
        except api.NoAccess as reason:
            return api.error(
                f"the Docker Engine cannot be asked: {clean(str(reason))}. Running containers continue, but PHM knows less about them "
                "and cannot recover them",
                brief="no permission for Docker's socket",
                condition="engine_down",
            )
        except api.CannotTell as reason:
            found = api.error(
                f"the Docker Engine does not respond: {clean(str(reason))}. Running containers continue without it, but "
                "PHM knows less about them and cannot recover them: check `systemctl status docker` and free space on its disk",
                brief="Docker not responding",
                condition="engine_down",
            )
            # A request that was given up has lasted for longer already; one more run must confirm it.
            return replace(found, settle_s=0.0) if world.clock.mono() - began_s >= SETTLE_S else found
        return api.ok(f"Docker Engine {version} responds", values={"engine_version": version})
