"""The configuration file is read once; its checks and their dependency graph are built once."""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.checking import registry
from phm.cli import group
from phm.config import loader
from phm.core.dependency_graph import DependencyGraph
from phm.core.signals import Signals
from phm.core.systemd import SystemdNotifier
from phm.runtime import service
from phm.runtime.reloader import Reloader

ONCE = Counter({"file": 1, "graph": 1, "checks": len(registry.checks())})


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often the file is read, a dependency graph is made, and `build` of an installed check is called."""
    counted: Counter[str] = Counter()

    def count(owner: Any, name: str, key: str) -> None:
        original = getattr(owner, name)

        def call(*args: Any, **more: Any) -> Any:
            counted[key] += 1
            return original(*args, **more)

        monkeypatch.setattr(owner, name, call)

    count(loader, "read_file", "file")
    count(DependencyGraph, "__init__", "graph")
    for check in registry.checks().values():
        count(check, "build", "checks")
    monkeypatch.setenv("PHM_WATCHDOG", "off")
    monkeypatch.setattr("phm.cli.run.end_process", sys.exit)  # this process stays
    return counted


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A configuration with an endpoint, without containers and ROS."""
    path = tmp_path / "phm.yaml"
    write(path)
    return path


def write(path: Path, agent: int = 3, interval: str = "20s") -> None:
    path.write_text(
        json.dumps(
            {
                "agent": {"id": agent},
                "interval": interval,
                "state_dir": str(path.parent / "state"),
                "run_dir": str(path.parent / "run"),
                "log": {"directory": str(path.parent / "log")},
                "mavlink": {"endpoints": [{"url": "udpout:127.0.0.1:9", "leads_to": "ground"}]},
            }
        )
    )


@pytest.mark.parametrize("verb", [("validate",), ("checks", "--graph"), ("once",)])
def test_a_command_reads_and_builds_once(verb: tuple[str, ...], counts: Counter[str], file: Path) -> None:
    """Also `phm once`, which opens no link and therefore judges none."""
    result = CliRunner().invoke(group, [*verb, "-c", str(file)])
    assert result.exit_code in (0, 1), result.output
    assert counts == ONCE


@pytest.mark.parametrize(("agent", "built"), [(3, 1), (4, 2)])
def test_run_and_reload_read_and_build_once(
    agent: int, built: int, counts: Counter[str], file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reload in which the agent's id changed builds twice: the file's checks, and those that apply until the restart."""
    seen: list[Counter[str]] = []

    def serve(running: Any, signals: Signals, reloader: Reloader, systemd: SystemdNotifier) -> None:
        seen.append(counts.copy())
        counts.clear()
        write(file, agent, interval="30s")
        before, running.daemon = running.daemon, reloader.run(running.daemon)
        seen.append(counts.copy())
        assert running.daemon is not before
        assert running.daemon.components.settings.agent.id == 3

    monkeypatch.setattr(service, "_serve", serve)
    result = CliRunner().invoke(group, ["run", "-c", str(file)])
    assert result.exit_code == 0, result.output
    assert seen == [ONCE, Counter({"file": 1, "graph": built, "checks": built * ONCE["checks"]})]


def test_own_checks_may_need_a_link_also_where_no_link_is_opened(file: Path) -> None:
    """`phm once` accepts what `phm validate` accepts."""
    entry = {"name": "camera", "type": "tcp", "host": "127.0.0.1", "port": 9, "timeout": 1}
    document = json.loads(file.read_text())
    document["mavlink"]["endpoints"][0]["name"] = "ground"
    file.write_text(json.dumps({**document, "custom": [{**entry, "needs": ["link/ground"]}]}))
    for verb in ("validate", "once"):
        result = CliRunner().invoke(group, [verb, "-c", str(file)])
        assert result.exit_code in (0, 1), result.output
