"""The first broken hop between an agent and the ground."""

from __future__ import annotations

import pytest

from phm.core.model import Level, Slot
from phm.gcs.frames import POWEROFF, RadioStatus
from phm.wire.tunnel import PeerView
from tests.gcs.bench import Ground, autopilot, events, phm_heartbeat, text_frame, tunnel_frame


@pytest.fixture
def ground() -> Ground:
    return Ground()


@pytest.mark.parametrize(
    ("slots", "text", "hop"),
    [
        ({}, "", None),
        ({Slot.RADIO: Level.ERROR}, "A07 FAIL 11 radio: no RADIO_STATUS 6 s", ("radio", "no RADIO_STATUS 6 s", True)),
        ({Slot.COMPANION: Level.ERROR}, "A07 FAIL 1 port fc: no permission", ("port fc", "no permission", True)),
        ({Slot.COMPANION: Level.ERROR}, "A07 FAIL 1 GCS: no heartbeat 10 s", ("GCS", "no heartbeat 10 s", True)),
        ({Slot.COMPANION: Level.ERROR}, "A07 FAIL 1 rates overdue", ("companion", "rates overdue", False)),
        ({Slot.NODES: Level.ERROR}, "A07 FAIL 6 node_1 dead", ("application", "node_1 dead", False)),
        (
            {Slot.AUTOPILOT: Level.ERROR},
            "A07 FAIL 10 autopilot: no heartbeat 4 s",
            ("autopilot", "no heartbeat 4 s", True),
        ),
        ({Slot.AUTOPILOT: Level.ERROR}, "", ("autopilot", "ERROR in slot 10, cause not received", True)),
        ({Slot.RADIO: Level.WARN}, "A07 WARN 11 radio: weak, margin 8", None),
        ({Slot.FILES: Level.ERROR}, "A07 FAIL 3 map.bin missing", None),
    ],
)
def test_the_hop_is_the_first_that_the_agent_names(
    ground: Ground, slots: dict[Slot, Level], text: str, hop: tuple[str, str, bool] | None
) -> None:
    """From its lines, or from its status word while no line has a reason; a possible hop is marked as uncertain."""
    ground.receive(phm_heartbeat(7, slots))
    if text:
        ground.receive(text_frame(7, text))
    found = ground.agent(7)["hop"]
    assert (found and (found["name"], found["evidence"], found["certain"])) == hop


def test_the_hop_closest_to_the_ground_wins(ground: Ground) -> None:
    """Units behind a broken hop may be bad because of it."""
    ground.receive(phm_heartbeat(7, {Slot.RADIO: Level.ERROR, Slot.AUTOPILOT: Level.ERROR, Slot.NODES: Level.ERROR}))
    assert ground.agent(7)["hop"]["name"] == "radio"


def test_a_silent_agent_is_explained_by_other_received_frames(ground: Ground) -> None:
    """Of its autopilot, of other agents, or none: the companion, the radio, or the ground's own link."""
    ground.receive(phm_heartbeat(7), phm_heartbeat(8), autopilot(7))
    ground.wait(20, autopilot(7), phm_heartbeat(8), every=1)
    assert ground.agent(7)["hop"]["name"] == "companion"
    ground.wait(20, phm_heartbeat(8), every=1)
    assert ground.agent(7)["hop"] == {"name": "radio or vehicle", "evidence": "silent 40 s", "certain": False}
    ground.wait(20)
    assert ground.agent(7)["hop"] == {"name": "ground link", "evidence": "all agents are silent", "certain": False}
    ground.receive(RadioStatus(51, 68, 190, 180, 60, None, 99))
    assert ground.agent(7)["hop"]["name"] == "radio"
    assert ground.snapshot()["radios"] == [
        {"link": "gcs", "age_s": 0.0, "rssi": 190, "remrssi": 180, "noise": 60, "remnoise": None, "txbuf": 99}
    ]
    ground.store.links({"gcs": (False, "Connection refused")}, ground.clock.stamp())
    assert ground.agent(7)["hop"] == {"name": "ground link", "evidence": "gcs: Connection refused", "certain": True}


def test_an_agent_that_has_left_says_nothing_about_the_ground_link(ground: Ground) -> None:
    """It is silent on purpose; the others, all silent after it, still point to the ground's own link."""
    ground.receive(phm_heartbeat(7), phm_heartbeat(8), phm_heartbeat(9))
    ground.receive(phm_heartbeat(9, state=POWEROFF))
    ground.wait(20)
    assert ground.agent(7)["hop"] == {"name": "ground link", "evidence": "all agents are silent", "certain": False}


def test_one_silent_agent_is_not_all(ground: Ground) -> None:
    """Where the only other one has left, the silence may be the agent's own."""
    ground.receive(phm_heartbeat(7), phm_heartbeat(9))
    ground.receive(phm_heartbeat(9, state=POWEROFF))
    ground.wait(20)
    assert ground.agent(7)["hop"]["name"] == "radio or vehicle"


def test_an_agent_that_was_never_received_gets_time() -> None:
    """For five heartbeats an expected agent has no hop; then the hop says where to look."""
    ground = Ground(expected=(3,))
    assert ground.wait(9) == []
    assert [body["hop"]["evidence"] for body in events(ground.wait(2), "hop")] == ["never received"]


def test_a_hop_causes_one_event(ground: Ground) -> None:
    """When it breaks and when it works again; the growing duration of its silence causes none."""
    ground.receive(phm_heartbeat(7), phm_heartbeat(8))
    news = ground.wait(60, phm_heartbeat(8))
    assert [body["hop"]["name"] for body in events(news, "hop")] == ["radio or vehicle"]
    ground.receive(phm_heartbeat(7))
    assert [body["hop"] for body in events(ground.wait(1), "hop")] == [None]


def test_an_agent_without_contact_to_the_ground_reports_it_in_its_view(ground: Ground) -> None:
    """Its radio works in one direction only: it is received, but commands do not reach it."""
    ground.receive(phm_heartbeat(7), tunnel_frame(7, PeerView(1, gcs=False, autopilot=True, radio=False)))
    assert ground.agent(7)["hop"] == {
        "name": "radio",
        "evidence": "it does not receive the ground station",
        "certain": False,
    }
