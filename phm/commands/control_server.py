"""The daemon's side of the control socket (`phm.wire.control`): approvals, notes, holds and reloads from this machine.

One thread. It imports an event loop for the first client alone (`phm.commands.control_clients`): a flight without a request saves
1.3 MB of memory. The socket belongs to PHM's user alone (mode 0600).
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from phm.commands.requests import OperatorRequest, Reply
from phm.core import polling, threads
from phm.wire.command import CommandResult
from phm.wire.control import NAME, address

if TYPE_CHECKING:
    from phm.commands.control_clients import ControlClients

BACKLOG = 16
"""With a full backlog, the kernel refuses further clients."""
RETRY_S = 5.0
CLOSING_S = 2.0

Execute = Callable[[OperatorRequest, str], Reply]
"""Executes a request of an operator (`phm.commands.handler.CommandHandler.execute`). Never raises."""


def _not_ready(request: OperatorRequest, by: str) -> Reply:
    return Reply(CommandResult.TEMPORARILY_REJECTED, "PHM is starting")


class ControlServer:
    """Serves `run_dir/control.sock` until closed. Requests are executed one at a time."""

    def __init__(self, run_dir: str, execute: Execute = _not_ready) -> None:
        self._run_dir = run_dir
        self.execute = execute
        """Replaced when the configuration is reloaded."""
        self._inode = 0
        self._problem = ""
        self._bell = polling.Bell()
        self._closing = threading.Event()
        self._clients: ControlClients | None = None
        self._thread = threading.Thread(target=self._run, name="phm-control", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def pause(self) -> None:
        """Refuse requests until `execute` is replaced: what they changed would be lost."""
        self.execute = _not_ready

    def problem(self) -> str:
        return self._problem

    def close(self) -> None:
        """End the thread and remove the socket; waits at most CLOSING_S."""
        self._closing.set()
        self._bell.ring()
        if (clients := self._clients) is not None:
            clients.close()
        threads.join(self._thread, CLOSING_S)
        path = os.path.join(self._run_dir, NAME)
        with contextlib.suppress(OSError):
            if os.stat(path).st_ino == self._inode:
                os.unlink(path)

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        while (listener := self._listen()) is None:
            if self._closing.wait(RETRY_S):
                return
        with listener:
            while not self._closing.is_set() and listener.fileno() >= 0:
                polling.wait([(listener.fileno(), polling.READ), (self._bell.fd, polling.READ)], None)
                try:
                    self._serve(listener)
                except Exception as error:
                    # Such as too many open files. The client waits: holds and approvals must be possible later.
                    self._problem = f"clients of {NAME} cannot be served: {error}; `phm approve` does not work"
                    self._closing.wait(RETRY_S)

    def _serve(self, listener: socket.socket) -> None:
        """Until `close`, which also closes the listener."""
        if self._closing.is_set():
            return
        from phm.commands.control_clients import ControlClients

        self._clients = ControlClients(self._execute)
        self._problem = ""
        self._clients.serve(listener, self._closing)

    def _execute(self, request: OperatorRequest, by: str) -> Reply:
        return self.execute(request, by)

    def _listen(self) -> socket.socket | None:
        try:
            listener = self._bound()
        except OSError as error:
            self._problem = f"cannot create {os.path.join(self._run_dir, NAME)}: {error.strerror or error}; `phm approve` does not work"
            return None
        self._problem = ""
        return listener

    def _bound(self) -> socket.socket:
        """Bind under another name, restrict its mode, and only then rename it: it is never open to other users."""
        name = f"{NAME}.{os.getpid()}"
        with contextlib.ExitStack() as failed:
            listener = failed.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            os.makedirs(self._run_dir, exist_ok=True)
            with address(self._run_dir, name) as path:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(path)
                listener.bind(path)
                os.chmod(path, 0o600)
                listener.listen(BACKLOG)
                self._inode = os.stat(path).st_ino
                os.replace(path, os.path.join(os.path.dirname(path), NAME))
            failed.pop_all()
        return listener
