"""`phm hold` and `phm release`: the request to the daemon, and the response."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.commands.control_server import ControlServer
from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.reporters.base import ReporterContext
from phm.reporters.status import StatusReporter
from phm.runtime.sections import reporter_settings
from phm.wire import control as wire
from tests.fakes.commands import execute
from tests.fakes.until import until


class HoldService:
    """Grants every hold except that of `unknown`, and records the requests."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    def hold(self, container: str, for_s: float | None, reason: str, by: str) -> tuple[str, dict[str, Any]]:
        if container == "unknown":
            raise LookupError("there is no container 'unknown' in the configuration: app")
        self.asked.append((container, for_s, reason, by))
        return f"{container} is on hold", {"container": container or None, "left_s": for_s}

    def release(self, container: str, by: str) -> tuple[str, dict[str, Any]]:
        self.asked.append((container, by))
        return "released: app", {"released": []}


@pytest.fixture
def holds(tmp_path: Path) -> Iterator[HoldService]:
    made = HoldService()
    control = ControlServer(str(tmp_path), execute(holds=made))
    control.start()
    until((tmp_path / wire.NAME).exists, "the socket")
    yield made
    control.close()


def phm(folder: Path, *words: str) -> tuple[int, str]:
    result = CliRunner().invoke(group, [*words, "--run-dir", str(folder)])
    return result.exit_code, result.output


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (("app", "--for", "10min", "--reason", "new firmware"), ("app", 600.0, "new firmware")),
        (("--for", "1.5h"), ("", 5400.0, "")),
        (("app", "--for", "90 s"), ("app", 90.0, "")),
        (("app",), ("app", None, "")),
    ],
)
def test_a_hold_reaches_the_daemon(
    holds: HoldService, tmp_path: Path, words: tuple[str, ...], asked: tuple[Any, ...]
) -> None:
    """Seconds, the reason, and the user, as the kernel reports it."""
    assert phm(tmp_path, "hold", *words) == (0, f"{asked[0]} is on hold\n")
    assert holds.asked == [(*asked, "operator (uid 0)")]


def test_a_release_reaches_the_daemon(holds: HoldService, tmp_path: Path) -> None:
    """Of one container, or of everything."""
    assert phm(tmp_path, "release", "app") == (0, "released: app\n")
    assert phm(tmp_path, "release")[0] == 0
    assert holds.asked == [("app", "operator (uid 0)"), ("", "operator (uid 0)")]


def test_a_refusal_is_reported_with_its_reason(holds: HoldService, tmp_path: Path) -> None:
    """Exit code 1."""
    code, said = phm(tmp_path, "hold", "unknown")
    assert (code, "there is no container" in said) == (1, True)
    code, said = phm(tmp_path, "hold", "unknown", "--json")
    assert code == 1 and json.loads(said)["ok"] is False


def test_json_has_the_hold_as_data(holds: HoldService, tmp_path: Path) -> None:
    """`phm status --json` lists the same."""
    code, said = phm(tmp_path, "hold", "app", "--for", "5s", "--json")
    assert (code, json.loads(said)) == (0, {"ok": True, "text": "app is on hold", "container": "app", "left_s": 5.0})


@pytest.mark.parametrize("length", ["10", "ten", "-5s", "5d", "nans", ""])
def test_a_bad_duration_is_a_usage_error(holds: HoldService, tmp_path: Path, length: str) -> None:
    """With the allowed values."""
    code, said = phm(tmp_path, "hold", "app", "--for", length)
    assert (code, "10min" in said, holds.asked) == (2, True, [])


@pytest.mark.parametrize(
    "request_",
    [
        {"do": "hold"},
        {"do": "hold", "container": "app", "for_s": "10", "reason": ""},
        {"do": "hold", "container": "app", "for_s": True, "reason": ""},
        {"do": "hold", "container": 5, "for_s": None, "reason": ""},
        {"do": "hold", "container": "app", "for_s": None, "reason": "", "by": "root"},
        {"do": "release"},
        {"do": "release", "container": None},
        {"do": "release", "container": "app", "reason": ""},
    ],
)
def test_an_invalid_request_changes_nothing(holds: HoldService, tmp_path: Path, request_: dict[str, Any]) -> None:
    """Missing, additional or wrong keys are rejected, as well as a self-declared user name."""
    with pytest.raises(wire.Refused):
        wire.ask(str(tmp_path), request_)
    assert holds.asked == []
    assert wire.ask(str(tmp_path), {"do": "ping"}) == "PHM is running"


def test_status_shows_what_is_on_hold(tmp_path: Path) -> None:
    """Until when, the remaining time, by which user and why; `--json` has it as data."""
    hold = {
        "container": "app",
        "source": "operator",
        "by": "operator (uid 0)",
        "reason": "new firmware",
        "until": "2026-11-22T12:34:05.123Z",
        "left_s": 543.0,
    }
    settings = Settings.model_validate({"run_dir": str(tmp_path)})
    context = ReporterContext(
        reporter_settings(settings), SystemClock(), "b", tuple, lambda: True, dict, holds=lambda: [hold]
    )
    StatusReporter.build(context).tick()
    shown = phm(tmp_path, "status")[1]
    assert "on hold: app until 12:34:05 UTC (9 min 3 s left) by operator (uid 0): new firmware" in shown
    assert json.loads(phm(tmp_path, "status", "--json")[1])["holds"] == [hold]
