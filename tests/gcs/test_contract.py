"""The keys of the JSON lines are a contract: `docs/reference/gcs.md` names each of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import phm
from phm.core.model import Level, Slot
from phm.gcs.events import describe_with_time, encode
from phm.gcs.frames import CommandAck
from phm.wire import tunnel
from phm.wire.tunnel import PeerState, PeerView, StatusWords, SwarmDigest
from tests.gcs.bench import Ground, autopilot, phm_heartbeat, text_frame, tunnel_frame

PAGE = (Path(phm.__file__).parents[1] / "docs" / "reference" / "gcs.md").read_text()


def flight() -> Ground:
    """A flight with every kind of event."""
    ground = Ground(expected=(7,))
    ground.store.links({"gcs": (False, "refused")}, ground.clock.stamp())
    ground.news += ground.store.links({"gcs": (True, "")}, ground.clock.stamp())
    ground.wait(20)
    ground.receive(
        phm_heartbeat(7),
        phm_heartbeat(8),
        autopilot(7, armed=True),
        text_frame(7, "A07 FAIL 6 node_1 dead"),
        text_frame(7, "hello", component=1),
    )
    ground.receive(
        text_frame(7, "SWARM 1/2 FAIL A08:lost", 6), tunnel_frame(7, SwarmDigest(2, 1, {7: Level.OK, 8: Level.ERROR}))
    )
    ground.receive(
        tunnel_frame(7, PeerView(1, True, True, False, {8: PeerState.LOST})),
        tunnel_frame(7, StatusWords({8: 0x40025D55})),
    )
    ground.receive(tunnel_frame(7, tunnel.details("ab12-1", "node_1 is dead")[0]))
    ground.receive(text_frame(7, "A07 ADVISE 6 restart app #1 60s", 4), CommandAck(7, 193, 31010, 0, (254, 190)))
    ground.receive(phm_heartbeat(7, {Slot.NODES: Level.ERROR}), phm_heartbeat(7, {}, state=1))
    ground.wait(30, phm_heartbeat(7))
    return ground


def keys(value: Any) -> set[str]:
    """Keys at any depth, except the numbers of slots or agents."""
    if isinstance(value, dict):
        own = {key for key in value if not key.isdigit()}
        return own.union(*(keys(entry) for entry in value.values()))
    return set().union(*(keys(entry) for entry in value)) if isinstance(value, list) else set()


def test_every_event_and_key_is_documented() -> None:
    """And every documented event occurs here, except those of the program itself."""
    ground = flight()
    lines = [json.loads(encode(news, "run", number)) for number, news in enumerate(ground.news, 1)]
    events = {line["event"] for line in lines}
    expected = {
        "link",
        "agent",
        "slots",
        "presence",
        "restart",
        "text",
        "hop",
        "view",
        "digest",
        "words",
        "ack",
        "detail",
        "autopilot",
    }
    assert events == expected
    found = keys(lines) | keys(ground.snapshot()) | events
    assert sorted(key for key in found if f"`{key}`" not in PAGE) == []


def test_all_events_have_a_text() -> None:
    """Except those for programs only: views, status words of other agents, and repetitions."""
    silent = {news.event for news in flight().news if not describe_with_time(news)}
    assert silent == {"view", "words"}


def test_numbers_are_json() -> None:
    """Every line is one line of ASCII that any parser accepts."""
    for news in flight().news:
        line = encode(news, "run", 1)
        assert b"\n" not in line
        assert line.isascii()
        assert b"NaN" not in line
