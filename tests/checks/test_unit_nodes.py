"""The ROS node that a unit names for the action `relaunch`."""

from __future__ import annotations

import pytest

from phm import api, testing
from phm_checks.data import Data
from phm_checks.diagnostics import Diagnostics
from phm_checks.node_ready import NodeReady
from phm_checks.nodes import Nodes
from phm_checks.rates import Rates
from phm_checks.topics import Topics

NODE = "/a/camera"
ROS = {
    "nodes": [{"name": "a/camera", "ready": {"services": ["/a/start"]}}, {"name": "/a/planner"}],
    "topics": [
        {"name": "/a/image", "publishers": ["a/camera", "/a/planner"], "rate": 10, "data": {"order": True}},
        {"name": "/a/goal", "subscribers": ["/a/planner"]},
    ],
    "diagnostics": {"watch": [{"name": "camera: Frequency", "node": "/a/camera"}, {"name": "battery"}]},
}


@pytest.mark.parametrize(
    ("check", "expected"),
    [
        (Nodes, {"nodes/a/camera": NODE, "nodes/a/planner": "/a/planner"}),
        (NodeReady, {"node_ready/a/camera": NODE}),
        (Topics, {"topics/a/image": NODE, "topics/a/goal": ""}),
        (Rates, {"rates/a/image": NODE}),
        (Data, {"data/a/image": NODE}),
        (Diagnostics, {"diagnostics/camera: Frequency": NODE, "diagnostics/battery": ""}),
    ],
)
def test_a_unit_names_the_node_that_relaunch_starts(check: type[api.Check], expected: dict[str, str]) -> None:
    """The node itself, the first publisher of a topic, or the node of a diagnostic status."""
    (built,) = check.build(testing.settings(containers=[{"name": "app"}], ros=ROS))
    assert {unit.id: unit.node for unit in built.units} == expected
