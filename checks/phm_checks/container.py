"""Slot 2: each configured container is running; if not, why not, in words."""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Sequence

from phm import api
from phm.api import Slot
from phm_checks._per_container import PerContainer
from phm_checks._words import brief, clean

LOOP_RESTARTS = 3
LOOP_WINDOW_S = 60.0
"""So many restarts by the engine within so long are told even while the container happens to run."""

_CODES = {
    0: "ended by itself without an error",
    125: "the engine could not run it",
    126: "its command cannot be executed: check the file's execute bit and its format",
    127: "its command was not found: check the image's entry point and PATH",
    int(signal.SIGKILL)
    + 128: "killed by SIGKILL: by `docker kill`, by a stop that took too long, or for lack of memory",
    int(signal.SIGTERM) + 128: "ended by SIGTERM, as `docker stop` sends it",
    int(signal.SIGSEGV) + 128: "segmentation fault (SIGSEGV): a bug in native code, look for a core dump",
    int(signal.SIGABRT) + 128: "aborted itself (SIGABRT), as a failed assertion does",
}


def code_in_words(code: int) -> str:
    """What an exit code says. Codes above 128 stand for signal `code - 128`, as shells and Docker count."""
    if code in _CODES:
        return _CODES[code]
    if code > 128:
        try:
            return f"ended by {signal.Signals(code - 128).name}"
        except ValueError:
            pass
    return "ended with an error of its own: see its log"


class Container(PerContainer):
    """The container's process exists and is not frozen."""

    name, slot = "container", Slot.CONTAINER

    def __init__(self, entry: api.ContainerSettings) -> None:
        super().__init__(entry)
        self._restarts: int | None = None
        self._restarted_at: deque[float] = deque(maxlen=LOOP_RESTARTS)

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.unit_id, needs=("engine",), target=self.key),)

    def run(self, world: api.World) -> api.Result:
        fact = world.docker.container(self.key)
        if fact is None:
            return self._bad(
                "missing",
                f"there is no container {self.key}: create it, e.g. with `docker compose up -d`, or correct its name in "
                "the configuration",
                "missing",
            )
        self._count_restarts(fact, world.clock.mono())
        if fact.running:
            return self._running(fact, world.clock.mono())
        return self._stopped(fact)

    def _running(self, fact: api.ContainerFact, now: float) -> api.Result:
        times = self._restarted_at
        if len(times) == LOOP_RESTARTS and now - times[0] <= LOOP_WINDOW_S:
            return api.warn(
                f"{self.key} runs, but the engine restarted it {LOOP_RESTARTS} times or more within {LOOP_WINDOW_S:.0f} s, "
                f"expected none: see `docker logs {fact.name}`",
                brief=brief(self.key, "keeps restarting"),
                condition="crash_loop",
                target=self.key,
                restart_count=fact.restart_count,
            )
        return api.ok(f"Container {self.key} is running", pid=fact.pid, restart_count=fact.restart_count)

    def _stopped(self, fact: api.ContainerFact) -> api.Result:
        key, status = self.key, fact.status
        values: dict[str, api.Value] = {"exit_code": fact.exit_code, "restart_count": fact.restart_count}
        said = f" The engine says: {clean(fact.error)}." if fact.error else ""
        if status == "exited":
            return self._exited(fact, said, values)
        if status == "restarting":
            words = (
                f"{key} ends again and again; the engine waits to restart it (restart {fact.restart_count}; last exit code "
                f"{fact.exit_code}: {code_in_words(fact.exit_code)}).{said} PHM leaves it to the engine's restart policy; see `docker logs {fact.name}`"
            )
            return self._bad("restarting", words, "crash loop", values)
        told = {
            "created": ("never started", f"was created but never started: `docker start {fact.name}`"),
            "paused": ("paused", f"is paused, its processes are frozen: `docker unpause {fact.name}`"),
            "dead": (
                "dead",
                f"is dead, the engine could not remove it: `docker rm -f {fact.name}`, then create it again",
            ),
            "removing": ("being removed", "is being removed: create it again"),
        }
        short, words = told.get(status, (f"is {clean(status, 12)}", f"is in the unknown state {clean(status, 40)!r}"))
        condition = (
            status if status in told and status != "removing" else "missing" if status == "removing" else "not_running"
        )
        return self._bad(condition, f"{key} {words}, expected running.{said}", short, values)

    def _exited(self, fact: api.ContainerFact, said: str, values: dict[str, api.Value]) -> api.Result:
        if fact.oom_killed:
            words = (
                f"{self.key} was killed for lack of memory (exit code {fact.exit_code}), expected running.{said} Raise its "
                f"memory limit or find the leak; `docker start {fact.name}`"
            )
            return self._bad("oom", words, "out of memory", values)
        words = (
            f"{self.key} exited with code {fact.exit_code} ({code_in_words(fact.exit_code)}), expected running.{said} "
            f"`docker logs {fact.name}` tells more; `docker start {fact.name}` starts it"
        )
        return self._bad("exited", words, f"exited {fact.exit_code}", values)

    def _bad(self, condition: str, words: str, short: str, values: dict[str, api.Value] | None = None) -> api.Result:
        return api.error(words, brief=brief(self.key, short), condition=condition, target=self.key, **(values or {}))

    def _count_restarts(self, fact: api.ContainerFact, now: float) -> None:
        """Remember when the engine's counter rose; it starts again at 0 when somebody else starts the container."""
        risen = fact.restart_count - (fact.restart_count if self._restarts is None else self._restarts)
        self._restarts = fact.restart_count
        if risen < 0:
            self._restarted_at.clear()
        if risen > 0:
            self._restarted_at.extend([now] * min(risen, LOOP_RESTARTS))
