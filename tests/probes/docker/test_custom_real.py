"""Checks without code, inside real containers: programs and Docker's logs."""

from __future__ import annotations

from typing import Any

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.core.model import Level, Result
from phm.facts import CannotTell, World
from phm.probes.docker import Docker
from phm.probes.log_file import READ_BYTES
from phm.probes.logs import Logs
from phm.probes.pattern_matcher import PatternMatcher
from phm.probes.programs import OUTPUT_BYTES, Programs
from phm.transport.docker import DockerEngine, EngineTimeout
from phm_checks.custom import Custom
from tests.fakes.until import until

CLOCK = SystemClock()


class Place:
    """A configured container and the real probes."""

    def __init__(self, engine: DockerEngine, name: str) -> None:
        self.name = name
        containers = testing.settings(containers=[{"name": name}]).containers
        docker = Docker(engine, containers, testing.settings().docker, CLOCK)
        self.matcher = PatternMatcher(CLOCK, limit_s=60.0)
        self.container = docker.container
        self.programs = Programs(engine, docker.container, CLOCK)
        logs = Logs(engine, docker.container, CLOCK, self.matcher)
        self.world: World = testing.world(clock=CLOCK, docker=docker, programs=self.programs, logs=logs)

    def check(self, **entry: Any) -> Any:
        entry = {"name": "x", "container": self.name, "timeout": 60, **entry}
        (check,) = Custom.build(testing.settings(containers=[{"name": self.name}], custom=[entry]))
        return check

    def run(self, check: Any) -> Result:
        result = check.run(self.world)
        assert isinstance(result, Result)
        return result


@pytest.fixture
def place(real: Any, engine: DockerEngine) -> Any:
    command = "while :; do cat /tmp/say 2>/dev/null && rm /tmp/say; sleep 0.1; done"
    made = Place(engine, real.container(command).name)
    yield made
    made.matcher.close()


def test_a_program_that_was_prepared_and_never_started_is_not_waited_for(
    place: Place, engine: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine was too busy, or a socket proxy refused: its exit code is neither there nor to come."""

    def busy(*_: object, **__: object) -> None:
        raise CannotTell("the Docker Engine did not answer in time")

    with monkeypatch.context() as patched:
        patched.setattr(engine, "exec_read", busy)
        with pytest.raises(CannotTell, match="did not answer"):
            place.programs.run(["true"], timeout_s=10, container=place.name)
    assert place.programs.run(["true"], timeout_s=60, container=place.name).exit_code == 0


def test_a_program_that_a_busy_engine_may_still_start_is_not_started_twice(
    place: Place, engine: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine has not answered the request to start it: the program may begin later, and a second one beside it."""

    def late(*_: object, **__: object) -> None:
        raise EngineTimeout("the Docker Engine did not answer in time")

    clock = testing.FakeClock()
    programs = Programs(engine, place.container, clock)
    with monkeypatch.context() as patched:
        patched.setattr(engine, "exec_read", late)
        with pytest.raises(EngineTimeout):
            programs.run(["true"], timeout_s=10, container=place.name)
    with pytest.raises(CannotTell, match="may still start true of an earlier run"):
        programs.run(["true"], timeout_s=60, container=place.name)
    clock.advance(60.0)
    assert programs.run(["true"], timeout_s=60, container=place.name).exit_code == 0


def shell(script: str) -> list[str]:
    return ["sh", "-c", script]


def saying(text: str) -> list[str]:
    """A program after which the container's own program writes the text into its log."""
    return shell(f"echo '{text}' > /tmp/say.new; mv /tmp/say.new /tmp/say")


def test_a_program_in_a_container_is_judged_by_exit_code_and_output(place: Place) -> None:
    """Its output and its errors arrive apart; much of it is cut. A busy engine now and then loses output: then it runs again."""
    check = place.check(type="command", command=shell("echo 'FUEL low|fuel=7%'; echo more >&2; exit 1"))
    result = until(lambda: (found := place.run(check)).values and found, "its output")
    assert (result.level, result.summary, result.values["fuel_percent"]) == (Level.WARN, "x: FUEL low", 7.0)

    def much() -> int:
        fact = place.programs.run(shell("yes | head -c 1000000"), timeout_s=60, container=place.name)
        assert fact.exit_code == 0 and len(fact.output) <= OUTPUT_BYTES
        return len(fact.output)

    until(lambda: much() > OUTPUT_BYTES - 100, "much output")

    def errors() -> str:
        return place.programs.run(shell("echo only >&2"), timeout_s=60, container=place.name).output

    assert until(errors, "its errors") == "only\n"


def test_a_program_that_is_not_in_the_container_is_unknown(place: Place) -> None:
    """The engine says so with exit code 127 or an error."""
    with pytest.raises(CannotTell):
        place.run(place.check(type="command", command=["/nowhere/check"]))


def test_a_program_that_hangs_in_a_container_is_not_started_twice(place: Place) -> None:
    """Docker cannot end it, so the next runs say what they wait for, until it has ended."""
    words = shell("while [ ! -e /tmp/go ]; do sleep 0.1; done; echo done")

    def run(timeout_s: float) -> str:
        try:
            return place.programs.run(words, timeout_s=timeout_s, container=place.name).output
        except CannotTell as error:
            return str(error)

    # A busy engine may not have started it when the first run gives up: until it has, the next runs say that it may still start.
    until(lambda: "earlier run has not ended" in run(1.0), "a run that waits for an earlier one")
    place.programs.run(["touch", "/tmp/go"], timeout_s=60, container=place.name)
    until(lambda: run(60.0) == "done\n", "the end of the earlier run")


def test_a_line_in_the_log_of_a_container_is_found_once(place: Place) -> None:
    """Lines from before PHM do not count, and none counts twice."""

    def say(text: str) -> None:
        place.programs.run(saying(text), timeout_s=60, container=place.name)

    check = place.check(type="log", patterns=[{"pattern": "PUMP (dry|stuck)"}])
    assert place.run(check).level is Level.OK
    say("PUMP dry")
    found = until(lambda: (result := place.run(check)).level is Level.ERROR and result, "the line")
    assert found.summary.endswith("newest line: PUMP dry") and found.values["matches"] == 1
    say("fine")
    until(lambda: place.run(check).values["lines"] == 1, "the other line")
    assert place.run(check).values == {"lines": 0, "matches": 1}


def test_a_line_after_one_that_never_ends_is_found(place: Place) -> None:
    """A progress bar writes more than one read of PHM, without an end of line. What follows counts."""
    check = place.check(type="log", patterns=[{"pattern": "PUMP dry"}])
    assert place.run(check).level is Level.OK
    place.programs.run(
        ["sh", "-c", "head -c 600000 /dev/zero | tr '\\0' x > /tmp/said"], timeout_s=60, container=place.name
    )
    place.programs.run(["mv", "/tmp/said", "/tmp/say"], timeout_s=60, container=place.name)
    # Counted as one line, of which the rest was left out; a busy engine delivers it in several runs.
    skipped: list[float] = []

    def enough() -> bool:
        skipped.append(float(place.run(check).values.get("skipped_bytes", 0) or 0))
        return sum(skipped) > READ_BYTES // 2

    until(enough, "the long line", lambda: skipped)
    place.programs.run(saying("\nPUMP dry"), timeout_s=60, container=place.name)
    until(lambda: place.run(check).level is Level.ERROR, "the line after it")


def test_processes_of_a_container_are_counted(place: Place) -> None:
    """From the engine's list."""
    check = place.check(type="process", process=["while", "sleep"])
    until(lambda: place.run(check).level is Level.OK, "the program to be listed")
    assert place.run(place.check(type="process", process=["no such process"])).level is Level.ERROR


class SlowClock(SystemClock):
    """The computer's clock, `behind_s` late: a companion computer without a battery-backed clock, before it has the time."""

    behind_s = 0.0

    def utc(self) -> float:
        return super().utc() - self.behind_s


def test_lines_of_an_earlier_flight_are_not_new_where_the_clock_was_set_back(
    place: Place, engine: DockerEngine
) -> None:
    """Their times are in the future. Until the clock has reached them, new lines cannot be distinguished, which is STALE."""
    container = place.world.docker.container(place.name)
    assert container is not None
    place.run(place.check(type="command", command=saying("FATAL of before")))
    until(lambda: b"FATAL" in engine.logs(container.id, "0.0", tail=10, limit=1000), "the line is in the log")
    clock = SlowClock()
    clock.behind_s = 3600.0
    logs = Logs(engine, place.world.docker.container, clock, place.matcher)
    check = place.check(type="log", patterns=[{"pattern": "FATAL"}])
    world = testing.world(clock=clock, docker=place.world.docker, logs=logs)
    assert check.run(world).level is Level.OK
    with pytest.raises(CannotTell, match="after the present time: the clock was set back"):
        check.run(world)
    clock.behind_s = 0.0
    assert check.run(world).level is Level.OK
    place.run(place.check(type="command", command=saying("FATAL now")))
    until(lambda: check.run(world).level is Level.ERROR, "the new line")
