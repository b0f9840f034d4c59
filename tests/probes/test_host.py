"""The host probe on the real machine, and on a fake /sys for hardware that this machine does not have."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.facts import CannotTell
from phm.probes.blocking_call import BlockingCallWorker
from phm.probes.host import Host
from tests.fakes.until import until


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may need longer to look at a disk than PHM waits for it."""
    monkeypatch.setattr("phm.probes.host.DISK_S", 60.0)


def probe(sysfs: Path, **host: object) -> Host:
    return Host(testing.settings(host=host).host, testing.FakeClock(), sysfs)


def write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="ascii")


def test_the_real_machine_is_read() -> None:
    """Plausible figures from the kernel of any machine."""
    machine = Host(testing.settings().host, SystemClock())
    until(lambda: machine.read().cpu_percent is not None, "a measurement of the CPU")
    fact = machine.read()
    assert fact.cpu_percent is not None and 0 <= fact.cpu_percent <= 100
    assert 0 < fact.memory_percent < 100 and fact.memory_available_bytes > 0
    (disk,) = fact.disks
    assert (disk.path, disk.problem) == ("/", "")
    assert 0 < disk.used_percent <= 100 and 0 <= disk.free_bytes <= disk.total_bytes
    assert fact.clock_synchronized in (True, False, None)


def test_disk_usage_equals_that_of_df(tmp_path: Path) -> None:
    """Blocks reserved for root are neither used nor free."""
    (disk,) = probe(tmp_path, disks=["/"]).read().disks
    seen = os.statvfs("/")
    used = seen.f_blocks - seen.f_bfree
    assert disk.used_percent == pytest.approx(100 * used / (used + seen.f_bavail), abs=1.0)


def test_a_missing_disk_is_a_problem_of_that_disk(tmp_path: Path) -> None:
    """The others are still reported."""
    root, gone = probe(tmp_path, disks=["/", "/no/such/mount"]).read().disks
    assert not root.problem
    assert "No such file" in gone.problem


def test_the_hottest_sensor_of_the_cpu_counts(tmp_path: Path) -> None:
    """Both thermal zones and hwmon; sensors of other parts do not count."""
    write(tmp_path / "class/thermal/thermal_zone0/type", "cpu-thermal\n")
    write(tmp_path / "class/thermal/thermal_zone0/temp", "48312\n")
    write(tmp_path / "class/thermal/thermal_zone1/type", "PMIC-Die\n")
    write(tmp_path / "class/thermal/thermal_zone1/temp", "100000\n")
    write(tmp_path / "class/hwmon/hwmon0/name", "coretemp\n")
    write(tmp_path / "class/hwmon/hwmon0/temp1_input", "51000\n")
    write(tmp_path / "class/hwmon/hwmon0/temp2_input", "garbage\n")
    fact = probe(tmp_path).read()
    assert (fact.temperature_c, fact.temperature_of) == (51.0, "coretemp")


def test_fans_are_read_if_their_drivers_report_them(tmp_path: Path) -> None:
    """Four at most; a value that is not a number is dropped."""
    for number, text in enumerate(("1200\n", "garbage\n", "0\n", "900\n", "800\n")):
        write(tmp_path / f"class/hwmon/hwmon0/fan{number}_input", text)
    assert probe(tmp_path).read().fans_rpm == (1200, 0, 900)


def test_a_machine_without_sensors_has_no_temperature(tmp_path: Path) -> None:
    """None, not zero degrees."""
    fact = probe(tmp_path).read()
    assert fact.temperature_c is None and fact.throttled is None


@pytest.mark.parametrize(
    ("bits", "words"),
    [
        ("0", ()),
        ("0x50005", ("under-voltage now", "throttled now")),
        ("50000", ("under-voltage earlier", "throttled earlier")),
        ("8", ("soft temperature limit now",)),
    ],
)
def test_throttling_of_a_raspberry_pi_is_described(tmp_path: Path, bits: str, words: tuple[str, ...]) -> None:
    """The low bits mean now, the same bits shifted by sixteen mean earlier."""
    write(tmp_path / "devices/platform/soc/soc:firmware/get_throttled", f"{bits}\n")
    assert probe(tmp_path).read().throttled == words


def test_throttling_is_read_each_time(tmp_path: Path) -> None:
    """The kernel polls every 2 s and forgets what it read before: PHM must read each of its readings."""
    flags, host = tmp_path / "devices/platform/soc/soc:firmware/get_throttled", probe(tmp_path)
    found = []
    for bits in ("0\n", "10000\n", "0\n"):
        write(flags, bits)
        found.append(host.read().throttled)
    assert found == [(), ("under-voltage earlier",), ()]


def test_a_clock_step_is_measured_against_the_monotonic_clock(tmp_path: Path) -> None:
    """Passing time is not a step; setting the clock is one, once."""
    clock = testing.FakeClock()
    host = Host(testing.settings().host, clock, tmp_path)
    steps = []
    for jump in (0.0, 0.0, -5.0, 0.0):
        clock.advance(2.0)
        clock.jump_utc(jump)
        steps.append(round(host.read().clock_step_s, 3))
    assert steps == [0.0, 0.0, -5.0, 0.0]


def test_whether_the_clock_is_synchronized_is_as_new_as_its_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both change when a time source is found; otherwise it is read every SLOW_S."""
    clock, states = testing.FakeClock(), iter((False, True))
    monkeypatch.setattr("phm.probes.host.clock_synchronized", lambda: next(states))
    host = Host(testing.settings().host, clock, tmp_path)
    found = []
    for jump in (0.0, 0.0, 5.0, 0.0):
        clock.advance(0.5)
        clock.jump_utc(jump)
        fact = host.read()
        found.append((fact.clock_synchronized, round(fact.clock_step_s)))
    assert found == [(False, 0), (False, 0), (True, 5), (True, 0)]


# ------------------------------------------------------------ the worker


def test_a_hung_call_costs_one_thread_and_is_rejected_until_it_returns() -> None:
    """A dead network mount is polled repeatedly; it must not cost a thread each time."""
    worker, release, back = BlockingCallWorker("test"), threading.Event(), threading.Event()

    def hang() -> None:
        release.wait(120)
        back.set()

    with pytest.raises(CannotTell, match="did not answer"):
        worker.call(hang, 0.01)
    for _ in range(5):
        with pytest.raises(CannotTell, match="not returned"):
            worker.call(lambda: 1, 0.01)
    assert sum(thread.name == "phm-test" for thread in threading.enumerate()) == 1
    release.set()
    assert back.wait(60)

    def answered() -> int:
        with contextlib.suppress(CannotTell):  # the hung call ends a moment after its last action
            return worker.call(lambda: 1, 60.0)
        return 0

    assert until(answered, "the worker to be free") == 1


def test_a_closed_worker_ends_when_its_call_returns() -> None:
    """A reload must not wait for a dead mount, nor leave a thread behind after it."""
    worker, release = BlockingCallWorker("test-closed"), threading.Event()
    with pytest.raises(CannotTell, match="did not answer"):
        worker.call(lambda: release.wait(120), 0.01)
    (thread,) = (thread for thread in threading.enumerate() if thread.name == "phm-test-closed")
    worker.close()
    assert thread.is_alive()
    release.set()
    until(lambda: not thread.is_alive(), "the end of the thread")
    with pytest.raises(CannotTell, match="stopping"):
        worker.call(lambda: 1, 60.0)


def test_an_exception_is_raised_in_the_caller() -> None:
    """And the worker keeps working."""
    worker = BlockingCallWorker("test-error")
    with pytest.raises(ZeroDivisionError):
        worker.call(lambda: 1 // 0, 60.0)
    assert worker.call(lambda: 2, 60.0) == 2
