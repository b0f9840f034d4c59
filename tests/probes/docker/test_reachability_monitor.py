"""Reachability of addresses: a change triggers once, and the response timeout adapts."""

from __future__ import annotations

import pytest

from phm.facts import CannotTell
from phm.probes.ping import LEARNED, LEAST_S, LIMIT_S, TIMES, Pinger
from phm.probes.reachability_monitor import GIVEN_UP_S, PERIOD_S, ReachabilityMonitor
from phm.testing import FakeClock


class Bench:
    """Two addresses, and a counter of published changes."""

    def __init__(self) -> None:
        self.clock, self.silent, self.changes, self.pings = FakeClock(), set[str](), 0, 0
        self.addresses = ["10.0.0.2", "10.0.0.3"]
        self.monitor = ReachabilityMonitor(self.clock, lambda: self.addresses, self.ping, self.turned)

    def ping(self, address: str) -> bool:
        self.pings += 1
        return address not in self.silent

    def turned(self) -> None:
        self.changes += 1

    def poll(self, times: int = 1) -> int:
        """The number of changes published by these polls."""
        before = self.changes
        for _ in range(times):
            self.clock.advance(PERIOD_S)
            self.monitor.poll()
        return self.changes - before


def test_a_responding_address_changes_nothing() -> None:
    """Both addresses respond."""
    assert Bench().poll(10) == 0


def test_an_address_that_falls_silent_is_published_once_and_again_when_it_responds() -> None:
    """The check then runs periodically as long as it is bad."""
    bench = Bench()
    bench.silent.add("10.0.0.3")
    assert (bench.poll(), bench.poll(5)) == (1, 0)
    bench.silent.clear()
    assert (bench.poll(), bench.poll(5)) == (1, 0)


def test_an_address_that_is_silent_for_long_is_not_pinged() -> None:
    """Usually its container is gone, and each ping waits for a response."""
    bench = Bench()
    bench.addresses, bench.silent = ["10.0.0.2"], {"10.0.0.2"}
    bench.poll(int(GIVEN_UP_S / PERIOD_S) + 2)
    before = bench.pings
    bench.poll(10)
    assert bench.pings == before


def test_an_address_that_is_no_longer_configured_is_forgotten() -> None:
    """If it returns with another container, it starts from scratch."""
    bench = Bench()
    bench.silent.add("10.0.0.3")
    bench.poll()
    bench.addresses = ["10.0.0.2"]
    bench.poll()
    bench.addresses, bench.silent = ["10.0.0.2", "10.0.0.3"], set()
    assert bench.poll() == 0


def test_a_machine_without_sockets_does_not_end_the_monitor() -> None:
    """The thread continues, and the check reports the missing evidence."""
    clock = FakeClock()

    def ping(address: str) -> bool:
        raise CannotTell("no sockets")

    monitor = ReachabilityMonitor(clock, lambda: ["10.0.0.2"], ping, lambda: None)
    monitor.start()
    for _ in range(3):
        clock.wait_for_sleepers(1, 60.0)
        clock.advance(PERIOD_S)
    clock.wait_for_sleepers(1, 60.0)
    monitor.stop()


def test_the_response_timeout_adapts() -> None:
    """At first one second; later a quarter of it, or ten times the longest recent response."""
    limits: list[float] = []

    def ping(address: str, limit_s: float) -> bool:
        limits.append(limit_s)
        return True

    reach = Pinger(ping=ping)
    for _ in range(LEARNED + 1):
        assert reach.ping("10.0.0.2")
    assert limits == [LIMIT_S] * LEARNED + [LEAST_S]
    assert reach.limit_s("10.0.0.3") == LIMIT_S


@pytest.mark.parametrize(("took_s", "limit_s"), [(0.1, TIMES * 0.1), (0.5, LIMIT_S)])
def test_slow_responses_get_more_time(monkeypatch: pytest.MonkeyPatch, took_s: float, limit_s: float) -> None:
    """A busy machine delays both the response and its receiver; one second at most."""
    clock = FakeClock()
    monkeypatch.setattr("phm.probes.ping.time.monotonic", clock.mono)

    def ping(address: str, limit_s: float) -> bool:
        clock.advance(took_s)
        return True

    reach = Pinger(ping=ping)
    for _ in range(LEARNED):
        reach.ping("10.0.0.2")
    assert reach.limit_s("10.0.0.2") == pytest.approx(limit_s)
