"""Restricts the ROS child before it loads foreign code: rclpy, the application's message packages, samples from the
domain.

Landlock limits the files that the process can open; a seccomp filter limits sockets and access to other processes. Both
need no privilege, last until the process ends, and cannot be undone by it. Restrictions that the kernel does not
support are reported: the child works without them, and `phm status` shows that. Runs only in the child.
"""

from __future__ import annotations

import errno
import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

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
_DATAGRAM_MIDDLEWARES = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp")
_DATAGRAMS = ("UDPv4", "UDPv6", "SHM")
_OTHER_PROCESSES = (
    "ptrace", "process_vm_readv", "process_vm_writev", "process_madvise", "kcmp", "tkill", "pidfd_open", "pidfd_getfd",
    "pidfd_send_signal", "process_mrelease", "migrate_pages", "move_pages",
)  # fmt: skip
_FORBIDDEN = (
    *_OTHER_PROCESSES, "execve", "execveat", "io_uring_setup", "io_uring_enter", "io_uring_register", "bpf", "perf_event_open",
    "userfaultfd", "keyctl", "add_key", "request_key", "mount", "umount2", "move_mount", "fsopen", "open_tree", "pivot_root",
    "chroot", "setns", "unshare", "open_by_handle_at", "kexec_load", "init_module", "finit_module",
)  # fmt: skip
"""io_uring would open sockets past the filter; the others access other processes, start programs, or need privileges.
"""
_SIGNALS = ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo")
"""Allowed for the process itself, by its id."""
_SETTINGS = ("sched_setaffinity", "sched_setscheduler", "sched_setparam", "sched_setattr", "prlimit64")
"""Allowed for the process itself, as id 0."""


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

    refused = seccomp.ERRNO(errno.EPERM)
    rules = seccomp.SyscallFilter(defaction=seccomp.ALLOW)

    def refuse(name: str, *arguments: object) -> None:
        if (
            seccomp.resolve_syscall(seccomp.Arch.NATIVE, name) >= 0
        ):  # otherwise a call that this architecture does not have
            rules.add_rule(refused, name, *arguments)

    for name in _FORBIDDEN:
        refuse(name)
    for family in set(range(_LAST_FAMILY + 1)) - set(map(int, _FAMILIES)):
        # The kernel uses 32 bits of the argument, seccomp sees 64: without the mask the upper half evades the rule.
        refuse("socket", seccomp.Arg(0, seccomp.MASKED_EQ, 0xFFFFFFFF, family))
    if not streams:
        for network in (socket.AF_INET, socket.AF_INET6):
            of_network = seccomp.Arg(0, seccomp.MASKED_EQ, 0xFFFFFFFF, int(network))
            refuse("socket", of_network, seccomp.Arg(1, seccomp.MASKED_EQ, _TYPE_MASK, int(socket.SOCK_STREAM)))
    for name in _SIGNALS:
        refuse(name, seccomp.Arg(0, seccomp.NE, os.getpid()))
    for name in _SETTINGS:
        refuse(name, seccomp.Arg(0, seccomp.NE, 0))
    rules.load()
