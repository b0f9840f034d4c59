"""Who speaks for the swarm: the lowest living id that hears the ground. Elected by each for itself, no messages. Pure.

An agent that would be a better speaker takes over only after it has been fit for STEADY_S, so that one on the edge of
its radio does not pass the word back and forth. While views still differ, two may speak for a moment: a digest
is the same whoever sends it, and a second one costs 46 bytes.
"""

from __future__ import annotations

from phm.swarm.consensus import Consensus, State

STEADY_S = 10.0


class Election:
    """Call `speaker` regularly. Not thread-safe."""

    def __init__(self) -> None:
        self._speaker: int | None = None
        self._fit_since: dict[int, float] = {}

    def speaker(self, consensus: Consensus, own_gcs: bool, now: float) -> int | None:
        """The id of the agent that speaks now; None while nobody here hears the ground."""
        fit = _fit(consensus, own_gcs)
        self._fit_since = {agent: self._fit_since.get(agent, now) for agent in fit}
        if self._speaker not in fit:
            # Nobody speaks: the best one begins at once.
            self._speaker = min(fit, default=None)
            return self._speaker
        steady = [agent for agent in fit if now - self._fit_since[agent] >= STEADY_S]
        better = min(steady, default=self._speaker)
        if better is not None and self._speaker is not None and better < self._speaker:
            self._speaker = better
        return self._speaker


def _fit(consensus: Consensus, own_gcs: bool) -> list[int]:
    """Living agents that hear the ground, by their own word."""
    there = (State.ALIVE, State.PARTLY, State.LATE)
    fit = [agent for agent, verdict in consensus.verdicts.items() if verdict.state in there and verdict.gcs]
    return sorted([*fit, *([consensus.own] if own_gcs else [])])
