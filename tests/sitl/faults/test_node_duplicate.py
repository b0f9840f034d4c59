"""The second process of a node is one as the first, whatever the profile and the graph of the application are."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest

from sitl.application.graph import OPTIONS_VARIABLE
from sitl.faults import node_duplicate
from sitl.faults.base import Agent

NODE = """
import os, sys
with open(os.environ["SEEN"], "a") as file:
    file.write(f"{sys.argv[1:]} {os.environ['SITL_NODE']}\\n")
print("up", flush=True)
sys.stdin.read()
"""


def test_the_second_process_has_command_line_and_environment_of_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node as found has its name in the environment, none in the command line, and no beacon: neither may its double."""
    monkeypatch.setattr(node_duplicate, "PID", str(tmp_path / "duplicate.pid"))
    monkeypatch.setattr(node_duplicate, "NODE_PID", str(tmp_path / "node_1.pid"))
    seen = tmp_path / "seen"
    own = {OPTIONS_VARIABLE: '["--publish", "topic_1:5", "--no-beacon"]', "SEEN": str(seen)}
    argv = [sys.executable, "-c", NODE, "a word", ""]

    def run_in_app(shell: str, option: str, script: str) -> str:
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        # The engine does not wait for what runs in the background; this test does.
        subprocess.run([shell, option, f"{script}; wait"], env={**os.environ, "PATH": path}, check=True)
        return ""

    with subprocess.Popen(
        argv, env={**os.environ, **own}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdin is not None and first.stdout is not None
        assert first.stdout.readline() == "up\n"
        (tmp_path / "node_1.pid").write_text(f"{first.pid}\n", "ascii")
        node_duplicate.Injection().inject(mock.Mock(spec=Agent, generation="1", run_in_app=run_in_app))
        first.stdin.close()
    line = f"['a word', ''] {own[OPTIONS_VARIABLE]}\n"
    assert seen.read_text("ascii") == 2 * line
    assert (tmp_path / "duplicate.pid").read_text("ascii").strip().isdecimal()
