"""Rules for `ros`."""

from __future__ import annotations

from functools import partial

from phm.config.node import ConfigNode
from phm.config.problems import unknown
from phm.config.rules.common import configured, container_key, demand_field_of_type, report_duplicates, without_slash
from phm.core.message_fields import demand_counter, demand_value, has_header
from phm.core.settings import Hertz

_OWN_TOPICS = (
    ("diagnostics", "diagnostics", "; monitor the application's statuses with ros.diagnostics.watch"),
    ("phm/consensus", "consensus", ""),
)
"""Name, the section of `ros` that turns it off, and what to use instead."""


def relaunch_has_a_container(root: ConfigNode) -> None:
    """The container in which to run the command or to search for the process must be known."""
    if len(list(root.get("containers").entries())) == 1:
        return
    for node in root.get("ros", "nodes").records():
        if node.get("relaunch").value and not node.get("container").given:
            node.get("relaunch").add_problem("has no container to run in: add 'container' to this node")
        if node.get("process").value and not node.get("container").given:
            node.get("process").add_problem("has no container to search: add 'container' to this node")


def ros_names_are_unique(root: ConfigNode) -> None:
    for key, what in (("nodes", "node"), ("topics", "topic")):
        entries = (entry.get("name") for entry in root.get("ros", key).records())
        report_duplicates(what, ((without_slash(place.text), place) for place in entries))
    for topic in root.get("ros", "topics").records():
        for key in ("publishers", "subscribers"):
            report_duplicates("node", ((without_slash(place.text), place) for place in topic.get(key).texts))


def topic_nodes_exist(root: ConfigNode) -> None:
    known = {without_slash(node.get("name").text): node.get("name").text for node in root.get("ros", "nodes").records()}
    if not root.get("ros", "nodes").value:
        return
    for topic in root.get("ros", "topics").records():
        for key in ("publishers", "subscribers"):
            for place in topic.get(key).texts:
                if without_slash(place.text) not in known:
                    place.add_problem(unknown("node", place.text, known.values()) + " (or add it to 'ros.nodes')")


def diagnostics_are_known(root: ConfigNode) -> None:
    """Each watched pattern is unique, its container and node are configured, and a topic is read."""
    known = {container_key(container): container for container in root.get("containers").records()}
    known.pop("", None)
    nodes = {without_slash(node.get("name").text): node.get("name").text for node in root.get("ros", "nodes").records()}
    watched = list(root.get("ros", "diagnostics", "watch").records())
    report_duplicates("status", ((entry.get("name").text, entry.get("name")) for entry in watched))
    listen = root.get("ros", "diagnostics", "listen")
    if watched and listen.given and not listen.value:
        listen.add_problem("is empty, but 'watch' needs a topic: remove this key, or name a topic")
    for entry in watched:
        container, node = entry.get("container"), entry.get("node")
        if container.text:
            configured(container, known)
        if node.text and without_slash(node.text) not in nodes:
            node.add_problem(unknown("node", node.text, nodes.values()) + " (or add it to 'ros.nodes')")


def own_topics_are_not_measured(root: ConfigNode) -> None:
    """PHM publishes on these itself, which would be counted with the application's messages."""
    for name, key, instead in _OWN_TOPICS:
        if root.get("ros", key, "publish").value is False:
            continue
        problem = f"cannot be measured while PHM publishes on /{name} itself: leave it out, or set ros.{key}.publish to false{instead}"
        for topic in root.get("ros", "topics").records():
            if without_slash(topic.get("name").text) == name and topic.get("rate").given:
                topic.get("rate").add_problem(problem)
        for entry in (*root.get("containers").records(), *root.get("ros", "nodes").records()):
            for place in entry.get("ready", "topics").texts:
                if without_slash(place.text) == name:
                    place.add_problem(problem)


def examined_topics_have_a_rate(root: ConfigNode) -> None:
    """Messages are examined where their rate is measured, and a silent topic is reported there."""
    for topic in root.get("ros", "topics").records():
        data = topic.get("data")
        if not data.given:
            continue
        if topic.get("rate").quantity(Hertz, 0.0) == 0.0:
            data.add_problem("requires 'rate' above 0 for this topic: add it or remove this")
        examined = [data.get(key).value for key in ("max_age", "order", "frozen", "counter", "ranges")]
        if isinstance(data.value, dict) and not any(examined):
            data.add_problem("examines nothing: give at least one of max_age, order, frozen, counter, ranges")
        if data.get("gaps").given and not data.get("counter").given:
            data.get("gaps").add_problem("is never used without 'counter': add it or remove this")
        places = [limits for _, limits in data.get("ranges").items()]
        for limits in places:
            numbers = [number for number in limits.value if _number(number)] if isinstance(limits.value, list) else []
            if len(numbers) == 2 and numbers[0] > numbers[1]:
                limits.add_problem(f"is {numbers[0]:g} to {numbers[1]:g}: the first number is the lowest allowed value")


def examined_fields_exist(root: ConfigNode) -> None:
    """Where the type is known and installed beside PHM: it has the stamp and the fields that are to be examined."""
    for topic in root.get("ros", "topics").records():
        kind, data = topic.get("type").text, topic.get("data")
        if not kind:
            continue
        for key in ("max_age", "order"):
            if data.get(key).value and has_header(kind) is False:
                data.get(key).add_problem(
                    f"needs a stamp, but {kind} does not begin with a std_msgs/Header: remove this"
                )
        if data.get("counter").text:
            demand_field_of_type(demand_counter, kind, data.get("counter"), data.get("counter").text)
        for name, limits in data.get("ranges").items():
            if isinstance(name, str):
                demand_field_of_type(partial(demand_value, number=True), kind, limits, name)


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
