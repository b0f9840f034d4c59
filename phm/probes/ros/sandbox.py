"""Restricts the ROS child before it loads foreign code: rclpy, the application's message packages, samples from the
domain.

Landlock limits the files that the process can open; a seccomp filter limits sockets and access to other processes. Both
need no privilege, last until the process ends, and cannot be undone by it. Restrictions that the kernel does not
support are reported: the child works without them, and `phm status` shows that. Runs only in the child.
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

_SYSTEM = (
    "/usr", "/lib", "/lib64", "/opt/ros", "/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d", "/etc/hosts", "/etc/host.conf",
    "/etc/resolv.conf", "/etc/nsswitch.conf", "/etc/gai.conf", "/etc/localtime", "/etc/passwd", "/etc/group",
    "/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/sys/kernel/random", "/proc/sys/net",
    "/sys/devices/system/cpu", "/sys/class/net", "/dev/urandom", "/dev/random",
)  # fmt: skip
"""Files read by the interpreter, the C library and the middleware. Not all of /etc, which contains PHM's configuration
and keys."""
_DEVICES = ("/dev/null", "/dev/zero")
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_FILE_VARIABLES = (
    *PROFILE_VARIABLES, "FASTDDS_ENVIRONMENT_FILE", "CYCLONEDDS_URI",
    "ZENOH_SESSION_CONFIG_URI", "ROS_SECURITY_KEYSTORE", "RCL_LOGGING_CONFIG_FILE",
)  # fmt: skip
"""Environment variables that name a file or folder read by the middleware."""
OWN_PROFILE = "PHM_ROS_PROFILE"
"""Names the child's own profile (`phm.probes.ros.fastdds_profile`), which uses UDP alone."""
_PATH_VARIABLES = ("AMENT_PREFIX_PATH", "LD_LIBRARY_PATH")
_SHARED_MEMORY = "/dev/shm"  # noqa: S108 (Fast DDS puts its segments there when a user turns shared memory on)

_FAMILIES = (socket.AF_INET, socket.AF_INET6, socket.AF_NETLINK)
"""Networks, and the kernel's list of interfaces. Not AF_UNIX, the type of the engine's socket and PHM's control socket.
"""
_LAST_FAMILY = 63
_TYPE_MASK = 0xF
"""The type of a socket without its flags."""
_TYPES = frozenset(range(_TYPE_MASK + 1))
_DATAGRAM_MIDDLEWARES = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp")
_DATAGRAMS = ("UDPv4", "UDPv6", "SHM")
_FORBIDDEN = (
    # Other processes, their memory and IPC.
    "ptrace", "process_vm_readv", "process_vm_writev", "process_madvise", "kcmp", "tkill", "pidfd_open", "pidfd_getfd",
    "pidfd_send_signal", "process_mrelease", "migrate_pages", "move_pages", "fork", "vfork", "execve", "execveat",
    "shmget", "shmat", "shmctl", "semget", "semop", "semtimedop", "semctl", "msgget", "msgsnd", "msgrcv", "msgctl",
    "mq_open", "mq_unlink",
    # Files: what Landlock does not limit; `truncate` since Linux 6.2. Fast DDS gives its segments in shared memory the mode
    # that they have, and ignores the result.
    "chmod", "fchmod", "fchmodat", "fchmodat2", "chown", "fchown", "lchown", "fchownat", "utime", "utimes", "futimesat",
    "utimensat", "setxattr", "fsetxattr", "lsetxattr", "setxattrat", "removexattr", "fremovexattr", "lremovexattr",
    "removexattrat", "truncate",
    # io_uring would open sockets past the filter. The others need privileges or look into the kernel.
    "io_uring_setup", "io_uring_enter", "io_uring_register", "bpf", "perf_event_open", "userfaultfd", "keyctl", "add_key",
    "request_key", "mount", "umount2", "move_mount", "mount_setattr", "fsopen", "fspick", "open_tree", "open_tree_attr",
    "pivot_root", "chroot", "setns", "unshare", "open_by_handle_at", "fanotify_init", "kexec_load", "kexec_file_load",
    "init_module", "finit_module", "delete_module", "reboot", "swapon", "swapoff", "settimeofday", "clock_settime",
)  # fmt: skip
_NUMBERS = {"fchmodat2": 452, "setxattrat": 463, "removexattrat": 466, "open_tree_attr": 467}
"""Calls that libseccomp may not know by name: a newer kernel has them. The numbers are those of every architecture."""
_IN_MEMORY = ("clone3", "openat2")
"""Their arguments are in memory, which a filter cannot read. The C library then uses `clone` and `openat`."""
_CLONE_THREAD = 0x10000
_INT = 0xFFFFFFFF
"""The kernel uses 32 bits of most arguments, seccomp sees 64: without the mask the upper half evades a rule."""
_COMMANDS = (
    # F_SETOWN, F_SETSIG, F_SETOWN_EX: a signal of choice to any process. F_SETLEASE: who opens the file waits for 45 s.
    ("fcntl", 1, (8, 10, 15, 1024)),
    ("ioctl", 1, (0x8901, 0x8902)),  # FIOSETOWN, SIOCSPGRP: as F_SETOWN
    ("prctl", 0, (62,)),  # PR_SCHED_CORE: which processes share a processor core with another one
)
"""System call, argument and the values that are refused."""
_SIGNALS = ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo")
"""Allowed for the process itself, by its id."""
_SETTINGS = {
    **dict.fromkeys(("sched_setaffinity", "sched_setscheduler", "sched_setparam", "sched_setattr", "prlimit64"), (0,)),
    "setpriority": (0, 0),  # PRIO_PROCESS, id
    "ioprio_set": (1, 0),  # IOPRIO_WHO_PROCESS, id
}
"""The only arguments allowed: those of the process itself, as id 0."""
_CREATE_RULESET, _RESTRICT_SELF = 444, 446
_SCOPES = 0b11
"""Abstract sockets and signals."""


def enter(installs: Iterable[str] = (), environ: Callable[[str], str | None] = os.environ.get) -> str:
    """Restrict this process. Returns the missing restrictions as text, empty: none. Call it while there is one thread.

    installs: folders of the application's packages (`ros.installs`), readable.
    """
    missing = [
        f"{what} ({problem})"
        for what, limit in (
            # In this order: importing the binding of seccomp starts a program that looks for the library.
            ("sockets and processes: no seccomp", lambda: _limit_calls(streams=_needs_streams(environ))),
            ("files: no Landlock", lambda: _limit_files(list(_readable(installs, environ)), _writable(environ))),
        )
        if (problem := _attempt(limit))
    ]
    return "; ".join(missing)


def _attempt(limit: Callable[[], None]) -> str:
    try:
        limit()
    except Exception as error:  # a kernel, container filter or library that does not support it
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or str(error)
        return str(reason) or type(error).__name__
    return ""


# ------------------------------------------------------------ files


def _readable(installs: Iterable[str], environ: Callable[[str], str | None]) -> Iterator[str]:
    yield from _SYSTEM
    yield from (sys.prefix, sys.exec_prefix, sys.base_prefix, sys.base_exec_prefix)
    yield from sys.path
    yield from installs
    for name in _FILE_VARIABLES:
        # Cyclone DDS accepts several, separated by commas.
        yield from (part.removeprefix("file://") for part in (environ(name) or "").split(","))
    for name in _PATH_VARIABLES:
        yield from (environ(name) or "").split(os.pathsep)


def _writable(environ: Callable[[str], str | None]) -> list[str]:
    """The folder of rclpy's own log, which must exist before the restriction, and shared memory of the middleware."""
    folder = environ("ROS_LOG_DIR")
    if folder:
        Path(folder).mkdir(parents=True, exist_ok=True)
    return [folder or "", _SHARED_MEMORY]


def _limit_files(readable: list[str], writable: list[str]) -> None:
    from landlock import FSAccess, Ruleset

    ruleset = Ruleset()
    read = FSAccess.READ_FILE | FSAccess.READ_DIR
    for path in readable:
        _allow(ruleset, path, read, read & FSAccess.all_file())
    for path in writable:
        _allow(ruleset, path, FSAccess.all() & ~FSAccess.EXECUTE, FSAccess.READ_FILE | FSAccess.WRITE_FILE)
    for path in _DEVICES:
        _allow(ruleset, path, read, FSAccess.READ_FILE | FSAccess.WRITE_FILE)
    ruleset.apply()
    _limit_scope()


def _limit_scope() -> None:
    """A second barrier before other processes, from Linux 6.12; the binding does not have it, an older kernel refuses it."""
    system = ctypes.CDLL(None)
    attributes = (ctypes.c_uint64 * 3)(0, 0, _SCOPES)
    ruleset = system.syscall(_CREATE_RULESET, attributes, ctypes.c_size_t(ctypes.sizeof(attributes)), 0)
    if ruleset >= 0:
        system.syscall(_RESTRICT_SELF, ruleset, 0)
        os.close(ruleset)


def _allow(ruleset: object, path: str, of_folder: object, of_file: object) -> None:
    """A relative path, the root and what does not exist are left out: an empty or wrong variable must not open everything."""
    if not path.startswith("/") or os.path.realpath(path) == "/" or not os.path.exists(path):
        return
    ruleset.allow(path, rules=of_folder if os.path.isdir(path) else of_file)  # type: ignore[attr-defined]


# ------------------------------------------------------------ system calls


def _needs_streams(environ: Callable[[str], str | None]) -> bool:
    """Whether the middleware may use TCP. Fast DDS over UDP and Cyclone do not, and an engine on TCP must be
    unreachable."""
    profiles = [environ(name) or "" for name in PROFILE_VARIABLES]
    if any(path not in ("", environ(OWN_PROFILE)) for path in profiles) or environ("CYCLONEDDS_URI"):
        return True
    if environ("RMW_IMPLEMENTATION") not in (None, "", *_DATAGRAM_MIDDLEWARES):
        return True
    return "TCP" in (environ("ROS_DISCOVERY_SERVER") or "") or environ("FASTDDS_BUILTIN_TRANSPORTS") not in _DATAGRAMS


def _limit_calls(*, streams: bool) -> None:
    import pyseccomp as seccomp

    rules = seccomp.SyscallFilter(defaction=seccomp.ALLOW)
    for name, *arguments in itertools.chain(_refused(), _refused_sockets(streams=streams), _refused_for_others()):
        number = _NUMBERS.get(name, seccomp.resolve_syscall(seccomp.Arch.NATIVE, name))
        if number >= 0:  # otherwise a call that this architecture does not have
            error = errno.ENOSYS if name in _IN_MEMORY else errno.EPERM
            rules.add_rule(seccomp.ERRNO(error), number, *arguments)
    rules.load()


def _refused() -> Iterator[tuple[Any, ...]]:
    """Each a system call and the arguments with which it is refused."""
    for name in (*_FORBIDDEN, *_IN_MEMORY):
        yield (name,)
    yield "clone", _masked(0, 0, _CLONE_THREAD)  # a new process, which a new namespace also needs
    # Landlock before Linux 6.2 does not see that these write.
    for access in (os.O_RDONLY, os.O_ACCMODE):
        for name, argument in (("open", 1), ("openat", 2)):
            yield name, _masked(argument, access | os.O_TRUNC, os.O_ACCMODE | os.O_TRUNC)


def _refused_sockets(*, streams: bool) -> Iterator[tuple[Any, ...]]:
    stream = int(socket.SOCK_STREAM)
    for family in set(range(_LAST_FAMILY + 1)) - set(map(int, _FAMILIES)):
        yield "socket", _masked(0, family)
    yield "socket", _masked(0, int(socket.AF_NETLINK)), _other_than(2, socket.NETLINK_ROUTE)
    for kind in _TYPES - {int(socket.SOCK_DGRAM), *([stream] if streams else [])}:
        for network in (socket.AF_INET, socket.AF_INET6):
            yield "socket", _masked(0, int(network)), _masked(1, kind, _TYPE_MASK)
    # Of a pair, a datagram can go to any path.
    yield "socketpair", _other_than(0, int(socket.AF_UNIX))
    for kind in _TYPES - {stream}:
        yield "socketpair", _masked(1, kind, _TYPE_MASK)


def _refused_for_others() -> Iterator[tuple[Any, ...]]:
    for name, argument, values in _COMMANDS:
        for value in values:
            yield name, _masked(argument, value)
    for name, own in {**dict.fromkeys(_SIGNALS, (os.getpid(),)), **_SETTINGS}.items():
        for argument, value in enumerate(own):
            yield name, _other_than(argument, value)


def _masked(argument: int, value: int, mask: int = _INT) -> object:
    import pyseccomp as seccomp

    return seccomp.Arg(argument, seccomp.MASKED_EQ, mask, value)


def _other_than(argument: int, value: int) -> object:
    import pyseccomp as seccomp

    return seccomp.Arg(argument, seccomp.NE, value)
