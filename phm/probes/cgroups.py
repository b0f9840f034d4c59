"""Reads the files of a container's cgroup, version 2 or 1, in the host's tree. Read-only; needs no privilege.

Formats: the kernel's Documentation/admin-guide/cgroup-v2.rst and cgroup-v1/. If both versions are mounted (hybrid, with
version 2 at `unified`), limits and counters are those of version 1, and pressure is that of version 2.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from phm.facts import CgroupState, ContainerFact, PressureFact, StallFact
from phm.probes.kernel_file import head

NEAR_LIMIT = 0.9
"""Below this share of its memory limit PHM does not read a container's memory.stat, the most expensive file."""
MOST_GROUPS = 256
PERIOD_S = 0.1
"""Period of a CPU limit, the kernel's default."""
_ID = re.compile(r"[0-9a-f]{64}")
_SCOPE = re.compile(r"(?:docker-)?([0-9a-f]{64})(?:\.scope)?")
_PARENT = re.compile(r"[A-Za-z0-9_.@:/-]{1,200}")
_NO_LIMIT = 1 << 60
"""Version 1 writes its largest number of pages if there is no limit."""


@dataclass(frozen=True, slots=True)
class Cgroup:
    """The directories of one container. `unified` is that of version 2, used alone or beside version 1."""

    unified: str
    cpu: str = ""
    cpuacct: str = ""
    memory: str = ""
    pids: str = ""

    @property
    def version(self) -> int:
        return 1 if self.cpu else 2


def find(root: Path, container: ContainerFact) -> Cgroup | None:
    """The cgroup of a running container below `root`, the mount of the host's /sys/fs/cgroup; None if it does not
    exist."""
    if not _ID.fullmatch(container.id):
        return None
    for place in _places(container):
        group = _group(root, place)
        if group is not None:
            return group
    return None


def _places(container: ContainerFact) -> Iterator[str]:
    """Possible paths, for the cgroup drivers cgroupfs and systemd, and for a parent configured by the user."""
    parent = container.cgroup_parent.strip("/")
    if _PARENT.fullmatch(parent) and ".." not in parent.split("/"):
        if parent.endswith(".slice"):
            yield f"{_slice(parent)}/docker-{container.id}.scope"
        yield f"{parent}/{container.id}"
    yield f"docker/{container.id}"
    yield f"system.slice/docker-{container.id}.scope"


def _slice(name: str) -> str:
    """The path of a systemd slice: `a-b.slice` is in `a.slice`."""
    words = name.rpartition("/")[2].removesuffix(".slice").split("-")
    return "/".join("-".join(words[: count + 1]) + ".slice" for count in range(len(words)))


def cpu_weight(root: Path, container: ContainerFact) -> int:
    """The CPU weight of a running container on version 2; 0: version 1, where the engine's shares are exact, or not known."""
    group = find(root, container)
    text = _text(f"{group.unified}/cpu.weight") if group is not None and group.version == 2 else None
    return int(text) if text and text.isdecimal() else 0


def state(root: Path, group: Cgroup) -> CgroupState | None:
    """Whether a cgroup that was found has processes now; None if `root` does not show it any more."""
    if group.version == 2:
        return _state_v2(group) if (root / "cgroup.controllers").exists() else None
    return _state_v1(root, group) if (root / "cpu").is_dir() else None


def _state_v2(group: Cgroup) -> CgroupState | None:
    events = _table(f"{group.unified}/cgroup.events")
    if not events.get("populated"):
        if events:
            return CgroupState.EMPTY
        return None if os.path.exists(group.unified) else CgroupState.REMOVED
    return CgroupState.FROZEN if events.get("frozen") else CgroupState.RUNNING


def _state_v1(root: Path, group: Cgroup) -> CgroupState | None:
    """By the number of tasks: version 1 does not list processes that are outside of PHM's PID namespace."""
    if not os.path.exists(group.cpu):
        return CgroupState.REMOVED
    tasks = _text(f"{group.pids}/pids.current")
    if tasks in ("0", None, ""):
        return CgroupState.EMPTY if tasks == "0" else None
    frozen = _text(str(root / "freezer" / os.path.relpath(group.cpu, root / "cpu") / "freezer.state")) or ""
    return CgroupState.FROZEN if frozen.startswith("FR") else CgroupState.RUNNING


def _group(root: Path, place: str) -> Cgroup | None:
    if (root / "cgroup.controllers").exists():
        return Cgroup(str(root / place)) if (root / place).is_dir() else None
    cpu = root / "cpu" / place
    if not cpu.is_dir():
        return None
    unified = root / "unified" / place
    others = (str(root / name / place) for name in ("cpuacct", "memory", "pids"))
    return Cgroup(str(unified) if unified.is_dir() else "", str(cpu), *others)


def read(group: Cgroup, at: float) -> PressureFact:
    """Read all figures at monotonic second `at`. Raises OSError if the container has ended, ValueError for unexpected
    content."""
    return _read_v1(group, at) if group.version == 1 else _read_v2(group, at)


def _read_v2(group: Cgroup, at: float) -> PressureFact:
    base = group.unified
    cpu = _table(f"{base}/cpu.stat")
    quota, _, period = (_text(f"{base}/cpu.max") or "max").partition(" ")
    period_s = int(period or 0) / 1e6 or PERIOD_S
    used, limit = _number(f"{base}/memory.current"), _number(f"{base}/memory.max")
    events = _table(f"{base}/memory.events")
    return PressureFact(
        at,
        "cgroup v2",
        _life(base),
        _not_seen(base, cpu, used),
        cpu_limit=int(quota) / (period_s * 1e6) if quota.isdecimal() else None,
        cpu_used_s=_seconds(cpu, "usage_usec", 1e6),
        cpu_period_s=period_s,
        throttled_periods=cpu.get("nr_throttled"),
        throttled_s=_seconds(cpu, "throttled_usec", 1e6),
        cpu=_stall(base, "cpu"),
        memory=_stall(base, "memory"),
        io=_stall(base, "io"),
        memory_bytes=used,
        memory_limit=limit,
        reread_pages=_reread(f"{base}/memory.stat", used, limit),
        oom_kills=events.get("oom_kill"),
        memory_limit_hits=events.get("oom"),
        pids=_number(f"{base}/pids.current"),
        pids_limit=_number(f"{base}/pids.max"),
        pids_refused=_table(f"{base}/pids.events").get("max"),
    )


def _read_v1(group: Cgroup, at: float) -> PressureFact:
    cpu = _table(f"{group.cpu}/cpu.stat")
    quota_us, period_us = _number(f"{group.cpu}/cpu.cfs_quota_us"), _number(f"{group.cpu}/cpu.cfs_period_us")
    period_s = (period_us or 0) / 1e6 or PERIOD_S
    used_ns = _number(f"{group.cpuacct}/cpuacct.usage")
    used, limit = _number(f"{group.memory}/memory.usage_in_bytes"), _number(f"{group.memory}/memory.limit_in_bytes")
    limit = None if limit is None or limit >= _NO_LIMIT else limit
    base = group.unified
    return PressureFact(
        at,
        "cgroup v1",
        _life(group.cpu),
        _not_seen(base, cpu, used),
        cpu_limit=quota_us / (period_s * 1e6) if quota_us is not None and quota_us > 0 else None,
        cpu_used_s=None if used_ns is None else used_ns / 1e9,
        cpu_period_s=period_s,
        throttled_periods=cpu.get("nr_throttled"),
        throttled_s=_seconds(cpu, "throttled_time", 1e9),
        cpu=_stall(base, "cpu"),
        memory=_stall(base, "memory"),
        io=_stall(base, "io"),
        memory_bytes=used,
        memory_limit=limit,
        reread_pages=_reread(f"{group.memory}/memory.stat", used, limit),
        oom_kills=_table(f"{group.memory}/memory.oom_control").get("oom_kill"),
        memory_limit_hits=_limit_hits_v1(group.memory),
        pids=_number(f"{group.pids}/pids.current"),
        pids_limit=_number(f"{group.pids}/pids.max"),
        pids_refused=_table(f"{group.pids}/pids.events").get("max"),
    )


def _limit_hits_v1(base: str) -> int | None:
    """How often the memory limit was reached. None if the limit of memory and swap together has been reached too: Linux
    6.18 does not count that."""
    most, limit = _number(f"{base}/memory.memsw.max_usage_in_bytes"), _number(f"{base}/memory.memsw.limit_in_bytes")
    if most is not None and limit is not None and most >= NEAR_LIMIT * limit:
        return None
    return _number(f"{base}/memory.failcnt")


def without_cache(group: Cgroup, used: int | None) -> int | None:
    """Bytes of the `used` memory without pages of files, active or not: both can be evicted. Reads memory.stat."""
    table = _table(f"{group.memory or group.unified}/memory.stat")
    return less_cache(used, table)


def less_cache(used: int | None, table: Mapping[str, int]) -> int | None:
    """The same from the lines of memory.stat; version 1 has those of the group and its children as `total_...`."""
    pages = [table.get(f"total_{name}", table.get(name)) for name in ("inactive_file", "active_file")]
    known = [count for count in pages if count is not None]
    return None if used is None or len(known) < len(pages) else max(0, used - sum(known))


def used_by_all(root: Path, known: Iterable[Cgroup] = ()) -> dict[str, float]:
    """CPU seconds used by each container, by full id; for at most MOST_GROUPS containers.

    They are searched beside those of `known` too, which may be below a parent configured by the user.
    """
    first = root if (root / "cgroup.controllers").exists() else root / "cpuacct"
    parents = [Path(group.cpuacct or group.unified).parent for group in known]
    found: dict[str, float] = {}
    for parent in dict.fromkeys((*parents, first / "docker", first / "system.slice")):
        for name in _names(parent):
            match = _SCOPE.fullmatch(name)
            used_s = _used_s(str(parent / name)) if match else None
            if match and used_s is not None and len(found) < MOST_GROUPS:
                found[match[1]] = used_s
    return found


def used_s(group: Cgroup) -> float | None:
    return _used_s(group.cpuacct or group.unified)


def _used_s(base: str) -> float | None:
    try:
        version_1 = _number(f"{base}/cpuacct.usage")
        return version_1 / 1e9 if version_1 is not None else _seconds(_table(f"{base}/cpu.stat"), "usage_usec", 1e6)
    except ValueError:
        return None


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _life(base: str) -> str:
    """Raises OSError if the cgroup has gone. A restarted container gets a new directory of the same name."""
    return f"{base}@{os.stat(base).st_ino}"


def _not_seen(base: str, cpu: Mapping[str, int], memory_bytes: int | None) -> tuple[str, ...]:
    """What the kernel does not count for this container: a disabled controller, or no pressure stall information
    (`psi=1`)."""
    missing = [] if "nr_throttled" in cpu else ["its CPU limit"]
    if memory_bytes is None:
        missing.append("its memory limit")
    if not base or _stall(base, "cpu") is None:
        missing.append("waiting for CPU, memory and disk (no pressure stall information)")
    return tuple(missing)


def _reread(path: str, used: int | None, limit: int | None) -> int | None:
    """Pages read again by a process that had to wait: the lower of the major faults and the refaults.

    Files that are read once are refaults without a major fault; programs and maps that are loaded for the first time
    are major faults without a refault.
    """
    if used is None or limit is None or used < NEAR_LIMIT * limit:
        return None
    table = _table(path)
    faults = table.get("pgmajfault")
    refaults = [count for name, count in table.items() if name in _REFAULTS]
    return faults if faults is None or not refaults else min(faults, sum(refaults))


_REFAULTS = ("workingset_refault", "workingset_refault_anon", "workingset_refault_file")


def _stall(base: str, what: str) -> StallFact | None:
    found: dict[str, float] = {}
    for line in ((_text(f"{base}/{what}.pressure") if base else None) or "").splitlines():
        kind, _, rest = line.partition(" ")
        total = rest.rpartition("total=")[2]
        if total.isdecimal():
            found[kind] = int(total) / 1e6
    return StallFact(found["some"], found.get("full")) if "some" in found else None


def _table(path: str) -> dict[str, int]:
    """Lines `name number`; others are ignored. Empty if the file does not exist."""
    found: dict[str, int] = {}
    for line in (_text(path) or "").splitlines():
        name, _, number = line.partition(" ")
        if number.isdecimal():
            found[name] = int(number)
    return found


def _number(path: str) -> int | None:
    """The number in a file; None for `max`, and if the file does not exist."""
    text = _text(path)
    return None if text is None or text in ("", "max") else int(text)


def _seconds(table: Mapping[str, int], name: str, per_s: float) -> float | None:
    return table[name] / per_s if name in table else None


def _text(path: str) -> str | None:
    """The content of a small kernel file; None if it does not exist."""
    try:
        return head(path, 8192).strip()
    except OSError:
        return None
