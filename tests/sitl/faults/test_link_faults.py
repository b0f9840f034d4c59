"""Faults of the link layer against the real link emulator: each affects the stated links of one agent and restores
them.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any
from unittest import mock

import pytest

from sitl.faults import all_faults
from sitl.faults.base import Agent
from sitl.simulation.link_emulator import LinkEmulator
from sitl.simulation.ports import Ports
from sitl.swarm import control
from sitl.swarm.control import LinkEmulatorClient

LINKED = sorted(name for name, fault in all_faults().items() if "air" in fault.needs and name != "router_killed")
"""The router is a separate container, which the emulator's process does not have."""
TOUCHED = {
    "autopilot_silent": ("autopilot",),
    "gcs_radio_cut": ("ground",),
    "radio_lossy": ("ground",),
    "peer_lost": ("peers",),
    "radio_saturated": ("ground",),
    "autopilot_reboot": ("autopilot",),
    "peer_split": (),
}
"""Which links of the agent differ from before; a split belongs to no single agent."""
AGENTS = 5


class Client(LinkEmulatorClient):
    """A reboot lasts until it is cleared: its usual six seconds may be over before a busy machine has looked at it."""

    def autopilot(self, agent: int, what: str, **how: float) -> None:
        super().autopilot(agent, what, **({"boot_s": 600.0} if what == "reboot" else {}), **how)


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine an answer takes a while."""
    monkeypatch.setattr(control, "LIMIT_S", 60.0)


@pytest.fixture(scope="module")
def emulator() -> Iterator[LinkEmulatorClient]:
    process = LinkEmulator(AGENTS, host="127.0.0.1", ports=Ports())
    thread = threading.Thread(target=process.run, name="air", daemon=True)
    thread.start()
    yield Client(("127.0.0.1", process.control_port))
    process.stop()
    thread.join(60)


def links(emulator: LinkEmulatorClient) -> dict[int, dict[str, Any]]:
    agents: dict[int, dict[str, Any]] = emulator.state()["agents"]
    return agents


@pytest.mark.parametrize("name", LINKED)
def test_a_fault_affects_its_link_of_one_agent_and_restores_it(name: str, emulator: LinkEmulatorClient) -> None:
    """Injected: exactly the named links of agent 2 differ. Cleared, twice: none does."""
    fault, agent = all_faults()[name], Agent("phm-test", "agent_2", mock.Mock(), number=2, air=emulator)
    before = links(emulator)
    fault.inject(agent)
    assert fault.restored(agent) in (False, None)
    after = links(emulator)
    changed = [link for link in before[2] if before[2][link] != after[2][link]]
    assert changed == sorted(TOUCHED[name], key=list(before[2]).index)
    assert all(before[number] == after[number] for number in before if number != 2)
    assert bool(emulator.state()["groups"]) is (name == "peer_split")
    fault.clear(agent)
    fault.clear(agent)
    assert links(emulator) == before
    assert not emulator.state()["groups"]
    assert fault.restored(agent) in (True, None)


@pytest.mark.parametrize("name", ["autopilot_silent", "autopilot_reboot"])
def test_the_world_shows_whether_an_autopilot_is_back(name: str, emulator: LinkEmulatorClient) -> None:
    """Before the fault, during it and after its end."""
    fault, agent = all_faults()[name], Agent("phm-test", "agent_3", mock.Mock(), number=3, air=emulator)
    assert fault.restored(agent) is True
    fault.inject(agent)
    assert fault.restored(agent) is False
    fault.clear(agent)
    assert fault.restored(agent) is True


def test_a_disabled_router_affects_one_agent(emulator: LinkEmulatorClient) -> None:
    """Its endpoint in the emulator refuses connections, and is restored."""
    before = links(emulator)
    emulator.set(2, "router", off=True)
    after = links(emulator)
    assert [
        (number, link) for number in before for link in before[number] if before[number][link] != after[number][link]
    ] == [(2, "router")]
    emulator.reset(2)
    assert links(emulator) == before


def test_a_killed_router_is_killed_in_its_container(monkeypatch: pytest.MonkeyPatch) -> None:
    """And restarted by `clear`, whether it runs or not."""
    container = mock.Mock(attrs={"State": {"FinishedAt": "0001-01-01T00:00:00Z"}})
    air = mock.Mock(**{"traffic.return_value": {2: {}}})
    agent = Agent("phm-test", "agent_2", mock.Mock(), number=2, air=air)
    monkeypatch.setattr(Agent, "container", lambda self, service: {"router": container}[service])
    container.reload.side_effect = lambda: container.attrs["State"].update(FinishedAt="2026-01-01T00:00:00.5Z")
    all_faults()["router_killed"].inject(agent)
    container.kill.assert_called_once_with()
    all_faults()["router_killed"].clear(agent)
    container.start.assert_called_once_with()


@pytest.mark.parametrize(
    ("running", "connected", "bytes_now", "restored"),
    [(True, 1, 700, True), (True, 1, 500, False), (True, 0, 700, False), (False, 1, 700, False)],
)
def test_a_router_is_restored_when_it_forwards(
    monkeypatch: pytest.MonkeyPatch, running: bool, connected: int, bytes_now: int, restored: bool
) -> None:
    """It runs, is connected, and PHM's frames have reached the radio again."""
    state = {"FinishedAt": "0001-01-01T00:00:00Z", "Running": running, "Paused": False, "Restarting": False}
    container = mock.Mock(attrs={"State": state})
    container.reload.side_effect = lambda: state.update(FinishedAt="2026-01-01T00:00:00.5Z")
    air = mock.Mock()
    air.traffic.side_effect = [{2: {"phm_to_ground": 500}}, {2: {"phm_to_ground": bytes_now}}]
    air.state.return_value = {"agents": {2: {"router": {"connected": connected}}}}
    agent, fault = Agent("phm-test", "agent_2", mock.Mock(), number=2, air=air), all_faults()["router_killed"]
    monkeypatch.setattr(Agent, "container", lambda self, service: container)
    fault.inject(agent)
    assert fault.restored(agent) is restored


def test_a_split_makes_two_groups(emulator: LinkEmulatorClient) -> None:
    """Each agent is in one group, and a group has at least two."""
    fault, agent = all_faults()["peer_split"], Agent("phm-test", "agent_4", mock.Mock(), number=4, air=emulator)
    fault.inject(agent)
    here, there = emulator.state()["groups"]
    fault.clear(agent)
    assert 4 in here
    assert sorted(here + there) == list(range(1, AGENTS + 1))
    assert min(len(here), len(there)) == AGENTS // 2


def test_a_link_fault_without_emulated_links_states_what_is_needed() -> None:
    """A single agent has no emulated links."""
    with pytest.raises(LookupError, match="python -m sitl up"):
        all_faults()["gcs_radio_cut"].inject(Agent("phm-test", "agent_1", mock.Mock()))
