"""Reports that the graph may have changed, as soon as the middleware knows, and costs nothing otherwise.

rclpy has no way to wait for the graph; rcl has one since Foxy, a guard condition of each node. It is put by its C function into
a wait set that rclpy made. Where anything of this is missing there are no events, and the looks of each tick see all the same.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from typing import Any

BURST_S = 0.1
"""Changes come in bursts when nodes start: one event at once, then one for all that comes in so long."""
FAREWELL_S = 0.5


class GraphEvents:
    """`fd` becomes readable with a change; None where there are no events. `take` makes it unreadable again."""

    def __init__(self, node: Any, context: Any) -> None:
        self.fd: int | None = None
        self._stopping = threading.Event()
        try:
            self._wait_set = _wait_set(context)
            self._stop = _guard(context)
            self._add = _adder(node, self._wait_set)
        except Exception:  # another distribution or middleware: pybind and ctypes raise what they like
            return
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="phm-graph", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:  # the limit of processes: the looks of each tick have to do
            os.close(self.fd)
            self.fd = None

    def take(self) -> None:
        """The event has been seen."""
        if self.fd is not None:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self.fd)

    def close(self) -> None:
        """Before the node is destroyed."""
        if self.fd is None:
            return
        self._stopping.set()
        self._stop.trigger_guard_condition()
        self._thread.join(FAREWELL_S)

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
    """A function that puts the node's graph guard condition into the wait set. Raises where the library is not as known."""
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
