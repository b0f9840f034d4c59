"""Put a container back on its networks."""

from __future__ import annotations

from phm.facts import Attachment, ContainerFact
from phm.model import Fault
from phm.recovery.actions._common import present
from phm.recovery.base import Action, ActionContext, Unneeded
from phm.recovery.critical import Reach
from phm.settings import ContainerSettings


class Reconnect(Action):
    """Disconnect a container from its expected networks by force and connect it as it was.

    The old attachment may be half there, or belong to a network that was recreated under the same name,
    so ids decide and not names; aliases and a fixed address are given back.
    """

    name = "reconnect"
    takes_down = Reach.NETWORK
    # A node that has lost its network for good stays listed until its lease ends (1 s with config/fastdds.xml).
    proof_s = 2.0
    # The kernel of an attached interface answers at once; one whose address is silent now stays so.
    shows_s = 1.0
    # Its processes go on and find each other by the next announcement, 3 s apart by Fast DDS's default, or not at all: a socket
    # keeps its multicast membership on the interface that is gone.
    follow_s = 6.0

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        attached = {entry.name: entry for entry in fact.networks}
        silent = fault.result.condition == "address_silent"
        done: list[str] = []
        for name in target.networks:
            network = str(context.engine.inspect_network(name).get("Id", ""))
            now = attached.get(name)
            if now is not None and now.network_id == network and not silent:
                continue
            if now is not None:
                context.engine.disconnect(name, fact.name, force=True)
            before = context.remembered(target.key, name) or now
            context.engine.connect(network, fact.name, aliases=_aliases(before, fact), address=_address(before))
            done.append(name)
        if not done:
            return Unneeded(f"{target.key} is connected already")
        return f"reconnected {target.key} to {', '.join(done)}"


def _aliases(before: Attachment | None, fact: ContainerFact) -> tuple[str, ...]:
    """The aliases it had, less the short id, which the engine adds by itself."""
    return tuple(alias for alias in before.aliases if alias != fact.id[:12]) if before else ()


def _address(before: Attachment | None) -> str:
    """Only an address that the user fixed may be asked for: the engine refuses others on default subnets."""
    return before.fixed_address if before else ""
