"""Slot 9: fast detection of a CPU overload, and the probe behind it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm import api, testing
from phm.probes.cpu_usage import SHORTEST_S, CpuMonitor, CpuUsage
from phm.probes.host import Host as HostProbe
from phm_checks._cpu import STAYS_S, WAITING_PERCENT
from phm_checks.host import Host

STEP_S = 0.5
BUSY = {"cpu_percent": 100.0, "waiting_percent": 90.0}
CALM = {"cpu_percent": 30.0, "waiting_percent": 10.0}


class Bench:
    """The check on a machine and with a container that have been up for a while; each check is half a second later."""

    def __init__(self, **limits: Any) -> None:
        (self.check,) = Host.build(testing.settings(host=limits, containers=[{"name": "ros_app"}]))
        self.clock, self.host = testing.FakeClock(), testing.FakeHost()
        self.docker = testing.FakeDocker(testing.container("ros_app", started_at="2023-11-01T00:00:00.5Z"))
        self.pressure = testing.FakePressure()
        self.observations(20.0, **CALM)

    def observe(self, **fields: Any) -> api.Result:
        self.clock.advance(STEP_S)
        self.host.change(**fields)
        world = testing.world(clock=self.clock, host=self.host, docker=self.docker, pressure=self.pressure)
        results = self.check.run(world)
        assert not isinstance(results, api.Result)
        return results["host/cpu"]

    def observations(self, seconds: float, **fields: Any) -> list[api.Result]:
        return [self.observe(**fields) for _ in range(round(seconds / STEP_S))]

    def started(self) -> None:
        """The container was started a second ago."""
        stamp = "2023-11-14T22:13:39.1Z"  # the fake clock begins at 22:13:20 and has gone on for 20 s
        self.docker.change("ros_app", started_at=stamp)


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_a_start_is_recognized_despite_clock_steps(step_s: float) -> None:
    """The container's own timestamp is from the clock before the step."""
    bench = Bench()
    bench.started()
    bench.clock.jump_utc(step_s)
    assert "ERROR" not in [result.level.name for result in bench.observations(2.0, **BUSY)]


def test_a_full_cpu_with_waiting_tasks_is_reported_fast() -> None:
    """After `cpu_quick`, with the kernel's evidence in the text; nothing before."""
    results = Bench().observations(2.0, **BUSY)
    assert [result.level.name for result in results] == ["OK"] * 3 + ["ERROR"]
    assert (results[-1].condition, results[-1].brief) == ("cpu_high", "CPU 100 %")
    assert "waited for a core in 90 %" in results[-1].summary and "`top`" in results[-1].summary


def test_use_that_does_not_last_yet_is_reported_to_the_tracker_as_rising() -> None:
    """Symptoms that it may explain wait for it."""
    bench = Bench()
    assert not bench.observe(**CALM).evidence.rising
    assert [result.evidence.rising for result in bench.observations(1.5, **BUSY)] == [True] * 3
    assert not bench.observe(cpu_percent=100.0, waiting_percent=WAITING_PERCENT - 1).evidence.rising


def test_an_alarm_that_only_has_not_ended_yet_is_reported_to_the_tracker_as_falling() -> None:
    """It goes on for STAYS_S after the last burst, and explains symptoms no longer than these need."""
    bench = Bench()
    bench.observations(2.0, **BUSY)
    damped = bench.observations(STAYS_S - 2.0, **CALM)
    assert {result.level for result in damped} == {api.Level.ERROR}
    assert all(result.evidence.falling for result in damped)
    burst = bench.observe(**BUSY)
    assert (burst.level, burst.evidence.falling) == (api.Level.ERROR, False)
    ended = bench.observations(STAYS_S + 1.0, **CALM)[-1]
    assert (ended.level, ended.evidence.falling) == (api.Level.OK, False)


@pytest.mark.parametrize(
    "fields",
    [
        {"cpu_percent": 100.0, "waiting_percent": WAITING_PERCENT - 1},
        {"cpu_percent": 100.0, "waiting_percent": None},
        {"cpu_percent": 85.0, "waiting_percent": 100.0},
    ],
)
def test_load_without_cpu_pressure_is_left_to_the_mean(fields: dict[str, Any]) -> None:
    """All cores busy without waiting tasks, a kernel without PSI, and waiting tasks beside idle cores."""
    assert {result.level for result in Bench().observations(5.0, **fields)} == {api.Level.OK}


def test_one_idle_sample_restarts_the_fast_window() -> None:
    """A burst with a pause is not sustained."""
    bench = Bench()
    for _ in range(5):
        assert {result.level for result in [*bench.observations(1.5, **BUSY), bench.observe(**CALM)]} == {api.Level.OK}
        bench.observations(3.0, **CALM)


def test_a_starting_container_may_use_the_cpu_for_a_while() -> None:
    """Within `ros.grace` (8 s) of its start only the mean counts; then the fast detection reports it."""
    bench = Bench()
    bench.started()
    levels = [result.level.name for result in bench.observations(8.0, **BUSY)]
    assert levels[: round(6.5 / STEP_S)] == ["OK"] * round(6.5 / STEP_S)
    assert levels[-1] != "OK"


def test_the_fast_detection_is_off_shortly_after_the_start_of_phm() -> None:
    """A booting machine is busy."""
    bench = Bench()
    (bench.check,) = Host.build(testing.settings())
    assert "ERROR" not in {result.level.name for result in bench.observations(7.5, **BUSY)}


def test_with_a_silent_engine_only_the_mean_decides_and_the_engine_is_not_polled() -> None:
    """Each request may take as long as the engine's timeout."""
    bench = Bench()
    bench.docker.fail()
    bench.observations(2.0, **BUSY)
    asked = bench.docker.calls
    assert bench.observations(8.0, **BUSY)[-1].level is not api.Level.OK
    assert bench.docker.calls == asked == 1


def test_an_alarm_lasts_also_if_the_engine_took_long_to_answer() -> None:
    """On a busy machine it is slow: the alarm was over at the next reading, and raised again by the one after that."""
    bench = Bench()
    bench.observations(1.5, **BUSY)
    known = bench.docker.container

    def slow(name: str, young_s: float = 0.0) -> api.ContainerFact | None:
        bench.clock.advance(STAYS_S + 1.0)
        return known(name, young_s)

    bench.docker.container = slow  # type: ignore[method-assign]
    assert bench.observe(**BUSY).level is api.Level.ERROR
    assert bench.observe(**BUSY).level is api.Level.ERROR


def test_bursts_with_short_pauses_are_one_fault() -> None:
    """A fast report stays until the load has been low for a while."""
    bench = Bench()
    levels = []
    for _ in range(4):
        levels += [result.level for result in bench.observations(3.0, **BUSY) + bench.observations(2.0, **CALM)]
    assert set(levels[5:]) == {api.Level.ERROR}
    assert bench.observations(STAYS_S + 1.0, **CALM)[-1].level is api.Level.OK


def test_the_fast_detection_can_be_disabled() -> None:
    """Then only the mean decides."""
    assert {result.level for result in Bench(cpu_quick="0s").observations(6.0, **BUSY)} == {api.Level.OK}


def test_a_warning_of_the_fast_detection_becomes_an_error_of_the_mean() -> None:
    """The worse of the two is reported."""
    bench = Bench()
    assert bench.observations(3.0, cpu_percent=95.0, waiting_percent=90.0)[-1].level is api.Level.WARN
    assert bench.observations(12.0, cpu_percent=100.0, waiting_percent=90.0)[-1].level is api.Level.ERROR


def test_a_busy_start_of_phm_does_not_lower_the_limit_of_the_mean() -> None:
    """The mean of the first complete window is an ERROR only at the limit for ERROR, whatever its first readings were."""
    bench = Bench(cpu_quick="0s")
    (bench.check,) = Host.build(testing.settings(host={"cpu_quick": "0s"}, containers=[{"name": "ros_app"}]))
    results = [*bench.observations(5.0, **BUSY), *bench.observations(6.0, cpu_percent=91.0, waiting_percent=90.0)]
    assert [result.level.name for result in results if result.level.bad] == ["WARN"] * 2


# ------------------------------------------------------------ the probe


def write(proc: Path, ticks: str, waited_us: int | None) -> None:
    (proc / "pressure").mkdir(exist_ok=True)
    (proc / "stat").write_text(f"cpu  {ticks}\ncpu0 1 2 3\n", "ascii")
    if waited_us is not None:
        line = f"some avg10=0.00 avg60=0.00 avg300=0.00 total={waited_us}\nfull avg10=0.00 total=0\n"
        (proc / "pressure" / "cpu").write_text(line, "ascii")


def test_usage_is_measured_since_the_previous_sample(tmp_path: Path) -> None:
    """Idle and iowait do not count as usage; user already includes guest time; pressure is a share of the time."""
    clock = testing.FakeClock()
    write(tmp_path, "100 0 100 1000 100 0 0 0 50 0", 1_000_000)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(1.0)
    write(tmp_path, "150 0 125 1100 125 0 0 0 90 0", 1_400_000)
    use = processor.use()
    assert use.busy_percent == pytest.approx(100 * 75 / 200)
    assert use.waiting_percent == pytest.approx(40.0)


def test_a_sample_too_soon_returns_the_previous_one(tmp_path: Path) -> None:
    """The kernel counts in hundredths of a second."""
    clock = testing.FakeClock()
    write(tmp_path, "100 0 100 1000 0 0 0 0 0 0", 0)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(1.0)
    write(tmp_path, "200 0 100 1000 0 0 0 0 0 0", 0)
    first = processor.use()
    clock.advance(SHORTEST_S / 2)
    write(tmp_path, "200 0 100 1001 0 0 0 0 0 0", 0)
    assert processor.use() == first and first.busy_percent == 100.0


def test_nothing_is_measured_before_there_is_an_interval(tmp_path: Path) -> None:
    """Shares need two samples; zeros would be in the log and in the report's plots."""
    clock = testing.FakeClock()
    write(tmp_path, "100 0 100 1000 0 0 0 0 0 0", 0)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(SHORTEST_S / 2)
    assert processor.use() == CpuUsage(None, None, None, None)


def test_the_first_run_does_not_judge_what_was_not_measured(tmp_path: Path) -> None:
    """CPU and disks are STALE and have no values; after an interval both are measured."""
    clock = testing.FakeClock()
    write(tmp_path, "100 0 100 1000 0 0 0 0 0 0", 0)
    for name in ("memory", "io"):
        (tmp_path / "pressure" / name).write_text("some avg10=0.00 total=0\nfull avg10=0.00 total=0\n", "ascii")
    (tmp_path / "meminfo").write_text("MemTotal: 1000 kB\nMemAvailable: 700 kB\n", "ascii")
    settings = testing.settings(host={"disks": []})
    (check,) = Host.build(settings)
    machine = HostProbe(settings.host, clock, tmp_path / "sys", tmp_path)

    def observe() -> tuple[api.Result, api.Result]:
        results = check.run(testing.world(clock=clock, host=machine))
        assert not isinstance(results, api.Result)
        return results["host/cpu"], results["host/io"]

    clock.advance(SHORTEST_S / 2)
    for result in observe():
        assert (result.level, result.bypass, dict(result.values)) == (api.Level.STALE, False, {})
        assert "not measured yet" in result.summary
        assert " 0 %" not in result.summary and "does not count" not in result.summary
        assert result.readings is None or result.readings.cpu_percent is None
    clock.advance(1.0)
    write(tmp_path, "150 0 100 1150 0 0 0 0 0 0", 0)
    cpu, io = observe()
    assert (cpu.level, cpu.values["cpu_percent"]) == (api.Level.OK, 25.0)
    assert (io.level, io.bypass, dict(io.values)) == (api.Level.OK, False, {"io_stalled_percent": 0.0})


def test_a_kernel_without_psi_reports_no_pressure(tmp_path: Path) -> None:
    """Such as a Raspberry Pi without `psi=1` on its kernel command line."""
    clock = testing.FakeClock()
    write(tmp_path, "1 0 1 1 0 0 0 0 0 0", None)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(1.0)
    assert processor.use().waiting_percent is None


def test_without_psi_the_run_queues_show_waiting_tasks(tmp_path: Path) -> None:
    """Field 8 of each `cpu` line of /proc/schedstat (sched-stats.rst) counts nanoseconds: the mean of all CPUs."""

    def waited(first_ns: int, second_ns: int) -> None:
        lines = [
            f"cpu{number} 0 0 9 9 9 9 777 {ns} 9\ndomain0 3 1 2" for number, ns in enumerate((first_ns, second_ns))
        ]
        (tmp_path / "schedstat").write_text("\n".join(["version 15", "timestamp 4294892", *lines, ""]), "ascii")

    clock = testing.FakeClock()
    write(tmp_path, "1 0 1 1 0 0 0 0 0 0", None)
    waited(0, 10**9)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(1.0)
    waited(2 * 10**8, 10**9 + 3 * 10**8)
    assert processor.use().waiting_percent == pytest.approx(25.0)


def test_stalls_for_memory_and_disks_are_those_of_all_tasks(tmp_path: Path) -> None:
    """The `full` lines: one waiting task while others run is normal."""

    def stalled(full_us: int) -> None:
        for name in ("memory", "io"):
            lines = f"some avg10=0.00 total=9{full_us}\nfull avg10=0.00 avg60=0.00 avg300=0.00 total={full_us}\n"
            (tmp_path / "pressure" / name).write_text(lines, "ascii")

    clock = testing.FakeClock()
    write(tmp_path, "1 0 1 1 0 0 0 0 0 0", 0)
    stalled(1_000)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(2.0)
    stalled(501_000)
    use = processor.use()
    assert (use.memory_percent, use.io_percent) == (pytest.approx(25.0), pytest.approx(25.0))


def test_an_overload_names_the_processes_that_use_the_cpu() -> None:
    """They are queried only then."""
    bench = Bench()
    pressure = testing.FakePressure()
    pressure.taken = (api.ConsumerFact("slam", 1.83), api.ConsumerFact("ros_app", 0.1))
    bench.pressure = pressure
    assert pressure.consumers_asked == 0
    assert "slam uses 1.8 CPUs" in bench.observations(2.0, **BUSY)[-1].summary
