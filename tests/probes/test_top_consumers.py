"""The top CPU consumers from fabricated cgroup trees and engine answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.facts import CannotTell, ConsumerFact
from phm.probes.top_consumers import AGAIN_S, BUDGET_S, LEAST_S, MOST_S, TopConsumers
from phm.transport.docker import EngineRefused, EngineTimeout
from tests.probes.test_pressure import ID, OTHER, Bench, CountingEngine, v1, v2, write


class TwoContainers:
    """Two containers, one of them configured, on a machine whose CPUs are counted in `proc`."""

    def __init__(self, tmp_path: Path, files: bool = True) -> None:
        self.root, self.proc = tmp_path / "cgroup", tmp_path / "proc"
        self.engine, self.clock, self.files = CountingEngine(), testing.FakeClock(), files
        self.engine.names = [{"Id": OTHER, "Names": ["/slam"], "State": "running"}]
        if files:
            write(self.root, {"cgroup.controllers": "cpu\n"})
        self.after(0, 0, 0)
        self.consumers = TopConsumers(self.engine, self.root, self.clock, lambda: {ID: "ros_app"}, self.proc)  # type: ignore[arg-type]

    def after(self, ours_s: float, slam_s: float, all_s: float) -> None:
        """Set the CPU seconds used since the start."""
        write(self.proc, {"stat": f"cpu  {round(all_s * 100)} 0 0 500 20 0 0 0 0 0\n"})
        if self.files:
            write(self.root / "docker" / ID, {"cpu.stat": f"usage_usec {round(ours_s * 1e6)}\n"})
            write(
                self.root / "system.slice" / f"docker-{OTHER}.scope",
                {"cpu.stat": f"usage_usec {round(slam_s * 1e6)}\n"},
            )
            write(self.root / "system.slice" / "cron.service", {"cpu.stat": "usage_usec 9\n"})


def test_consumers_are_sorted_by_usage(tmp_path: Path) -> None:
    """By key or by the engine's name; a process outside containers has none. The first call has no reference."""
    containers = TwoContainers(tmp_path)
    assert containers.consumers.read() == ()
    containers.clock.advance(2.0)
    containers.after(0.2, 3.0, 3.9)
    read = [(fact.name, round(fact.cpus, 2)) for fact in containers.consumers.read()]
    assert read == [("slam", 1.5), ("", 0.35), ("ros_app", 0.1)]
    assert containers.engine.asked == ["list"]


def test_containers_in_a_slice_of_the_user_are_consumers(tmp_path: Path) -> None:
    """They are no processes outside containers. One that is not configured is found beside a configured one."""
    for version, file, unit in (("v1", "cpuacct.usage", 1e9), ("v2", "cpu.stat", 1e6)):
        root, name = tmp_path / version, "" if version == "v1" else "usage_usec "
        (v1 if version == "v1" else v2)(root, f"robot.slice/docker-{ID}.scope")
        base = root / ("cpuacct" if version == "v1" else "") / "robot.slice"
        bench = Bench(root, cgroup_parent="robot.slice")
        bench.engine.names = [{"Id": OTHER, "Names": ["/slam"], "State": "running"}]
        assert bench.probe.container("ros_app") is not None
        for used_s in (0.0, 3.0):
            for container, part in ((ID, 0.5), (OTHER, 1.0)):
                write(base / f"docker-{container}.scope", {file: f"{name}{round(part * used_s * unit)}\n"})
            bench.clock.advance(2.0)
            found = bench.probe.consumers()
        assert [(fact.name, fact.cpus) for fact in found if fact.name] == [("slam", 1.5), ("ros_app", 0.75)]


def test_consumers_are_measured_at_limited_intervals(tmp_path: Path) -> None:
    """Several checks ask at the same time, and an old measurement says nothing about now."""
    containers = TwoContainers(tmp_path)
    containers.consumers.read()
    containers.clock.advance(1.0)
    containers.after(0.0, 1.0, 1.0)
    first = containers.consumers.read()
    containers.clock.advance(LEAST_S / 2)
    assert containers.consumers.read() is first and first[0].name == "slam"
    containers.clock.advance(MOST_S + 1)
    assert containers.consumers.read() == ()


def test_a_container_without_a_name_of_the_engine_keeps_its_id(tmp_path: Path) -> None:
    """As behind a proxy that does not allow a list."""
    containers = TwoContainers(tmp_path)
    containers.engine.names = EngineRefused("403")
    containers.consumers.read()
    containers.clock.advance(1.0)
    containers.after(0.0, 1.0, 1.0)
    assert containers.consumers.read() == (ConsumerFact(f"container {OTHER[:12]}", 1.0),)


def test_an_engine_that_hangs_costs_one_request(tmp_path: Path) -> None:
    """Also with many new containers: the checks of an overload wait for this. The names come when the engine answers."""
    containers = TwoContainers(tmp_path)
    clock, ids = containers.clock, [f"{number:064x}" for number in range(1, 17)]
    asked = 0

    def hangs(*, deadline_s: float, **_: Any) -> Any:
        nonlocal asked
        asked += 1
        clock.advance(deadline_s)
        raise EngineTimeout("no answer")

    answers, containers.engine.list = containers.engine.list, hangs  # type: ignore[method-assign]
    containers.engine.names = [{"Id": each, "Names": [f"/c{each[-2:]}"]} for each in ids]

    def read(used_s: float) -> list[str]:
        for each in ids:
            write(containers.root / "docker" / each, {"cpu.stat": f"usage_usec {round(used_s * 1e6)}\n"})
        began_s = clock.mono()
        found = containers.consumers.read()
        assert clock.mono() - began_s <= BUDGET_S
        clock.advance(LEAST_S)
        return [fact.name for fact in found]

    read(0.0)
    for used_s in (1.0, 2.0, 3.0):
        assert read(used_s)[0].startswith("container 0000")
    assert asked == 1
    clock.advance(AGAIN_S)
    containers.engine.list = answers  # type: ignore[method-assign]
    assert sorted(read(9.0)) == [f"c{each[-2:]}" for each in ids]


def test_without_cgroups_the_engine_provides_the_consumers(tmp_path: Path) -> None:
    """One request for each running container, the configured ones first."""
    containers = TwoContainers(tmp_path, files=False)
    containers.consumers.read()
    assert containers.engine.asked == ["list", ID, OTHER]
    containers.clock.advance(1.0)
    containers.consumers.read()
    assert containers.engine.asked == ["list", ID, OTHER], "not so soon again"
    containers.clock.advance(4.0)
    containers.engine.answer = {"cpu_stats": {"cpu_usage": {"total_usage": 2680194374}}}
    assert {fact.name: round(fact.cpus, 2) for fact in containers.consumers.read()}["slam"] == 0.5


def test_a_proxy_that_refuses_the_list_is_asked_once(tmp_path: Path) -> None:
    """Each refusal is a line in the proxy's log; the configured containers are known without it."""
    containers = TwoContainers(tmp_path, files=False)
    containers.engine.names = EngineRefused("403")
    for _ in range(3):
        containers.consumers.read()
        containers.clock.advance(5.0)
    assert containers.engine.asked == ["list", ID, ID, ID]


def test_a_restarted_container_is_not_counted_as_other_programs(tmp_path: Path) -> None:
    """Its counter restarts at 0: neither its share nor that of other programs is known for that measurement."""
    containers = TwoContainers(tmp_path)
    containers.after(500.0, 0.0, 500.0)
    containers.consumers.read()
    containers.clock.advance(1.0)
    containers.after(-1.0, 1.0, 2.0)
    assert [fact.name for fact in containers.consumers.read()] in ([], ["slam"], [f"container {OTHER[:12]}"])


def test_a_slow_engine_is_not_asked_about_all_containers(tmp_path: Path) -> None:
    """The time budget is for all requests together."""
    containers = TwoContainers(tmp_path, files=False)
    slow = containers.engine.stats

    def stats(container: str, **more: Any) -> Any:
        containers.clock.advance(5.0)
        return slow(container, **more)

    containers.engine.stats = stats  # type: ignore[method-assign]
    containers.consumers.read()
    assert containers.engine.asked == ["list", ID]


class ManyContainers(CountingEngine):
    """Sixty running containers; the one that uses two CPUs was started first, so the engine lists it last."""

    def __init__(self, clock: Any, takes_s: float) -> None:
        super().__init__()
        self.clock, self.takes_s = clock, takes_s
        ids = [f"{number:064x}" for number in range(60, 0, -1)]
        self.names = [{"Id": each, "Names": [f"/c{int(each, 16)}"], "State": "running"} for each in ids]

    def stats(self, container: str, **_: Any) -> Any:
        self.clock.advance(self.takes_s)
        used_s = 2.0 * self.clock.mono() if container.endswith("01") else 1.0
        return {"cpu_stats": {"cpu_usage": {"total_usage": round(used_s * 1e9)}}}


@pytest.mark.parametrize("takes_s", [0.02, 0.5])
def test_every_container_is_asked_about_in_turn(tmp_path: Path, takes_s: float) -> None:
    """However many run and however slow the engine is: those asked about in one reading are not always the same."""
    containers = TwoContainers(tmp_path, files=False)
    containers.consumers._engine = ManyContainers(containers.clock, takes_s)  # type: ignore[assignment]
    found: tuple[ConsumerFact, ...] = ()
    for _ in range(40):
        found = containers.consumers.read()
        if found:
            break
        containers.clock.advance(5.0)
    assert [(fact.name, round(fact.cpus, 2)) for fact in found] == [("c1", 2.0)]


def test_other_programs_are_not_blamed_while_the_containers_are_unknown(tmp_path: Path) -> None:
    """The engine does not answer, or a proxy refuses its list: what uses the CPU may be a container."""
    for error in (EngineRefused("403"), CannotTell("the engine did not answer")):
        containers = TwoContainers(tmp_path, files=False)
        containers.engine.names = error
        containers.consumers.read()
        containers.clock.advance(5.0)
        containers.after(0.0, 0.0, 10.0)
        assert containers.consumers.read() == ()
