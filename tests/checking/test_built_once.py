"""A start of PHM builds its checks and its dependency graph once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.core.dependency_graph import DependencyGraph
from phm.runtime.wiring import Components
from phm_checks.container import Container


def test_checks_and_dependency_graph_are_built_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Tracker and scheduler share the graph and the checks of the plan."""
    built: list[str] = []

    def counted(owner: type, name: str) -> None:
        original = getattr(owner, name)

        def call(*args: Any, **more: Any) -> Any:
            built.append(owner.__name__)
            return original(*args, **more)

        monkeypatch.setattr(owner, name, call)

    counted(Container, "__init__")
    counted(DependencyGraph, "__init__")
    settings = testing.settings(
        containers=[{"name": "app"}], state_dir=str(tmp_path / "state"), run_dir=str(tmp_path / "run")
    )
    Components(settings, SystemClock())
    assert sorted(built) == ["Container", "DependencyGraph"]
