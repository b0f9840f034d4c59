"""Fields of real message types: what is decoded, and what is refused without an exception."""

from __future__ import annotations

import random
import sys
from collections.abc import Mapping
from typing import Any

import pytest

from phm.core.message_fields import fields_of, has_header, has_other_stamps
from phm.facts import FieldFact
from phm.probes.ros.data.data_monitor import DataMonitor
from phm.probes.ros.data.decoder import MAX_DECODED, Decoder, Undecodable, _content, class_fields
from phm.probes.ros.data.raw_message import digest, stamp_ns
from phm.probes.ros.protocol import WantedData, WantedRange
from phm.probes.ros.reader import RawMessage

# The parser in ROS's generated messages imports a module that Python has deprecated.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

TWIST = "geometry_msgs/msg/TwistStamped"


def serialized(x: float = 1.0, seconds: int = 7, frame: str = "base") -> bytes:
    from geometry_msgs.msg import TwistStamped
    from rclpy.serialization import serialize_message

    message = TwistStamped()
    message.header.stamp.sec, message.header.frame_id = seconds, frame
    message.twist.linear.x = x
    return bytes(serialize_message(message))


def decoder(type_name: str = TWIST, counter: str = "", **ranges: tuple[float | None, float | None]) -> Decoder:
    limits = tuple(WantedRange(name.replace("__", "."), *pair) for name, pair in ranges.items())
    return Decoder(WantedData(frozen_s=1.0, counter=counter, ranges=limits), type_name)


def outside(x: float, low: float | None, high: float | None) -> Mapping[str, str]:
    return decoder(twist__linear__x=(low, high)).read(serialized(x))[1]


def test_the_stamp_is_that_of_a_real_message() -> None:
    """Whatever follows it, and with any frame."""
    for frame in ("", "a", "odom", "größer"):
        assert stamp_ns(serialized(seconds=12, frame=frame)) == 12_000_000_000


@pytest.mark.parametrize(
    "name", [TWIST, "geometry_msgs/msg/PoseWithCovariance", "diagnostic_msgs/msg/KeyValue", "std_msgs/msg/Empty"]
)
def test_the_text_of_a_module_has_the_fields_of_its_class(name: str) -> None:
    """`phm validate` and the child agree."""
    assert fields_of(name) == class_fields(name)


def test_a_header_alone_is_compared_with_its_stamp() -> None:
    """Without it, only the name of its frame is left, which never changes: a healthy topic would be frozen."""
    assert has_other_stamps("std_msgs/msg/Header", class_fields) is False


def test_types_with_and_without_a_header_are_known() -> None:
    """None for a type that is not installed."""
    assert [has_header(name) for name in (TWIST, "std_msgs/msg/String", "absent_msgs/msg/X")] == [
        True,
        False,
        None,
    ]


@pytest.mark.parametrize(
    ("x", "low", "high", "text"),
    [
        (5.0, -5.0, 5.0, ""),
        (5.5, -5.0, 5.0, "5.5"),
        (-6.0, None, 5.0, ""),
        (6.0, None, 5.0, "6"),
        (float("inf"), 0.0, None, ""),
        (float("inf"), 0.0, 1e300, "inf"),
        (float("nan"), None, None, "nan"),
    ],
)
def test_a_value_is_compared_with_its_range(x: float, low: float | None, high: float | None, text: str) -> None:
    """The limits belong to the range; NaN never does."""
    assert outside(x, low, high) == ({"twist.linear.x": text} if text else {})


@pytest.mark.parametrize(
    ("name", "field", "value", "text"),
    [
        ("PoseWithCovariance", "covariance", [0.0] * 35 + [-1.0], "-1"),
        ("PoseWithCovariance", "covariance", [0.0] * 36, ""),
        ("PolygonStamped", "polygon.points", None, None),
    ],
)
def test_each_element_of_an_array_counts(name: str, field: str, value: Any, text: str | None) -> None:
    """Of numbers; an array of messages is refused."""
    import geometry_msgs.msg
    from rclpy.serialization import serialize_message

    found = Decoder(WantedData(ranges=(WantedRange(field, 0.0, None),)), f"geometry_msgs/msg/{name}")
    if text is None:
        assert "not a number" in found.problem and not found.usable
        return
    message = getattr(geometry_msgs.msg, name)(**{field: value})
    assert found.read(bytes(serialize_message(message)))[1] == ({field: text} if text else {})


def test_the_range_of_an_element_is_examined() -> None:
    """By its index, also of a field of a message in an array. One that a message lacks is said, and hides nothing else."""
    from geometry_msgs.msg import Point32, PolygonStamped
    from rclpy.serialization import serialize_message

    message = PolygonStamped()
    message.polygon.points = [Point32(x=1.0), Point32(x=2.0, y=7.0)]
    names = ("polygon.points[0].x", "polygon.points[9].x", "polygon.points[1].x", "polygon.points[1].y")
    wanted = WantedData(ranges=tuple(WantedRange(name, 2.0, None) for name in names), fields=("polygon.points[1].y",))
    found = Decoder(wanted, "geometry_msgs/msg/PolygonStamped").read(bytes(serialize_message(message)))
    assert found.outside == {"polygon.points[0].x": "1"} and found.fields[0].low == 7.0
    assert found.problem == "points has 2 elements in the newest message, none with index 9"


@pytest.mark.parametrize("counter", ["twist.linear.x", ""])
def test_bytes_between_fields_are_not_content(counter: str) -> None:
    """Nothing writes those before an aligned number, so equal messages differ in them."""
    found = decoder(counter=counter, twist__linear__y=(None, 1.0))
    message = serialized(frame="sensor")
    end = message.index(b"sensor") + len("sensor") + 1
    assert end % 8 == 7
    contents = {
        digest(found.read(message[:end] + padding + message[end + 5 :])[2], header=True)
        for padding in (b"\0\0\0\0\0", b"\1\2\3\4\5")
    }
    assert len(contents) == 1


def fields(message: Any, type_name: str, *names: str) -> dict[str, FieldFact]:
    """The reported values of the fields of a message."""
    from rclpy.serialization import serialize_message

    found = Decoder(WantedData(fields=names), type_name)
    assert found.problem == ""
    return {one.field: one for one in found.read(bytes(serialize_message(message))).fields}


def test_values_of_fields_are_reported() -> None:
    """Numbers, true and false, elements by index, also of messages in arrays, the range of an array, and text, shortened."""
    from geometry_msgs.msg import Point32, PolygonStamped, PoseWithCovariance
    from std_msgs.msg import Bool

    polygon = PolygonStamped()
    polygon.header.stamp.sec, polygon.header.frame_id = 7, "x" * 300
    polygon.polygon.points = [Point32(x=1.0), Point32(x=2.0)]
    found = fields(
        polygon, "geometry_msgs/msg/PolygonStamped", "header.stamp.sec", "header.frame_id", "polygon.points[1].x"
    )
    assert (found["header.stamp.sec"].low, found["polygon.points[1].x"].high) == (7.0, 2.0)
    assert (found["header.frame_id"].low, found["header.frame_id"].text) == (None, "x" * 200)
    pose = PoseWithCovariance(covariance=[float(number) for number in range(36)])
    found = fields(pose, "geometry_msgs/msg/PoseWithCovariance", "covariance", "covariance[35]")
    assert found["covariance"] == FieldFact("covariance", 0.0, 35.0)
    assert found["covariance[35]"] == FieldFact("covariance[35]", 35.0, 35.0)
    assert fields(Bool(data=True), "std_msgs/msg/Bool", "data")["data"] == FieldFact("data", 1.0, 1.0)


def test_values_that_are_no_numbers_are_reported_as_such() -> None:
    """NaN apart, infinity as the largest number: both would end the message to the daemon."""
    from std_msgs.msg import Float64, Float64MultiArray

    array = "std_msgs/msg/Float64MultiArray"
    assert fields(Float64(data=float("nan")), "std_msgs/msg/Float64", "data")["data"] == FieldFact("data", nan=True)
    assert fields(Float64(data=float("-inf")), "std_msgs/msg/Float64", "data")["data"].low == -sys.float_info.max
    some = fields(Float64MultiArray(data=[1.0, float("nan"), 3.0]), array, "data")["data"]
    assert some == FieldFact("data", 1.0, 3.0, nan=True)
    assert fields(Float64MultiArray(), array, "data")["data"] == FieldFact("data")


def test_a_wrong_field_does_not_hide_the_others() -> None:
    """An own check must not end what `ros.topics[].data` examines, or another own check."""
    from geometry_msgs.msg import Point32, PolygonStamped

    polygon = PolygonStamped()
    polygon.polygon.points = [Point32(x=12.0)]
    names = ("polygon.points[0].x", "polygon.volts", "polygon.points[9].x", "header")
    found = fields(polygon, "geometry_msgs/msg/PolygonStamped", *names)
    assert found["polygon.points[0].x"].low == 12.0
    assert "has no field 'volts'; it has points" in found["polygon.volts"].problem
    assert "1 elements in the newest message, none with index 9" in found["polygon.points[9].x"].problem
    assert "not a number or a text" in found["header"].problem
    unknown = Decoder(WantedData(order=True, fields=("x",)), "absent_msgs/msg/X")
    assert (unknown.problem, unknown.usable) == ("", False)
    assert unknown.unreadable[0].problem.startswith("type unknown: its fields cannot be read: absent_msgs/msg/X is not")


def test_a_counter_is_not_content() -> None:
    """It is set to 0 before the content is compared, also a nested one; the rest remains."""
    found = decoder(counter="twist.linear.x")
    contents = {digest(found.read(serialized(number))[2], header=True) for number in range(5)}
    assert found.read(serialized(4.0))[0] == 4.0 and len(contents) == 1
    assert digest(found.read(serialized(1.0, frame="other"))[2], header=True) not in contents
    assert found.read(serialized(float("nan")))[0] is None


def goal(seconds: int, status: int) -> Any:
    from action_msgs.msg import GoalStatus, GoalStatusArray

    one = GoalStatus(status=status)
    one.goal_info.stamp.sec = seconds
    return GoalStatusArray(status_list=[one])


def log(seconds: int, level: int) -> Any:
    from rcl_interfaces.msg import Log

    message = Log(level=level, name="n")
    message.stamp.sec = seconds
    return message


def clock(_: int, level: int) -> Any:
    from rosgraph_msgs.msg import Clock

    message = Clock()
    message.clock.sec = level
    return message


@pytest.mark.parametrize("made", [goal, log, clock])
def test_a_stamp_anywhere_is_not_content(made: Any) -> None:
    """Also in messages of an array, and one that comes first; a message with nothing but a stamp is compared completely."""
    from rclpy.serialization import serialize_message

    kind = type(made(0, 0))
    name = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
    found = Decoder(WantedData(frozen_s=1.0), name)
    assert (found.usable, found.stamped, found.problem) == (True, True, "")
    contents = [
        digest(found.read(bytes(serialize_message(made(*values)))).content, header=False)
        for values in ((1, 1), (2, 1), (2, 2))
    ]
    assert contents[0] == contents[1] != contents[2]


def test_frozen_content_with_a_new_stamp_inside_is_found() -> None:
    """Of a type without a header, in the messages of an array."""
    from rclpy.serialization import serialize_message

    monitor = DataMonitor(WantedData(frozen_s=2.0), 2.0)
    for number in range(8):
        data = bytes(serialize_message(goal(seconds=number, status=2)))
        monitor.update(number / 2, "action_msgs/msg/GoalStatusArray", [RawMessage(data, b"w", 1, number)])
    assert monitor.fact is not None and (monitor.fact.conditions, monitor.fact.problem) == (("data_frozen",), "")


class Px4:
    """As rosidl generates the class of a PX4 message."""

    def __init__(self, timestamp: int, x: float) -> None:
        self.timestamp = self.timestamp_sample = timestamp
        self.x, self.inner = x, Inner(x)

    @classmethod
    def get_fields_and_field_types(cls) -> Mapping[str, str]:
        return {"timestamp": "uint64", "timestamp_sample": "uint64", "x": "float", "inner": "px4_msgs/Inner"}


class Inner:
    def __init__(self, timestamp: float) -> None:
        self.timestamp = timestamp

    @classmethod
    def get_fields_and_field_types(cls) -> Mapping[str, str]:
        return {"timestamp": "double"}


def test_the_stamps_of_px4_are_not_content() -> None:
    """They are numbers of the message itself; others of that name count."""
    contents = [b"".join(_content(Px4(*values), top=True)) for values in ((1, 1.0), (2, 1.0), (2, 2.0))]
    assert contents == [b"1.0,1.0,", b"1.0,1.0,", b"2.0,2.0,"]


@pytest.mark.parametrize(
    ("name", "stamped"), [(TWIST, False), ("geometry_msgs/msg/Twist", False), ("a_msgs/msg/X", None)]
)
def test_a_type_without_other_stamps_is_not_decoded(name: str, stamped: bool | None) -> None:
    """Its messages show without that whether their content changes."""
    found = Decoder(WantedData(frozen_s=1.0), name)
    assert (found.usable, found.stamped, found.problem) == (False, stamped, "")


@pytest.mark.parametrize(
    ("type_name", "counter", "words"),
    [
        (TWIST, "twist.linear.seq", "geometry_msgs/Vector3 has no field 'seq'; it has x, y, z"),
        (TWIST, "header.frame_id", "is of type string, not an integer"),
        ("absent_msgs/msg/X", "seq", "its fields cannot be read: absent_msgs/msg/X is not installed beside PHM"),
    ],
)
def test_a_field_that_does_not_exist_is_a_problem(type_name: str, counter: str, words: str) -> None:
    """A text for the operator, and nothing is decoded."""
    found = decoder(type_name, counter)
    assert words in found.problem and not found.usable


def test_hostile_messages_are_refused() -> None:
    """Random, truncated and too long ones: an error, never another exception, and never an endless time."""
    source, found = random.Random(3), decoder("diagnostic_msgs/msg/DiagnosticArray", counter="header.stamp.sec")
    real = serialized()
    cases = [real[:length] for length in range(len(real))]
    cases += [source.randbytes(source.randrange(200)) for _ in range(500)]
    cases += [real[:16] + b"\xff\xff\xff\xff" + real[20:], bytes(MAX_DECODED + 1), b"\0\1\0\0" + b"\xff" * MAX_DECODED]
    for case in cases:
        try:
            found.read(case)
        except Undecodable:
            continue
    with pytest.raises(Undecodable, match="more than 200 kB"):
        found.read(bytes(MAX_DECODED + 1))
