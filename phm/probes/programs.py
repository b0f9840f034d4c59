"""Runs programs that the configuration names, beside PHM or in a container, and lists the processes that PHM sees."""

from __future__ import annotations

import contextlib
import os
import selectors
import subprocess
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from phm.core import process_group
from phm.core.clock import Clock
from phm.facts import CannotTell, ContainerFact, NotPermitted, ProcessFact, ProgramFact
from phm.transport.docker import NEVER_STARTED, DockerEngine, EngineMissing, EngineTimeout

AT_ONCE = 4
"""This many programs run beside PHM at a time."""
OUTPUT_BYTES = 16 << 10
"""More output is read and dropped."""
MOST_PROCESSES = 4096
ENVIRONMENT = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8", "HOME": "/"}
"""All that a program gets: PHM's own environment may hold keys."""
_LATE_S = 60.0
"""A busy engine may start a program so long after PHM has given it up."""
_ENDED_S = 0.2
"""How often a program is looked for that closed its output, or ended while a child of it holds the output open."""


class Programs:
    """Implements `phm.facts.ProgramProbe`. Thread-safe."""

    def __init__(
        self,
        engine: DockerEngine,
        container: Callable[[str], ContainerFact | None],
        clock: Clock,
        proc: Path = Path("/proc"),
    ) -> None:
        self._engine, self._container, self._clock, self._proc = engine, container, clock, proc
        self._free = threading.BoundedSemaphore(AT_ONCE)
        self._locks: dict[str, threading.Lock] = {}
        self._unfinished: dict[tuple[str, tuple[str, ...]], tuple[str, float]] = {}
        """The id of a program that is not known to have ended, and until when the engine may still start it."""
        self._running: set[int] = set()
        self._hung: dict[tuple[str, ...], subprocess.Popen[bytes]] = {}
        """Programs beside PHM that were killed and may not have ended yet."""
        self._closed = False
        self._lock = threading.Lock()

    def close(self) -> None:
        """Kill the programs that run beside PHM, with their children; no other is started."""
        with self._lock:
            self._closed = True
            for pid in self._running:
                process_group.kill(pid)

    def run(self, argv: Sequence[str], *, timeout_s: float, container: str = "") -> ProgramFact:
        until = self._clock.mono() + timeout_s
        with self._lock:
            lock = self._locks.setdefault(container, threading.Lock()) if container else self._free
        # In a container one at a time: a socket proxy knows only the newest program.
        if not lock.acquire(timeout=timeout_s):
            raise CannotTell(f"{argv[0]} was not started: other programs have been running for {timeout_s:g} s")
        try:
            return self._inside(argv, until, container) if container else self._beside(argv, until, timeout_s)
        finally:
            lock.release()

    def processes(self) -> tuple[ProcessFact, ...]:
        found = []
        try:
            pids = [int(name) for name in os.listdir(self._proc) if name.isdecimal()]
        except OSError as error:
            raise CannotTell(f"{self._proc} cannot be read: {error.strerror}") from error
        for pid in sorted(pids)[:MOST_PROCESSES]:
            with contextlib.suppress(OSError):  # it has ended
                words = _beginning(self._proc / str(pid) / "cmdline").replace(b"\0", b" ")
                if words and pid != os.getpid():
                    found.append(ProcessFact(pid, command=words.decode("utf-8", "replace").strip()))
        return tuple(found)

    # ------------------------------------------------------------ in a container

    def _inside(self, argv: Sequence[str], until: float, container: str) -> ProgramFact:
        fact = self._container(container)
        if fact is None or not fact.running:
            raise CannotTell(f"{container} is not running, so {argv[0]} cannot be started in it")
        key, began = (container, tuple(argv)), self._clock.mono()
        self._demand_ended(key)
        made = self._engine.exec_create(fact.id, argv)
        self._unfinished[key] = (made, began)
        try:
            output, errors = self._engine.exec_read(made, OUTPUT_BYTES, deadline_s=max(0.1, until - self._clock.mono()))
        except EngineTimeout:
            self._unfinished[key] = (made, self._clock.mono() + _LATE_S)
            raise
        code = self._engine.exec_exit_code(made)
        if code is None:
            raise CannotTell(f"{argv[0]} closed its output in {container} and still runs")
        del self._unfinished[key]
        if code == NEVER_STARTED:
            raise CannotTell(f"the Docker Engine did not start {argv[0]} in {container}")
        if code in (126, 127) and not output:
            raise CannotTell(
                f"{argv[0]} cannot be started in {container}: {_text(errors)[:200] or f'exit code {code}'}"
            )
        return ProgramFact(code, _text(output or errors), self._clock.mono() - began)

    def _demand_ended(self, key: tuple[str, tuple[str, ...]]) -> None:
        """Docker cannot end a program in a container: another one is not started while it runs."""
        earlier = self._unfinished.get(key)
        if earlier is None:
            return
        program, late_s = earlier
        with contextlib.suppress(EngineMissing, NotPermitted):
            code = self._engine.exec_exit_code(program)
            if code is None:
                raise CannotTell(f"{key[1][0]} of an earlier run has not ended in {key[0]}")
            if code == NEVER_STARTED and self._clock.mono() < late_s:
                raise CannotTell(f"the Docker Engine may still start {key[1][0]} of an earlier run in {key[0]}")
        del self._unfinished[key]

    # ------------------------------------------------------------ beside PHM

    def _beside(self, argv: Sequence[str], until: float, timeout_s: float) -> ProgramFact:
        began = self._clock.mono()
        hung = self._hung.get(tuple(argv))
        if hung is not None and hung.poll() is None:
            raise CannotTell(f"{argv[0]} of an earlier run was killed and has not ended")
        program = self._started(argv)
        try:
            output, errors, ended = self._read(program, until)
        finally:
            with self._lock:
                self._running.discard(program.pid)
            if not process_group.end(program):
                self._hung[tuple(argv)] = program
            for stream in (program.stdout, program.stderr):
                if stream is not None:
                    stream.close()
        if not ended:
            raise CannotTell(f"{argv[0]} did not end within {timeout_s:g} s and was killed")
        code = program.returncode
        if code < 0:
            raise CannotTell(f"{argv[0]} was ended by signal {-code}")
        return ProgramFact(code, _text(output or errors), self._clock.mono() - began)

    def _started(self, argv: Sequence[str]) -> subprocess.Popen[bytes]:
        if self._closed:
            raise CannotTell("PHM is stopping")
        try:
            program = subprocess.Popen(
                list(argv),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=ENVIRONMENT,
                cwd="/",
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise CannotTell(f"{argv[0]} cannot be started: {reason}") from error
        with self._lock:
            self._running.add(program.pid)
            if self._closed:  # meanwhile
                process_group.kill(program.pid)
        return program

    def _read(self, program: subprocess.Popen[bytes], until: float) -> tuple[bytes, bytes, bool]:
        """The beginning of its output and errors, and whether it ended in time."""
        kept = {program.stdout: bytearray(), program.stderr: bytearray()}
        with selectors.DefaultSelector() as selector:
            for stream in kept:
                assert stream is not None
                selector.register(stream, selectors.EVENT_READ)
            while (left_s := until - self._clock.mono()) > 0:
                ended = _has_ended(program.pid)
                ready = selector.select(0 if ended else min(left_s, _ENDED_S)) if selector.get_map() else []
                for key, _ in ready:
                    data = os.read(key.fd, 65536)
                    if not data:
                        selector.unregister(key.fileobj)
                    buffer = kept[key.fileobj]  # type: ignore[index]  # the streams registered above
                    buffer += data[: OUTPUT_BYTES - len(buffer)]
                if ended and not ready:
                    return bytes(kept[program.stdout]), bytes(kept[program.stderr]), True
                if not selector.get_map() and not ended:
                    self._clock.wait(threading.Event(), min(left_s, 0.01))
        return b"", b"", False


def _has_ended(pid: int) -> bool:
    """Without reaping it: until then its process group keeps its number."""
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _beginning(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4096)


def _text(output: bytes) -> str:
    return output.decode("utf-8", "replace")
