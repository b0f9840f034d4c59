"""Reports immediately that the graph may have changed, without polling.

rclpy has no way to wait for the graph; rcl has one since Foxy, a guard condition of each node. It is added by its C
function to a wait set that rclpy created. If any of this is missing there are no events, and the poll of each tick
finds the changes.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from typing import Any

BURST_S = 0.1
"""Changes come in bursts when nodes start: one event immediately, then one for all others within this time."""
FAREWELL_S = 0.5


class GraphEvents:
    """`fd` becomes readable after a change; None without events. `take` makes it unreadable again."""

    def __init__(self, node: Any, context: Any) -> None:
        self.fd: int | None = None
        self._stopping = threading.Event()
        try:
            self._wait_set = _wait_set(context)
            self._stop = _guard(context)
            self._add = _adder(node, self._wait_set)
        except Exception:  # another distribution or middleware: pybind and ctypes raise any type
            return
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="phm-graph", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:  # the limit of processes is reached: the poll of each tick must suffice
            os.close(self.fd)
            self.fd = None

    def take(self) -> None:
        """Mark the event as processed."""
        if self.fd is not None:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self.fd)

    def close(self) -> None:
        """Call before the node is destroyed."""
        if self.fd is None:
            return
        self._stopping.set()
        self._stop.trigger_guard_condition()
        self._thread.join(FAREWELL_S)
        if not self._thread.is_alive():  # it would write to another file of this number
            os.close(self.fd)
            self.fd = None

    def _run(self) -> None:
        assert self.fd is not None
        while not self._stopping.is_set():
            try:
                self._wait_set.clear_entities()
                self._wait_set.add_guard_condition(self._stop)
                self._add()
                self._wait_set.wait(-1)
            except Exception:  # the context is gone
                return
            if not self._stopping.is_set():
                os.eventfd_write(self.fd, 1)
                self._stopping.wait(BURST_S)


def _wait_set(context: Any) -> Any:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    with context.handle:
        return rclpy_implementation.WaitSet(0, 2, 0, 0, 0, 0, context.handle)


def _guard(context: Any) -> Any:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    with context.handle:
        return rclpy_implementation.GuardCondition(context.handle)


def _adder(node: Any, wait_set: Any) -> Any:
    """A function that adds the node's graph guard condition to the wait set. Raises if the library has another layout."""
    library = ctypes.CDLL("librcl.so")
    get, add = library.rcl_node_get_graph_guard_condition, library.rcl_wait_set_add_guard_condition
    get.restype, get.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
    add.restype, add.argtypes = ctypes.c_int, (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    condition = get(node.handle.pointer)
    if not condition:
        raise OSError("the node has no guard condition of the graph")

    def put() -> None:
        if add(wait_set.pointer, condition, None):
            raise OSError("the wait set does not take it")

    return put
