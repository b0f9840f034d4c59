"""The status file: the state that the running daemon publishes about itself, and when it is valid.

Standard library only: `phm status --healthy` runs every few seconds on small computers and must start fast. The image's
HEALTHCHECK runs this file itself, without site-packages, with the same result in a fifth of the CPU time.
"""

from __future__ import annotations

import json
import os
import sys
import time

TYPE_CHECKING = False
if TYPE_CHECKING:  # importing `typing` would be a fifth of a health check
    from typing import Any

NAME = "status.json"
MAX_AGE_S = 5.0
"""A file older than this is a leftover: the daemon rewrites it every two seconds."""


class NoStatus(Exception):
    """There is no status; the message is one sentence with the reason and the remedy."""


def read(run_dir: str) -> dict[str, Any]:
    """The document that the daemon wrote last. Raises NoStatus."""
    path = os.path.join(run_dir, NAME)
    try:
        with open(path, "rb") as stream:
            data = stream.read()
        document = json.loads(data, parse_constant=_not_json)
        if b"\\ud" in data.lower():
            # An unpaired surrogate, which cannot be printed: from a file name that is not UTF-8, or from damage.
            document = json.loads(json.dumps(document, ensure_ascii=False).encode("utf-8", "replace"))
    except FileNotFoundError:
        raise NoStatus(
            f"there is no {path}: PHM is not running (set it up with `phm init`), was started seconds ago (try again), "
            "or has another run_dir (see --run-dir); in a container: `docker compose exec phm phm status`"
        ) from None
    except OSError as error:
        raise NoStatus(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise NoStatus(f"{path} is not JSON: something other than PHM wrote it") from None
    if not isinstance(document, dict) or not isinstance(document.get("checks", []), list):
        raise NoStatus(f"{path} is not a PHM status: something other than PHM wrote it")
    return document


def _not_json(constant: str) -> object:
    raise ValueError(constant)  # NaN and Infinity: Python's own additions to JSON


def place() -> dict[str, str]:
    """The machine's boot and the PID namespace of this process, each empty if unknown."""
    return {"machine_boot": _machine_boot(), "pid_namespace": _pid_namespace()}


def unhealthy(document: dict[str, Any], *, now_mono: float | None = None) -> str:
    """Why the daemon that wrote `document` is not healthy, as one sentence; empty if it is.

    Healthy means: written within 5 s on the monotonic clock of this boot of the machine, `alive` true, and the process
    exists (checked only in the same PID namespace, where its number means the same process).
    """
    here = place()
    boot = document.get("machine_boot")
    if boot and here["machine_boot"] and boot != here["machine_boot"]:
        return "the status was written before the machine's last start: PHM is not running"
    written = document.get("written_mono")
    if isinstance(written, bool) or not isinstance(written, (int, float)):
        return "the status does not say when it was written: something other than PHM wrote it"
    try:
        age_s = (time.monotonic() if now_mono is None else now_mono) - written
    except OverflowError:  # a whole number beyond all floats
        age_s = -1.0
    if not age_s >= 0:  # from the future, or not a number
        return "the status was written before the machine's last start: PHM is not running"
    if age_s > MAX_AGE_S:
        return f"the status is {age_s:.0f} s old, at most {MAX_AGE_S:.0f} s are allowed: PHM has stopped or hangs"
    if document.get("alive") is not True:
        return "PHM's checks have stalled: see `phm status` for the checks that are overdue"
    namespace = document.get("pid_namespace")
    pid = document.get("pid")
    if namespace and namespace == here["pid_namespace"] and isinstance(pid, int) and not _exists(pid):
        return f"process {pid}, which wrote the status, is gone: PHM was killed"
    return ""


def _machine_boot() -> str:
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as stream:
            return stream.read().strip()
    except OSError:
        return ""


def _pid_namespace() -> str:
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


def _exists(pid: int) -> bool:
    """Whether the process exists; a zombie (killed, not yet collected by its parent) does not."""
    if not 0 < pid < 2**31:
        return False
    try:
        with open(f"/proc/{pid}/stat", "rb") as stream:
            return stream.read().rpartition(b")")[2].split()[0] not in (b"Z", b"X")
    except (OSError, IndexError):
        pass
    # With a /proc that hides other users' processes (hidepid) they seem gone; the kernel distinguishes both.
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def main(arguments: list[str]) -> int:
    """As `phm status --healthy`: a sentence, and 0 or 1. `arguments`: the run_dir, else PHM_RUN_DIR, else /run/phm."""
    run_dir = arguments[0] if arguments else os.environ.get("PHM_RUN_DIR") or "/run/phm"
    try:
        document = read(run_dir)
        reason = unhealthy(document)
    except NoStatus as error:
        document, reason = {}, str(error)
    healthy = f"PHM is healthy: monitoring {len(document.get('checks', ()))} units."
    sys.stdout.write(f"PHM is not healthy: {reason}.\n" if reason else f"{healthy}\n")
    return 1 if reason else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
