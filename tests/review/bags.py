"""Recordings of ROS 2 for tests, written by the libraries mcap and rosbags with rosbags' own serializer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tests.review.records import T0

JAZZY = get_typestore(Stores.ROS2_JAZZY)
ARRAY, LOG, SCAN = "diagnostic_msgs/msg/DiagnosticArray", "rcl_interfaces/msg/Log", "std_msgs/msg/String"
Message = tuple[float, str, str, bytes]
"""Seconds since T0, topic, type, CDR."""


def diagnostics(at: float, name: str, level: int, message: str = "", **values: str) -> Message:
    return at, "/diagnostics", ARRAY, array((name, level, message, values))


def array(*statuses: tuple[str, int, str, dict[str, str]]) -> bytes:
    types = JAZZY.types
    header = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=1, nanosec=2), frame_id="")
    made = [
        types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=level,
            name=name,
            message=message,
            hardware_id="h",
            values=[types["diagnostic_msgs/msg/KeyValue"](*pair) for pair in values.items()],
        )
        for name, level, message, values in statuses
    ]
    return bytes(JAZZY.serialize_cdr(types[ARRAY](header=header, status=made), ARRAY))


def log(at: float, node: str, level: int, message: str) -> Message:
    types = JAZZY.types
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    made = types[LOG](stamp=stamp, level=level, name=node, msg=message, file="f.cpp", function="main", line=7)
    return at, "/rosout", LOG, bytes(JAZZY.serialize_cdr(made, LOG))


def scan(at: float, text: str = "x", topic: str = "/scan") -> Message:
    return at, topic, SCAN, bytes(JAZZY.serialize_cdr(JAZZY.types[SCAN](data=text), SCAN))


def flight() -> list[Message]:
    """100 s: /scan every 0.1 s with a gap of 4 s from 40.0 s on; a status that fails and recovers; errors in /rosout."""
    found = [scan(number / 10) for number in range(1001) if not 400 < number < 440]
    found += [
        diagnostics(1.0, "camera: Status", 0, "fine"),
        diagnostics(30.0, "camera: Status", 2, "no frames"),
        diagnostics(31.0, "camera: Status", 2, "no frames"),
        diagnostics(50.0, "camera: Status", 0, "fine"),
        diagnostics(60.0, "lidar: Status", 3, "no data"),
        log(20.0, "planner", 20, "an information"),
        log(41.0, "planner", 40, "no scan since 1 s"),
        log(41.5, "planner", 40, "no scan since 1 s"),
        log(70.0, "driver", 50, "port is gone"),
    ]
    return sorted(found, key=lambda message: message[0])


SAID = [
    (30.0, "diagnostic", "camera: Status: no frames", "ERROR"),
    (40.0, "gap", "/scan: no message for 4.00 s, median period 0.100 s", "WARN"),
    (41.0, "rosout", "planner: no scan since 1 s", "ERROR"),
    (50.0, "diagnostic", "camera: Status: OK: fine", ""),
    (60.0, "diagnostic", "lidar: Status: STALE: no data", "STALE"),
    (70.0, "rosout", "FATAL: driver: port is gone", "ERROR"),
]
"""What the report has of `flight`, without topics."""


def stamp(at: float) -> int:
    return round((T0 + at) * 1e6) * 1000


def rosbag2(
    folder: Path, messages: Iterable[Message], storage: StoragePlugin = StoragePlugin.SQLITE3, compression: Any = None
) -> Path:
    """Write a bag, and return its only file of messages. compression: (mode, format)."""
    bag = Writer(folder, version=9, storage_plugin=storage)
    if compression is not None:
        bag.set_compression(*compression)
    with bag:
        known: dict[str, Any] = {}
        for at, topic, kind, data in messages:
            if topic not in known:
                known[topic] = bag.add_connection(topic, kind, typestore=JAZZY)
            bag.write(known[topic], stamp(at), data)
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    return file


def mcap(
    path: Path,
    messages: Iterable[Message],
    compression: CompressionType = CompressionType.ZSTD,
    *,
    chunk: int = 4096,
    encoding: str = "cdr",
    schemas: bool = True,
    chunks: bool = True,
    stop: bool = True,
) -> Path:
    """stop: False leaves out what a recorder writes at its end."""
    with path.open("wb") as stream:
        writer: Any = McapWriter(stream, chunk_size=chunk, compression=compression, use_chunking=chunks)
        writer.start(profile="ros2", library="test")
        known: dict[str, int] = {}
        for number, (at, topic, kind, data) in enumerate(messages):
            if topic not in known:
                definition = JAZZY.generate_msgdef(kind)[0] if encoding == "cdr" else "{}"
                schema = writer.register_schema(kind, "ros2msg", definition.encode()) if schemas else 0
                known[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(known[topic], stamp(at), data, stamp(at), number)
        if stop:
            writer.finish()
    return path
