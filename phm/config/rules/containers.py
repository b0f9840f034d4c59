"""Rules for `containers`, and for other keys that name one."""

from __future__ import annotations

from phm.config.node import ConfigNode
from phm.config.problems import shown
from phm.config.rules.common import configured, container_key, report_duplicates, same_path, shortest_path


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
            elif configured(place, known):
                way = shortest_path(graph, place.text, key)
                if way is not None:
                    circle = " after ".join([key, *way])
                    place.add_problem(f"'after' has a cycle: {circle} (remove one of these)")
                else:
                    graph.setdefault(key, set()).add(place.text)


def manifests_are_for_folders(root: ConfigNode) -> None:
    for container in root.get("containers").records():
        for file in container.get("files").records():
            if file.get("manifest").given:
                for key in ("sha256", "executable", "restore"):
                    if file.get(key).value not in (None, False):
                        file.get(key).add_problem(
                            "conflicts with 'manifest', which is for a folder: remove one of them"
                        )
                if file.get("present").value is False:
                    file.get("present").add_problem("conflicts with 'manifest': the folder must exist")
            elif file.get("ignore").value:
                file.get("ignore").add_problem("is never used without 'manifest': add it or remove this")


def absent_files_have_no_copy(root: ConfigNode) -> None:
    for container in root.get("containers").records():
        for file in container.get("files").records():
            if file.get("present").value is False and file.get("restore").given:
                file.get("restore").add_problem(
                    "conflicts with 'present: false': a file that must not exist is never restored"
                )


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


def named_containers_exist(root: ConfigNode) -> None:
    known = {container_key(container): container for container in root.get("containers").records()}
    known.pop("", None)
    for key in ("nodes", "topics"):
        for entry in root.get("ros", key).records():
            place = entry.get("container")
            if place.text:
                configured(place, known)
    for window in root.get("recovery", "maintenance").records():
        if window.get("container").text:
            configured(window.get("container"), known)
    report_duplicates("container", ((place.text, place) for place in root.get("recovery", "relieve").texts))
    critical = [key for key, entry in known.items() if entry.get("flight_critical").value is True]
    after = {key: {place.text for place in entry.get("after").texts} for key, entry in known.items()}
    for place in root.get("recovery", "relieve").texts:
        if not configured(place, known):
            continue
        if place.text in critical:
            place.add_problem("is flight-critical: only other containers can be relieved")
        elif needed_by := next((key for key in critical if shortest_path(after, key, place.text)), ""):
            place.add_problem(f"container {shown(needed_by)} is flight-critical and needs it ('after'): remove this")
