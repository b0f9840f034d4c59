"""Distinguishes an operator's stop from a crash, by the engine's events. Pure; the caller brings time.

What the engine reports (seen with Docker 20.10 and Compose 2.26)::

    docker stop, docker compose stop    kill (the stop signal), [kill 9,] die, stop
    docker restart                      kill, die, stop, start, restart
    docker rm -f                        kill 9, die, destroy
    docker kill                         kill 9, die
    docker compose up --force-recreate  create (label com.docker.compose.replace), kill, die, stop, destroy, rename, start
    a crash, the kernel, the process    die
    docker pause, docker commit         pause, unpause (`docker stop` of a paused one: kill, unpause, [kill 9,] die, stop)

A pause needs no decision: only a person or a tool pauses a container (`phm.recovery.holds.hold_service`). A stop is `kill`, `die`,
`stop`. PHM's own actions cause these, too, and are not counted. A container that runs again within seconds was restarted or recreated.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

STOPPED_S = 3.0
"""A stopped container that is not started within this time stays stopped: the `start` of a restart follows its `stop` in 0.3 s."""
RECREATED_S = 15.0
"""The same for one that is being replaced or was removed."""
STOP_FOLLOWS_S = 3.0
"""`stop` follows `die` within 0.1 s on an idle machine; without it, the end was a crash or `docker kill`."""
REMOVED_S = 0.5
"""`destroy` follows the `die` of `docker rm -f` within 0.1 s; until then it looks like `docker kill`."""
UNSURE_S = 0.15
"""Recovery waits this long after an exit whose `kill` may have been missed, since `stop` follows `die` within 0.1 s on an idle machine."""
ASKED_S = 3600.0
"""A container that runs this long after its stop signal does not stop: `docker stop -t` may give it that much time."""
SIGKILL = "signal 9"


class StopVerdict(str, Enum):
    """CRASHED: it was not a stop; the container is judged as usual."""

    STOPPED = "stopped"
    REMOVED = "removed"
    CRASHED = "crashed"


@dataclass(slots=True)
class _Ending:
    """`until` is when the verdict is due (monotonic seconds)."""

    until: float
    verdict: StopVerdict = StopVerdict.CRASHED
    killed: bool = False
    """Whether the container was ended by SIGKILL alone."""
    ended: bool = False
    unsure: bool = False
    """A crash, unless a `stop` follows: published as usual, but not acted on yet."""
    replaced: bool = False
    replaced_by: float = float("-inf")
    """Until when a replacement that was created takes its place, also if the old one has exited before."""
    id: str = ""
    """Of the container that has exited; empty: not known."""


class ManualStopDetector:
    """By container. Not thread-safe: the caller's lock."""

    def __init__(self) -> None:
        self._of: dict[str, _Ending] = {}

    def event(
        self,
        key: str,
        action: str,
        detail: str,
        now: float,
        *,
        own: bool,
        late: bool = False,
        missed: bool = False,
        container_id: str = "",
    ) -> None:
        """One event of the container `key`. own: the event is PHM's doing. late: PHM's call has given up, and the engine has not.
        missed: a `kill` before it may have been missed.

        A restart that the engine finishes late ends the container before it starts it: that end is not a fault yet.
        """
        if late and action in ("die", "stop"):
            self._of[key] = _Ending(now + STOPPED_S, ended=True)
        elif action == "start" or own:
            self._of.pop(key, None)
        elif action == "replace":
            self._of[key] = _Ending(now + RECREATED_S, replaced=True, replaced_by=now + RECREATED_S)
        elif action == "kill":
            self._kill(key, detail, now)
        elif action == "destroy":
            self._of[key] = _Ending(now + RECREATED_S, StopVerdict.REMOVED, ended=True)
        elif key in self._of and action in ("die", "stop"):
            self._end(self._of[key], action, now)
        elif action == "die" and missed:
            self._of[key] = _Ending(now + UNSURE_S, ended=True, unsure=True)
        elif action == "stop":  # its `kill` was before PHM looked; a crash has no `stop`
            self._of[key] = _Ending(now + STOPPED_S, StopVerdict.STOPPED, ended=True)
        if action in ("die", "stop", "destroy") and key in self._of:
            self._of[key].id = container_id

    def nearly_due(self, now: float) -> dict[str, str]:
        """The containers for which `due` will return a stop or a removal, with the id of the one that has exited."""
        return {
            key: ending.id
            for key, ending in self._of.items()
            if now >= ending.until and ending.verdict is not StopVerdict.CRASHED
        }

    def due(self, now: float) -> list[tuple[str, StopVerdict]]:
        """What is decided by now; each is returned once. A container that got a stop signal and did not exit is forgotten."""
        found = [(key, ending) for key, ending in self._of.items() if now >= ending.until]
        for key, _ending in found:
            del self._of[key]
        return [(key, ending.verdict) for key, ending in found]

    def undecided(self) -> frozenset[str]:
        """Containers whose exit must not be published yet."""
        return frozenset(key for key, ending in self._of.items() if not ending.unsure)

    def undecided_until(self, key: str, now: float) -> float | None:
        """Until when recovery must not act on a container that has exited or is being replaced; None: it may."""
        ending = self._of.get(key)
        if ending is None:
            return None
        until = ending.until if ending.ended else ending.replaced_by
        return until if ending.ended or until > now else None

    def next_due(self) -> float | None:
        return min((ending.until for ending in self._of.values()), default=None)

    def _kill(self, key: str, detail: str, now: float) -> None:
        ending = self._of.get(key)
        if ending is None:
            self._of[key] = _Ending(now + ASKED_S, killed=detail == SIGKILL)
        elif not ending.ended:
            ending.until = max(
                ending.until, now + ASKED_S
            )  # SIGKILL after the stop signal, or the stop of a replacement

    def _end(self, ending: _Ending, action: str, now: float) -> None:
        if action == "die":
            ending.ended = True
            wait_s = REMOVED_S if ending.killed and not ending.replaced else STOP_FOLLOWS_S
        else:
            ending.verdict, ending.unsure, wait_s = StopVerdict.STOPPED, False, STOPPED_S
        ending.until = now + (RECREATED_S if ending.replaced else wait_s)
