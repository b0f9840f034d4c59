"""The topic monitor in the real child process, with real publishers."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from phm.facts import RateFact, RosFact
from tests.fakes.ros_bench import ROOT, Bench, seen, until
from tests.fakes.ros_truth import true_rate

TOPIC = "/agent_1/topic_1"
HIDE = (
    "import phm.probes.ros.reader as r; plain = r._sample\n"
    "hide = lambda taken, now: (taken[0], {**taken[1], 'publication_sequence_number': None})\n"
    "r._sample = lambda taken, now: plain(hide(taken, now), now)\n"
    "from phm.probes.ros.child import main; raise SystemExit(main())"
)
"""What Humble's rclpy is like: samples without sequence numbers."""
SET = (
    "import os; from pathlib import Path; import phm.probes.ros.reader as r; plain = r._sample\n"
    "off = lambda: int(float(Path(os.environ['PHM_DEBUG_ROS_CLOCK']).read_text()) * 1e9)\n"
    "later = lambda taken: (taken[0], {**taken[1], 'source_timestamp': taken[1]['source_timestamp'] + off()})\n"
    "r._sample = lambda taken, now: plain(later(taken), now)\n"
    "from phm.probes.ros.child import main; raise SystemExit(main())"
)
"""A publisher whose clock is off by as many seconds as the file PHM_DEBUG_ROS_CLOCK says: no process can set the clock for itself alone."""
NUMBERED: Sequence[str] = (sys.executable, "-m", "phm.probes.ros.child")
HIDDEN: Sequence[str] = (sys.executable, "-c", HIDE)
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
NO_DATA = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles><participant profile_name="no_data" is_default_profile="true"><rtps>
<defaultUnicastLocatorList><locator><udpv4><port>17777</port><address>192.0.2.1</address></udpv4></locator>
</defaultUnicastLocatorList></rtps></participant></profiles></dds>
"""
"""Data for this participant is to be sent to an address that leads nowhere; its discovery works."""
LONG_LEASE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles><participant profile_name="long" is_default_profile="true"><rtps>
<builtin><discovery_config><leaseDuration><sec>100</sec><nanosec>0</nanosec></leaseDuration></discovery_config></builtin>
</rtps></participant></profiles></dds>
"""
"""A killed node stays listed for longer than the start of another one takes on a busy machine, which is not so with 20 s."""
APART = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles>
<data_writer profile_name="/agent_1/topic_1"><qos><partition><names><name>a</name></names></partition></qos></data_writer>
</profiles></dds>
"""


def rate_of(fact: RosFact) -> RateFact:
    return fact.topics[TOPIC].rate or RateFact(None, None)


def flows(bench: Bench, name: str, path: Path, *flows: str, **environ: str) -> subprocess.Popen[bytes]:
    """A node of `ros_flows`."""
    before = dict(bench.environ)
    bench.environ.update(environ)
    process = bench.script("ros_flows.py", name, str(path), *flows)
    bench.environ = before
    return process


def sent(path: Path) -> list[tuple[int, float, int]]:
    """(count, seconds, subscriptions) of each publication; the last line may be incomplete."""
    if not path.exists():
        return []
    lines = [line.split() for line in path.read_text(encoding="ascii").splitlines()[:-1]]
    return [(int(words[0]), float(words[1]), int(words[2])) for words in lines]


def matches_published(fact: RosFact, *paths: Path, within: float = 0.02) -> bool:
    """Whether the rate is that of all publishers together, over the same time."""
    rate = rate_of(fact)
    if rate.hz is None or rate.window_s < 2.0 or not all(len(sent(path)) > 1 for path in paths):
        return False
    return rate.hz == pytest.approx(sum(true_rate(path, rate.window_s) for path in paths), rel=within)


def is_even(path: Path, window_s: float) -> bool:
    """Whether no pause of the publisher, which may get no CPU, changes its rate over this window by more than 15 % or so. Some
    seconds before it count too: PHM's newest message may be as old."""
    now_s = time.time()
    recent = [at_s for _, at_s, _ in sent(path) if now_s - at_s <= window_s + 4.0]
    return len(recent) > 20 and all(later - earlier < 0.15 * window_s for earlier, later in pairwise([*recent, now_s]))


@pytest.mark.one_distribution
@pytest.mark.parametrize("hz", [2.0, 2000.0])
def test_slow_and_very_fast_topics(bench: Bench, tmp_path: Path, hz: float) -> None:
    """From one sample every other poll to five hundred per poll."""
    flows(bench, "source", tmp_path / "sent", f"topic_1:{hz}")
    probe = bench.probe([{"name": TOPIC, "rate": hz}])
    seen(probe, lambda fact: matches_published(fact, tmp_path / "sent"), "a rate within 2 %")


@pytest.mark.parametrize(
    "command", [NUMBERED, pytest.param(HIDDEN, marks=pytest.mark.one_distribution)], ids=["numbered", "hidden"]
)
def test_two_nodes_on_one_topic_are_added_up(bench: Bench, tmp_path: Path, command: Sequence[str]) -> None:
    """Each is counted separately; the rate is the sum, and the number of publishers is reported."""
    flows(bench, "one", tmp_path / "one", "topic_1:20")
    flows(bench, "two", tmp_path / "two", "topic_1:8")
    probe = bench.probe([{"name": TOPIC, "rate": 28}], command=command)
    both = (tmp_path / "one", tmp_path / "two")
    seen(
        probe,
        lambda fact: rate_of(fact).publishers == 2 and matches_published(fact, *both, within=0.05),
        "the sum",
        120.0,
    )


@pytest.mark.one_distribution
def test_fast_publishers_are_distinguished(bench: Bench, tmp_path: Path) -> None:
    """More samples between two polls than the queue holds: the remaining ones show their publishers."""
    flows(bench, "one", tmp_path / "one", "topic_1:150")
    flows(bench, "two", tmp_path / "two", "topic_1:100")
    probe = bench.probe([{"name": TOPIC, "rate": 250}])
    both = (tmp_path / "one", tmp_path / "two")
    seen(
        probe,
        lambda fact: rate_of(fact).publishers == 2 and matches_published(fact, *both, within=0.05),
        "the sum",
        120.0,
    )


@pytest.mark.one_distribution
@pytest.mark.long
def test_two_publishers_of_one_node_are_added_up(bench: Bench, tmp_path: Path) -> None:
    """They look like a restarted node until their numbers are found to be mixed."""
    flows(bench, "source", tmp_path / "sent", "topic_1:10", "topic_1:10")
    probe = bench.probe([{"name": TOPIC, "rate": 20}])
    seen(probe, lambda fact: 18.0 < (rate_of(fact).hz or 0.0) < 22.0, "the sum", 120.0)


@pytest.mark.one_distribution
def test_a_restarted_publisher_is_measured_again(bench: Bench, tmp_path: Path) -> None:
    """A restarted node, while the killed one is still listed: a restart, and not a second publisher."""
    profile = tmp_path / "long_lease.xml"
    profile.write_text(LONG_LEASE, encoding="ascii")
    first = flows(bench, "source", tmp_path / "first", "topic_1:40", **dict.fromkeys(PROFILE_VARIABLES, str(profile)))
    probe = bench.probe([{"name": TOPIC, "rate": 40}])
    fact = seen(probe, lambda fact: matches_published(fact, tmp_path / "first") and fact, "a rate", 120.0)
    assert rate_of(fact).restarts == 0
    first.kill()
    first.wait()
    flows(bench, "source", tmp_path / "second", "topic_1:10")
    seen(
        probe,
        lambda fact: (rate_of(fact).restarts, rate_of(fact).publishers) == (1, 2),
        "the restart, with both listed",
    )
    fact = seen(probe, lambda fact: matches_published(fact, tmp_path / "second") and fact, "the new rate", 120.0)
    assert rate_of(fact).restarts == 1


@pytest.mark.one_distribution
def test_samples_are_counted_without_sequence_numbers(bench: Bench, tmp_path: Path) -> None:
    """Humble and Cyclone DDS give no numbers: a deep queue is counted instead, with the same result."""
    flows(bench, "source", tmp_path / "sent", "topic_1:50")
    probe = bench.probe([{"name": TOPIC, "rate": 50}], command=HIDDEN)
    seen(probe, lambda fact: matches_published(fact, tmp_path / "sent"), "a rate within 2 %")


@pytest.mark.one_distribution
@pytest.mark.parametrize(
    "command", [pytest.param(NUMBERED, id="numbered"), pytest.param(HIDDEN, id="hidden", marks=pytest.mark.long)]
)
def test_a_large_topic_is_subscribed_in_windows(bench: Bench, tmp_path: Path, command: Sequence[str]) -> None:
    """4 MB/s: most of the time there is no subscription; the rate is still exact, and silence is detected."""
    path = tmp_path / "sent"
    source = flows(bench, "source", path, "topic_1:20:200000")
    probe = bench.probe([{"name": TOPIC, "rate": 20}], command=command, silence=1.0)
    known = seen(
        probe, lambda fact: rate_of(fact).hz and rate_of(fact).matched is None and fact, "a rate while not listening"
    )
    assert rate_of(known).sample_bytes == pytest.approx(200_000, rel=0.01)
    assert rate_of(known).limit_s == 1.0 + 2.0
    begun = len(sent(path))

    def in_windows() -> bool:
        """In the last ten seconds. A child that gets no CPU while it is subscribed remains so for longer."""
        later = [subscriptions for _, _, subscriptions in sent(path)][begun:][-200:]
        return len(later) == 200 and later.count(0) > len(later) / 3 and later.count(1) > 0

    until(in_windows, "ten seconds, a third of them without a subscription", 120.0)
    seen(probe, lambda fact: rate_of(fact).hz == pytest.approx(true_rate(path, 10.0), rel=0.03), "a rate within 3 %")
    source.send_signal(signal.SIGSTOP)
    seen(probe, lambda fact: rate_of(fact).hz == 0.0, "silence")
    source.send_signal(signal.SIGCONT)
    seen(probe, lambda fact: (rate_of(fact).hz or 0.0) > 10.0, "a rate again")


@pytest.mark.one_distribution
def test_a_large_topic_that_is_published_only_while_subscribed_has_its_rate(bench: Bench, tmp_path: Path) -> None:
    """As image_transport publishes, and a container with intra-process communication: with another subscription, and without."""
    code = (
        "import rclpy; from std_msgs.msg import String; rclpy.init(args=[]); n = rclpy.create_node('viewer')\n"
        f"n.create_subscription(String, '{TOPIC}', lambda _: None, 5); rclpy.spin(n)"
    )
    path = tmp_path / "sent"
    flows(bench, "source", path, "topic_1:20:200000:lazy")
    other = subprocess.Popen([sys.executable, "-c", code], env=bench.environ, cwd=ROOT)
    probe = bench.probe([{"name": TOPIC, "rate": 20}])

    pauses: set[int] = set()

    def is_right(fact: RosFact) -> bool:
        return rate_of(fact).matched is None and rate_of(fact).hz == pytest.approx(20.0, rel=0.1)

    def is_right_in_pauses(fact: RosFact) -> bool:
        """In four pauses in which nothing is published."""
        if is_right(fact) and time.time() - sent(path)[-1][1] > 0.5:
            pauses.add(rate_of(fact).samples)
        return len(pauses) >= 4

    try:
        seen(probe, is_right, "the rate with another subscription", 120.0)
    finally:
        other.kill()
        other.wait()
    seen(probe, is_right_in_pauses, "the rate without another subscription", 120.0)


@pytest.mark.one_distribution
def test_simulated_time_does_not_matter(bench: Bench, tmp_path: Path) -> None:
    """The stamps are the middleware's: a node whose clock is stopped has its real rate."""
    flows(bench, "source", tmp_path / "sent", "topic_1:20:sim")
    probe = bench.probe([{"name": TOPIC, "rate": 20}])
    seen(probe, lambda fact: matches_published(fact, tmp_path / "sent"), "a rate within 2 %")
    seen(probe, lambda fact: rate_of(fact).age_s == pytest.approx(0.0, abs=1.0), "the true age of a sample")


@pytest.mark.one_distribution
def test_setting_a_publishers_clock_does_not_distort_its_rate(bench: Bench, tmp_path: Path) -> None:
    """An hour ahead, then a minute back: the rate is right again after one window, and nothing else is reported."""
    path, off = tmp_path / "sent", tmp_path / "off"
    off.write_text("0", encoding="ascii")
    flows(bench, "source", path, "topic_1:20")
    command = (sys.executable, "-c", SET)
    probe = bench.probe(
        [{"name": TOPIC, "rate": 20}],
        command=command,
        environ={"PHM_DEBUG_ROS_CLOCK": str(off)},
        installs=[str(tmp_path)],
    )
    before = seen(probe, lambda fact: matches_published(fact, path) and fact, "a rate within 2 %")
    rates: list[RateFact] = []
    judged: list[RateFact] = []

    def note(fact: RosFact) -> bool:
        """Note a rate, and judge it where the publisher has not paused in its window."""
        rates.append(rate_of(fact))
        if rates[-1].hz is not None and is_even(path, min(max(rates[-1].window_s, 1.0), 10.0)):
            judged.append(rates[-1])
        return bool(judged)

    for seconds in (3600, -60):
        off.write_text(str(seconds), encoding="ascii")
        taken = rate_of(before).samples
        judged.clear()
        seen(probe, lambda fact: note(fact) and rate_of(fact).samples > taken + 16, "four seconds", 120.0)  # noqa: B023
        assert all(15.0 < (rate.hz or 0.0) < 25.0 for rate in judged)
        before = seen(probe, lambda fact: matches_published(fact, path) and fact, "a rate within 2 % again")
    assert {(rate.restarts, rate.problem) for rate in rates} == {(0, "")}


def test_a_latched_sample_from_before_the_subscription_is_received(bench: Bench, tmp_path: Path) -> None:
    """The reader adopts the QoS of its publishers: first of a volatile one, then of a transient-local one."""
    path, leases = tmp_path / "sent", dict.fromkeys(PROFILE_VARIABLES, str(ROOT / "config" / "fastdds.xml"))
    first = flows(bench, "source", path, "topic_1:0", **leases)
    until(lambda: path.exists() and path.read_text(encoding="ascii"), "its only message, before any subscription")
    probe = bench.probe([{"name": TOPIC, "rate": 0}])
    fact = seen(probe, lambda fact: rate_of(fact).matched == 1 and fact, "the first publisher")
    assert (rate_of(fact).samples, rate_of(fact).age_s, rate_of(fact).limit_s) == (0, None, None)
    first.kill()
    first.wait()
    seen(probe, lambda fact: not fact.topics[TOPIC].publishers, "its end")
    flows(bench, "source", path, "topic_1:0:1000:latched", **leases)
    fact = seen(probe, lambda fact: (rate_of(fact).age_s or 0.0) > 2.0 and fact, "the age of its sample")
    assert (rate_of(fact).samples, rate_of(fact).hz, rate_of(fact).problem) == (1, None, "")
    assert rate_of(fact).sample_bytes == pytest.approx(1009, abs=4)


def test_a_latched_sample_is_received_beside_a_volatile_publisher(bench: Bench, tmp_path: Path) -> None:
    """No subscription receives both what one of them keeps and what the other one sends: first it is the one, then the other."""
    path = tmp_path / "sent"
    flows(bench, "source", path, "topic_1:0", "topic_1:0:1000:latched")
    until(lambda: path.exists() and path.read_text(encoding="ascii"), "the only messages, before any subscription")
    probe = bench.probe([{"name": TOPIC, "rate": 0}])
    seen(probe, lambda fact: rate_of(fact).samples, "the kept sample")
    fact = seen(probe, lambda fact: rate_of(fact).matched == 2 and fact, "a connection to both publishers")
    assert rate_of(fact).sample_bytes == pytest.approx(1009, abs=4)
    assert (rate_of(fact).samples, rate_of(fact).problem) == (1, "")


def test_a_publisher_in_another_partition_is_a_mismatch(bench: Bench, tmp_path: Path) -> None:
    """Discovery lists it, but the middleware does not connect: the reason is reported, not a fault of the topic."""
    profile = tmp_path / "apart.xml"
    profile.write_text(APART, encoding="ascii")
    environ = {**dict.fromkeys(PROFILE_VARIABLES, str(profile)), "RMW_FASTRTPS_USE_QOS_FROM_XML": "1"}
    flows(bench, "source", tmp_path / "sent", "topic_1:10", **environ)
    probe = bench.probe([{"name": TOPIC, "rate": 10}])
    fact = seen(probe, lambda fact: rate_of(fact).problem and fact, "the problem")
    assert rate_of(fact).problem.startswith("QoS mismatch")
    assert rate_of(fact).matched == 0


def test_a_blocked_transport_shows_a_publisher_without_data(bench: Bench, tmp_path: Path) -> None:
    """Discovery works but no data arrives: the publisher is listed and matched, its node has no name, no sample
    arrives.
    """
    profile = tmp_path / "no_data.xml"
    profile.write_text(NO_DATA, encoding="ascii")
    path = tmp_path / "sent"
    flows(bench, "source", path, "topic_1:20")
    probe = bench.probe([{"name": TOPIC, "rate": 20}], environ=dict.fromkeys(PROFILE_VARIABLES, str(profile)))
    seen(probe, lambda fact: rate_of(fact).matched == 1, "a connection")
    begun = len(sent(path))
    until(lambda: len(sent(path)) > begun + 60, "three seconds of samples")
    fact = seen(probe, lambda fact: fact.topics[TOPIC].publishers and fact, "the publisher")
    assert [end.node for end in fact.topics[TOPIC].publishers] == [""]
    assert (rate_of(fact).silent_s, rate_of(fact).samples, rate_of(fact).problem) == (None, 0, "")


def test_a_publisher_of_another_type_is_ambiguous(bench: Bench, tmp_path: Path) -> None:
    """Two types on one topic: only one of them can be measured, so no rate is reported."""
    code = (
        "import rclpy, time; from std_msgs.msg import Bool; rclpy.init(args=[]); n = rclpy.create_node('other')\n"
        f"n.create_publisher(Bool, '{TOPIC}', 1); time.sleep(600)"
    )
    flows(bench, "source", tmp_path / "sent", "topic_1:10")
    other = subprocess.Popen([sys.executable, "-c", code], env=bench.environ, cwd=ROOT)
    try:
        probe = bench.probe([{"name": TOPIC, "rate": 10}])
        problem = "ambiguous: published as std_msgs/msg/Bool and as std_msgs/msg/String"
        seen(probe, lambda fact: rate_of(fact).problem == problem, "the problem")
    finally:
        other.kill()
        other.wait()
