"""Rules for `mavlink.endpoints`, and for what needs a link to the autopilot."""

from __future__ import annotations

from phm.config.node import ConfigNode
from phm.config.rules.common import configured, container_key, report_duplicates


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


def endpoints_are_unique(root: ConfigNode) -> None:
    endpoints = list(root.get("mavlink", "endpoints").records())
    report_duplicates("endpoint", ((entry.get("url").text, entry.get("url")) for entry in endpoints))
    report_duplicates("endpoint name", ((entry.get("name").text, entry.get("name")) for entry in endpoints))
    known = {container_key(container): container for container in root.get("containers").records()}
    for entry in endpoints:
        if entry.get("container").text:
            configured(entry.get("container"), known)
    application = root.get("mavlink", "application")
    if application.text not in ("", "auto", "none"):
        configured(application, known)
    named = [node for node in root.get("ros", "nodes").records() if node.get("commands").value is True]
    if named and application.text not in ("", "auto"):
        application.add_problem(
            f"is '{application.text}', but commands pass through the nodes with 'commands: true' (line {named[0].line}): "
            "remove one of the two"
        )
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
