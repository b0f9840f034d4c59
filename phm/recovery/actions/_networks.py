"""The networks that a container is to be on: which of them exist, and putting a container on one.

Networks are compared by id: one that was removed and created again under the same name is another one, and a stopped
container that was on the old one cannot even be started.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable

from phm.core.settings import ContainerSettings
from phm.facts import Attachment, CannotTell, ContainerFact, NotPermitted
from phm.recovery.base import ActionContext
from phm.transport.docker import EngineMissing


def network_id(name: str, context: ActionContext) -> str:
    """Id of the network of this name; empty when there is none. Raises CannotTell."""
    try:
        network = context.engine.inspect_network(name)
    except EngineMissing:
        return ""
    # The engine also takes the beginning of an id for a name.
    return str(network.get("Id") or "") if network.get("Name") == name else ""


def missing(names: Iterable[str], context: ActionContext) -> list[str]:
    """Those of these networks that do not exist now. Raises CannotTell."""
    return [name for name in names if not network_id(name, context)]


def not_there(names: Iterable[str]) -> str:
    """A sentence that says which networks are missing."""
    return f"there is no network {', '.join(names)}: PHM waits until it is created"


def has_its_own(fact: ContainerFact) -> bool:
    """Whether the container has its own network namespace, which can be connected to networks."""
    return fact.network_mode not in ("host", "none") and not fact.network_mode.startswith("container:")


def connect(container: ContainerSettings, fact: ContainerFact, name: str, network: str, context: ActionContext) -> bool:
    """Connect the container to the network of this name and id, as it was connected before. An old attachment is removed
    first. Returns False if the network has been removed meanwhile. Raises CannotTell."""
    left = next((one for one in fact.networks if one.name == name), None)
    before = context.last_attachment(container.key, name) or left
    try:
        if left is not None:
            context.engine.disconnect(name, fact.name, force=True)
        context.engine.connect(network, fact.name, aliases=aliases(before, fact), addresses=addresses(before))
    except (EngineMissing, NotPermitted):
        # For a removed network, a socket proxy refuses the call instead of reporting that the network does not exist.
        if network_id(name, context) == network:
            raise
        return False
    return True


def reconnect_stopped(container: ContainerSettings, fact: ContainerFact, context: ActionContext) -> None:
    """Connect a stopped container to networks that were recreated since it stopped: otherwise the engine refuses to start it. And to
    those from which it was disconnected: there it has no address and no nodes until it is connected again."""
    for name in stale(container, fact, context):
        connect(container, fact, name, network_id(name, context), context)
    for name in _disconnected(container, fact, context):
        with contextlib.suppress(CannotTell):  # it starts without, and what the network lacks is another fault
            if network := network_id(name, context):
                connect(container, fact, name, network, context)


def _disconnected(container: ContainerSettings, fact: ContainerFact, context: ActionContext) -> list[str]:
    """Configured networks that a container is not on, and on which PHM has seen it: only then it gets its aliases and addresses
    again."""
    on = {one.name for one in fact.networks}
    names = [name for name in container.networks if name not in on] if has_its_own(fact) else []
    return [name for name in names if context.last_attachment(container.key, name) is not None]


def stale(container: ContainerSettings, fact: ContainerFact, context: ActionContext) -> list[str]:
    """Configured networks of a stopped container that were removed or recreated: its attachment still has the old id."""
    known = [one for one in fact.networks if one.name in container.networks]
    return [one.name for one in known if one.network_id != network_id(one.name, context)]


def aliases(before: Attachment | None, fact: ContainerFact) -> tuple[str, ...]:
    """The aliases that it had, without the short id, which the engine adds by itself."""
    return tuple(alias for alias in before.aliases if alias != fact.id[:12]) if before else ()


def addresses(before: Attachment | None) -> tuple[str, ...]:
    """Only addresses that the user fixed may be asked for: the engine refuses others on default subnets."""
    return before.fixed_addresses if before else ()


def is_silent(attached: Attachment, context: ActionContext) -> bool:
    """Whether PHM can reach the network, and the address responds to neither of two pings: by the same rules as the check.
    Raises CannotTell."""
    if not attached.address or not _reached(attached.network_id, context):
        return False
    return not (context.reachable(attached.address) or context.reachable(attached.address))


def _reached(network: str, context: ActionContext) -> bool:
    """On the host's network PHM reaches bridge networks only; see `phm_checks.network`."""
    me = context.own_container()
    if me is not None and any(one.network_id == network for one in me.networks):
        return True
    on_host = me is None or me.network_mode == "host"
    return on_host and context.engine.inspect_network(network).get("Driver") == "bridge"
