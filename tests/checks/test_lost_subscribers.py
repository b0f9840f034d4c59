"""Slot 7: a subscription that its node closed because no one uses what it publishes, as image_proc does."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks._on_demand import OTHERS_S
from phm_checks.topics import Topics

RAW, RECT = "/a/raw", "/a/rect"
CAMERA, RECTIFY, VIEWER = "/a/camera", "/a/rectify", "/a/viewer"
NODES = dict.fromkeys((CAMERA, RECTIFY, VIEWER), 1)


def ends(*nodes: str) -> tuple[api.EndpointFact, ...]:
    return tuple(api.EndpointFact(node, "sensor_msgs/msg/Image") for node in nodes)


class Bench:
    """A camera and a node that rectifies its images for a viewer. The topic of the camera is judged."""

    def __init__(self, **topic: Any) -> None:
        topics = [{"name": RAW, "publishers": [CAMERA], "subscribers": [RECTIFY], **topic}]
        (self.check,) = Topics.build(testing.settings(containers=[{"name": "ros_app"}], ros={"topics": topics}))
        self.clock, self.ros = testing.FakeClock(), testing.FakeRos(nodes=NODES)
        self.see(True, others={RECT: api.NameFact((RECTIFY,), (VIEWER,))})

    def see(
        self, subscribed: bool, rect: api.TopicFact | None = None, publishers: tuple[str, ...] = (CAMERA,), **ros: Any
    ) -> api.Result:
        raw = api.TopicFact(ends(*publishers), ends(RECTIFY) if subscribed else ())
        self.ros.change(topics={RAW: raw} | ({} if rect is None else {RECT: rect}), **ros)
        self.clock.advance(5.0)
        results = self.check.run(testing.world(ros=self.ros, clock=self.clock))
        assert not isinstance(results, api.Result)
        return results["topics/a/raw"]


UNUSED = api.NameFact((RECTIFY,), ())


def test_a_subscription_that_no_one_needs_now_is_not_known_to_be_lost() -> None:
    """The last viewer has left. Nothing is restarted, and the text says what to change."""
    bench = Bench()
    result = bench.see(False, others={RECT: UNUSED})
    assert (result.level, result.condition, result.target) == (api.Level.STALE, "", "")
    assert "may subscribe on demand" in result.summary and RECTIFY in result.summary
    assert bench.see(False, others={}, rect=api.TopicFact(ends(RECTIFY))).level is api.Level.STALE, "a configured topic"
    assert bench.see(True).level is api.Level.OK


@pytest.mark.parametrize(
    ("ros", "settle_s"),
    [
        ({"rect": api.TopicFact(ends(RECTIFY), ends(VIEWER)), "others": {"/a/info": UNUSED}}, None),
        ({"others": {f"{RECTIFY}/transition_event": UNUSED}}, None),
        ({"others": {f"/x{number}": UNUSED for number in range(200)}}, None),
        ({"others": {RECT: api.NameFact((RECTIFY,), (VIEWER,)), "/a/info": UNUSED}}, OTHERS_S),
        ({"others": {RECT: api.NameFact((VIEWER,), ())}}, None),
    ],
    ids=["its output is used", "a lifecycle node", "many topics", "its output was used", "it publishes nothing"],
)
def test_a_subscription_that_is_needed_is_lost(ros: dict[str, Any], settle_s: float | None) -> None:
    """The users of topics that are not configured may be two seconds old: the viewer may have left."""
    result = Bench().see(False, **ros)
    assert (result.condition, result.settle_s) == ("subscriber_lost", settle_s)


def test_its_own_subscription_and_its_statuses_are_no_use_of_its_output() -> None:
    """It listens to itself, and an aggregator to its statuses."""
    others = {RECT: api.NameFact((RECTIFY,), (RECTIFY,)), "/diagnostics": api.NameFact((RECTIFY,), ("/aggregator",))}
    assert Bench().see(False, others=others).level is api.Level.STALE


def test_another_fault_of_the_topic_is_reported() -> None:
    """Its publisher, or another subscriber, is missing or lost."""
    unused = {RECT: UNUSED}
    assert Bench().see(False, publishers=(VIEWER,), others=unused).condition == "publisher_lost"
    assert Bench().see(False, publishers=(), others=unused).condition == "publisher_lost"
    assert Bench(publishers=["/a/six"]).see(False, others=unused).condition == "publisher_missing"
    both = Bench(subscribers=[RECTIFY, VIEWER])
    result = both.see(False, others=unused)
    assert result.condition == "subscriber_missing"
    assert VIEWER in result.summary and RECTIFY not in result.summary
