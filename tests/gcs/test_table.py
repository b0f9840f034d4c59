"""The table shows the state of each agent in 80 columns, and marks what is unknown."""

from __future__ import annotations

import io
from collections.abc import Sequence

import pytest
from rich.console import Console

from phm.core.model import Level, Slot
from phm.gcs import table
from phm.gcs.frames import RadioStatus
from phm.wire import status_word
from phm.wire.tunnel import PeerState, PeerView, SwarmDigest
from tests.gcs.bench import Ground, autopilot, phm_heartbeat, text_frame, tunnel_frame


def drawn(ground: Ground, *, width: int = 80, height: int | None = None, events: Sequence[str] = ()) -> list[str]:
    """The lines of the table on a terminal of this width."""
    stream = io.StringIO()
    target = Console(file=stream, width=width, highlight=False, markup=False, emoji=False)
    snapshot = {**ground.snapshot(), "system": 254, "component": 190, "problems": [], "frames_refused": 0}
    target.print(table.render(snapshot, events, width=width, height=height))
    return [line.rstrip() for line in stream.getvalue().splitlines()]


def row(lines: list[str], name: str) -> str:
    return next(line for line in lines if line.startswith(f"{name} "))


@pytest.fixture
def ground() -> Ground:
    """Agent 1 is OK, 2 has a dead node, 3 is lost here and received by 1, 4 is only reported, 7 lost its companion, 100 is new."""
    made = Ground()
    made.receive(*(phm_heartbeat(number) for number in (1, 3, 7)), autopilot(1, armed=True), autopilot(2), autopilot(7))
    made.receive(text_frame(7, "A07 OK 11111111", 6))
    view = PeerView(1, gcs=True, autopilot=True, radio=False, peers={3: PeerState.ALIVE})
    bad = phm_heartbeat(2, {Slot.NODES: Level.ERROR, Slot.HOST: Level.WARN, Slot.FILES: Level.STALE})
    made.wait(30, phm_heartbeat(1), bad, tunnel_frame(1, view), autopilot(1, armed=True), autopilot(2), autopilot(7))
    made.receive(
        text_frame(2, "A02 FAIL 6 node_1 dead"), phm_heartbeat(100, {Slot.AUTOPILOT: Level.OK, Slot.USER_1: Level.OK})
    )
    made.receive(
        text_frame(1, "SWARM 1/5 FAIL A07:lost A02:ROS", 6), tunnel_frame(1, SwarmDigest(5, 3, {4: Level.WARN}))
    )
    return made


def test_each_agent_has_its_row(ground: Ground) -> None:
    """Slots, level, age, autopilot, hop and line; unknown values are question marks."""
    lines = drawn(ground)
    assert lines[0] == "phm gcs 254/190  6 agents: 1 ERROR, 2 LOST, 1 UNKNOWN, 2 OK"
    assert lines[1].startswith("agent 12345678 9012 345 is      age  fc   broken at")
    assert row(lines, "A01") == "A01   ++++++++ +--- --- OK      0s   ARM"
    assert row(lines, "A02").startswith("A02   ++-++E++ W--- --- ERROR   0s   dis  application?: … FAIL 6 node_1 dead")
    assert row(lines, "A03").startswith("A03   ???????? ???? ??? LOST    30s  ?    radio: sil")
    assert row(lines, "A04").startswith("A04   ???????? ???? ??? UNKNOWN ?    ?")
    assert row(lines, "A04").endswith("by swarm: WARN")
    assert row(lines, "A07").startswith("A07   ???????? ???? ??? LOST    30s  dis  companion")
    assert row(lines, "A100").startswith("A100  ++++++++ ++-- +-- OK      0s   ?")
    assert "SWARM 1/5 FAIL A07:lost A02:ROS  (A01, 0 s ago)" in lines
    assert "links: gcs open; other ground stations: none" in lines
    ground.receive(RadioStatus(51, 68, 190, 180, 60, None, 99))
    assert "radio of gcs: signal/noise 190/60, other end 180/?, 0 s ago" in drawn(ground)


def test_a_wide_terminal_shows_the_names_of_the_slots(ground: Ground) -> None:
    """Each letter is below the name of its slot; narrower, the numbers."""
    lines = drawn(ground, width=120)
    assert lines[1].startswith("agent GCS CON FIL NET DEV NOD TOP RAT HST AUT RAD PEE US1 US2 US3 is")
    head, failed = lines[1], row(lines, "A02")
    assert failed[head.index("NOD") + 1] == "E"
    assert failed[head.index("HST") + 1] == "W"
    assert failed[head.index("FIL") + 1] == "-"
    assert failed[head.index(" is ") + 1 :].startswith("ERROR")
    assert "NOD" not in drawn(ground, width=119)[1]


def test_a_lost_agent_does_not_show_its_last_line_as_current(ground: Ground) -> None:
    """Its age comes first."""
    assert "30 s ago: OK 11111111" in row(drawn(ground, width=200), "A07")


def test_an_agent_whose_autopilot_is_lost_is_not_ok() -> None:
    """The ground has received the autopilot and no longer does, whatever the agent reports; one never received says nothing."""
    ground = Ground()
    ground.receive(phm_heartbeat(1), autopilot(1), phm_heartbeat(2))
    ground.wait(20, phm_heartbeat(1), phm_heartbeat(2))
    assert [(one["name"], one["how"]) for one in ground.snapshot()["agents"]] == [("A01", "ERROR"), ("A02", "OK")]
    assert ground.agent(1)["hop"] == {"name": "autopilot", "evidence": "silent 20 s here", "certain": False}
    ground.receive(autopilot(1))
    assert ground.agent(1)["how"] == "OK"


def test_the_selected_agent_and_alarms_are_marked(ground: Ground) -> None:
    """Where not all agents fit, the selected one is among those shown."""
    snapshot = {**ground.snapshot(), "system": 254, "component": 190, "problems": [], "frames_refused": 0}
    target = Console(file=io.StringIO(), width=80, height=12)
    target.print(table.render(snapshot, height=12, selected="A01", alarms=["A02"], dialog=["what the keys do"]))
    lines = target.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert any(line.startswith("A01 ") for line in lines)
    assert any(line.startswith("A02! ") for line in lines)
    assert any(line.startswith("what the keys do") for line in lines)


@pytest.mark.parametrize("width", [40, 60, 80, 200])
def test_the_table_is_never_wider_than_the_terminal(ground: Ground, width: int) -> None:
    """One row per agent, whatever names and texts there are."""
    ground.receive(text_frame(2, "A02 FAIL 6 " + "n" * 38))
    lines = drawn(ground, width=width, events=["x" * 300])
    assert max(map(len, lines)) <= width
    if width >= 80:
        assert sum(line.startswith("A") for line in lines) == 6


def test_a_short_terminal_shows_agents_with_problems() -> None:
    """In their order, and the number of the others; the output is never higher than the terminal."""
    ground = Ground()
    bad = {5: Slot.FILES, 77: Slot.NODES}
    ground.receive(
        *(phm_heartbeat(number, {bad[number]: Level.ERROR} if number in bad else None) for number in range(1, 101))
    )
    lines = drawn(ground, height=24, events=[f"news {number}" for number in range(20)])
    assert len(lines) <= 24
    assert row(lines, "A05")
    assert lines.index(row(lines, "A05")) < lines.index(row(lines, "A77"))
    left = next(line for line in lines if line.startswith("and "))
    shown = sum(line.startswith("A") for line in lines)
    assert left == f"and {100 - shown} more: {100 - shown} OK"
    assert lines[-1] == "news 19"


def test_the_table_says_that_no_agent_was_received_yet() -> None:
    """An empty table must not look like a healthy swarm."""
    ground = Ground()
    ground.store.links({}, ground.clock.stamp())
    lines = drawn(ground)
    assert lines[0] == "phm gcs 254/190  no agent received yet"
    assert "links: opening; other ground stations: none" in lines


def test_received_names_cannot_control_the_terminal(ground: Ground) -> None:
    """Even if a text bypassed the parser."""
    ground.receive(text_frame(2, "A02 FAIL 6 \x1b[2J\u202enode"))
    assert not any("\x1b" in line or "\u202e" in line for line in drawn(ground, width=200))


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(None, "?"), (0.0, "0s"), (59.9, "59s"), (60, "1m"), (3599, "59m"), (3600, "1h"), (86399, "23h"), (2e6, "23d")],
)
def test_ages_are_short(seconds: float | None, shown: str) -> None:
    """Four characters at most, for years."""
    assert table.age(seconds) == shown


@pytest.mark.parametrize(
    ("seconds", "shown"), [(None, ""), (3.0, "3 s ago"), (200.0, "3 min ago"), (7300.0, "2 h ago"), (2e5, "2 d ago")]
)
def test_ages_in_a_sentence_have_their_unit(seconds: float | None, shown: str) -> None:
    """`3 min ago`, since `3m` may be metres."""
    assert table.ago(seconds) == shown


def test_letters_are_those_of_the_status_word() -> None:
    """Each level of each slot is shown in its own place and nowhere else."""
    for level, letter in ((Level.OK, "+"), (Level.WARN, "W"), (Level.ERROR, "E")):
        for slot in Slot:
            levels = {
                str(int(one)): found.name
                for one, found in status_word.decode(status_word.encode({slot: level})).items()
            }
            shown = table.cells({"presence": "alive", "slots": levels}).plain
            assert shown.replace(" ", "").index(letter) == slot - 1
            assert shown.count("-") == 14
            assert len(shown) == len(table.HEADER)
