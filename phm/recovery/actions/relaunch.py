"""Start one ROS node again inside its container, with the configured command."""

from __future__ import annotations

from phm.core.model import Fault
from phm.core.settings import NodeSettings, Settings
from phm.facts import CannotTell
from phm.recovery.base import Action, ActionContext, ActionFailed, Impact, NotNeeded, Target, present


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
    def applies(cls, target: Target, fault: Fault, settings: Settings) -> bool:
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


def _node(target: Target, fault: Fault, settings: Settings) -> NodeSettings | None:
    """The node to start for this fault, for a topic its first publisher; None if it has no command."""
    check, _, subject = fault.unit.partition("/")
    name = subject if check == "nodes" else ""
    if check in ("topics", "rates"):
        topic = next((entry for entry in settings.ros.topics if entry.name.lstrip("/") == subject), None)
        name = topic.publishers[0].lstrip("/") if topic is not None and topic.publishers else ""
    node = next((entry for entry in settings.ros.nodes if entry.name.lstrip("/") == name), None)
    if node is None or not node.relaunch or settings.container_of_node(node.name) != target.key:
        return None
    return node


def _runs(command: str, container: str, context: ActionContext) -> bool:
    """Whether a process of the container has this command line; an interpreter may precede it."""
    rows = context.engine.top(container).get("Processes") or []
    if not isinstance(rows, list):
        raise CannotTell("the Docker Engine answered without a process list")
    return any(f" {command}" in f" {row[-1]}" for row in rows if isinstance(row, list) and row)
