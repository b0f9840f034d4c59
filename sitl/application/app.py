"""The demo application: starts N nodes and is the first process of the application container.

    python -m sitl.application.app --agent agent_1 --nodes 3 --rate 10
    python -m sitl.application.app --agent agent_1 --graph '[{"name": "camera", "publish": {"image": 5}}]'

Node i publishes topic_i and subscribes to the topic of the node before it, in the namespace of the agent; or it is as the graph
says, see `sitl.application.graph`.
A dead node is left dead, so that PHM has something to find. Each node's process id is in
`/tmp/nodes/<node>.pid`, so that a fault can be injected into that node alone. SIGUSR1 makes this process take
memory until it is killed; SIGUSR2 makes it end without a word to its nodes, which the kernel ends with the container;
SIGRTMIN+1 makes it ignore SIGTERM from then on. A
file `/tmp/broken_start` that is not empty makes the next start fail; a node whose name is in `/tmp/left_out` is not
started, once.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from sitl.application.graph import OPTIONS_VARIABLE, NodePlan, read, ring

IGNORE_TERM = signal.SIGRTMIN + 1
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD, signal.SIGUSR1, signal.SIGUSR2, IGNORE_TERM)
NODE = (sys.executable, "-m", "sitl.application.node")
_FAREWELL_S = 3.0
_BITE = 8 * 2**20
"""Bytes that a leaking process takes in one step."""
_APPETITE = 2**30
"""Bytes after which it stops leaking, should nothing limit it."""


class App:
    """The running nodes. Needs SIGTERM, SIGINT and SIGCHLD blocked in this process (see `main`)."""

    def __init__(self, pid_dir: Path) -> None:
        self._pid_dir = pid_dir
        self._nodes: dict[int, str] = {}

    def start(self, name: str, argv: Sequence[str], more: Mapping[str, str]) -> None:
        """`more`: environment variables of this node alone."""
        # posix_spawn gives the node a clean signal mask: ours is blocked, and would be inherited.
        pid = os.posix_spawn(argv[0], list(argv), {**os.environ, **more}, setsigmask=())
        self._nodes[pid] = name
        pid_file = self._pid_dir / f"{name}.pid"
        pid_file.write_text(f"{pid}\n", encoding="ascii")
        _say(f"{name} started as process {pid}")

    def serve(self) -> None:
        """Until SIGTERM, SIGINT or SIGUSR2; dead nodes are reaped, and their pid files removed."""
        ignored: set[int] = {signal.SIGCHLD}
        while True:
            number = signal.sigwait(_SIGNALS)
            if number == signal.SIGUSR1:
                _leak()
            elif number == signal.SIGUSR2:
                os._exit(0)
            elif number == IGNORE_TERM:
                ignored |= {IGNORE_TERM, signal.SIGTERM}
            elif number not in ignored:
                return
            self._reap()

    def stop(self) -> None:
        """SIGTERM to all, SIGKILL to those that have not gone in time."""
        for number, patience_s in ((signal.SIGTERM, _FAREWELL_S), (signal.SIGKILL, _FAREWELL_S)):
            for pid in self._nodes:
                os.kill(pid, number)
            until_s = time.monotonic() + patience_s
            while self._nodes and (left_s := until_s - time.monotonic()) > 0:
                signal.sigtimedwait((signal.SIGCHLD,), left_s)
                self._reap()

    def _reap(self) -> None:
        """All that ended: also orphans, which become the first process's children in a container."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            name = self._nodes.pop(pid, "")
            if name:
                (self._pid_dir / f"{name}.pid").unlink(missing_ok=True)
                _say(f"{name} ended with {os.waitstatus_to_exitcode(status)}")


def _leak() -> None:
    """Take memory that is really written, as a leak does, until the kernel has had enough of this process."""
    _say("leaking")
    taken = [bytearray(_BITE)]
    while len(taken) * _BITE < _APPETITE:
        taken.append(bytearray(b"x" * _BITE))


def node_argv(agent: str, plan: NodePlan) -> list[str]:
    """The command of one node of the agent's graph."""
    return [*NODE, *_node_options(agent, plan)]


def _node_options(agent: str, plan: NodePlan) -> list[str]:
    return ["--namespace", f"/{agent}", *plan.argv()]


def _with_beacon(agent: str, plan: NodePlan) -> tuple[list[str], dict[str, str]]:
    return node_argv(agent, plan), {}


def _as_found(agent: str, plan: NodePlan) -> tuple[list[str], dict[str, str]]:
    """Command and environment of a node that was made without PHM in mind: it has no beacon, and as with a node whose
    name is in its program, the command line does not show which one it is.
    """
    return [*NODE], {OPTIONS_VARIABLE: json.dumps([*_node_options(agent, plan), "--no-beacon"])}


def main(argv: list[str] | None = None) -> int:
    """Run until SIGTERM or SIGINT. Returns the exit code."""
    options = _options(argv)
    # Blocked and waited for: the first process of a container has no default signal handling at all.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    if options.broken.exists() and options.broken.stat().st_size:
        _say(f"{options.broken} says that this start fails")
        return 1
    options.marker.unlink(missing_ok=True)  # a restart fixes what this marker simulates
    options.pids.mkdir(parents=True, exist_ok=True)
    app = App(options.pids)
    left_out = options.left_out.read_text("ascii").split() if options.left_out.exists() else []
    options.left_out.unlink(missing_ok=True)  # the start that goes wrong now goes well the next time
    for plan in _plans(options):
        if plan.name not in left_out:
            app.start(plan.name, *(_as_found if options.as_found else _with_beacon)(options.agent, plan))
    app.serve()
    app.stop()
    return 0


def plans(argv: Sequence[str]) -> list[NodePlan]:
    """The nodes that the application starts with these options."""
    return _plans(_options(list(argv)))


def _plans(options: argparse.Namespace) -> list[NodePlan]:
    return read(json.loads(options.graph)) if options.graph else ring(options.nodes, options.rate)


def _options(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m sitl.application.app", description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("--agent", default="agent_1")
    parser.add_argument("--nodes", type=int, default=3)
    parser.add_argument("--rate", type=float, default=10.0, help="Hz of every topic")
    parser.add_argument("--graph", default="", metavar="JSON", help="instead of --nodes and --rate")
    parser.add_argument("--pids", type=Path, default=Path("/tmp/nodes"), help="folder of the pid files")
    parser.add_argument("--marker", type=Path, default=Path("/tmp/unhealthy"), help="file that breaks the healthcheck")
    parser.add_argument("--broken", type=Path, default=Path("/tmp/broken_start"), help="file that breaks the start")
    parser.add_argument(
        "--left-out", type=Path, default=Path("/tmp/left_out"), help="file with nodes not to start, once"
    )
    parser.add_argument(
        "--as-found", action="store_true", help="nodes without beacons, whose command lines do not name them"
    )
    return parser.parse_args(argv)


def _say(text: str) -> None:
    sys.stdout.write(f"app: {text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
