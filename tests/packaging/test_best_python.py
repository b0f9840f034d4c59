"""scripts/lib.sh chooses a Python without messages of its own parts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LISTS_MANY = (
    f"pythons() {{ local n; for n in $(seq 20000); do printf '%s\\n' '3.12 {sys.executable}' || return 1; done; }}"
)


def test_the_first_python_is_taken_without_an_error_of_the_list() -> None:
    """The list of Pythons is longer than what is read of it, and SIGPIPE is ignored, as it may be where a script is started."""
    script = f"trap '' PIPE; source scripts/lib.sh; {LISTS_MANY}; best_python"
    done = subprocess.run(["bash", "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    assert (done.stdout, done.stderr) == (sys.executable, "")
