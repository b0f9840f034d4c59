"""Rules for the types of `custom` that compare values of ROS and MAVLink messages, and read serial ports."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from phm.config.node import ConfigNode
from phm.config.problems import shown
from phm.config.rules.common import demand_field_of_type, without_slash
from phm.core import mavlink_fields
from phm.core.mavlink_fields import UnknownMavlinkField
from phm.core.message_fields import demand_value

_NUMBERS = ("min", "max", "warn_min", "warn_max")


def custom_fields_exist(root: ConfigNode) -> None:
    """The field of a topic, where its type is given and installed beside PHM; that of a MAVLink message, in MAVLink's dialect."""
    for entry in _of_type(root, "topic"):
        kind, field = entry.get("message").text, entry.get("field")
        if kind and field.text:
            demand_field_of_type(partial(demand_value, number=_number(entry)), kind, field, field.text)
    for entry in _of_type(root, "mavlink"):
        message, field = entry.get("message"), entry.get("field")
        if message.text.isupper() and field.text and _limited(entry):
            try:
                instance = entry.get("instance").given
                mavlink_fields.demand_field(message.text, field.text, number=_number(entry), instance=instance)
            except UnknownMavlinkField as error:
                (message if "unknown message" in str(error) else field).add_problem(str(error))


def custom_mavlink_has_a_link(root: ConfigNode) -> None:
    """Messages of the autopilot arrive only where it is connected."""
    leads = [entry.get("leads_to").text or "both" for entry in root.get("mavlink", "endpoints").records()]
    if any(where not in ("ground", "peers") for where in leads):
        return
    for entry in _of_type(root, "mavlink"):
        entry.get("type").add_problem(
            "is 'mavlink', but no endpoint of mavlink.endpoints leads to the autopilot: add one, or remove this check"
        )


def custom_services_have_one_type(root: ConfigNode) -> None:
    """PHM has one client for a service. `ready.call` is of type Trigger."""
    types: dict[str, tuple[str, int]] = {}
    for owner in (*root.get("containers").records(), *root.get("ros", "nodes").records()):
        place = owner.get("ready", "call")
        if place.text:
            types[without_slash(place.text)] = ("std_srvs/srv/Trigger", place.line)
    for entry in _of_type(root, "service"):
        call, name = entry.get("call"), without_slash(entry.get("service").text)
        if "/" in call.text and (known := types.setdefault(name, (call.text, call.line)))[0] != call.text:
            call.add_problem(f"is {shown(call.text)}, but the same service is {known[0]} in line {known[1]}")


def custom_serial_ports_are_read_once(root: ConfigNode) -> None:
    """Two readers of a port take each other's data."""
    readers = {
        place.text: f"mavlink.endpoints (line {place.line})"
        for entry in root.get("mavlink", "endpoints").records()
        for place in [entry.get("url")]
        if place.text.startswith("/")
    }
    for entry in _of_type(root, "serial"):
        if not entry.get("max_age").given:
            continue
        place = entry.get("device")
        if place.text in readers:
            place.add_problem(
                f"is {shown(place.text)}, which {readers[place.text]} reads already: two readers take each other's data; "
                "remove 'max_age', or this check"
            )
        readers.setdefault(place.text, f"another check (line {place.line})")


def own_topics_are_not_custom(root: ConfigNode) -> None:
    """PHM publishes on these itself, so messages always arrive."""
    own = [
        name
        for name, key in (("diagnostics", "diagnostics"), ("phm/consensus", "consensus"))
        if root.get("ros", key, "publish").value is not False
    ]
    for entry in _of_type(root, "topic"):
        if without_slash(entry.get("topic").text) in own:
            entry.get("topic").add_problem(
                f"is {shown(entry.get('topic').text)}, on which PHM publishes itself: use ros.diagnostics.watch"
            )


def _of_type(root: ConfigNode, name: str) -> Iterator[ConfigNode]:
    return (entry for entry in root.get("custom").records() if entry.get("type").text == name)


def _limited(entry: ConfigNode) -> bool:
    return _number(entry) or entry.get("equals").given


def _number(entry: ConfigNode) -> bool:
    """Whether a text cannot meet the limits."""
    equals = entry.get("equals").value
    numbers = any(entry.get(key).given for key in _NUMBERS) or entry.get("not_nan").value is True
    return numbers or isinstance(equals, bool | int | float)
