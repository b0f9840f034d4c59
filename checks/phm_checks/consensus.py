"""Slot 6: the nodes agree on which nodes are alive, and the nodes are not split into groups.

The check `nodes` reports dead and hung nodes by PHM's own evidence. This check reports what only the nodes themselves can observe,
also a node that most of them do not receive while PHM still considers it alive, and a subscriber that has lost its publisher.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._lost_publishers import SETTLE_S as LOST_SETTLE_S, Connection, LostPublishers, connections
from phm_checks._node_consensus import PHM, Agreement, Opinion, Verdict, agree
from phm_checks._quorum import SETTLE_S as QUORUM_SETTLE_S, DeadNodes, ReceivedBefore, ended, received_by_others
from phm_checks._ros_facts import OLD_SNAPSHOT_S, SILENT_PERIODS, full_name
from phm_checks._text import brief, last, listed, span

FORGET_S = 60.0
"""A beacon silent for longer is ignored: its node was changed, or its beacon closed."""
LOST_S = 10.0
"""A required beacon silent for longer, and for several periods, while its node is listed, is missing."""
FRESH_S = 5.0
"""A diagnostic status younger than this shows that the node is alive; diagnostic_updater sends one per second."""
CROWDED_S = 5.0
"""After beacons were lost among too many messages, the result is STALE for this long."""
SETTLE_S = 3.0
"""After a node died or started, the views of the other nodes differ briefly."""
REMEDY = (
    "check the network and ROS_DOMAIN_ID between them; nodes in different containers that share no /dev/shm need "
    "FASTDDS_BUILTIN_TRANSPORTS=UDPv4"
)


class Consensus(api.Check):
    """One unit for all configured nodes. It depends on their units: a dead node is one fault, not also a disagreement."""

    name, slot, layer = "consensus", Slot.NODES, Layer.ROS
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._grace_s = settings.ros.grace
        self._nodes = [full_name(node.name) for node in settings.ros.nodes]
        self._required = [full_name(node.name) for node in settings.ros.nodes if node.beacon == "required"]
        self._open_faults = settings.ros.consensus.open_faults
        self._known: set[str] = set()
        """Nodes whose beacon PHM has received."""
        self._bad = False
        """Whether the last result that was not STALE was bad."""
        self._dead = DeadNodes(self._nodes)
        self._containers = {node: settings.container_of_node(node) for node in self._nodes}
        subscribed = connections(settings, self._nodes)
        self._lost = LostPublishers(subscribed)
        in_run: dict[Hashable, str] = {one: self._containers[one.subscriber] for one in subscribed}
        in_run.update(self._containers)
        self._received = ReceivedBefore(in_run)
        keys = list(dict.fromkeys(filter(None, self._containers.values())))
        needs = [f"{check}/{key}" for key in keys for check in ("container", "network")]
        needs += [f"nodes/{api.topic_id(node)}" for node in self._nodes]
        target = keys[0] if len(keys) == 1 else ""
        self._unit = api.Unit(self.name, tuple(needs), target, settle_s=SETTLE_S, grace_s=self._grace_s)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if settings.ros.nodes else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return (self._unit,)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> api.Result:
        result = self._run(world)
        if result.level is not Level.STALE:
            self._bad = result.level.bad
        return result

    def _run(self, world: api.World) -> api.Result:
        now = world.clock.mono()
        try:
            fact = world.ros.snapshot()
        except api.CannotTell as reason:
            self._forget()
            return api.stale(str(reason))
        self._dead.list(fact.nodes, now)
        beacons = self._beacons(fact)
        result = self._unknown(fact) or self._lacking(fact, beacons) or (None if beacons else self._none_received(fact))
        if result is not None:
            self._forget()
            return result
        closed = [
            name
            for name, beacon in beacons.items()
            if ended(beacon, fact.age_s)
            and (receives(fact, name, self._nodes) or self._dead.restarted(name, beacon, now))
        ]
        for name in closed:
            del beacons[name]
        others = {name: receives(fact, name, self._nodes) for name in self._nodes if name not in beacons}
        agreement = agree(beacons, others, fact.age_s)
        lost = self._lost.observe(beacons, fact.age_s, now)
        self._received.observe(world, [*received_by_others(agreement), *self._lost.received])
        dead = self._dead.observe(agreement, beacons, now)
        result = None if (dead or lost) and self._open_faults else _copied(fact, beacons)
        result = result or self._judge(agreement, dead, lost, fact, beacons)
        if result.level is Level.OK:
            result = self._not_yet(fact, agreement) or result
        self._known.update(beacons)
        return replace(result, votes=_votes(agreement))

    def _not_yet(self, fact: api.RosFact, agreement: Agreement) -> api.Result | None:
        """STALE while a new ROS child process has not received all beacons that were known before, or what was reported may not
        have lasted long enough for it to be reported again."""
        if fact.up_s >= self._grace_s:
            return None
        awaited = [name for name in self._nodes if name in self._known and name not in fact.beacons]
        if awaited:
            return api.stale(
                f"no beacon received from {_names(awaited)} yet; PHM has listened for only {span(fact.up_s)}"
            )
        dead = [item.node for item in agreement.opinions if item.verdict is Verdict.DEAD]
        if self._bad and dead:
            return api.stale(
                f"{_names(dead)} is not received; PHM has listened for only {span(fact.up_s)}, so it is not known yet"
            )
        return None

    def _forget(self) -> None:
        """The consensus is unknown."""
        self._dead.clear()
        self._lost.clear()

    @staticmethod
    def _unknown(fact: api.RosFact) -> api.Result | None:
        """STALE without a current snapshot with all beacons."""
        if fact.age_s > OLD_SNAPSHOT_S:
            return api.stale(f"the newest ROS graph snapshot is {span(fact.age_s)} old, too old to evaluate")
        if fact.lost_s is not None and fact.lost_s <= CROWDED_S:
            return api.stale(
                "more messages arrive on /phm/beacon than PHM can read: which nodes are reachable is unknown"
            )
        return None

    def _beacons(self, fact: api.RosFact) -> dict[str, api.BeaconFact]:
        """Those of the configured nodes; not one that was closed long ago, unless its node is reported as dead."""
        return {
            name: fact.beacons[name]
            for name in self._nodes
            if name in fact.beacons and (fact.beacons[name].age_s <= FORGET_S or name in self._dead.reported)
        }

    def _lacking(self, fact: api.RosFact, beacons: Mapping[str, api.BeaconFact]) -> api.Result | None:
        """The result for required beacons that are missing although their node is listed; None when there are none."""
        lacking = [
            name
            for name in self._required
            if name in fact.nodes
            and (name not in beacons or (beacons[name].silent_s > LOST_S and beacons[name].missed > SILENT_PERIODS))
        ]
        if not lacking:
            return None
        if fact.up_s < self._grace_s:
            return api.stale(
                f"no beacon received from {_names(lacking)} yet; PHM has listened for only {span(fact.up_s)}"
            )
        return api.error(
            f"no beacon received from {_names(lacking)}, which is required: add Beacon(node) to the node (phm/beacon.py) and "
            f"check that PHM_BEACON is not off{_refused(fact)}",
            brief=brief(last(lacking[0]), "has no beacon"),
            condition="beacon_missing",
            values={"refused": fact.refused},
        )

    def _none_received(self, fact: api.RosFact) -> api.Result:
        if fact.refused:
            return api.warn(
                f"no beacon received from the configured nodes{_refused(fact)}",
                brief="beacons refused",
                condition="beacons_refused",
                values={"refused": fact.refused},
            )
        if fact.up_s < (FORGET_S if self._bad else self._grace_s):
            return api.stale(
                f"no beacon received from the configured nodes yet; PHM has listened for only {span(fact.up_s)}"
            )
        words = "No beacon received from the configured nodes: PHM is their only observer"
        return api.bypass(words).with_evidence(api.Evidence(unobserved=True))

    def _judge(
        self,
        agreement: Agreement,
        dead: Sequence[Opinion],
        lost: Sequence[Connection],
        fact: api.RosFact,
        beacons: Mapping[str, api.BeaconFact],
    ) -> api.Result:
        hung = [item.node for item in agreement.opinions if item.verdict is Verdict.HUNG]
        values: dict[str, api.Value] = {
            "nodes": len(self._nodes),
            "alive": len(agreement.alive),
            "hung": len(hung),
            "observers": len(agreement.observers),
            "beacons": len(beacons),
            "refused": fact.refused,
        }
        if len(agreement.observers) == 1:
            return api.stale("no beacon received at the moment: no peers left for consensus")
        if dead and self._open_faults:
            return self._quorum_dead(agreement, dead, values)
        if lost and self._open_faults:
            return self._publisher_not_received(agreement, lost, values)
        if agreement.split:
            count = "|".join(str(len(side)) for side in _sides(agreement))
            words = _statement([_split(agreement), *_disagreements(agreement)], REMEDY)
            return api.Result(Level.WARN, words, brief("nodes split", count), "nodes_split", "", values)
        disagreements = _disagreements(agreement)
        if disagreements:
            first = agreement.disagreements[0]
            short = brief(last(first.node), f"not seen by {last(first.not_received_by[0])}"[:30])
            return api.Result(Level.WARN, _statement(disagreements, REMEDY), short, "partly_received", "", values)
        stuck = f"; the executor of {_names(hung)} is blocked" if hung else ""
        return api.ok(f"{_agreed(agreement)}{_alone(agreement, beacons)}{stuck}", values=values)

    def _quorum_dead(
        self, agreement: Agreement, dead: Sequence[Opinion], values: Mapping[str, api.Value]
    ) -> api.Result:
        """ERROR for nodes that the majority has not received for long. Without a target if PHM does not receive the node
        either: then `nodes` knows a reason why it may be alive, such as a process that uses the CPU."""
        received = [item.node for item in dead if PHM in item.received_by]
        received.sort(key=lambda node: self._received.never(node) is True)
        words = [
            f"{_names([item.node])} is dead by majority: it is not received by {_names(item.not_received_by)}"
            + (f", but is received by {_names(item.received_by)}" if item.received_by else "")
            for item in dead
        ]
        words.append(_split(agreement) if agreement.split else "")
        step = REMEDY if received else "check its log and `docker top`; PHM restarts nothing for this"
        return api.Result(
            Level.ERROR,
            _statement(words, step),
            brief(last(dead[0].node), "dead by majority"),
            "quorum_dead",
            self._containers[received[0]] if received else "",
            values,
            settle_s=0.0 if received else QUORUM_SETTLE_S,
            evidence=api.Evidence(never_ok=self._received.never(received[0]) if received else None),
        )

    def _publisher_not_received(
        self, agreement: Agreement, lost: Sequence[Connection], values: Mapping[str, api.Value]
    ) -> api.Result:
        """ERROR for subscribers that do not receive the node of their publisher, while PHM receives both."""
        # A restart restores only what was received before, and needs a container.
        first = min(lost, key=lambda one: (self._received.never(one) is True, not self._containers[one.subscriber]))
        words = [
            f"{_names([one.subscriber])} does not receive {_names([one.publisher])}, which publishes {_names([one.topic])} for it, "
            "while PHM receives both"
            for one in lost
        ]
        words.append(_split(agreement) if agreement.split else "")
        return api.Result(
            Level.ERROR,
            _statement(words, REMEDY),
            brief(last(first.subscriber), f"does not receive {last(first.publisher)[:12]}"),
            "publisher_not_received",
            self._containers[first.subscriber],
            values,
            settle_s=LOST_SETTLE_S,
            evidence=api.Evidence(never_ok=self._received.never(first)),
        )


def _copied(fact: api.RosFact, beacons: Mapping[str, api.BeaconFact]) -> api.Result | None:
    """WARN for a second publisher of a node's beacon. Two nodes with one name are reported by the check `nodes` instead."""
    by = {name: beacon.copied_by for name, beacon in beacons.items() if beacon.copied_by}
    twice = [name for name, beacon in beacons.items() if beacon.rivals and fact.nodes.get(name, 0) < 2]
    if not by and not twice:
        return None
    names = list(dict.fromkeys((*by, *twice)))
    who = f": {listed(dict.fromkeys(by.values()), 3)}" if by else ""
    return api.warn(
        f"beacons of {_names(names)} also come from a second publisher{who}; PHM refuses them and uses the first: find out which participant "
        "publishes on /phm/beacon. Any participant of the ROS domain can; SROS2 prevents it",
        brief=brief(last(names[0]), "beacon copied"),
        condition="beacon_copied",
        target="",
        values={"copied": len(names), "refused": fact.refused},
    )


def receives(fact: api.RosFact, node: str, nodes: Iterable[str]) -> bool:
    """Whether PHM receives data from a node without a beacon: a topic that it alone publishes, or its diagnostics."""
    for topic in fact.topics.values():
        if topic.rate is not None and {end.node for end in topic.publishers} == {node} and topic.rate.hz:
            return True
    # diagnostic_updater names a status `node: task`, without the namespace.
    names = [node, node[1:]] + [last(node)] * (sum(last(other) == last(node) for other in nodes) == 1)
    return any(status.age_s <= FRESH_S and name.partition(":")[0] in names for name, status in fact.diagnostics.items())


def _agreed(agreement: Agreement) -> str:
    nodes = len(agreement.opinions)
    return f"{len(agreement.alive)} of {nodes} nodes are alive according to {_names(agreement.observers)}"


def _alone(agreement: Agreement, beacons: Mapping[str, api.BeaconFact]) -> str:
    """The part of the summary about nodes without a beacon, which PHM alone can observe."""
    observed = [item.node for item in agreement.opinions if item.node not in beacons and item.received_by]
    unobserved = [item.node for item in agreement.opinions if item.node not in beacons and not item.received_by]
    words = f"; {_names(observed)} without a beacon, observed by PHM only" if observed else ""
    return words + (f"; no observer for {_names(unobserved)}" if unobserved else "")


def _sides(agreement: Agreement) -> list[tuple[str, ...]]:
    return sorted(agreement.sides, key=len, reverse=True)


def _split(agreement: Agreement) -> str:
    sides = " | ".join(map(_names, _sides(agreement)))
    return f"the nodes are split: {sides} do not receive each other, while PHM receives all of them"


def _votes(agreement: Agreement) -> tuple[api.NodeVotes, ...]:
    return tuple(
        api.NodeVotes(
            api.topic_id(item.node),
            item.verdict.value,
            tuple(map(api.topic_id, item.received_by)),
            tuple(map(api.topic_id, item.not_received_by)),
        )
        for item in agreement.opinions
    )


def _disagreements(agreement: Agreement) -> list[str]:
    return [
        f"{_names([item.node])} is not received by {_names(item.not_received_by)}, but is received by {_names(item.received_by)}"
        f"{'; most do not receive it' if item.verdict is Verdict.DEAD else ''}"
        for item in agreement.disagreements
    ]


def _statement(findings: Iterable[str], step: str) -> str:
    """The findings that are not empty, and what to do."""
    return f"{'; '.join(filter(None, findings))}: {step}"


def _names(nodes: Iterable[str]) -> str:
    return listed(map(api.topic_id, nodes))


def _refused(fact: api.RosFact) -> str:
    if not fact.refused:
        return ""
    return (
        f"; {fact.refused} messages on /phm/beacon were refused: they have another version; give the nodes this PHM's "
        "phm/beacon.py"
    )
