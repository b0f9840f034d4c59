"""The payload of a status: the contract of docs/reference/fleet.md, and what a reader rejects."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, strategies as st

from phm.core.model import Evidence, Level, Slot, UnitState
from phm.wire import fleet_status, status_word
from tests.fakes.records import at, fault, unit

HEALTHY = unit("container/ros_app", Slot.CONTAINER)
DEAD = unit("nodes/a/one", Slot.NODES, Level.ERROR, brief="one dead", condition="gone", fault="ab12-1")


def made(*states: UnitState, faults: tuple[Any, ...] = ()) -> bytes:
    return fleet_status.encode(("agent_3", 3), "0123456789ab", 7, at(), states, faults, "EMERGENCY")


def test_the_payload_has_the_contract_keys() -> None:
    """Exactly these keys, in this form."""
    assert json.loads(made(HEALTHY, DEAD, faults=(fault(DEAD),))) == {
        "v": 1,
        "agent": "agent_3",
        "agent_id": 3,
        "boot_id": "0123456789ab",
        "seq": 7,
        "utc": "2026-03-01T12:00:00.123Z",
        "utc_s": 1772366400.123,
        "mono": 100.0,
        "state": "EMERGENCY",
        "status_word": status_word.encode({Slot.CONTAINER: Level.OK, Slot.NODES: Level.ERROR}),
        "slots": {"2": "OK", "6": "ERROR"},
        "line": "A03 FAIL -1---0-- 6 one dead",
        "broken_hop": None,
        "open_faults": 1,
        "faults": [
            {
                "fault": "ab12-1",
                "unit": "nodes/a/one",
                "slot": 6,
                "condition": "gone",
                "brief": "one dead",
                "opened": "2026-03-01T12:00:00.123Z",
            }
        ],
    }


def test_a_status_is_read_as_written() -> None:
    """Levels by slot, word, sequence number and times are read back."""
    status = fleet_status.decode(made(HEALTHY, DEAD, faults=(fault(DEAD),)))
    assert (status.agent, status.agent_id, status.boot_id, status.sequence) == ("agent_3", 3, "0123456789ab", 7)
    assert status.levels == status_word.decode(status.word) == {Slot.CONTAINER: Level.OK, Slot.NODES: Level.ERROR}
    assert (status.utc_s, status.mono_s, status.state) == (1772366400.123, 100.0, "EMERGENCY")
    assert (status.open_faults, status.faults[0]["fault"]) == (1, "ab12-1")


def path(level: Level, blocked_by: str = "", broken: str = "") -> UnitState:
    evidence = Evidence(broken_hop=broken)
    return unit("path", Slot.AUTOPILOT, level, evidence=evidence, blocked_by=blocked_by)


@pytest.mark.parametrize(
    ("states", "hop"),
    [
        ((HEALTHY,), None),
        ((path(Level.OK),), ""),
        ((path(Level.STALE, "radio/ground", "radio"),), "radio"),
        ((path(Level.STALE, "gcs"),), "gcs"),
        ((path(Level.STALE),), None),
    ],
)
def test_the_payload_names_the_first_broken_hop(states: tuple[UnitState, ...], hop: str | None) -> None:
    """As the path check reports it: the first broken hop, what blocks it, none, or unknown."""
    assert fleet_status.decode(made(*states)).broken == hop


def test_the_longest_status_is_accepted_by_a_reader() -> None:
    """Names of any length and script, and more faults than are listed, stay below the reader's limit."""
    long = unit("\U0001f600" * 5000, Slot.NODES, Level.ERROR, brief="\U0001f600" * 999, condition="\U0001f600" * 999)
    faults = tuple(replace(fault(long), id=f"ab12-{number}") for number in range(300))
    payload = made(path(Level.STALE, "\U0001f600" * 999), long, faults=faults)
    status = fleet_status.decode(payload)
    assert (status.open_faults, len(status.faults)) == (300, fleet_status.MAX_FAULTS)
    assert len(payload) <= fleet_status.MAX_BYTES


GOOD = json.loads(made(HEALTHY, DEAD, faults=(fault(DEAD),)))


@pytest.mark.parametrize(
    "change",
    [
        {"v": 2},
        {"agent": 5},
        {"agent": "a" * 201},
        {"agent_id": True},
        {"agent_id": -1},
        {"seq": 1.5},
        {"mono": "1"},
        {"mono": float("nan")},
        {"utc_s": 10**400},
        {"slots": []},
        {"slots": {"16": "OK"}},
        {"slots": {"2": "HEALTHY"}},
        {"slots": {"2": None}},
        {"faults": {}},
        {"broken_hop": 1},
        {"line": None},
        {"status_word": None},
    ],
)
def test_a_payload_that_violates_the_contract_is_rejected(change: dict[str, Any]) -> None:
    """Each key is validated, since it comes from outside."""
    with pytest.raises(ValueError, match="status"):
        fleet_status.decode(json.dumps({**GOOD, **change}).encode())


@given(
    st.one_of(
        st.binary(max_size=200), st.text(max_size=50).map(str.encode), st.just(b"[" * 50_000), st.just(b" " * 70_000)
    )
)
def test_garbage_is_rejected(payload: bytes) -> None:
    """Any bytes raise ValueError and nothing else."""
    with pytest.raises(ValueError):
        fleet_status.decode(payload)


def test_additional_keys_are_accepted() -> None:
    """A reader of this version accepts a status with more keys."""
    assert fleet_status.decode(json.dumps({**GOOD, "more": 1}).encode()).agent == "agent_3"
