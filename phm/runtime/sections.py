"""The sections of the configuration that recovery and the reporters receive."""

from __future__ import annotations

from typing import Any

from phm.core.settings import NodeSettings, Settings
from phm.recovery.base import ActionSettings
from phm.reporters.base import ReporterSettings


def action_settings(settings: Settings) -> ActionSettings:
    """For recovery and its actions."""
    nodes: dict[str, list[NodeSettings]] = {}
    for node in settings.ros.nodes:
        nodes.setdefault(settings.container_of_node(node.name), []).append(node)
    return ActionSettings(
        settings.containers,
        settings.recovery,
        settings.host,
        nodes,
        start_s=settings.ros.grace,
        heartbeat_s=settings.mavlink.heartbeat or 0.0,
        options=_options(settings),
    )


def reporter_settings(settings: Settings) -> ReporterSettings:
    """For reporters."""
    return ReporterSettings(
        settings.agent,
        settings.interval,
        settings.ros,
        settings.mavlink,
        settings.fleet,
        settings.log,
        settings.notify,
        settings.metrics,
        approval_s=settings.recovery.approval,
        state_dir=settings.state_dir,
        run_dir=settings.run_dir,
        options=_options(settings),
    )


def _options(settings: Settings) -> dict[str, dict[str, Any]]:
    return {name: check.options for name, check in settings.checks.items()}
