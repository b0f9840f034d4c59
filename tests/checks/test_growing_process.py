"""Rules of the process that is named when the memory of its container fills."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks._growing_process import LEAST_S, MOST_S
from phm_checks._text import BRIEF_MAX
from phm_checks.pressure import Pressure
from tests.fakes.nodes_bench import MAIN, ONE, TWO

MIB = 1 << 20
KNOWN_S = 75
"""A leak of 0.5 MB a second is forecast after 60 s; the second list of processes follows 8 s later."""


class Bench:
    """The check on one container with a limit of 256 MB, of which it uses 180 MB, once a second. `memory`: MB by process, as a function of the second."""

    def __init__(
        self, memory: Callable[[int], Mapping[api.ProcessFact, float]], name: str = "ros_app", **more: Any
    ) -> None:
        ros = {"nodes": [{"name": "agent_1/node_1"}, {"name": "agent_1/node_2"}]}
        (self.check,) = Pressure.build(testing.settings(**{"containers": [{"name": name}], "ros": ros, **more}))
        self.clock, self.pressure = testing.FakeClock(), testing.FakePressure()
        self.docker, self.name = testing.FakeDocker(testing.container(name)), name
        self.memory, self.second, self.generation, self.other = memory, 0, "a", 0.0
        self.listed_at: list[int] = []

    def run(self, seconds: int) -> api.Result:
        """`other`: MB of the container that belong to no process, such as a tmpfs."""
        for _ in range(seconds):
            amounts = self.memory(self.second)
            used = round((180 + self.other + sum(amounts.values()) - sum(self.memory(0).values())) * MIB)
            fact = api.PressureFact(
                self.clock.mono(), "cgroup v2", self.generation, without_cache_bytes=used, memory_limit=256 * MIB
            )
            self.pressure.put(self.name, fact)
            self.docker.lists[self.name] = tuple(
                replace(process, memory_bytes=round(amount * MIB)) for process, amount in amounts.items()
            )
            before = self.docker.listings
            result = self.check.run(testing.world(clock=self.clock, pressure=self.pressure, docker=self.docker))
            self.listed_at += [self.second] * (self.docker.listings - before)
            self.second += 1
            self.clock.advance(1.0)
        assert isinstance(result, api.Result)
        return result


def leak(of: api.ProcessFact = ONE, *steady: api.ProcessFact) -> Callable[[int], Mapping[api.ProcessFact, float]]:
    return lambda second: {of: 20 + 0.5 * second, **dict.fromkeys((MAIN, *steady), 30.0)}


def test_the_node_that_leaks_is_named() -> None:
    """In the text with its process on the host, and in the brief."""
    result = Bench(leak(ONE, TWO)).run(KNOWN_S)
    assert (result.level, result.condition) == (api.Level.WARN, "memory_filling")
    assert "growing by 30 MB a minute, most of it node /agent_1/node_1 (process 71): find the leak" in result.summary
    assert result.brief == "ros_app memory full in 2 min (node_1)"


def test_no_process_is_named_before_the_second_list() -> None:
    """The warning itself does not wait for it."""
    result = Bench(leak()).run(62)
    assert result.condition == "memory_filling" and "most of it" not in result.summary
    assert result.brief == "ros_app memory full in 2 min"


def test_a_process_of_no_node_is_named_by_its_program() -> None:
    """Not with its arguments: they may contain a password."""
    other = api.ProcessFact(99, 1, "S", 5.0, "/usr/bin/bagger --token secret")
    result = Bench(leak(other, ONE, TWO)).run(KNOWN_S)
    assert "most of it process 99 (bagger): find" in result.summary and "secret" not in result.summary
    assert result.brief.endswith("(bagger)")


def test_nodes_of_one_process_are_named_together() -> None:
    """A process of components, as configured."""
    ros = {"nodes": [{"name": f"agent_1/node_{n}", "process": ["component_container"]} for n in (1, 2)]}
    process = api.ProcessFact(99, 1, "S", 5.0, "/opt/ros/lib/component_container")
    result = Bench(leak(process), ros=ros).run(KNOWN_S)
    assert "most of it nodes /agent_1/node_1, /agent_1/node_2 (process 99)" in result.summary


@pytest.mark.parametrize("command", ["/x/\x1b[31m\u202eevil\n\x00 --x", "\ud800", "", " ", "x" * 4096, "ä" * 200])
def test_a_hostile_name_of_a_program_is_harmless(command: str) -> None:
    """Anything may be in a command line: the text stays printable and short, and so does the brief."""
    result = Bench(leak(api.ProcessFact(99, 1, "S", 5.0, command))).run(KNOWN_S)
    assert "most of it process 99" in result.summary
    assert result.summary.isprintable() and len(result.summary) < 350
    assert result.brief.startswith("ros_app memory full in 2 min") and len(result.brief) <= BRIEF_MAX
    assert result.brief.isascii()


def test_a_name_that_does_not_fit_is_left_out_of_the_brief() -> None:
    """The container and the time are more important."""
    result = Bench(leak(), name="the_application_1").run(KNOWN_S)
    assert result.brief == "the_application_1 memory full in 2 min" and "node_1" in result.summary


def test_nothing_is_listed_while_nothing_is_forecast() -> None:
    """Each list costs the engine a `ps`."""
    bench = Bench(lambda _: {ONE: 20.0})
    bench.run(300)
    assert bench.docker.listings == 0


def test_lists_become_rare() -> None:
    """While the forecast lasts: at first after 4 MB, at last once a minute."""
    bench = Bench(lambda second: {ONE: 20 + 0.2 * second})
    result = bench.run(370)
    assert "node_1" in result.summary
    apart = [later - earlier for earlier, later in zip(bench.listed_at, bench.listed_at[1:], strict=False)]
    assert apart == [20, 40, MOST_S, MOST_S]


def test_memory_of_no_process_names_no_process() -> None:
    """A tmpfs that fills: no process has it."""
    bench = Bench(lambda _: {ONE: 20.0, TWO: 20.0})
    for _ in range(120):
        bench.other += 0.5
        result = bench.run(1)
    assert result.condition == "memory_filling" and "most of it" not in result.summary


def test_growth_of_several_alike_names_no_process() -> None:
    """Four nodes that grow equally: none has most of it."""
    four = [api.ProcessFact(100 + n, 1, "S", 0.0, f"program {n}") for n in range(4)]
    result = Bench(lambda second: dict.fromkeys(four, 20 + 0.125 * second)).run(120)
    assert result.condition == "memory_filling" and "most of it" not in result.summary


def test_shared_memory_names_no_process() -> None:
    """It counts for each process that uses it, and once for the container."""
    bench = Bench(lambda second: {ONE: 20 + 0.5 * second, TWO: 20 + 0.5 * second})
    for _ in range(120):
        bench.other -= 0.5
        result = bench.run(1)
    assert result.condition == "memory_filling" and "most of it" not in result.summary


def test_a_mapped_file_is_not_a_leak() -> None:
    """A process whose memory grows by far more than that of its container."""
    bench = Bench(lambda second: {ONE: 20 + 2.0 * second})
    for _ in range(120):
        bench.other -= 1.5
        result = bench.run(1)
    assert result.condition == "memory_filling" and "most of it" not in result.summary


def test_memory_that_comes_and_goes_is_not_taken_for_the_leak() -> None:
    """Another process that has 12 MB more at the second list, and no longer at the third."""
    bench = Bench(lambda second: {ONE: 20 + 0.2 * second, TWO: 32.0 if 140 < second < 160 else 20.0})
    named = [bench.run(1).summary for _ in range(370)]
    assert not [words for words in named if "node_2" in words]
    assert "node_1" in named[-1]


def test_a_process_that_started_later_is_found() -> None:
    """After one more list: its growth is unknown before."""
    late = api.ProcessFact(99, 1, "S", 5.0, "late")
    bench = Bench(lambda second: {ONE if second < 66 else late: 20 + 0.5 * second})
    assert "most of it" not in bench.run(KNOWN_S).summary
    assert "process 99 (late)" in bench.run(30).summary


def test_a_number_that_was_given_to_another_process_is_not_compared() -> None:
    """The kernel gives numbers again."""
    bench = Bench(lambda second: {ONE if second < 66 else api.ProcessFact(71, 1, "S", 0.0, "late"): 20 + 0.5 * second})
    assert "most of it" not in bench.run(KNOWN_S).summary


def test_a_restart_of_the_container_forgets_the_process() -> None:
    """And starts with its own trend."""
    bench = Bench(leak())
    assert "node_1" in bench.run(KNOWN_S).summary
    bench.generation = "b"
    assert bench.run(2).level is api.Level.OK
    listings = bench.docker.listings
    bench.run(10)
    assert bench.docker.listings == listings


def test_a_ps_without_memory_names_no_process() -> None:
    """BusyBox."""
    bench = Bench(leak())
    bench.docker.processes = lambda name: (MAIN, ONE)  # type: ignore[method-assign]
    result = bench.run(120)
    assert result.condition == "memory_filling" and "most of it" not in result.summary


def test_an_engine_that_does_not_answer_is_asked_rarely() -> None:
    """Each question may take its full deadline."""
    bench = Bench(leak())
    bench.run(60)
    bench.docker.problems["ros_app"] = api.CannotTell("hung")
    result = bench.run(60)
    assert result.condition == "memory_filling" and "most of it" not in result.summary
    assert 2 <= len(bench.listed_at) <= 4


def test_a_proxy_that_refuses_is_asked_once() -> None:
    """Each refusal is a line in its log."""
    bench = Bench(leak())
    bench.docker.problems["ros_app"] = api.NotPermitted("403")
    assert bench.run(120).condition == "memory_filling"
    assert len(bench.listed_at) == 1


def test_a_fast_leak_is_named_within_seconds() -> None:
    """4 MB grow in one step then."""
    bench = Bench(lambda second: {ONE: 20 + 0.9 * second})
    bench.run(70)
    assert bench.listed_at[1] - bench.listed_at[0] == LEAST_S
