"""Reconnect a container to its networks."""

from __future__ import annotations

import contextlib

from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact, NotPermitted
from phm.recovery.actions._networks import connect, missing, network_id, not_there
from phm.recovery.actions.join_network import join_networks
from phm.recovery.actions.restart import Restart, restart_dependents, restart_gracefully
from phm.recovery.base import (
    Action,
    ActionContext,
    FlightCriticalError,
    Impact,
    NotNeeded,
    NotYet,
    Target,
    container_settings,
    present,
)


class Reconnect(Action):
    """Disconnect a container from its expected networks by force and connect it as it was; restart its ROS nodes if the vehicle is
    disarmed.

    The old attachment may be half there, or belong to a network that was recreated under the same name,
    so ids decide and not names; aliases and a fixed address are given back.

    The container gets a new network interface, on which the sockets of its programs have not joined their multicast groups.
    Nodes keep the connections that they had if the outage was shorter than their DDS lease, but nodes and tools that start
    later never find them. Only a restart of the program changes that.
    """

    name = "reconnect"
    impact = Impact.NETWORK
    deadline_s = Restart.deadline_s
    # A node that has lost its network for good stays listed until its lease ends (1 s with config/fastdds.xml).
    verify_after_s = 2.0
    # The kernel of an attached interface answers immediately; one whose address is silent now stays so.
    still_bad_after_s: float | None = 1.0
    # Its processes go on and find each other by the next announcement, 3 s apart by Fast DDS's default, or not at all: a socket
    # keeps its multicast membership on the interface that is gone.
    dependents_within_s: float | None = 6.0

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        container = container_settings(target)
        gone = missing(container.networks, context)
        return not_there(gone) if gone and not _due(container, fault, present(target, context), context) else ""

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        container, fact = container_settings(target), present(target, context)
        gone = missing(container.networks, context)
        done: list[str] = []
        for name, network in _due(container, fault, fact, context):
            reached = connect(container, fact, name, network, context)
            (done if reached else gone).append(name)
        if gone and not done:
            raise NotYet(not_there(gone))
        if not done:
            return NotNeeded(f"{target.key} is already connected")
        waits = f"; {not_there(gone)}" if gone else ""
        joined = _join(container, context)
        # The engine may refuse to start a container again whose network is gone. When that is there, this action is done again.
        renewed = "" if gone else self._renew_sockets(target, fault, context)
        return f"reconnected {target.key} to {', '.join(done)}{waits}{joined}{renewed}"

    def _renew_sockets(self, target: Target, fault: Fault, context: ActionContext) -> str:
        """Restart the container if ROS nodes run in it, and only while the vehicle is disarmed: in the air the connections that are
        left are worth more than those that could be made. A ladder of the user without `restart` forbids it, and so does
        an operator who puts it on hold meanwhile.
        """
        settings = context.settings
        has_nodes = any(settings.container_of_node(node.name) == target.key for node in settings.ros.nodes)
        ladder = settings.recovery.ladders.get(fault.result.condition, [Restart.name])
        fact = context.container(target.key)
        if not has_nodes or Restart.name not in ladder or fact is None or not fact.running:
            return ""
        later = f"; nodes that start later find those of {target.key} only after its restart, which is not done now"
        armed = context.armed()
        if why := armed.why if armed.restricts else context.on_hold(target.key):
            return f"{later}: {why}"
        try:
            restart_gracefully(fact, context)
        except (FlightCriticalError, NotPermitted) as error:  # the reconnection itself was permitted
            return f"{later}: {error}"
        self.still_bad_after_s = self.dependents_within_s = None  # now something has to start
        return f" and restarted it: its sockets had left their multicast groups{restart_dependents(target, fault, context)}"


def _join(container: ContainerSettings, context: ActionContext) -> str:
    """What takes the container off a network often takes PHM off it, too; then the container's unit stays bad until PHM is back.

    A clause for the log; empty: PHM is on the networks already, or cannot join them, which the next result shows.
    """
    with contextlib.suppress(CannotTell):
        joined = join_networks(container, context)
        return f"; {joined}" if joined else ""
    return ""


def _due(
    container: ContainerSettings, fault: Fault, fact: ContainerFact, context: ActionContext
) -> list[tuple[str, str]]:
    """Name and id of each existing network that the container is to be connected to; all of them when its address is silent."""
    attached = {entry.name: entry for entry in fact.networks}
    due = []
    for name in container.networks:
        network, now = network_id(name, context), attached.get(name)
        is_as_it_must_be = now is not None and now.network_id == network and (now.address or not container.address)
        if network and (fault.result.condition == "address_silent" or not is_as_it_must_be):
            due.append((name, network))
    return due
