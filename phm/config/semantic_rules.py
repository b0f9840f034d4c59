"""Rules between keys: names that must exist, names that must be unique, pairs in order.

One function per rule; each reads the raw tree through `ConfigNode`, so it works although other parts are invalid.
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterable, Mapping

from phm.config import fleet_rules
from phm.config.node import ConfigNode
from phm.config.problems import shown, unknown
from phm.core.settings import (
    Celsius,
    ContainerSettings,
    Hertz,
    HostSettings,
    Percent,
    RecoverySettings,
    Seconds,
    TopicSettings,
)

PRESSURE_SHARES = ("throttled", "waiting", "memory", "io", "pids", "host_memory", "host_io")


def check_all(root: ConfigNode) -> None:
    """Apply every rule of this module."""
    for rule in RULES:
        rule(root)


def bare(name: str) -> str:
    """A ROS name without its first slash: both forms name the same node."""
    return name.lstrip("/")


def same_path(path: str) -> str:
    """`/a//b/` and `/a/b` are one file."""
    return posixpath.normpath(path).replace("//", "/")


def container_key(container: ConfigNode) -> str:
    """As `ContainerSettings.key`, of an entry that may be invalid elsewhere."""
    name, label, alias = (container.get(part).text or None for part in ("name", "label", "alias"))
    return ContainerSettings.model_construct(name=name, label=label, alias=alias).key


def report_duplicates(what: str, places: Iterable[tuple[str, ConfigNode]]) -> None:
    """Add a problem for each name that is defined twice, with the line of the first."""
    first: dict[str, ConfigNode] = {}
    for name, place in places:
        if name in first:
            place.add_problem(f"{what} {shown(name)} is defined twice, first in line {first[name].line}: keep one")
        elif name:
            first[name] = place


def containers_have_one_identity(root: ConfigNode) -> None:
    for container in root.get("containers").records():
        name, label = container.get("name"), container.get("label")
        if name.given and label.given:
            label.add_problem("conflicts with 'name': give only one of them")
        elif not name.given and not label.given and not {name.path, label.path} & root.tree.bad:
            container.add_problem("has neither 'name' nor 'label': give one of them")
        elif label.text and not container_key(container):
            label.add_problem("has an empty value: add 'alias', the name to use for this container")


def containers_are_unique(root: ConfigNode) -> None:
    containers = list(root.get("containers").records())
    report_duplicates("container", ((container_key(container), container) for container in containers))
    # What remains: one container with two aliases.
    by_key = {container_key(container): container for container in reversed(containers)}
    names = (container.get("name") for container in reversed(by_key.values()))
    report_duplicates("container", ((place.text, place) for place in names))


def container_parts_are_unique(root: ConfigNode) -> None:
    for container in root.get("containers").records():
        for key, what in (("files", "file"), ("devices", "device")):
            places = ((entry.get("path").text, entry.get("path")) for entry in container.get(key).records())
            report_duplicates(what, ((same_path(path), place) for path, place in places if path))
        report_duplicates("network", ((entry.text, entry) for entry in container.get("networks").texts))


def containers_start_in_order(root: ConfigNode) -> None:
    """`after` names other configured containers, without a cycle."""
    containers = [entry for entry in root.get("containers").records() if container_key(entry)]
    known = {container_key(entry): entry for entry in containers}
    graph: dict[str, set[str]] = {}
    for key, entry in known.items():
        report_duplicates("container", ((place.text, place) for place in entry.get("after").texts))
        for place in entry.get("after").texts:
            if place.text == key:
                place.add_problem(f"container {shown(key)} cannot start after itself: remove it")
            elif _configured(place, known):
                way = _way(graph, place.text, key)
                if way is not None:
                    circle = " after ".join([key, *way])
                    place.add_problem(f"'after' has a cycle: {circle} (remove one of these)")
                else:
                    graph.setdefault(key, set()).add(place.text)


def absent_files_have_no_copy(root: ConfigNode) -> None:
    for container in root.get("containers").records():
        for file in container.get("files").records():
            if file.get("present").value is False and file.get("restore").given:
                file.get("restore").add_problem(
                    "conflicts with 'present: false': a file that must not exist is never restored"
                )


def relaunch_has_a_container(root: ConfigNode) -> None:
    """The container in which to run the command or to search for the process must be known."""
    if len(list(root.get("containers").entries())) == 1:
        return
    for node in root.get("ros", "nodes").records():
        if node.get("relaunch").value and not node.get("container").given:
            node.get("relaunch").add_problem("has no container to run in: add 'container' to this node")
        if node.get("process").value and not node.get("container").given:
            node.get("process").add_problem("has no container to search: add 'container' to this node")


def recovery_keys_need_opt_in(root: ConfigNode) -> None:
    """Keys that only recovery uses are refused for containers that have not opted in: they would be ignored silently."""
    containers = {container_key(container): container for container in root.get("containers").records()}
    closed = {key for key, container in containers.items() if container.get("recover").value in (None, False)}
    advice = "is never used, because container {} has not opted in: add 'recover: true' to it or remove this"
    for key in closed:
        for file in containers[key].get("files").records():
            if file.get("restore").given:
                file.get("restore").add_problem(advice.format(shown(key)))
    for node in root.get("ros", "nodes").records():
        key = node.get("container").text or (next(iter(containers)) if len(containers) == 1 else "")
        if node.get("relaunch").value and key in closed:
            node.get("relaunch").add_problem(advice.format(shown(key)))


def _configured(place: ConfigNode, known: Mapping[str, ConfigNode]) -> bool:
    """Whether the text is the key of a container in `known`; adds a problem when not."""
    real = {entry.get("name").text: key for key, entry in known.items()}
    if place.text in known:
        return True
    if place.text in real:
        place.add_problem(f"container {shown(place.text)} has the alias {shown(real[place.text])}: write that")
    elif known:
        place.add_problem(unknown("container", place.text, known))
    else:
        place.add_problem(f"unknown container {shown(place.text)}, none is configured: add it to 'containers'")
    return False


def flight_critical_needs_autopilot(root: ConfigNode) -> None:
    """Without a link to the autopilot the vehicle is never known to be disarmed, so PHM would never act. With several links, each
    needs `leads_to`, because a disarmed HEARTBEAT is accepted from those that lead to the autopilot."""
    places = (container.get("flight_critical") for container in root.get("containers").records())
    critical = [place for place in places if place.value is True]
    endpoints = list(root.get("mavlink", "endpoints").records())
    if all(entry.get("leads_to").value in ("ground", "peers") for entry in endpoints):
        for place in critical:
            place.add_problem(
                "is true, but no MAVLink endpoint leads to the autopilot, so nothing could report whether it is armed: add one to "
                "'mavlink.endpoints' with 'leads_to' autopilot, router or both, or remove this"
            )
    for entry in endpoints if critical and len(endpoints) > 1 else ():
        if not entry.get("leads_to").given:
            entry.add_problem(
                "has no 'leads_to', so any sender there could report the vehicle as disarmed, which matters because of "
                f"flight_critical (line {critical[0].line}): write what is at its other end, e.g. 'leads_to: ground'"
            )


def ros_names_are_unique(root: ConfigNode) -> None:
    for key, what in (("nodes", "node"), ("topics", "topic")):
        entries = (entry.get("name") for entry in root.get("ros", key).records())
        report_duplicates(what, ((bare(place.text), place) for place in entries))
    for topic in root.get("ros", "topics").records():
        for key in ("publishers", "subscribers"):
            report_duplicates("node", ((bare(place.text), place) for place in topic.get(key).texts))


def named_containers_exist(root: ConfigNode) -> None:
    known = {container_key(container): container for container in root.get("containers").records()}
    known.pop("", None)
    for key in ("nodes", "topics"):
        for entry in root.get("ros", key).records():
            place = entry.get("container")
            if place.text:
                _configured(place, known)
    for window in root.get("recovery", "maintenance").records():
        if window.get("container").text:
            _configured(window.get("container"), known)
    report_duplicates("container", ((place.text, place) for place in root.get("recovery", "relieve").texts))
    for place in root.get("recovery", "relieve").texts:
        if _configured(place, known) and known[place.text].get("flight_critical").value is True:
            place.add_problem("is flight-critical: only other containers can be relieved")


def topic_nodes_exist(root: ConfigNode) -> None:
    known = {bare(node.get("name").text): node.get("name").text for node in root.get("ros", "nodes").records()}
    if not root.get("ros", "nodes").value:
        return
    for topic in root.get("ros", "topics").records():
        for key in ("publishers", "subscribers"):
            for place in topic.get(key).texts:
                if bare(place.text) not in known:
                    place.add_problem(unknown("node", place.text, known.values()) + " (or add it to 'ros.nodes')")


def diagnostics_are_known(root: ConfigNode) -> None:
    """Each watched pattern is unique, its container and node are configured, and a topic is read."""
    known = {container_key(container): container for container in root.get("containers").records()}
    known.pop("", None)
    nodes = {bare(node.get("name").text): node.get("name").text for node in root.get("ros", "nodes").records()}
    watched = list(root.get("ros", "diagnostics", "watch").records())
    report_duplicates("status", ((entry.get("name").text, entry.get("name")) for entry in watched))
    listen = root.get("ros", "diagnostics", "listen")
    if watched and listen.given and not listen.value:
        listen.add_problem("is empty, but 'watch' needs a topic: remove this key, or name a topic")
    for entry in watched:
        container, node = entry.get("container"), entry.get("node")
        if container.text:
            _configured(container, known)
        if node.text and bare(node.text) not in nodes:
            node.add_problem(unknown("node", node.text, nodes.values()) + " (or add it to 'ros.nodes')")


def own_topics_have_no_rate(root: ConfigNode) -> None:
    """PHM publishes on /diagnostics itself once a second, which would be counted with the application's messages."""
    if root.get("ros", "diagnostics", "publish").value is False:
        return
    for topic in root.get("ros", "topics").records():
        rate = topic.get("rate")
        if bare(topic.get("name").text) == "diagnostics" and rate.given and rate.value is not None:
            rate.add_problem(
                "cannot be measured while PHM publishes on /diagnostics itself: leave it out, or set ros.diagnostics.publish to "
                "false; monitor the application's statuses with ros.diagnostics.watch"
            )


def endpoints_are_unique(root: ConfigNode) -> None:
    endpoints = list(root.get("mavlink", "endpoints").records())
    report_duplicates("endpoint", ((entry.get("url").text, entry.get("url")) for entry in endpoints))
    report_duplicates("endpoint name", ((entry.get("name").text, entry.get("name")) for entry in endpoints))
    known = {container_key(container): container for container in root.get("containers").records()}
    for entry in endpoints:
        if entry.get("container").text:
            _configured(entry.get("container"), known)
    autopilot = root.get("mavlink", "autopilot")
    if autopilot.value is True and not root.get("mavlink", "endpoints").value:
        autopilot.add_problem("is true, but there are no endpoints to receive it on: add one to 'mavlink.endpoints'")
    elif autopilot.value is True and all(entry.get("leads_to").value in ("ground", "peers") for entry in endpoints):
        autopilot.add_problem("is true, but no endpoint leads to it: correct 'leads_to' of one of them")


def link_ids_are_unique(root: ConfigNode) -> None:
    """Two links that sign with one id share a stream at the receiver, which then refuses the second."""
    taken: dict[int, ConfigNode] = {}
    endpoints = list(root.get("mavlink", "endpoints").records())
    # The default is the position in the list, so entries with a default come first.
    for number, entry in sorted(enumerate(endpoints), key=lambda pair: pair[1].get("link_id").given):
        place = entry.get("link_id")
        link_id = place.value if place.given else number
        if not isinstance(link_id, int):
            continue
        if link_id in taken:
            place.add_problem(
                f"{link_id} is also used by the endpoint in line {taken[link_id].line}: give each its own"
            )
        taken.setdefault(link_id, entry)


def limits_are_in_order(root: ConfigNode) -> None:
    places = [("host", key, Percent) for key in ("cpu", "memory", "disk")]
    places += [("pressure", key, Percent) for key in PRESSURE_SHARES]
    for section, key, kind in (*places, ("pressure", "memory_faults", Hertz)):
        limit = root.get(section, key)
        warn, error = limit.get("warn"), limit.get("error")
        if warn.given and error.given:
            in_order(warn, error, kind, (0.0, 0.0))
    host, recovery = HostSettings(), RecoverySettings()
    pair = root.get("host", "temperature_warn"), root.get("host", "temperature_error")
    in_order(*pair, Celsius, (host.temperature_warn, host.temperature_error))
    for topic in root.get("ros", "topics").records():
        if topic.get("error_tolerance").given:
            tolerance = TopicSettings.model_fields["tolerance"].default
            in_order(topic.get("tolerance"), topic.get("error_tolerance"), Percent, (tolerance, tolerance))
    pair = root.get("recovery", "backoff"), root.get("recovery", "backoff_max")
    in_order(*pair, Seconds, (recovery.backoff, recovery.backoff_max))
    in_order(root.get("recovery", "reserve"), root.get("recovery", "budget"), int, (recovery.reserve, recovery.budget))
    in_order(
        root.get("recovery", "hold"), root.get("recovery", "hold_max"), Seconds, (recovery.hold, recovery.hold_max)
    )


def in_order(low: ConfigNode, high: ConfigNode, kind: object, defaults: tuple[float, float]) -> None:
    """Add a problem at the key that is in the file when `low` is above `high`."""
    small, big = low.quantity(kind, defaults[0]), high.quantity(kind, defaults[1])
    if small is None or big is None or small <= big:
        return
    if low.given:
        low.add_problem(f"is {small:g}, above {high.path[-1]!r} which is {big:g}: allowed is {big:g} or less")
    else:
        high.add_problem(f"is {big:g}, below {low.path[-1]!r} which is {small:g}: allowed is {small:g} or more")


def disks_are_unique(root: ConfigNode) -> None:
    report_duplicates("disk", ((same_path(place.text), place) for place in root.get("host", "disks").texts))


def names_of_checks(root: ConfigNode, known: Iterable[str], units: Iterable[str] | None) -> None:
    """`checks.<name>` must be installed; needs name checks or units of checks."""
    names = sorted(known)
    for name, check in root.get("checks").items():
        if name not in names:
            check.add_problem(unknown("check", name, names) + " (`phm checks` lists them)")
        for need in check.get("needs").texts:
            of_check, _, subject = need.text.partition("/")
            if of_check not in names:
                what = f"unknown need {shown(need.text)}"
                near = unknown("check", of_check, names)
                need.add_problem(f"{what}: {near} (write a check's name or the id of a unit, check/subject)")
            elif subject and units is not None and need.text not in units:
                theirs = sorted(unit for unit in units if unit.startswith(f"{of_check}/"))
                need.add_problem(unknown("unit", need.text, [of_check, *theirs]))


def names_of_recovery(root: ConfigNode, actions: Iterable[str] | None, conditions: Iterable[str] | None) -> None:
    """`recovery.ladders`: conditions to lists of actions."""
    for condition, ladder in root.get("recovery", "ladders").items():
        if conditions is not None and condition not in conditions:
            ladder.add_problem(unknown("condition", condition, sorted(conditions)))
        for action in ladder.texts:
            if actions is not None and action.text not in actions:
                action.add_problem(unknown("action", action.text, sorted(actions)))


def needs_have_no_loop(root: ConfigNode, builtin: dict[str, set[str]]) -> None:
    """The needs in the file, together with the built-in ones, must not form a cycle.

    Each cycle is reported once, at the need in the file that closes it.
    """
    graph = {name: set(needs) for name, needs in builtin.items()}
    written: list[tuple[str, str, ConfigNode]] = []
    for name, check in root.get("checks").items():
        if check.get("enabled").value is False:
            continue
        for place in check.get("needs").texts:
            need = place.text.partition("/")[0]
            if need == name and "/" in place.text:
                continue  # all units of a check may need one of them
            written.append((name, need, place))
            graph.setdefault(name, set()).add(need)
    reported: set[frozenset[str]] = set()
    for name, need, place in written:
        way = _way(graph, need, name)
        if way is not None and frozenset(way) not in reported:
            reported.add(frozenset(way))
            place.add_problem(f"dependency cycle: {' -> '.join([name, *way])} (remove one of these needs)")


def _way(graph: dict[str, set[str]], start: str, end: str) -> list[str] | None:
    """The shortest path from `start` to `end`, both included, or None."""
    ways = {start: [start]}
    queue = [start]
    for name in queue:
        if name == end:
            return ways[name]
        for need in sorted(graph.get(name, ())):
            if need not in ways:
                ways[need] = [*ways[name], need]
                queue.append(need)
    return None


RULES: tuple[Callable[[ConfigNode], None], ...] = (
    containers_have_one_identity,
    containers_are_unique,
    container_parts_are_unique,
    containers_start_in_order,
    absent_files_have_no_copy,
    recovery_keys_need_opt_in,
    flight_critical_needs_autopilot,
    ros_names_are_unique,
    named_containers_exist,
    relaunch_has_a_container,
    topic_nodes_exist,
    diagnostics_are_known,
    own_topics_have_no_rate,
    endpoints_are_unique,
    link_ids_are_unique,
    limits_are_in_order,
    disks_are_unique,
    fleet_rules.fleet_has_endpoints,
    fleet_rules.fleet_modes_match,
    fleet_rules.fleet_certificates_are_used,
)
