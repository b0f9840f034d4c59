"""`phm run` with an unusable key ends like any invalid configuration, before anything is opened."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group


@pytest.mark.parametrize(("mode", "said"), [(0o644, "others than its owner"), (None, "cannot be read")])
def test_an_unusable_key_ends_with_exit_code_78(tmp_path: Path, mode: int | None, said: str) -> None:
    """One sentence that says what to do; PHM never sends unsigned frames if signing is configured."""
    key, config = tmp_path / "key", tmp_path / "phm.yaml"
    if mode is not None:
        key.write_bytes(bytes(32))
        key.chmod(mode)
    config.write_text(f"""
mavlink:
  endpoints: [{{url: "udpout:127.0.0.1:9"}}]
  signing: {{key: "{key}"}}
state_dir: {tmp_path}
run_dir: {tmp_path}
""")
    result = CliRunner().invoke(group, ["run", "-c", str(config)])
    assert result.exit_code == 78
    assert f"mavlink.signing.key: {key}" in result.output
    assert said in result.output
