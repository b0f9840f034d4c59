"""Takes messages of one subscription as bytes, each with the identity (gid) of its writer.

rclpy provides the identity from Kilted on. In earlier versions it is read through rcl's C function. If neither works,
there is none. Runs only in the child.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

Taken = tuple[bytes, bytes | None, int]
"""The serialized message, its writer, and when the middleware received it: nanoseconds of the system clock."""
GID_BYTES = 16
_KEPT_BYTES = 200_000
"""A buffer that a longer message has enlarged is released."""
NO_SEQUENCE = 2**64 - 1
"""RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED."""


class MessageInfo(ctypes.Structure):
    """rmw_message_info_t since Galactic, with space for new fields."""

    _fields_ = (
        ("source_ns", ctypes.c_int64),
        ("received_ns", ctypes.c_int64),
        ("publication", ctypes.c_uint64),
        ("reception", ctypes.c_uint64),
        ("implementation", ctypes.c_char_p),
        ("gid", ctypes.c_uint8 * GID_BYTES),
        ("room", ctypes.c_uint8 * 192),
    )


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t: four functions and a state."""

    _fields_ = (("parts", ctypes.c_void_p * 5),)


class _Message(ctypes.Structure):
    """The C type rcl_serialized_message_t."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class MessageTaker:
    """Takes serialized messages from one raw subscription that no executor spins."""

    def __init__(self, subscription: Any) -> None:
        self._subscription = subscription
        self._by_rcl: Callable[[], Taken | None] | None = None
        self._tried = False

    def take(self) -> Taken | None:
        """The oldest message in the queue; None if it is empty."""
        if self._by_rcl is not None:
            return self._by_rcl()
        taken = self._subscription.handle.take_message(self._subscription.msg_type, True)
        if taken is None:
            return None
        data, info = taken
        gid = info.get("publisher_gid")
        if isinstance(gid, dict):
            gid = gid.get("data")
        if not gid and not self._tried:
            self._tried = True
            self._by_rcl = by_rcl(self._subscription.handle.pointer)
        return data, bytes(gid)[:GID_BYTES] if gid else None, int(info["received_timestamp"])


def by_rcl(subscription: int) -> Callable[[], Taken | None] | None:
    """The same through the C function, with rcl's pointer; None if the libraries have another layout."""
    taker = RclTaker.opened(subscription)
    if taker is None:
        return None

    def take() -> Taken | None:
        taken = taker.take()
        return None if taken is None else (taken[0], bytes(taken[1].gid), int(taken[1].received_ns))

    return take


class RclTaker:
    """Takes messages through the C function. Its buffer is released by `close`, not before."""

    def __init__(self, subscription: int, rcl: Any, rcutils: Any) -> None:
        self._subscription = subscription
        self._ask, self._release, self._begin = (
            rcl.rcl_take_serialized_message,
            rcutils.rcutils_uint8_array_fini,
            rcutils.rcutils_uint8_array_init,
        )
        default = rcutils.rcutils_get_default_allocator
        self._ask.restype, self._ask.argtypes = ctypes.c_int, (ctypes.c_void_p,) * 4
        self._begin.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
        self._release.argtypes = (ctypes.c_void_p,)
        default.restype = _Allocator
        self._allocator = default()
        self._message, self._info = _Message(), MessageInfo()

    @classmethod
    def opened(cls, subscription: int) -> RclTaker | None:
        """For rcl's pointer; None if the libraries have another layout."""
        try:
            taker = cls(subscription, ctypes.CDLL("librcl.so"), ctypes.CDLL("librcutils.so"))
        except (OSError, AttributeError):
            return None
        return taker if taker._empty() else None

    def take(self) -> tuple[bytes, MessageInfo] | None:
        """The oldest message in the queue, and its information, which the next call overwrites; None if it is empty."""
        message = self._message
        if self._ask(self._subscription, ctypes.byref(message), ctypes.byref(self._info), None):
            return None
        data = ctypes.string_at(message.buffer, message.length)
        if message.capacity > _KEPT_BYTES:
            self.close()
            self._empty()
        return data, self._info

    def close(self) -> None:
        self._release(ctypes.byref(self._message))

    def _empty(self) -> bool:
        return not self._begin(ctypes.byref(self._message), 0, ctypes.byref(self._allocator))
