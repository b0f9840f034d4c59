"""The pressure probe on fabricated cgroup trees (formats: the kernel's cgroup-v2.rst and cgroup-v1) and engine answers."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from phm import testing
from phm.facts import CannotTell, ContainerFact, StallFact
from phm.probes import cgroups, engine_stats
from phm.probes.pressure import ENGINE_EVERY_S, Pressure
from phm.probes.stall_sampler import KEEP_S, PERIOD_S
from phm.transport.docker import EngineMissing, EngineRefused
from tests.fakes.until import LIMIT_S, until

ID = "ab" * 32
OTHER = "cd" * 32
V2 = {
    "cpu.stat": "usage_usec 180194\nuser_usec 154453\nsystem_usec 25740\nnice_usec 0\ncore_sched.force_idle_usec 0\n"
    "nr_periods 43\nnr_throttled 42\nthrottled_usec 3877288\nnr_bursts 0\nburst_usec 0\n",
    "cpu.max": "3000 100000\n",
    "cpu.pressure": "some avg10=13.58 avg60=2.45 avg300=0.51 total=2722284\nfull avg10=13.58 avg60=2.45 avg300=0.51 total=2720498\n",
    "memory.pressure": "some avg10=0.00 avg60=0.00 avg300=0.00 total=0\nfull avg10=0.00 avg60=0.00 avg300=0.00 total=0\n",
    "io.pressure": "some avg10=0.00 avg60=0.00 avg300=0.00 total=7101\nfull avg10=0.00 avg60=0.00 avg300=0.00 total=7100\n",
    "memory.current": "66060288\n",
    "memory.max": "67108864\n",
    "memory.stat": "anon 2666496\nfile 8663040\npgfault 1778\npgmajfault 700\nworkingset_refault_anon 5\nworkingset_refault_file 600\n",
    "memory.events": "low 0\nhigh 0\nmax 12\noom 3\noom_kill 1\noom_group_kill 0\n",
    "pids.current": "7\n",
    "pids.max": "20\n",
    "pids.events": "max 3\n",
}
V1: dict[str, dict[str, str]] = {
    "cpu": {
        "cpu.stat": "nr_periods 32\nnr_throttled 31\nthrottled_time 2846706290\n",
        "cpu.cfs_quota_us": "5000\n",
        "cpu.cfs_period_us": "100000\n",
    },
    "cpuacct": {"cpuacct.usage": "180194374\n"},
    "memory": {
        "memory.usage_in_bytes": "66060288\n",
        "memory.limit_in_bytes": "67108864\n",
        "memory.stat": "cache 8663040\nworkingset_refault_file 2123\npgmajfault 10\ntotal_pgmajfault 10\n",
        "memory.failcnt": "61\n",
        "memory.oom_control": "oom_kill_disable 0\nunder_oom 0\noom_kill 2\n",
    },
    "pids": {"pids.current": "1\n", "pids.max": "max\n", "pids.events": "max 0\n"},
}
STATS = {
    "pids_stats": {"current": 1, "limit": 20},
    "cpu_stats": {
        "cpu_usage": {"total_usage": 180194374},
        "throttling_data": {"periods": 33, "throttled_periods": 32, "throttled_time": 2939308349},
    },
    "memory_stats": {"usage": 11763712, "stats": {"pgmajfault": 10}, "limit": 67108864},
}
"""As Engine 20.10 answers, shortened."""


def write(folder: Path, files: dict[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


def v2(root: Path, place: str = f"docker/{ID}", **changed: str) -> Path:
    write(root, {"cgroup.controllers": "cpu io memory pids\n"})
    write(root / place, {**V2, **{name.replace("_", "."): text for name, text in changed.items()}})
    return root / place


def v1(root: Path, place: str = f"docker/{ID}") -> None:
    for controller, files in V1.items():
        write(root / controller / place, files)


class CountingEngine:
    """An engine that counts its requests."""

    timeout_s = 1.0

    def __init__(self, stats: Any = STATS) -> None:
        self.answer = stats
        self.asked: list[str] = []
        self.names: Any = []

    def stats(self, container: str, **_: Any) -> Any:
        self.asked.append(container)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def list(self, **_: Any) -> Any:
        self.asked.append("list")
        if isinstance(self.names, Exception):
            raise self.names
        return self.names


class Bench:
    """The probe with one configured container, `ros_app`, whose cgroup is below `root`."""

    def __init__(self, root: Path, stats: Any = STATS, **container: Any) -> None:
        self.engine, self.clock = CountingEngine(stats), testing.FakeClock()
        fields = {"id": ID, "cpu_limit": 0.05, "memory_limit": 67108864, **container}
        self.docker = testing.FakeDocker(testing.container("ros_app", **fields))
        settings = testing.settings(containers=[{"name": "ros_app"}], pressure={"cgroups": str(root)})
        self.probe = Pressure(self.engine, self.docker, settings.containers, settings.pressure, self.clock)  # type: ignore[arg-type]


def test_version_2_is_read(tmp_path: Path) -> None:
    """Each file by its documented format; no statistics are requested from the engine."""
    folder = v2(tmp_path)
    bench = Bench(tmp_path)
    fact = bench.probe.container("ros_app")
    assert fact is not None and bench.engine.asked == []
    assert fact.generation.startswith(str(folder))
    assert dataclasses.replace(fact, generation="") == dataclasses.replace(
        fact,
        generation="",
        at=1000.0,
        source="cgroup v2",
        not_seen=(),
        cpu_limit=pytest.approx(0.03),
        cpu_used_s=0.180194,
        cpu_period_s=0.1,
        throttled_periods=42,
        throttled_s=3.877288,
        cpu=StallFact(2.722284, 2.720498),
        memory=StallFact(0.0, 0.0),
        io=StallFact(0.007101, 0.0071),
        memory_bytes=66060288,
        memory_limit=67108864,
        reread_pages=605,
        oom_kills=1,
        memory_limit_hits=3,
        pids=7,
        pids_limit=20,
        pids_refused=3,
    )


def test_a_container_that_seems_to_wait_is_read_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel counts too little if tasks change their CPU between two readings. One that does not wait any more is left."""
    read: list[str] = []
    monkeypatch.setattr("phm.probes.stall_sampler.head", lambda path, most: read.append(path))
    folder, bench = v2(tmp_path), Bench(tmp_path)

    def second(full_us: int) -> None:
        (folder / "cpu.pressure").write_text(f"some avg10=0.00 total={full_us}\nfull avg10=0.00 total={full_us}\n")
        bench.clock.advance(1.0)
        bench.probe.container("ros_app")

    second(3_000_000)
    second(3_100_000)
    assert read == []
    second(3_300_000)
    for _ in range(3):
        bench.clock.wait_for_sleepers(1, LIMIT_S)
        bench.clock.advance(PERIOD_S)
    bench.clock.wait_for_sleepers(1, LIMIT_S)
    assert read == [str(folder / "cpu.pressure")] * 4
    bench.clock.advance(KEEP_S)
    until(lambda: "phm-stalls" not in [thread.name for thread in threading.enumerate()], "the end of the readings")


def test_version_1_is_read_with_the_pressure_of_hybrid_mode(tmp_path: Path) -> None:
    """Counters in nanoseconds; pressure only if version 2 is mounted too."""
    v1(tmp_path)
    fact = Bench(tmp_path).probe.container("ros_app")
    assert fact is not None
    assert (fact.source, fact.cpu_limit, fact.throttled_periods, fact.throttled_s) == (
        "cgroup v1",
        0.05,
        31,
        2.84670629,
    )
    assert (fact.cpu_used_s, fact.memory_limit, fact.reread_pages, fact.oom_kills) == (0.180194374, 67108864, 10, 2)
    assert (fact.pids, fact.pids_limit, fact.pids_refused, fact.cpu) == (1, None, 0, None)
    assert fact.memory_limit_hits == 61
    assert fact.not_seen == ("waiting for CPU, memory and disk (no pressure stall information)",)
    write(tmp_path / "unified" / "docker" / ID, {"cpu.pressure": V2["cpu.pressure"]})
    fact = Bench(tmp_path).probe.container("ros_app")
    assert fact is not None and fact.cpu == StallFact(2.722284, 2.720498) and fact.not_seen == ()


@pytest.mark.parametrize(("most", "hits"), [("33554432\n", 61), ("67108864\n", None)])
def test_version_1_may_not_count_hits_of_the_limit_of_memory_and_swap(
    tmp_path: Path, most: str, hits: int | None
) -> None:
    """Linux 6.18 kills for that limit without counting: once it was reached, the count of the other says nothing."""
    v1(tmp_path)
    files = {"memory.memsw.max_usage_in_bytes": most, "memory.memsw.limit_in_bytes": "67108864\n"}
    write(tmp_path / "memory" / "docker" / ID, files)
    fact = Bench(tmp_path).probe.container("ros_app")
    assert fact is not None and fact.memory_limit_hits == hits


def test_a_missing_limit_is_none(tmp_path: Path) -> None:
    """`max`, -1, and the largest number of pages of version 1."""
    v2(tmp_path / "2", cpu_max="max 100000\n", memory_max="max\n", pids_max="max\n")
    write(tmp_path / "1" / "cpu" / "docker" / ID, {**V1["cpu"], "cpu.cfs_quota_us": "-1\n"})
    write(tmp_path / "1" / "memory" / "docker" / ID, {"memory.limit_in_bytes": "9223372036854771712\n"})
    for name in "12":
        fact = Bench(tmp_path / name).probe.container("ros_app")
        assert fact is not None and (fact.cpu_limit, fact.memory_limit, fact.pids_limit) == (None, None, None)


def test_memory_stat_is_read_only_close_to_the_limit(tmp_path: Path) -> None:
    """It is the most expensive of the files, and irrelevant while memory is available."""
    v2(tmp_path, memory_current="1000\n")
    fact = Bench(tmp_path).probe.container("ros_app")
    assert fact is not None and fact.reread_pages is None


@pytest.mark.parametrize(
    ("parent", "place"),
    [
        ("", f"docker/{ID}"),
        ("", f"system.slice/docker-{ID}.scope"),
        ("/apps", f"apps/{ID}"),
        ("apps-ros.slice", f"apps.slice/apps-ros.slice/docker-{ID}.scope"),
    ],
)
def test_a_cgroup_is_found_below_the_known_parents(tmp_path: Path, parent: str, place: str) -> None:
    """Of both cgroup drivers of the engine, and of the user's own `cgroup_parent`."""
    v2(tmp_path, place)
    bench = Bench(tmp_path, cgroup_parent=parent)
    fact = bench.probe.container("ros_app")
    assert fact is not None and fact.source == "cgroup v2"


@pytest.mark.parametrize("name", ["../../etc", "/../..", "a" * 300, "a\0b", "$(id)"])
def test_a_parent_outside_of_the_cgroup_tree_is_rejected(tmp_path: Path, name: str) -> None:
    """It is user input; the engine's default parents are still searched."""
    v2(tmp_path)
    fact = Bench(tmp_path, cgroup_parent=name).probe.container("ros_app")
    assert fact is not None and fact.source == "cgroup v2"
    strange = testing.container("x", id="../../etc", cgroup_parent=name)
    assert cgroups.find(tmp_path, strange) is None


def test_each_generation_has_another_text(tmp_path: Path) -> None:
    """A restarted container gets another directory of the same name."""
    folder = v2(tmp_path)
    bench = Bench(tmp_path)
    first = bench.probe.container("ros_app")
    folder.rename(tmp_path / "gone")
    v2(tmp_path)
    second = bench.probe.container("ros_app")
    assert first is not None and second is not None and first.generation != second.generation


def test_without_a_cgroup_the_engine_is_asked(tmp_path: Path) -> None:
    """Every 2 s at most; the fact names what the statistics lack; the limit is that of the container."""
    bench = Bench(tmp_path / "nowhere")
    fact = bench.probe.container("ros_app")
    assert fact is not None and fact.source == "engine statistics" and fact.not_seen == engine_stats.NOT_SEEN
    assert (fact.cpu_limit, fact.throttled_periods, fact.throttled_s) == (0.05, 32, 2.939308349)
    assert (fact.memory_bytes, fact.memory_limit, fact.reread_pages) == (11763712, 67108864, None)
    assert (fact.pids, fact.pids_limit, fact.cpu_used_s) == (1, 20, 0.180194374)
    assert bench.probe.container("ros_app") is fact and bench.engine.asked == [ID]
    bench.clock.advance(ENGINE_EVERY_S)
    assert bench.probe.container("ros_app") is not fact and bench.engine.asked == [ID, ID]


def test_a_container_without_a_memory_limit_has_none_in_the_statistics(tmp_path: Path) -> None:
    """The engine answers with the memory of the machine then."""
    fact = Bench(tmp_path / "nowhere", memory_limit=None).probe.container("ros_app")
    assert fact is not None and (fact.memory_bytes, fact.memory_limit) == (11763712, None)


def test_page_faults_of_the_engine_count_only_close_to_the_limit(tmp_path: Path) -> None:
    """Version 1 has no refaults, and a program that maps a large file for the first time has faults, too."""
    memory = {"usage": 66060288, "limit": 67108864, "stats": {"pgmajfault": 10}}
    for changed, expected in (
        ({}, 10),
        ({"stats": {"pgmajfault": 10, "workingset_refault": 4}}, 4),
        ({"usage": 1}, None),
    ):
        fact = Bench(tmp_path, stats={**STATS, "memory_stats": {**memory, **changed}}).probe.container("ros_app")
        assert fact is not None and fact.reread_pages == expected


def test_files_that_appear_or_disappear_change_the_source(tmp_path: Path) -> None:
    """A container that was recreated, or a mount that was added later."""
    bench = Bench(tmp_path)
    sources = []
    for change in (lambda: None, lambda: v2(tmp_path), lambda: (tmp_path / "docker" / ID).rename(tmp_path / "gone")):
        change()
        bench.clock.advance(ENGINE_EVERY_S)
        fact = bench.probe.container("ros_app")
        assert fact is not None
        sources.append(fact.source)
    assert sources == ["engine statistics", "cgroup v2", "engine statistics"]


def test_a_container_that_does_not_run_has_no_counters(tmp_path: Path) -> None:
    """By its state, by a response without usage, or because it was removed since."""
    assert Bench(tmp_path, status="exited").probe.container("ros_app") is None
    assert Bench(tmp_path, stats={"cpu_stats": {"cpu_usage": {"total_usage": 0}}}).probe.container("ros_app") is None
    assert Bench(tmp_path, stats=EngineMissing("gone")).probe.container("ros_app") is None
    bench = Bench(tmp_path)
    bench.docker.remove("ros_app")
    assert bench.probe.container("ros_app") is None


def test_a_refusal_is_passed_on(tmp_path: Path) -> None:
    """As from a proxy that does not allow the request."""
    with pytest.raises(EngineRefused):
        Bench(tmp_path, stats=EngineRefused("403")).probe.container("ros_app")
    with pytest.raises(CannotTell, match="no container other is configured"):
        Bench(tmp_path).probe.container("other")


@given(text=st.text(max_size=200), name=st.sampled_from(sorted(V2)))
def test_any_file_content_gives_a_fact_or_cannot_tell(tmp_path_factory: Any, text: str, name: str) -> None:
    """No other exception leaves the probe."""
    root = tmp_path_factory.mktemp("tree")
    v2(root, **{name.replace(".", "_"): text})
    with contextlib.suppress(CannotTell):
        assert Bench(root).probe.container("ros_app") is not None


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["usage", "limit", "stats"]), inner, max_size=3)
    ),
    max_leaves=5,
)


@given(part=JSON, name=st.sampled_from(["pids_stats", "cpu_stats", "memory_stats"]))
def test_any_response_of_the_engine_gives_a_fact_or_nothing(part: Any, name: str) -> None:
    """Fields of other types are ignored."""
    container = ContainerFact("a", ID, "running", "then")
    fact = engine_stats.pressure_fact({**STATS, name: part}, container, 1.0)
    assert fact is None or fact.source == engine_stats.SOURCE
