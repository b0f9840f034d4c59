"""The child is replaced however it fails, and the daemon is never affected."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from phm.core.settings import ReadySettings, RosSettings, Settings
from phm.facts import CannotTell, RosFact
from phm.probes.ros.child_environment import child_environ
from phm.probes.ros.protocol import INSTALLS, WantedCall, decode_wanted, encode_wanted
from phm.probes.ros.supervisor import NOT_INSTALLED, SupervisorLimits
from phm.probes.ros.wanted import uses_ros, wanted
from tests.fakes.ros_bench import ROOT, Bench, gone, seen, stale, until

pytestmark = pytest.mark.one_distribution
"""No ROS at all."""

FAST = SupervisorLimits(start_s=60.0, silent_s=60.0, memory_period_s=0.1, backoff_s=0.05, backoff_max_s=0.2, exit_s=0.5)
"""Quick, but with long limits for a child that, on a busy machine, gets no CPU for seconds, as this process does."""
SHORT_LIMITS = replace(FAST, start_s=2.0, silent_s=0.5)


def sent_after_s(fact: RosFact) -> float:
    """How long the child had run when it sent this snapshot."""
    return fact.up_s - fact.age_s


def nodes_of(bench: Bench) -> object:
    """The nodes that the probe lists, or why it cannot tell. Also within `Bench.on_change`, before `Bench.probe` has returned."""
    try:
        return bench._probes[-1].snapshot().nodes
    except CannotTell as reason:
        return str(reason)


def fake(behaviour: str, folder: Path | str = "") -> tuple[str, ...]:
    return (sys.executable, str(ROOT / "tests" / "fakes" / "ros_child.py"), behaviour, str(folder))


@pytest.mark.parametrize(
    ("behaviour", "words"),
    [
        ("exit", "exited with code 3 (it went wrong)"),
        ("crash", "was terminated by SIGSEGV"),
        ("mute", "was unresponsive for 0.5 s and was killed"),
        ("never", "was unresponsive for 2 s and was killed"),
    ],
)
def test_a_failed_child_is_replaced_and_reported(bench: Bench, behaviour: str, words: str) -> None:
    """However a child fails, the probe reports how, counts it, and starts another."""
    probe = bench.probe(command=fake(behaviour), limits=SHORT_LIMITS)
    until(lambda: probe.restarts >= 2, "two replacements")
    # On a busy machine some children fail otherwise before: they start too late, or for seconds could not run, as is noted then.
    until(lambda: any(words in note for note in bench.notes), "the sentence in the log")
    until(lambda: words in stale(probe), "the sentence in CannotTell")


def test_a_text_for_the_log_does_not_end_the_time_to_start(bench: Bench, tmp_path: Path) -> None:
    """The child reports an unknown peer before it imports rclpy, which takes seconds on a small board."""
    probe = bench.probe(command=fake("slow", tmp_path), limits=replace(FAST, silent_s=0.0))
    until(lambda: any("one peer is unknown" in note for note in bench.notes), "the text")
    (tmp_path / "go").touch()
    until(lambda: bench.changes or probe.restarts, "a snapshot, or another child")
    assert bench.changes


def test_the_same_failure_is_noted_once(bench: Bench) -> None:
    """A child that fails permanently must not fill the log."""
    probe = bench.probe(command=fake("exit"), limits=FAST)
    until(lambda: probe.restarts >= 4, "four replacements")
    assert len(bench.notes) == 1


def test_a_missing_command_is_reported(bench: Bench) -> None:
    """A child that cannot be started leaves the probe STALE, and PHM keeps trying."""
    probe = bench.probe(command=("/nonexistent/python",), limits=FAST)
    until(lambda: probe.restarts >= 2, "two attempts")
    assert "cannot be started" in stale(probe)


def test_an_interpreter_without_rclpy_reports_what_to_install(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without rclpy the probe is STALE with the remedy, tries rarely, and counts no restart."""
    monkeypatch.chdir(ROOT)
    probe = bench.probe(command=(sys.executable, "-S", "-m", "phm.probes.ros.child"), environ={"PYTHONPATH": ""})
    until(lambda: stale(probe) == NOT_INSTALLED, "the sentence about rclpy")
    restricted, *notes = bench.notes
    assert restricted.startswith("the ROS child is not fully restricted")  # -S hides the libraries for the sandbox, too
    assert notes == [NOT_INSTALLED]
    assert probe.restarts == 0


@pytest.mark.parametrize("behaviour", ["garbage", "long"])
def test_stray_output_is_harmless(bench: Bench, behaviour: str) -> None:
    """Lines that are not messages, and unterminated lines, are dropped; the messages between them count."""
    probe = bench.probe(command=fake(behaviour), limits=FAST)
    seen(probe, lambda fact: sent_after_s(fact) > 0.5 and fact.nodes == {"/a/n": 1}, "a snapshot among the garbage")
    assert probe.restarts == 0


def test_a_stopped_child_is_replaced(bench: Bench) -> None:
    """SIGSTOP looks like a deadlock in the middleware: the child is killed, and another answers."""
    probe = bench.probe(command=fake("good"), limits=replace(FAST, silent_s=0.5))
    seen(probe, lambda fact: fact.nodes, "a snapshot")
    first, reasons = probe.pid, list[str]()
    bench.on_change = lambda: reasons.append(stale(probe))
    os.kill(first, signal.SIGSTOP)
    until(lambda: any(reasons), "STALE while it is silent, as the checks that are woken see it")
    seen(probe, lambda fact: probe.pid not in (0, first), "a snapshot of another child")
    until(lambda: gone(first), "the end of the first child")
    assert probe.restarts == 1


def test_a_stale_node_in_the_graph_disappears_with_its_child(bench: Bench, tmp_path: Path) -> None:
    """A node that one participant lists twice for longer than any lease is looked up by another, which does not count
    as a failure of the child.
    """
    pictures: list[object] = []
    bench.on_change = lambda: pictures.append(nodes_of(bench))
    limits = replace(FAST, doubt_s=0.3)
    probe = bench.probe(command=fake("stale_name", tmp_path), limits=limits, nodes=[{"name": "/a/n"}])
    until(lambda: {"/a/n": 2} in pictures, "the stale name, as the checks that are woken see it")
    seen(probe, lambda fact: fact.nodes == {"/a/n": 1}, "one node")
    assert bench.notes == ["the ROS child is restarted: /a/n has been listed more than once for 0.3 s"]
    assert probe.restarts == 0


def test_a_node_that_really_runs_twice_is_looked_up_once_more(bench: Bench, tmp_path: Path) -> None:
    """Two nodes of one name must not restart child after child."""
    probe = bench.probe(command=fake("twice", tmp_path), limits=replace(FAST, doubt_s=0.2), nodes=[{"name": "/a/n"}])
    until(lambda: len(list(tmp_path.iterdir())) == 2, "a second child")
    seen(
        probe,
        lambda fact: fact.nodes == {"/a/n": 2} and sent_after_s(fact) > 1.0,
        "a second child that has run for long enough",
    )
    assert len(list(tmp_path.iterdir())) == 2


def test_an_unconfigured_node_listed_twice_does_not_replace_the_child(bench: Bench, tmp_path: Path) -> None:
    """Anyone can announce names twice: only the configured nodes justify another participant."""
    probe = bench.probe(
        command=fake("twice", tmp_path), limits=replace(FAST, doubt_s=0.1), nodes=[{"name": "/a/other"}]
    )
    seen(probe, lambda fact: sent_after_s(fact) > 2.0, "a child that has run for long enough")
    assert len(list(tmp_path.iterdir())) == 1 and not bench.notes


def test_a_killed_child_is_replaced(bench: Bench) -> None:
    """SIGKILL from outside (the kernel's out-of-memory killer) is reported, and another child answers."""
    probe = bench.probe(command=fake("good"), limits=FAST)
    seen(probe, lambda fact: fact.nodes, "a snapshot")
    first = probe.pid
    os.kill(first, signal.SIGKILL)
    until(lambda: bench.notes == ["the ROS child was terminated by SIGKILL"], "the note")
    seen(probe, lambda fact: probe.pid not in (0, first), "a snapshot of another child")


def test_renewing_replaces_the_child_without_counting_a_failure(bench: Bench) -> None:
    """After PHM joined a network the child is restarted on purpose, so it does not count."""
    probe = bench.probe(command=fake("good"), limits=FAST)
    seen(probe, lambda fact: fact.nodes, "a snapshot")
    first = probe.pid
    probe.renew("PHM joined a network")
    seen(probe, lambda fact: probe.pid not in (0, first), "a snapshot of another child")
    until(lambda: gone(first), "the end of the first child")
    assert probe.restarts == 0
    assert bench.notes == ["the ROS child is restarted: PHM joined a network"]


@pytest.mark.parametrize("behaviour", ["good", "stubborn", "never", "exit"])
def test_close_leaves_no_process(bench: Bench, tmp_path: Path, behaviour: str) -> None:
    """After `close` none of the children exists, and the probe reports it."""
    probe = bench.probe(command=fake(behaviour, tmp_path), limits=FAST)
    until(lambda: list(tmp_path.iterdir()), "a start")
    probe.close()
    probe.close()
    # `close` waits some seconds for its thread, and that for a killed child: on a busy machine they end later.
    until(lambda: "closed" in stale(probe), "the end of the probe")
    until(lambda: all(gone(int(path.name)) for path in tmp_path.iterdir()), "the end of all children")


def test_the_probe_cannot_tell_before_its_start() -> None:
    """A probe without any data is never OK."""
    from phm.core.clock import SystemClock
    from phm.probes.ros.supervisor import RosSupervisor

    probe = RosSupervisor(RosSettings(), "a", SystemClock(), lambda: None, lambda _: None, {})
    assert "not been started" in stale(probe)
    probe.close()


def test_the_first_snapshot_and_its_loss_are_changes(bench: Bench) -> None:
    """Checks are woken when there is a snapshot and when it is lost, and not by every message."""
    probe = bench.probe(command=fake("good"), limits=FAST)
    seen(probe, lambda fact: sent_after_s(fact) > 0.5, "several snapshots")
    assert bench.changes == 1
    os.kill(probe.pid, signal.SIGKILL)
    until(lambda: bench.changes >= 3, "the loss, and the first snapshot of the next")


def test_the_environment_of_the_child() -> None:
    """UDP by default, the user's own choice first, and the configured domain over both."""
    settings = RosSettings.model_validate({"domain": 7})
    assert child_environ(settings, {})["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"
    assert child_environ(settings, {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"})["FASTDDS_BUILTIN_TRANSPORTS"] == "DEFAULT"
    assert child_environ(settings, {"ROS_DOMAIN_ID": "3"})["ROS_DOMAIN_ID"] == "7"
    assert child_environ(RosSettings(), {"ROS_DOMAIN_ID": "3"})["ROS_DOMAIN_ID"] == "3"
    installs = RosSettings.model_validate({"installs": ["/a/install", "/b"]})
    assert child_environ(installs, {})[INSTALLS] == "/a/install:/b"


def test_topics_are_requested_by_their_full_names() -> None:
    """A missing leading slash is added, as documented in the configuration."""
    settings = RosSettings.model_validate({"topics": [{"name": "a/b", "rate": 5}, {"name": "/c"}], "silence": 2})
    assert [(t.name, t.rate_hz, t.silence_s) for t in wanted(settings, "a").topics] == [("/a/b", 5, 2), ("/c", None, 2)]


def test_readiness_requests_each_service_topic_and_state_once() -> None:
    """Services and topics of nodes and containers, and the states of nodes with `lifecycle`."""
    nodes = [
        {"name": "a/b", "ready": {"lifecycle": "active", "services": ["/s"]}},
        {"name": "/c", "ready": {"topics": ["t"]}},
    ]
    looked_for = wanted(
        RosSettings.model_validate({"nodes": nodes, "topics": [{"name": "/u"}]}),
        "a",
        [ReadySettings(services=["s", "/r"], topics=["/t"], call="c")],
    )
    assert (looked_for.services, looked_for.lifecycle, looked_for.calls) == (
        ("/s", "/r"),
        ("/a/b",),
        (WantedCall("/c"),),
    )
    assert [(topic.name, topic.rate_hz) for topic in looked_for.topics] == [("/u", None), ("/t", 0.0)]


def test_own_checks_are_requested_once_and_beside_the_rest() -> None:
    """A topic that is measured already keeps its rate and data and gets the fields; one without a rate is received."""
    topics = [{"name": "/odom", "rate": 10, "data": {"order": True, "sample": 4}}, {"name": "/plain"}]
    custom = Settings.model_validate(
        {
            "custom": [
                {"name": "a", "type": "topic", "topic": "odom", "field": "x", "min": 0.0},
                {"name": "b", "type": "topic", "topic": "/odom", "field": "y[1]", "max": 1.0},
                {"name": "c", "type": "topic", "topic": "/odom", "field": "x", "max": 9.0},
                {"name": "d", "type": "topic", "topic": "/plain"},
                {"name": "e", "type": "service", "service": "reset"},
                {"name": "f", "type": "service", "service": "/ask", "call": "a_msgs/srv/Ask", "period": 30.0},
                {"name": "g", "type": "lifecycle", "node": "planner"},
            ]
        }
    ).custom
    looked_for = wanted(RosSettings.model_validate({"topics": topics}), "a", custom=custom)
    odom, plain = looked_for.topics
    assert odom.data is not None
    assert (odom.rate_hz, odom.data.order, odom.data.hz, odom.data.fields) == (10, True, 4, ("x", "y[1]"))
    assert (plain.name, plain.rate_hz, plain.data) == ("/plain", 0.0, None)
    assert (looked_for.services, looked_for.lifecycle) == (("/reset", "/ask"), ("/planner",))
    assert looked_for.calls == (WantedCall("/ask", "a_msgs/srv/Ask", 30.0, 30.0),)
    assert decode_wanted(encode_wanted(looked_for)) == looked_for
    assert uses_ros(custom) and not uses_ros([])
