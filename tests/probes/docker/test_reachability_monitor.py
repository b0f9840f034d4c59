"""The pulse of addresses: a change is told once, and how long an answer may take is learned."""

from __future__ import annotations

import pytest

from phm.facts import CannotTell
from phm.probes.ping import LEARNED, LEAST_S, LIMIT_S, TIMES, Pinger
from phm.probes.reachability_monitor import GIVEN_UP_S, PERIOD_S, ReachabilityMonitor
from phm.testing import FakeClock


class Bench:
    """Two addresses and whoever is told of them."""

    def __init__(self) -> None:
        self.clock, self.silent, self.told, self.knocks = FakeClock(), set[str](), 0, 0
        self.addresses = ["10.0.0.2", "10.0.0.3"]
        self.pulse = ReachabilityMonitor(self.clock, lambda: self.addresses, self.ping, self.turned)

    def ping(self, address: str) -> bool:
        self.knocks += 1
        return address not in self.silent

    def turned(self) -> None:
        self.told += 1

    def poll(self, times: int = 1) -> int:
        """How often somebody was told meanwhile."""
        before = self.told
        for _ in range(times):
            self.clock.advance(PERIOD_S)
            self.pulse.poll()
        return self.told - before


def test_an_address_that_answers_is_not_told() -> None:
    """All is well."""
    assert Bench().poll(10) == 0


def test_who_falls_silent_is_told_once_and_again_when_it_answers() -> None:
    """The check then looks by itself as long as it is bad."""
    bench = Bench()
    bench.silent.add("10.0.0.3")
    assert (bench.poll(), bench.poll(5)) == (1, 0)
    bench.silent.clear()
    assert (bench.poll(), bench.poll(5)) == (1, 0)


def test_who_is_silent_for_long_is_left_to_the_check() -> None:
    """Mostly its container is gone, and each knock waits for an answer."""
    bench = Bench()
    bench.addresses, bench.silent = ["10.0.0.2"], {"10.0.0.2"}
    bench.poll(int(GIVEN_UP_S / PERIOD_S) + 2)
    before = bench.knocks
    bench.poll(10)
    assert bench.knocks == before


def test_an_address_that_is_no_longer_looked_for_is_forgotten() -> None:
    """When it comes back in another life, it begins anew."""
    bench = Bench()
    bench.silent.add("10.0.0.3")
    bench.poll()
    bench.addresses = ["10.0.0.2"]
    bench.poll()
    bench.addresses, bench.silent = ["10.0.0.2", "10.0.0.3"], set()
    assert bench.poll() == 0


def test_a_machine_without_sockets_ends_nothing() -> None:
    """The thread goes on, and the check tells what cannot be told."""
    clock = FakeClock()

    def ping(address: str) -> bool:
        raise CannotTell("no sockets")

    pulse = ReachabilityMonitor(clock, lambda: ["10.0.0.2"], ping, lambda: None)
    pulse.start()
    for _ in range(3):
        clock.wait_for_sleepers(1)
        clock.advance(PERIOD_S)
    clock.wait_for_sleepers(1)
    pulse.stop()


def test_how_long_an_answer_may_take_is_learned() -> None:
    """At first a second; later a quarter of one, or ten times the longest of late."""
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
def test_slow_answers_are_given_more_time(monkeypatch: pytest.MonkeyPatch, took_s: float, limit_s: float) -> None:
    """A busy machine delays answers and whoever waits for them; never more than a second."""
    clock = FakeClock()
    monkeypatch.setattr("phm.probes.ping.time.monotonic", clock.mono)

    def ping(address: str, limit_s: float) -> bool:
        clock.advance(took_s)
        return True

    reach = Pinger(ping=ping)
    for _ in range(LEARNED):
        reach.ping("10.0.0.2")
    assert reach.limit_s("10.0.0.2") == pytest.approx(limit_s)
