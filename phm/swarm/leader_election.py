"""Election of the leader: the lowest id that is alive and receives the ground and an agent. Each agent computes it; no messages. Pure.

A better candidate takes over only after it has been fit for STEADY_S, so that an agent at the edge of its radio range does not
cause repeated changes. Where there was no leader, one is elected only when the views of all have arrived. While views differ
nevertheless, two agents may act as leader: their digests are the same, and a second one costs 46 bytes.
"""

from __future__ import annotations

from phm.swarm.consensus import Consensus, MemberState

STEADY_S = 10.0
VIEWS_S = 5.0
"""Within this time the views of all others arrive in a small swarm: where a ground station appears, each agent knows that of itself first."""


class LeaderElection:
    """Call `leader` regularly. Not thread-safe."""

    def __init__(self) -> None:
        self._leader: int | None = None
        self._fit_since: dict[int, float] = {}

    def leader(self, consensus: Consensus, own_gcs: bool, now: float, views_s: float = VIEWS_S) -> int | None:
        """The id of the current leader; None while no agent on this side is fit, or the first became fit less than `views_s` ago."""
        fit = _fit(consensus, own_gcs)
        self._fit_since = {agent: self._fit_since.get(agent, now) for agent in fit}
        if self._leader not in fit:
            # A leader that fails is replaced immediately by the best candidate.
            known = self._leader is not None or now - min(self._fit_since.values(), default=now) >= views_s
            self._leader = min(fit, default=None) if known else None
            return self._leader
        steady = [agent for agent in fit if now - self._fit_since[agent] >= STEADY_S]
        better = min(steady, default=self._leader)
        if better is not None and self._leader is not None and better < self._leader:
            self._leader = better
        return self._leader


def _fit(consensus: Consensus, own_gcs: bool) -> list[int]:
    """Agents that are alive and receive the ground and another agent by their own views: one that receives none knows no other agent's state."""
    there = (MemberState.ALIVE, MemberState.PARTLY, MemberState.LATE)
    fit = [agent for agent, status in consensus.statuses.items() if status.state in there and status.gcs]
    return sorted({*fit, *([consensus.own] if own_gcs else [])}.difference(consensus.receive_none))
