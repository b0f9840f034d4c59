"""Slot 9: the quick way to see that the processor is used up, and the reading behind it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm import api, testing
from phm.probes.cpu_usage import SHORTEST_S, CpuMonitor
from phm_checks._cpu import STAYS_S, WAITING_PERCENT
from phm_checks.host import Host

STEP_S = 0.5
BUSY = {"cpu_percent": 100.0, "waiting_percent": 90.0}
CALM = {"cpu_percent": 30.0, "waiting_percent": 10.0}


class Bench:
    """The check on a machine that has been up for a while, with one container that has, too; each look is half a second later."""

    def __init__(self, **limits: Any) -> None:
        (self.check,) = Host.build(testing.settings(host=limits, containers=[{"name": "ros_app"}]))
        self.clock, self.host = testing.FakeClock(), testing.FakeHost()
        self.docker = testing.FakeDocker(testing.container("ros_app", started_at="2023-11-01T00:00:00.5Z"))
        self.pressure = testing.FakePressure()
        self.looks(20.0, **CALM)

    def look(self, **fields: Any) -> api.Result:
        self.clock.advance(STEP_S)
        self.host.change(**fields)
        world = testing.world(clock=self.clock, host=self.host, docker=self.docker, pressure=self.pressure)
        results = self.check.run(world)
        assert not isinstance(results, api.Result)
        return results["host/cpu"]

    def looks(self, seconds: float, **fields: Any) -> list[api.Result]:
        return [self.look(**fields) for _ in range(round(seconds / STEP_S))]

    def started(self) -> None:
        """The container was started a second ago."""
        stamp = "2023-11-14T22:13:39.1Z"  # the fake clock begins at 22:13:20 and has gone on for 20 s
        self.docker.change("ros_app", started_at=stamp)


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_a_start_is_one_however_the_clock_is_set(step_s: float) -> None:
    """The container's own stamp is of the clock before the step."""
    bench = Bench()
    bench.started()
    bench.clock.jump_utc(step_s)
    assert "ERROR" not in [result.level.name for result in bench.looks(2.0, **BUSY)]


def test_a_processor_that_is_full_while_tasks_wait_is_told_soon() -> None:
    """After cpu_quick, with the kernel's evidence in the text; before it, nothing."""
    told = Bench().looks(2.0, **BUSY)
    assert [result.level.name for result in told] == ["OK"] * 3 + ["ERROR"]
    assert (told[-1].condition, told[-1].brief) == ("cpu_high", "CPU 100 %")
    assert "waited for a core in 90 %" in told[-1].summary and "`top`" in told[-1].summary


@pytest.mark.parametrize(
    "fields",
    [
        {"cpu_percent": 100.0, "waiting_percent": WAITING_PERCENT - 1},
        {"cpu_percent": 100.0, "waiting_percent": None},
        {"cpu_percent": 85.0, "waiting_percent": 100.0},
    ],
)
def test_what_the_kernel_does_not_call_pressure_is_left_to_the_mean(fields: dict[str, Any]) -> None:
    """Cores that are all used while nobody waits, a kernel that does not count, and waiting tasks beside idle cores."""
    assert {result.level for result in Bench().looks(5.0, **fields)} == {api.Level.OK}


def test_one_look_with_room_begins_the_quick_window_anew() -> None:
    """A burst that pauses is not sustained."""
    bench = Bench()
    for _ in range(5):
        assert {result.level for result in [*bench.looks(1.5, **BUSY), bench.look(**CALM)]} == {api.Level.OK}
        bench.looks(3.0, **CALM)


def test_a_container_that_starts_takes_the_processor_for_a_while() -> None:
    """Within ros.grace (8 s) of its start only the mean counts; then it is told."""
    bench = Bench()
    bench.started()
    levels = [result.level.name for result in bench.looks(8.0, **BUSY)]
    assert levels[: round(6.5 / STEP_S)] == ["OK"] * round(6.5 / STEP_S)
    assert levels[-1] != "OK"


def test_phm_itself_has_just_started() -> None:
    """A machine that boots is busy."""
    bench = Bench()
    (bench.check,) = Host.build(testing.settings())
    assert "ERROR" not in {result.level.name for result in bench.looks(7.5, **BUSY)}


def test_an_engine_that_does_not_answer_leaves_it_to_the_mean_and_is_left_alone() -> None:
    """Each question may take as long as the engine's time-out."""
    bench = Bench()
    bench.docker.fail()
    bench.looks(2.0, **BUSY)
    asked = bench.docker.calls
    assert bench.looks(8.0, **BUSY)[-1].level is not api.Level.OK
    assert bench.docker.calls == asked == 1


def test_bursts_with_short_pauses_are_one_fault() -> None:
    """What was told quickly stays until it was not so for a while."""
    bench = Bench()
    levels = []
    for _ in range(4):
        levels += [result.level for result in bench.looks(3.0, **BUSY) + bench.looks(2.0, **CALM)]
    assert set(levels[5:]) == {api.Level.ERROR}
    assert bench.looks(STAYS_S + 1.0, **CALM)[-1].level is api.Level.OK


def test_the_quick_way_can_be_switched_off() -> None:
    """Then the mean alone decides."""
    assert {result.level for result in Bench(cpu_quick="0s").looks(6.0, **BUSY)} == {api.Level.OK}


def test_a_warning_by_the_quick_way_becomes_an_error_by_the_mean() -> None:
    """The worse of the two is told."""
    bench = Bench()
    assert bench.looks(3.0, cpu_percent=95.0, waiting_percent=90.0)[-1].level is api.Level.WARN
    assert bench.looks(12.0, cpu_percent=100.0, waiting_percent=90.0)[-1].level is api.Level.ERROR


# ------------------------------------------------------------ the probe


def write(proc: Path, ticks: str, waited_us: int | None) -> None:
    (proc / "pressure").mkdir(exist_ok=True)
    (proc / "stat").write_text(f"cpu  {ticks}\ncpu0 1 2 3\n", "ascii")
    if waited_us is not None:
        line = f"some avg10=0.00 avg60=0.00 avg300=0.00 total={waited_us}\nfull avg10=0.00 total=0\n"
        (proc / "pressure" / "cpu").write_text(line, "ascii")


def test_use_is_counted_since_the_reading_before(tmp_path: Path) -> None:
    """Idle and waiting for a disk are no use; guests are counted in user already; pressure is a share of the time."""
    clock = testing.FakeClock()
    write(tmp_path, "100 0 100 1000 100 0 0 0 50 0", 1_000_000)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(1.0)
    write(tmp_path, "150 0 125 1100 125 0 0 0 90 0", 1_400_000)
    use = processor.use()
    assert use.busy_percent == pytest.approx(100 * 75 / 200)
    assert use.waiting_percent == pytest.approx(40.0)


def test_a_reading_too_soon_gives_the_last_one(tmp_path: Path) -> None:
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


def test_a_kernel_without_pressure_tells_none(tmp_path: Path) -> None:
    """As a Raspberry Pi's without `psi=1` on its command line."""
    clock = testing.FakeClock()
    write(tmp_path, "1 0 1 1 0 0 0 0 0 0", None)
    processor = CpuMonitor(clock, tmp_path)
    clock.advance(1.0)
    assert processor.use().waiting_percent is None


def test_without_pressure_the_run_queues_show_who_waits(tmp_path: Path) -> None:
    """The eighth figure of each `cpu` line of /proc/schedstat (sched-stats.rst) counts nanoseconds: the mean of the CPUs."""

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
    """The `full` lines: a single task that waits while others run is ordinary."""

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


def test_who_has_the_cpus_is_named_when_they_are_taken() -> None:
    """Asked only then."""
    bench = Bench()
    pressure = testing.FakePressure()
    pressure.taken = (api.ConsumerFact("slam", 1.83), api.ConsumerFact("ros_app", 0.1))
    bench.pressure = pressure
    assert pressure.consumers_asked == 0
    assert "slam uses 1.8 CPUs" in bench.looks(2.0, **BUSY)[-1].summary
