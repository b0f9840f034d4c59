"""The process list of a container: the engine's table, other kinds of `ps`, and real processes."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Sequence
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.facts import CannotTell, ProcessFact
from phm.probes.docker import Docker
from phm.probes.docker_processes import AGAIN_MOST_S, AGAIN_S, FORMS, Processes, processes
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine, EngineBroken, EngineTimeout
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang, Status
from tests.fakes.until import until

TITLES = ["PID", "PPID", "STAT", "TIME", "ELAPSED", "RSS", "COMMAND"]


def probe(engine: DockerEngine, name: str) -> Docker:
    return Docker(engine, settings(containers=[{"name": name}]).containers, settings().docker, SystemClock())


def test_a_row_is_a_process() -> None:
    """Numbers, the first letter of the state, CPU time and age in whole seconds, memory in KiB, and the unmodified command.

    A rounded number, as of BusyBox, is unknown.
    """
    rows = [
        ["7", "1", "Sl+", "12", "300", "2048", "python -m sitl.application.node --name node_1"],
        ["8", "7", "R", "0", "0", "12m", "sh"],
    ]
    assert processes({"Titles": TITLES, "Processes": rows}) == (
        ProcessFact(7, 1, "S", 12.0, "python -m sitl.application.node --name node_1", 300.0, 2 << 20),
        ProcessFact(8, 7, "R", 0.0, "sh", 0.0),
    )


def test_a_zombie_has_terminated() -> None:
    """A child process that was not reaped no longer runs."""
    rows = [["7", "1", "Z", "0", "9", "0", "[python3] <defunct>"], ["8", "1", "S", "0", "9", "8", "sh"]]
    assert [fact.pid for fact in processes({"Titles": TITLES, "Processes": rows})] == [8]


@pytest.mark.parametrize(
    "answer",
    [{}, {"Titles": None}, {"Titles": ["USER", "COMMAND"], "Processes": [["a", "b"]]}],
)
def test_a_table_without_numbers_is_an_error(answer: dict[str, Any]) -> None:
    """An unexpected response does not prove that nothing runs."""
    with pytest.raises(CannotTell):
        processes(answer)


@pytest.mark.parametrize("rows", [None, [None], [["x", "1", "S", "0", "9", "8", "sh"]], [["1", "sh"]], [[]]])
def test_invalid_rows_are_dropped(rows: Any) -> None:
    """A truncated row is not a process, and breaks nothing."""
    assert processes({"Titles": TITLES, "Processes": rows}) == ()


def test_columns_that_ps_does_not_have_are_unknown() -> None:
    """The engine's default table has no state, and BusyBox has no CPU time."""
    (fact,) = processes({"Titles": ["UID", "PID", "PPID", "CMD"], "Processes": [["root", "7", "1", "sh -c x"]]})
    assert fact == ProcessFact(7, 1, "", None, "sh -c x")


class OtherPs:
    """An engine on a host whose `ps` accepts only some options."""

    def __init__(self, *known: str) -> None:
        self.known, self.asked = known, list[str]()

    def top(self, container: str, ps_args: str, *, deadline_s: float) -> dict[str, Any]:
        self.asked.append(ps_args)
        if ps_args not in self.known:
            raise EngineBroken("ps: bad -o argument 'times'")
        return {"Titles": ["PID", "PPID", "STAT", "COMMAND"], "Processes": [["7", "1", "S", "sh"]]}


def test_a_host_with_another_ps_gets_options_that_it_accepts() -> None:
    """BusyBox refuses the first options; after that the second ones are used, and the first ones are retried rarely."""
    engine, clock = OtherPs(FORMS[1]), FakeClock()
    asking = Processes(engine, clock)  # type: ignore[arg-type]
    assert asking.inspect("app") == asking.inspect("app") == (ProcessFact(7, 1, "S", None, "sh"),)
    assert engine.asked == [*FORMS, FORMS[1]]
    for _ in range(10_000):
        clock.advance(1.0)
        asking.inspect("app")
    assert 10_000 / AGAIN_MOST_S < engine.asked.count(FORMS[0]) < 10_000 / AGAIN_MOST_S + 10


def test_one_refusal_does_not_lose_the_figures_permanently() -> None:
    """HTTP 500 also means that this one `ps` could not be started."""
    engine, clock = OtherPs(FORMS[1]), FakeClock()
    asking = Processes(engine, clock)  # type: ignore[arg-type]
    asking.inspect("app")
    engine.known = FORMS
    engine.asked.clear()
    clock.advance(AGAIN_S)
    asking.inspect("app")
    asking.inspect("app")
    assert engine.asked == [FORMS[0], FORMS[0]]


def test_a_host_without_ps_raises() -> None:
    """Each request is tried: a `ps` may be installed later."""
    asking = Processes(OtherPs(), FakeClock())  # type: ignore[arg-type]
    for _ in range(2):
        with pytest.raises(CannotTell):
            asking.inspect("app")


def test_a_container_that_does_not_run_has_no_process_list(fake: FakeEngine, ask: DockerEngine) -> None:
    """Stopped or missing: unknown, which does not mean a dead node."""
    fake.containers["app"] = container("app", status="exited")
    for name in ("app", "other"):
        with pytest.raises(CannotTell, match="is not running"):
            probe(ask, name).processes(name)


@pytest.mark.parametrize("fault", [Hang(route="/top"), Status(403, route="/top"), Status(500, route="/top")])
def test_an_engine_that_lists_nothing_raises(fake: FakeEngine, ask: DockerEngine, fault: Any) -> None:
    """Hung, not permitted, broken: an error text within the deadline."""
    fake.containers["app"] = container("app")
    fake.fault = fault
    with pytest.raises(CannotTell):
        probe(ask, "app").processes("app")


@pytest.mark.engine
def test_real_processes_are_listed_with_their_state(real: Any, engine: DockerEngine) -> None:
    """Sleeping, busy, stopped, gone: each is visible in the list of a real container, with long arguments in full."""
    long = "x" * 1000
    made = real.container(f"sleep 601 & bash -c 'while :; do :; done' busy {long} & exec sleep 602")
    docker = probe(engine, made.name)

    def listed() -> Sequence[ProcessFact]:
        """On a busy machine the engine may answer after PHM's deadline: then it is asked again."""

        def answer() -> Sequence[ProcessFact] | None:
            with contextlib.suppress(EngineTimeout):
                return docker.processes(made.name)
            return None

        found: Sequence[ProcessFact] = until(answer, "the list of processes")
        return found

    def find(word: str) -> ProcessFact | None:
        found = (fact for fact in listed() if word in fact.command.split())
        # The container's init has all of these words, too, and so has the shell until it becomes the last of the programs.
        return next((fact for fact in found if fact.command.startswith(("sleep ", "bash "))), None)

    def state(word: str) -> str:
        fact = find(word)
        return fact.state if fact is not None else "gone"

    until(lambda: state("601") == "S" and state("busy") == "R" and find("602"), "both children, and their parent")
    until(lambda: (getattr(find("busy"), "cpu_s", None) or 0) >= 1, "its CPU time to increase")
    busy = find("busy")
    assert busy is not None
    assert busy.command.endswith(long)
    parent = find("602")
    assert parent is not None
    assert None not in (parent.age_s, busy.age_s)
    assert busy.memory_bytes and busy.memory_bytes > 1 << 20
    assert busy.parent == parent.pid
    for number, letter in ((signal.SIGSTOP, "T"), (signal.SIGCONT, "R"), (signal.SIGKILL, "gone")):
        made.exec_run(["pkill", f"-{number.value}", "-f", "^bash"])
        until(lambda letter=letter: state("busy") == letter, f"state {letter}")  # type: ignore[misc]
