"""Slot 9: rules of the host check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks._threshold import Threshold
from phm_checks.host import FIRST_SET_S, STEP_REPORT_S, THROTTLE_REPORT_S, Host


class Bench:
    """The check with a fake machine and a fake clock; each check is two seconds later."""

    def __init__(self, **limits: Any) -> None:
        (self.check,) = Host.build(testing.settings(host=limits))
        self.clock, self.host = testing.FakeClock(), testing.FakeHost()

    def observe(self, part: str, **fields: Any) -> api.Result:
        self.host.change(**fields)
        results = self.check.run(testing.world(clock=self.clock, host=self.host))
        assert not isinstance(results, api.Result)
        assert set(results) == {unit.id for unit in self.check.units}
        self.clock.advance(2.0)
        return results[f"host/{part}"]


def test_an_idle_machine_is_ok() -> None:
    """Each part has a unit and a reading."""
    bench = Bench()
    for part in ("cpu", "memory", "disk", "temperature", "clock"):
        assert bench.observe(part).level is api.Level.OK


def test_a_burst_of_cpu_load_is_not_a_fault() -> None:
    """CPU usage is averaged over `cpu_window`, and high usage is reported only when the window is full."""
    bench = Bench(cpu_window="10s")
    levels = [bench.observe("cpu", cpu_percent=100.0).level for _ in range(6)]
    assert levels == [api.Level.STALE] * 5 + [api.Level.ERROR]


def test_one_busy_sample_vanishes_in_the_mean() -> None:
    """One sample of five does not reach the limit."""
    bench = Bench(cpu_window="10s")
    for _ in range(6):
        bench.observe("cpu", cpu_percent=50.0)
    assert bench.observe("cpu", cpu_percent=100.0).level is api.Level.OK


def test_samples_before_the_window_do_not_count() -> None:
    """Only the window determines the mean."""
    bench = Bench(cpu_window="10s")
    for _ in range(10):
        bench.observe("cpu", cpu_percent=100.0)
    for _ in range(5):
        result = bench.observe("cpu", cpu_percent=0.0)
    assert result.values["cpu_percent"] == 0.0


@pytest.mark.parametrize(
    ("part", "fields", "level", "condition"),
    [
        ("memory", {"memory_percent": 86.0}, api.Level.WARN, "memory_high"),
        ("memory", {"memory_percent": 96.0}, api.Level.ERROR, "memory_high"),
        ("disk", {"disks": (api.DiskFact("/", 90.0, 10**9),)}, api.Level.WARN, "disk_full"),
        ("disk", {"disks": (api.DiskFact("/", 10.0, 10**9, 99.0),)}, api.Level.ERROR, "disk_full"),
        ("temperature", {"temperature_c": 76.0}, api.Level.WARN, "temperature_high"),
        ("temperature", {"temperature_c": 90.0}, api.Level.ERROR, "temperature_high"),
        ("temperature", {"throttled": ("under-voltage now",)}, api.Level.WARN, "throttled"),
        ("clock", {"clock_step_s": -3600.0}, api.Level.WARN, "clock_step"),
    ],
)
def test_each_limit_has_its_condition(part: str, fields: dict[str, Any], level: api.Level, condition: str) -> None:
    """WARN at the first limit, ERROR at the second, advice in the summary."""
    result = Bench().observe(part, **fields)
    assert (result.level, result.condition) == (level, condition)
    assert result.brief and result.brief.isascii() and ":" in result.summary


def test_the_worst_disk_counts_and_a_hung_one_is_stale() -> None:
    """A dead mount does not hide a full disk."""
    hung = api.DiskFact("/mnt/nas", 0.0, 0, problem="the kernel did not answer within 1 s")
    assert Bench().observe("disk", disks=(api.DiskFact("/", 50.0, 10**9), hung)).level is api.Level.STALE
    result = Bench().observe("disk", disks=(hung, api.DiskFact("/", 99.0, 10**6)))
    assert result.level is api.Level.ERROR
    assert "/mnt/nas" in result.summary


def test_a_value_at_the_limit_does_not_flap() -> None:
    """A level ends only 5 % below its limit."""
    threshold = Threshold(warn=80.0, error=90.0)
    values = (79.0, 80.0, 79.0, 77.0, 75.0, 90.0, 89.0, 86.0, 85.0, 77.0, 75.0)
    expected = "OK WARN WARN WARN OK ERROR ERROR ERROR WARN WARN OK"
    assert " ".join(threshold.level(value).name for value in values) == expected


def test_a_machine_without_temperature_sensors_is_a_bypass() -> None:
    """The text says so; it is not a fault."""
    result = Bench().observe("temperature", temperature_c=None, throttled=None)
    assert result.bypass and "does not report" in result.summary


def test_past_throttling_is_a_note() -> None:
    """Before the start of PHM; the text remains for readers of the log."""
    bench = Bench()
    for _ in range(3):
        result = bench.observe("temperature", throttled=("under-voltage earlier",))
        assert result.level is api.Level.OK
        assert "under-voltage earlier" in result.summary


def warned_s(bench: Bench, seconds: int) -> int:
    """For how many of the next `seconds` the temperature is a WARN; the machine is observed every 2 s."""
    return 2 * sum(bench.observe("temperature").level is api.Level.WARN for _ in range(seconds // 2))


def test_short_throttling_is_reported_for_a_limited_time() -> None:
    """Kernels that poll every 2 s show it in one reading. A motor that starts again extends the time."""
    bench = Bench()
    bench.observe("temperature")
    for _ in range(2):
        result = bench.observe("temperature", throttled=("under-voltage earlier",))
        assert (result.level, result.condition, result.brief) == (api.Level.WARN, "throttled", "under-voltage")
        assert "under-voltage in the last 30 s: check the power supply" in result.summary
        bench.observe("temperature", throttled=())
        assert warned_s(bench, 20) == 20
    assert warned_s(bench, 40) == THROTTLE_REPORT_S - 24


def test_repeated_throttling_is_reported_until_it_ends() -> None:
    """A kernel that was seen to clear the flag sets it again only for a new under-voltage."""
    bench = Bench()
    for flags in ((), ("under-voltage earlier",), ()):
        bench.observe("temperature", throttled=flags)
    bench.host.change(throttled=("under-voltage earlier",))
    assert warned_s(bench, 100) == 100
    bench.host.change(throttled=())
    assert warned_s(bench, 100) == THROTTLE_REPORT_S - 2


def test_a_flag_that_is_kept_since_boot_becomes_a_note() -> None:
    """Other kernels never clear it: its first appearance is reported, and each end of a throttling that is seen."""
    bench = Bench()
    bench.observe("temperature")
    bench.host.change(throttled=("under-voltage earlier",))
    assert warned_s(bench, 100) == THROTTLE_REPORT_S
    bench.host.change(throttled=None)
    assert warned_s(bench, 10) == 0, "a reading that failed shows nothing"
    bench.host.change(throttled=("under-voltage earlier",))
    assert warned_s(bench, 10) == 0
    result = bench.observe("temperature", throttled=("under-voltage now",))
    assert (result.level, result.brief) == (api.Level.WARN, "under-voltage")
    assert "the CPU is throttled: under-voltage now" in result.summary
    bench.host.change(throttled=("under-voltage earlier",))
    assert warned_s(bench, 100) == THROTTLE_REPORT_S - 2


def test_a_clock_step_is_reported_for_a_limited_time() -> None:
    """It is visible in one sample only, which would be easy to miss."""
    bench = Bench()
    bench.observe("clock", clock_step_s=10.0)
    assert bench.observe("clock", clock_step_s=0.0).brief == "clock jumped +10 s"
    bench.clock.advance(STEP_REPORT_S)
    assert bench.observe("clock").level is api.Level.OK


def test_a_time_source_that_returns_is_not_the_first() -> None:
    """It was synchronized before, so earlier time stamps are right."""
    bench = Bench()
    bench.clock = testing.FakeClock(mono=2 * FIRST_SET_S)
    bench.observe("clock", clock_synchronized=True)
    bench.observe("clock", clock_synchronized=False)
    assert bench.observe("clock", clock_step_s=3.0, clock_synchronized=True).condition == "clock_step"


@pytest.mark.parametrize(("synchronized", "mono"), [(False, 60.0), (None, 60.0), (False, 2 * FIRST_SET_S)])
def test_the_first_time_that_is_set_after_boot_is_a_note(synchronized: bool | None, mono: float) -> None:
    """A computer without a battery for its clock has an old time until it has a time source. A second jump is a WARN."""
    bench = Bench()
    bench.clock = testing.FakeClock(mono=mono)
    bench.observe("clock", clock_synchronized=synchronized)
    for step in (86400.0, 0.0):
        first = bench.observe("clock", clock_step_s=step, clock_synchronized=True)
        assert (first.level, first.brief) == (api.Level.OK, "")
        assert "set for the first time, by +86400.0 s" in first.summary
    assert bench.observe("clock", clock_step_s=3.0).brief == "clock jumped +3 s"
    bench.clock.advance(STEP_REPORT_S)
    assert bench.observe("clock", clock_step_s=0.0).summary == "Clock is synchronised"


@pytest.mark.parametrize(
    ("mono", "synchronized", "step"),
    [(60.0, None, -5.0), (60.0, True, 5.0), (FIRST_SET_S, None, 5.0), (FIRST_SET_S, False, 5.0)],
    ids=["back", "synchronised before", "long after boot", "without a time source"],
)
def test_any_other_jump_is_a_warning(mono: float, synchronized: bool | None, step: float) -> None:
    """Nothing is expected to set the clock like this."""
    bench = Bench()
    bench.clock = testing.FakeClock(mono=mono)
    bench.observe("clock", clock_synchronized=synchronized)
    assert bench.observe("clock", clock_step_s=step).condition == "clock_step"


@pytest.mark.parametrize("synchronized", [True, False, None])
def test_a_clock_without_time_source_is_a_note(synchronized: bool | None) -> None:
    """Vehicles in the field often have none."""
    result = Bench().observe("clock", clock_synchronized=synchronized)
    assert result.level is api.Level.OK
    assert result.values["clock_synchronized"] is synchronized


def test_an_unreadable_machine_is_not_a_fault() -> None:
    """CannotTell propagates, and all units are STALE."""
    bench = Bench()
    bench.host.fail("/proc is not mounted")
    with pytest.raises(api.CannotTell):
        bench.observe("cpu")


class Stalled:
    """The check on a machine whose tasks wait for memory or disks; each check is a second after the previous one."""

    def __init__(self) -> None:
        (self.check,) = Host.build(testing.settings())
        self.clock, self.host = testing.FakeClock(), testing.FakeHost()

    def observations(self, count: int, unit: str, **fields: float | None) -> list[api.Result]:
        self.host.change(**fields)
        found = []
        for _ in range(count):
            self.clock.advance(1.0)
            results = self.check.run(testing.world(clock=self.clock, host=self.host))
            assert not isinstance(results, api.Result)
            found.append(results[unit])
        return found


def test_disks_that_stall_the_machine_are_reported_after_a_while() -> None:
    """With the share, its limit and advice; a burst of writes is not reported, and an idle window ends the fault."""
    bench = Stalled()
    assert {result.level for result in bench.observations(12, "host/io", io_stalled_percent=10.0)} == {api.Level.OK}
    assert {result.level for result in bench.observations(5, "host/io", io_stalled_percent=99.0)} == {api.Level.OK}
    bench.observations(10, "host/io", io_stalled_percent=10.0)
    result = bench.observations(12, "host/io", io_stalled_percent=98.0)[-1]
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "io_pressure",
        "host waits for disk 98 %",
    )
    assert "all tasks waited for disks during 98 % of the last 10 s" in result.summary and "SD card" in result.summary
    assert bench.observations(12, "host/io", io_stalled_percent=1.0)[-1].level is api.Level.OK


@pytest.mark.parametrize(
    ("unit", "key", "percent"),
    [("host/io", "io_stalled_percent", 99.0), ("host/memory", "memory_stalled_percent", 25.0)],
)
def test_stalls_that_do_not_last_yet_are_reported_to_the_tracker_as_rising(unit: str, key: str, percent: float) -> None:
    """Containers that wait for the same wait for that; once it is reported, and afterwards, it is not rising."""
    bench = Stalled()
    assert not bench.observations(12, unit, **{key: 1.0})[-1].evidence.rising
    rising = bench.observations(3, unit, **{key: percent})[-1]
    assert (rising.level, rising.evidence.rising) == (api.Level.OK, True)
    reported = bench.observations(12, unit, **{key: percent})[-1]
    assert (reported.level.bad, reported.evidence.rising) == (True, False)
    assert not bench.observations(12, unit, **{key: 1.0})[-1].evidence.rising


def test_a_kernel_without_psi_is_a_bypass() -> None:
    """Raspberry Pi OS without `psi=1`: the slot is not yellow."""
    result = Stalled().observations(12, "host/io", io_stalled_percent=None)[-1]
    assert result.bypass and result.level is api.Level.OK and "psi=1" in result.summary


def test_memory_stalls_are_reported_together_with_memory_usage() -> None:
    """A machine can have memory available and still lack room for the working set of its programs."""
    bench = Stalled()
    result = bench.observations(12, "host/memory", memory_stalled_percent=45.0)[-1]
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "memory_pressure",
        "host waits for memory 45 %",
    )
    result = bench.observations(1, "host/memory", memory_percent=99.0)[-1]
    assert "waited for memory during 45 %" in result.summary and "memory at 99 %" in result.summary
    assert (
        bench.observations(12, "host/memory", memory_percent=40.0, memory_stalled_percent=1.0)[-1].level is api.Level.OK
    )
