"""The nodes' consensus about each other on /phm/consensus: one status for each node, on each change and every few seconds.

It is the consensus itself, before the tracker waits for confirmation. `docs/reference/ros.md` states names and key-values as a
contract.
"""

from __future__ import annotations

from collections.abc import Mapping

from phm.core.model import Event, Level, NodeVotes, Result, Transition
from phm.facts.ros import CONSENSUS, DiagnosticFact
from phm.reporters.base import DiagnosticsPublisher, Reporter, ReporterContext
from phm.wire.text import one_line

UNIT = "consensus"
AT_LEAST_S = 5.0
"""Without a change it is published this often."""
MAX_NODES = 200
MAX_TEXT = 255
MAX_NAMES = 400_000
"""Characters of all lists of observers with one verdict: the ROS child takes at most `phm.probes.ros.protocol.LINE_LIMIT`."""
_LEVELS: Mapping[str, Level] = {
    "alive": Level.OK,
    "hung": Level.ERROR,
    "dead": Level.ERROR,
    "undecided": Level.STALE,
}
_NOT_TAKEN = 5


class ConsensusReporter(Reporter):
    """Publishes through the ROS child process, from the first consensus on."""

    name = "consensus"
    period_s = 1.0
    kinds = (Transition,)

    def __init__(self, context: ReporterContext, port: DiagnosticsPublisher) -> None:
        self._context, self._agent, self._port = context, context.settings.agent.name, port
        self._last: dict[str, DiagnosticFact] = {}
        self._sent_at = float("-inf")
        self._not_taken = 0

    @classmethod
    def build(cls, context: ReporterContext) -> ConsensusReporter | None:
        ros = context.settings.ros
        if context.ros is None or not (ros.nodes and ros.consensus.publish):
            return None
        return cls(context, context.ros)

    def handle(self, event: Event) -> None:
        if isinstance(event, Transition) and event.state.check in (UNIT, "nodes"):
            self.tick()

    def tick(self) -> None:
        """Publish the consensus if it has changed or the last publication is old enough."""
        if not self._context.alive():
            return
        result, now = self._context.newest(UNIT), self._context.clock.mono()
        if result is None or not (result.votes or self._last):
            return
        statuses = self._statuses(result)
        if statuses != self._last or now - self._sent_at >= AT_LEAST_S:
            self._send(statuses, now)

    def close(self) -> None:
        """Publish a last array in which all is STALE, so that subscribers need not wait for their timeouts."""
        if self._last:
            gone = DiagnosticFact(0.0, int(Level.STALE), "PHM has stopped", self._agent)
            self._send(dict.fromkeys(self._last, gone), self._context.clock.mono())

    def hand_over(self) -> None:
        """Send nothing: the next reporter continues."""

    def problem(self) -> str:
        if self._not_taken < _NOT_TAKEN:
            return ""
        return f"{CONSENSUS} is not published: the ROS child process has not accepted the last {self._not_taken} arrays"

    def _send(self, statuses: dict[str, DiagnosticFact], now: float) -> None:
        self._last, self._sent_at = statuses, now
        self._not_taken = self._port.publish(statuses, CONSENSUS)

    def _statuses(self, result: Result) -> dict[str, DiagnosticFact]:
        """Without a consensus, the nodes of the last one as STALE with the reason."""
        if not result.votes:
            unknown = DiagnosticFact(0.0, int(Level.STALE), one_line(result.summary)[:MAX_TEXT], self._agent)
            return dict.fromkeys(self._last, unknown)
        nodes = result.votes[:MAX_NODES]
        most = MAX_NAMES // len(nodes)
        return {f"phm/{self._agent}/consensus: {node.node}": self._status(node, most) for node in nodes}

    def _status(self, node: NodeVotes, most: int) -> DiagnosticFact:
        alive, dead = _names(node.alive, most), _names(node.dead, most)
        values = {"node": node.node, "verdict": node.verdict, "alive": alive, "dead": dead}
        votes = f"{len(node.alive)} alive, {len(node.dead)} dead"
        level = int(_LEVELS.get(node.verdict, Level.STALE))
        return DiagnosticFact(0.0, level, f"{node.verdict}: {votes}", self._agent, values)


def _names(observers: tuple[str, ...], most: int) -> str:
    """The names, without the last ones of more than `most` characters."""
    text = one_line(", ".join(observers))
    if len(text) <= most:
        return text
    shown = text[:most].rpartition(", ")[0]
    return f"{shown}, and {len(observers) - shown.count(', ') - 1} more"
