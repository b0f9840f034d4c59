"""The swarm in the ground's state: views and relays of other agents."""

from __future__ import annotations

import pytest

from phm.core.model import Level
from phm.wire import tunnel
from phm.wire.tunnel import PeerState, PeerView, StatusWords, SwarmDigest
from tests.gcs.bench import Ground, events, phm_heartbeat, text_frame, tunnel_frame


@pytest.fixture
def ground() -> Ground:
    return Ground()


def test_views_list_which_agents_receive_an_agent(ground: Ground) -> None:
    """An agent that is lost here and received there has a broken radio; a view of a lost agent no longer counts."""
    ground.receive(*(phm_heartbeat(number) for number in (1, 2, 3)))
    both = PeerView(1, gcs=True, autopilot=True, radio=False, peers={3: PeerState.ALIVE})
    ground.receive(
        tunnel_frame(1, both),
        tunnel_frame(2, PeerView(1, gcs=True, autopilot=True, radio=False, peers={3: PeerState.LOST})),
    )
    ground.wait(20, phm_heartbeat(1), phm_heartbeat(2))
    agent = ground.agent(3)
    assert (agent["received_by"], agent["not_received_by"]) == ([1], [2])
    assert agent["hop"] == {"name": "radio", "evidence": "silent 20 s here, received by A01", "certain": True}
    ground.wait(20, phm_heartbeat(2))
    assert ground.agent(3)["received_by"] == []


def test_an_equal_view_causes_no_event(ground: Ground) -> None:
    """Its number increases; its content is the same."""
    ground.receive(phm_heartbeat(1))
    assert len(ground.receive(tunnel_frame(1, PeerView(1, True, True, False, {2: PeerState.ALIVE})))) == 1
    assert ground.receive(tunnel_frame(1, PeerView(2, True, True, False, {2: PeerState.ALIVE}))) == []
    assert len(ground.receive(tunnel_frame(1, PeerView(3, True, True, False, {2: PeerState.LOST})))) == 1


def test_the_leader_reports_agents_never_received_here(ground: Ground) -> None:
    """They have a row with the leader's report, and nothing else."""
    ground.receive(phm_heartbeat(1), text_frame(1, "SWARM 1/3 FAIL A05:lost", 6))
    ground.receive(tunnel_frame(1, SwarmDigest(3, 2, {1: Level.OK, 4: Level.WARN, 5: Level.ERROR})))
    assert (ground.agent(4)["how"], ground.agent(4)["swarm_says"]) == ("UNKNOWN", "WARN")
    assert ground.agent(5)["swarm_says"] == "ERROR"
    swarm = ground.snapshot()["swarm"]
    assert (swarm["by"], swarm["line"], swarm["members"], swarm["alive"]) == (1, "SWARM 1/3 FAIL A05:lost", 3, 2)


def test_an_agent_without_a_radio_is_reported_by_a_relay(ground: Ground) -> None:
    """Its last line is the relay's report, with the relay's name."""
    ground.receive(phm_heartbeat(1), text_frame(1, "A03 no GCS radio, received by A01 A02: 2 ERROR"))
    agent = ground.agent(3)
    assert (agent["line"]["via"], agent["receives_ground"], agent["how"]) == (1, False, "UNKNOWN")


def test_a_relay_is_over_when_the_swarm_is_ok(ground: Ground) -> None:
    """By a swarm line without the agent, or by the agent's own line; a truncated swarm line proves nothing."""
    for line in (text_frame(1, "SWARM 3/3 OK", 6), text_frame(3, "A03 OK 1 recovered: GCS: no heartbeat 10 s", 5)):
        ground.receive(
            phm_heartbeat(1), phm_heartbeat(3), text_frame(1, "A03 no GCS radio, received by A01 A02: 2 ERROR")
        )
        ground.receive(text_frame(1, "SWARM 1/9 FAIL A04:lost +3", 6), text_frame(1, "SWARM 2/3 WARN A03:no-GCS", 6))
        assert ground.agent(3)["hop"]["name"] == "radio"
        ground.receive(line)
        assert ground.agent(3)["hop"] is None


def test_details_are_joined_from_their_parts(ground: Ground) -> None:
    """In any order, with characters that were split between two parts."""
    ground.receive(phm_heartbeat(7))
    parts = tunnel.details("ab12-17", "Übermaß " * 40)
    assert len(parts) > 2
    news = [one for part in reversed(parts) for one in ground.receive(tunnel_frame(7, part))]
    assert [body["text"] for body in events(news, "detail")] == ["Übermaß " * 40]


def test_status_words_of_other_agents_are_forwarded(ground: Ground) -> None:
    """As events; directly received data has priority over reports of others."""
    ground.receive(phm_heartbeat(7))
    assert events(ground.receive(tunnel_frame(7, StatusWords({7: 0, 8: 0x40025D55}))), "words")[0]["words"] == {
        "8": 0x40025D55
    }
    assert ground.agent(7)["how"] == "OK"
