"""The demo application: its launcher and its specification."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from phm.facts import RosFact
from sitl.application.app import node_argv
from sitl.application.graph import ring
from sitl.application.node import topic_rate
from tests.fakes.ros_bench import Bench, gone, seen, until

pytestmark = pytest.mark.one_distribution
"""The application of the demonstration: its nodes call rclpy as those of the other tests do."""


def test_nodes_form_a_ring() -> None:
    """Node i publishes topic_i and subscribes to that of its predecessor, the first to that of the last."""
    assert node_argv("agent_1", ring(3, 10.0)[0])[3:] == [
        "--namespace",
        "/agent_1",
        "--name",
        "node_1",
        "--publish",
        "topic_1:10",
        "--subscribe",
        "topic_3",
    ]
    assert node_argv("a", ring(1, 0.5)[0])[-3:] == ["topic_1:0.5", "--subscribe", "topic_1"]


@pytest.mark.parametrize("text", ["topic", "topic:", "topic:0", "topic:-1", ":5", "topic:nan", "topic:x"])
def test_a_rate_must_be_above_zero(text: str) -> None:
    """A wrong TOPIC:HZ is rejected with the allowed form."""
    with pytest.raises(argparse.ArgumentTypeError, match="rate above zero"):
        topic_rate(text)


def test_the_application_runs_and_stops_as_a_container_would(bench: Bench, tmp_path: Path) -> None:
    """Pid files identify the nodes, a killed node stays dead, a stale marker is removed, SIGTERM ends all with code 0."""
    marker, pids = tmp_path / "unhealthy", tmp_path / "nodes"
    marker.touch()
    command = [
        sys.executable,
        "-m",
        "sitl.application.app",
        "--nodes",
        "2",
        "--pids",
        str(pids),
        "--marker",
        str(marker),
    ]
    app = subprocess.Popen(command, env=bench.environ, stdout=subprocess.DEVNULL)
    try:
        probe = bench.probe(nodes=[{"name": "/agent_1/node_1"}])
        seen(probe, lambda fact: set(fact.nodes) == {"/agent_1/node_1", "/agent_1/node_2"}, "both nodes")
        assert not marker.exists()
        files = [pids / f"node_{number}.pid" for number in (1, 2)]
        until(lambda: all(file.exists() and file.read_text().endswith("\n") for file in files), "their pid files")
        first, second = (int(file.read_text()) for file in files)
        os.kill(first, signal.SIGKILL)
        until(lambda: not (pids / "node_1.pid").exists(), "the pid file's end")
        assert app.poll() is None
        app.terminate()
        assert app.wait(60) == 0
        assert gone(first) and gone(second)
        assert not list(pids.iterdir())
    finally:
        app.kill()
        app.wait()


def test_a_node_drops_its_endpoints_and_recreates_them(bench: Bench) -> None:
    """SIGHUP: no subscription; SIGRTMIN+1: a publisher with a weaker QoS; a second signal restores it. Its name stays."""
    node = bench.node("node_1", "--publish", "out:10", "--subscribe", "into")
    probe = bench.probe([{"name": f"/agent_1/{topic}"} for topic in ("out", "into")])

    def listens(fact: RosFact) -> bool:
        return [end.node for end in fact.topics["/agent_1/into"].subscribers] == ["/agent_1/node_1"]

    def offers(fact: RosFact) -> list[str]:
        return [end.reliability for end in fact.topics["/agent_1/out"].publishers]

    seen(probe, lambda fact: listens(fact) and offers(fact) == ["reliable"], "both ends")
    node.send_signal(signal.SIGHUP)
    seen(probe, lambda fact: not listens(fact), "the subscription's end")
    node.send_signal(signal.SIGRTMIN + 1)
    seen(probe, lambda fact: offers(fact) == ["best_effort"], "the lesser offer")
    node.send_signal(signal.SIGHUP)
    node.send_signal(signal.SIGRTMIN + 1)
    fact = seen(probe, lambda fact: listens(fact) and offers(fact) == ["reliable"] and fact, "both ends again")
    assert fact.nodes["/agent_1/node_1"] == 1
    assert node.poll() is None


def test_a_node_is_left_out_once(bench: Bench, tmp_path: Path) -> None:
    """The file names it; the next start has all nodes again."""
    left_out, pids = tmp_path / "left_out", tmp_path / "nodes"
    left_out.write_text("node_1\n")
    command = [
        sys.executable,
        "-m",
        "sitl.application.app",
        "--nodes",
        "2",
        "--pids",
        str(pids),
        "--left-out",
        str(left_out),
    ]
    for expected in (["node_2.pid"], ["node_1.pid", "node_2.pid"]):
        app = subprocess.Popen(command, env=bench.environ, stdout=subprocess.PIPE)
        try:
            assert app.stdout is not None
            started = [app.stdout.readline() for _ in expected]
            assert [b"started" in line for line in started] == [True] * len(expected)
            assert sorted(file.name for file in pids.iterdir()) == expected
            assert not left_out.exists()
            app.terminate()
            assert app.wait(60) == 0
        finally:
            app.kill()
            app.wait()
            assert app.stdout is not None
            app.stdout.close()
