"""`phm deliver` on the terminal: what answers there may be anyone."""

from __future__ import annotations

import json
import os
import socket
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group


def test_words_of_who_answers_steer_no_terminal(tmp_path: Path) -> None:
    """A refusal is shown although it is from someone without the key."""
    key, file = tmp_path / "key", tmp_path / "a.yaml"
    key.write_bytes(os.urandom(32))
    key.chmod(0o600)
    file.write_text("agent: {id: 1}\n")
    refusal = json.dumps({"ok": False, "text": "\x1b[2J\napplied", "present": "", "problems": []})

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60.0)

        def serve() -> None:
            stream, _ = server.accept()
            with stream:
                stream.sendall(json.dumps({"answer": refusal}).encode() + b"\n")

        thread = threading.Thread(target=serve)
        thread.start()
        where = f"127.0.0.1:{server.getsockname()[1]}"
        result = CliRunner().invoke(group, ["deliver", str(file), where, "--key", str(key), "--any"])
        thread.join()
    assert result.exit_code == 1 and "applied" in result.output
    assert "\x1b" not in result.output and result.output.count("\n") == 1


@pytest.mark.parametrize("arguments", [("deliver", __file__), ("init", "--deliver"), ("status", "--web")])
def test_only_phm_gcs_knows_the_urls_of_connections(arguments: tuple[str, ...]) -> None:
    """The refusal names no other verb."""
    result = CliRunner().invoke(group, [*arguments, "http://10.0.0.5:8014"])
    assert result.exit_code == 2
    assert "'http://10.0.0.5:8014' is not HOST:PORT, e.g. 192.168.7.1:8014" in result.output, result.output
