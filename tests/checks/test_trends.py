"""Rules of the warnings of what will fail: in the units of disk, memory, radio, topic and container."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks.container import Container
from phm_checks.host import Host
from phm_checks.pressure import Pressure
from phm_checks.radio import Radio
from phm_checks.rates import Rates

MIB = 1 << 20
GB = 1_000_000_000


class Machine:
    """The host check, once a second."""

    def __init__(self, **settings: Any) -> None:
        (self.check,) = Host.build(testing.settings(**settings))
        self.clock, self.host = testing.FakeClock(), testing.FakeHost()

    def watch(self, unit: str, seconds: int, fields: Callable[[int], dict[str, Any]]) -> list[api.Result]:
        results = []
        for second in range(seconds):
            self.host.change(**fields(second))
            found = self.check.run(testing.world(clock=self.clock, host=self.host))
            assert not isinstance(found, api.Result)
            results.append(found[unit])
            self.clock.advance(1.0)
        return results


def disk(percent: float) -> dict[str, Any]:
    return {"disks": (api.DiskFact("/", percent, round((100 - percent) / 100 * 20 * GB), 5.0, total_bytes=20 * GB),)}


def test_a_disk_that_fills_is_reported_before_it_is_full() -> None:
    """WARN, with the time that is left and how sure that is; later the limit itself is reported by the same unit."""
    results = Machine().watch("host/disk", 480, lambda second: disk(70.0 + 0.05 * second))
    first = next(number for number, result in enumerate(results) if result.level is api.Level.WARN)
    assert 160 <= first <= 180, "its limit is then twice as far ahead as it was observed"
    warning = results[first]
    assert (warning.condition, warning.brief) == ("disk_filling", "disk / full in 6 min")
    assert "reaches 95 % in 330 s at this rate (in 330 s at the latest, with 95 % confidence)" in warning.summary
    assert all(result.level is api.Level.WARN for result in results[first:])
    assert [result.condition for result in (results[290], results[310])] == ["disk_filling", "disk_full"]


def test_the_line_for_the_ground_changes_seldom() -> None:
    """Each change is sent."""
    results = Machine().watch("host/disk", 600, lambda second: disk(50.0 + 0.05 * second))
    assert len({result.brief for result in results if result.condition == "disk_filling"}) <= 5


def test_a_disk_that_is_filled_slowly_is_not_reported() -> None:
    """It will be full after the horizon."""
    results = Machine().watch("host/disk", 900, lambda second: disk(50.0 + 0.01 * second))
    assert {result.level for result in results} == {api.Level.OK}


def test_logs_that_are_rotated_are_not_a_trend() -> None:
    """A sawtooth of two minutes, once more than one tooth was observed."""
    results = Machine().watch("host/disk", 1800, lambda second: disk(60.0 + 0.1 * (second % 120)))
    levels = [result.level for result in results[600:]]
    assert set(levels) == {api.Level.OK}


def test_memory_of_the_computer_that_grows_is_reported() -> None:
    """With the same words."""
    results = Machine().watch("host/memory", 300, lambda second: {"memory_percent": 40.0 + 0.1 * second})
    assert results[-1].condition == "memory_filling"
    assert "find the leak (`docker stats`)" in results[-1].summary


@pytest.mark.parametrize("section", ["disk", "memory"])
def test_a_horizon_of_0_switches_it_off(section: str) -> None:
    """For those who want limits only."""
    machine = Machine(trends={section: 0})
    rising = {
        "disk": lambda second: disk(50.0 + 0.05 * second),
        "memory": lambda second: {"memory_percent": 40 + 0.1 * second},
    }
    assert {result.level for result in machine.watch(f"host/{section}", 300, rising[section])} == {api.Level.OK}


def pressure(
    seconds: int, used: Callable[[int], int], generation: Callable[[int], str] = lambda _: "a"
) -> list[api.Result]:
    (check,) = Pressure.build(testing.settings(containers=[{"name": "ros_app"}]))
    clock, probe = testing.FakeClock(), testing.FakePressure()
    results = []
    for second in range(seconds):
        fact = api.PressureFact(
            clock.mono(),
            "cgroup v2",
            generation(second),
            memory_bytes=250 * MIB,
            without_cache_bytes=used(second),
            memory_limit=256 * MIB,
        )
        probe.put("ros_app", fact)
        result = check.run(testing.world(clock=clock, pressure=probe))
        assert isinstance(result, api.Result)
        results.append(result)
        clock.advance(1.0)
    return results


def test_a_container_that_grows_to_its_limit_is_reported() -> None:
    """By its working set: the page cache fills any limit, and is not a leak."""
    result = pressure(120, lambda second: 100 * MIB + second * MIB // 2)[-1]
    assert (result.level, result.condition) == (api.Level.WARN, "memory_filling")
    assert result.brief.startswith("ros_app memory full in ") and result.target == "ros_app"
    assert "growing by 30 MB a minute: find the leak" in result.summary


def test_page_cache_is_not_a_leak() -> None:
    """Memory in use is near its limit all the time here."""
    assert {result.level for result in pressure(120, lambda _: 100 * MIB)[1:]} == {api.Level.OK}


def test_a_restarted_container_is_observed_from_its_start() -> None:
    """The growth of the former run says nothing about this one."""
    results = pressure(
        170,
        lambda second: 100 * MIB + second * MIB // 2 if second < 120 else 100 * MIB,
        lambda second: "a" if second < 120 else "b",
    )
    assert results[119].level is api.Level.WARN and results[121].level is api.Level.OK


def test_a_shortage_of_now_has_priority_over_a_forecast() -> None:
    """A forecast explains no other fault, so it must not take the place of one that does."""
    (check,) = Pressure.build(testing.settings(containers=[{"name": "ros_app"}]))
    clock, probe = testing.FakeClock(), testing.FakePressure()
    for second in range(150):
        fact = api.PressureFact(
            clock.mono(),
            "cgroup v2",
            "a",
            without_cache_bytes=100 * MIB + second * MIB // 2,
            memory_limit=256 * MIB,
            pids=95 if second > 140 else 5,
            pids_limit=100,
        )
        probe.put("ros_app", fact)
        result = check.run(testing.world(clock=clock, pressure=probe))
        clock.advance(1.0)
    assert isinstance(result, api.Result)
    assert (result.level, result.condition) == (api.Level.WARN, "pids_limit")
    assert "memory limit of 256 MB in" in result.summary, "both are said"


def test_a_value_that_falls_through_its_limit_is_not_a_forecast() -> None:
    """Memory that was above its limit, and is given back: the limit lies ahead of the falling trend, too."""
    results = Machine().watch(
        "host/memory", 203, lambda second: {"memory_percent": 99.0 - 0.01 * second if second < 200 else 50.0}
    )
    assert {result.level for result in results[200:]} == {api.Level.OK}


def test_a_radio_that_loses_margin_is_reported_before_it_is_weak() -> None:
    """The pilot can turn back while commands still arrive."""
    endpoint = {"url": "/dev/ttyUSB0", "name": "ground"}
    (check,) = Radio.build(testing.settings(mavlink={"endpoints": [endpoint]}))
    clock, fact = testing.FakeClock(), api.RadioFact("ground", 0.2, 2.0, 180, 175, 40, 45, 98, 140.0, 130.0, 0.2, 0.1)
    link = api.LinkFact("ground", open=True, rx_age_s=0.5)
    for second in range(60):
        margin = 80.0 - 0.5 * second
        links = testing.FakeLinks(links=(link,), radios=(replace(fact, margin=margin, remmargin=margin + 5),))
        result = check.run(testing.world(clock=clock, links=links))
        clock.advance(1.0)
    assert isinstance(result, api.Result)
    assert (result.level, result.condition) == (api.Level.WARN, "radio_fading")
    assert "falls below" in result.summary and result.brief.startswith("radio: weak in ")


def test_a_topic_with_rising_jitter_is_reported_at_its_right_rate() -> None:
    """Its rate is still right."""
    topic = {"name": "/odom", "rate": 10.0, "publishers": ["/node"]}
    (check,) = Rates.build(testing.settings(ros={"topics": [topic]}))
    clock, ros = testing.FakeClock(), testing.FakeRos()
    for second in range(120):
        rate = api.RateFact(
            10.0, 0.1, 3.0, samples=50, limit_s=1.5, publishers=1, error_hz=0.0, jitter_s=0.002 + 0.0002 * second
        )
        ros.change(topics={"/odom": api.TopicFact((api.EndpointFact("/node", "std_msgs/msg/String"),), (), rate)})
        results = check.run(testing.world(clock=clock, ros=ros))
        clock.advance(1.0)
    assert not isinstance(results, api.Result)
    result = results["rates/odom"]
    assert (result.level, result.condition) == (api.Level.WARN, "jitter_rising")
    assert "its jitter of 26 ms rises to half of its period, 50 ms" in result.summary


def restarted(*at_s: int, for_s: int = 3000) -> api.Result:
    """The container check at the end of a time in which the container was restarted at these seconds."""
    (check,) = Container.build(testing.settings(containers=[{"name": "ros_app"}]))
    clock, runs = testing.FakeClock(), 0
    for second in range(0, for_s, 5):
        runs += second in at_s
        fact = testing.container("ros_app", started_at=f"run {runs}", restart_count=runs)
        result = check.run(testing.world(clock=clock, docker=testing.FakeDocker(fact)))
        clock.advance(5.0)
    assert isinstance(result, api.Result)
    return result


def test_restarts_that_become_more_frequent_are_reported() -> None:
    """Each of them alone is only a restart."""
    result = restarted(1200, 2000, 2500, 2700, 2900)
    assert (result.level, result.condition, result.brief) == (
        api.Level.WARN,
        "restarts_rising",
        "ros_app 5 restarts, ever faster",
    )
    assert result.ends_fault, "the container runs: a recovery that has started it has succeeded"
    assert result.evidence.generation


@pytest.mark.parametrize("at_s", [(600, 1200, 1800, 2400, 2700), (100, 300, 800, 2000), (2500, 2900)])
def test_restarts_without_a_trend_are_not_reported(at_s: tuple[int, ...]) -> None:
    """Even, ever rarer, or too few."""
    assert restarted(*at_s).level is api.Level.OK
