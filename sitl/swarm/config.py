"""PHM's configuration for an agent of a swarm: the shipped one, with the graph, the links and the swarm of that agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from sitl.application.graph import NodePlan, read, ring
from sitl.harness.config_overrides import overridden, parsed
from sitl.simulation.ports import INSIDE
from sitl.swarm import external_autopilots
from sitl.swarm.options import Options

AIR_HOST = "air"
"""Name of the air's container on the network that it shares with the sidecars."""
APP, ROUTER = "ros_app", "router"


def graph(options: Options) -> list[NodePlan]:
    """The nodes of every agent's application. ValueError and OSError when the file of the graph is not what it should be."""
    if not options.graph:
        return ring(options.nodes, options.rate_hz)
    return read(yaml.safe_load(Path(options.graph).read_text("utf-8")))


def text(options: Options, number: int, changes: Mapping[str, str] | None = None) -> str:
    """The YAML for agent `number`. changes: further lines of the shipped file to be replaced, as `sitl.harness.config_overrides` has it."""
    tree = parsed(overridden({**options.changes, **(changes or {})}))
    agent = f"agent_{number}"
    plans = graph(options)
    tree["ros"]["nodes"] = [*(_node(agent, plan) for plan in plans), *_beyond(tree["ros"]["nodes"])]
    tree["ros"]["topics"] = [*_topics(agent, plans), *_added(tree["ros"]["topics"])]
    router: dict[str, Any] = {"name": f"{options.name}-{number}-{ROUTER}-1", "alias": ROUTER, "recover": True}
    tree["containers"].append({**router, "healthcheck": "ignore"} if options.profile == "tuned" else router)
    tree["mavlink"]["endpoints"] = endpoints(options, number)
    tree["mavlink"]["autopilot"] = True
    tree["swarm"]["agents"] = list(range(1, options.agents + 1))
    if options.mode != "act":
        tree["recovery"]["mode"] = options.mode
    head = f"# Made by `python -m sitl` from config/phm.yaml for agent {number} of {options.agents}.\n"
    return head + yaml.safe_dump(tree, sort_keys=False, width=120)


def endpoints(options: Options, number: int) -> list[dict[str, Any]]:
    """The way to the ground and to the autopilot, and that to the other agents."""
    found: list[dict[str, Any]] = [
        {
            "url": f"tcp:{ROUTER}-{number}:{INSIDE.router_of(number)}",
            "name": "router",
            "leads_to": "router",
            "container": ROUTER,
            **({"radio": "required"} if options.profile == "tuned" else {}),
        },
        {"url": f"udpout:{AIR_HOST}:{INSIDE.peers_of(number)}", "name": "peers", "leads_to": "peers"},
    ]
    serial = external_autopilots.serial_port(options, number)
    if serial is not None:
        # On a separate cable, as beside a real flight controller, and not limited as a radio is.
        url = f"tcp:{AIR_HOST}:{serial}"
        found.append({"url": url, "name": "autopilot", "leads_to": "autopilot", "radio": "off", "budget": 0})
    return found


def _beyond(shipped: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Nodes that a change has added to the shipped ones."""
    return [node for node in shipped if node.get("container") != APP]


def _added(shipped: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Topics that a change has added to the shipped ones, which are named by a variable."""
    return [topic for topic in shipped if "${" not in topic["name"]]


def _node(agent: str, plan: NodePlan) -> dict[str, Any]:
    return {"name": f"/{agent}/{plan.name}", "container": APP}


def _topics(agent: str, plans: Sequence[NodePlan]) -> list[dict[str, Any]]:
    topics = dict.fromkeys(topic for plan in plans for topic in plan.publish)
    return [_topic(agent, topic, plans) for topic in topics]


def _topic(agent: str, topic: str, plans: Sequence[NodePlan]) -> dict[str, Any]:
    writers = [plan for plan in plans if topic in plan.publish]
    found: dict[str, Any] = {
        "name": f"/{agent}/{topic}",
        "type": "std_msgs/msg/String",
        "rate": f"{sum(plan.publish[topic] for plan in writers):g}Hz",
        "publishers": [f"/{agent}/{plan.name}" for plan in writers],
        "container": APP,
    }
    readers = [f"/{agent}/{plan.name}" for plan in plans if topic in plan.subscribe]
    return {**found, "subscribers": readers} if readers else found
