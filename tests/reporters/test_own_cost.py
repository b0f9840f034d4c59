"""What the log says PHM costs is what the kernel says of its processes."""

from __future__ import annotations

import subprocess
import sys

import psutil

from phm.reporters.own_cost import own_cost

BUSY = "import time\nend = time.process_time() + 0.4\nwhile time.process_time() < end: pass\nprint('done', flush=True)\ninput()"


def test_child_processes_count_while_they_run_and_after_their_end() -> None:
    """The ROS child is the larger half of PHM."""
    before = own_cost({})
    with subprocess.Popen([sys.executable, "-c", BUSY], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None and child.stdout.readline() == b"done\n"
        during = own_cost({})
        child.communicate(b"\n", timeout=60)
    after = own_cost({})
    assert during["processes"] == before["processes"] + 1
    assert during["cpu_s"] - before["cpu_s"] >= 0.3 and after["cpu_s"] >= during["cpu_s"]
    assert 0 < during["memory_bytes"] <= psutil.virtual_memory().total


def test_bytes_sent_are_those_of_each_link() -> None:
    """As in `phm status`."""
    health = {
        "links": [{"name": "ground", "bytes_out": 120, "bytes_in": 7}, {"name": "peers", "bytes_out": 3, "bytes_in": 0}]
    }
    assert own_cost(health)["sent_bytes"] == {"ground": 120, "peers": 3}
