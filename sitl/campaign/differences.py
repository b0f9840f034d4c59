"""What deviates from what is shipped, computed: of a configuration as parsed YAML, and of containers as the engine has them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from docker import DockerClient
from docker.models.containers import Container

from phm.config.env_expansion import Expander
from sitl.faults.base import Agent, Fault
from sitl.harness.config_overrides import overridden, parsed
from sitl.swarm import config
from sitl.swarm.options import Options
from sitl.swarm.swarm import Swarm, SwarmAgent

Difference = dict[str, Any]
"""`of`: ``configuration``, ``application`` or ``sidecar``; `key`; `shipped` and `here`, None where it is absent."""
_KEYS = ("name", "path", "url")
"""What identifies an entry of a list."""
_HIDDEN = ("HOSTNAME", "PATH", "HOME")
"""Variables of an image that say nothing about the application."""


def of_swarm(swarm: Swarm) -> list[Difference]:
    """Of the first agent: the others differ from it by their number alone."""
    agent = swarm.agents[0]
    return [
        *of_configuration(agent.config.read_text("utf-8"), environment_of(agent.sidecar)),
        *of_container("application", _described(agent.app), _image(agent, agent.app)),
        *of_container("sidecar", _described(agent.sidecar), _image(agent, agent.sidecar)),
    ]


def of_fault(
    fault: Fault, agent: Agent, changes: Mapping[str, str], options: Options, environment: Mapping[str, str]
) -> list[Difference]:
    """What the trial of a fault changes on its agent beforehand: `shipped` is what the campaign has without it. Each
    difference also has the `fault` and the number of the `agent`.
    """
    usual, here = (flat(config.text(options, agent.number, more), environment) for more in ({}, changes))
    found = compare("configuration", usual, here)
    if fault.prepared:
        found.append({"of": "agent", "key": fault.prepared, "shipped": None, "here": "present"})
    return [{**each, "fault": fault.name, "agent": agent.number} for each in found]


def of_configuration(text: str, environment: Mapping[str, str] | None = None) -> list[Difference]:
    """Of a configuration from the shipped one, with the same variables."""
    return compare("configuration", flat(overridden({}), environment), flat(text, environment))


def of_container(which: str, here: Mapping[str, Any], image: Mapping[str, Any]) -> list[Difference]:
    """Of a container from its image, both as `described`."""
    return compare(which, image, here)


def compare(which: str, shipped: Mapping[str, Any], here: Mapping[str, Any]) -> list[Difference]:
    """One difference for each key, in order of the keys."""
    return [
        {"of": which, "key": key, "shipped": shipped.get(key), "here": here.get(key)}
        for key in sorted({*shipped, *here})
        if shipped.get(key) != here.get(key)
    ]


def flat(text: str, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Every value of a configuration by its path, such as ``ros.topics[/agent_1/topic_1].rate``, variables expanded."""
    found: dict[str, Any] = {}
    _flatten(parsed(text), "", found, Expander(environment or {}))
    return found


def _flatten(tree: Any, path: str, found: dict[str, Any], expander: Expander) -> None:
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            _flatten(value, f"{path}.{key}" if path else str(key), found, expander)
    elif isinstance(tree, list) and any(isinstance(each, Mapping) for each in tree):
        for number, entry in enumerate(tree):
            key = next((entry[key] for key in _KEYS if key in entry), number) if isinstance(entry, Mapping) else number
            _flatten(entry, f"{path}[{expander.expand(str(key))}]", found, expander)
    elif isinstance(tree, list):
        found[path] = [_value(each, expander) for each in tree]
    else:
        found[path] = _value(tree, expander)


def _value(value: Any, expander: Expander) -> Any:
    if not isinstance(value, str) or "${" not in value:
        return value
    return parsed(expander.expand(value)) if value.startswith("${") else expander.expand(value)


def described(config: Mapping[str, Any]) -> dict[str, Any]:
    """Command, environment and HEALTHCHECK of a container or an image, from its `Config`."""
    variables = dict(entry.partition("=")[::2] for entry in config.get("Env") or ())
    found: dict[str, Any] = {f"environment.{key}": value for key, value in variables.items() if key not in _HIDDEN}
    if config.get("Cmd"):
        found["command"] = shlex.join(config["Cmd"])
    check = config.get("Healthcheck") or {}
    for key in ("Interval", "Timeout", "StartPeriod", "Retries"):
        if check.get(key):
            value = check[key]
            found[f"healthcheck.{key.lower()}"] = value if key == "Retries" else f"{value / 1e9:g}s"
    return found


def _described(container: Container) -> dict[str, Any]:
    limits = container.attrs["HostConfig"]
    return {
        **described(container.attrs["Config"]),
        **{f"limits.{key}": limits[key] for key in ("Memory",) if limits.get(key)},
    }


def _image(agent: SwarmAgent, container: Container) -> dict[str, Any]:
    client: DockerClient = agent.docker
    return described(client.images.get(str(container.attrs["Image"])).attrs["Config"])


def environment_of(container: Container) -> dict[str, str]:
    """The variables with which a container was created."""
    entries = container.attrs["Config"].get("Env") or ()
    return dict(entry.partition("=")[::2] for entry in entries)
