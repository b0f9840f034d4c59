"""Holds and manual stops on the real engine, with the docker CLI and Compose, and an entire PHM within this process."""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from phm.cli import group
from phm.core.model import ActionEvent, Event, FaultOpened, HoldChanged, Level, Phase
from phm.probes.docker_event import FILTERS
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.docker import EngineNotConnected
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until

LIMIT_S = 180.0
RUN = "trap 'exit 0' TERM; while :; do sleep 0.1; done"
RESPECT, HEAL = {"on_manual_stop": "respect"}, {"on_manual_stop": "heal"}


class Phm:
    """A daemon that monitors one container, and its events."""

    def __init__(self, folder: Path, container: str, **recovery: Any) -> None:
        self.events: list[Event] = []
        made = settings(
            interval=2,
            docker={"timeout": 30},  # the engine may be busy
            containers=[{"name": container, "recover": True}],
            recovery={"verify": "60s", **recovery},
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            # A busy machine starves its containers, which is a fault and postpones actions.
            checks={"host": {"enabled": False}, "pressure": {"enabled": False}},
        )
        self.unit = f"container/{container}"
        self.daemon = build_daemon(made, measured_clock())
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()

    def until(self, condition: Any, what: str) -> None:
        until(condition, what, lambda: self.events, limit_s=LIMIT_S)

    def level(self) -> Level:
        return next(state.level for state in self.daemon.pipeline.states() if state.unit == self.unit)

    def faults(self) -> list[str]:
        return [event.fault.unit for event in self.events if isinstance(event, FaultOpened)]

    def phases(self) -> list[Phase]:
        return [event.phase for event in self.events if isinstance(event, ActionEvent)]

    def holds(self, *, began: bool) -> list[str]:
        return [event.text for event in self.events if isinstance(event, HoldChanged) and event.began is began]

    def verb(self, *words: str) -> str:
        """The output of a CLI verb that queries this daemon."""
        result = CliRunner().invoke(group, [*words, "--run-dir", self.daemon.components.settings.run_dir])
        assert result.exit_code == 0, result.output
        return result.output

    def status(self) -> str:
        """What `phm status` shows. Its exit code is 1 while a busy machine keeps PHM from running."""
        return CliRunner().invoke(group, ["status", "--run-dir", self.daemon.components.settings.run_dir]).output

    def decided(self) -> bool:
        """Whether PHM has seen the stop and it can no longer be part of a restart."""
        return not self.daemon.components.holds._stops.undecided()


class Project:
    """A Compose project of one service, controlled by the docker CLI."""

    def __init__(self, folder: Path) -> None:
        self.container = f"phm-test-{uuid.uuid4().hex[:8]}"
        service = {
            "image": "phm-base:dev",
            "container_name": self.container,
            "entrypoint": ["sh", "-c", RUN],
            "stop_grace_period": "5s",
        }
        self._file = folder / "compose.yaml"
        self._file.write_text(yaml.safe_dump({"services": {"app": service}}))

    def compose(self, *words: str) -> None:
        self._run("docker", "compose", "-p", self.container, "-f", str(self._file), *words)

    def docker(self, *words: str) -> None:
        self._run("docker", *words)

    def id(self) -> str:
        command = ["docker", "inspect", "--format", "{{.Id}}", self.container]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout

    def _run(self, *words: str) -> None:
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr


@pytest.fixture
def project(tmp_path: Path) -> Iterator[Project]:
    made = Project(tmp_path)
    made.compose("up", "-d")
    yield made
    made.compose("down", "-t", "2")


@pytest.fixture
def phm(tmp_path: Path, project: Project) -> Iterator[Any]:
    made: list[Phm] = []

    def start(**recovery: Any) -> Phm:
        made.append(Phm(tmp_path, project.container, **recovery))
        made[-1].until(lambda: made[-1].level() is Level.OK, "the container to be OK")
        return made[-1]

    yield start
    for each in made:
        each.daemon.stop()


def test_a_recreation_by_compose_raises_no_alarm(phm: Any, project: Project) -> None:
    """`docker compose up --force-recreate` is not a failure, whatever the rule for stops is."""
    agent, old = phm(**HEAL), project.id()
    project.compose("up", "-d", "--force-recreate")
    assert project.id() != old
    agent.until(lambda: agent.decided() and agent.level() is Level.OK, "the new container to be OK")
    assert agent.faults() == [] and agent.phases() == []


@pytest.mark.parametrize("words", [("docker", "stop"), ("compose", "stop")])
def test_a_manual_stop_is_respected_until_the_start(phm: Any, project: Project, words: tuple[str, str]) -> None:
    """Where stops are respected, the container is on hold until it is started, and there is no alarm and no action."""
    agent = phm(**RESPECT)
    getattr(project, words[0])(*words[1:], *([project.container] if words[0] == "docker" else []))
    agent.until(lambda: agent.holds(began=True), "the hold")
    agent.until(lambda: agent.level() is Level.STALE, "the unit to be on hold")
    project.docker("start", project.container)
    agent.until(lambda: agent.holds(began=False), "the end of the hold")
    agent.until(lambda: agent.level() is Level.OK, "the container to be OK")
    assert "stopped by hand" in agent.holds(began=True)[0]
    assert "it was started again" in agent.holds(began=False)[0]
    assert agent.faults() == [] and agent.phases() == []


def test_a_respected_stop_is_recovered_when_its_hold_expires(phm: Any, project: Project) -> None:
    """A hold always has an end: then the fault is raised and recovered as usual."""
    agent = phm(**RESPECT, hold="6s")
    project.docker("stop", project.container)
    agent.until(lambda: Phase.VERIFIED in agent.phases(), "the container to be started")
    said = [type(event) for event in agent.events if isinstance(event, (HoldChanged, FaultOpened))]
    assert said == [HoldChanged, HoldChanged, FaultOpened]


def test_a_manual_stop_is_recovered_with_the_rule_heal(phm: Any, project: Project) -> None:
    """`heal`, the default in flight: a manual stop is a failure like any other."""
    agent = phm(**HEAL)
    project.docker("stop", project.container)
    agent.until(lambda: Phase.VERIFIED in agent.phases(), "the container to be started")
    assert agent.faults() == [agent.unit]


def test_a_manual_stop_is_only_advised_with_the_rule_advise(phm: Any, project: Project) -> None:
    """The alarm is raised and no action is taken."""
    agent = phm(on_manual_stop="advise")
    project.docker("stop", project.container)
    agent.until(lambda: Phase.ADVISED in agent.phases(), "the advice")
    assert agent.faults() == [agent.unit] and Phase.STARTED not in agent.phases()


@pytest.mark.parametrize("words", [("kill", "{}"), ("exec", "{}", "kill", "-TERM", "1")])
def test_a_crash_is_not_a_stop(phm: Any, project: Project, words: tuple[str, ...]) -> None:
    """A container that ends without a stop by the engine is recovered, also where stops are respected."""
    agent = phm(**RESPECT)
    project.docker(*(word.format(project.container) for word in words))
    agent.until(lambda: Phase.VERIFIED in agent.phases(), "the container to be started")
    assert agent.faults() == [agent.unit] and agent.holds(began=True) == []


def test_a_stop_during_an_event_stream_outage_is_not_undone(
    phm: Any, project: Project, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PHM sees that the container has ended before it gets the event: the alarm is raised, and PHM waits for the
    replay.
    """
    monkeypatch.setattr("phm.recovery.holds.awaited_events.CLOSED_S", 10 * LIMIT_S)
    agent = phm(**RESPECT)
    engine, watch = agent.daemon.components.probes.engine, agent.daemon.components.probes.watch
    agent.until(lambda: watch.fact.open, "the event stream to be open")
    with monkeypatch.context() as closed:

        def refuse(*words: Any) -> Any:
            raise EngineNotConnected("the test keeps the event stream closed")

        closed.setattr(engine, "events", refuse)
        watch._stream.close()
        agent.until(lambda: not watch.fact.open, "the interruption")
        project.docker("stop", project.container)
        agent.until(lambda: agent.faults() == [agent.unit], "the alarm")
        seen = agent.daemon.pipeline._pass_number
        agent.until(lambda: agent.daemon.pipeline._pass_number >= seen + 2, "two passes")
        assert agent.phases() == []
    agent.until(lambda: agent.holds(began=True), "the hold")
    assert "stopped by hand" in agent.holds(began=True)[0]
    assert Phase.STARTED not in agent.phases()


@pytest.mark.parametrize("stops", [True, False])
def test_an_end_with_a_missed_kill_is_acted_on_unless_a_stop_follows(
    phm: Any, project: Project, monkeypatch: pytest.MonkeyPatch, stops: bool
) -> None:
    """PHM was started between the `kill` and the `die`; only with a `stop` was it a manual stop."""
    actions = tuple(action for action in FILTERS["event"] if action != "kill")
    monkeypatch.setattr("phm.probes.container_watcher.FILTERS", {**FILTERS, "event": actions})
    if stops:
        monkeypatch.setattr("phm.recovery.holds.manual_stop.UNSURE_S", 10 * LIMIT_S)
    agent = phm(**RESPECT)
    project.docker("stop" if stops else "kill", project.container)
    if stops:
        agent.until(lambda: agent.holds(began=True), "the hold")
        assert Phase.STARTED not in agent.phases()
    else:
        agent.until(lambda: Phase.VERIFIED in agent.phases(), "the container to be started")
        assert agent.holds(began=True) == []


def test_a_restart_of_phm_is_not_a_manual_stop(phm: Any, project: Project) -> None:
    """PHM's own restart also stops the container, and causes no hold."""
    agent = phm(**RESPECT, ladders={"exited": ["restart"]})
    project.docker("kill", project.container)
    agent.until(lambda: Phase.VERIFIED in agent.phases() and agent.decided(), "the container to be restarted")
    assert agent.holds(began=True) == []


def test_a_removal_is_on_hold_until_compose_recreates_it(phm: Any, project: Project) -> None:
    """An intended `docker compose down` is respected like `stop`; `up` ends the hold."""
    agent = phm(**RESPECT)
    project.compose("down", "-t", "2")
    agent.until(lambda: agent.holds(began=True), "the hold")
    project.compose("up", "-d")
    agent.until(lambda: agent.holds(began=False) and agent.level() is Level.OK, "the end of the hold")
    assert "removed by hand" in agent.holds(began=True)[0] and agent.faults() == []


def test_an_operator_holds_and_releases_a_container(phm: Any, project: Project) -> None:
    """On hold, a crash is STALE, raises no alarm, and is left alone; after the release it is a fault and recovered."""
    agent = phm(**HEAL)
    said = agent.verb("hold", project.container, "--for", "10min", "--reason", "swapping firmware")
    assert said.startswith(f"{project.container} is on hold until ") and "swapping firmware" in said
    project.docker("kill", project.container)
    agent.until(lambda: agent.level() is Level.STALE and agent.decided(), "the unit to be on hold")
    state = next(state for state in agent.daemon.pipeline.states() if state.unit == agent.unit)
    assert "swapping firmware" in state.result.summary and agent.faults() == []
    agent.until(lambda: f"on hold: {project.container} until" in agent.status(), "the status to show it")
    assert agent.verb("release", project.container) == f"released: {project.container}\n"
    agent.until(lambda: Phase.VERIFIED in agent.phases(), "the container to be started")
    assert agent.faults() == [agent.unit]


def test_a_hold_survives_a_restart_of_phm(phm: Any, project: Project, tmp_path: Path) -> None:
    """The next PHM keeps the previous holds, until the same end."""
    agent = phm(**HEAL)
    agent.daemon.components.holds.hold(project.container, 600.0, "swapping firmware", "operator (uid 0)")
    before = agent.daemon.components.holds.snapshot()[0]
    agent.daemon.stop()
    project.docker("kill", project.container)
    following = Phm(tmp_path, project.container, **HEAL)
    try:
        following.until(lambda: following.level() is Level.STALE and following.daemon.pipeline.complete, "the hold")
        after = following.daemon.components.holds.snapshot()[0]
        assert after["left_s"] < before["left_s"] and after["reason"] == "swapping firmware"
        assert following.faults() == [] and following.phases() == []
    finally:
        following.daemon.stop()
