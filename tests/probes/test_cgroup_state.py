"""Whether a container has processes, and its CPU weight, from fabricated cgroup trees, and from the real one of a real container."""

from __future__ import annotations

import shutil
from pathlib import Path

from phm import testing
from phm.facts import CgroupState
from phm.probes import cgroups
from tests.probes.test_pressure import ID, OTHER, Bench, v1, v2, write


def lost_engine(bench: Bench) -> None:
    """The probe has found the cgroup of the container, and the engine does not answer any more."""
    assert bench.probe.state("ros_app", ID) is None, "not looked for yet"
    assert bench.probe.container("ros_app") is not None
    bench.docker.fail()


def test_the_state_of_a_cgroup_of_version_2_needs_no_engine(tmp_path: Path) -> None:
    """`cgroup.events` counts processes of cgroups within it, too; a removed cgroup has none, a removed mount says nothing."""
    folder, bench = v2(tmp_path), Bench(tmp_path)
    lost_engine(bench)
    assert bench.probe.state("ros_app", ID) is None, "there is no such file"
    for events, state in (
        ("populated 1\nfrozen 0\n", CgroupState.RUNNING),
        ("populated 1\nfrozen 1\n", CgroupState.FROZEN),
        ("populated 0\nfrozen 0\n", CgroupState.EMPTY),
        ("nonsense", None),
    ):
        (folder / "cgroup.events").write_text(events, encoding="utf-8")
        assert bench.probe.state("ros_app", ID) is state
        assert bench.probe.state("ros_app", OTHER) is None, "another container"
    shutil.rmtree(folder)
    assert bench.probe.state("ros_app", ID) is CgroupState.REMOVED
    (tmp_path / "cgroup.controllers").unlink()
    assert bench.probe.state("ros_app", ID) is None
    assert bench.probe.state("gps", ID) is None


def test_the_state_of_a_cgroup_of_version_1_is_its_number_of_tasks(tmp_path: Path) -> None:
    """Its list of processes is empty for a reader in another PID namespace, as a sidecar is."""
    v1(tmp_path)
    bench = Bench(tmp_path)
    lost_engine(bench)
    tasks = tmp_path / "pids" / "docker" / ID / "pids.current"
    write(tmp_path / "cpu" / "docker" / ID, {"cgroup.procs": ""})
    assert bench.probe.state("ros_app", ID) is CgroupState.RUNNING
    write(tmp_path / "freezer" / "docker" / ID, {"freezer.state": "FROZEN\n"})
    assert bench.probe.state("ros_app", ID) is CgroupState.FROZEN
    tasks.write_text("0\n", encoding="utf-8")
    assert bench.probe.state("ros_app", ID) is CgroupState.EMPTY
    tasks.unlink()
    assert bench.probe.state("ros_app", ID) is None, "without the controller"
    shutil.rmtree(tmp_path / "cpu" / "docker")
    assert bench.probe.state("ros_app", ID) is CgroupState.REMOVED
    shutil.rmtree(tmp_path / "cpu")
    assert bench.probe.state("ros_app", ID) is None


def test_the_cpu_weight_is_that_of_version_2(tmp_path: Path) -> None:
    """0 where the shares are exact, and where there is no such file or cgroup."""
    app = testing.container("ros_app", id=ID)
    folder = v2(tmp_path / "v2", cpu_weight="100\n")
    assert cgroups.cpu_weight(tmp_path / "v2", app) == 100
    assert cgroups.cpu_weight(tmp_path / "v2", testing.container("other", id=OTHER)) == 0
    (folder / "cpu.weight").unlink()
    assert cgroups.cpu_weight(tmp_path / "v2", app) == 0
    v1(tmp_path / "v1")
    assert cgroups.cpu_weight(tmp_path / "v1", app) == 0
