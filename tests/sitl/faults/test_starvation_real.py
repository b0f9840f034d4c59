"""Faults that starve a container, on the real Docker Engine and kernel: each has its effect, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import os
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from docker import DockerClient
from docker.errors import APIError
from docker.models.containers import Container

from sitl.faults import (
    _container_process,
    _overload,
    all_faults,
    cpu_limited,
    disk_slow,
    memory_tight,
    overload_container_killed,
    overload_ends,
    overload_node_killed,
    pids_exhausted,
)
from sitl.faults._cgroups import cgroup
from sitl.faults.base import Agent
from tests.fakes.until import until

NODE = "n=600; mkdir -p /tmp/nodes; sleep $n & echo $! >/tmp/nodes/node_1.pid; while :; do wait; sleep 1; done"
LIMITS = {
    "cpu": ("cpu.cfs_quota_us", "cpu.cfs_period_us", "cpu.max"),
    "memory": ("memory.limit_in_bytes", "memory.max"),
    "pids": ("pids.max",),
    "blkio": ("blkio.throttle.read_bps_device", "blkio.throttle.write_bps_device", "io.max"),
}


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Agent]]:
    """Create agents whose application is one small container with the given limits; remove all at the end."""
    # What starves it must not end by itself before a busy machine has looked at it.
    lasts = str(_container_process.LASTS_S)
    monkeypatch.setattr(_container_process, "LASTS_S", 300)
    # This one has it since the import.
    monkeypatch.setattr(pids_exhausted, "HOLD", pids_exhausted.HOLD.replace(lasts, "300"))
    client = DockerClient.from_env(timeout=60)
    agents: list[Agent] = []

    def make(**limits: Any) -> Agent:
        project = f"phm-test-{uuid.uuid4().hex[:8]}"
        labels = {"com.docker.compose.project": project, "com.docker.compose.service": "ros_app", "phm.test": "1"}
        agent = Agent(project, "agent_1", client)
        agents.append(agent)
        client.containers.run(
            "phm-base:dev",
            ["sh", "-c", NODE],
            name=f"{project}-ros_app-1",
            detach=True,
            labels=labels,
            init=True,
            **limits,
        )
        until(lambda: agent.app.exec_run(["test", "-s", "/tmp/nodes/node_1.pid"]).exit_code == 0, "the node's process")
        return agent

    yield make
    for agent in agents:
        _overload.end_overload(agent)
        agent.app.remove(force=True, v=True)
    client.close()


def kernel(container: Container) -> dict[str, str]:
    """Every limit of the container that these faults change, as read from the kernel."""
    found = {}
    for controller, names in LIMITS.items():
        for file in (cgroup(container, controller) / name for name in names):
            if file.exists():
                found[file.name] = file.read_text("ascii")
    return found


def counter(container: Container, controller: str, *places: tuple[str, str]) -> int:
    """The first of these counters that exists: file, and the key of its line or empty."""
    folder = cgroup(container, controller)
    for name, word in places:
        if (folder / name).exists():
            lines = (folder / name).read_text("ascii").splitlines()
            return int(next(line for line in lines if line.startswith(word)).split()[-1])
    raise AssertionError(f"{folder} has none of {places}")


def hogs(agent: Agent) -> list[Container]:
    wanted = {"name": f"{agent.project}-overload-"}
    return list(agent.docker.containers.list(all=True, filters=wanted, ignore_removed=True))


@pytest.mark.parametrize("limits", [{}, {"nano_cpus": 1_500_000_000}, {"cpu_period": 50_000, "cpu_quota": 40_000}])
def test_a_cpu_limit_throttles_and_is_restored(made: Callable[..., Agent], limits: dict[str, int]) -> None:
    """Whatever limit the container had, 3 % throttles it, and clearing restores exactly that limit, also when repeated."""
    agent, fault = made(**limits), cpu_limited.Injection()
    before = kernel(agent.app)
    fault.inject(agent)
    quota, period = _quota(agent.app)
    assert quota == pytest.approx(0.03 * period)
    assert fault.restored(agent) is False
    agent.app.exec_run(["timeout", "60", "sh", "-c", "while :; do :; done"], detach=True)
    until(lambda: counter(agent.app, "cpu", ("cpu.stat", "nr_throttled ")) > 2, "throttling")
    for _ in range(2):
        fault.clear(agent)
        assert kernel(agent.app) == before
        assert fault.restored(agent) is True


def _quota(app: Container) -> tuple[int, int]:
    folder = cgroup(app, "cpu")
    if (folder / "cpu.max").exists():
        quota, period = (folder / "cpu.max").read_text("ascii").split()
    else:
        quota, period = ((folder / name).read_text("ascii") for name in ("cpu.cfs_quota_us", "cpu.cfs_period_us"))
    return int(quota), int(period)


def test_low_memory_is_reclaimed_and_nothing_is_killed(made: Callable[..., Agent]) -> None:
    """The kernel reclaims pages that are needed again, endlessly; no process is killed, and the limit is restored."""
    agent, fault = made(mem_limit="256m", memswap_limit="256m"), memory_tight.Injection()
    before = kernel(agent.app)

    def refaults() -> int:
        return counter(agent.app, "memory", ("memory.stat", "workingset_refault_file "))

    fault.inject(agent)
    assert fault.restored(agent) is False
    for _ in range(3):
        seen = refaults()
        until(lambda seen=seen: refaults() > seen, "reclaim")  # type: ignore[misc]
    assert counter(agent.app, "memory", ("memory.events", "oom_kill "), ("memory.oom_control", "oom_kill ")) == 0
    for _ in range(2):
        fault.clear(agent)
        assert kernel(agent.app) == before
        assert fault.restored(agent) is True
    assert agent.processes(agent.app, memory_tight.FILE) == []


def test_a_container_without_a_memory_limit_is_not_changed(made: Callable[..., Agent]) -> None:
    """The Docker Engine cannot remove a memory limit, so the fault reports that it needs one and changes nothing."""
    agent = made()
    before = kernel(agent.app)
    with pytest.raises(LookupError, match="no memory limit"):
        memory_tight.Injection().inject(agent)
    assert kernel(agent.app) == before


def test_a_slow_disk_makes_writers_wait(made: Callable[..., Agent]) -> None:
    """1 MiB takes at least 2 s at 256 KiB/s, since the limit permits no more; clearing removes it."""
    agent, fault = made(), disk_slow.Injection()
    before = kernel(agent.app)
    fault.inject(agent)
    assert fault.restored(agent) is False
    began = time.monotonic()
    agent.run_in_app("dd", "if=/dev/zero", "of=/tmp/probe", "bs=256k", "count=4", "conv=fsync")
    assert time.monotonic() - began > 2.0
    assert agent.processes(agent.app, disk_slow.FILE)
    for _ in range(2):
        fault.clear(agent)
        assert kernel(agent.app) == before
        assert fault.restored(agent) is True
    assert agent.processes(agent.app, disk_slow.FILE) == []


def test_a_slow_disk_is_cleared_after_the_container_has_ended(made: Callable[..., Agent]) -> None:
    """Clearing is harmless when the container and its cgroup no longer exist."""
    agent, fault = made(), disk_slow.Injection()
    fault.inject(agent)
    with contextlib.suppress(APIError):  # the Docker Engine does not wait for processes that wait for their disk
        agent.app.kill()
    until(lambda: agent.app.status == "exited", "its end")
    fault.clear(agent)


@pytest.mark.parametrize("limits", [{}, {"pids_limit": 300}])
def test_no_process_starts_at_the_limit(made: Callable[..., Agent], limits: dict[str, int]) -> None:
    """At the limit no command in the container can start another one; clearing ends the processes and restores the
    limit.
    """
    agent, fault = made(**limits), pids_exhausted.Injection()
    before = kernel(agent.app)
    fault.inject(agent)
    assert fault.restored(agent) is False
    for _ in range(3):
        assert agent.app.exec_run(["sh", "-c", "true & wait $!"]).exit_code != 0
    for _ in range(2):
        fault.clear(agent)
        assert kernel(agent.app) == before
        assert fault.restored(agent) is True
    assert agent.processes(agent.app, pids_exhausted.MARK) == []
    agent.run_in_app("true")


@pytest.mark.parametrize("module", [memory_tight, disk_slow, pids_exhausted])
def test_an_interrupted_injection_is_undone(
    made: Callable[..., Agent], monkeypatch: pytest.MonkeyPatch, module: Any
) -> None:
    """The limits are the same as before the interruption."""
    agent = made(mem_limit="256m", memswap_limit="256m")
    before = kernel(agent.app)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        module.Injection().inject(agent)
    assert kernel(agent.app) == before


def test_an_overload_runs_the_requested_loops(made: Callable[..., Agent]) -> None:
    """As many loops run as requested, in separate containers."""
    agent = made()
    _overload.overload(agent, lasts_s=180.0, loops_per_core=2, hogs=2)
    loops = 2 * (os.cpu_count() or 1)
    until(lambda: _loops(agent) == loops, "the loops")
    assert agent.app.name not in [each.name for each in hogs(agent)]
    for _ in range(2):
        _overload.end_overload(agent)
        assert hogs(agent) == []


def test_an_overload_ends_without_its_starter(made: Callable[..., Agent]) -> None:
    """Whatever happens to the process that started it, its containers end and are removed."""
    agent = made()
    _overload.overload(agent, lasts_s=1.0, loops_per_core=1, hogs=1)
    until(lambda: not hogs(agent), "their end")


def _loops(agent: Agent) -> int:
    found = 0
    for each in hogs(agent):
        try:
            rows = each.top(ps_args="-eo pid,stat,args")["Processes"]
        except APIError:  # it has ended meanwhile
            continue
        found += sum(row[1].startswith("R") for row in rows)
    return found


def test_an_interrupted_overload_is_removed(made: Callable[..., Agent], monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted after two of its containers, an overload leaves none."""
    agent = made()
    run, calls = agent.docker.containers.run, []

    def interrupted(*args: Any, **more: Any) -> Any:
        calls.append(more["name"])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return run(*args, **more)

    monkeypatch.setattr(type(agent.docker.containers), "run", lambda self, *args, **more: interrupted(*args, **more))
    with pytest.raises(KeyboardInterrupt):
        _overload.overload(agent)
    assert len(calls) == 3
    assert hogs(agent) == []


@pytest.fixture
def light(monkeypatch: pytest.MonkeyPatch) -> None:
    """An overload of one loop, since these tests are about events during the load and not about the load."""
    for module in (overload_node_killed, overload_container_killed, overload_ends):
        monkeypatch.setattr(
            module, "overload", lambda agent, **more: _overload.overload(agent, lasts_s=180.0, loops_per_core=0, hogs=1)
        )
        monkeypatch.setattr(module, "BEFORE_S", 0.1)


@pytest.mark.usefixtures("light")
def test_a_node_dies_during_the_overload(made: Callable[..., Agent]) -> None:
    """The node is dead, its container and the load are running; clearing ends the load and restarts the container."""
    agent, fault = made(), overload_node_killed.Injection()
    generation = agent.generation
    fault.inject(agent)
    assert len(hogs(agent)) == 1
    until(lambda: agent.processes(agent.app, "sleep 600") == [], "the end of the node")
    assert agent.generation == generation
    for _ in range(2):
        fault.clear(agent)
        assert hogs(agent) == []
    assert agent.generation != generation


@pytest.mark.usefixtures("light")
def test_the_container_dies_during_the_overload(made: Callable[..., Agent]) -> None:
    """The container has ended while the load is running; clearing ends the load and starts the container."""
    agent, fault = made(), overload_container_killed.Injection()
    fault.inject(agent)
    assert len(hogs(agent)) == 1
    assert agent.app.status == "exited"
    for _ in range(2):
        fault.clear(agent)
        assert hogs(agent) == []
        assert agent.app.status == "running"


@pytest.mark.usefixtures("light")
def test_an_overload_has_ended_when_its_end_is_the_fault(made: Callable[..., Agent]) -> None:
    """After the injection nothing of the load is left."""
    agent, fault = made(), overload_ends.Injection()
    fault.inject(agent)
    assert hogs(agent) == []
    fault.clear(agent)


def test_every_starvation_fault_is_tested_here() -> None:
    """Each fault of this kind has a test in this file."""
    text = Path(__file__).read_text("utf-8")
    names = [name for name, fault in all_faults().items() if "starvation" in fault.needs and name != "host_overload"]
    assert all(f"{name}.Injection()" in text for name in names)
