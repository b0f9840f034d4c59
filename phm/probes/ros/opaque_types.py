"""Creates a message class for any type from its name alone, for a reader that never decodes a message.

A reader that does not decode needs only the name of the type, by which the middleware matches readers and writers. So
this module copies the type support of a type that rclpy always has, and changes the two names. The copy is C memory of
the middleware; nothing of it is used before it was compared with the expected values.

Layouts: rosidl_runtime_c/message_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/message_type_support.h. Runs
only in the child.
"""

from __future__ import annotations

import ctypes
import os
import re
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MIDDLEWARE = "rmw_fastrtps_cpp"
KNOWN: dict[tuple[str, str], tuple[str, bool]] = {
    # Fast DDS 2 builds a description of the type from it, and fails without; it is never sent.
    ("fastrtps", "2.14"): ("jazzy", True),
    # Fast DDS 3 sends that description, and a writer of another one then does not match. Without it only the name counts.
    ("fastdds", "3.2"): ("kilted", False),
}
"""Library and version of Fast DDS -> distribution, and whether it needs the introspection of the copied type."""
MAX_TYPES = 500
"""Names come from outside, and classes are never freed: the middleware may keep pointers after a reader is closed."""

_LIBRARY = re.compile(r"/lib(fastrtps|fastdds)\.so\.(\d+\.\d+)[^/]*$")
_BASE = ("rcl_interfaces", "msg", "SetParametersResult")
_FASTRTPS, _C_INTROSPECTION = b"rosidl_typesupport_fastrtps_c", b"rosidl_typesupport_introspection_c"
_HANDLE = struct.Struct("<6Q")
"""identifier, data, func, get_type_hash_func, get_type_description_func, get_type_description_sources_func."""
_CALLBACKS = struct.Struct("<7Q")
"""namespace, name, serialize, deserialize, size, maximum size, callbacks for keys (none)."""
_HASH_VALUE_SIZE = 32

_Ask = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_GetHash = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
_capsule_pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)
_new_capsule = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)(
    ("PyCapsule_New", ctypes.pythonapi)
)


class TypeUnavailable(Exception):
    """A class for any type cannot be created here; the text says why."""


class OpaqueTypes:
    """Creates classes by name. `make` raises NotHere if the middleware is not supported."""

    def __init__(self) -> None:
        self._base: _Base | None = None
        self._made: dict[str, Any] = {}
        self._kept: list[Any] = []

    def make(self, package: str, kind: str, short: str, type_hash: bytes = b"") -> Any:
        """The class of `package/kind/short`, for raw readers. type_hash: 32 bytes that its publisher reports, or empty."""
        name = f"{package}/{kind}/{short}"
        if name not in self._made:
            if len(self._made) >= MAX_TYPES:
                raise TypeUnavailable(f"more than {MAX_TYPES} types were seen")
            self._base = self._base or _Base.found()
            self._made[name] = self._build(self._base, f"{package}::{kind}", short, type_hash)
        return self._made[name]

    def _build(self, base: _Base, namespace: str, short: str, type_hash: bytes) -> Any:
        texts = [ctypes.create_string_buffer(text.encode()) for text in (namespace, short)]
        members = list(base.callbacks)
        members[0:2] = [ctypes.addressof(text) for text in texts]
        callbacks = ctypes.create_string_buffer(_CALLBACKS.pack(*members), _CALLBACKS.size)
        handle = ctypes.create_string_buffer(_HANDLE.size)
        ask = _Ask(_answers(ctypes.addressof(handle), base.introspection))
        fields = list(base.handle)
        fields[1], fields[2] = ctypes.addressof(callbacks), _address(ask)
        if len(type_hash) == _HASH_VALUE_SIZE:
            hash_value = ctypes.create_string_buffer(b"\1" + type_hash, 1 + _HASH_VALUE_SIZE)
            get_hash = _GetHash(_constant(ctypes.addressof(hash_value)))
            fields[3] = _address(get_hash)
            self._kept += [hash_value, get_hash]
        handle.raw = _HANDLE.pack(*fields)
        self._kept += [*texts, callbacks, handle, ask]
        return _message_class(ctypes.addressof(handle))


@dataclass(frozen=True, slots=True)
class _Base:
    """The copied parts. handle, callbacks: the C structures. introspection: address of that handle; None: not used."""

    handle: tuple[int, ...]
    callbacks: tuple[int, ...]
    introspection: int | None

    @classmethod
    def found(cls) -> _Base:
        """Raises NotHere if anything differs from the expected values."""
        needs_introspection = _known_middleware()
        _demand(
            sys.byteorder == "little" and ctypes.sizeof(ctypes.c_void_p) == 8,
            "this is not a 64-bit little-endian machine",
        )
        try:
            ask = ctypes.CDLL("librosidl_runtime_c.so").get_message_typesupport_handle
        except (OSError, AttributeError) as error:
            raise TypeUnavailable(f"the middleware differs from the supported one ({error})") from error
        ask.restype, ask.argtypes = ctypes.c_void_p, (ctypes.c_void_p, ctypes.c_char_p)
        original = _base_pointer()
        _demand(
            _text(_HANDLE.unpack(_peek(original, _HANDLE.size))[0]) == b"rosidl_typesupport_c", "its handle differs"
        )
        address = ask(original, _FASTRTPS)
        _demand(address is not None, "it has no type support of Fast DDS")
        handle = _HANDLE.unpack(_peek(address, _HANDLE.size))
        _demand(_text(handle[0]) == _FASTRTPS, "its handle differs")
        callbacks = _CALLBACKS.unpack(_peek(handle[1], _CALLBACKS.size))
        names = (_text(callbacks[0]), _text(callbacks[1]))
        _demand(names == (f"{_BASE[0]}::{_BASE[1]}".encode(), _BASE[2].encode()), "unexpected offset of its names")
        _demand(callbacks[6] == 0, "it has a key")
        code = _code()
        _demand(
            all(any(start <= at < end for start, end in code) for at in (*handle[2:], *callbacks[2:6])),
            "unexpected offset of its functions",
        )
        introspection = ask(original, _C_INTROSPECTION) if needs_introspection else None
        _demand(not needs_introspection or introspection is not None, "it has no introspection")
        return cls(handle, callbacks, introspection)


def _known_middleware() -> bool:
    """Whether introspection is needed. Raises NotHere."""
    from rclpy.utilities import get_rmw_implementation_identifier

    used = get_rmw_implementation_identifier()
    if used != MIDDLEWARE:
        raise TypeUnavailable(f"the middleware is {used}, not {MIDDLEWARE}")
    loaded = {match.groups() for line in _maps() if (match := _LIBRARY.search(line))}
    known = [KNOWN[library] for library in loaded if library in KNOWN]
    if len(loaded) != 1 or not known:
        versions = ", ".join(sorted(" ".join(library) for library in loaded)) or "none"
        raise TypeUnavailable(f"this version of Fast DDS is not known ({versions})")
    distribution, needs_introspection = known[0]
    named = os.environ.get("ROS_DISTRO", distribution)
    if named != distribution:
        raise TypeUnavailable(f"the distribution is {named}, and its Fast DDS that of {distribution}")
    return needs_introspection


def _base_pointer() -> int:
    from rcl_interfaces.msg import SetParametersResult
    from rclpy.type_support import check_for_type_support

    check_for_type_support(SetParametersResult)
    address: int = _capsule_pointer(SetParametersResult.__class__._TYPE_SUPPORT, None)
    return address


def _message_class(handle: int) -> Any:
    """A class with the attributes that rclpy requires. Only its type support may be used, so the rest is not a capsule."""
    functions = ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
    members = {**dict.fromkeys(functions, "raw readers only"), "_TYPE_SUPPORT": _new_capsule(handle, None, None)}
    return type("AnyTypeMeta", (type,), members)("AnyType", (), {})


def _answers(own: int, introspection: int | None) -> Callable[[int, bytes], int | None]:
    answers = {_FASTRTPS: own, _C_INTROSPECTION: introspection}
    return lambda _, identifier: answers.get(identifier)


def _constant(address: int) -> Callable[[int], int]:
    return lambda _: address


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def _demand(holds: bool, otherwise: str) -> None:
    if not holds:
        raise TypeUnavailable(f"the middleware's memory has an unknown layout: {otherwise}")


def _peek(address: int, size: int) -> bytes:
    """Memory of this process. Raises NotHere where a direct read would crash the process."""
    try:
        with open("/proc/self/mem", "rb", buffering=0) as memory:
            data = os.pread(memory.fileno(), size, address)
    except (OSError, OverflowError) as error:
        raise TypeUnavailable(f"the middleware's memory has an unknown layout: {error}") from error
    _demand(len(data) == size, "it ends")
    return data


def _text(address: int) -> bytes:
    """The text at an address; reads at most 99 bytes, and not beyond the end of a page."""
    room = min(99, 4096 - address % 4096)
    return _peek(address, room).partition(b"\0")[0]


def _maps() -> list[str]:
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as file:
        return file.read().splitlines()


def _code() -> list[tuple[int, int]]:
    """Start and end of the code segments of this process."""
    ranges = []
    for line in _maps():
        span, mode = line.split(maxsplit=2)[:2]
        if "x" in mode:
            start, _, end = span.partition("-")
            ranges.append((int(start, 16), int(end, 16)))
    return ranges
