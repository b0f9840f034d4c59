"""The contract of commands: what each number means, and who may do what."""

from __future__ import annotations

import itertools
import math
import struct
import zlib

import pytest
from hypothesis import given, strategies as st

from phm.commands.authorization import Accept, Deny, Ignore, authorize, is_addressed_to
from phm.wire.command import (
    ApproveAction,
    Command,
    CommandResult,
    HoldContainerAt,
    InvalidParameters,
    Permission,
    ReleaseContainerAt,
    RepeatMessage,
    Request,
    RestartContainer,
    RunChecks,
    SendContainers,
    SendDetails,
    SendMessage,
    UnknownCommand,
    container_hash,
    fault_number,
    parse,
    required_permission,
)

NAN, INF = math.nan, math.inf
WORDS = frozenset(each.value for each in Permission)
FLOATS = st.integers(0, 2**32 - 1).map(lambda bits: struct.unpack("<f", struct.pack("<I", bits))[0])
"""Every value that a parameter can have on the wire."""

KNOWN: list[tuple[int, float, float, Request, Permission]] = [
    (512, 0, 0, SendMessage(0), Permission.STATUS),
    (512, 253, 0, SendMessage(253), Permission.STATUS),
    (512, 390, NAN, SendMessage(390), Permission.STATUS),
    (512, 385, 0, SendDetails(0), Permission.DETAILS),
    (512, 385, NAN, SendDetails(0), Permission.DETAILS),
    (512, 385, 17, SendDetails(17), Permission.DETAILS),
    (512, 385, -1, SendContainers(), Permission.DETAILS),
    (511, 253, 2e6, RepeatMessage(253, 2.0), Permission.STATUS),
    (511, 390, 5e6, RepeatMessage(390, 5.0), Permission.STATUS),
    (511, 390, -1, RepeatMessage(390, 0.0), Permission.STATUS),
    (512, 251, 0, SendMessage(251), Permission.STATUS),
    (511, 251, 5e6, RepeatMessage(251, 5.0), Permission.STATUS),
    (511, 251, 0, RepeatMessage(251, 0.0), Permission.STATUS),
    (511, 253, 0, RepeatMessage(253, 0.0), Permission.STATUS),
    (511, 385, 1e7, RepeatMessage(385, 10.0), Permission.DETAILS),
    (31010, 1, 0, RunChecks(), Permission.CHECK),
    (31010, 1, NAN, RunChecks(), Permission.CHECK),
    (31010, 2, 17, ApproveAction(17), Permission.APPROVE),
    (31010, 3, 1, RestartContainer(1), Permission.RESTART),
    (31010, 4, 1, HoldContainerAt(1), Permission.HOLD),
    (31010, 5, 2, ReleaseContainerAt(2), Permission.HOLD),
]
WRONG = [
    (512, NAN, 0),
    (512, INF, 0),
    (512, -1, 0),
    (512, 0.5, 0),
    (512, 2**25, 0),
    (512, 385, -2),
    (512, 385, 1.5),
    (512, 385, INF),
    (511, 253, 1.9e6),
    (511, 390, 4.9e6),
    (511, 251, 4.9e6),
    (511, 390, NAN),
    (511, 390, INF),
    (511, 390, -2),
    (511, 385, 9e6),
    (511, 390, 3601e6),
    (31010, NAN, 1),
    (31010, 2, 0),
    (31010, 2, NAN),
    (31010, 2, -17),
    (31010, 2, 1.5),
    (31010, 3, 0),
    (31010, 3, INF),
]
UNKNOWN = [
    (400, 1, 0),
    (0, 0, 0),
    (65535, 0, 0),
    (512, 1, 0),
    (512, 148, 0),
    (511, 0, 1e6),
    (511, 148, 1e7),
    (31010, 0, 0),
    (31010, 6, 1),
    (31011, 1, 0),
    (246, 1, 0),
]


@pytest.mark.parametrize(("command", "first", "second", "wanted", "needed"), KNOWN)
def test_each_command_has_one_meaning(
    command: int, first: float, second: float, wanted: Request, needed: Permission
) -> None:
    """The table of the contract, and the permission that each command needs."""
    assert parse(command, (first, second)) == wanted
    assert required_permission(wanted) is needed


@pytest.mark.parametrize(("third", "wanted"), [(0, 0), (NAN, 0), (17, 17), (2**24, 2**24)])
def test_a_restart_may_have_the_hash_of_the_name(third: float, wanted: int) -> None:
    """In param3; 0 and NaN are what other ground stations send there."""
    assert parse(31010, (3, 2), third) == RestartContainer(2, wanted)


@pytest.mark.parametrize("third", [-1, 0.5, 2**25, INF])
def test_a_wrong_hash_is_not_ignored(third: float) -> None:
    """It could mean another container."""
    with pytest.raises(InvalidParameters, match="param3 must be"):
        parse(31010, (3, 2), third)
    assert parse(31010, (1, 0), third) == RunChecks()


@given(st.text(max_size=300))
def test_the_hash_of_a_name_survives_a_float(name: str) -> None:
    """It is never 0, which means that none is given."""
    number = container_hash(name)
    assert 0 < number == struct.unpack("<f", struct.pack("<f", number))[0]


def test_the_hash_of_a_name_is_part_of_the_contract() -> None:
    """Other ground stations compute it: 1 + CRC-32 of the name modulo 2^24 - 1."""
    assert container_hash("ros_app") == zlib.crc32(b"ros_app") % (2**24 - 1) + 1


@pytest.mark.parametrize("given_", WRONG)
def test_parameters_outside_of_the_contract_are_wrong(given_: tuple[int, float, float]) -> None:
    """Nothing is rounded or guessed."""
    with pytest.raises(InvalidParameters, match=r"param[12] must be"):
        parse(given_[0], given_[1:])


@pytest.mark.parametrize("given_", UNKNOWN)
def test_commands_that_the_contract_does_not_name_are_unknown(given_: tuple[int, float, float]) -> None:
    """Especially those of the autopilot: arming (400) and rebooting (246)."""
    with pytest.raises(UnknownCommand):
        parse(given_[0], given_[1:])


@given(st.one_of(st.integers(0, 65535), st.sampled_from([511, 512, 31010])), FLOATS, FLOATS)
def test_any_numbers_are_accepted_or_rejected(command: int, first: float, second: float) -> None:
    """No bit pattern raises anything, and every accepted command is within the contract."""
    try:
        wanted = parse(command, (first, second))
    except (UnknownCommand, InvalidParameters):
        return
    if isinstance(wanted, RepeatMessage):
        assert wanted.every_s == 0 or 2.0 <= wanted.every_s <= 3600.0
    if isinstance(wanted, (ApproveAction, RestartContainer)):
        assert second == (wanted.fault if isinstance(wanted, ApproveAction) else wanted.place) >= 1


@pytest.mark.parametrize(("fourth", "wanted"), [(0, None), (NAN, None), (600, 600)])
def test_a_hold_has_a_length_or_the_configured_one(fourth: float, wanted: float | None) -> None:
    """And the hash of the container's name, as a restart."""
    assert parse(31010, (4, 2), 17.0, fourth) == HoldContainerAt(2, 17, wanted)


@pytest.mark.parametrize("fourth", [-1, 0.5, INF, 2**25])
def test_a_hold_of_another_length_is_refused(fourth: float) -> None:
    """It is not rounded."""
    with pytest.raises(InvalidParameters, match="param4"):
        parse(31010, (4, 2), 0.0, fourth)


@pytest.mark.parametrize(
    ("name", "expected"), [("ab12-17", 17), ("ab-1-3", 3), ("F1", None), ("ab-", None), ("ab-1x", None), ("-", None)]
)
def test_the_number_of_a_fault_is_the_part_behind_its_dash(name: str, expected: int | None) -> None:
    """An id of another form has no number."""
    assert fault_number(name) == expected


def asked(command: int, first: float, second: float, *, signed: bool = False, broadcast: bool = False) -> Command:
    return Command(command, (first, second), 0, 255, 190, "radio", signed, broadcast)


def test_a_command_is_accepted_with_permission_and_required_signature() -> None:
    """Every known command x every set of permissions x signed or not x signing on or off x to all or to us."""
    done = 0
    sets = [frozenset(chosen) for size in range(7) for chosen in itertools.combinations(sorted(WORDS), size)]
    for (command, first, second, wanted, needed), allowed, signed, signing, broadcast in itertools.product(
        KNOWN, sets, (False, True), (False, True), (False, True)
    ):
        authorization = authorize(
            asked(command, first, second, signed=signed, broadcast=broadcast), allowed, signing=signing
        )
        acts = needed not in (Permission.STATUS, Permission.DETAILS)
        if broadcast and acts:
            assert isinstance(authorization, Ignore)
        elif (signing and not signed) or needed.value not in allowed:
            assert isinstance(authorization, Deny)
            assert authorization.result is CommandResult.DENIED
        else:
            assert authorization == Accept(wanted)
            done += 1
    assert done == 3 * 32 * (len(KNOWN) + sum(1 for row in KNOWN if row[4] in (Permission.STATUS, Permission.DETAILS)))


@pytest.mark.parametrize("given_", UNKNOWN)
def test_unknown_commands_are_answered_only_if_addressed_to_us(
    given_: tuple[int, float, float],
) -> None:
    """For a broadcast the acknowledgement is the task of another component."""
    authorization = authorize(asked(*given_), WORDS, signing=False)
    assert isinstance(authorization, Deny)
    assert authorization.result is CommandResult.UNSUPPORTED
    assert authorize(asked(*given_, broadcast=True), WORDS, signing=False) == Ignore()


@pytest.mark.parametrize("given_", WRONG)
def test_wrong_parameters_are_denied(given_: tuple[int, float, float]) -> None:
    """With the reason for the log."""
    authorization = authorize(asked(*given_), WORDS, signing=False)
    assert isinstance(authorization, Deny)
    assert authorization.result is CommandResult.DENIED
    assert "param" in authorization.why


def test_only_our_system_and_our_component_or_all_components_are_addressed() -> None:
    """Every pair of ids, against system 7 component 193."""
    found = {(s, c) for s in range(256) for c in range(256) if is_addressed_to(s, c, 7, 193)}
    assert found == {(7, 193), (7, 0)}
