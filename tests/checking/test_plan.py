"""From a configuration to a plan: which pressure units can explain a unit's symptoms."""

from __future__ import annotations

from typing import Any

import pytest

from phm import testing
from phm.checking import plan, registry
from phm.core.settings import Settings

CONFIG: dict[str, Any] = {
    "containers": [
        {"name": "nav", "flight_critical": True, "recover": True},
        {"name": "video", "recover": True},
    ],
    "ros": {
        "nodes": [{"name": "/planner", "container": "nav"}, {"name": "/camera", "container": "video"}],
        "topics": [{"name": "/image", "publishers": ["/camera"], "subscribers": ["/planner"], "rate": 10}],
    },
}


def starved_by(**recovery: Any) -> dict[str, tuple[str, ...]]:
    settings: Settings = testing.settings(**CONFIG, recovery=recovery)
    made = plan.build_plan(settings, registry.checks())
    return {entry.unit.id: entry.starved_by for entry in made.tracked}


def test_a_unit_is_starved_by_its_container_its_dependencies_and_the_host() -> None:
    """In this order: the first bad one is named."""
    by = starved_by()
    assert by["nodes/planner"][0] == "pressure/nav"
    assert by["nodes/camera"][0] == "pressure/video"
    assert set(by["rates/image"][:2]) == {"pressure/nav", "pressure/video"}
    assert by["nodes/planner"][-1] == "host/memory"
    assert "host/cpu" in by["nodes/planner"]


def test_a_container_is_starved_by_the_host_and_the_host_by_nothing() -> None:
    """Chains end at the machine."""
    by = starved_by()
    assert by["pressure/nav"] and all(name.startswith("host/") for name in by["pressure/nav"])
    assert by["host/cpu"] == by["host/memory"] == ()


@pytest.mark.parametrize(("relieve", "alone"), [([], False), (["video"], True)])
def test_pressure_that_recovery_can_relieve_is_a_separate_fault(relieve: list[str], alone: bool) -> None:
    """Blocked by the host it would have no fault, and so no action."""
    by = starved_by(relieve=relieve)
    assert (by["pressure/nav"] == ()) is alone
    assert by["pressure/video"] != ()


def test_without_a_check_its_dependents_need_what_it_needs() -> None:
    """A rate needs the nodes of its topic and their container, also if the topics are not checked."""
    settings = testing.settings(**CONFIG, checks={"topics": {"enabled": False}})
    made = plan.build_plan(settings, registry.checks())
    assert "topics/image" not in {entry.unit.id for entry in made.tracked}
    assert {"container/nav", "container/video", "nodes/planner", "nodes/camera"} <= set(
        made.graph.upstream("rates/image")
    )


def test_several_disabled_checks_in_a_row_are_skipped_together() -> None:
    """The needs of their needs remain."""
    disabled = {name: {"enabled": False} for name in ("topics", "nodes")}
    made = plan.build_plan(testing.settings(**CONFIG, checks=disabled), registry.checks())
    above = made.graph.upstream("rates/image")
    assert "container/video" in above and not any(name.startswith(("topics/", "nodes/")) for name in above)
