"""Own checks of topics, services and lifecycle nodes: real nodes, the real child process, the real checks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.api import CannotTell, Level, Result
from phm_checks.custom import Custom
from tests.fakes import app_messages
from tests.fakes.app_messages import OWN_DISTRIBUTION
from tests.fakes.ros_bench import ROOT, Bench, until

pytestmark = pytest.mark.one_distribution
"""Evaluations of what test_data.py, test_readiness.py and test_opaque_types.py receive on both distributions."""

ODOM, POINT = "/agent_1/odom", "geometry_msgs/msg/PointStamped"


class Agent:
    """Own checks on one domain, each evaluated when the test looks."""

    def __init__(self, bench: Bench, *custom: dict[str, Any], **ros: Any) -> None:
        settings = testing.settings(ros=ros, custom=list(custom))
        self._checks = {check.subject: check for check in Custom.build(settings)}
        self._world = testing.world(ros=bench.probe(custom=custom, **ros))

    def result(self, name: str) -> Result | str:
        """The result, or why there is none."""
        try:
            result = self._checks[name].run(self._world)
        except CannotTell as reason:
            return str(reason)
        assert isinstance(result, Result)
        return result

    def until(self, name: str, level: Level | None, words: str) -> None:
        """Wait for a result; None: that it cannot tell, for a reason with these words."""

        def found() -> bool:
            result = self.result(name)
            if isinstance(result, str):
                return level is None and words in result
            return result.level is level and words in result.summary

        until(found, f"{name}: {level} {words!r}")


def send(process: subprocess.Popen[bytes], words: str) -> None:
    assert process.stdin is not None
    process.stdin.write(f"{words}\n".encode())
    process.stdin.flush()


def topic(name: str, field: str, **limits: Any) -> dict[str, Any]:
    return {"name": name, "type": "topic", "topic": ODOM, "field": field, **limits}


@pytest.fixture
def source(bench: Bench) -> subprocess.Popen[bytes]:
    return bench.script("ros_stamped.py", "source", "20")


def test_fields_of_a_real_topic_are_compared(bench: Bench, source: subprocess.Popen[bytes]) -> None:
    """Several checks of one topic, also beside its rate and data: limits, NaN, a text, a wrong field, another type."""
    agent = Agent(
        bench,
        topic("within", "point.y", min=0.0, max=1.0),
        topic("low", "point.y", min=0.75),
        topic("warned", "point.y", warn_max=0.25),
        topic("frame", "header.frame_id", equals="odom"),
        topic("other_frame", "header.frame_id", equals="map"),
        topic("wrong_field", "point.w", min=0.0),
        topic("wrong_type", "point.x", min=0.0, message="std_msgs/msg/Float64"),
        topics=[{"name": ODOM, "type": POINT, "rate": 20, "data": {"counter": "point.z", "sample": 4}}],
    )
    agent.until("within", Level.OK, "point.y of /agent_1/odom is 0.5")
    agent.until("low", Level.ERROR, "point.y of /agent_1/odom is 0.5, allowed is 0.75 or more")
    agent.until("warned", Level.WARN, "is 0.5, allowed is 0.25 or less")
    agent.until("frame", Level.OK, "header.frame_id of /agent_1/odom is 'odom'")
    agent.until("other_frame", Level.ERROR, "is 'odom', expected 'map'")
    agent.until("wrong_field", None, "geometry_msgs/Point has no field 'w'")
    agent.until("wrong_type", Level.ERROR, f"is published as {POINT}, expected std_msgs/msg/Float64")
    send(source, "outside")
    agent.until("within", Level.ERROR, "is NaN, expected a number")
    send(source, "healthy")
    agent.until("within", Level.OK, "is 0.5")


def test_a_topic_that_falls_silent_fails(bench: Bench, source: subprocess.Popen[bytes]) -> None:
    """Without an entry in `ros.topics`; before it, that it never had a publisher."""
    agent = Agent(
        bench,
        topic("position", "point.y", max=1.0, max_age=1.0),
        {"name": "absent", "type": "topic", "topic": "/agent_1/absent", "grace": 0},
        grace=1.0,
    )
    agent.until("position", Level.OK, "is 0.5")
    agent.until("absent", Level.ERROR, "/agent_1/absent has no publisher")
    source.kill()
    agent.until("position", Level.ERROR, "has had no message for")


def test_a_type_whose_package_phm_does_not_have_is_not_known(bench: Bench, tmp_path: Path) -> None:
    """The topic arrives and its fields cannot be read, which is not a fault of the vehicle; until the package is mounted."""
    installed = app_messages.install(OWN_DISTRIBUTION)
    script = str(ROOT / "tests" / "fakes" / "ros_typed_source.py")
    command = [sys.executable, script, "20", str(tmp_path / "sent")]
    application = subprocess.Popen(command, env=app_messages.environ(bench.environ, installed))
    try:
        checks = (
            {"name": "field", "type": "topic", "topic": "/agent_1/plain", "field": "range", "min": 0.0},
            {"name": "arrives", "type": "topic", "topic": "/agent_1/plain", "max_age": 5.0},
        )
        agent = Agent(bench, *checks)
        agent.until("arrives", Level.OK, "/agent_1/plain was received")
        agent.until("field", None, "sensor_msgs/msg/Range is not installed beside PHM")
        agent.until("field", None, "ros.installs")
        Agent(bench, *checks, installs=[str(installed)]).until("field", Level.OK, "range of /agent_1/plain is 1")
    finally:
        application.kill()
        application.wait()


def test_a_lifecycle_node_and_its_services_are_seen(bench: Bench) -> None:
    """Its state, whether a service exists, and what it answers if it may be called."""
    service = {"type": "service", "service": "/agent_1/is_ready", "grace": 0}
    agent = Agent(
        bench,
        {"name": "state", "type": "lifecycle", "node": "/agent_1/planner"},
        {"name": "exists", **service, "service": "/agent_1/plan_path"},
        {"name": "ready", **service, "call": "std_srvs/srv/Trigger", "period": 0.5, "timeout": 2.0},
        {"name": "arguments", **service, "service": "/agent_1/plan_path", "call": "rcl_interfaces/srv/ListParameters"},
        grace=0.5,
    )
    agent.until("exists", Level.ERROR, "service /agent_1/plan_path has no server")
    node = bench.script("ros_lifecycle.py", "planner")
    agent.until("state", Level.ERROR, "its lifecycle state is unconfigured, expected active")
    send(node, "configure")
    agent.until("exists", Level.OK, "has a server")
    agent.until("ready", Level.ERROR, "answers success: false (waits for its activation)")
    agent.until("arguments", None, "has a request with fields (prefixes, depth): PHM sends only empty requests")
    send(node, "activate")
    agent.until("state", Level.OK, "/agent_1/planner is active")
    agent.until("ready", Level.OK, "answers")
    send(node, "block")
    agent.until("ready", Level.ERROR, "has not answered for")
