"""The pipe between the daemon and its ROS child, which processes untrusted data."""

from __future__ import annotations

import contextlib
import json

from hypothesis import strategies as st

from phm.facts.ros import (
    AnswerFact,
    BeaconFact,
    DataFact,
    DiagnosticFact,
    FieldFact,
    NeighbourFact,
    OutsideFact,
    TopicFact,
)
from phm.probes.ros import protocol as pipe
from phm.probes.ros.line_splitter import LineSplitter
from tests.fuzz.hostile import messages
from tests.fuzz.targets import fuzzed

BEACON = BeaconFact(0.0, 0.2, 0.0, "w.1", 5, {"/b": NeighbourFact(True, 0.4, 0.0)}, 3, "w")
STATUS = DiagnosticFact(0.0, 1, "words", "board", {"a": "b"})
FIELDS = (FieldFact("x", 1.0, 2.0, True), FieldFact("y[0]", text="words"), FieldFact("z", problem="words"))
EXAMINED = TopicFact(
    data=DataFact(("data_range",), 9, "", 0.1, False, 1, 2.0, 0.0, 5.0, (OutsideFact("x", "nan"),), FIELDS)
)
EXAMINE = pipe.WantedData(0.5, True, 2.0, "seq", 5.0, (pipe.WantedRange("x", None, 1.0),), 2.0, ("x", "y[0]"))
SENT = [
    *map(
        pipe.encode,
        (
            pipe.GraphMessage(1.0, {"/a": 1}, problems=("one",)),
            pipe.GraphMessage(1.0, {"/a": 1}, {"/t": EXAMINED}),
            pipe.Tick(1.0, {"/t": 0.5, "/u": None}, 3),
            pipe.SelfReportUpdate({"/a": BEACON}, {"s": STATUS}, {"/b": 0.1}, 2),
            pipe.ReadinessUpdate({"/s": 1}, {"/a": AnswerFact("active", "", True, 0.5)}),
            pipe.LogText("words"),
        ),
    ),
    pipe.encode_order(pipe.Publish(1.0, {"s": STATUS})),
    pipe.encode_wanted(
        pipe.Wanted(
            "agent_1",
            3,
            (pipe.WantedTopic("/t", 10.0), pipe.WantedTopic("/u", 1.0, data=EXAMINE)),
            calls=(pipe.WantedCall("/s"),),
        )
    ),
]
STREAMS = st.sampled_from(SENT).flatmap(lambda line: messages(json.loads(line)))


@fuzzed("ROS pipe", line=STREAMS)
def test_any_line_is_a_message_or_a_protocol_error(line: bytes) -> None:
    """In both directions; a valid message can be written again."""
    with contextlib.suppress(pipe.ProtocolError):
        message = pipe.decode(line)
        assert pipe.decode(pipe.encode(message)) == message
    with contextlib.suppress(pipe.ProtocolError):
        order = pipe.decode_order(line)
        assert pipe.decode_order(pipe.encode_order(order)) == order
    with contextlib.suppress(pipe.ProtocolError):
        pipe.decode_wanted(line)


@fuzzed(
    "ROS pipe, lines",
    pieces=st.lists(
        st.binary(max_size=60)
        | st.sampled_from([b"\n", b"x" * pipe.LINE_LIMIT, b"x" * (pipe.LINE_LIMIT // 2), b"x\n" * 100, *SENT]),
        max_size=12,
    ),
)
def test_lines_do_not_depend_on_the_fragments_of_the_stream(pieces: list[bytes]) -> None:
    """No line is longer than the limit, and each longer one is counted."""
    cut, whole = LineSplitter(), LineSplitter()
    lines = [line for piece in pieces for line in cut.add(piece)]
    stream = b"".join(pieces)
    complete = stream.split(b"\n")[:-1]
    assert lines == [line for line in complete if len(line) <= pipe.LINE_LIMIT]
    assert whole.add(stream) == lines
    too_long = sum(len(line) > pipe.LINE_LIMIT for line in stream.split(b"\n"))
    assert (cut.dropped, whole.dropped) == (too_long, too_long)
