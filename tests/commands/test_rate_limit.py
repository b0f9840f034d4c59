"""Limits for requests, and protection against duplicates."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, strategies as st

from phm.commands.rate_limit import (
    ALL_BURST,
    ALL_RATE,
    COPY_S,
    MAX_DONE,
    MAX_SENDERS,
    REPEAT_S,
    SENDER_BURST,
    SENDER_RATE,
    CommandDedup,
    CommandRateLimiter,
)
from phm.wire.command import Command, CommandResult

ASKED = Command(31010, (3.0, 1.0), 0, 255, 190, "radio", False)


def test_a_sender_has_a_burst_and_then_a_rate() -> None:
    """Ten immediately, then two per second."""
    gate = CommandRateLimiter()
    assert sum(gate.allow("radio", 255, 190, False, 0.0) for _ in range(100)) == SENDER_BURST
    assert sum(gate.allow("radio", 255, 190, False, 1.0) for _ in range(100)) == SENDER_RATE


def test_unsigned_commands_cannot_displace_signed_ones() -> None:
    """A flood of forged senders, including our ground station's identity, leaves signed commands their full burst."""
    gate = CommandRateLimiter()
    names = [(255, 190)] * 100 + [(n % 256, n // 256) for n in range(5000)]
    assert sum(gate.allow("radio", *name, False, 0.0) for name in names) == ALL_BURST
    assert sum(gate.allow("radio", 255, 190, True, 0.0) for _ in range(20)) == SENDER_BURST


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 255), st.floats(0, 0.2)), max_size=400))
def test_the_total_rate_is_bounded_for_any_senders(floods: list[tuple[int, int, float]]) -> None:
    """Over any time no more than burst + rate x time is allowed, and memory stays bounded."""
    gate, now, let = CommandRateLimiter(), 0.0, 0
    for system, component, pause in floods:
        now += pause
        let += gate.allow("radio", system, component, False, now)
    assert let <= ALL_BURST + ALL_RATE * now + 1
    assert len(gate._senders) <= MAX_SENDERS


def test_a_repeated_command_has_its_first_result() -> None:
    """A rising confirmation is the same command, also by another link."""
    memory = CommandDedup()
    memory.record(ASKED, b"one", CommandResult.ACCEPTED, 0.0)
    again = replace(ASKED, confirmation=1, link="other")
    assert memory.previous_result(again, b"two", REPEAT_S) is CommandResult.ACCEPTED
    assert memory.previous_result(again, b"two", REPEAT_S + 0.1) is None
    assert memory.previous_result(replace(again, params=(3.0, 2.0)), b"three", 1.0) is None
    assert memory.previous_result(replace(again, system=254), b"four", 1.0) is None
    assert memory.previous_result(replace(again, signed=True), b"five", 1.0) is None


def test_another_number_in_an_unused_parameter_makes_a_new_command() -> None:
    """A lost request that only its repetition replaces is not answered with the result of an equal one before."""
    memory = CommandDedup()
    memory.record(replace(ASKED, rest=(0.0, 0.0, 11.0)), b"one", CommandResult.ACCEPTED, 0.0)
    later = replace(ASKED, confirmation=1, rest=(0.0, 0.0, 12.0))
    assert memory.previous_result(later, b"two", 1.0) is None
    assert memory.previous_result(replace(later, rest=(0.0, 0.0, 11.0)), b"three", 1.0) is CommandResult.ACCEPTED


def test_an_identical_frame_is_a_copy_and_another_one_a_new_command() -> None:
    """With confirmation 0 only a copy by another route is the same."""
    memory = CommandDedup()
    memory.record(ASKED, b"one", CommandResult.FAILED, 0.0)
    assert memory.previous_result(replace(ASKED, link="other"), b"one", COPY_S) is CommandResult.FAILED
    assert memory.previous_result(ASKED, b"one", COPY_S + 0.1) is None
    assert memory.previous_result(ASKED, b"two", 0.1) is None


def test_a_repetition_of_a_lost_command_is_executed() -> None:
    """With a confirmation above 0 a command is new if the earlier ones never arrived."""
    assert CommandDedup().previous_result(replace(ASKED, confirmation=3), b"one", 0.0) is None


def test_memory_is_bounded() -> None:
    """The oldest entry is forgotten."""
    memory = CommandDedup()
    for n in range(1000):
        memory.record(replace(ASKED, params=(3.0, float(n))), b"", CommandResult.ACCEPTED, 0.0)
    assert len(memory._done[False]) == MAX_DONE


def test_unsigned_commands_displace_no_signed_one() -> None:
    """Its acknowledgement was lost; repeated after a flood of others, it is not executed twice."""
    memory, signed = CommandDedup(), replace(ASKED, signed=True)
    memory.record(signed, b"one", CommandResult.ACCEPTED, 0.0)
    for n in range(10 * MAX_DONE):
        memory.record(replace(ASKED, params=(3.0, float(n))), b"", CommandResult.DENIED, 0.0)
    assert memory.previous_result(replace(signed, confirmation=1), b"two", 1.0) is CommandResult.ACCEPTED
