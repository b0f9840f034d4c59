"""PHM's processes in its container, and what the kernel says of them. Health checks, which the engine starts, are not among them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

PROC = Path("/proc")


@dataclass(frozen=True)
class Tree:
    """pids: the container's first process and all its descendants. daemon: that process, or the first that a container's init started."""

    pids: Sequence[int]
    daemon: str


def tree(first: int, pids: Sequence[int], proc: Path = PROC) -> Tree:
    """Of the processes of a container. LookupError when the first one is gone."""
    parents = {pid: parent for pid in pids if (parent := _parent(pid, proc)) is not None}
    if first not in parents:
        raise LookupError(f"process {first} has ended")
    mine = [pid for pid in sorted(parents) if _descends(pid, first, parents)]
    children = [pid for pid in mine if parents[pid] == first]
    daemon = min(children, default=first) if _name(first, proc) in ("tini", "docker-init") else first
    return Tree(mine, f"{first}/{daemon}")


def _descends(pid: int, first: int, parents: Mapping[int, int]) -> bool:
    for _ in range(len(parents) + 1):
        if pid == first:
            return True
        if pid not in parents:
            return False
        pid = parents[pid]
    return False


def _name(pid: int, proc: Path) -> str:
    with contextlib.suppress(OSError):
        return (proc / str(pid) / "comm").read_text("utf-8", "replace").strip()
    return ""


def _parent(pid: int, proc: Path) -> int | None:
    with contextlib.suppress(OSError, IndexError, ValueError):
        # The name, in parentheses, may have anything in it.
        return int((proc / str(pid) / "stat").read_text("utf-8", "replace").rpartition(")")[2].split()[1])
    return None


def memory_mb(pids: Sequence[int], proc: Path = PROC) -> tuple[float, float]:
    """Resident and private memory of processes; one that is gone has none."""
    resident = private = 0
    for pid in pids:
        with contextlib.suppress(OSError, ValueError, IndexError):
            for line in (proc / str(pid) / "smaps_rollup").read_text("ascii", "replace").splitlines():
                name, *rest = line.split()
                resident += 1024 * int(rest[0]) if name == "Rss:" else 0
                private += 1024 * int(rest[0]) if name in ("Private_Clean:", "Private_Dirty:") else 0
    return resident / 1e6, private / 1e6


def descriptors(pids: Sequence[int], proc: Path = PROC) -> int:
    found = 0
    for pid in pids:
        with contextlib.suppress(OSError):
            found += sum(1 for _ in (proc / str(pid) / "fd").iterdir())
    return found


@dataclass
class Wakeups:
    """The voluntary context switches of threads, which end while it counts: a total that never falls."""

    total: int = 0
    _last: dict[tuple[int, int], int] = field(default_factory=dict)

    def take(self, pids: Sequence[int], proc: Path = PROC) -> int:
        """Count again; the number of threads."""
        now = {(pid, thread): count for pid in pids for thread, count in _switches(pid, proc).items()}
        if self._last:
            # What a thread did before it was first seen, or after it was last seen, is not completely known.
            self.total += sum(max(0, count - self._last.get(key, 0)) for key, count in now.items())
        self._last = now
        return len(now)


def _switches(pid: int, proc: Path) -> dict[int, int]:
    found = {}
    with contextlib.suppress(OSError):
        for task in (proc / str(pid) / "task").iterdir():
            with contextlib.suppress(OSError, ValueError, IndexError):
                for line in (task / "status").read_text("utf-8", "replace").splitlines():
                    if line.startswith("voluntary_ctxt_switches:"):
                        found[int(task.name)] = int(line.split()[1])
    return found
