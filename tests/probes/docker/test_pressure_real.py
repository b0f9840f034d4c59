"""The pressure check against real containers: through their cgroup files, and through the engine's statistics."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from phm import api, testing
from phm.core.clock import SystemClock
from phm.probes.docker import Docker
from phm.probes.pressure import Pressure as Probe
from phm.transport.docker import DockerEngine
from phm_checks.pressure import Pressure
from sitl.faults.base import freeze
from tests.fakes.until import until

FILES, STATISTICS = "/sys/fs/cgroup", "/nowhere"
POLL_S, LIMIT_S = 0.5, 180.0
"""For whatever is waited for: the machine may be as busy as it likes."""
BUSY = "while :; do :; done"
THRASH = """
import mmap, os
size = 40 << 20
with open("/tmp/data", "wb") as file:
    for _ in range(40):
        file.write(os.urandom(1 << 20))
pages = mmap.mmap(os.open("/tmp/data", os.O_RDONLY), size, prot=mmap.PROT_READ)
pages.madvise(mmap.MADV_RANDOM)
while True:
    sum(pages[place] for place in range(0, size, 4096))
"""
"""Needs the same 40 MB of a file again and again, as a program needs its code."""
HOLD = """
import time
kept = bytes([1]) * (30 << 20)
time.sleep(600)
"""
LEAK = """
import time
kept = [bytes([1]) * (30 << 20)]
while True:
    kept.append(bytes([1]) * (1 << 19))
    time.sleep(0.4)
"""
"""Takes another 1.2 MB a second: the limit of 256 MB is reached after almost three minutes."""
STREAM = "while :; do dd if=/dev/zero of=/tmp/data bs=1M count=200 2>/dev/null; cat /tmp/data >/dev/null; done"


wait_until = partial(until, limit_s=LIMIT_S, poll_s=POLL_S)


class Agent:
    """The check and the probe on one real container, as in PHM."""

    def __init__(self, engine: DockerEngine, name: str, source: str, **more: Any) -> None:
        # This machine may be overloaded during the test, so waiting for others is excluded.
        limits = {"cgroups": source, "waiting": {"warn": 100, "error": 100}}
        settings = testing.settings(containers=[{"name": name, "alias": "ros_app"}], pressure=limits, **more)
        (self.check,) = Pressure.build(settings)
        clock = SystemClock()
        self.docker = Docker(engine, settings.containers, settings.docker, clock)
        self.world = testing.world(
            clock=clock,
            docker=self.docker,
            pressure=Probe(engine, self.docker, settings.containers, settings.pressure, clock),
        )
        self.seen: list[api.Result] = []

    def observe(self) -> api.Result:
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        self.seen.append(result)
        return result

    def until(self, wanted: Callable[[api.Result], bool], what: str, limit_s: float = LIMIT_S) -> api.Result:
        def found() -> api.Result | None:
            result = self.observe()
            return result if wanted(result) else None

        return wait_until(found, what, lambda: self.seen[-1], limit_s=limit_s)

    def is_ok(self) -> api.Result:
        return self.until(lambda result: result.level is api.Level.OK and not result.bypass, "no pressure")

    def is_error(self, condition: str) -> api.Result:
        def found(result: api.Result) -> bool:
            return result.level is api.Level.ERROR and result.condition == condition

        return self.until(found, condition)


@pytest.fixture(params=[pytest.param(FILES, id="files"), pytest.param(STATISTICS, id="statistics")])
def source(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_a_low_cpu_limit_is_reported_until_it_is_raised(real: Any, engine: DockerEngine, source: str) -> None:
    """`docker update --cpus 0.03`, and back."""
    made = real.container(BUSY)
    agent = Agent(engine, made.name, source)
    agent.is_ok()
    made.update(cpu_quota=3000, cpu_period=100000)
    result = agent.is_error("cpu_throttled")
    assert "% of the time by its limit of 0.03 CPUs: raise it" in result.summary and "limit 0.03 CPU" in result.brief
    made.update(cpu_quota=-1)
    agent.is_ok()


def test_a_reached_limit_of_processes_is_reported(real: Any, engine: DockerEngine, source: str) -> None:
    """Until some of them have terminated."""
    made = real.container("sleep 600 & sleep 600 & sleep 600 & wait", pids_limit=50)
    agent = Agent(engine, made.name, source)
    agent.is_ok()
    # docker-py's own `update` does not support a limit of processes.
    body = {"PidsLimit": 5}
    path = "/containers/{0}/update"
    engine.call(lambda client: client._post_json(client._url(path, made.id), data=body))  # type: ignore[attr-defined]
    assert "at its limit of 5" in agent.is_error("pids_limit").summary
    made.kill(signal="SIGKILL")
    agent.docker.invalidate()
    agent.until(lambda result: result.bypass, "the end of the container")


def test_the_cgroup_shows_whether_a_container_runs_is_frozen_or_has_ended(real: Any, engine: DockerEngine) -> None:
    """Also when the engine has forgotten it, and whether an engine has removed the cgroup; of a source without cgroups nothing is
    known."""
    made = real.container("sleep 600")
    blind = Agent(engine, made.name, STATISTICS)
    agent = Agent(engine, made.name, FILES)
    agent.is_ok()
    blind.is_ok()
    state = partial(agent.world.pressure.state, "ros_app", made.id)
    assert state() is api.CgroupState.RUNNING
    freeze(made)
    assert state() is api.CgroupState.FROZEN
    made.unpause()
    assert state() is api.CgroupState.RUNNING
    made.kill(signal="SIGKILL")
    wait_until(lambda: state() is api.CgroupState.REMOVED, "the engine to remove the cgroup")
    made.start()
    wait_until(lambda: state() is api.CgroupState.RUNNING, "processes again")
    made.remove(force=True)
    wait_until(lambda: state() is api.CgroupState.REMOVED, "no cgroup")
    assert blind.world.pressure.state("ros_app", made.id) is None


def test_a_memory_limit_below_the_working_set_is_reported(real: Any, engine: DockerEngine, source: str) -> None:
    """The container is not killed: its pages are dropped and read back. With a higher limit the fault ends."""
    made = real.container(f"exec python3 -c '{THRASH}'", mem_limit="90m", memswap_limit="90m")
    agent = Agent(engine, made.name, source)
    agent.is_ok()
    until_read(made, 40 << 20)
    made.update(mem_limit="30m", memswap_limit="30m")
    result = agent.is_error("memory_pressure")
    assert "memory limit of 30 MB" in result.summary and "pages a second" in result.summary
    made.update(mem_limit="90m", memswap_limit="90m")
    agent.is_ok()


def test_a_page_cache_at_the_memory_limit_is_not_pressure(real: Any, engine: DockerEngine, source: str) -> None:
    """Files are written and read once at the limit, as a recorder does."""
    made = real.container(STREAM, mem_limit="40m", memswap_limit="40m")
    agent = Agent(engine, made.name, source)
    agent.until(lambda result: (result.values.get("memory_bytes") or 0) > (36 << 20), "a full page cache")  # type: ignore[operator]
    for _ in range(12):
        assert agent.observe().condition != "memory_pressure", agent.seen[-1].summary
        threading.Event().wait(POLL_S)


def test_the_page_cache_is_not_taken_for_a_leak(real: Any, engine: DockerEngine, source: str) -> None:
    """A recorder fills it, up to any limit."""
    made = real.container(STREAM, mem_limit="40m", memswap_limit="40m")
    agent = Agent(engine, made.name, source)
    agent.until(lambda result: (result.values.get("memory_bytes") or 0) > (36 << 20), "a full page cache")  # type: ignore[operator]
    fact = wait_until(lambda: agent.world.pressure.container("ros_app"), "a running container", lambda: agent.seen[-1])
    assert fact.without_cache_bytes is not None and fact.without_cache_bytes < (20 << 20)


def test_a_restarted_container_is_evaluated_from_zero(real: Any, engine: DockerEngine, source: str) -> None:
    """Its counters start at 0, in another cgroup of the same name."""
    made = real.container(BUSY, cpu_quota=3000, cpu_period=100000)
    agent = Agent(engine, made.name, source)
    agent.is_error("cpu_throttled")
    made.restart(timeout=0)
    agent.docker.invalidate()
    agent.until(lambda result: result.level is api.Level.STALE or result.bypass, "a first sample after the restart")
    agent.is_error("cpu_throttled")


def test_the_real_cgroup_of_a_container_has_all_values(real: Any, engine: DockerEngine) -> None:
    """For the cgroup version of this machine."""
    made = real.container(BUSY, cpu_quota=50000, cpu_period=100000, mem_limit="64m", pids_limit=20)
    agent = Agent(engine, made.name, FILES)
    fact = agent.world.pressure.container("ros_app")
    assert fact is not None and fact.source in ("cgroup v1", "cgroup v2")
    assert (fact.cpu_limit, fact.memory_limit, fact.pids_limit) == (0.5, 64 << 20, 20)
    assert fact.throttled_periods is not None and fact.throttled_s is not None and fact.cpu_used_s is not None
    assert fact.pids is not None and fact.pids_refused == 0 and fact.memory_bytes
    assert fact.cpu is not None and fact.cpu.full_s is not None and Path("/proc/pressure/cpu").exists()


def test_a_real_mount_of_version_2_is_read(real: Any, engine: DockerEngine) -> None:
    """Also one without controllers, as in hybrid mode: the text names what is not counted there."""
    hybrid = Path(FILES, "unified")
    made = real.container(BUSY, cpu_quota=3000, cpu_period=100000)
    agent = Agent(engine, made.name, str(hybrid if hybrid.is_dir() else FILES))
    fact = agent.world.pressure.container("ros_app")
    assert fact is not None and fact.source == "cgroup v2" and fact.cpu_used_s is not None
    assert fact.cpu is not None and fact.memory is not None and fact.io is not None
    assert fact.not_seen == (("its CPU limit", "its memory limit") if hybrid.is_dir() else ())

    def stalled_s() -> float:
        fact = agent.world.pressure.container("ros_app")
        return fact.cpu.full_s or 0.0 if fact is not None and fact.cpu is not None else 0.0

    first_s = stalled_s()
    wait_until(lambda: stalled_s() >= first_s + 1.0, "the kernel to count that the limit stops it")


def test_users_of_the_cpu_are_known_by_name(
    real: Any, engine: DockerEngine, source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also a container that is not configured."""
    for name in ("LIST_S", "BUDGET_S"):  # the machine may be busy
        monkeypatch.setattr(f"phm.probes.top_consumers.{name}", 30.0)
    made, other = real.container(), real.container(f"{BUSY} & {BUSY}")
    agent = Agent(engine, made.name, source)
    agent.is_ok()
    wait_until(
        lambda: other.name in [fact.name for fact in agent.world.pressure.consumers()],
        "the other container among the consumers",
        agent.world.pressure.consumers,
    )


def until_read(made: Any, size: int) -> None:
    """Wait until the program has its file in memory."""
    wait_until(
        lambda: made.stats(stream=False, one_shot=True)["memory_stats"].get("usage", 0) >= size,
        "the program to read its file",
    )


@pytest.mark.long
def test_the_process_that_leaks_is_named(real: Any, engine: DockerEngine, source: str) -> None:
    """Of two nodes of a container, by real process lists; PHM knows a trend after a minute."""
    commands = f"python3 -c '{HOLD}' __node:=steady & exec python3 -c '{LEAK}' __node:=leaking"
    made = real.container(commands, mem_limit="256m", memswap_limit="256m")
    nodes = [{"name": "/steady"}, {"name": "/leaking"}]
    agent = Agent(engine, made.name, source, ros={"nodes": nodes})
    result = agent.until(lambda result: "most of it" in result.summary, "a named process", limit_s=300.0)
    assert (result.level, result.condition) == (api.Level.WARN, "memory_filling")
    pids = [fact.pid for fact in agent.docker.processes("ros_app") if fact.command.endswith("__node:=leaking")]
    assert any(f"most of it node /leaking (process {pid}): find the leak" in result.summary for pid in pids)
    assert "(leaking)" in result.brief
