"""What the daemon's memory consists of: what it does not load, what it frees, and how its parts are named to the kernel."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import psutil
import pytest

from phm.core import memory, threads
from sitl.bench import footprint, footprint_imports, footprint_proc
from tests.fakes.until import until

ROOT = Path(__file__).parents[2]
HEAVY = ("asyncio", "ruamel", "rich", "numpy", "rclpy", "aiohttp", "jinja2")


def test_the_daemon_loads_no_package_that_it_can_do_without() -> None:
    """Each of these takes megabytes: they are imported where they are used, or not at all."""
    assert _modules("phm.cli.run", "phm.runtime.configuration", "phm.runtime.service").isdisjoint(HEAVY)


def test_metrics_load_no_event_loop() -> None:
    """They are served with the modules of the standard library that prometheus-client imports anyway."""
    assert _modules("phm.transport.scrape_server", "phm.wire.openmetrics").isdisjoint(HEAVY)


def _modules(*names: str) -> set[str]:
    """What is loaded after an import of these modules."""
    code = f"import sys, {', '.join(names)}; print(*sys.modules)"
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks")))}
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_kernel_knows_the_name_of_each_thread() -> None:
    """`top -H` shows which part uses the processor: up to 15 characters, without the prefix that all have."""
    done = threading.Event()
    thread = threading.Thread(target=done.wait, name="phm-check-container/ros_app", daemon=True)
    assert threads.start(thread)
    assert Path(f"/proc/self/task/{thread.native_id}/comm").read_text() == "check-container\n"
    done.set()


def test_memory_is_given_back_without_an_error() -> None:
    """Another C library than glibc has no such function."""
    memory.give_back()


def test_threads_and_memory_of_a_process_are_measured() -> None:
    """The figures are those of the kernel: a thread that sleeps often wakes often, and a page is counted once."""
    done = threading.Event()

    def sleep_often() -> None:
        while not done.wait(0.01):
            pass

    thread = threading.Thread(target=sleep_often, name="phm-often", daemon=True)
    threads.start(thread)
    me = os.getpid()

    def wakeups() -> float:
        costs = {cost.name: cost for cost in footprint_proc.threads([me], partial(done.wait, 0.5))[me]}
        return costs["often"].wakeups

    until(lambda: wakeups() > 1, "a measurement in which a busy machine lets it wake")
    done.set()
    found = footprint_proc.memory(me)
    assert 0 < found.anonymous < found.rss
    together = footprint_proc.together([me, me])
    assert together is None or found.anonymous / 2 < together < 1.1 * found.rss


def test_an_import_is_charged_to_its_package() -> None:
    """A package does not pay for the modules of another one that it imports."""
    command = [sys.executable, "-m", "sitl.bench.footprint_imports", "csv"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert '"csv": {' in done.stdout
    assert '"_csv": {' in done.stdout
    assert footprint_imports.anonymous_kb() > 1000


@pytest.mark.parametrize(
    ("line", "daemon"),
    [
        ("/opt/phm/bin/python /opt/phm/code/bin/phm run", True),
        (".venv/bin/python -m phm.cli run -c phm.yaml", True),
        ("/sbin/docker-init -- ros-entrypoint phm run", False),
        ("/usr/bin/python3 /usr/bin/phm status --watch", False),
        ("", False),
    ],
)
def test_a_daemon_is_found_by_its_command_line(line: str, daemon: bool) -> None:
    """With and without options; the init that started it is another process."""
    assert footprint._is_daemon(line.split()) is daemon


def test_a_process_that_is_not_phm_is_not_measured() -> None:
    """Only daemons named by their process id, or found by their command line, are agents."""

    def agents(*pids: int) -> list[list[dict[str, int]]]:
        with contextlib.suppress(psutil.NoSuchProcess):  # a daemon of another test has ended meanwhile
            return [footprint.agents(pids)]
        return []

    (found,) = until(agents, "a look at all processes")
    assert all(roles["daemon"] != os.getpid() for roles in found)
    (found,) = until(lambda: agents(os.getpid()), "a look at this process")
    assert found[0]["daemon"] == os.getpid()


def test_a_phm_of_another_user_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ran for the entire time, so that it did not would be the wrong reason; and the mean of the others would be of other agents."""

    def refused(pid: int) -> footprint_proc.Memory:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(footprint_proc, "memory", refused)
    with pytest.raises(ValueError, match="another user"):
        footprint.measure([{"daemon": os.getpid()}], 0.01)


def test_the_cpu_of_a_container_has_what_ends_in_it(tmp_path: Path) -> None:
    """A health check is a separate process, whose time only the cgroup has."""
    used = tmp_path / "cpuacct.usage"
    used.write_text("1000000000\n")

    def check_runs(seconds: float) -> None:
        used.write_text("61000000000\n")

    group = {"phm-1": tmp_path}
    found = footprint.measure([{"daemon": os.getpid()}], 0.0, group, check_runs)
    assert found["containers"]["phm-1"] > 1000, "60 s of CPU time in next to no time"

    with pytest.raises(ValueError, match="phm-1"):
        footprint.measure([{"daemon": os.getpid()}], 0.0, group, lambda seconds: used.unlink())


def test_a_container_that_does_not_run_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its name and what to do, in one line."""
    monkeypatch.setenv("DOCKER_HOST", "nonsense")
    with pytest.raises(ValueError, match="no-such-container"):
        footprint.containers(["no-such-container"])
    assert footprint.containers([]) == {}
