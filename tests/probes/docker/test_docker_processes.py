"""The process list of a container: reading the engine's table, other kinds of `ps`, and the real thing."""

from __future__ import annotations

import signal
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.facts import CannotTell, ProcessFact
from phm.probes.docker import Docker
from phm.probes.docker_processes import AGAIN_MOST_S, AGAIN_S, FORMS, Processes, processes
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine, EngineBroken
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang, Status
from tests.fakes.until import until

TITLES = ["PID", "PPID", "STAT", "TIME", "ELAPSED", "COMMAND"]


def probe(engine: DockerEngine, name: str) -> Docker:
    return Docker(engine, settings(containers=[{"name": name}]).containers, settings().docker, SystemClock())


def test_a_row_is_a_process() -> None:
    """Numbers, the state's first letter, whole seconds of processor time and age, and the command as it is."""
    rows = [
        ["7", "1", "Sl+", "12", "300", "python -m sitl.application.node --name node_1"],
        ["8", "7", "R", "0", "0", "sh"],
    ]
    assert processes({"Titles": TITLES, "Processes": rows}) == (
        ProcessFact(7, 1, "S", 12.0, "python -m sitl.application.node --name node_1", 300.0),
        ProcessFact(8, 7, "R", 0.0, "sh", 0.0),
    )


def test_a_zombie_has_ended() -> None:
    """A child that nobody has reaped is no process any more."""
    rows = [["7", "1", "Z", "0", "9", "[python3] <defunct>"], ["8", "1", "S", "0", "9", "sh"]]
    assert [fact.pid for fact in processes({"Titles": TITLES, "Processes": rows})] == [8]


@pytest.mark.parametrize(
    "answer",
    [{}, {"Titles": None}, {"Titles": ["USER", "COMMAND"], "Processes": [["a", "b"]]}],
)
def test_a_table_without_numbers_cannot_be_told(answer: dict[str, Any]) -> None:
    """An engine that answers something else is no proof that nothing runs."""
    with pytest.raises(CannotTell):
        processes(answer)


@pytest.mark.parametrize("rows", [None, [None], [["x", "1", "S", "0", "9", "sh"]], [["1", "sh"]], [[]]])
def test_rows_that_make_no_sense_are_left_out(rows: Any) -> None:
    """A torn row is not a process, and breaks nothing."""
    assert processes({"Titles": TITLES, "Processes": rows}) == ()


def test_what_ps_does_not_tell_is_unknown() -> None:
    """The engine's default table has no state, and BusyBox no processor time."""
    (fact,) = processes({"Titles": ["UID", "PID", "PPID", "CMD"], "Processes": [["root", "7", "1", "sh -c x"]]})
    assert fact == ProcessFact(7, 1, "", None, "sh -c x")


class OtherPs:
    """An engine on a host whose `ps` knows only some forms."""

    def __init__(self, *known: str) -> None:
        self.known, self.asked = known, list[str]()

    def top(self, container: str, ps_args: str, *, deadline_s: float) -> dict[str, Any]:
        self.asked.append(ps_args)
        if ps_args not in self.known:
            raise EngineBroken("ps: bad -o argument 'times'")
        return {"Titles": ["PID", "PPID", "STAT", "COMMAND"], "Processes": [["7", "1", "S", "sh"]]}


def test_a_host_with_another_ps_is_asked_in_its_own_form() -> None:
    """BusyBox refuses the first form; after that it is asked in the second, and in the first less and less often."""
    engine, clock = OtherPs(FORMS[1]), FakeClock()
    asking = Processes(engine, clock)  # type: ignore[arg-type]
    assert asking.look("app") == asking.look("app") == (ProcessFact(7, 1, "S", None, "sh"),)
    assert engine.asked == [*FORMS, FORMS[1]]
    for _ in range(10_000):
        clock.advance(1.0)
        asking.look("app")
    assert 10_000 / AGAIN_MOST_S < engine.asked.count(FORMS[0]) < 10_000 / AGAIN_MOST_S + 10


def test_one_refusal_does_not_cost_the_figures_for_ever() -> None:
    """HTTP 500 also says that this one `ps` could not be started."""
    engine, clock = OtherPs(FORMS[1]), FakeClock()
    asking = Processes(engine, clock)  # type: ignore[arg-type]
    asking.look("app")
    engine.known = FORMS
    engine.asked.clear()
    clock.advance(AGAIN_S)
    asking.look("app")
    asking.look("app")
    assert engine.asked == [FORMS[0], FORMS[0]]


def test_a_host_without_ps_cannot_tell() -> None:
    """Each question is an answer of its own: a `ps` may be installed tomorrow."""
    asking = Processes(OtherPs(), FakeClock())  # type: ignore[arg-type]
    for _ in range(2):
        with pytest.raises(CannotTell):
            asking.look("app")


def test_a_container_that_does_not_run_has_no_list(fake: FakeEngine, ask: DockerEngine) -> None:
    """Stopped, or not there: cannot tell, which is no death of a node."""
    fake.containers["app"] = container("app", status="exited")
    for name in ("app", "other"):
        with pytest.raises(CannotTell, match="is not running"):
            probe(ask, name).processes(name)


@pytest.mark.parametrize("fault", [Hang(route="/top"), Status(403, route="/top"), Status(500, route="/top")])
def test_an_engine_that_does_not_list_cannot_tell(fake: FakeEngine, ask: DockerEngine, fault: Any) -> None:
    """Hanging, not permitted, broken: a sentence within the deadline."""
    fake.containers["app"] = container("app")
    fake.fault = fault
    with pytest.raises(CannotTell):
        probe(ask, "app").processes("app")


@pytest.mark.engine
def test_real_processes_with_their_state(real: Any, engine: DockerEngine) -> None:
    """Asleep, busy, stopped, gone: each shows in the list of a real container, with long arguments in full."""
    long = "x" * 1000
    made = real.container(f"sleep 601 & bash -c 'while :; do :; done' busy {long} & exec sleep 602")
    docker = probe(engine, made.name)

    def find(word: str) -> ProcessFact | None:
        found = (fact for fact in docker.processes(made.name) if word in fact.command.split())
        # The container's init names all of its arguments, too.
        return next((fact for fact in found if "docker-init" not in fact.command), None)

    def state(word: str) -> str:
        fact = find(word)
        return fact.state if fact is not None else "gone"

    until(lambda: state("601") == "S" and state("busy") == "R", "both children")
    busy = find("busy")
    assert busy is not None
    assert busy.command.endswith(long)
    parent = find("602")
    assert parent is not None
    assert None not in (parent.age_s, busy.age_s)
    assert busy.parent == parent.pid
    until(lambda: (getattr(find("busy"), "cpu_s", None) or 0) >= 1, "its processor time to advance")
    for number, letter in ((signal.SIGSTOP, "T"), (signal.SIGCONT, "R"), (signal.SIGKILL, "gone")):
        made.exec_run(["pkill", f"-{number.value}", "-f", "^bash"])
        until(lambda letter=letter: state("busy") == letter, f"state {letter}")  # type: ignore[misc]
