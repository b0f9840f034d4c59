"""Detects with a second participant that the child's own participant misses something permanently, or permanently lists
a node that has ended. Pure; callers pass the time.

When the lease of a node ends only for PHM while the two exchange their endpoints, as on a computer that is overloaded
at its start, Fast DDS drops the node's data and requests them again. The node considers acknowledged data as received
and sends nothing. PHM then misses the node, or some of its endpoints, until the node restarts (measured with Jazzy and
Kilted).

When a node ends, its last announcement may be processed after its end. The participant then lists the node until PHM
restarts, without any endpoint (a race in rmw_fastrtps, seen on a busy machine).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from phm.core.backoff import Backoff

CALM_S = 5.0
"""Time from a start, or a loss, to the comparison: data that are only late have arrived by then."""
CONFIRM_S = 2.0
"""How long the second participant must have known what the first one does not."""
CONFIRM_STALE_S = 5.0
"""How long the second participant must have known everything except a node: what is not discovered may be late."""
OPEN_S = 10.0
"""Lifetime of the second participant: on an overloaded machine discovery takes seconds."""
REST_S, REST_MOST_S = 15.0, 900.0
"""Time between two comparisons.

Doubled while each comparison finds something without helping, or while endpoints leave repeatedly without any being missed (a
short-lived node, e.g. of a health check). Reset after an equally long time without changes, or when something
configured is newly missing.
"""

Known = frozenset[tuple[str, ...]]
"""The knowledge of a participant: nodes as (name,), and endpoints of topics as (topic, side, name of the node)."""
Since = Mapping[tuple[str, ...], float]
"""Parts of such a knowledge, and since when they differ."""


class Differences(NamedTuple):
    """Names in which the first participant is wrong."""

    missed: tuple[str, ...] = ()
    """Nodes and topics of which it lacks something."""
    stale: tuple[str, ...] = ()
    """Nodes that it lists and that have ended."""


NO_DIFFERENCES = Differences()


class SecondParticipant(Protocol):
    """The second participant."""

    def known(self, now_s: float) -> Known: ...

    def close(self) -> None: ...


class GraphComparison:
    """Decides when a second participant is opened, and in what the first one is wrong.

    It is opened after the start, after something left, and at increasing intervals while something configured is missing.
    """

    def __init__(self, open_participant: Callable[[], SecondParticipant], now_s: float) -> None:
        self._open = open_participant
        self._participant: SecondParticipant | None = None
        self._opened_s = 0.0
        self._missed: Since = {}
        self._stale: Since = {}
        self._known: Known = frozenset()
        self._due_s: float | None = now_s + CALM_S
        self._rested_s = now_s
        self._ended_s = now_s
        self._backoff = Backoff(REST_S, REST_MOST_S)
        self._lacking = self._left = self._compares_left = self._found = False

    def update(self, now_s: float, known: Known, *, lacking: bool) -> Differences | None:
        """The differences that require a new first participant, usually none. Called once per tick.

        known: what the first participant knows. lacking: whether it lacks something configured.
        """
        left, self._known = self._known - known, known
        self._left = self._left or bool(left)
        if lacking and not self._lacking:
            self._hurry()
        self._lacking = lacking
        if (left or lacking) and self._due_s is None:
            self._due_s = now_s + CALM_S
        if self._participant is None:
            if self._due_s is not None and now_s >= max(self._due_s, self._rested_s):
                self._begin(now_s)
            return None
        second = self._participant.known(now_s)
        self._missed = {one: self._missed.get(one, now_s) for one in second - known}
        self._stale = {one: self._stale.get(one, now_s) for one in _stale(known, second)}
        found = Differences(
            _lasting(self._missed, now_s - CONFIRM_S),
            _lasting(self._stale, now_s - CONFIRM_STALE_S),
        )
        different = found != NO_DIFFERENCES
        if different or now_s - self._opened_s >= OPEN_S:
            if different and not self._found:
                self._backoff.reset()
            self._found = different
            self._end(now_s, again=lacking or different or self._compares_left)
        return found if different else None

    def renewed(self, now_s: float) -> None:
        """The first participant was replaced."""
        self._known, self._due_s = frozenset(), now_s + CALM_S

    def close(self) -> None:
        """Safe to call twice."""
        participant, self._participant = self._participant, None
        if participant is not None:
            participant.close()

    def _begin(self, now_s: float) -> None:
        if now_s - self._rested_s >= self._backoff.pause_s:
            self._backoff.reset()
        self._due_s, self._opened_s, self._missed, self._stale = None, now_s, {}, {}
        self._compares_left, self._left = self._left, False
        try:
            self._participant = self._open()
        except Exception:  # rclpy's own exceptions, at a limit of threads or participants: the first one must suffice
            self._end(now_s, again=True)

    def _hurry(self) -> None:
        """Limit the interval to that after the first comparison."""
        self._backoff.reset()
        self._rested_s = min(self._rested_s, self._ended_s + REST_S)

    def _end(self, now_s: float, *, again: bool) -> None:
        self.close()
        self._ended_s = now_s
        if again:
            self._backoff.next_s()
        else:
            self._backoff.reset()
        self._rested_s = now_s + self._backoff.pause_s


def _lasting(since: Since, until_s: float) -> tuple[str, ...]:
    """Names of what has differed since this time or longer."""
    return tuple(sorted({one[0] for one, since_s in since.items() if since_s <= until_s}))


def _stale(known: Known, second: Known) -> Known:
    """Nodes without an endpoint that only the first participant lists, if the second one knows everything else."""
    nodes = {one for one in known if len(one) == 1}
    alive = {(end[2],) for end in known if len(end) > 1}
    stale = nodes - alive - second
    return frozenset(stale) if known - stale <= second else frozenset()
