"""A beacon for rclpy nodes: one line makes a node report that it runs, that its executor works, and which nodes it receives.

    from phm.beacon import Beacon      # or `from beacon import Beacon`, with this one file copied beside the node

    Beacon(node)

It needs rclpy alone, from Humble on. All nodes of a process share one thread and one hidden ROS node. Five times a
second they send a heartbeat on `/phm/beacon`, which PHM receives; less often they greet each other on `/phm/hello`, and
the heartbeat contains which greetings arrived. The messages are `rcl_interfaces/msg/Log`, which comes with rclpy itself; docs/reference/ros.md has their text.

The thread is not the executor's: a process whose executor hangs still sends heartbeats, and says for how long it has hung,
while one that is dead or stopped is silent. Nothing here blocks the application, and nothing is raised into it but
ValueError for a wrong argument. `PHM_BEACON=off` in the environment turns every beacon off.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import re
import threading
import time
import uuid
import weakref
from collections.abc import Iterator
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

BEACON, BEACON_FORMAT = "/phm/beacon", "phm.beacon/1"
HELLO, HELLO_FORMAT = "/phm/hello", "phm.hello/1"

PERIOD_S = 0.2
PERIODS_S = (0.05, 10.0)
"""Shortest and longest allowed period."""
TURN_S = 1.0
"""How often the executor is asked to turn. Each time wakes it up, and it costs more the more the node has."""
FIRST_TURN_S = 0.05
"""The first one comes soon: an executor that hangs before it is taken for one that was never started."""
VIEWS_S = 1.0
"""How often a heartbeat contains the neighbours."""
HELLO_S = 0.8
HELLO_SHARE_S = 0.05
"""A greeting every HELLO_S, or HELLO_SHARE_S for each process where that is longer: so no listener receives more
than 20 a second. Each costs about 0.3 ms with all that the middleware does for it."""
SILENT_HELLOS = 3.0
"""A neighbour that is silent for this many of its periods is not alive."""
FORGET_S = 60.0
MAX_NODES = 50
"""In one message; a process with more sends several."""
MAX_NEIGHBOURS = 50
"""Most nodes in `views`: PHM takes a list of this many as full, and what it does not contain as unknown."""
MAX_TEXT = 40_000
NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
MAX_NAME = 255
MAX_LATE_S = 1e6
QUEUE = 64
"""More greetings than come between two polls."""


class Beacon:
    """Makes `node` known to PHM until it is destroyed, its context is shut down, or `close` is called. Need not be kept.

    period_s: between two heartbeats, 0.05 to 10; the nodes of a process share the shortest. watch_executor: False for
    a node that is spun at times only, and would look hung in between. A node that is never spun never looks hung.

    Raises ValueError for a period that is not allowed. Any other trouble is one warning in the node's log.
    """

    def __init__(self, node: Any, *, period_s: float = PERIOD_S, watch_executor: bool = True) -> None:
        if not PERIODS_S[0] <= period_s <= PERIODS_S[1]:
            raise ValueError(f"period_s is {period_s!r}, allowed are {PERIODS_S[0]:g} to {PERIODS_S[1]:g} seconds")
        self._node_beacon: _NodeBeacon | None = None
        if os.environ.get("PHM_BEACON", "").strip().lower() in ("off", "0", "no", "false"):
            return
        try:
            self._node_beacon = _join(node, period_s, watch_executor)
        except Exception as error:  # a node without a beacon is better than no node
            _warn(node, f"this node has no PHM beacon: {error!r}")

    def close(self) -> None:
        """Fall silent; the node goes on. Safe to call twice."""
        if self._node_beacon is not None:
            self._node_beacon.close()


class _NodeBeacon:
    """One node with a beacon. Written by its executor (`_turn`) and read by the hub's thread."""

    def __init__(self, node: Any, birth: str, watch_executor: bool) -> None:
        self.name: str = node.get_fully_qualified_name()
        self._birth = birth
        self._node = weakref.ref(node)
        self._heartbeats = self._turns = 0
        self._turned_s = 0.0
        self._closed = False
        self._timer: Any = None
        if watch_executor:
            # In the node's default group, so that a callback that never returns there is seen under an executor with
            # several threads too. The steady clock: simulated time may be paused.
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = node.create_timer(FIRST_TURN_S, self._turn, clock=clock)

    def _turn(self) -> None:
        self._turned_s = time.monotonic()
        if not self._turns:
            with contextlib.suppress(Exception):
                self._timer.timer_period_ns = int(TURN_S * 1e9)
        self._turns += 1

    @property
    def over(self) -> bool:
        node = self._node()
        if node is None or self._closed:
            return True
        try:
            with node.handle:  # raises once the node is being destroyed
                return False
        except Exception:
            return True

    def exclude_suspension(self, seconds: float) -> None:
        """The entire process was suspended for this long, which is not its executor's fault."""
        self._turned_s += seconds

    def late_s(self, now_s: float) -> float:
        return round(min(max(0.0, now_s - self._turned_s - TURN_S), MAX_LATE_S), 3) if self._turns else 0.0

    def heartbeat(self, now_s: float) -> dict[str, Any]:
        self._heartbeats += 1
        return {"birth": self._birth, "beats": self._heartbeats, "turns": self._turns, "late_s": self.late_s(now_s)}

    def close(self) -> None:
        self._closed = True
        node, timer, self._timer = self._node(), self._timer, None
        if node is not None and timer is not None:
            with contextlib.suppress(Exception):
                node.destroy_timer(timer)


class _Neighbours:
    """The nodes whose greetings were received. Messages come from outside: anything that is not a greeting is ignored."""

    def __init__(self, witness: str) -> None:
        self._witness = witness
        self._received: dict[str, tuple[str, float, float, float]] = {}
        """By full name: witness, when (monotonic), the period in which it greets, lateness of its executor."""
        self._own: set[str] = set()

    def add_own(self, name: str) -> None:
        """A node of this process: nodes of its first namespace come before others when there are too many."""
        self._own.add(_first_namespace(name))

    @property
    def processes(self) -> int:
        return len({witness for witness, *_ in self._received.values()})

    def receive(self, format_name: str, text: str, at_s: float) -> None:
        if format_name != HELLO_FORMAT or len(text) > MAX_TEXT:
            return
        try:
            said = json.loads(text)
            witness, period_s, nodes = str(said["witness"])[:40], float(said["period_s"]), dict(said["nodes"])
            if witness == self._witness or not 0.0 < period_s <= 60.0 or len(nodes) > MAX_NODES:
                return
            for name, late_s in nodes.items():
                valid = len(name) <= MAX_NAME and NAME.fullmatch(name) and 0.0 <= late_s <= MAX_LATE_S
                if valid and (name in self._received or self._has_space(name)):
                    self._received[name] = (witness, at_s, period_s, float(late_s))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
            return

    def _has_space(self, name: str) -> bool:
        """Whether one more name fits; one of the own namespace takes the place of the longest silent other."""
        if len(self._received) < MAX_NEIGHBOURS:
            return True
        others = [other for other in self._received if _first_namespace(other) not in self._own]
        if not others or _first_namespace(name) not in self._own:
            return False
        del self._received[min(others, key=lambda other: self._received[other][1])]
        return True

    def views(self, now_s: float) -> dict[str, dict[str, Any]]:
        """By full name; nodes that have been silent for long are removed."""
        for name in [name for name, received in self._received.items() if now_s - received[1] > FORGET_S]:
            del self._received[name]
        return {
            name: {
                "alive": now_s - at_s <= SILENT_HELLOS * period_s + VIEWS_S / 4,
                "age_s": round(max(0.0, now_s - at_s), 3),
                "late_s": late_s,
            }
            for name, (_, at_s, period_s, late_s) in self._received.items()
        }


class _Voice:
    """One publisher with its message, which is made once: the cost of a heartbeat matters, five times a second."""

    def __init__(self, node: Any, topic: str, format_name: str) -> None:
        self._publisher = node.create_publisher(Log, topic, _qos(1))
        self._message: Any = Log(level=Log.INFO, name=format_name)
        self._text = json.JSONEncoder(separators=(",", ":")).encode

    def say(self, said: dict[str, Any]) -> None:
        self._message.msg = self._text(said)
        self._publisher.publish(self._message)


class _Hub:
    """The thread and the hidden node that speak and listen for all nodes of one context (so, of one process).

    Invariant: it is in `_hubs` exactly as long as it takes nodes, and only its own thread touches its ROS node.
    """

    def __init__(self, context: Any) -> None:
        self._context = context
        self._witness = uuid.uuid4().hex[:12]
        self._neighbours = _Neighbours(self._witness)
        self._beacons: list[_NodeBeacon] = []
        self._births = 0
        self._period_s = PERIODS_S[1]
        self._next_hello_s = self._listened_s = 0.0
        self._has_news = False
        # Nothing spins this node: what arrives waits in a short queue until the thread polls, and wakes no executor.
        self._node: Any = Node(
            f"_phm_beacon_{self._witness}",
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._beacon = _Voice(self._node, BEACON, BEACON_FORMAT)
        self._hello = _Voice(self._node, HELLO, HELLO_FORMAT)
        self._subscription = self._node.create_subscription(Log, HELLO, _never_called, _qos(QUEUE))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="phm-beacon", daemon=True)

    def add(self, node: Any, period_s: float, watch_executor: bool) -> _NodeBeacon:
        """Add a neighbour. Call with `_lock` held."""
        if self._thread.ident is None:
            self._thread.start()  # raises at a limit of processes: then the next node tries again
        self._births += 1
        beacon = _NodeBeacon(node, f"{self._witness}.{self._births}", watch_executor)
        self._beacons.append(beacon)
        self._neighbours.add_own(beacon.name)
        self._period_s = min(self._period_s, period_s)
        return beacon

    def stop(self, patience_s: float) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(patience_s)

    def _run(self) -> None:
        warned = False
        due_s = time.monotonic()
        while self._has_nodes() and not self._stop.wait(max(0.0, due_s - time.monotonic())):
            now_s = time.monotonic()
            try:
                self._beat(now_s, overslept_s=now_s - due_s)
            except Exception as error:
                if not warned and self._context.ok():
                    _warn(self._node, f"the PHM beacon failed and keeps trying: {error!r}")
                    warned = True
            due_s = max(due_s + self._period_s, now_s)
        with contextlib.suppress(Exception):
            self._node.destroy_node()

    def _has_nodes(self) -> bool:
        with _lock:
            self._beacons = [beacon for beacon in self._beacons if not beacon.over] if self._context.ok() else []
            if not self._beacons or self._stop.is_set():
                _hubs.pop(id(self._context), None)
            return bool(self._beacons)

    def _beat(self, now_s: float, overslept_s: float) -> None:
        """The beat first: it must come, whatever becomes of the rest."""
        beacons = self._beacons
        if overslept_s > TURN_S / 2:
            for beacon in beacons:
                beacon.exclude_suspension(overslept_s)
        views = {"views": self._neighbours.views(now_s)} if self._has_news else {}
        self._has_news = False
        for some in _portions(beacons):
            nodes = {beacon.name: beacon.heartbeat(now_s) for beacon in some}
            said = {"witness": self._witness, "period_s": self._period_s, "nodes": nodes, **views}
            self._beacon.say(said)
        if now_s >= self._next_hello_s:
            self._greet(now_s, beacons)
        if now_s - self._listened_s >= VIEWS_S - self._period_s / 2:
            self._listen(now_s)

    def _greet(self, now_s: float, beacons: list[_NodeBeacon]) -> None:
        period_s = max(HELLO_S, self._period_s, HELLO_SHARE_S * (1 + self._neighbours.processes))
        self._next_hello_s = now_s + period_s - self._period_s / 2
        for some in _portions(beacons):
            nodes = {beacon.name: beacon.late_s(now_s) for beacon in some}
            said = {"witness": self._witness, "period_s": round(period_s, 3), "nodes": nodes}
            self._hello.say(said)

    def _listen(self, now_s: float) -> None:
        """Take what has come since the last poll, oldest first."""
        longest_s, self._listened_s = now_s - self._listened_s, now_s
        self._has_news = True
        wall_ns = time.time_ns()
        subscription = self._subscription.handle
        with subscription:
            for _ in range(QUEUE):
                taken = subscription.take_message(Log, False)
                if taken is None:
                    return
                # The middleware's stamp is of a clock that may be set: it counts within what is possible.
                age_s = (wall_ns - int(taken[1]["received_timestamp"])) / 1e9
                self._neighbours.receive(taken[0].name, taken[0].msg, now_s - min(max(age_s, 0.0), longest_s))


_lock = threading.Lock()
_hubs: dict[int, _Hub] = {}
"""By id of the context, which the hub keeps alive."""


def _join(node: Any, period_s: float, watch_executor: bool) -> _NodeBeacon:
    with _lock:
        hub = _hubs.get(id(node.context))
        if hub is None:
            hub = _hubs[id(node.context)] = _Hub(node.context)
        return hub.add(node, period_s, watch_executor)


def _first_namespace(name: str) -> str:
    """`agent_1` of `/agent_1/nav/planner`; empty for a node without a namespace."""
    return name[1:].partition("/")[0] if name.count("/") > 1 else ""


def _portions(beacons: list[_NodeBeacon]) -> Iterator[list[_NodeBeacon]]:
    return (beacons[at : at + MAX_NODES] for at in range(0, len(beacons), MAX_NODES))


def _qos(depth: int) -> Any:
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.VOLATILE,
    )


def _warn(node: Any, text: str) -> None:
    with contextlib.suppress(Exception):
        node.get_logger().warning(text)


def _never_called(_: object) -> None:
    """rclpy wants a callback; without an executor it is never called."""


def _farewell() -> None:
    """Before Python takes itself apart under a thread that is inside the middleware."""
    for hub in list(_hubs.values()):
        hub.stop(0.5)


atexit.register(_farewell)
# A forked process has no hub's thread; its own beacons start again.
os.register_at_fork(after_in_child=_hubs.clear)
