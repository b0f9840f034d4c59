"""Lines of PHM are parsed into their parts, and lines of other programs are not."""

from __future__ import annotations

import pytest

from phm.core.model import Level, Slot
from phm.gcs import statustext_parser
from phm.gcs.statustext_parser import LineKind, ParsedLine
from phm.swarm import digest
from phm.wire import status_line
from tests.fakes.records import unit


def read(text: str) -> ParsedLine:
    found = statustext_parser.parse(text)
    assert found is not None, text
    return found


def test_a_state_change_has_agent_level_slot_and_text() -> None:
    """As `bad`, `gave_up` and `advise` write them, also of agents with three digits."""
    found = read(status_line.failing(7, Level.ERROR, Slot.NODES, "node_1 dead"))
    assert (found.kind, found.agent, found.word, found.slot, found.text) == (
        LineKind.CHANGE,
        7,
        "FAIL",
        6,
        "node_1 dead",
    )
    assert found.level is Level.ERROR
    assert read(status_line.failing(250, Level.WARN, Slot.USER_3, "battery low")).level is Level.WARN
    assert read(status_line.gave_up(7, Slot.CONTAINER, "ros_app", "ros_app exited")).level is Level.ERROR
    advised = read(status_line.advise(7, Slot.CONTAINER, "restart", "ros_app"))
    assert (advised.level, advised.text) == (None, "restart ros_app")
    assert read(status_line.approved(7, Slot.CONTAINER, "restart", "ros_app")).word == "APPROVED"
    assert read(status_line.expired(7, Slot.CONTAINER, "restart", "ros_app")).word == "EXPIRED"


@pytest.mark.parametrize("by", ["", "itself", "restart", "a-long-action"])
def test_a_recovery_line_has_the_recovered_brief(by: str) -> None:
    """For any way of recovery; if the line was truncated, the truncated name is recognized."""
    for brief in ("node_1 dead", "x" * 20 + "y" * 18):
        line = read(status_line.recovered(250, Slot.USER_1, brief, by))
        assert line.recovered
        assert line.resolves(brief)
        assert not line.resolves("node_2 dead")


@pytest.mark.parametrize("by", ["itself", "restart", "free_disk", "a-long-action"])
def test_a_recovery_names_the_unit_that_failed(by: str) -> None:
    """By its name, even if the line about the failure was truncated; a unit with a longer name is another one."""
    line = read(status_line.recovered(250, Slot.NODES, "node_1 dead", by, "node_1"))
    assert line.recovered == "node_1"
    assert line.resolves("node_1 dead")
    assert line.resolves("node..d")
    assert not line.resolves("node_10 dead")
    assert not line.resolves("node_2 dead")


def test_the_result_of_an_operators_request_resolves_no_failure() -> None:
    """`done` says that the action ran, not that the container is OK."""
    line = read(status_line.operator_request(7, Slot.CONTAINER, "restart", "done", "ros_app"))
    assert not line.recovered
    assert not line.resolves("ros_app exited")


def test_a_refresh_has_the_number_of_bad_units() -> None:
    """Only one with a single bad unit names it; digits at the end of a name are not a count."""
    bad = [unit("a", Slot.NODES, Level.ERROR, brief="node +1x"), unit("b", Slot.NODES, Level.WARN, brief="slow")]
    assert read(status_line.refresh(1, [unit("a", Slot.NODES)])).kind is LineKind.REFRESH
    one = read(status_line.refresh(1, bad[:1]))
    assert (one.word, one.slot, one.text, one.alone) == ("FAIL", 6, "node +1x", True)
    assert not read(status_line.refresh(1, bad)).alone
    assert read(status_line.refresh(1, [unit("a", Slot.NODES, Level.STALE)])).word == "STALE"


def test_lines_of_the_leader_are_parsed() -> None:
    """The swarm's line, and the line about an agent whose radio failed."""
    swarm = read(digest.digest_line({1: (Level.OK, ""), 3: (Level.ERROR, "ROS")}))
    assert (swarm.kind, swarm.agent, swarm.word, swarm.text) == (LineKind.SWARM, 0, "FAIL", "A03:ROS")
    relay = read(digest.relay_line(3, [1, 2], 0x40025D55))
    assert (relay.kind, relay.agent) == (LineKind.RELAY, 3)
    assert read("A03 no GCS radio: flapping").kind is LineKind.RELAY


def test_a_swarm_line_names_agents_that_are_not_ok() -> None:
    """Unless it had no room for all of them."""
    many = dict.fromkeys(range(1, 20), (Level.ERROR, "lost"))
    assert statustext_parser.unhealthy_agents(read(digest.digest_line(many))) is None
    assert statustext_parser.unhealthy_agents(
        read(digest.digest_line({1: (Level.OK, ""), 103: (Level.WARN, "no-GCS"), 4: (Level.ERROR, "lost")}))
    ) == {
        4,
        103,
    }
    assert statustext_parser.unhealthy_agents(read(digest.digest_line({1: (Level.OK, "")}))) == frozenset()
    assert statustext_parser.unhealthy_agents(read("SWARM 90/100 FAIL +7")) is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "PreArm: GPS 1 failing",
        "A07",
        "A07 FAIL",
        "A07 FAIL 16 x",
        "A07 FAIL 0 x",
        "A07 FAIL 11111111 0 x",
        "A07 FAIL 11111111 00",
        "A07 OK 1111",
        "A7 OK 11111111",
        "A000 OK 11111111",
        "A251 FAIL 6 x",
        "A999 WARN 1 x",
        "SWARM of bees",
        "SWARM 1/2 BAD",
        "xA07 FAIL 6 node",
        "A07 FAIL 6 node\nA08 FAIL 6 node",
        "A\u0660\u0667 FAIL 6 x",
    ],
)
def test_lines_of_other_programs_are_not_parsed(text: str) -> None:
    """Nor similar lines with numbers that no agent and no slot has."""
    assert statustext_parser.parse(text) is None
