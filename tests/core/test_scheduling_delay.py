"""Time in which PHM itself did not run does not count as silence of others."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from phm import api
from phm.checking.check_turns import CheckRun, ScheduledCheck
from phm.checking.scheduler import CheckScheduler
from phm.core.clock import SystemClock
from phm.core.scheduling_delay import NOISE_S, PERIOD_S, SchedulingDelay
from phm.probes.adaptive_timeout import AdaptiveTimeout
from phm.probes.autopilot_state import AutopilotState
from phm.probes.link_stats import LinkStats
from phm.swarm.peers import LOST_PERIODS, Peers
from phm.testing import FakeClock, world
from phm.transport.call_deadlines import CallDeadlines
from phm.transport.mavlink_traffic import Traffic
from phm.wire.tunnel import PeerState
from tests.fakes.mavlink import heartbeat
from tests.fakes.until import until


def starved(clock: FakeClock, seconds: float, share: float = 0.8) -> None:
    """PHM runs from time to time, and waits for a CPU in between."""
    for _ in range(round(seconds / PERIOD_S)):
        clock.advance((1 - share) * PERIOD_S)
        clock.be_late(share * PERIOD_S)


# ---------------------------------------------------------------- the measurement


def test_lateness_is_the_delay_of_the_measuring_thread() -> None:
    """Sleeping is not late; time beyond the announced moment is, except timer noise."""
    lateness = SchedulingDelay()
    lateness.expect(10.0)
    lateness.record_run(10.0 + NOISE_S / 2)
    assert lateness.late_s(0.0, 11.0) == 0.0
    lateness.expect(11.0)
    lateness.record_run(14.0)
    assert lateness.late_s(0.0, 20.0) == pytest.approx(3.0)
    assert lateness.late_s(12.0, 20.0) == pytest.approx(2.0)
    assert lateness.late_s(15.0, 20.0) == 0.0


def test_any_thread_knows_a_pause_before_the_measuring_thread_does() -> None:
    """After a pause the result does not depend on which thread runs first, and the pause counts once."""
    lateness = SchedulingDelay()
    lateness.expect(10.0)
    assert lateness.late_s(0.0, 15.0) == pytest.approx(5.0)
    lateness.record_run(15.01)
    assert lateness.late_s(0.0, 15.02) == pytest.approx(5.0)


def test_without_a_measurement_nothing_is_late() -> None:
    """A measuring thread that could not be started hides no loss."""
    assert SchedulingDelay().late_s(0.0, 1000.0) == 0.0


def test_the_longest_pause_counts_in_full_and_all_others_up_to_the_deadline_itself() -> None:
    """After a pause every sender has its full time again; a permanently starved PHM doubles a deadline at most."""
    clock = FakeClock()
    since = clock.mono()
    clock.be_late(60.0)
    assert clock.late_s(since, 3.5) == pytest.approx(60.0)
    starved(clock, 60.0)
    assert clock.late_s(since, 3.5) == pytest.approx(63.5)
    since = clock.mono()
    starved(clock, 60.0)
    assert clock.late_s(since, 3.5) <= 3.5 + PERIOD_S


PAUSED = """
import sys
from phm.core.clock import SystemClock
from tests.fakes.until import until
clock = SystemClock()
clock.measure()
began = clock.mono()
until(lambda: clock.lateness._due is not None, "the thread that measures to begin")
print("runs", flush=True)
sys.stdin.readline()
until(lambda: clock.late_s(began) > 1.0, "the thread that measures to run again")
print(clock.late_s(began), flush=True)
"""


def test_a_process_that_was_stopped_knows_for_how_long() -> None:
    """SIGSTOP for 3 s counts as not run, except for one period of the measurement."""
    with subprocess.Popen(
        [sys.executable, "-c", PAUSED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        assert process.stdout.readline() == "runs\n"
        time.sleep(2 * PERIOD_S)
        os.kill(process.pid, signal.SIGSTOP)
        stopped = time.monotonic()
        time.sleep(3.0)
        lasted_s = time.monotonic() - stopped
        os.kill(process.pid, signal.SIGCONT)
        process.stdin.write("\n")
        process.stdin.flush()
        assert float(process.stdout.readline()) >= lasted_s - PERIOD_S - NOISE_S


# ---------------------------------------------------------------- each timeout


def test_only_time_in_which_phm_ran_makes_a_check_overdue() -> None:
    """A run that waited because PHM was not scheduled is not reported; a hung one is."""
    clock = FakeClock()
    found: list[CheckRun] = []

    class Hangs(api.Check):
        name, slot, layer = "hangs", api.Slot.HOST, api.Layer.COMPANION

        def run(self, world: api.World) -> api.Result:
            raise AssertionError

    engine = CheckScheduler([ScheduledCheck(Hangs(), 5.0, 2.0)], world(), clock, found.append)
    engine.turns[0].running_since = clock.mono()
    clock.be_late(5.0)
    engine.report_overdue()
    assert (found, engine.overdue()) == ([], ())
    clock.advance(1.9)
    assert engine.report_overdue() == pytest.approx(0.1)
    clock.advance(0.2)
    engine.report_overdue()
    assert [batch.overdue for batch in found] == [True]


@pytest.mark.parametrize("late", ["paused", "starved"])
def test_an_autopilot_is_not_lost_while_phm_does_not_run(late: str) -> None:
    """Neither by its timeout nor by its adaptive timeout; silence while PHM runs is still a loss."""
    clock = FakeClock()
    pilot = AutopilotState(3.5, clock.late_s)
    for _ in range(130):
        pilot.heartbeat(clock.mono(), heartbeat(kind=2, autopilot=3), "fc")
        clock.advance(1.0)
    if late == "paused":
        clock.be_late(20.0)
    else:
        starved(clock, 3.0)

    def lost() -> tuple[bool, bool]:
        fact = pilot.fact(clock.mono(), lambda link: clock.mono())
        assert fact is not None
        return fact.silent_s > 3.5, fact.overdue

    assert lost() == (False, False)
    clock.advance(1.6)
    assert lost()[1]
    clock.advance(2.0)
    assert lost() == (True, True)


def test_a_starved_phm_still_reports_a_lost_autopilot_after_twice_the_timeout() -> None:
    """However rarely PHM runs, a real loss is not hidden permanently."""
    clock = FakeClock()
    pilot = AutopilotState(3.5, clock.late_s)
    pilot.heartbeat(clock.mono(), heartbeat(kind=2, autopilot=3), "fc")
    starved(clock, 5.0, share=0.9)
    fact = pilot.fact(clock.mono())
    assert fact is not None
    assert fact.silent_s <= 3.5
    starved(clock, 2.5, share=0.9)
    fact = pilot.fact(clock.mono())
    assert fact is not None
    assert fact.silent_s > 3.5


def test_pauses_of_phm_do_not_raise_the_limit_of_a_sender() -> None:
    """Otherwise the loss of a regular sender would be detected late for an hour after each starvation."""
    clock = FakeClock()
    cadence = AdaptiveTimeout(10.0)
    for _ in range(130):
        cadence.heartbeat(clock.mono())
        clock.advance(1.0)
    at = clock.mono()
    clock.be_late(4.0)
    cadence.heartbeat(clock.mono(), clock.late_s(at - 1.0))
    cadence.heartbeat(clock.mono())
    assert cadence.due_s() == 2.5


def test_a_router_is_not_silent_while_phm_does_not_run() -> None:
    """The age of a link's data excludes the time in which PHM did not run."""
    clock = FakeClock()
    flow = LinkStats((7, 193), clock.late_s)
    flow.sample(clock.mono(), Traffic(10, 0, 1, 0, {(7, 1): (1, 0)}))
    clock.be_late(6.0)
    clock.advance(1.0)
    flow.sample(clock.mono(), Traffic(10, 0, 1, 0, {(7, 1): (1, 0)}))
    fact = flow.fact(clock.mono(), api.LinkFact("router", open=True))
    assert fact.rx_age_s == pytest.approx(1.0)
    assert fact.senders[0].age_s == pytest.approx(1.0)


def test_peers_are_not_lost_while_phm_does_not_run() -> None:
    """Neither alone nor together; peers that stay silent while PHM runs are."""
    clock = FakeClock()
    peers = Peers(1, 2.0, (2, 3, 4), clock.late_s)
    for _ in range(60):
        for agent in (2, 3, 4):
            peers.heartbeat(agent, 5, clock.mono())
        for _ in range(4):
            clock.advance(0.5)
            peers.watch(clock.mono(), 2.0)
    starved(clock, 12.0)
    peers.watch(clock.mono(), 2.0)
    assert set(peers.states(clock.mono()).values()) <= {PeerState.ALIVE, PeerState.LATE}
    clock.be_late(30.0)
    peers.watch(clock.mono(), 2.0)
    assert set(peers.states(clock.mono()).values()) <= {PeerState.ALIVE, PeerState.LATE}
    for _ in range(30):
        clock.advance(0.5)
        peers.watch(clock.mono(), 2.0)
    assert set(peers.states(clock.mono()).values()) == {PeerState.LOST}
    assert LOST_PERIODS * 2.0 < 15.0


def test_a_call_is_not_aborted_for_time_in_which_phm_did_not_run() -> None:
    """The response may wait in the socket; a call without a response while PHM runs is aborted."""
    clock = FakeClock()
    watchdog = CallDeadlines(clock, "phm-test-deadlines")
    near, far = socket.socketpair()
    with near, far, watchdog.watch(2.0) as call:
        call.attach(near)
        clock.wait_for_sleepers(1, 60.0)
        clock.be_late(5.0)
        clock.wait_for_sleepers(1, 60.0)
        assert not call.expired
        clock.advance(2.1)
        until(lambda: call.expired, "the call to expire")
    watchdog.close()


def test_the_system_clock_measures_after_the_first_request() -> None:
    """Before that nothing counts as late; the measuring thread announces its next wake-up."""
    clock = SystemClock()
    assert clock.late_s(0.0) == 0.0
    clock.measure()
    until(lambda: clock.lateness._due is not None, "the first measurement")
