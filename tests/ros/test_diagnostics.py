"""Diagnostics through the real child: those of the application are received, PHM's own reach a real subscriber."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from phm.facts import DiagnosticFact, RosFact
from phm.probes.ros.diagnostic_sources import STEADY_S
from phm.probes.ros.diagnostics import MAX_TEXT, MAX_VALUES, portions
from phm.probes.ros.protocol import LINE_LIMIT, SelfReportUpdate, encode
from phm.probes.ros.self_reports import MAX_NAMES, ConfiguredNames, SelfReports
from phm.probes.ros.supervisor import UNKEPT, RosSupervisor
from phm.wire import json_log
from tests.fakes.ros_bench import ROOT, Bench, Listener, seen, until

FREQUENCY = "camera: Frequency"
FINE = [FREQUENCY, 0, "fine", "cam-07", {"fps": "30.0"}]


class Speaker:
    """A real node that publishes the given status ten times a second."""

    def __init__(self, bench: Bench, name: str = "camera") -> None:
        self.process = bench.script("ros_status.py", "say", name)

    def say(self, *statuses: list[Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(statuses).encode() + b"\n")
        self.process.stdin.flush()


def received(fact: RosFact, name: str = FREQUENCY) -> DiagnosticFact | None:
    return fact.diagnostics.get(name)


def listening(bench: Bench, **diagnostics: Any) -> RosSupervisor:
    return bench.probe(nodes=[{"name": "/agent_1/camera"}], diagnostics=diagnostics)


def statuses(level: int, message: str, **values: str) -> Mapping[str, DiagnosticFact]:
    return {"phm/agent_1: summary": DiagnosticFact(0.0, level, message, "agent_1", values)}


def test_a_nodes_status_is_received(bench: Bench) -> None:
    """Each status with its level, message, hardware id and values; a new level is reported immediately; silence shows
    as age.
    """
    camera, probe = Speaker(bench), listening(bench)
    camera.say(FINE, ["camera: Frames", 1, "few", "", {}])
    fact = seen(probe, lambda fact: received(fact) and received(fact, "camera: Frames") and fact, "both statuses")
    frequency = fact.diagnostics[FREQUENCY]
    assert (frequency.level, frequency.message, frequency.hardware_id) == (0, "fine", "cam-07")
    assert dict(frequency.values) == {"fps": "30.0"} and fact.diagnostics["camera: Frames"].level == 1
    changes = bench.changes
    camera.say([FREQUENCY, 2, "no image", "cam-07", {}])
    seen(probe, lambda fact: fact.diagnostics[FREQUENCY].message == "no image", "the news")
    until(lambda: bench.changes > changes, "the wake-up, which follows the news")
    camera.process.kill()
    seen(probe, lambda fact: fact.diagnostics[FREQUENCY].age_s > 1.0, "silence")


@pytest.mark.one_distribution
def test_two_nodes_are_received_on_one_topic(bench: Bench) -> None:
    """Arrays of one topic share a queue, and all waiting ones are read."""
    camera, lidar, probe = Speaker(bench), Speaker(bench, "lidar"), listening(bench)
    camera.say(FINE)
    lidar.say(["lidar: Frequency", 0, "", "", {}])
    both = {FREQUENCY, "lidar: Frequency"}
    seen(
        probe,
        lambda fact: both <= set(fact.diagnostics) and all(f.age_s < 1 for f in fact.diagnostics.values()),
        "both",
    )


def test_two_nodes_with_one_status_name_are_both_received(bench: Bench) -> None:
    """diagnostic_updater leaves out the namespace; the nodes differ by the identity of their publishers."""
    left, right, probe = Speaker(bench), Speaker(bench, "camera_2"), listening(bench)
    left.say([FREQUENCY, 2, "left", "none", {}])
    right.say([FREQUENCY, 0, "right", "none", {}])

    def both(fact: RosFact) -> Any:
        found = fact.diagnostic_sources.get(FREQUENCY, ())
        return {status.message: status.level for status in found} == {"left": 2, "right": 0} and fact

    since_s = seen(probe, both, "both").up_s
    seen(
        probe, lambda fact: both(fact) and fact.up_s > since_s + STEADY_S + 1.0, "both for longer than a single message"
    )
    left.process.kill()
    seen(probe, lambda fact: both(fact) and max(f.age_s for f in fact.diagnostic_sources[FREQUENCY]) > 2.0, "silence")


@pytest.mark.one_distribution
def test_phm_ignores_diagnostics_of_phm(bench: Bench) -> None:
    """Neither its own array nor that of another agent's PHM in the same domain."""
    camera, probe = Speaker(bench), listening(bench)
    camera.say(["phm/agent_2: summary", 2, "", "", {}], FINE)
    until(lambda: probe.publish(statuses(2, "x")) == 0 and seen(probe, received, "the status"), "the status")
    fact = seen(probe, lambda fact: fact.up_s > 3.0 and fact, "a while")
    assert set(fact.diagnostics) == {FREQUENCY}


def test_phms_diagnostics_reach_a_subscriber(bench: Bench) -> None:
    """A real subscriber gets level, texts and values, and the frame by which PHM recognizes its own."""
    probe, monitor = listening(bench), Listener(bench)
    message = "größer\u202e" + "x" * 200

    def arrived() -> Any:
        probe.publish(statuses(1, message, slot="6", empty=""))
        return monitor.received.get("phm/agent_1: summary")

    assert until(arrived, "the status") == [1, message, "agent_1", {"slot": "6", "empty": ""}]
    assert monitor.frames["phm/agent_1: summary"] == "phm"


def test_the_daemon_knows_whether_a_node_subscribes(bench: Bench) -> None:
    """The topic exists from the first array on. PHM's own reader does not count; a subscriber that comes later does."""
    probe = listening(bench)
    assert not probe.idle()  # unknown

    def published() -> bool:
        probe.publish(statuses(1, "first"))
        return probe.idle()

    until(published, "a topic without a subscriber")
    monitor = Listener(bench)
    until(lambda: not probe.idle(), "the subscriber")

    def arrived() -> Any:
        probe.publish(statuses(1, "second"))
        return monitor.received.get("phm/agent_1: summary")

    assert until(arrived, "the status")[1] == "second"


@pytest.mark.one_distribution
def test_a_long_array_goes_through_the_pipe_in_pieces(bench: Bench) -> None:
    """Longer than the pipe's capacity: nothing blocks, and it arrives complete."""
    probe, monitor = listening(bench), Listener(bench)
    long = {
        f"phm/agent_1/ros: x/{n}": DiagnosticFact(0.0, 0, "x" * 250, "agent_1", {"k": "v" * 100}) for n in range(400)
    }
    assert len(repr(long)) > 150_000
    until(lambda: probe.publish(long) >= 0 and len(monitor.received) == 400, "all of them")


@pytest.mark.one_distribution
def test_an_array_that_is_too_long_is_not_read(bench: Bench) -> None:
    """The log states it once, and other arrays are still received."""
    camera, lidar, probe = Speaker(bench), Speaker(bench, "lidar"), listening(bench)
    lidar.say(["lidar: Log", 0, "x" * 300_000, "", {}])
    camera.say(FINE)
    seen(probe, received, "the short one")
    until(lambda: bench.notes, "the note")
    fact = seen(probe, lambda fact: fact.up_s > 2.0 and fact, "a while")
    assert bench.notes == ["an array of more than 200 kB on /diagnostics is ignored"]
    assert set(fact.diagnostics) == {FREQUENCY}


@pytest.mark.one_distribution
def test_texts_and_values_are_cut(bench: Bench) -> None:
    """Names and values come from outside: they must fill neither the pipe nor the memory."""
    camera, probe = Speaker(bench), listening(bench)
    camera.say(["n" * 999, 77, "m" * 999, "h" * 999, {f"k{n}": "v" * 999 for n in range(99)}], ["", 2, "", "", {}])
    name = "n" * 255
    picture = seen(probe, lambda fact: received(fact, name) and fact, "the status")
    fact = picture.diagnostics[name]
    assert (fact.level, fact.message, fact.hardware_id) == (77, "m" * 255, "h" * 255)
    assert len(fact.values) == 32 and set(fact.values.values()) == {"v" * 255}
    assert set(picture.diagnostics) == {name}


@pytest.mark.one_distribution
@pytest.mark.parametrize("watch", [[], [{"name": "*"}]], ids=["others", "watched"])
def test_no_more_names_are_kept_than_the_cap(bench: Bench, watch: list[Any]) -> None:
    """500 at most; recently received names replace older ones, which is reported of those that are watched."""
    camera, probe = Speaker(bench), listening(bench, watch=watch)
    camera.say(*([f"a{n}", 0, "", "", {}] for n in range(400)))
    seen(probe, lambda fact: received(fact, "a399"), "the first")
    camera.say(*([f"b{n}", 0, "", "", {}] for n in range(400)))
    fact = seen(probe, lambda fact: received(fact, "b399") and fact, "the next")
    assert len(fact.diagnostics) == 500
    assert (UNKEPT in probe.problems()) is bool(watch)


@pytest.mark.one_distribution
def test_other_topics_may_be_subscribed(bench: Bench) -> None:
    """And none at all: then nothing is received, and PHM still publishes."""
    camera, probe, monitor = Speaker(bench), listening(bench, listen=[]), Listener(bench)
    camera.say(FINE)
    until(lambda: probe.publish(statuses(0, "x")) == 0 and "phm/agent_1: summary" in monitor.received, "PHM's status")
    until(lambda: FREQUENCY in monitor.received, "the camera's status, elsewhere")
    assert seen(probe, lambda fact: fact, "a snapshot").diagnostics == {}


@pytest.mark.one_distribution
def test_missing_diagnostic_msgs_is_reported_and_harmless(bench: Bench) -> None:
    """It is reported once, also when the child is restarted; the graph is still seen."""
    bench.node("node_1")
    hidden = (
        "import sys; sys.modules['diagnostic_msgs'] = None\n"
        "from phm.probes.ros.child import main; raise SystemExit(main())"
    )
    probe = bench.probe(nodes=[{"name": "/agent_1/node_1"}], command=(sys.executable, "-c", hidden))
    seen(probe, lambda fact: fact.nodes, "the node")
    assert probe.publish(statuses(0, "x")) == 0
    first = probe.pid
    probe.renew("for the test")
    seen(probe, lambda fact: fact.nodes and probe.pid != first, "the node again")
    probe.publish(statuses(0, "x"))
    seen(probe, lambda fact: fact.up_s > 1.0, "a while")
    assert [note for note in bench.notes if "restarted" not in note] == [
        "diagnostic_msgs is not installed beside PHM: /diagnostics is neither read nor published; "
        "install it where rclpy comes from (ros-<distro>-diagnostic-msgs)"
    ]
    assert probe.restarts == 0


@pytest.mark.one_distribution
def test_a_child_that_does_not_read_blocks_nothing(bench: Bench) -> None:
    """Waiting data are replaced by newer ones, and counted; graph snapshots continue."""
    fake = (sys.executable, str(ROOT / "tests" / "fakes" / "ros_child.py"), "no_input")
    probe = bench.probe(nodes=[{"name": "/a/n"}], command=fake)
    big = {f"s{n}": DiagnosticFact(0.0, 0, "x" * 250) for n in range(400)}
    assert probe.publish(big) == 0  # no snapshot yet: no child to send it to
    seen(probe, lambda fact: fact.nodes, "a snapshot")
    until(lambda: probe.publish(big) >= 3, "arrays that were not taken")
    up_s = seen(probe, lambda fact: fact, "a snapshot").up_s
    seen(probe, lambda fact: fact.up_s > up_s + 0.5, "snapshots")
    assert probe.restarts == 0


@pytest.mark.one_distribution
def test_invalid_requests_are_ignored() -> None:
    """A truncated line, or one that is not JSON, does not affect the next; a closed pipe ends the reader."""
    code = (
        "import time; from types import SimpleNamespace\n"
        "from phm.probes.ros import child; from phm.probes.ros.line_splitter import LineSplitter\n"
        "orders, got = LineSplitter(), []\n"
        "watch = SimpleNamespace(events=None, execute=got.append)\n"
        "while child._wait(time.monotonic() + 9, orders, watch) is not None: pass\n"
        "print([order.utc_s for order in got])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=b'[1,{},"/diagnostics"]\nnonsense\n{"a":1}\n' + b"x" * 2_000_000 + b'\n[2,{},"/diagnostics"]\n[3,{}',
        capture_output=True,
        timeout=60,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.stdout.strip() == b"[1.0, 2.0]"


CONFIG = """
agent: {{name: agent_7, id: 7}}
interval: 5s
log: {{directory: {folder}/log}}
state_dir: {folder}/state
run_dir: {folder}/run
docker: {{socket: unix://{folder}/none.sock}}
ros:
  domain: {domain}
  grace: 4s
  nodes: [{{name: /agent_1/camera}}]
  diagnostics:
    watch: [{{name: "camera: *", timeout: 60s}}]
"""


@pytest.mark.one_distribution
def test_a_running_daemon_judges_and_publishes_diagnostics(bench: Bench, tmp_path: Path) -> None:
    """End to end: a node's ERROR becomes a fault in the log and on /diagnostics, and is resolved when the node reports
    OK.
    """
    (tmp_path / "phm.yaml").write_text(CONFIG.format(folder=tmp_path, domain=bench.domain))
    camera, monitor = Speaker(bench), Listener(bench)
    camera.say(FINE)
    daemon = subprocess.Popen(
        [sys.executable, "-m", "phm.cli", "run", "-c", str(tmp_path / "phm.yaml")],
        env={**bench.environ, "PHM_INTERVAL": ""},
    )
    unit = "phm/agent_7/ros: diagnostics/camera: *"

    def level() -> Any:
        return monitor.received.get(unit, [None])[0]

    def closed() -> list[Any]:
        return [line for line in json_log.read(tmp_path / "log") if line["event"] == "fault_closed"]

    try:
        until(lambda: level() == 0, "OK", 120.0)
        camera.say([FREQUENCY, 2, "no image", "cam-07", {}])
        _, message, hardware, values = until(
            lambda: level() == 2 and monitor.received[unit][3].get("fault") and monitor.received[unit], "ERROR"
        )
        assert message.startswith("camera: Frequency reports ERROR: no image (hardware id cam-07)")
        assert (hardware, values["condition"], values["slot"]) == ("agent_7", "diagnostic_error", "6")
        assert values["fault"] and values["status"] == FREQUENCY
        until(lambda: "camera: Frequency ERROR" in monitor.received["phm/agent_7: summary"][1], "the summary")
        camera.say(FINE)
        until(lambda: level() == 0 and monitor.received[unit][3]["fault"] == "", "OK again")
        (fault,) = until(closed, "the fault's end in the log")
        assert (fault["unit"], fault["outcome"], fault["by"]) == ("diagnostics/camera: *", "resolved", "itself")
    finally:
        daemon.terminate()
        assert daemon.wait(60) == 0
    until(lambda: monitor.received[unit][:2] == [3, "PHM has stopped"], "the final statuses")


@pytest.mark.parametrize("character", ["\u20ac", "\U0001f600"])
def test_statuses_of_any_size_fit_into_messages(character: str) -> None:
    """The maximum number and length; characters that JSON writes with six bytes, and with twelve."""
    text = character * MAX_TEXT
    fact = DiagnosticFact(0.0, 2, text, text, {f"{number:03}{text[3:]}": text for number in range(MAX_VALUES)})
    messages = portions([(f"{number:03}{text[3:]}", fact) for number in range(50)])
    assert sum(len(message.diagnostics) for message in messages if isinstance(message, SelfReportUpdate)) == 50
    assert all(len(encode(message)) < LINE_LIMIT for message in messages)
    assert portions([]) == []


def test_other_statuses_displace_no_configured_status() -> None:
    """The daemon keeps configured statuses, by name or pattern, however old they are."""
    kept = SelfReports(configured=ConfiguredNames(statuses=("camera: *",))).with_update(
        SelfReportUpdate(diagnostics={"camera: a": DiagnosticFact(0.0, 0)}), 1.0
    )
    for number in range(3 * MAX_NAMES):
        kept = kept.with_update(SelfReportUpdate(diagnostics={f"x{number}": DiagnosticFact(0.0, 0)}), 2.0 + number)
    assert "camera: a" in kept.diagnostics and len(kept.diagnostics) == MAX_NAMES + 1


def test_the_statuses_of_a_pattern_are_limited_and_displace_no_others() -> None:
    """Part of a name may count up, or be invented: without a limit each of them would stay in the daemon's memory."""
    named = dict.fromkeys(("lidar: a", "gps: fix"), DiagnosticFact(0.0, 0))
    watched = ConfiguredNames(statuses=("camera: *", "lidar: *", "gps: fix"))
    kept = SelfReports(configured=watched).with_update(SelfReportUpdate(diagnostics=named), 1.0)
    for first in range(0, 3 * MAX_NAMES, 100):
        assert kept.unkept_at is None or first > MAX_NAMES
        frames = {f"camera: {number}": DiagnosticFact(0.0, 0) for number in range(first, first + 100)}
        kept = kept.with_update(SelfReportUpdate(diagnostics=frames), 2.0 + first)
    newest = {f"camera: {number}" for number in range(2 * MAX_NAMES, 3 * MAX_NAMES)}
    assert kept.diagnostics.keys() == {*named, *newest}
    assert kept.unkept_at == 2.0 + first
