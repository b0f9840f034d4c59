"""Connect PHM itself to the networks of a container."""

from __future__ import annotations

from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.facts import Attachment, ContainerFact, NotPermitted
from phm.recovery.actions._networks import addresses, aliases, missing, network_id, not_there
from phm.recovery.base import Action, ActionContext, ActionFailed, NotNeeded, Target, container_settings
from phm.transport.docker import EngineBroken, EngineConflict


class JoinNetwork(Action):
    """Connect PHM's own container to the networks of a container, so that it can see its nodes."""

    name = "join_network"
    starts = False
    leaves_running = True
    on_phm_itself = True

    # A network that PHM's container is on is there immediately.
    still_bad_after_s = 1.0
    # The application was never off its network; that PHM has not discovered all of its nodes yet does not show the opposite.
    proven_by_unit = True

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        networks = container_settings(target).networks
        gone = missing(networks, context)
        return not_there(gone) if gone and len(gone) == len(networks) else ""

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        me = context.own_container()
        if me is not None and shares_network(me):
            raise ActionFailed("PHM shares the network of another container: connect that one")
        joined = rejoin_networks(container_settings(target), context)
        return joined or NotNeeded(f"PHM is on the networks of {target.key} already")


def shares_network(me: ContainerFact) -> bool:
    """Whether PHM uses the network namespace of another container: the engine connects that one to networks, not PHM."""
    return me.network_mode.startswith("container:")


def rejoin_networks(container: ContainerSettings, context: ActionContext) -> str:
    """As `join_networks`, while ROS runs: a DDS participant does not use an interface that was added after its start."""
    joined = join_networks(container, context)
    if joined:
        context.restart_ros("PHM joined a network")
    return joined


def _connect(network: str, me: ContainerFact, before: Attachment | None, context: ActionContext) -> None:
    """As it was connected before, if that is known: others may use PHM's aliases and its fixed addresses."""
    names, fixed = aliases(before, me), addresses(before)
    try:
        context.engine.connect(network, me.name, aliases=names, addresses=fixed)
    except (EngineConflict, EngineBroken):
        if not fixed:
            raise
        # Another container has the address, or the network another subnet now. PHM needs the network more than its address there.
        context.engine.connect(network, me.name, aliases=names)


def join_networks(container: ContainerSettings, context: ActionContext) -> str:
    """Join every network of the container that exists and PHM's container is not on; what was joined, in words, or empty."""
    me = context.own_container()
    if me is None or me.network_mode == "host" or shares_network(me):
        return ""
    joined = []
    for name in container.networks:
        network = network_id(name, context)
        if not network:
            continue  # joined when it is there: the check of the container's networks sees that
        mine = next((entry for entry in me.networks if entry.name == name), None)
        if mine is not None and mine.network_id == network:
            continue
        if mine is not None:
            context.engine.disconnect(name, me.name, force=True)
        try:
            _connect(network, me, mine or context.own_attachment(name), context)
        except NotPermitted:
            # The engine answers 403 also when the container is on the network already, e.g. because PHM was quicker.
            if me.id not in context.engine.inspect_network(network).get("Containers", {}):
                raise
            continue
        joined.append(name)
    return f"PHM joined network {', '.join(joined)}" if joined else ""
