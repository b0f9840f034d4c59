"""The bench of the reports' bytes runs, and measures the bytes that are really sent."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from phm.core.model import Level
from phm.wire.report import report_json
from sitl.bench import mavlink, report_sizes

REPORTS = mavlink.REPORTS


def test_the_recorded_reports_are_read_unchanged() -> None:
    """Units in, the same JSON out; the failing one has one fault at its cause."""
    for name in ("healthy", "failing"):
        path = REPORTS / f"{name}.json"
        wanted = json.loads(path.read_text())["checks"]
        assert report_json("agent_1", report_sizes.load(path))["checks"] == wanted
    bad = [state.unit for state in report_sizes.load(REPORTS / "failing.json") if state.level is Level.ERROR]
    assert bad == ["container/ros_app"]


def test_the_bench_prints_the_figures_of_each_swarm(capsys: pytest.CaptureFixture[str]) -> None:
    """Two agents, idle and with one failing. A heartbeat has 21 bytes, and its period is 2 s."""
    code = mavlink.main(["--agents", "2", "--seconds", "60", "--json"])
    printed = json.loads(capsys.readouterr().out)
    idle, failing = printed["figures"]
    assert (code, printed["missed"]) == (0, [])
    assert (idle["agents"], idle["failing"], failing["failing"]) == (2, 0, 1)
    assert idle["heartbeats"] == pytest.approx(2 * 21 / 2)
    assert idle["mavlink"] == pytest.approx(idle["heartbeats"] + idle["texts"] + idle["tunnels"])
    assert idle["reports"] == pytest.approx(2 / 10)
    assert idle["json"] == pytest.approx(idle["reports"] * printed["one_report"]["healthy"]["json"])
    assert idle["mavlink"] < idle["deflated"] < idle["json"]
    assert failing["texts"] > idle["texts"]


def test_an_invalid_report_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a message that states how to make one."""
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{}")
    with pytest.raises(SystemExit) as ended:
        mavlink.main(["--healthy", str(wrong)])
    assert ended.value.code == 2
    assert "has no 'checks'; `phm status --json` makes one" in capsys.readouterr().err


@pytest.mark.ros
def test_a_diagnostic_array_is_measured_by_ros() -> None:
    """The bytes include at least all names and messages, four bytes for the length of each, and the stamp."""
    units = report_sizes.load(REPORTS / "healthy.json")
    weight = report_sizes.sizes(units).diagnostics
    assert weight is not None
    assert weight > sum(len(state.unit) + len(state.result.summary) + 8 for state in units) + 8
