"""The record of one Docker event, and which events PHM asks the engine for."""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.model import Stamp

CONTAINER_ACTIONS = (
    "create",
    "start",
    "kill",
    "die",
    "stop",
    "restart",
    "pause",
    "unpause",
    "oom",
    "health_status",
    "destroy",
    "rename",
)
NETWORK_ACTIONS = ("create", "connect", "disconnect", "destroy")
# The engine matches actions by prefix once `health_status` is among them: exec events are excluded.
ENDINGS = ("kill", "die", "stop", "destroy")
FILTERS = {"type": ("container", "network"), "event": tuple(dict.fromkeys((*CONTAINER_ACTIONS, *NETWORK_ACTIONS)))}


@dataclass(frozen=True, slots=True)
class DockerEvent:
    """Something that happened to a configured container or to a network.

    kind:   container or network.
    key:    the container's key in the configuration, or the network's name.
    action: one of CONTAINER_ACTIONS or NETWORK_ACTIONS, or ``replace``: Compose has made the one to take its place.
    detail: e.g. ``exit code 137``, ``unhealthy``, ``signal 15`` for kill (which `docker stop` sends first), or empty.
    container: for network events the key of the container concerned, when it is a configured one.
    lost:   not in the stream; found by the comparison.
    id:     of the container, or of the one that the comparison found; empty: not known.
    end_s:  for a `kill` after which the container is to end: within how many seconds at most; else 0.
    """

    kind: str
    key: str
    action: str
    detail: str
    at: Stamp
    container: str = ""
    lost: bool = False
    end_s: float = 0.0
    id: str = ""

    @property
    def subjects(self) -> frozenset[str]:
        """The subjects that it wakes: see `phm.api.Check.wakes`."""
        return frozenset({f"container:{self.key}" if self.kind == "container" else "network"})

    @property
    def harmless(self) -> bool:
        """A signal that does not stop the container, e.g. SIGHUP to reload its configuration."""
        return self.action == "kill" and self.end_s == 0

    @property
    def exits(self) -> bool:
        """The container has ended or was removed."""
        return self.kind == "container" and self.action in ("die", "destroy")

    @property
    def starts(self) -> bool:
        """The container was started. The engine's `restart` event only follows its `start`; if `start` is lost, it
        replaces it."""
        return self.kind == "container" and (self.action == "start" or (self.action == "restart" and self.lost))

    def __str__(self) -> str:
        of = f" of {self.container}" if self.container else ""
        return f"{self.kind} {self.key}{of}: {self.action}" + (f" ({self.detail})" if self.detail else "")
