"""Which faults a campaign injects, and what their combination explains."""

from __future__ import annotations

from unittest.mock import Mock

import pytest

from sitl.campaign.fault_catalog import (
    EXCLUDED,
    LEFT_ALONE,
    OFF,
    chosen,
    class_of,
    excluded,
    explained,
    injection,
    kind,
)
from sitl.campaign.plan import fits
from sitl.campaign.profiles import ALL, CHANGES
from sitl.faults import all_faults
from sitl.faults.base import Agent
from sitl.harness.config_overrides import overridden

TUNED, SHIPPED, AS_FOUND = ALL["tuned"], ALL["shipped"], ALL["as-found"]


def test_every_fault_is_injected_or_excluded_with_a_reason() -> None:
    """With eight agents and emulated links, the only faults that the tuned profile excludes are double faults and one that
    is injected when it ends.
    """
    faults = all_faults()
    left = excluded(faults, 8, TUNED, air=True)
    assert left.keys() == {name for name, fault in faults.items() if fault.also} | EXCLUDED.keys()
    assert {fault.layer for fault in faults.values()} == {"companion", "container", "ros", "link"}
    assert chosen(faults, (), 8, TUNED, air=True).keys() == faults.keys() - left.keys()


def test_the_shipped_configuration_says_what_it_cannot_see() -> None:
    """What needs more than names is excluded from the other profiles, with the keys that it needs; a fault whose
    configuration only names things is not. Files are reported, and PHM may not restore them.
    """
    faults = all_faults()
    for profile in (SHIPPED, AS_FOUND):
        left = excluded(faults, 8, profile, air=True)
        assert "host.memory.error" in left["memory_full"]
        assert "host.free_disk" in left["disk_full"]
        assert "SHA-256" in left["file_altered"]
        assert not {"engine_restarted", "netns_owner_killed", "container_killed"} & left.keys()
        assert not injection(faults["file_deleted"], Agent("p", "agent_1", docker=Mock()), profile).healable
    assert injection(faults["file_deleted"], Agent("p", "agent_1", docker=Mock()), TUNED).healable


def test_several_faults_on_one_agent_are_independent_or_explained() -> None:
    """An engine and a container, a network and a node, a node and the host's load may fail together; the end of a
    container explains its nodes, so one alarm may report both. PHM's own faults come alone.
    """
    faults = all_faults()
    one, other = (class_of(faults[name]) for name in ("host_overload", "node_killed"))
    assert fits(one, [other])
    assert fits(class_of(faults["engine_restarted"]), [class_of(faults["container_killed"])])
    assert fits(class_of(faults["network_disconnected"]), [other])
    for name in (
        "phm_killed",
        "gcs_radio_cut",
        "crash_loop",
        "peer_lost",
        "cpu_limited",
        "topic_silent",
        "memory_leak",
        "power_loss",
        "phm_state_noise",
        "phm_killed_in_restart",
    ):
        assert not fits(class_of(faults[name]), [other]), name
    agents = [Agent("p", f"agent_{number}", docker=Mock(), number=number) for number in (1, 2)]
    found = [
        injection(faults[name], agents[at], SHIPPED)
        for name, at in (("node_killed", 0), ("network_blocked", 0), ("container_killed", 0), ("node_stopped", 1))
    ]
    explained(found)
    assert [each.explained_by for each in found] == ["container_killed", "", "", ""]


def test_faults_of_radio_and_router_blind_the_ground() -> None:
    """Faults of the radio and of the router hide the agent; one of its autopilot does not."""
    faults, agent = all_faults(), Agent("p", "agent_1", docker=Mock())
    blind = {name for name, fault in faults.items() if injection(fault, agent, TUNED).blinds}
    assert blind == {"gcs_radio_cut", "radio_lossy", "radio_saturated", "router_killed"}
    assert kind(faults["topic_silent"]) == kind(faults["qos_mismatch"]) == "topics"


def test_a_stepped_clock_does_not_pass() -> None:
    """Nothing sets it back before it is cleared."""
    assert not injection(all_faults()["clock_stepped"], Agent("p", "agent_1", docker=Mock()), TUNED).passes


def test_an_unavailable_fault_is_rejected() -> None:
    """A fault that does not exist, or needs more agents, is named in the message."""
    with pytest.raises(ValueError, match="no such fault: nonsense"):
        chosen(all_faults(), ["nonsense"], 8, TUNED, air=True)
    with pytest.raises(ValueError, match="peer_lost: it needs 3 agents"):
        chosen(all_faults(), ["peer_lost"], 2, TUNED, air=True)


def test_the_changes_apply_to_the_shipped_configuration() -> None:
    """Each value that a campaign changes exists; every fault of the recovery-off run exists."""
    assert overridden({**CHANGES, **OFF})
    assert set(LEFT_ALONE) <= all_faults().keys()
