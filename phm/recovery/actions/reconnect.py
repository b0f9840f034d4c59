"""Reconnect a container to its networks."""

from __future__ import annotations

import contextlib
import threading

from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact, NotPermitted
from phm.recovery.actions._networks import connect, is_silent, missing, network_id, not_there
from phm.recovery.actions.join_network import rejoin_networks
from phm.recovery.actions.restart import Restart, restart_dependents, restart_gracefully, restart_limit_s
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
from phm.recovery.safety.armed_state import ArmedStatus

DECIDED_S = 0.1
"""The armed state is asked for this long after heartbeats decide again."""


class Reconnect(Action):
    """Disconnect a container by force from its expected networks that are faulty, and connect it as before. If ROS nodes run in it
    and the vehicle is disarmed, restart it, too.

    The engine may still list a part of the old attachment, or one to a network that was recreated under the same name. So
    PHM compares the ids of networks and not their names. It restores aliases and fixed addresses.

    The container gets a new network interface, on which the sockets of its programs have not joined their multicast groups.
    Nodes keep their connections if the outage was shorter than their DDS lease, but nodes and tools that start later do not
    find them. Only a restart of the program changes that.
    """

    name = "reconnect"
    impact = Impact.NETWORK
    leaves_running = True
    # A node that has lost its network permanently stays listed until its lease ends (1 s with config/fastdds.xml).
    verify_after_s = 2.0
    # On a connected interface the kernel answers immediately. An address that is silent after this time stays silent.
    still_bad_after_s: float | None = 1.0
    # The nodes keep running. They find each other with the next announcement (every 3 s by default in Fast DDS), or never:
    # a socket keeps its multicast membership on the interface that was removed.
    dependents_within_s: float | None = 6.0

    def limit_s(self, context: ActionContext) -> float:
        return restart_limit_s(context)

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        container = container_settings(target)
        gone = missing(container.networks, context)
        return not_there(gone) if gone and not _due(container, fault, present(target, context), context) else ""

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        container, fact = container_settings(target), present(target, context)
        gone = missing(container.networks, context)
        done: list[str] = []
        for name, network in _due(container, fault, fact, context, pinged=True):
            reached = connect(container, fact, name, network, context)
            (done if reached else gone).append(name)
        if gone and not done:
            raise NotYet(not_there(gone))
        if not done:
            return NotNeeded(f"{target.key} is already connected")
        waits = f"; {not_there(gone)}" if gone else ""
        joined = _join(container, context)
        # The engine may refuse to restart a container while one of its networks is missing. This action runs again once the
        # network exists.
        renewed = "" if gone else self._renew_sockets(target, fault, context)
        return f"reconnected {target.key} to {', '.join(done)}{waits}{joined}{renewed}"

    def _renew_sockets(self, target: Target, fault: Fault, context: ActionContext) -> str:
        """Restart the container if ROS nodes run in it and the vehicle is disarmed. Returns a clause for the log.

        In the air, connections that still work are more important than new ones. A user's ladder without `restart` also
        forbids it, and so does a hold that an operator begins meanwhile.
        """
        settings = context.settings
        ladder = settings.recovery.ladders.get(fault.result.condition, [Restart.name])
        if not settings.nodes.get(target.key) or Restart.name not in ladder:
            return ""
        armed = _armed(context)  # this may take seconds, so the container is looked at after it
        fact = context.container(target.key)
        if fact is None or not fact.running:
            return ""
        later = (
            f"; nodes that start later do not find those of {target.key} until it is restarted, which is not done now"
        )
        if armed.restricts:
            return f"{later}: {armed.why}"
        if held := context.on_hold(target.key):
            return f"{later}: it is {held}"
        try:
            restart_gracefully(fact, context)
        except (FlightCriticalError, NotPermitted) as error:  # the reconnection itself was permitted
            return f"{later}: {error}"
        self.still_bad_after_s = self.dependents_within_s = None  # after a restart, nodes need time to start
        followed = restart_dependents(target, fact, fault, context)
        return f" and restarted it, because its sockets had left their multicast groups{followed}"


def _armed(context: ActionContext) -> ArmedStatus:
    """The armed state of the vehicle. A machine that is so busy that PHM was suspended delays the answer and does not decide it."""
    armed = context.armed()
    if armed.undecided_s:
        context.clock.wait(threading.Event(), armed.undecided_s + DECIDED_S)
        armed = context.armed()
    return armed


def _join(container: ContainerSettings, context: ActionContext) -> str:
    """Connect PHM itself to the networks. What disconnects the container often disconnects PHM, too, and without PHM on the
    network the unit stays bad.

    Returns a clause for the log. It is empty if PHM is already connected, or cannot be: the next result shows that.
    """
    with contextlib.suppress(CannotTell):
        joined = rejoin_networks(container, context)
        return f"; {joined}" if joined else ""
    return ""


def _due(
    container: ContainerSettings, fault: Fault, fact: ContainerFact, context: ActionContext, *, pinged: bool = False
) -> list[tuple[str, str]]:
    """Name and id of each existing network to which the container must be connected. If an address is silent: also the network
    where it is (`pinged`), or all where it may be."""
    may_be_silent = fault.result.condition == "address_silent"
    attached = {entry.name: entry for entry in fact.networks}
    due = []
    for name in container.networks:
        network, now = network_id(name, context), attached.get(name)
        if network and (
            now is None
            or now.network_id != network
            or (container.address and not now.address)
            or (may_be_silent and (not pinged or is_silent(now, context)))
        ):
            due.append((name, network))
    return due
