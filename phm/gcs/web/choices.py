"""What can be requested of an agent, with the words of the page, and the command that follows from the choice. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phm.gcs import operator
from phm.gcs.operator import OperatorCommand
from phm.gcs.web.site import RequestRefused

Json = dict[str, Any]
LOAD_S, RATES_S = 10.0, 10.0
SHORTEST_S, LONGEST_S = 1.0, 86_400.0
"""Limits of a hold that the page requests; the agent has its own limits."""
_DECIDES = "The agent decides: it refuses what its configuration does not allow, and says why."


def choices(agent: Mapping[str, Any]) -> list[Json]:
    """All requests that an agent can receive now. agent: its row."""
    name = agent["name"]
    found = [_choice("check", "run all checks", f"{name} runs all its checks now. Nothing is changed.", confirm=False)]
    for one in agent["advice"]:
        what = f"{one['action']} {one['target']}".strip()
        valid = f" The approval is valid for {one['valid_s']:g} s." if one["valid_s"] is not None else ""
        will = f"{name} does what it advises for fault #{one['fault']}: {what}.{valid} {_DECIDES}"
        found.append(_choice("approve", f"approve {what} (#{one['fault']})", will, fault=one["fault"]))
    armed = _armed(agent["autopilot"])
    for container in agent["containers"]:
        will = f"{name} stops the container {container} and starts it again.{armed} {_DECIDES}"
        found.append(_choice("restart", f"restart {container}", will, container=container))
        will = f"{name} takes no action on {container} and raises no alarm about it until the hold ends. {_DECIDES}"
        found.append(_choice("hold", f"hold {container}", will, container=container))
        will = f"{name} watches and recovers {container} again."
        found.append(_choice("release", f"release {container}", will, container=container))
    found += [
        _choice("details", "details of the newest fault", f"{name} sends the text about it.", confirm=False),
        _choice("containers", "list containers", f"{name} sends the names of its containers.", confirm=False),
        _choice("load", "report load", f"{name} sends CPU, memory and temperature every {LOAD_S:g} s.", confirm=False),
        _choice("load_off", "stop reporting load", f"{name} no longer sends its load.", confirm=False),
        _choice(
            "rates", "report topic rates", f"{name} sends the rates of its topics every {RATES_S:g} s.", confirm=False
        ),
        _choice(
            "rates_off", "stop reporting topic rates", f"{name} no longer sends the rates of its topics.", confirm=False
        ),
    ]
    return found


def command_of(body: Mapping[str, Any], agent: Mapping[str, Any]) -> OperatorCommand:
    """The command of a request. agent: the row of its agent. Raises ValueError for an invalid request, and RequestRefused for a fault
    or container that the agent does not have."""
    match body.get("do"):
        case "check":
            return operator.run_checks()
        case "approve":
            return _approve(body, agent)
        case "restart" | "hold" | "release":
            return _container(body, agent)
        case "details":
            fault = body.get("fault", 0)
            return operator.details(_number(fault, "fault", 0, 10**9 - 1))
        case "containers":
            return operator.list_containers()
        case "load":
            return operator.report_load(LOAD_S)
        case "load_off":
            return operator.report_load(0.0)
        case "rates":
            return operator.report_rates(RATES_S)
        case "rates_off":
            return operator.report_rates(0.0)
    raise ValueError(
        "do must be check, approve, restart, hold, release, details, containers, load, load_off, rates or rates_off"
    )


def _armed(autopilot: Mapping[str, Any] | None) -> str:
    """The sentence about arming; empty only for a vehicle that is known to be disarmed. autopilot: as in the row."""
    if autopilot is None or autopilot["presence"] not in ("alive", "late"):
        return " It is not known whether the vehicle is armed."
    return " The vehicle is armed." if autopilot["armed"] else ""


def _approve(body: Mapping[str, Any], agent: Mapping[str, Any]) -> OperatorCommand:
    fault = _number(body.get("fault"), "fault", 1, 10**9 - 1)
    one = next((one for one in agent["advice"] if one["fault"] == fault), None)
    if one is None:
        raise RequestRefused(
            f"{agent['name']} approve #{fault}: not sent, the agent no longer advises an action for it"
        )
    return operator.approve(fault, f"{one['action']} {one['target']}".strip())


def _container(body: Mapping[str, Any], agent: Mapping[str, Any]) -> OperatorCommand:
    name, what = body.get("container"), str(body["do"])
    if not isinstance(name, str) or not name:
        raise ValueError("container must be the name of a container")
    known = list(agent["containers"])
    if name not in known:
        raise RequestRefused(f"{agent['name']} {what} {name[:100]}: not sent, the agent has not listed this container")
    place = known.index(name) + 1
    if what == "restart":
        return operator.restart(place, name)
    if what == "release":
        return operator.release(place, name)
    for_s = body.get("for_s")
    return operator.hold(place, name, None if for_s is None else _seconds(for_s))


def _number(value: object, name: str, least: int, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{name} must be a whole number from {least} to {most}")
    return value


def _seconds(value: object) -> float:
    """A duration in whole seconds, as in the command. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not SHORTEST_S <= value <= LONGEST_S:
        raise ValueError(f"for_s must be {SHORTEST_S:g} to {LONGEST_S:g} seconds")
    return float(round(value))


def _choice(what: str, text: str, will: str, *, confirm: bool = True, **more: object) -> Json:
    return {"do": what, **more, "text": text, "will": will, "confirm": confirm}
