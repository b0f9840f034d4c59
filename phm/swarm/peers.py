"""The other agents, as this one receives them: alive, late, lost, or with a duplicate id. Pure.

A peer is known by PHM's heartbeat, which carries its status word. The allowed silence follows from its usual period: agents may
have other periods than ours, and radios lose frames. The loss of a peer with regular heartbeats is detected sooner
(`phm.swarm.heartbeat_stats`), and even sooner where others became silent with it (`phm.swarm.group_loss`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from phm.core.duplicate_filter import DuplicateFilter
from phm.core.scheduling_delay import Late, never_late
from phm.swarm.agent_count import RECENT_S, STEADY
from phm.swarm.frame_sequences import FrameSequences
from phm.swarm.group_loss import NEARLY, SilentPeer, lost_together, most_significant_group, silent_peer
from phm.swarm.heartbeat_stats import HeartbeatStats
from phm.wire.tunnel import PeerState, PeerView

LATE_PERIODS, LOST_PERIODS = 2.5, 5.0
"""Silence in heartbeat periods of the peer: one lost frame means nothing, four in a row do. LOST_PERIODS is the maximum."""
FADE_S, FADE_MARGIN = 600.0, 1.5
"""How long a fade of several peers is remembered, and by what factor a later silence must be longer."""
STALL_PERIODS = 0.5
"""After a longer pause between looks the silence may be our own: then each peer has one period to be received first."""
LEARN = 0.3
"""Weight of the newest gap in the estimate of a peer's period."""
MAX_PERIOD_S = 60.0
EQUAL = 0.2
"""Two gaps are equal if they differ by at most this share: those of one period are, two outages seldom."""
VIEW_LATE_PERIODS = 45.0
"""A view is too old to vote when its sender has sent none for this many periods. Views come when something changes, twice,
and every 20 heartbeats; while its sender is alive and sends no other one, its view remains valid."""
CLASHES, CLASH_PERIODS = 3, 30.0
"""An id is used twice when so many frames within this many periods show a second sender."""
REMEMBERED = 32
MAX_PEERS = 250


@dataclass(slots=True)
class Peer:
    """One other agent. Times are monotonic seconds; `word` is its newest status word, 0 before the first."""

    agent: int
    period_s: float
    received_s: float | None = None
    word: int = 0
    leaving: bool = False
    """It sent POWEROFF: the silence that follows is planned."""
    booting: bool = False
    """Its first report is not complete."""
    restarts: int = 0
    """How often it began to boot since it was first received."""
    view: PeerView | None = None
    view_s: float | None = None
    timed_link: str = ""
    timed_s: float | None = None
    """The link by which its period is learned, and when a heartbeat came by it last."""
    long_gap_s: float = 0.0
    """The gap before its last heartbeat, if that was as long as a loss."""
    clashes: deque[float] = field(default_factory=lambda: deque(maxlen=CLASHES))
    """When a frame showed a second sender with the same id."""
    stats: HeartbeatStats = field(init=False)
    lost_together: bool = False
    """It became silent together with others, and was not received since."""
    lost_alone: bool = False
    """It was received regularly, and is silent for longer than ever before."""
    sequences: FrameSequences = field(default_factory=FrameSequences)
    recent_heartbeats: DuplicateFilter[tuple[str, int, int], bool] = field(
        default_factory=lambda: DuplicateFilter(REMEMBERED)
    )
    """Link, frame number and word of the last heartbeats."""
    late_s: Late = never_late

    def __post_init__(self) -> None:
        self.stats = HeartbeatStats(self.period_s)

    def count(self, frame: int, word: int, link: str, now: float) -> None:
        """Detect two senders with one id."""
        beat = (link, frame, word)
        known = bool(self.recent_heartbeats.get(beat))
        if self.sequences.add(frame, link, known=known):
            self.clashes.append(now)
        if not known:
            self.recent_heartbeats.add(beat, True)

    def time_heartbeat(self, link: str, now: float) -> float | None:
        """Take the time of a heartbeat. Returns the seconds since the one before, if both came by the timed link.

        Other links deliver the same heartbeats with another delay, so the gaps between links are shorter than the period.
        """
        timed = link == self.timed_link
        gap_s = now - self.timed_s if timed and self.timed_s is not None else None
        if timed or self.timed_s is None or now - self.timed_s > LATE_PERIODS * self.period_s:
            self.timed_link, self.timed_s = link, now
        return gap_s

    def is_period(self, gap_s: float, state: PeerState) -> bool:
        """Whether its period may be learned from this gap, before which it was in this state. The first one as long as a loss is an
        outage; a second, equal one in sequence is another period, of a larger swarm.
        """
        known = state in (PeerState.ALIVE, PeerState.LATE)
        if gap_s <= LOST_PERIODS * self.period_s:
            if gap_s > self.period_s / 2:  # a shorter one is an additional heartbeat, or came by another way
                self.long_gap_s = 0.0
            return known or not self.leaving
        equal = abs(gap_s - self.long_gap_s) <= EQUAL * gap_s
        self.long_gap_s = gap_s
        return known or (equal and not self.leaving and gap_s <= (1.0 + EQUAL) * MAX_PERIOD_S)

    def state(self, now: float) -> PeerState:
        if self.received_s is None:
            return PeerState.NEVER
        silent_s = self.silent_s(now)
        if self.leaving and silent_s > self.period_s:
            return PeerState.LOST
        if self.lost_together or self.lost_alone or silent_s > LOST_PERIODS * self.period_s:
            return PeerState.LOST
        return PeerState.LATE if silent_s > LATE_PERIODS * self.period_s else PeerState.ALIVE

    def silent_s(self, now: float) -> float:
        """Silence in seconds, without the time in which PHM did not run. Only for a peer that was received."""
        assert self.received_s is not None
        age_s = now - self.received_s
        if age_s <= LATE_PERIODS * self.period_s / 2:
            return age_s  # most are, and there may be hundreds
        return max(0.0, age_s - self.late_s(self.received_s, LOST_PERIODS * self.period_s))

    def fresh_view(self, now: float) -> PeerView | None:
        """Its view, if that is new enough to count while the peer is alive."""
        fresh = self.view_s is not None and now - self.view_s <= VIEW_LATE_PERIODS * self.period_s
        return self.view if fresh else None


class Peers:
    """All other agents. Not thread-safe.

    expected: agent ids of the fleet, which count as members even if never received; other ids are ignored. Without it the
    members are the agents that were received.
    period_s: of our own heartbeat, the first guess for all. late_s: for how long PHM did not run, which does not count as silence.
    """

    def __init__(self, own: int, period_s: float, expected: Iterable[int] = (), late_s: Late = never_late) -> None:
        self.own, self._late_s = own, late_s
        self._period_s = period_s
        self._listed = frozenset(expected)
        self._expected = self._listed - {own}
        self._unlisted: dict[int, float] = {}
        """Agents that are not listed, and when they were received."""
        self._peers = {agent: Peer(agent, period_s, late_s=late_s) for agent in sorted(self._expected)}
        self._watched: float | None = None
        self._blind_until = float("-inf")
        self._fades: deque[tuple[float, float]] = deque(maxlen=8)
        """When a fade ended, and for how long several peers were silent, seconds."""

    def take_over(self, before: Peers) -> None:
        """Go on with the agents that `before` has received and that are members here too."""
        for agent, peer in before.all().items():
            if peer.received_s is not None and (agent in self._expected or not self._listed):
                if before._period_s != self._period_s:
                    peer.stats = HeartbeatStats(self._period_s)
                self._peers[agent] = peer

    def heartbeat(
        self,
        agent: int,
        word: int,
        now: float,
        *,
        leaving: bool = False,
        booting: bool = False,
        frame: int | None = None,
        link: str = "",
    ) -> bool:
        """Take a heartbeat of another agent's PHM. True when its state or its content changed.

        leaving, booting: its state is POWEROFF, or BOOT. frame: the sequence number of its MAVLink frame, which counts all that this
        sender sends on the link.
        """
        if agent == self.own or self._is_unlisted(agent, now):
            return False
        peer = self._peer(agent)
        if frame is not None:
            peer.count(frame, word, link, now)
        before = (peer.state(now), peer.word, peer.leaving)
        gap_s = peer.time_heartbeat(link, now)
        if gap_s is not None and peer.is_period(gap_s, before[0]):
            gap_s = min(gap_s, MAX_PERIOD_S)
            # Two heartbeats in one moment come from an answer to a ground station, and are not a period.
            if gap_s > 0.2 * peer.period_s:
                peer.period_s += LEARN * (gap_s - peer.period_s)
                peer.stats.add_gap(gap_s)
        self._fade(peer, now)
        peer.restarts += booting and not peer.booting and peer.received_s is not None
        peer.booting = booting
        peer.received_s, peer.word, peer.leaving = now, word, leaving
        peer.lost_together = peer.lost_alone = False
        return before != (peer.state(now), word, leaving)

    def add_view(self, agent: int, view: PeerView, now: float) -> bool:
        """Take a view of another agent. True when it differs from the one before."""
        if agent == self.own or self._is_unlisted(agent, now):
            return False
        peer = self._peer(agent)
        old = peer.view
        peer.view, peer.view_s = view, now
        return old is None or (old.gcs, old.autopilot, old.radio, old.peers) != (
            view.gcs,
            view.autopilot,
            view.radio,
            view.peers,
        )

    def watch(self, now: float, period_s: float, *, receives: bool = True) -> None:
        """Detect losses sooner than after LOST_PERIODS: of single peers and of groups. Call it a few times in each period.

        period_s: of heartbeats in a swarm of this size. receives: the links on which they were received are open; a
        closed link is reported elsewhere.
        """
        last, self._watched = self._watched, now
        if period_s != self._period_s:  # all change over, and the first pause is a long one
            self._period_s = period_s
            for peer in self._peers.values():
                peer.stats = HeartbeatStats(period_s)
            receives = False
        if last is None or now - last > STALL_PERIODS * period_s or not receives:
            longest = max((peer.stats.period_s for peer in self._peers.values()), default=period_s)
            self._blind_until = now + 1.5 * longest
        if now < self._blind_until:
            return
        recent = [length for ended, length in self._fades if now - ended <= FADE_S]
        least_s = FADE_MARGIN * max(recent, default=0.0)
        listened = self._listened(now)
        for agent in lost_together(listened, now, least_s):
            self._peers[agent].lost_together = True
        for entry in listened:
            self._peers[entry.agent].lost_alone = entry.stats.is_lost(entry.missed)

    def states(self, now: float) -> dict[int, PeerState]:
        """The state of each other member, by agent id."""
        return {agent: peer.state(now) for agent, peer in sorted(self._peers.items())}

    def peer(self, agent: int) -> Peer | None:
        return self._peers.get(agent)

    def all(self) -> Mapping[int, Peer]:
        return self._peers

    def agents_on_links(self, now: float) -> int:
        """How many agents use the links, this one included: those listed, or those received recently and regularly."""
        if self._listed:
            return len(self._listed | {self.own})
        return 1 + sum(
            not peer.leaving
            and len(peer.recent_heartbeats) >= STEADY
            and peer.received_s is not None
            and now - peer.received_s <= RECENT_S
            for peer in self._peers.values()
        )

    def unlisted(self, now: float) -> tuple[int, ...]:
        """Agents received recently that are not listed, if a list is configured."""
        return tuple(sorted(agent for agent, received_s in self._unlisted.items() if now - received_s <= RECENT_S))

    def duplicate_ids(self, now: float) -> tuple[int, ...]:
        """Ids that two agents use: their frames repeatedly return to an earlier sequence."""
        return tuple(
            agent
            for agent, peer in sorted(self._peers.items())
            if len(peer.clashes) == CLASHES and now - peer.clashes[0] <= CLASH_PERIODS * peer.period_s
        )

    def _listened(self, now: float) -> list[SilentPeer]:
        """Peers that are expected to send and whose id is unique, with the time of their last heartbeat and their statistics."""
        mixed = self.duplicate_ids(now)
        return [
            silent_peer(agent, now - peer.silent_s(now), peer.stats, now)
            for agent, peer in self._peers.items()
            if peer.received_s is not None
            and not peer.leaving
            and peer.state(now) in (PeerState.ALIVE, PeerState.LATE)
            and agent not in mixed
        ]

    def _fade(self, peer: Peer, now: float) -> None:
        """Remember the length of a fade of several peers when the first of them is received again."""
        if peer.received_s is None or not peer.stats.missed(silent_s := now - peer.received_s):
            return
        if self._fades and now - self._fades[-1][0] <= 2.0 * peer.stats.period_s:
            return
        if peer.lost_together:
            if silent_s <= LOST_PERIODS * peer.period_s:
                self._fades.append((now, silent_s))
            return
        group = most_significant_group(self._listened(now))
        if group is not None and group.weight >= NEARLY and peer.agent in group.agents:
            self._fades.append((now, now - group.since_s))

    def _is_unlisted(self, agent: int, now: float) -> bool:
        if not self._listed or agent in self._listed:
            return False
        self._unlisted[agent] = now  # bounded: a system id has one byte
        return True

    def _peer(self, agent: int) -> Peer:
        peer = self._peers.get(agent)
        if peer is None:
            if len(self._peers) >= MAX_PEERS:  # ids are 1 to 250, so only hostile frames get here
                longest = min(self._peers.values(), key=lambda entry: entry.received_s or 0.0)
                del self._peers[longest.agent]
            peer = self._peers[agent] = Peer(agent, self._period_s, late_s=self._late_s)
        return peer
