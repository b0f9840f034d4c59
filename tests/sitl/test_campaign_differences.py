"""What a campaign says about its configuration is computed, not written by hand."""

from __future__ import annotations

import json
import sys

import pytest

from sitl.application import app, graph
from sitl.application.graph import ring
from sitl.campaign.differences import compare, described, flat, of_configuration
from sitl.campaign.fault_catalog import OFF
from sitl.campaign.profiles import ALL, NAMING
from sitl.harness.config_overrides import overridden, parsed
from sitl.swarm import config
from sitl.swarm.options import Options

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
    """The budget, the checksum, the copy to restore from, the required radio, and a HEALTHCHECK
    that is not expected.
    """
    more = keys("tuned") - keys("shipped")
    assert more == {
        "recovery.budget",
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


def test_off_is_a_text() -> None:
    """As for PHM, whose levels and modes may be `off`; only true and false are booleans."""
    assert parsed("[off, on, yes, no, true, false]") == ["off", "on", "yes", "no", True, False]
    tree = parsed(config.text(Options(agents=2, name="s"), 1, OFF))
    assert tree["recovery"]["mode"] == "off"


def test_a_container_is_described_by_environment_and_healthcheck() -> None:
    """In seconds, without the variables that every image has."""
    check = {"Test": ["CMD", "true"], "Interval": 30 * 10**9, "Retries": 1}
    assert described({"Env": ["A=b=c", "PATH=/bin"], "Healthcheck": check}) == {
        "environment.A": "b=c", "healthcheck.interval": "30s", "healthcheck.retries": 1,
    }  # fmt: skip
    assert described({"Env": None, "Healthcheck": None}) == {}


def test_the_command_lines_of_an_application_as_found_do_not_name_its_nodes() -> None:
    """The options of each node are in its environment, with which it starts, without a beacon."""
    for plan in ring(3, 5.0):
        argv, environment = app._as_found("agent_1", plan)
        assert argv == [sys.executable, "-m", "sitl.application.node"]
        assert json.loads(environment[graph.OPTIONS_VARIABLE]) == [
            "--namespace", "/agent_1", *plan.argv(), "--no-beacon",
        ]  # fmt: skip
