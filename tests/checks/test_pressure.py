"""Slot 9: which resource a container lacks, by the counters of its cgroup or of the engine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks._text import BRIEF_MAX
from phm_checks.pressure import KILL_REPORT_S, KILL_SETTLE_S, Pressure

MIB = 2**20
FACT = api.PressureFact(
    0.0,
    "cgroup v2",
    "life",
    cpu_limit=0.03,
    cpu_used_s=0.0,
    throttled_periods=0,
    throttled_s=0.0,
    cpu=api.StallFact(0.0, 0.0),
    memory=api.StallFact(0.0, 0.0),
    io=api.StallFact(0.0, 0.0),
    memory_bytes=30 * MIB,
    memory_limit=64 * MIB,
    reread_pages=0,
    oom_kills=0,
    memory_limit_hits=0,
    pids=5,
    pids_limit=20,
    pids_refused=0,
)
STARVED = {"cpu_used_s": 0.03, "throttled_periods": 10, "throttled_s": 0.97, "cpu": 0.97}
"""What a second adds to the counters of a container that wants more than its limit of 0.03 CPUs."""


class Bench:
    """The check on one container; each check is a second after the previous one."""

    def __init__(self, fact: api.PressureFact = FACT, **settings: Any) -> None:
        (self.check,) = Pressure.build(testing.settings(containers=[{"name": "ros_app"}], **settings))
        self.clock, self.pressure = testing.FakeClock(), testing.FakePressure()
        self.fact = fact
        self.world = testing.world(clock=self.clock, pressure=self.pressure)

    def observe(self, after_s: float = 1.0, **more: float) -> api.Result:
        """Advance by `after_s`, during which counters rise by `more` per second (stalls: by their full time), and check."""
        self.clock.advance(after_s)
        fields: dict[str, Any] = {"at": self.clock.mono()}
        for name, rise in more.items():
            old = getattr(self.fact, name)
            if isinstance(old, api.StallFact):
                assert old.full_s is not None
                fields[name] = api.StallFact(old.some_s + rise * after_s, old.full_s + rise * after_s)
            else:
                fields[name] = old + type(old)(rise * after_s)
        self.fact = replace(self.fact, **fields)
        return self.again()

    def again(self) -> api.Result:
        self.pressure.put("ros_app", self.fact)
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result

    def observations(self, count: int, **more: float) -> list[api.Result]:
        return [self.observe(**more) for _ in range(count)]

    def calm(self, count: int = 3) -> None:
        assert self.observations(count)[-1].level is api.Level.OK


def names(results: list[api.Result]) -> list[str]:
    return [result.level.name for result in results]


def test_a_container_throttled_by_its_cpu_limit_is_reported_within_two_checks() -> None:
    """The text has the resource, the limit and the measured value; the operator's line, too."""
    bench = Bench()
    bench.calm()
    results = bench.observations(2, **STARVED)
    assert results[-1].level is api.Level.ERROR and results[-1].condition == "cpu_throttled"
    assert results[-1].summary.startswith("ros_app throttled 97 % of the time by its limit of 0.03 CPUs: raise it")
    assert results[-1].brief == "ros_app throttled 97%, limit 0.03 CPU" and len(results[-1].brief) <= BRIEF_MAX
    assert results[-1].target == "ros_app"


def test_a_removed_limit_ends_the_fault_within_three_checks_and_without_a_warning() -> None:
    """The level ends when the entire window is calm."""
    bench = Bench()
    bench.calm()
    bench.observations(5, **STARVED)
    assert names(bench.observations(3, cpu_used_s=0.07)) == ["ERROR", "OK", "OK"]


def test_one_calm_second_does_not_end_a_fault() -> None:
    """A container throttled in bursts has one fault, not several."""
    bench = Bench()
    bench.calm()
    bench.observations(3, **STARVED)
    for _ in range(4):
        assert names([bench.observe(), bench.observe(**STARVED)]) == ["ERROR", "ERROR"]


@pytest.mark.parametrize(
    "more",
    [
        pytest.param({"cpu_used_s": 0.02, "throttled_periods": 1, "throttled_s": 0.05}, id="one period in ten"),
        pytest.param(
            {"cpu_used_s": 0.9, "throttled_periods": 10, "throttled_s": 0.1}, id="each period for a tenth of it"
        ),
        pytest.param({"cpu": 0.7}, id="waits as on a machine with load 9 per core, and gets what it needs"),
        pytest.param({"memory": 0.33, "io": 0.3, "reread_pages": 8}, id="page cache is filled up to the limit"),
        pytest.param(
            {"memory": 0.62, "io": 0.17, "cpu": 0.19, "reread_pages": 2},
            id="the same beside others that use disk and CPU",
        ),
        pytest.param({"io": 0.45}, id="a recorder writes"),
    ],
)
def test_the_normal_load_of_a_busy_container_is_not_pressure(more: dict[str, float]) -> None:
    """Measured on containers that worked properly."""
    bench = Bench()
    bench.calm()
    assert set(names(bench.observations(8, **more))) == {"OK"}


def test_one_second_of_throttling_is_not_a_fault() -> None:
    """It happens when a node starts to compute."""
    bench = Bench()
    bench.calm()
    for _ in range(3):
        assert "ERROR" not in names([bench.observe(0.4, **STARVED), *bench.observations(3)])


def test_a_second_above_a_limit_is_reported_to_the_tracker_as_rising() -> None:
    """Symptoms that it may explain wait for it."""
    bench = Bench()
    bench.calm()
    rising = bench.observe(0.4, **STARVED)
    assert (rising.level, rising.evidence.rising) == (api.Level.OK, True)
    assert [result.evidence.rising for result in bench.observations(3)][1:] == [False, False]


def test_the_throttled_share_is_correct_for_any_number_of_cpus() -> None:
    """Throttled time is summed over the CPUs: four threads with 1.5 CPUs are throttled 62 % of the time, not 250 %."""
    bench = Bench(replace(FACT, cpu_limit=1.5))
    bench.calm()
    result = bench.observations(3, cpu_used_s=1.5, throttled_periods=10, throttled_s=2.5)[-1]
    assert "throttled 62 % of the time by its limit of 1.5 CPUs" in result.summary


def test_a_container_without_cpu_time_names_the_processes_that_use_it() -> None:
    """The container itself has no limit that could be the cause."""
    bench = Bench(replace(FACT, cpu_limit=None))
    bench.calm()
    assert bench.pressure.consumers_asked == 0
    bench.pressure.taken = (api.ConsumerFact("slam", 1.83), api.ConsumerFact("ros_app", 0.1))
    result = bench.observations(3, cpu=0.96, cpu_used_s=0.02)[-1]
    assert (result.level, result.condition) == (api.Level.ERROR, "cpu_starved")
    assert "waits 96 % of the time for a CPU that others use; slam uses 1.8 CPUs" in result.summary
    assert result.brief == "ros_app waits 96% for CPU (slam)"


def test_programs_outside_of_containers_are_named_as_such() -> None:
    """The probe has no container name for them."""
    bench = Bench(replace(FACT, cpu_limit=None))
    bench.pressure.taken = (api.ConsumerFact("", 1.83),)
    result = bench.observations(4, cpu=0.96)[-1]
    assert "a process outside containers uses 1.8 CPUs" in result.summary
    assert result.brief == "ros_app waits 96% for CPU"


def test_the_users_of_the_cpu_may_be_unknown() -> None:
    """A probe that fails does not prevent the report."""
    bench = Bench(replace(FACT, cpu_limit=None))
    bench.calm()
    bench.pressure.consumers = lambda: (_ for _ in ()).throw(api.CannotTell("refused"))  # type: ignore[method-assign]
    assert bench.observations(3, cpu=0.96)[-1].condition == "cpu_starved"


def test_throttled_time_does_not_count_as_waiting_for_others() -> None:
    """The kernel counts it as both."""
    bench = Bench()
    bench.calm()
    assert {result.condition for result in bench.observations(4, **STARVED)[1:]} == {"cpu_throttled"}


def test_memory_that_is_read_back_from_disk_is_pressure() -> None:
    """The limit is slightly above usage: the kernel drops pages of the program and reads them again."""
    bench = Bench(replace(FACT, memory_bytes=64 * MIB))
    bench.calm()
    result = bench.observations(3, reread_pages=4000, io=0.25)[-1]
    assert (result.level, result.condition) == (api.Level.ERROR, "memory_pressure")
    assert "reads back 4000 pages a second" in result.summary and "limit of 64 MB" in result.summary
    assert result.brief == "ros_app memory limit 64 MB too small"


def test_pages_that_a_slow_disk_reads_back_are_pressure() -> None:
    """An SD card: few pages a second, and the container does nothing but wait for them."""
    bench = Bench(replace(FACT, memory_bytes=64 * MIB))
    bench.calm()
    assert bench.observations(3, memory=0.9, io=0.9, reread_pages=90)[-1].condition == "memory_pressure"


def test_waiting_for_memory_is_pressure() -> None:
    """The kernel's own measure, for containers that read nothing back."""
    bench = Bench()
    bench.calm()
    assert bench.observations(3, memory=0.7)[-1].condition == "memory_pressure"


@pytest.mark.parametrize("fact", [FACT, replace(FACT, memory_limit=None)], ids=["below its limit", "without a limit"])
def test_memory_that_the_computer_lacks_is_not_blamed_on_a_limit(fact: api.PressureFact) -> None:
    """A raised limit would not help."""
    bench = Bench(fact)
    bench.calm()
    result = bench.observations(3, memory=0.7)[-1]
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "memory_pressure",
        "ros_app waits for memory",
    )
    assert "the computer has too little memory" in result.summary and "raise it" not in result.summary


def test_a_kill_without_a_memory_limit_is_blamed_on_the_computer() -> None:
    """The kernel counts it in the same place."""
    bench = Bench(replace(FACT, memory_limit=None))
    bench.calm()
    result = bench.observe(oom_kills=2)
    assert result.summary.startswith(
        "the computer ran out of memory, and the kernel killed 2 of the processes of ros_app"
    )
    assert result.brief == "ros_app killed, no memory left"


def test_an_oom_kill_inside_the_container_is_reported_for_a_while() -> None:
    """The container keeps running without that process."""
    bench = Bench()
    bench.calm()
    result = bench.observe(oom_kills=1, memory_limit_hits=1)
    assert result.level is api.Level.ERROR and "killed 1 of its processes" in result.summary
    assert result.settle_s == KILL_SETTLE_S, "the check of a node that was killed comes first"
    assert names(bench.observations(int(KILL_REPORT_S)))[-1] == "OK"


def test_a_kill_far_below_the_containers_own_limit_is_blamed_on_the_computer() -> None:
    """The kernel counts a hit of the limit before it kills for that; advice to raise the limit would make it worse."""
    bench = Bench()
    bench.calm()
    for result in bench.observations(1, oom_kills=1) + bench.observations(5):
        assert (result.level, result.brief) == (api.Level.ERROR, "ros_app killed, no memory left")
        assert (result.condition, result.target) == ("memory_pressure", "ros_app")
        assert "the computer ran out of memory" in result.summary and "raise the limit" not in result.summary


@pytest.mark.parametrize("before", [0, 1])
def test_a_kill_at_the_containers_own_limit_is_blamed_on_it_until_its_report_ends(before: int) -> None:
    """The kernel may count the hit just before a reading, and the kill just after it."""
    bench = Bench()
    bench.calm()
    bench.observe(memory_limit_hits=before)
    for result in [bench.observe(oom_kills=1, memory_limit_hits=1 - before), *bench.observations(6)]:
        assert result.brief == "ros_app memory limit 64 MB: killed" and "raise the limit" in result.summary


def test_without_a_count_of_hits_a_kill_is_blamed_on_the_containers_limit() -> None:
    """The usual cause, on a kernel that does not count them."""
    bench = Bench(replace(FACT, memory_limit_hits=None))
    bench.calm()
    assert bench.observe(oom_kills=1).brief == "ros_app memory limit 64 MB: killed"


def test_a_container_that_only_waits_for_the_disk_has_pressure_after_five_seconds() -> None:
    """A slow SD card; one long write is not reported."""
    bench = Bench()
    bench.calm(7)
    results = bench.observations(7, io=0.97)
    assert results[-1].condition == "io_pressure" and results[-1].level is api.Level.ERROR
    assert "waits for the disk 97 % of the time" in results[-1].summary
    assert names(results[:2]) == ["OK", "OK"]


def test_a_reached_limit_of_processes_is_reported_immediately() -> None:
    """With the limit; a count just below it is a warning."""
    bench = Bench(replace(FACT, pids=20))
    result = bench.observations(2)[-1]
    assert (result.level, result.condition) == (api.Level.ERROR, "pids_limit")
    assert "20 processes and threads at its limit of 20" in result.summary
    assert bench.observe(pids=-1).level is api.Level.WARN
    assert bench.observe(pids=-10).level is api.Level.OK
    assert "and 3 more were refused" in bench.observe(pids_refused=3).summary


def test_several_shortages_are_one_result_with_the_worst_first() -> None:
    """One unit, one alarm."""
    bench = Bench(replace(FACT, pids=19))
    result = bench.observations(4, **STARVED)[-1]
    assert result.condition == "cpu_throttled" and "19 processes" in result.summary


def test_counters_of_a_restarted_container_are_not_compared_with_earlier_ones() -> None:
    """They start at 0."""
    bench = Bench()
    bench.calm()
    bench.observations(3, **STARVED)
    bench.fact = replace(FACT, generation="another", at=0.0)
    assert bench.observe().level is api.Level.STALE
    assert bench.observe().level is api.Level.OK


def test_decreasing_counters_mean_a_restart() -> None:
    """For a source that does not report the container's generation."""
    bench = Bench()
    bench.observations(3, **STARVED)
    bench.fact = replace(FACT, generation="life", cpu_used_s=0.0)
    assert bench.observe().level is api.Level.STALE


def test_a_repeated_sample_counts_once() -> None:
    """The engine is asked every 2 s, and the check runs every second."""
    bench = Bench()
    bench.calm()
    bench.observations(3, **STARVED)
    assert bench.again().level is api.Level.ERROR


def test_a_container_that_is_stopped_or_inaccessible_is_a_bypass() -> None:
    """The slot of a machine without a source is not yellow; a silent engine makes it STALE."""
    bench = Bench()
    bench.pressure.put("ros_app", None)
    result = bench.check.run(bench.world)
    assert isinstance(result, api.Result) and result.bypass and "is not running" in result.summary
    bench.pressure.fail(api.NotPermitted("the proxy refuses it"))
    result = bench.check.run(bench.world)
    assert isinstance(result, api.Result) and result.bypass and "the proxy refuses it" in result.summary
    bench.pressure.fail("no answer")
    with pytest.raises(api.CannotTell):
        bench.check.run(bench.world)


def test_the_text_names_the_source_and_its_missing_values() -> None:
    """`phm status` prints it."""
    bench = Bench(
        replace(FACT, source="engine statistics", not_seen=("waiting for CPU", "refused processes"), cpu=None)
    )
    assert bench.observations(3)[-1].summary == (
        "ros_app has enough CPU, memory and I/O (engine statistics; not available: waiting for CPU, refused processes)"
    )


def test_each_configured_container_has_a_unit_unless_it_is_ignored() -> None:
    """`pressure/<key>` depends on its container and starts with the grace of what runs in it."""
    settings = testing.settings(
        containers=[{"name": "a"}, {"name": "b", "alias": "c"}, {"name": "d", "pressure": "ignore"}],
        ros={"grace": "9s"},
    )
    units = [unit for check in Pressure.build(settings) for unit in check.units]
    assert [(unit.id, unit.needs, unit.target, unit.grace_s) for unit in units] == [
        ("pressure/a", ("container/a",), "a", 9.0),
        ("pressure/c", ("container/c",), "c", 9.0),
    ]


def test_limits_are_configurable() -> None:
    """In `pressure:`."""
    bench = Bench(pressure={"throttled": {"warn": "98%", "error": "99%"}, "waiting": {"warn": 99, "error": 100}})
    assert set(names(bench.observations(5, **STARVED)[2:])) == {"OK"}
