"""Real topics whose message packages only the application has: this environment has no sensor_msgs, the publisher's
has.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from phm.facts import RosFact
from phm.probes.ros.supervisor import RosSupervisor
from tests.fakes import app_messages
from tests.fakes.app_messages import OTHER_DISTRIBUTION, OWN_DISTRIBUTION
from tests.fakes.ros_bench import ROOT, Bench, seen
from tests.fakes.ros_truth import within_2_percent

HZ = 20.0
TOPICS = {
    "/agent_1/plain": "sensor_msgs/msg/Range",
    "/agent_1/nested": "sensor_msgs/msg/Imu",
    "/agent_1/unbounded": "sensor_msgs/msg/Image",
}
WANTED = [{"name": name, "rate": HZ} for name in TOPICS]
PYTHONS = {"jazzy": ROOT / ".venv" / "bin" / "python", "kilted": ROOT / ".venv-kilted" / "bin" / "python"}
UNKNOWN_MIDDLEWARE = (
    sys.executable,
    "-c",
    "from phm.probes.ros import opaque_types, child; opaque_types.KNOWN.clear(); raise SystemExit(child.main())",
)


class Application:
    """A publisher of these topics in a separate environment."""

    def __init__(self, bench: Bench, folder: Path) -> None:
        self._environ: Mapping[str, str] = bench.environ
        self.sent = folder / "sent"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, distribution: str = OWN_DISTRIBUTION, *words: str) -> None:
        python = PYTHONS[distribution] if distribution != OWN_DISTRIBUTION else Path(sys.executable)
        assert python.exists(), f"there is no {python}: run scripts/venv and scripts/venv kilted"
        environ = app_messages.environ(self._environ, app_messages.install(distribution))
        script = ROOT / "tests" / "fakes" / "ros_typed_source.py"
        command = [str(python), str(script), str(HZ), str(self.sent), *words]
        self._process = subprocess.Popen(command, env=environ)

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


@pytest.fixture
def application(bench: Bench, tmp_path: Path) -> Iterator[Application]:
    made = Application(bench, tmp_path)
    yield made
    made.close()


def all_measured(probe: RosSupervisor, sent: Path) -> None:
    """Whether each topic's rate equals its publication rate, measured by a child that was never replaced."""

    def matches(fact: RosFact) -> RosFact | None:
        measured = all(
            fact.topics[name].publishers and within_2_percent(fact.topics[name].rate, sent) for name in TOPICS
        )
        return fact if measured else None

    fact = seen(probe, matches, "three rates within 2 %", limit_s=120.0)
    types = {name: topic.publishers[0].type for name, topic in fact.topics.items()}
    assert types == TOPICS
    assert probe.restarts == 0


def test_this_environment_has_no_such_package() -> None:
    """Otherwise these tests would prove nothing."""
    assert importlib.util.find_spec("sensor_msgs") is None


def test_types_that_only_the_application_has_are_measured(bench: Bench, application: Application) -> None:
    """A flat message, a nested one, and one with an array of 20 kB: from their names alone, within 2 %."""
    application.start()
    all_measured(bench.probe(WANTED), application.sent)


@pytest.mark.one_distribution
def test_the_content_of_messages_is_not_parsed(bench: Bench, application: Application) -> None:
    """Random bytes instead of messages, 3 to 20000 of them: the content is not read, and the rates are right."""
    application.start(OWN_DISTRIBUTION, "garbage")
    all_measured(bench.probe(WANTED), application.sent)


def test_the_other_distribution_is_measured(bench: Bench, application: Application) -> None:
    """Jazzy's reader and Kilted's publishers, and the reverse in Kilted's environment."""
    application.start(OTHER_DISTRIBUTION)
    all_measured(bench.probe(WANTED), application.sent)


def test_the_reader_announces_the_type_hash_of_its_publisher(bench: Bench, application: Application) -> None:
    """A tool that lists the endpoints of the topic sees one type, not a different one at PHM."""
    application.start()
    all_measured(bench.probe(WANTED), application.sent)
    readers = Path(f"{application.sent}.readers")

    def hashes(_: RosFact) -> list[str]:
        found = readers.read_text().split() if readers.exists() else []
        return found if len(found) == 2 else []

    mine, its = seen(bench.probe(), hashes, "two ends")
    assert mine == its
    assert mine.startswith("RIHS01_")


@pytest.mark.one_distribution
def test_an_unknown_middleware_takes_the_mounted_install(bench: Bench, application: Application) -> None:
    """Where the name is not enough, the application's install folder provides the types."""
    application.start()
    installs = [str(app_messages.install(OWN_DISTRIBUTION))]
    all_measured(bench.probe(WANTED, command=UNKNOWN_MIDDLEWARE, installs=installs), application.sent)


def test_a_different_type_definition_is_not_silence(bench: Bench, application: Application) -> None:
    """Jazzy matches by name alone; Kilted separates endpoints with different definitions, which is reported and is not
    0 Hz.
    """
    differing = (
        "from phm.probes.ros import opaque_types, child\n"
        "for library, (name, _) in opaque_types.KNOWN.items(): opaque_types.KNOWN[library] = (name, True)\n"
        "raise SystemExit(child.main())"
    )
    application.start()
    probe = bench.probe(WANTED, command=(sys.executable, "-c", differing))
    if OWN_DISTRIBUTION == "jazzy":
        all_measured(probe, application.sent)
        return

    def reported(fact: RosFact) -> RosFact | None:
        rates = [fact.topics[name].rate for name in TOPICS]
        found = all(rate is not None and "another definition of its type" in rate.problem for rate in rates)
        return fact if found else None

    rates = [topic.rate for topic in seen(probe, reported, "the reason").topics.values()]
    assert [(rate.hz, rate.silent_s) for rate in rates if rate is not None] == [(None, None)] * len(TOPICS)
    assert probe.restarts == 0


@pytest.mark.one_distribution
def test_an_unavailable_type_leaves_only_the_graph(bench: Bench, application: Application) -> None:
    """Publishers and types are listed, the rate is missing with a reason, and no child crashed."""
    application.start()
    probe = bench.probe(WANTED, command=UNKNOWN_MIDDLEWARE)

    def refused(fact: RosFact) -> RosFact | None:
        topics = [fact.topics[name] for name in TOPICS]
        return fact if all(topic.publishers and topic.rate and topic.rate.problem for topic in topics) else None

    fact = seen(probe, refused, "three publishers, and why their rates are missing")
    for name, kind in TOPICS.items():
        rate = fact.topics[name].rate
        assert rate is not None
        assert (rate.hz, rate.silent_s) == (None, None)
        assert rate.problem.startswith(
            f"type unknown: {kind} is not installed beside PHM; it cannot be read by its name"
        )
    assert probe.restarts == 0
