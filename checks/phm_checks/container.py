"""Slot 2: each configured container is running; if not, why."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Slot
from phm_checks._per_container import PerContainer
from phm_checks._restart_loop import OTHER_STARTS, STABLE_S, RestartLoop
from phm_checks._restart_trend import RestartTrend
from phm_checks._text import brief, clean, span

KILLED = 137
"""Exit code of a container that was ended by SIGKILL."""
_CODES = {
    0: "exited by itself without an error",
    125: "Docker could not run it",
    126: "its command cannot be executed: check the file's execute bit and its format",
    127: "its command was not found: check the image's entry point and PATH",
    KILLED: "killed by SIGKILL: by `docker kill`, by a stop that took too long, or for lack of memory",
    143: "ended by SIGTERM, as `docker stop` sends it",
    139: "segmentation fault (SIGSEGV): a bug in native code, look for a core dump",
    134: "aborted itself (SIGABRT), e.g. by a failed assertion",
}


def code_in_words(code: int) -> str:
    """The meaning of an exit code. Above 128: terminated by signal `code - 128`, the convention of shells and Docker."""
    if code in _CODES:
        return _CODES[code]
    if code > 128:
        try:
            return f"ended by {signal.Signals(code - 128).name}"
        except ValueError:
            pass
    return "exited with an application error: see its log"


WITHOUT_ENGINE_S = 15.0
"""A container whose cgroup was removed or is frozen must have been so for this long before this is reported: only the engine's events
show who did it, and the engine may work while PHM does not reach it. PHM allows a recreation by hand as much
(`phm.recovery.holds.manual_stop.RECREATED_S`)."""
UNNOTICED_S = 3.0
"""The same for a cgroup that is empty and still there. An engine that works removes it (measured: within 0.1 s), so it does not work,
and no one can recreate the container."""
UNREPORTED_S = 10.0
"""How long an engine that reports a container as running, although its processes have ended, counts as late. Usually it reports the end
within 0.1 s, on a busy machine within a second."""
UNSTARTED_S = 60.0
"""How long a container that was created may wait for its start. Only a person or a tool creates one, and `docker compose up` starts it
when its networks are connected and the health checks of what it depends on have passed, so a start by PHM would come too early."""
UNSTARTED_ALONE_S = 15.0
"""The same for a container that Compose starts without waiting for another service: Compose may still be replacing others, which it does
before it starts any, but a start by PHM does no harm."""
_SHOWN = {
    api.CgroupState.FROZEN: "is paused: its cgroup is frozen",
    api.CgroupState.EMPTY: "has ended: its cgroup has no process",
    api.CgroupState.REMOVED: "has ended or was replaced: its cgroup was removed",
}
_STABLE = ("a run without a restart",)
"""`Evidence.subjects` of a restart loop."""


class Container(PerContainer):
    """The container's process exists, is not paused, and is not restarted repeatedly.

    While the Docker Engine does not answer, the container's cgroup shows that it has ended or is frozen, and nothing else is known.
    """

    name, slot = "container", Slot.CONTAINER
    period_s = 5.0
    """No event signals that a restarted container has run for long enough."""

    def __init__(
        self,
        entry: api.ContainerSettings,
        trends: api.TrendSettings,
        steady_s: float = STABLE_S,
        by_hand: int = OTHER_STARTS,
    ) -> None:
        super().__init__(entry)
        self._trend = RestartTrend(trends.restarts, trends.confidence)
        self._restarts = RestartLoop(steady_s, by_hand)
        self._before: tuple[api.ContainerFact, api.Result] | None = None
        """The engine's last answer, and the result."""
        self._ended_at: float | None = None
        """When its cgroup first showed that it has ended (monotonic seconds), while the engine reports it as running."""
        self._unstarted: tuple[str, float] | None = None
        """Id of the container that waits for its first start, and since when it has existed (monotonic seconds)."""
        self._asked_at = float("-inf")
        """When the engine was last asked and answered (monotonic seconds)."""

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        """One check per container. A run shorter than the grace period of its nodes does not count as stable."""
        steady_s = max(STABLE_S, settings.ros.grace)
        by_hand = max(OTHER_STARTS, settings.recovery.budget + 1)
        return [cls(entry, settings.trends, steady_s, by_hand) for entry in settings.containers]

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.unit_id, needs=("engine",), target=self.key),)

    def run(self, world: api.World) -> api.Result:
        asked_at = world.clock.mono()
        try:
            fact = world.docker.container(self.key)
        except api.NoResponse as reason:
            found = self._by_cgroup(world, *self._before, str(reason)) if self._before is not None else None
            if found is None:
                raise
            return found
        result = self._not_reported(fact, world) or self._judge(fact, world)
        generation = fact.generation if fact is not None else ""
        result = result.with_evidence(replace(result.evidence, generation=generation))
        self._before = (fact, result) if fact is not None else None
        self._asked_at = asked_at
        return result

    def _by_cgroup(
        self, world: api.World, fact: api.ContainerFact, before: api.Result, reason: str
    ) -> api.Result | None:
        """That the container has ended or is frozen; None: neither, or unknown. What was reported before and still holds is repeated."""
        state = world.pressure.state(self.key, fact.id)
        if state is None or state is api.CgroupState.RUNNING:
            return None
        frozen = state is api.CgroupState.FROZEN
        settle_s = UNNOTICED_S if state is api.CgroupState.EMPTY else WITHOUT_ENGINE_S
        if before.level is api.Level.ERROR and not fact.running and (fact.status == "paused") is frozen:
            found = before
            settle_s = max(settle_s, before.settle_s or 0.0)
        else:
            words = f"{self.key} {_SHOWN[state]}. Why is unknown, and it cannot be recovered, until the Docker Engine responds: {clean(reason)}"
            found = self._bad("frozen", words, "paused") if frozen else self._bad("ended", words, "ended")
        seen = api.Evidence(certain=True, conclusive=True)  # of no generation: it may have been replaced
        return replace(found, settle_s=settle_s, evidence=seen)

    def _not_reported(self, fact: api.ContainerFact | None, world: api.World) -> api.Result | None:
        """STALE if it has ended and the engine is late to report that, so that its end is not first reported as a fault of what depends
        on it; else None."""
        state = world.pressure.state(self.key, fact.id) if fact is not None and fact.running else None
        if state not in (api.CgroupState.EMPTY, api.CgroupState.REMOVED):
            self._ended_at = None
            return None
        now_s = world.clock.mono()
        self._ended_at = now_s if self._ended_at is None else self._ended_at
        if now_s - self._ended_at >= UNREPORTED_S:
            return None
        return api.stale(f"{self.key} {_SHOWN[state]}. The Docker Engine still reports it as running")

    def _judge(self, fact: api.ContainerFact | None, world: api.World) -> api.Result:
        if fact is None:
            return self._bad(
                "missing",
                f"container {self.key} does not exist: create it, e.g. with `docker compose up -d`, or correct its name in "
                "the configuration",
                "missing",
            )
        now_s = world.clock.mono()
        self._restarts.observe(fact, now_s)
        self._trend.observe(fact, now_s)
        values: dict[str, api.Value] = {"restart_count": fact.restart_count}
        patience_s = UNSTARTED_ALONE_S if fact.depends_on == "" else UNSTARTED_S
        if self._unstarted_s(fact, world) < patience_s:
            words = (
                f"{self.key} was created and has not been started yet; PHM gives its creator {span(patience_s)} for that. "
                f"`docker start {fact.name}` starts it"
            )
            # Published only where a fault is open already: else it is known as `created` by then.
            return replace(self._bad("not_started", words, "not started yet", values), settle_s=patience_s)
        if fact.running:
            return self._running(fact, {"pid": fact.pid, **values}, more_often=self._trend.rising(now_s))
        return self._stopped(fact, {"exit_code": fact.exit_code, **values})

    def _unstarted_s(self, fact: api.ContainerFact, world: api.World) -> float:
        """How long it has waited for its first start; infinity: it was started, or that failed, of which the engine keeps the error.

        The engine may have been away since, or PHM. Its time stamp is from a clock that may be set or differ, but not from before the
        last time when there was another container.
        """
        if fact.status != "created" or fact.error:
            self._unstarted = None
            return math.inf
        now_s = world.clock.mono()
        if self._unstarted is None or self._unstarted[0] != fact.id:
            known_s = now_s if fact.created_at is None else world.clock.latest(fact.created_at)
            self._unstarted = (fact.id, min(now_s, max(known_s, self._asked_at)))
        return now_s - self._unstarted[1]

    def _running(self, fact: api.ContainerFact, values: dict[str, api.Value], *, more_often: bool) -> api.Result:
        starts = self._restarts
        if starts.looping:
            who = f"{starts.by_hand} times" if not starts.by_engine else f"by Docker (restart {fact.restart_count})"
            words = (
                f"{self.key} is running at the moment, but is restarted repeatedly, {who}, and has not run for "
                f"{span(starts.steady_s)} in between, expected to stay up. PHM leaves it to its restart policy or operator; see "
                f"`docker logs {fact.name}`"
            )
            return self._bad("restarting", words, "crash loop", values).with_evidence(api.Evidence(subjects=_STABLE))
        if starts.by_engine and not starts.steady:
            return api.warn(
                f"{self.key} exited, and Docker restarted it by its restart policy (restart {fact.restart_count}); it has "
                f"not run for {span(starts.steady_s)} yet: see `docker logs {fact.name}` for why",
                brief=brief(self.key, "was restarted"),
                condition="restarted",
                target=self.key,
                values=values,
            )
        if more_often:
            return api.warn(
                f"{self.key} was restarted {self._trend.count} times in {span(self._trend.window_s)}, at ever shorter intervals: "
                f"see `docker logs {fact.name}` and `docker inspect` for why, before it no longer starts",
                brief=brief(self.key, f"{self._trend.count} restarts, ever faster"),
                condition="restarts_rising",
                values=values,
            ).with_evidence(api.Evidence(forecast=True))
        # After a restart of PHM, a restart loop is over when a run has lasted.
        evidence = api.Evidence(unobserved_of=() if starts.steady else _STABLE)
        return api.ok(f"Container {self.key} is running", values=values).with_evidence(evidence)

    def _stopped(self, fact: api.ContainerFact, values: dict[str, api.Value]) -> api.Result:
        key, status = self.key, fact.status
        said = f" Docker reports: {clean(fact.error)}." if fact.error else ""
        if status == "exited":
            return self._exited(fact, said, values)
        if status == "restarting":
            return self._restarting(fact, said, values)
        statuses = {
            "created": ("never started", f"was created but never started: `docker start {fact.name}`"),
            "paused": ("paused", f"is paused, its processes are frozen: `docker unpause {fact.name}`"),
            "dead": (
                "dead",
                f"is dead, Docker could not remove it: `docker rm -f {fact.name}`, then create it again",
            ),
            "removing": ("being removed", "is being removed: create it again"),
        }
        short, words = statuses.get(
            status, (f"is {clean(status, 12)}", f"is in the unknown state {clean(status, 40)!r}")
        )
        known = "missing" if status == "removing" else status
        condition = known if status in statuses else "not_running"
        return self._bad(condition, f"{key} {words}, expected running.{said}", short, values)

    def _restarting(self, fact: api.ContainerFact, said: str, values: dict[str, api.Value]) -> api.Result:
        ended = f"exit code {fact.exit_code}: {code_in_words(fact.exit_code)}"
        if not self._restarts.looping:
            # Usually over within 0.1 s: wait for its outcome.
            return api.stale(f"{self.key} has exited ({ended}); Docker is about to restart it", values=values)
        words = (
            f"{self.key} exits repeatedly; Docker waits before restarting it (restart {fact.restart_count}; last {ended})."
            f"{said} PHM leaves it to Docker's restart policy; see `docker logs {fact.name}`"
        )
        return self._bad("restarting", words, "crash loop", values).with_evidence(api.Evidence(subjects=_STABLE))

    def _exited(self, fact: api.ContainerFact, said: str, values: dict[str, api.Value]) -> api.Result:
        # The engine has the flag, too, if the kernel has killed another process of this run than the first.
        if fact.oom_killed and fact.exit_code == KILLED:
            words = (
                f"{self.key} was killed for lack of memory (exit code {fact.exit_code}), expected running.{said} Raise its "
                f"memory limit or find the leak; `docker start {fact.name}`"
            )
            return self._bad("oom", words, "out of memory", values)
        killed = " In this run the kernel killed a process in it for lack of memory." if fact.oom_killed else ""
        words = (
            f"{self.key} exited with code {fact.exit_code} ({code_in_words(fact.exit_code)}), expected running.{said}{killed} "
            f"`docker logs {fact.name}` shows more; `docker start {fact.name}` starts it"
        )
        return self._bad("exited", words, f"exited {fact.exit_code}", values)

    def _bad(self, condition: str, words: str, short: str, values: dict[str, api.Value] | None = None) -> api.Result:
        return api.error(words, brief=brief(self.key, short), condition=condition, target=self.key, values=values)
