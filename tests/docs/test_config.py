"""YAML of the documents: a configuration of PHM passes `phm validate`, a Compose file can be parsed.

A block whose keys are sections of phm.yaml is a configuration. With `agent` or `containers` it must be valid unchanged;
without them it is a fragment, valid when it is added to `MINIMAL`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from phm.config import ConfigError, load
from phm.core.settings import Settings
from sitl.application import graph
from tests.docs.blocks import Block, blocks
from tests.docs.examples import ROOT

MINIMAL = "agent: {name: agent_1, id: 1}\ncontainers: [{name: ros_app, recover: true}]\n"
SECTIONS = frozenset(Settings.model_fields)
COMPOSE = frozenset({"services", "networks", "volumes", "configs", "secrets", "include"})
SERVICE = frozenset(
    [
        "build",
        "cap_add",
        "cap_drop",
        "cgroup",
        "cgroup_parent",
        "command",
        "depends_on",
        "device_cgroup_rules",
        "devices",
        "env_file",
        "environment",
        "extra_hosts",
        "group_add",
        "healthcheck",
        "image",
        "init",
        "ipc",
        "labels",
        "mem_limit",
        "network_mode",
        "networks",
        "pid",
        "ports",
        "privileged",
        "read_only",
        "restart",
        "pids_limit",
        "mem_reservation",
        "memswap_limit",
        "cpu_shares",
        "logging",
        "runtime",
        "security_opt",
        "shm_size",
        "stop_grace_period",
        "tmpfs",
        "user",
        "volumes",
    ]
)


def nodes(found: Any) -> str:
    """Why `python -m sitl up --graph` refuses the graph."""
    try:
        return "" if graph.read(found) else "no nodes"
    except ValueError as error:
        return str(error)


OTHERS: dict[str, Callable[[Any], str]] = {"nodes": nodes}
"""Files of other programs, by their only key, and what is wrong with one."""
ENVIRONMENT = {"PHM_AGENT": "agent_3", "PHM_AGENT_ID": "3"}


def kind(block: Block) -> str:
    """The kind of the block, by its top-level keys."""
    keys = set(yaml.safe_load(block.text))
    if keys <= SECTIONS:
        return "configuration"
    if keys <= COMPOSE:
        return "compose"
    return "other" if len(keys) == 1 and keys <= set(OTHERS) else f"unknown: {sorted(keys)}"


@pytest.mark.parametrize("block", blocks("yaml"), ids=str)
def test_a_yaml_block_is_valid(block: Block, tmp_path: Path) -> None:
    """The program that reads it accepts it, with and without the environment."""
    what = kind(block)
    assert what in ("configuration", "compose", "other"), f"{block}: {what}"
    if what == "other":
        ((key, _),) = (found := yaml.safe_load(block.text)).items()
        assert not OTHERS[key](found), f"{block}: {OTHERS[key](found)}"
    if what == "configuration":
        fragment = not {"agent", "containers"} & set(yaml.safe_load(block.text))
        (tmp_path / "phm.yaml").write_text((MINIMAL if fragment else "") + block.text)
        for environment in ({}, ENVIRONMENT):
            try:
                load(str(tmp_path / "phm.yaml"), environ=environment)
            except ConfigError as error:
                pytest.fail(f"{block}: {error}")
    if what == "compose":
        for name, service in yaml.safe_load(block.text).get("services", {}).items():
            assert set(service) <= SERVICE, f"{block}: {name} has keys that Compose does not know"


OTHER_PROGRAMS = ("prometheus", "ros")
"""Folders of config/examples whose YAML is for other programs; tests/metrics examines it."""
SHIPPED = sorted(path for path in (ROOT / "config").glob("**/*.yaml") if path.parent.name not in OTHER_PROGRAMS)


@pytest.mark.parametrize("path", SHIPPED, ids=str)
def test_a_shipped_configuration_is_valid(path: Path) -> None:
    """All files of config/ load with and without the environment."""
    load(str(path), environ={})
    load(str(path), environ=ENVIRONMENT)


def test_each_section_has_its_row() -> None:
    """docs/reference/configuration.md names every section of the configuration."""
    page = (ROOT / "docs" / "reference" / "configuration.md").read_text("utf-8")
    assert [name for name in SECTIONS if f"`{name}`" not in page] == []
