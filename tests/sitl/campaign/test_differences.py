"""What a campaign says about its configuration is computed, not written by hand."""

from __future__ import annotations

import json
import sys
from unittest import mock

import pytest

from sitl.application import app, graph
from sitl.application.graph import ring
from sitl.campaign.differences import compare, described, flat, of_configuration, of_container, of_fault
from sitl.campaign.fault_catalog import OFF
from sitl.campaign.fault_rows import differences
from sitl.campaign.groups import groups
from sitl.campaign.profiles import ALL, NAMING
from sitl.campaign.trial import Trial
from sitl.faults import all_faults
from sitl.faults.base import Agent, Fault
from sitl.harness.config_overrides import overridden, parsed
from sitl.swarm import config
from sitl.swarm.options import Options
from tests.fakes.campaign_trials import trial

ENVIRONMENT = {"PHM_AGENT": "agent_1", "PHM_APP": "s-1-ros_app-1"}


def keys(profile: str) -> set[str]:
    chosen = ALL[profile]
    options = Options(agents=2, name="s", changes=chosen.changes, profile=chosen.name)
    return {each["key"] for each in of_configuration(config.text(options, 1), ENVIRONMENT)}


@pytest.mark.parametrize("profile", ["shipped", "as-found"])
def test_the_shipped_profile_only_names_things(profile: str) -> None:
    """Its configuration differs from the shipped one only in what there is: the agent, its links, containers and nodes."""
    found = keys(profile)
    assert found, "the swarm's own links are not in the shipped configuration"
    assert {key for key in found if not NAMING.fullmatch(key)} <= {
        # The link of the shipped configuration, in whose place are the swarm's, says its defaults.
        *(key for key in found if key.startswith("mavlink.endpoints[ground].")),
        # And so does its first topic.
        *(key for key in found if key.endswith(".tolerance")),
    }


def test_the_tuned_profile_shows_its_changes() -> None:
    """The budget, the checksum, the copy to restore from, the required radio, a HEALTHCHECK that is not expected, and a
    pause that counts as a failure on the ground.
    """
    more = keys("tuned") - keys("shipped")
    assert more == {
        "recovery.budget",
        "recovery.on_manual_stop.ground",
        "containers[s-1-ros_app-1].files[/ws/src/critical_file].sha256",
        "containers[s-1-ros_app-1].files[/ws/src/critical_file].restore",
        "containers[s-1-router-1].healthcheck",
        "mavlink.endpoints[router].radio",
    }


def test_values_are_compared_by_their_path() -> None:
    """A changed value, one that is new and one that is gone; an unchanged configuration has no difference."""
    shipped = flat("a: {b: 1}\nlist: [{name: x, rate: 5}, {name: '${N:-y}', rate: 7}]\nwords: [u, v]\n")
    assert shipped == {
        "a.b": 1, "list[x].name": "x", "list[x].rate": 5, "list[y].name": "y", "list[y].rate": 7, "words": ["u", "v"],
    }  # fmt: skip
    assert compare("configuration", {"a": 1, "b": 2}, {"a": 3, "c": 4}) == [
        {"of": "configuration", "key": "a", "shipped": 1, "here": 3},
        {"of": "configuration", "key": "b", "shipped": 2, "here": None},
        {"of": "configuration", "key": "c", "shipped": None, "here": 4},
    ]
    assert of_configuration(overridden({})) == []


@pytest.mark.parametrize("name", [name for name, fault in all_faults().items() if "configuration" in fault.needs])
def test_a_trial_has_the_differences_that_its_fault_makes(name: str) -> None:
    """From the configuration of the profile, on its agent; and what it adds to the agent."""
    fault, options = all_faults()[name], Options(agents=3, name="s")
    agent = Agent("s-2", "agent_2", docker=mock.Mock(), number=2)
    found = of_fault(fault, agent, fault.configuration(agent), options, {**ENVIRONMENT, "PHM_AGENT": "agent_2"})
    assert {(each["fault"], each["agent"]) for each in found} == {(name, 2)}
    assert any(each["of"] == "configuration" for each in found)
    assert "recovery.budget" not in {each["key"] for each in found}
    prepares = type(fault).prepare is not Fault.prepare
    assert [each["key"] for each in found if each["of"] == "agent"] == [fault.prepared] * prepares
    assert bool(fault.prepared) == prepares


def test_differences_of_trials_are_listed_by_fault() -> None:
    """Those of several agents in one row, with their values."""

    def made(agent: int, value: str) -> Trial:
        of = {"fault": "memory_full", "agent": agent}
        return trial(
            setting={"profile": "tuned", "load": "quiet", "seed": 1},
            differences=[
                {"of": "configuration", "key": "host.memory.warn", "shipped": "85%", "here": value, **of},
                {
                    "of": "configuration",
                    "key": f"nodes[/agent_{agent}/x]",
                    "shipped": None,
                    "here": f"s-{agent}-y",
                    **of,
                },
            ],
        )

    rows = differences(groups([made(3, "40%"), made(1, "41%"), made(1, "40%"), made(2, "42%"), made(2, "43%")]))
    assert rows == [
        ("tuned, quiet", "configuration, for memory_full", "host.memory.warn", "85%", "40%, 41%, 42% and 1 more"),
        ("tuned, quiet", "configuration, for memory_full", "nodes[/agent_N/x]", "absent", "s-N-y"),
    ]


def test_off_is_a_text() -> None:
    """As for PHM, whose levels and modes may be `off`; only true and false are booleans."""
    assert parsed("[off, on, yes, no, true, false]") == ["off", "on", "yes", "no", True, False]
    tree = parsed(config.text(Options(agents=2, name="s"), 1, OFF))
    assert tree["recovery"]["mode"] == "off"


def test_a_container_is_described_by_command_environment_and_healthcheck() -> None:
    """In seconds, without the variables that every image has."""
    check = {"Test": ["CMD", "true"], "Interval": 30 * 10**9, "Retries": 1}
    assert described({"Cmd": ["app", "--graph", "[1, 2]"], "Env": ["A=b=c", "PATH=/bin"], "Healthcheck": check}) == {
        "command": "app --graph '[1, 2]'", "environment.A": "b=c", "healthcheck.interval": "30s", "healthcheck.retries": 1,
    }  # fmt: skip
    assert described({"Cmd": None, "Env": None, "Healthcheck": None}) == {}


def test_the_command_of_an_application_as_found_is_a_difference() -> None:
    """It is what the profile changes: no beacons, and no names in the command lines of nodes."""
    command = ["python", "-m", "sitl.application.app"]
    image, here = ({"Cmd": words} for words in (command, [*command, "--as-found"]))
    assert of_container("application", described(here), described(image)) == [
        {
            "of": "application",
            "key": "command",
            "shipped": "python -m sitl.application.app",
            "here": "python -m sitl.application.app --as-found",
        }
    ]


def test_the_command_lines_of_an_application_as_found_do_not_name_its_nodes() -> None:
    """The options of each node are in its environment, with which it starts, without a beacon."""
    for plan in ring(3, 5.0):
        argv, environment = app._as_found("agent_1", plan)
        assert argv == [sys.executable, "-m", "sitl.application.node"]
        assert json.loads(environment[graph.OPTIONS_VARIABLE]) == [
            "--namespace", "/agent_1", *plan.argv(), "--no-beacon",
        ]  # fmt: skip
