"""Foreign code in the ROS child that tries what the sandbox should prevent, and reports successes by a failed import.

PHM_ROS_TARGETS: JSON with the paths `socket`, `datagrams`, `key`, `folder` and `install`, the process id `pid`, the id
`memory` of its shared memory and the TCP port `port`.
"""

import ctypes
import errno
import fcntl
import json
import os
import pathlib
import resource
import signal
import socket
import struct
import subprocess
import threading
from collections.abc import Callable
from typing import Any

import pyseccomp

TARGETS = json.loads(os.environ["PHM_ROS_TARGETS"])
PID = TARGETS["pid"]
LIBC = ctypes.CDLL(None, use_errno=True)
LIBC.syscall.restype = ctypes.c_long
UPPER_HALF = 1 << 32
"""Bits of an argument that the kernel ignores where it takes an int."""
F_SETSIG, F_SETOWN_EX, F_OWNER_PID, FIOSETOWN, SIOCSPGRP = 10, 15, 1, 0x8901, 0x8902
PTRACE_ATTACH, KCMP_VM, PR_SCHED_CORE, SIGEV_THREAD_ID, SI_QUEUE, UFFD_USER_MODE_ONLY = 16, 1, 62, 4, -1, 1
IOPRIO_WHO_PROCESS, IOPRIO_WHO_PGRP, IDLE = 1, 2, 3 << 13
CLONE_NEWUSER, SESSION_KEYRING, NETLINK_USERSOCK = 0x10000000, -3, 2
PAIR = (socket.AF_UNIX, socket.SOCK_STREAM)


def call(name: str, *arguments: Any) -> int:
    """A system call by its name. Raises OSError."""
    number = pyseccomp.resolve_syscall(pyseccomp.Arch.NATIVE, name)
    result = int(LIBC.syscall(number, *(ctypes.c_long(each) if isinstance(each, int) else each for each in arguments)))
    if result < 0:
        raise OSError(ctypes.get_errno(), name)
    return result


def reach(name: str, *arguments: Any) -> None:
    """A call with arguments that the kernel takes for wrong, where right ones would need more. Raises if it is not allowed."""
    try:
        call(name, *arguments)
    except OSError as error:
        if error.errno in (errno.EPERM, errno.EACCES, errno.ENOSYS):
            raise


def connect(family: int, kind: int, address: Any) -> None:
    with socket.socket(family, kind) as made:
        made.connect(address)


def send_from_pair(kind: int) -> None:
    one, other = socket.socketpair(socket.AF_UNIX, kind)
    with one, other:
        one.sendto(b"x", TARGETS["datagrams"])


def connect_from_pair() -> None:
    one, other = socket.socketpair(*PAIR)
    other.close()
    with one:
        one.connect(TARGETS["socket"])


def pair_past_the_mask() -> None:
    call("socketpair", socket.AF_UNIX, socket.SOCK_DGRAM | UPPER_HALF, 0, (ctypes.c_int * 2)())


def with_pipe(command: int, argument: Any) -> None:
    reading, writing = os.pipe()
    try:
        fcntl.fcntl(reading, command, argument)
    finally:
        os.close(reading)
        os.close(writing)


def with_socket(command: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        fcntl.ioctl(made, command, struct.pack("i", PID))


def kill_by_pipe(*, past: int = 0) -> None:
    reading, writing = os.pipe()
    call("fcntl", reading, fcntl.F_SETOWN | past, PID)
    call("fcntl", reading, F_SETSIG | past, signal.SIGKILL)
    call("fcntl", reading, fcntl.F_SETFL, os.O_ASYNC)
    os.write(writing, b"x")


def lease() -> None:
    with open(pathlib.Path(TARGETS["install"], "node.py"), "rb") as file:
        fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)


def signal_by_timer() -> None:
    event = ctypes.create_string_buffer(struct.pack("qiii", 0, signal.SIGCONT, SIGEV_THREAD_ID, PID), 64)
    call("timer_create", 0, event, ctypes.create_string_buffer(8))


def queue_signal(name: str, *ids: int) -> None:
    call(name, *ids, signal.SIGCONT, ctypes.create_string_buffer(struct.pack("iii", signal.SIGCONT, 0, SI_QUEUE), 128))


def start(name: str, *arguments: Any) -> None:
    pid = call(name, *arguments)
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)


def make_queue() -> None:
    call("mq_open", b"phm_intruder", os.O_CREAT | os.O_RDWR, 0o600, None)
    call("mq_unlink", b"phm_intruder")


def start_thread() -> None:
    thread = threading.Thread(target=int)
    thread.start()
    thread.join()


def change_an_open_file(change: Callable[[int], Any]) -> None:
    with open(pathlib.Path(TARGETS["install"], "node.py"), "rb") as file:
        change(file.fileno())


def empty(path: str, access: int) -> None:
    os.close(os.open(path, access | os.O_TRUNC))


ATTEMPTS: dict[str, Callable[[], Any]] = {
    "connect to a local socket": lambda: connect(socket.AF_UNIX, socket.SOCK_STREAM, TARGETS["socket"]),
    "connect to an engine by TCP": lambda: connect(socket.AF_INET, socket.SOCK_STREAM, ("127.0.0.1", TARGETS["port"])),
    "send a datagram to a local socket": lambda: send_from_pair(socket.SOCK_DGRAM),
    "send a datagram to a local socket, without blocking": lambda: send_from_pair(
        socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
    ),
    "send a raw datagram to a local socket": lambda: send_from_pair(socket.SOCK_RAW),
    "make a pair of packets": lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)[0].close(),
    "make a pair of datagrams past the mask": pair_past_the_mask,
    "connect one of a pair to a local socket": connect_from_pair,
    "open a raw socket": lambda: socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_ICMP).close(),
    "send to processes by netlink": lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, NETLINK_USERSOCK).close(),
    "read a key": lambda: pathlib.Path(TARGETS["key"]).read_bytes(),
    "list a folder of PHM": lambda: os.listdir(TARGETS["folder"]),
    "write to a folder of PHM": lambda: pathlib.Path(TARGETS["folder"], "new").write_bytes(b"x"),
    "write to the application's packages": lambda: pathlib.Path(TARGETS["install"], "new").write_bytes(b"x"),
    "change the mode of a key": lambda: os.chmod(TARGETS["key"], 0o644),
    "change the mode of a key by number": lambda: call("fchmodat2", -1, TARGETS["key"].encode(), 0o644, 0),
    "change the owner of a key": lambda: os.chown(TARGETS["key"], os.getuid(), os.getgid()),
    "change the time of a key": lambda: os.utime(TARGETS["key"]),
    "give a key an attribute": lambda: os.setxattr(TARGETS["key"], "user.phm", b"x"),
    "truncate a key": lambda: os.truncate(TARGETS["key"], 64),
    "change the mode of the application's packages": lambda: change_an_open_file(lambda file: os.fchmod(file, 0o644)),
    "change the owner of the application's packages": lambda: change_an_open_file(lambda file: os.fchown(file, -1, -1)),
    "change the time of the application's packages": lambda: change_an_open_file(os.utime),
    "empty the application's packages": lambda: empty(TARGETS["install"] + "/node.py", os.O_RDONLY),
    "empty a key": lambda: empty(TARGETS["key"], os.O_ACCMODE),
    "delay others who open a file": lease,
    "read another process's environment": lambda: pathlib.Path(f"/proc/{PID}/environ").read_bytes(),
    "signal another process": lambda: os.kill(PID, signal.SIGCONT),
    "signal all processes": lambda: os.kill(-1, 0),
    "signal a thread of another process": lambda: call("tgkill", PID, PID, 0),
    "signal a thread of another process by its id": lambda: call("tkill", PID, 0),
    "queue a signal": lambda: queue_signal("rt_sigqueueinfo", PID),
    "queue a signal to a thread": lambda: queue_signal("rt_tgsigqueueinfo", PID, PID),
    "signal by a process descriptor": lambda: reach("pidfd_send_signal", -1, 0, None, 0),
    "signal by a timer": signal_by_timer,
    "make another process the owner of a pipe": lambda: with_pipe(fcntl.F_SETOWN, PID),
    "make another process the owner of a pipe, by a structure": lambda: with_pipe(
        F_SETOWN_EX, struct.pack("ii", F_OWNER_PID, PID)
    ),
    "choose the signal of a pipe": lambda: with_pipe(F_SETSIG, signal.SIGKILL),
    "make another process the owner of a socket": lambda: with_socket(FIOSETOWN),
    "make another group the owner of a socket": lambda: with_socket(SIOCSPGRP),
    "trace another process": lambda: call("ptrace", PTRACE_ATTACH, PID, 0, 0),
    "read another process's memory": lambda: call("process_vm_readv", PID, None, 0, None, 0, 0),
    "write another process's memory": lambda: call("process_vm_writev", PID, None, 0, None, 0, 0),
    "attach another process's shared memory": lambda: call("shmat", TARGETS["memory"], None, 0),
    "make a message queue": make_queue,
    "compare with another process": lambda: call("kcmp", PID, os.getpid(), KCMP_VM, 0, 0),
    "take hold of another process": lambda: os.pidfd_open(PID),
    "take another process's descriptor": lambda: reach("pidfd_getfd", -1, 0, 0),
    "advise about another process's memory": lambda: reach("process_madvise", -1, None, 0, 0, 0),
    "move another process's memory": lambda: reach("migrate_pages", PID, 0, None, None),
    "move another process's pages": lambda: reach("move_pages", PID, 0, None, None, None, 0),
    "share a core with another process": lambda: reach("prctl", PR_SCHED_CORE, 0, PID, 0, ctypes.c_uint64()),
    "slow another process": lambda: os.sched_setaffinity(PID, {0}),
    "slow another process by its policy": lambda: os.sched_setscheduler(PID, os.SCHED_BATCH, os.sched_param(0)),
    "slow another process by its parameters": lambda: os.sched_setparam(PID, os.sched_param(0)),
    "slow another process by its attributes": lambda: call(
        "sched_setattr", PID, ctypes.create_string_buffer(struct.pack("IIQiIQQQ", 48, 0, 0, 0, 0, 0, 0, 0), 48), 0
    ),
    "slow another process by its niceness": lambda: os.setpriority(os.PRIO_PROCESS, PID, 19),
    "slow another group by its niceness": lambda: os.setpriority(os.PRIO_PGRP, PID, 19),
    "slow another process's disk": lambda: call("ioprio_set", IOPRIO_WHO_PROCESS, PID, IDLE),
    "slow another group's disk": lambda: call("ioprio_set", IOPRIO_WHO_PGRP, PID, IDLE),
    "limit another process": lambda: resource.prlimit(PID, resource.RLIMIT_CORE, (0, 0)),
    "start a program": lambda: subprocess.run(["true"], check=False),
    "start a process": lambda: start("clone", signal.SIGCHLD, 0, 0, 0, 0),
    "start a process by a structure": lambda: start(
        "clone3", ctypes.create_string_buffer(struct.pack("QQQQQ", 0, 0, 0, 0, signal.SIGCHLD), 64), 64
    ),
    "start a process in its own namespace": lambda: start("clone", CLONE_NEWUSER | signal.SIGCHLD, 0, 0, 0, 0),
    "queue calls for the kernel": lambda: call("io_uring_setup", 1, ctypes.create_string_buffer(256)),
    "read keys of the kernel": lambda: call("keyctl", 0, SESSION_KEYRING, 0),
    "handle page faults": lambda: call("userfaultfd", UFFD_USER_MODE_ONLY),
    "load code into the kernel": lambda: reach("bpf", 0, ctypes.create_string_buffer(128), 128),
    "count events of the kernel": lambda: reach("perf_event_open", None, 0, -1, -1, 0),
    "restart the machine": lambda: reach("reboot", 0, 0, 0, None),
    "find a secret in the environment": lambda: os.environ["PHM_SIGNING_SECRET"],
    "send a datagram": lambda: connect(socket.AF_INET, socket.SOCK_DGRAM, ("127.0.0.1", 9)),
    "list the interfaces": socket.if_nameindex,
    "make a pair of streams": lambda: [each.close() for each in socket.socketpair(*PAIR)],
    "read the application's packages": lambda: os.listdir(TARGETS["install"]),
    "signal itself": lambda: os.kill(os.getpid(), 0),
    "set its own priority": lambda: os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0)),
    "start a thread": start_thread,
    # At the end, since they may end the process.
    "kill another process by a pipe": kill_by_pipe,
    "kill another process by a pipe past the mask": lambda: kill_by_pipe(past=UPPER_HALF),
}


def succeeded() -> list[str]:
    done = []
    for name, attempt in ATTEMPTS.items():
        try:
            attempt()
        except (OSError, KeyError):
            continue
        done.append(name)
    return done


raise ImportError(json.dumps(succeeded()), name="rclpy.intruder")
