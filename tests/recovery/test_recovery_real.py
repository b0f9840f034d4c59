"""An entire PHM on the real engine, within this process: who caused a container's life, and who restarts a dependent."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import ActionEvent, Event, FaultOpened, Level, Note, Phase
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until
from tests.probes.docker.conftest import printed
from tests.proxy.haproxy import EngineAccess

pytestmark = pytest.mark.engine

LIMIT_S = 180.0
TIMEOUT_S = 30.0
"""Of requests to the engine, which may be busy."""
NEEDED = "/needed"
RUN = "trap 'exit 0' TERM; while :; do sleep 0.1; done"
READY = f"test -e /once || touch /once {NEEDED}; while :; do sleep 0.1; done"
"""Has the file once its trap is set, but not after a restart."""
RULES: dict[str, Any] = {
    "ladders": {"file_missing": ["restart"], "exited": ["start"]},
    "same_failure": 2,
    "verify": "3s",
    "backoff": "100ms",
    "stop_timeout": "2s",
    "budget": 20,
}


class Phm:
    """A daemon, and its events."""

    def __init__(
        self,
        folder: Path,
        engine_access: EngineAccess,
        containers: list[dict[str, Any]],
        *,
        docker: dict[str, Any] | None = None,
        custom: list[dict[str, Any]] | None = None,
        limit_s: float = LIMIT_S,
        **recovery: Any,
    ) -> None:
        self.events: list[Event] = []
        self._limit_s = limit_s
        made = settings(
            interval=2,
            docker={"timeout": TIMEOUT_S, **engine_access.section, **(docker or {})},
            containers=containers,
            custom=custom or [],
            recovery={**RULES, **recovery},
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            # A busy machine starves its containers, which is a fault and postpones actions.
            checks={"host": {"enabled": False}, "pressure": {"enabled": False}},
        )
        engine_access.open(made)
        self.daemon = build_daemon(made, measured_clock())
        self.daemon.components.bus.subscribe("test", self.events.append)

    def start(self) -> None:
        self.daemon.start()
        self.until(lambda: self.levels() == {Level.OK}, "all units to be OK")

    def levels(self) -> set[Level]:
        """Without what PHM says about itself: on a busy machine it has paused now and then."""
        return {state.level for state in self.daemon.pipeline.states() if state.unit != "companion"}

    def until(self, condition: Callable[[], object], what: str) -> None:
        until(condition, what, self.seen, limit_s=self._limit_s)

    def seen(self) -> tuple[object, ...]:
        """For a test that fails: actions, what is not OK, and notes."""
        states = [state for state in self.daemon.pipeline.states() if state.level is not Level.OK]
        return self.actions(), [(state.unit, state.level.name, state.result.summary) for state in states], self.notes()

    def actions(self) -> list[tuple[str, str, str]]:
        return [
            (event.target, event.phase.value, event.detail) for event in self.events if isinstance(event, ActionEvent)
        ]

    def count(self, phase: Phase) -> int:
        return sum(entry[1] == phase.value for entry in self.actions())

    def notes(self) -> list[str]:
        return [event.text for event in list(self.events) if isinstance(event, Note)]

    def conditions(self) -> list[tuple[str, str, float]]:
        """Of the faults: unit, condition, and when it was opened (monotonic seconds)."""
        faults = [event.fault for event in list(self.events) if isinstance(event, FaultOpened)]
        return [(fault.unit, fault.result.condition, fault.opened.mono) for fault in faults]

    def opened(self) -> list[str]:
        return [event.fault.unit for event in self.events if isinstance(event, FaultOpened)]

    def passes(self, number: int) -> None:
        """Wait until PHM has checked everything this many times."""
        seen = self.daemon.pipeline._pass_number
        self.until(lambda: self.daemon.pipeline._pass_number >= seen + number, f"{number} passes")


Start = Callable[..., Phm]


@pytest.fixture
def phm(tmp_path: Path, engine_access: EngineAccess) -> Iterator[Start]:
    made: list[Phm] = []

    def start(containers: list[dict[str, Any]], **recovery: Any) -> Phm:
        made.append(Phm(tmp_path, engine_access, containers, **recovery))
        made[-1].start()
        return made[-1]

    yield start
    for one in made:
        one.daemon.stop()


def with_file(made: Any) -> dict[str, Any]:
    return {"name": made.name, "alias": "app", "recover": True, "files": [{"path": NEEDED}]}


def given_up(real: Any, phm: Start, **more: Any) -> tuple[Any, Phm]:
    """A container that lacks a file, which no restart restores: PHM has tried twice and reported that it gave up."""
    made = real.container(RUN, **more)
    made.exec_run(["touch", NEEDED])
    daemon = phm([with_file(made)])
    made.exec_run(["rm", NEEDED])
    daemon.until(lambda: daemon.count(Phase.ESCALATED) == 1, "giving up")
    assert daemon.count(Phase.STARTED) == 2
    return made, daemon


def test_recovery_resumes_for_an_externally_recreated_container(real: Any, phm: Start) -> None:
    """A container of the same name and another id: two more attempts, and one more alarm."""
    made, daemon = given_up(real, phm)
    made.remove(force=True)
    real.container(RUN, name=made.name)
    daemon.until(lambda: daemon.count(Phase.ESCALATED) == 2, "giving up on the new one")
    assert daemon.count(Phase.STARTED) == 4
    assert daemon.opened().count("files/app") == 2


def test_recovery_resumes_after_a_manual_restart_that_lasts(real: Any, phm: Start) -> None:
    """`docker restart` of a container that PHM had given up on; PHM's own earlier restarts did not count."""
    made, daemon = given_up(real, phm)
    daemon.passes(3)
    assert daemon.count(Phase.STARTED) == 2
    made.restart(timeout=1)
    daemon.until(lambda: daemon.count(Phase.STARTED) > 2, "another attempt")
    assert any("started again outside PHM" in event.text for event in daemon.events if isinstance(event, Note))


def test_dockers_restart_policy_does_not_reset_attempts(real: Any, phm: Start) -> None:
    """The process ends repeatedly, each time after `verify`; the engine restarts it, and PHM, which gave up, takes no
    action.
    """
    made, daemon = given_up(real, phm, restart_policy={"Name": "always"})
    for _ in range(2):
        before = real.client.api.inspect_container(made.id)["RestartCount"]
        made.exec_run(["sh", "-c", "kill -KILL -1"])

        def lived(count: int = before) -> bool:
            answer = real.client.api.inspect_container(made.id)
            return bool(answer["RestartCount"] > count and answer["State"]["Running"])

        daemon.until(lived, "Docker to restart it")
        daemon.passes(3)  # longer than `verify`
    seen = (daemon.seen(), daemon.conditions())
    assert daemon.count(Phase.STARTED) == 2, seen
    assert daemon.opened().count("files/app") == 1, seen


class Restarts:
    """Restarts of one container that PHM requested, and how many ran at the same time."""

    def __init__(self, daemon: Daemon, container: str) -> None:
        self.made, self.at_once, self._now = 0, 0, 0
        self._lock, engine = threading.Lock(), daemon.components.probes.engine
        original = engine.restart

        def restart(ref: str, stop_timeout_s: float = 5.0) -> None:
            if ref != container:
                original(ref, stop_timeout_s)
                return
            with self._lock:
                self.made, self._now = self.made + 1, self._now + 1
                self.at_once = max(self.at_once, self._now)
            try:
                original(ref, stop_timeout_s)
            finally:
                with self._lock:
                    self._now -= 1

        engine.restart = restart  # type: ignore[method-assign]


def test_a_dependent_of_two_containers_is_restarted_by_one_at_a_time(real: Any, phm: Start) -> None:
    """Both owners are killed at the same time. `side` shares the network of one and starts after the other; it stops
    slowly.
    """
    slow = "trap 'sleep 1; exit 0' TERM; while :; do sleep 0.1; done"
    one, two = real.container(RUN), real.container(RUN)
    side = real.container(slow, network_mode=f"container:{one.id}")
    entries = [
        {"name": one.name, "alias": "one", "recover": True},
        {"name": two.name, "alias": "two", "recover": True},
        {"name": side.name, "alias": "side", "recover": True, "after": ["two"]},
    ]
    daemon = phm(entries, verify="60s")
    restarts = Restarts(daemon.daemon, side.id)
    for owner in (one, two):
        owner.kill()
    daemon.until(lambda: daemon.count(Phase.VERIFIED) == 2, "both repairs")
    daemon.until(lambda: not daemon.daemon.pipeline.open_faults(), "all units to be OK")
    assert restarts.at_once == 1
    assert 1 <= restarts.made <= 2
    assert sorted(daemon.opened()) == ["container/one", "container/two"]
    started = {made.id: real.client.api.inspect_container(made.id)["State"]["StartedAt"] for made in (one, two, side)}
    assert started[side.id] > max(started[one.id], started[two.id])
    assert printed(one, "readlink", "/proc/1/ns/net") == printed(side, "readlink", "/proc/1/ns/net")


def test_a_slow_stop_is_not_interrupted(real: Any, phm: Start) -> None:
    """`docker stop -t 60` of a container that needs 14 s to end, unhealthy meanwhile: it is not killed before it has
    ended.
    """
    made = real.container(
        f"trap 'rm {NEEDED}; sleep 14; exit 7' TERM; touch {NEEDED}; while :; do sleep 0.1; done",
        healthcheck={"test": ["CMD", "test", "-e", NEEDED], "interval": 10**9, "timeout": 6 * 10**10, "retries": 1},
    )
    daemon = phm([{"name": made.name, "alias": "app", "recover": True}])
    threading.Thread(target=lambda: made.stop(timeout=60), daemon=True).start()
    daemon.until(lambda: any("container app: die" in text for text in daemon.notes()), "its end")
    assert "container app: die (exit code 7)" in daemon.notes()
    assert "health/app" not in daemon.opened()


def test_phm_respects_a_containers_own_stop_timeout(real: Any, phm: Start) -> None:
    """Its own stop timeout is longer than `recovery.stop_timeout`, and its stop signal is not SIGTERM."""
    made = real.container(f"trap 'sleep 4; exit 7' INT; {READY}", stop_signal="SIGINT", asks_s=60)
    daemon = phm([with_file(made)], same_failure=1)
    made.exec_run(["rm", NEEDED])
    daemon.until(lambda: daemon.count(Phase.DONE) == 1, "the restart")
    assert [text for text in daemon.notes() if "die" in text] == ["container app: die (exit code 7)"]


def test_restarts_that_the_engine_finishes_late_are_attributed_to_phm(
    real: Any, phm: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A container that ignores SIGTERM: the engine restarts it seconds after PHM's call has failed. After three equal
    failures PHM gives up, and the lives that PHM itself started do not make it resume.
    """
    # The call fails after a second, the stop takes three.
    monkeypatch.setattr("phm.transport.docker_session.ACT_MARGIN_S", 1.0 - TIMEOUT_S - 3.0)
    made = real.container(f"trap '' TERM; {READY}")
    daemon = phm([with_file(made)], same_failure=3, stop_timeout="3s")
    started = real.client.api.inspect_container(made.id)["State"]["StartedAt"]
    made.exec_run(["rm", NEEDED])
    daemon.until(lambda: daemon.count(Phase.ESCALATED) == 1, "giving up")
    daemon.passes(5)  # longer than `verify`
    details = [detail for _, phase, detail in daemon.actions() if phase == Phase.FAILED.value]
    assert len(details) == 3 and all("did not answer within 1.0 s" in detail for detail in details)
    assert real.client.api.inspect_container(made.id)["State"]["StartedAt"] != started
    assert daemon.count(Phase.STARTED) == 3
    assert daemon.opened().count("files/app") == 1
    assert not any("outside PHM" in text for text in daemon.notes())
