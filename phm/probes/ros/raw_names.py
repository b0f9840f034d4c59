"""Node names as bytes, for names that rclpy cannot return: one name that is not UTF-8 makes it raise for all.

They are read through rcl's C functions and escaped. Runs only in the child.
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

LONGEST = 255
"""Characters kept of a name: the maximum length in ROS."""


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t: four functions and a state."""

    _fields_ = (("parts", ctypes.c_void_p * 5),)


class _Strings(ctypes.Structure):
    """The C type rcutils_string_array_t."""

    _fields_ = (
        ("size", ctypes.c_size_t),
        ("data", ctypes.POINTER(ctypes.c_char_p)),
        ("allocator", _Allocator),
    )


def raw_node_names(node: Any) -> list[tuple[str, str]]:
    """Like `get_node_names_and_namespaces`. Raises OSError or AttributeError if the libraries have another layout."""
    ask, free, allocator = _functions()
    names, namespaces = _Strings(), _Strings()
    if ask(node.handle.pointer, allocator, ctypes.byref(names), ctypes.byref(namespaces)):
        raise OSError("rcl does not list the names of nodes")
    try:
        return [(_text(names.data[i]), _text(namespaces.data[i])) for i in range(min(names.size, namespaces.size))]
    finally:
        free(ctypes.byref(names))
        free(ctypes.byref(namespaces))


def printable(name: str) -> str:
    """A name from outside as ASCII without control characters, at most LONGEST characters."""
    name = name[:LONGEST]
    if name.isascii() and name.isprintable():
        return name
    return "".join(char if char.isascii() and char.isprintable() else _escaped(char) for char in name)[:LONGEST]


def undecodable(error: UnicodeDecodeError) -> str:
    """The text that could not be decoded, with its bytes escaped."""
    return _text(bytes(error.object))


def _text(raw: bytes | None) -> str:
    return printable((raw or b"").decode("utf-8", "backslashreplace"))


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode()


@functools.cache
def _functions() -> tuple[Any, Any, _Allocator]:
    rcl, rcutils = ctypes.CDLL("librcl.so"), ctypes.CDLL("librcutils.so")
    ask, free, default = (
        rcl.rcl_get_node_names,
        rcutils.rcutils_string_array_fini,
        rcutils.rcutils_get_default_allocator,
    )
    ask.restype, ask.argtypes = ctypes.c_int, (ctypes.c_void_p, _Allocator, ctypes.c_void_p, ctypes.c_void_p)
    free.argtypes = (ctypes.c_void_p,)
    default.restype = _Allocator
    return ask, free, default()
