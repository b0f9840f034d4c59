"""Publishes forged samples on the topic with node names of the rmw layer, `ros_discovery_info`, twice a second.

python tests/fakes/ros_discovery_forger.py COUNT [BAD [STALE]]

Its own node is `/elsewhere/forger`, which has an endpoint. Its participant claims COUNT nodes in `/x`, and with BAD one
whose name is not UTF-8: `node`, or `topic`, which gives that name to the publisher of /agent_1/topic_1 too;
with `name` a topic has such a name instead, with `refused` one that ROS does not allow. With STALE, a participant that
does not exist claims one node of this full name instead, as in the last announcement of a node that is processed after
its end.

rclpy does not support this topic, which has no `rt/` prefix: it is accessed through rmw's C functions.
"""

from __future__ import annotations

import ctypes
import sys
import time
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rmw_dds_common.msg import Gid, NodeEntitiesInfo, ParticipantEntitiesInfo
from std_msgs.msg import String

TOPIC = b"ros_discovery_info"
PLACEHOLDER, NO_UTF8 = "no_utf_8_at_all", b"no_\xff\xfe_utf_at_all"
BAD_TOPICS = {"name": b"rt/" + NO_UTF8, "refused": b"rt/arm-state"}


class _Time(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_uint64), ("nsec", ctypes.c_uint64))


class _Quality(ctypes.Structure):
    """rmw_qos_profile_t."""

    _fields_ = (
        ("history", ctypes.c_int),
        ("depth", ctypes.c_size_t),
        ("reliability", ctypes.c_int),
        ("durability", ctypes.c_int),
        ("deadline", _Time),
        ("lifespan", _Time),
        ("liveliness", ctypes.c_int),
        ("lease", _Time),
        ("avoid_ros_namespace_conventions", ctypes.c_bool),
    )


class _Options(ctypes.Structure):
    """rmw_publisher_options_t, with room for additions of later versions."""

    _fields_ = (("payload", ctypes.c_void_p), ("unique", ctypes.c_int), ("room", ctypes.c_byte * 64))


class _Bytes(ctypes.Structure):
    """rmw_serialized_message_t; its allocator is not used."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


def forged_publisher(node: Any, topic: bytes = TOPIC) -> Any:
    """A function that publishes bytes as a sample of this DDS topic, by default the discovery topic."""
    rcl, rmw = ctypes.CDLL("librcl.so"), ctypes.CDLL("librmw_fastrtps_cpp.so")
    support = ctypes.CDLL("librmw_dds_common__rosidl_typesupport_c.so")
    type_support = (
        support.rosidl_typesupport_c__get_message_type_support_handle__rmw_dds_common__msg__ParticipantEntitiesInfo
    )
    for function in (type_support, rcl.rcl_node_get_rmw_handle, rmw.rmw_create_publisher):
        function.restype = ctypes.c_void_p
    rcl.rcl_node_get_rmw_handle.argtypes = (ctypes.c_void_p,)
    rmw.rmw_create_publisher.argtypes = (
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_void_p,
        ctypes.c_void_p,
    )
    rmw.rmw_publish_serialized_message.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    quality = _Quality(1, 1, 1, 1, avoid_ros_namespace_conventions=True)  # keep last 1, reliable, transient local
    options = _Options()
    publisher = rmw.rmw_create_publisher(
        rcl.rcl_node_get_rmw_handle(node.handle.pointer),
        type_support(),
        topic,
        ctypes.byref(quality),
        ctypes.byref(options),
    )
    assert publisher, "no publisher on the discovery topic"

    def publish(data: bytes) -> None:
        message = _Bytes(data, len(data), len(data))
        assert not rmw.rmw_publish_serialized_message(publisher, ctypes.byref(message), None)

    return publish


def gid_of(info: Any) -> Any:
    data = bytes(info.endpoint_gid)
    size = len(Gid().data)
    return Gid(data=list(data[:size].ljust(size, b"\0")))


def stale_announcement(full_name: str, participant: Any) -> bytes:
    """The sample of a participant that differs from this one in the bytes of its process."""
    namespace, _, name = full_name.rpartition("/")
    gid = Gid(data=[*participant.data[:8], *(255 - byte for byte in participant.data[8:12]), *participant.data[12:]])
    info = NodeEntitiesInfo(node_namespace=namespace, node_name=name)
    return bytes(serialize_message(ParticipantEntitiesInfo(gid=gid, node_entities_info_seq=[info])))


def main(count: str, bad: str = "", stale: str = "") -> int:
    rclpy.init(args=[])
    node = rclpy.create_node("forger", namespace="/elsewhere")
    publish = forged_publisher(node)
    own = node.create_publisher(
        String, "/agent_1/topic_1" if bad == "topic" else "/elsewhere/topic", QoSProfile(depth=1)
    )
    while not (infos := node.get_publishers_info_by_topic(own.topic_name)):
        time.sleep(0.05)
    writer = next(gid_of(info) for info in infos if info.node_name == "forger")
    participant = Gid(data=[*writer.data[:12], 0, 0, 1, 0xC1, *[0] * (len(writer.data) - 16)])
    nodes = [NodeEntitiesInfo(node_namespace="/x", node_name=f"{'n' * 200}_{i}") for i in range(int(count))]
    if bad in BAD_TOPICS:
        forged_publisher(node, BAD_TOPICS[bad])
    elif bad:
        nodes.append(
            NodeEntitiesInfo(
                node_namespace="/x", node_name=PLACEHOLDER, writer_gid_seq=[writer] if bad == "topic" else []
            )
        )
    data = serialize_message(ParticipantEntitiesInfo(gid=participant, node_entities_info_seq=nodes))
    data = data.replace(PLACEHOLDER.encode(), NO_UTF8.ljust(len(PLACEHOLDER), b"_")[: len(PLACEHOLDER)])
    if stale:
        data = stale_announcement(stale, participant)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    while rclpy.ok():
        publish(data)
        own.publish(String(data="x"))
        time.sleep(0.5)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
