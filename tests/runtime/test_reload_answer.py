"""The answer to `phm reload` about a configuration with many problems."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli.options import EX_CONFIG
from phm.cli.reload import command
from phm.commands.control_server import ControlServer
from phm.commands.requests import Reply
from phm.config import Problem
from phm.runtime.reloader import ReloadOutcome
from phm.wire.command import CommandResult
from tests.fakes.until import until


@pytest.mark.parametrize(("count", "words"), [(150, 400), (2, 100_000)])
def test_many_or_long_problems_are_an_invalid_configuration(tmp_path: Path, count: int, words: int) -> None:
    """The socket's answer is limited: it has fewer of the problems, and their number."""
    problems = tuple(Problem("phm.yaml", line, f"key_{line}", '"ä"' * (words // 3)) for line in range(1, count + 1))
    answer = ReloadOutcome(False, problems=problems).as_json()
    server = ControlServer(str(tmp_path), lambda _request, _by: Reply(CommandResult.ACCEPTED, answer))
    server.start()
    try:
        until((tmp_path / "control.sock").exists)
        result = CliRunner().invoke(command, ["--run-dir", str(tmp_path)])
    finally:
        server.close()
    assert result.exit_code == EX_CONFIG, result.output
    assert "key_1" in result.output
    assert f"{count} problems: the old configuration remains active" in result.output
