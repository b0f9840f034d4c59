"""Command services without effect; a test replaces those that it needs."""

from __future__ import annotations

from typing import Any

from phm.commands.control_server import Execute
from phm.commands.handler import CommandHandler
from phm.commands.services import CommandServices
from phm.testing import FakeClock

NOTHING: dict[str, Any] = {
    "states": tuple,
    "open_faults": tuple,
    "recent_faults": tuple,
    "complete": lambda: True,
    "alive": lambda: True,
    "run_checks": lambda: None,
    "approve": str,
    "restart": lambda key, by: key,
    "note": lambda kind, text: None,
    "later": TimeoutError,
}


def execute(**services: Any) -> Execute:
    """A command handler's `execute` with these services."""
    return CommandHandler(CommandServices(**{**NOTHING, **services}), ["app"], FakeClock()).execute
