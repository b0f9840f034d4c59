"""Messages pass the pipe unchanged, and nothing else is accepted as one."""

from __future__ import annotations

import pytest

from phm.facts import (
    AnswerFact,
    BeaconFact,
    DataFact,
    DiagnosticFact,
    EndpointFact,
    NameFact,
    NeighbourFact,
    RateFact,
    TopicFact,
)
from phm.probes.ros.graph_snapshot import GraphSnapshot
from phm.probes.ros.protocol import (
    GraphMessage,
    LogText,
    Message,
    Missing,
    OtherTopics,
    ProtocolError,
    Publish,
    ReadinessUpdate,
    SelfReportUpdate,
    Tick,
    Wanted,
    WantedTopic,
    decode,
    decode_order,
    decode_wanted,
    encode,
    encode_order,
    encode_wanted,
)

END = EndpointFact("/a/n", "std_msgs/msg/String", "reliable", "volatile")


@pytest.mark.parametrize(
    "message",
    [
        GraphMessage(1.5, {"/a/n": 2}, {"/t": TopicFact((END,), (END, END), RateFact(9.9, 0.1, 3.0, 7, "x"))}),
        GraphMessage(0.0, {}, {"/t": TopicFact()}),
        Tick(2.0, {"/t": 0.5, "/u": None}),
        SelfReportUpdate({"/a/n": BeaconFact(0.1, 0.2, 0.0, "x", 7, {"/a/m": NeighbourFact(True, 0.3)})}),
        SelfReportUpdate({}, {"radio": DiagnosticFact(0.1, 2, "no link", "sik", {"rssi": "0"})}),
        OtherTopics({"/u": NameFact(("/a/n",), ("/a/m", "/a/o"))}),
        ReadinessUpdate({"/a/plan": 1}, {"/a/n": AnswerFact("active", "", True, 0.5, "x")}),
        LogText("diagnostic_msgs is not installed"),
        Missing("rclpy", "No module named 'rclpy'"),
    ],
)
def test_a_message_is_read_as_written(message: Message) -> None:
    """Each message is returned equal, on one line."""
    line = encode(message)
    assert line.count(b"\n") == 1
    assert decode(line) == message


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
def test_a_number_that_is_not_finite_is_unknown(number: float) -> None:
    """It costs one value, not the message with the entire graph."""
    found = GraphMessage(1.0, topics={"/t": TopicFact(data=DataFact(lost_percent=number, samples=3))})
    assert decode(encode(found)) == GraphMessage(1.0, topics={"/t": TopicFact(data=DataFact(samples=3))})


def test_the_configuration_passes_the_pipe() -> None:
    """The child gets exactly the daemon's configuration."""
    wanted = Wanted(
        "agent_1",
        3,
        (WantedTopic("/t", 10.0, 2.0, least_silence_s=1.5), WantedTopic("/u")),
        0.1,
        2.0,
        ("/diagnostics",),
        services=("/a/s",),
        lifecycle=("/a/n",),
    )
    assert decode_wanted(encode_wanted(wanted)) == wanted


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"[INFO] hello",
        b"\xff\xfe",
        b"[]",
        b"{}",
        b"7",
        b'["other",[]]',
        b'["graph"]',
        b'["graph",[]]',
        b'[["graph"],[]]',
        b'["tick",["x",{}]]',
        b'["tick",[1,[1]]]',
        b'["tick",[NaN,{}]]',
        b'["tick",[true,{}]]',
        b'["tick",[1,{}],3]',
        b'["graph",[1,{"/a":1.5},{}]]',
        b'["graph",[1,{"/a":1},{"/t',
        b'["graph",[1,{},{"/t":[[["/n"]],[],null]}]]',
        b'["tick",[1' + b"0" * 400 + b",{}]]",
        b"[" * 100_000,
    ],
)
def test_any_other_line_is_rejected(line: bytes) -> None:
    """Stray output and truncated lines raise ProtocolError and nothing else."""
    with pytest.raises(ProtocolError):
        decode(line)


def test_a_wrong_configuration_is_rejected() -> None:
    """Unknown keys are a version mismatch, and are not guessed."""
    with pytest.raises(ProtocolError):
        decode_wanted(b'{"agent":"a","topics":[],"colour":1}')


def test_a_publish_request_passes_the_pipe() -> None:
    """A request of the daemon is returned equal, on one line."""
    order = Publish(1.5, {"phm/a: summary": DiagnosticFact(0.0, 1, "two\nlines", "a", {"slot": "6"})})
    line = encode_order(order)
    assert line.count(b"\n") == 1
    assert decode_order(line) == order


@pytest.mark.parametrize(
    "line", [b"", b"[]", b"[1]", b'[1,{"a":[]}]', b'[1,{"a":[0,"x","","",{}]}]', b"[NaN,{}]", b"x" * 99]
)
def test_an_invalid_request_is_rejected(line: bytes) -> None:
    """Any other content of the pipe raises ProtocolError and nothing else."""
    with pytest.raises(ProtocolError):
        decode_order(line)


def test_silence_grows_between_two_snapshots() -> None:
    """A tick states how long topics with a rate are silent; all else is as in the last snapshot, and all ages grow."""
    topics = {"/t": TopicFact((END,), (), RateFact(9.9, 0.1)), "/u": TopicFact((), (END,))}
    view = GraphSnapshot().with_message(GraphMessage(5.0, {"/a/n": 1}, topics), 100.0)
    view = view.with_message(SelfReportUpdate({"/a/n": BeaconFact(0.1, 0.2)}), 100.0)
    view = view.with_message(Tick(5.25, {"/t": 0.35}), 100.25)
    assert view.graph is not None
    fact = view.fact(view.graph, 100.35)
    assert fact.topics["/u"] == topics["/u"] and fact.topics["/t"].publishers == (END,)
    rate = fact.topics["/t"].rate
    assert rate is not None
    assert (rate.hz, rate.silent_s, fact.up_s) == (9.9, pytest.approx(0.45), pytest.approx(5.35))
    assert fact.beacons["/a/n"].age_s == pytest.approx(0.45)
    assert view.with_message(GraphMessage(6.0, {}, topics), 101.0).fact(view.graph, 101.0).topics == topics


def test_readiness_is_kept_until_it_is_reported_again() -> None:
    """It comes between two snapshots; only a change of a state or of a service wakes the checks."""
    view = GraphSnapshot().with_message(GraphMessage(5.0), 100.0)
    news = ReadinessUpdate({"/s": 1}, {"/a/n": AnswerFact("active", served=True)})
    assert view.changed_by(news)
    view = view.with_message(news, 100.1).with_message(Tick(5.25), 100.25).with_message(GraphMessage(6.0), 101.0)
    assert view.graph is not None
    fact = view.fact(view.graph, 101.0)
    assert (fact.services, fact.lifecycle) == (news.services, news.lifecycle)
    assert not view.changed_by(ReadinessUpdate({"/s": 1}, {"/a/n": AnswerFact("active", served=True, unanswered_s=1)}))
    assert view.changed_by(ReadinessUpdate({"/s": 1}, {"/a/n": AnswerFact("inactive", served=True)}))
