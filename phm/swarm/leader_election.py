"""Who leads for the swarm: the lowest living id that hears the ground. Elected by each for itself, no messages. Pure.

An agent that would be a better leader takes over only after it has been fit for STEADY_S, so that one on the edge of
its radio does not pass the word back and forth. While views still differ, two may speak for a moment: a digest
is the same whoever sends it, and a second one costs 46 bytes.
"""

from __future__ import annotations

from phm.swarm.consensus import Consensus, MemberState

STEADY_S = 10.0


class LeaderElection:
    """Call `leader` regularly. Not thread-safe."""

    def __init__(self) -> None:
        self._leader: int | None = None
        self._fit_since: dict[int, float] = {}

    def leader(self, consensus: Consensus, own_gcs: bool, now: float) -> int | None:
        """The id of the agent that leads now; None while nobody here hears the ground."""
        fit = _fit(consensus, own_gcs)
        self._fit_since = {agent: self._fit_since.get(agent, now) for agent in fit}
        if self._leader not in fit:
            # Nobody leads: the best one begins at once.
            self._leader = min(fit, default=None)
            return self._leader
        steady = [agent for agent in fit if now - self._fit_since[agent] >= STEADY_S]
        better = min(steady, default=self._leader)
        if better is not None and self._leader is not None and better < self._leader:
            self._leader = better
        return self._leader


def _fit(consensus: Consensus, own_gcs: bool) -> list[int]:
    """Living agents that hear the ground, by their own word."""
    there = (MemberState.ALIVE, MemberState.PARTLY, MemberState.LATE)
    fit = [agent for agent, status in consensus.statuses.items() if status.state in there and status.gcs]
    return sorted([*fit, *([consensus.own] if own_gcs else [])])
