"""Start one ROS node again inside its container, with the configured command."""

from __future__ import annotations

from phm.core.model import Fault
from phm.core.settings import NodeSettings
from phm.facts import CannotTell
from phm.recovery.base import Action, ActionContext, ActionFailed, ActionSettings, Impact, NotNeeded, Target, present


class Relaunch(Action):
    """Run `nodes[].relaunch` through the engine's exec: word by word, detached, as the container's own user.

    It never starts a duplicate of a node. A node that is still listed, or whose command still runs, is left to the next
    step of the ladder, which restarts the container and so ends the hung process too.
    """

    name = "relaunch"
    starts = False
    impact = Impact.NOTHING
    # A node that fails to start also uses the CPU for a moment, while the name of the dead one is still listed.
    verify_after_s = 2.0

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
        return _node(target, fault, settings) is not None

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        node = _node(target, fault, context.settings)
        if node is None:
            raise ActionFailed(f"no relaunch command is configured for {fault.unit}: add it to its node in ros.nodes")
        name = f"/{node.name.lstrip('/')}"
        if self._listed(name, fault, context):
            if fault.result.condition == "node_missing":
                return NotNeeded(f"{name} is listed again")
            raise ActionFailed(f"{name} is still running, and a second copy would disturb it: relaunch does not help")
        fact = present(target, context)
        if _runs(" ".join(node.relaunch), fact.id, context):
            raise ActionFailed(f"the command of {name} still runs in {target.key}, so a second copy is not started")
        context.engine.exec_detached(fact.id, node.relaunch)
        return f"relaunched {name} in {target.key}: {' '.join(node.relaunch)}"

    @staticmethod
    def _listed(name: str, fault: Fault, context: ActionContext) -> bool:
        """Without a graph, a node reported as missing counts as missing, and any other as present.

        A node can be reported missing while it is listed: its name stays until its lease ends.
        """
        missing = fault.result.condition == "node_missing"
        still_listed = (fault.result.evidence.listed or 0) if missing else 0
        try:
            return context.listed_nodes().get(name, 0) > still_listed
        except CannotTell:
            return not missing


def _node(target: Target, fault: Fault, settings: ActionSettings) -> NodeSettings | None:
    """The node to start for this fault; None if it does not run in the target, or has no command."""
    nodes = settings.nodes.get(target.key, ())
    return next((node for node in nodes if node.relaunch and node.name.lstrip("/") == fault.node.lstrip("/")), None)


def _runs(command: str, container: str, context: ActionContext) -> bool:
    """Whether a process of the container has this command line; an interpreter may precede it."""
    rows = context.engine.top(container).get("Processes") or []
    if not isinstance(rows, list):
        raise CannotTell("the Docker Engine answered without a process list")
    return any(f" {command}" in f" {row[-1]}" for row in rows if isinstance(row, list) and row)
