"""A real daemon that a real Prometheus scrapes."""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm import __version__
from phm.reporters.metrics import MetricsReporter
from tests.fakes.until import until
from tests.metrics.agent import context
from tests.metrics.prometheus import Prometheus, free_port

ROOT = Path(__file__).parents[2]


class Agent:
    """`phm run` with metrics."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        self.write(f"127.0.0.1:{self.port}")
        path = os.pathsep.join((str(ROOT), str(ROOT / "checks")))
        self.log = (folder / "out").open("wb")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "phm.cli", "run", "-c", str(folder / "phm.yaml")],
            env={**os.environ, "PYTHONPATH": path, "PHM_WATCHDOG": "off"},
            stdout=self.log,
            stderr=self.log,
        )
        until(lambda: self.page() is not None, "the page", self.said)

    def write(self, listen: str, *, host: bool = True) -> None:
        places: dict[str, Any] = {name: str(self.folder / name) for name in ("state_dir", "run_dir")}
        config: dict[str, Any] = {
            "agent": {"id": 7, "name": "a7"},
            "interval": 1,
            "metrics": {"listen": listen},
            **places,
        }
        config["checks"] = {"host": {"enabled": host}}
        (self.folder / "phm.yaml").write_text(json.dumps({**config, "log": {"directory": str(self.folder / "log")}}))

    def page(self) -> str | None:
        assert self.process.poll() is None, self.said()
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/metrics", timeout=60) as response:
                return str(response.read().decode())
        # It does not listen yet, or has dropped a client that was too slow.
        except (OSError, http.client.HTTPException):
            return None

    def said(self) -> str:
        return (self.folder / "out").read_text()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(60)
        self.log.close()


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[Agent]:
    (tmp_path / "agent").mkdir()
    made = Agent(tmp_path / "agent")
    yield made
    made.close()


def test_prometheus_scrapes_a_daemon(agent: Agent, tmp_path: Path) -> None:
    """Its levels, the use of the computer and PHM's own cost arrive, and a restart of nothing is needed."""
    server = Prometheus(tmp_path, {"phm": f"127.0.0.1:{agent.port}"})
    about = {"agent": "a7", "agent_id": "7", "version": __version__}

    def seen() -> dict[str, bool]:
        """What has arrived. After a scrape that took more than a second, on a busy machine, nothing has until the next one."""
        return {
            "a measurement": 0 < (server.value("phm_host_memory_usage_ratio") or 0) < 1,
            "a complete pass": server.value("phm_report_age_seconds") is not None,
            "a scrape": server.value('up{job="phm"}') == 1,
            "the agent": [one["metric"].items() >= about.items() for one in server.query("phm_info")] == [True],
            "that it is alive": server.value("phm_alive") == 1,
            "a unit": server.value('phm_unit_level{unit="host/memory"}') is not None,
            "PHM's own memory": (server.value("process_resident_memory_bytes") or 0) > 1e6,
            "the faults": server.value("sum(phm_faults_open)") is not None,
        }

    try:
        until(lambda: all(seen().values()), "all of it", lambda: f"{seen()}\n{agent.page()}", poll_s=0.2)
        until(lambda: (server.value("rate(process_cpu_seconds_total[60s])") or 0) > 0, "two scrapes")
        until(lambda: not server.errors(), "a scrape without an error", server.errors)
    finally:
        server.close()


def test_without_the_setting_nothing_listens(tmp_path: Path) -> None:
    """Metrics are off by default."""
    assert MetricsReporter.build(context()) is None


def test_a_port_that_is_taken_is_a_problem_until_it_is_free() -> None:
    """PHM works without its metrics, says why they are missing, and tries again."""
    port = free_port()
    listen = {"listen": f"127.0.0.1:{port}"}
    first = MetricsReporter.build(context(metrics=listen))
    second = MetricsReporter.build(context(metrics=listen))
    assert first is not None and second is not None
    assert first.problem() == ""
    assert second.problem() == f"metrics: cannot listen on 127.0.0.1:{port}: Address already in use"
    first.close()
    second.tick()
    assert (second.problem(), second.address) == ("", ("127.0.0.1", port))
    second.close()


def test_a_reload_keeps_the_port(agent: Agent) -> None:
    """The next daemon opens it after the last one has closed it."""
    until(lambda: "phm_host_cpu_usage_ratio" in (agent.page() or ""), "the first measurements", agent.said)
    agent.write(f"127.0.0.1:{agent.port}", host=False)
    agent.process.send_signal(signal.SIGHUP)
    until(lambda: "phm_host_" not in (agent.page() or "phm_host_"), "the page of the new configuration", agent.said)


def test_without_the_library_phm_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra is not part of every image."""
    monkeypatch.setitem(sys.modules, "phm.wire.openmetrics", None)
    made = MetricsReporter.build(context(metrics={"listen": "127.0.0.1:1"}))
    assert made is not None
    assert made.problem().startswith("metrics.listen needs prometheus-client: install the extra 'metrics'")
    made.close()
