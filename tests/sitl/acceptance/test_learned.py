"""When a row of `scripts/proof-learned` holds, and what it starts with."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from phm.config.loader import load
from sitl.acceptance.learned import BEFORE, CONDITIONS, FAULTS, judge_fault, judge_quiet, learned_counts, override
from sitl.acceptance.table import Row
from sitl.faults import all_faults
from sitl.harness.log_follower import Event

NODE = "nodes/agent_1/node_1"


def opened(unit: str, condition: str) -> Event:
    return {"event": "fault_opened", "unit": unit, "condition": condition}


def row() -> Row:
    return Row("learned", "node_killed", "node killed", NODE)


@pytest.mark.parametrize(
    ("events", "good"),
    [
        ([opened(NODE, "node_missing")], True),
        ([opened(NODE, "node_missing"), opened("host/cpu", "cpu_high")], True),
        ([], False),
        ([opened(NODE, "node_hung")], False),
        ([opened(NODE, "node_missing"), opened(NODE, "node_missing")], False),
        ([opened(NODE, "node_missing"), opened("topics/agent_1/topic_1", "topic_silent")], False),
        ([opened("topics/agent_1/topic_1", "topic_silent")], False),
    ],
)
def test_a_fault_holds_with_one_alarm_at_its_unit_and_condition(events: list[Event], good: bool) -> None:
    """An alarm about the machine is shown and not counted, as in `scripts/proof`."""
    judged = row()
    judge_fault(judged, events, "node_missing")
    assert judged.good is good


@pytest.mark.parametrize("unit", [NODE, "host/cpu"])
def test_a_quiet_time_holds_without_any_alarm(unit: str) -> None:
    """Alarms about the machine count there, too."""
    judged = row()
    judge_quiet(judged, [{"event": "report"}, {"event": "report"}])
    assert judged.good and judged.outcome == "2 reports, 0 alarms"
    judge_quiet(judged, [opened(unit, "some")])
    assert not judged.good


def test_the_faults_exist_and_need_nothing() -> None:
    """Each is played on the unchanged demonstration."""
    faults = all_faults()
    assert set(FAULTS) <= set(faults) and set(CONDITIONS) <= set(FAULTS)
    assert not [name for name in FAULTS if faults[name].needs]


def test_the_configuration_before_is_valid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names the container and its network, and nothing of what is learned."""
    for name, value in (("AGENT", "a"), ("AGENT_ID", "1"), ("DEV_ROOT", "/dev"), ("APP", "app"), ("NETWORK", "net")):
        monkeypatch.setenv(f"PHM_{name}", value)
    monkeypatch.setenv("PHM_MAVLINK", "udpout:127.0.0.1:14550")
    file = tmp_path / "phm.yaml"
    file.write_text(BEFORE)
    settings = load(file)
    assert [container.networks for container in settings.containers] == [["net"]]
    assert not settings.ros.nodes and not settings.ros.topics


def test_the_counts_are_those_of_the_file(tmp_path: Path) -> None:
    """Also of a file that has learned nothing."""
    assert learned_counts("containers: [{name: a}]") == dict.fromkeys(
        ("nodes", "topics", "rates", "devices", "manifests"), 0
    )
    text = "containers: [{name: a, devices: [{path: /dev/x}], files: [{path: /ws, manifest: m}]}]\nros: {nodes: [{name: /n}], topics: [{name: /t}]}"
    assert learned_counts(text) == {"nodes": 1, "topics": 1, "rates": 0, "devices": 1, "manifests": 1}
    services = yaml.safe_load(override(tmp_path).read_text())["services"]
    assert services["phm"]["volumes"] == [f"{tmp_path}:/etc/phm"]
