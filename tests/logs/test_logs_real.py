"""`phm logs bundle` with containers of a real engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from click.testing import CliRunner

from phm.cli import group
from tests.fakes.until import until
from tests.logs.test_logs_bundle import members
from tests.probes.docker.conftest import SOCKET, real as real

SECRET = "c0ntainer-s3cret"


def config_of(folder: Path, *containers: str) -> Path:
    path = folder / "phm.yaml"
    listed = "".join(f"  - name: {name}\n" for name in containers)
    path.write_text(
        f"agent: {{name: agent_1, id: 1}}\nlog: {{directory: {folder / 'log'}}}\nstate_dir: {folder / 'state'}\n"
        f"docker: {{socket: {SOCKET}}}\ncontainers:\n{listed}"
    )
    return path


def test_logs_and_inspect_output_of_containers_are_in_the_bundle(real: Any, tmp_path: Path) -> None:
    """Without the secrets of their environment; a container that does not exist is listed as missing."""
    made = real.container("echo said $APP_TOKEN aloud; exec sleep 600", environment={"APP_TOKEN": SECRET, "MODE": "x1"})
    until(lambda: b"aloud" in made.logs(), "the container to write its log")
    file, config = tmp_path / "made.tar.gz", config_of(tmp_path, made.name, "phm-test-none")
    result = CliRunner().invoke(group, ["logs", "bundle", str(file), "-c", str(config), "--run-dir", str(tmp_path)])
    assert result.exit_code == 0, result.output
    inside = members(file)
    assert not [name for name, content in inside.items() if SECRET.encode() in content] and SECRET not in result.output
    assert b"said <removed> aloud" in inside[f"containers/{made.name}/log.txt"]
    assert b"MODE=x1" in inside[f"containers/{made.name}/inspect.json"]
    assert b"APP_TOKEN" in inside["REMOVED.txt"] and b"phm-test-none" in inside["MISSING.txt"]
