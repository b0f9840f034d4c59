"""`phm logs collect` from containers of a real engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.fakes.log_agents import collect, texts
from tests.fakes.until import until
from tests.probes.docker.conftest import SOCKET, real as real

WRITE = """
mkdir -p /var/log/phm && cd /var/log/phm
line() { echo "{\\"agent\\":\\"uav\\",\\"agent_id\\":7,\\"boot_id\\":\\"b\\",\\"seq\\":$1,\\"event\\":\\"note\\",\\"text\\":\\"event $1\\"}"; }
line 1 | gzip > phm.jsonl.2.gz
line 2 > phm.jsonl.1
line 3 > phm.jsonl
touch -d @1000 phm.jsonl.2.gz; touch -d @2000 phm.jsonl.1  # written one after another, as by PHM
ln -s /etc/passwd phm.jsonl.3
echo text > phm.log
echo ready
exec sleep 600
"""


def test_logs_of_a_container_are_collected_once(real: Any, tmp_path: Path) -> None:
    """Also of a stopped one; the second run copies nothing, and a link is left alone."""
    made = real.container(WRITE)
    until(lambda: b"ready" in made.logs(), "the container to write its log")
    words = (tmp_path / "out", "--docker", SOCKET, "--container", made.name)
    result = collect(*words)
    assert result.exit_code == 0, result.output
    assert texts(tmp_path / "out" / "uav") == [1, 2, 3]
    assert (tmp_path / "out" / "uav" / "phm.log").read_text() == "text\n"
    made.stop(timeout=0)
    result = collect(*words)
    assert result.exit_code == 0 and "0 files fetched (0.0 MB), 4 unchanged" in result.output
    assert not list((tmp_path / "out" / "uav").glob("phm.jsonl.3*"))
