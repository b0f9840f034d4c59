"""The other agents on the MAVLink links: heartbeats of their PHM, their views, and the consensus from all of these."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import MavlinkSettings, SwarmSettings
from phm.facts.swarm import PeerFact, SwarmFact
from phm.swarm.agent_count import SmoothedAgentCount
from phm.swarm.consensus import Consensus, compute_consensus, without_gcs
from phm.swarm.leader_election import VIEWS_S, LeaderElection
from phm.swarm.peers import LOST_PERIODS, Peers
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.transport.priority import default_periods
from phm.wire import status_word, tunnel

FRESH_S, FRESH_PERIODS = 0.5, 0.1
"""Maximum age of the cached fact, the shorter of both: silence is detected only by looking."""
LINK_S = 60.0
"""A link without a frame from another agent for this long leads to no agent."""
GROUND_PERIODS = 2.5
"""Where a ground station has appeared, agents that do not receive it are known after so many periods, at least VIEWS_S. A view that
was lost is sent again a period later. An agent that was started now knows the others after this time."""


class SwarmMonitor:
    """A `phm.facts.SwarmProbe`. `on_wake` is called when the status changes, also because of silence; it must not block.

    gcs_age_s: seconds since the last heartbeat of a ground station, None if there was none.
    gcs_unreachable: whether the ground station is certainly unreachable, regardless of `gcs_age_s`. Frames arrive in the
    threads of the endpoints.
    """

    def __init__(
        self,
        hub: MavlinkHub,
        agent: int,
        link_settings: MavlinkSettings,
        settings: SwarmSettings,
        clock: Clock,
        gcs_age_s: Callable[[], float | None],
        on_wake: Callable[[], None],
        gcs_unreachable: Callable[[], bool] = lambda: False,
    ) -> None:
        self._hub, self._clock, self._on_wake, self._gcs_age_s = hub, clock, on_wake, gcs_age_s
        self._gcs_unreachable = gcs_unreachable
        self._own, self._component = agent, link_settings.component_id
        self._gcs_timeout_s = link_settings.gcs_timeout
        expected = settings.agents
        self._heartbeat_s = link_settings.heartbeat
        # Each PHM with a key signs its heartbeats. This probe ignores those of autopilots and ground stations.
        self._signed = link_settings.signing.key is not None and link_settings.signing.unsigned != "all"
        self._agents = len({*expected, self._own})
        """Number of agents that share the links, including this one."""
        self._expected = tuple(expected)
        self._peers = Peers(self._own, self._period_s(self._agents), expected, clock.late_s)
        self._agent_count = SmoothedAgentCount(self._agents, clock.mono())
        self._election = LeaderElection()
        self._ground_from: float | None = None
        """Since when at least one agent receives the ground without a break."""
        self._links: dict[str, float] = {}
        self._began = clock.mono()
        self._shown: object = None
        self._fresh: tuple[float, SwarmFact | None] = (0.0, None)
        self._fresh_s = FRESH_S
        self._since: dict[int, tuple[str, float]] = {}
        """Each agent's state, and since when it has it."""
        self._lock = threading.Lock()
        hub.set_agent_count(self._agents)
        hub.listen(self._receive, (mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_TUNNEL))
        hub.watch(self.wake_if_changed)

    def resume(self, before: SwarmMonitor) -> None:
        """Go on with the agents that the predecessor has received and that are members still (after a reload): else one that is lost
        would seem to be one that was never there."""
        with before._lock, self._lock:
            self._links, self._since, self._fresh = before._links, before._since, (0.0, None)
            self._election, self._ground_from = before._election, before._ground_from
            if self._expected == before._expected:
                self._peers, self._agent_count = before._peers, before._agent_count
                self._began = before._began
            else:
                self._peers.take_over(before._peers)

    def snapshot(self) -> SwarmFact:
        """The current fact, cached until a frame brings a change or it is FRESH_S old (in a small swarm a tenth of the
        heartbeat's period): a hundred views cost milliseconds. Wakes the check when its result would change."""
        at, fact = self._fresh
        if fact is None or self._clock.mono() - at >= self._fresh_s:
            fact = self._observe()
            self._fresh = (self._clock.mono(), fact)
            self._compare(fact)
        return fact

    def _observe(self) -> SwarmFact:
        now, gcs = self._clock.mono(), self._receives_ground()
        closed = {link.name for link in self._hub.links() if not link.open}
        with self._lock:
            self._agents = self._agent_count.update(self._peers.agents_on_links(now), now)
            period_s = self._period_s(self._agents)
            self._fresh_s = min(FRESH_S, FRESH_PERIODS * period_s)
            receives = not any(name in closed and now - at <= LINK_S for name, at in self._links.items())
            self._peers.watch(now, period_s, receives=receives)
            agreed = compute_consensus(self._peers, now)
            views_s = max(VIEWS_S, GROUND_PERIODS * period_s)
            # An agent that was started now must first receive the others; later they are known, and a leader is needed soon.
            known_s = views_s if now - self._began < views_s else VIEWS_S
            leader = self._election.leader(agreed, gcs and not self._awaits_views(agreed, now, period_s), now, known_s)
            no_gcs = self._without_ground(agreed, gcs, now, views_s)
            duplicate_ids, unlisted = self._peers.duplicate_ids(now), self._peers.unlisted(now)
            recent = [name for name, at in self._links.items() if now - at <= LINK_S]
            links = tuple(sorted(recent or self._links))  # an agent that receives none must still send that it does
            self._since = {
                agent: self._since_when(agent, status.state.value, now) for agent, status in agreed.statuses.items()
            }
            peers = {agent: self._peer(agent, agreed, now) for agent in agreed.statuses}
        return SwarmFact(
            self._own,
            agreed.members,
            len(agreed.living),
            peers,
            agreed.split,
            no_gcs,
            duplicate_ids,
            leader,
            gcs,
            now - self._began,
            links,
            unlisted,
            agreed.receive_none,
            period_s,
        )

    def _awaits_views(self, agreed: Consensus, now: float, period_s: float) -> bool:
        """Whether this agent was started only now, and an agent with a lower id may lead whose view has not been received yet."""
        new = now - self._began < LOST_PERIODS * period_s
        return new and any(agreed.statuses[agent].gcs is None for agent in agreed.living if agent < self._own)

    def _without_ground(self, agreed: Consensus, gcs: bool, now: float, views_s: float) -> tuple[int, ...]:
        """`without_gcs`; none while a ground station has only just appeared: the views of most are from before, for `views_s`."""
        if not (gcs or any(status.gcs for status in agreed.statuses.values())):
            self._ground_from = None
            return ()
        if self._ground_from is None:
            self._ground_from = now
        return without_gcs(agreed, gcs) if now - self._ground_from >= views_s else ()

    def wake_if_changed(self) -> None:
        """Compute the fact. The number of agents sets the links' budgets."""
        fact = self.snapshot()
        self._hub.set_agent_count(self._agents, leads=fact.leader == self._own)

    def _compare(self, fact: SwarmFact) -> None:
        picture = (
            {agent: (peer.state, peer.received_by, peer.gcs) for agent, peer in fact.peers.items()},
            fact.split,
            fact.no_gcs,
            fact.duplicate_ids,
            fact.leader,
            fact.receive_none,
        )
        with self._lock:
            changed, self._shown = picture != self._shown, picture
        if changed:
            self._on_wake()

    # ------------------------------------------------------------ from the endpoints' threads

    def _receive(self, message: Any, link: str) -> None:
        agent = message.get_srcSystem()
        if agent == self._own or agent not in tunnel.AGENTS or message.get_srcComponent() != self._component:
            return
        if self._signed and not message.get_signed():
            return
        beat = message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        received = self._heartbeat(agent, message, link) if beat else self._tunnel(agent, message)
        if received is None:
            return
        with self._lock:
            self._links[link] = self._clock.mono()
        if received:
            self._fresh = (0.0, None)
            self._on_wake()

    def _heartbeat(self, agent: int, message: Any, link: str) -> bool | None:
        """Whether it changes the state; None for a heartbeat of another program."""
        if message.type != mavlink.MAV_TYPE_ONBOARD_CONTROLLER:
            return None
        try:
            if message.custom_mode == 0 or status_word.decode(message.custom_mode) is None:
                return None  # other programs send an all-zero word
        except ValueError:
            return None
        with self._lock:
            return self._peers.heartbeat(
                agent,
                message.custom_mode,
                self._clock.mono(),
                leaving=message.system_status == mavlink.MAV_STATE_POWEROFF,
                booting=message.system_status == mavlink.MAV_STATE_BOOT,
                frame=message.get_seq(),
                link=link,
            )

    def _tunnel(self, agent: int, message: Any) -> bool | None:
        if message.payload_type != tunnel.PAYLOAD_TYPE or message.target_system not in (0, self._own):
            return None
        try:
            content = tunnel.decode(bytes(message.payload[: message.payload_length]))
        except tunnel.TunnelError:
            return None
        if not isinstance(content, tunnel.PeerView):
            return None
        with self._lock:
            return self._peers.add_view(agent, content, self._clock.mono())

    def _receives_ground(self) -> bool:
        age_s = self._gcs_age_s()
        return age_s is not None and age_s <= self._gcs_timeout_s and not self._gcs_unreachable()

    def _period_s(self, agents: int) -> float:
        """Period of heartbeats in a swarm of this size, in seconds."""
        return self._heartbeat_s or default_periods(agents)[0]

    def _since_when(self, agent: int, state: str, now: float) -> tuple[str, float]:
        was = self._since.get(agent)
        return was if was is not None and was[0] == state else (state, now)

    def _peer(self, agent: int, agreed: Consensus, now: float) -> PeerFact:
        status, peer = agreed.statuses[agent], self._peers.peer(agent)
        age_s = None if peer is None or peer.received_s is None else now - peer.received_s
        return PeerFact(
            status.state.value,
            age_s,
            status.received_by,
            status.not_received_by,
            status.gcs,
            status.word,
            now - self._since[agent][1],
            0 if peer is None else peer.restarts,
        )
