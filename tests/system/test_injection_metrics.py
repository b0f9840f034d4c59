"""Table 2 of the paper from the log of a real agent: a fault that was injected with its note, detected and recovered."""

from __future__ import annotations

import json
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl.harness.log_follower import Event, Record
from sitl.swarm.cli import main
from sitl.swarm.options import Options
from sitl.swarm.swarm import Swarm
from tests.system.conftest import ROOT

NODE = "nodes/agent_1/node_1"
RECOVERED_LIMIT_S, REPORT_LIMIT_S = 180.0, 120.0


@pytest.fixture
def swarm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Swarm]:
    """A swarm of one agent, which is OK."""
    monkeypatch.setenv("PHM_SITL_DIR", str(tmp_path))
    name = f"phm-t{uuid.uuid4().hex[:6]}"
    try:
        assert main(["up", "--agents", "1", "--interval", "5", "--name", name, "--no-build"]) == 0
        yield Swarm.load(name)
    finally:
        Swarm(Options(agents=1, name=name)).down()


@pytest.mark.long
def test_an_injected_fault_is_in_table_2_of_the_report(swarm: Swarm, capsys: pytest.CaptureFixture[str]) -> None:
    """`python -m sitl inject` notes the injection; `phm report` finds its fault, the action that ended it, and the times."""
    record = Record(swarm.agents[0].record)
    record.update()
    since = len(record.events)
    assert main(["inject", "node_killed", "--agent", "1", "--name", swarm.name]) == 0
    assert capsys.readouterr().err == "", "the note was written"

    def wait(wanted: str, after: int, limit_s: float) -> Event:
        def right(event: Event) -> bool:
            return bool(event["event"] == wanted and event.get("unit", NODE) == NODE)

        event = record.wait(right, limit_s, since=after)
        assert event is not None, f"no {wanted} within {limit_s:g} s"
        return event

    closed = wait("fault_closed", since, RECOVERED_LIMIT_S)
    assert closed["outcome"] == "resolved"
    wait("report", len(record.events), REPORT_LIMIT_S)
    argv = [sys.executable, "-m", "phm.cli", "report", str(swarm.agents[0].record.parent), "--json"]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    table = json.loads(done.stdout)["injection_metrics"]
    assert (table["agents"], table["injected"], table["detected"], table["self_resolved"]) == (1, 1, 1, 1.0)
    (injection,) = table["injections"]
    assert injection["text"] == f"INJECT node_killed: {NODE}"
    assert (injection["fault"], injection["by_action"]) == (closed["fault"], True)
    assert 0 <= table["first_alarm_s"] <= table["detection_s"]
    assert table["response_s"] > 0 and table["interval_s"] == [5.0]
