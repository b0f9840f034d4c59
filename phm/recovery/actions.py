"""The actions that come with PHM: start, restart, unpause, reconnect a container; join a network oneself."""

from __future__ import annotations

from phm.facts import Attachment, ContainerFact
from phm.model import Fault
from phm.recovery.base import Action, ActionContext, ActionFailed
from phm.settings import ContainerSettings


def _present(target: ContainerSettings, context: ActionContext) -> ContainerFact:
    fact = context.container(target.key)
    if fact is None:
        raise ActionFailed(f"there is no container {target.key}: create it, e.g. docker compose up -d")
    return fact


class Start(Action):
    """Start a container that has stopped."""

    name = "start"

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        fact = _present(target, context)
        if fact.status == "paused":
            raise ActionFailed(f"{target.key} is paused, not stopped: unpause it")
        context.engine.start(fact.id)
        return f"started {target.key}"


class Restart(Action):
    """Stop gracefully (SIGTERM, stop timeout), then start.

    SIGTERM first matters to ROS: a node that ends by itself takes its DDS participant with it, a killed
    one lingers in the graph until its lease ends.
    """

    name = "restart"
    deadline_s = 60.0

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        fact = _present(target, context)
        if fact.status == "paused":
            context.engine.unpause(fact.id)  # a frozen process cannot act on SIGTERM
        context.engine.restart(fact.id, context.settings.recovery.stop_timeout)
        return f"restarted {target.key}"


class Unpause(Action):
    """Let a paused container go on."""

    name = "unpause"

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        fact = _present(target, context)
        if fact.status != "paused":
            return f"{target.key} is no longer paused"
        context.engine.unpause(fact.id)
        return f"unpaused {target.key}"


class Reconnect(Action):
    """Disconnect a container from its expected networks by force and connect it as it was.

    The old attachment may be half there, or belong to a network that was recreated under the same name,
    so ids decide and not names; aliases and a fixed address are given back.
    """

    name = "reconnect"

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        fact = _present(target, context)
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
        return f"reconnected {target.key} to {', '.join(done)}" if done else f"{target.key} is connected already"


class Join(Action):
    """Connect PHM's own container to the networks of a container, so that it can see its nodes."""

    name = "join"
    on_myself = True

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        return join(target, context) or f"PHM is on the networks of {target.key} already"


def join(target: ContainerSettings, context: ActionContext) -> str:
    """Join every network of `target` that PHM's container is not on; what was joined, in words, or empty."""
    me = context.myself()
    if me is None or me.network_mode == "host":
        return ""
    joined = []
    for name in target.networks:
        network = str(context.engine.inspect_network(name).get("Id", ""))
        mine = next((entry for entry in me.networks if entry.name == name), None)
        if mine is not None and mine.network_id == network:
            continue
        if mine is not None:
            context.engine.disconnect(name, me.name, force=True)
        context.engine.connect(network, me.id, aliases=(), address="")
        joined.append(name)
    return f"PHM joined network {', '.join(joined)}" if joined else ""


def _aliases(before: Attachment | None, fact: ContainerFact) -> tuple[str, ...]:
    """The aliases it had, less the short id, which the engine adds by itself."""
    return tuple(alias for alias in before.aliases if alias != fact.id[:12]) if before else ()


def _address(before: Attachment | None) -> str:
    """Only an address that the user fixed may be asked for: the engine refuses others on default subnets."""
    return before.fixed_address if before else ""
