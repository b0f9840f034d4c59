"""Evidence limits as the faults state them, and the waits that explain a later detection."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from unittest.mock import Mock

import pytest

from phm.tracker.tracker import ASK_AGAIN_S
from phm_checks import _data_path
from sitl import faults
from sitl.campaign.evidence import EXPLANATIONS, WAITS, compared
from sitl.campaign.fault_catalog import explained, injection as fault_record
from sitl.campaign.groups import groups
from sitl.campaign.profiles import ALL
from sitl.faults import all_faults
from sitl.faults.base import Agent
from tests.fakes.campaign_trials import T0, alarm, injection, trial

AGENT = Agent("p", "agent_3", docker=Mock(), number=3)


@pytest.mark.parametrize("file", sorted(Path(faults.__file__).parent.glob("*.py")), ids=lambda file: file.stem)
def test_no_fault_takes_anything_from_phm(file: Path) -> None:
    """Its evidence limit must not follow from how long PHM waits."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
        assert not any(name.split(".")[0].startswith("phm") for name in names)


def test_every_explanation_follows_from_a_wait() -> None:
    """A limit that was set from measurements explains nothing, and until Python has started there is none."""
    assert EXPLANATIONS.keys() == WAITS.keys()
    assert not {"phm_killed", "phm_state_noise", "power_loss"} & EXPLANATIONS.keys()
    assert EXPLANATIONS["node_killed"].up_to == pytest.approx((0.1 + 2 * 0.2 + 0.25) / 0.1)


def test_a_container_that_exits_by_itself_is_not_explained_by_a_removal() -> None:
    """Without a `kill` of the engine PHM waits for nothing."""
    assert "SIGKILL" in EXPLANATIONS["container_killed"].words
    assert "SIGKILL" not in EXPLANATIONS["container_stopped"].words
    assert EXPLANATIONS["container_stopped"].up_to == pytest.approx((0.1 + ASK_AGAIN_S) / 0.1)


def test_a_blocked_transport_is_explained_by_both_waits() -> None:
    """Also nodes with beacons are waited for, while one of their processes does not sleep."""
    assert {f"{_data_path.SOON_S:g} s", f"{_data_path.CONFIRM_S:g} s", f"{_data_path.SILENT_S:g} s"} <= set(
        re.findall(r"[\d.]+ s", EXPLANATIONS["transport_blocked"].words)
    )


def test_the_limit_of_a_created_container_beside_an_outage_is_its_end() -> None:
    """The engine's event, or the moment at which the engine is back: no wait of PHM is in it."""
    created, away = (
        fault_record(all_faults()[name], AGENT, ALL["shipped"]) for name in ("container_created", "engine_restarted")
    )
    created.moment = away.moment = T0
    explained([created, away])
    assert created.hidden_s == away.outage_s > 0
    (group,) = groups([trial(injections=[created, away], alarms=[alarm(75.1, "container/ros_app")])])
    assert group.all.evidence.mean == away.outage_s


@pytest.mark.parametrize(("interval", "latest_s", "mean_s"), [("3s", 4.0, 2.5), ("30s", 31.0, 16.0), (None, 4.0, 2.5)])
def test_the_limit_of_a_health_check_follows_from_its_interval(
    interval: str | None, latest_s: float, mean_s: float
) -> None:
    """A record of before has another limit: the page has the present one. The run is overdue after a second, in any profile."""
    key = {"of": "application", "key": "healthcheck.interval", "shipped": "1s", "here": interval}
    old = injection(fault="healthcheck_hangs", evidence="the timeout", evidence_s=33.0, evidence_period_s=3.0)
    (group,) = groups(
        [trial(injections=[old], alarms=[alarm(32.0)], setting={"differences": [key] if interval else []})]
    )
    (row,) = compared(group.all)
    assert (row.latest_s, row.limit_s) == (latest_s, mean_s)
    assert group.all.verdicts[0].evidence_limit_s == mean_s
    assert "longer than they did" in row.evidence and old.evidence_s == 33.0
