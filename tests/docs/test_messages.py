"""Messages that the documents quote are those of the code, which makes each of them here from its cause."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from phm import api, testing
from phm.config import ConfigError, load
from phm.facts import RosEnvironment
from phm.probes.ros.environment_differences import differences
from phm_checks.node_ready import NodeReady
from phm_checks.topics import Topics
from tests.checks.test_growing_process import KNOWN_S, Bench, leak
from tests.checks.test_hanging_health_check import Watched
from tests.docs.blocks import Block, containing
from tests.docs.story import play
from tests.fakes.nodes_bench import ONE, TWO
from tests.fakes.path_world import PathWorld

PLANNER = "/agent_1/planner"
IMAGE = "sensor_msgs/msg/Image"


def path() -> str:
    """The radio is silent for so long that the ground station is, too."""
    world = PathWorld(url="/dev/ttyUSB0")
    world.run(20.0)
    world.down = {"radio"}
    for _ in range(80):
        world.run(0.25)
        if "GCS unknown" in world.text("path"):
            break
    return world.text("path").partition(": ")[2]


def not_ready() -> str:
    """A node with a lifecycle that nothing activates."""
    ros = {"nodes": [{"name": PLANNER, "ready": {"lifecycle": "active"}}]}
    (check,) = NodeReady.build(testing.settings(containers=[{"name": "ros_app"}], ros=ros))
    state = testing.FakeRos(lifecycle={PLANNER: api.AnswerFact("inactive", served=True)})
    return _summary(check, state)


def other_domain() -> str:
    """The application has another ROS domain than PHM."""
    (found,) = differences(RosEnvironment("ros_app", {"ROS_DOMAIN_ID": "7"}, exact=True), RosEnvironment("PHM", {}))
    return found.text


def topics() -> str:
    """Two topics, as the log prints them: policies that do not connect, and a publisher with a wrong name."""
    camera = api.EndpointFact("/agent_1/camera", IMAGE, reliability="best_effort")
    detector = api.EndpointFact("/agent_1/detector", IMAGE, reliability="reliable")
    image = _summary(_topic("/agent_1/image"), testing.FakeRos(topics={"/agent_1/image": _pair(camera, detector)}))
    node = "/agent_1/node_1"
    listener = api.TopicFact((), (api.EndpointFact("/agent_1/node_2", IMAGE),))
    others = {"/agent_1/topc_1": api.NameFact((node,), ())}
    ros = testing.FakeRos(topics={"/agent_1/topic_1": listener}, others=others)
    return f"(7) {image} (7) {_summary(_topic('/agent_1/topic_1', publishers=[node]), ros)}"


def _topic(name: str, **more: object) -> api.Check:
    settings = testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [{"name": name, **more}]})
    (check,) = Topics.build(settings)
    return check


def _pair(publisher: api.EndpointFact, subscriber: api.EndpointFact) -> api.TopicFact:
    return api.TopicFact((publisher,), (subscriber,))


def _summary(check: api.Check, ros: testing.FakeRos) -> str:
    results = check.run(testing.world(ros=ros))
    assert not isinstance(results, api.Result)
    (result,) = results.values()
    return result.summary


def unknown_field() -> str:
    """A range for a field that the type does not have, in line 9."""
    text = (
        "agent: {name: agent_1, id: 1}\ncontainers: [{name: ros_app}]\nros:\n  topics:\n    - name: agent_1/speed\n"
        "      rate: 10\n      type: geometry_msgs/msg/TwistStamped\n      data:\n        ranges: {twist.x: [-1, 1]}\n"
    )
    with TemporaryDirectory() as folder:
        Path(folder, "phm.yaml").write_text(text)
        with pytest.raises(ConfigError) as caught:
            load(f"{folder}/phm.yaml", environ={})
        return str(caught.value).replace(f"{folder}/", "")


def hanging() -> str:
    """No run of a HEALTHCHECK with an interval of 10 s has ended for 16 s."""
    return Watched().after(16.0).summary


def growing() -> str:
    """A process leaks. The figures of the page are of another leak, and so of no weight here."""
    return Bench(leak(ONE, TWO)).run(KNOWN_S).summary


EXACT: dict[str, Callable[[], str]] = {
    "the command path is broken": path,
    "runs and is not ready": not_ready,
    "ROS_DOMAIN_ID is": other_domain,
    "does not connect all its endpoints": topics,
    "has no field": unknown_field,
    "health check of ros_app hangs": hanging,
}
"""By words of the block: what makes its text, up to blanks and the last full stop."""
FIGURES = {"reaches its memory limit": growing}
"""The same, for texts whose figures may be others."""
MADE = EXACT | FIGURES


def words_of(text: str, *, figures: bool) -> str:
    """The text without what may differ."""
    joined = " ".join(text.split()).rstrip(".")
    return re.sub(r"(?<![\w])\d+(?:\.\d+)?(?=\D)", "N", joined) if figures else joined


@pytest.mark.parametrize("block", [block for words in MADE for block in containing("text", words)], ids=str)
def test_a_message_is_the_one_of_the_code(block: Block) -> None:
    """Cause in, text out: each word is that of the page."""
    (key,) = (words for words in MADE if words in block.text)
    made = MADE[key]()
    assert words_of(block.text, figures=key in FIGURES) == words_of(made, figures=key in FIGURES), str(block)


@pytest.mark.parametrize("block", containing("text", "RESOLVED: "), ids=str)
def test_a_line_is_in_the_log_of_the_example(block: Block) -> None:
    """In this order, with other durations; `...` is the rest of a line."""
    logged = [words_of(line, figures=True) for line in play().text_log]
    at = 0
    for line in block.text.splitlines():
        start, dots, _ = line.partition(" ...")
        begin = words_of(start, figures=True)
        found = [n for n, text in enumerate(logged[at:], at) if _says(text.partition("---- ")[2], begin, bool(dots))]
        assert found, f"{block}: {line}: it is not in the log, or earlier"
        at = found[0] + 1


def _says(logged: str, begin: str, shortened: bool) -> bool:
    return logged.startswith(begin) if shortened else logged == begin


def test_other_words_are_found() -> None:
    """Only figures may differ, and only where they are said to."""
    assert words_of("9 MB in 1.5 s.", figures=True) == words_of("12 MB  in\n2.0 s", figures=True) != "9 MB in 1.5 s"
    assert words_of("node_1 of 9 s", figures=True) == "node_1 of N s"
    assert words_of("9 s", figures=False) != words_of("8 s", figures=False)
