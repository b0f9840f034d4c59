"""The control socket, by which the command line sends requests to the running daemon. One JSON object a line, each way.

Requests are ``{"do": "ping"}``, ``{"do": "reload"}``, ``{"do": "approve", "fault": ID}``,
``{"do": "note", "text": TEXT}``, ``{"do": "hold", "container": KEY, "for_s": SECONDS or null, "reason": TEXT}``
and ``{"do": "release", "container": KEY}``, where an empty KEY means all containers; answers are
``{"ok": true, "text": ...}`` or ``{"ok": false, "error": ...}``. Standard library only.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from typing import Any

NAME = "control.sock"
MAX_REQUEST = 4096
"""Bytes of one request, with the newline."""
MAX_ANSWER = 65536
DEADLINE_S = 5.0


class NoAnswer(Exception):
    """The daemon did not answer; the message says why and what to do."""


class Refused(Exception):
    """The daemon refused the request; the message is its reason."""


@contextlib.contextmanager
def address(directory: str, name: str = NAME) -> Iterator[str]:
    """The socket's address, short however long the directory's name is (the kernel allows 107 bytes). Raises OSError."""
    folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{name}"
    finally:
        os.close(folder)


def ask(run_dir: str, request: dict[str, Any], timeout_s: float | None = None) -> str:
    """The daemon's answer as a sentence, within DEADLINE_S if no other time is given. Raises NoAnswer and Refused."""
    return str(ask_all(run_dir, request, timeout_s).get("text"))


def ask_all(run_dir: str, request: dict[str, Any], timeout_s: float | None = None) -> dict[str, Any]:
    """The daemon's complete answer, `text` and data. As `ask`."""
    where = os.path.join(run_dir, NAME)
    try:
        with address(run_dir) as path, socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stream:
            stream.settimeout(DEADLINE_S if timeout_s is None else timeout_s)
            stream.connect(path)
            with contextlib.suppress(
                ConnectionError
            ):  # refused before the request was read: the reason can still be read
                stream.sendall(json.dumps(request).encode("ascii") + b"\n")
            answer = _line(stream)
    except FileNotFoundError:
        raise NoAnswer(
            f"{where} does not exist: PHM is not running, or uses another run_dir (see --run-dir); in a container: "
            "`docker compose exec phm phm status`"
        ) from None
    except PermissionError:
        raise NoAnswer(f"permission denied for {where}: run this as root or as PHM's own user") from None
    except OSError as error:
        raise NoAnswer(f"PHM does not answer at {where}: {error.strerror or error}") from None
    if not isinstance(answer, dict) or not isinstance(answer.get("ok"), bool):
        raise NoAnswer(f"the process that answers at {where} is not PHM")
    if not answer["ok"]:
        raise Refused(str(answer.get("error")))
    return answer


def _line(stream: socket.socket) -> Any:
    data = b""
    while b"\n" not in data and len(data) <= MAX_ANSWER:
        chunk = stream.recv(4096)
        if not chunk:
            break
        data += chunk
    try:
        return json.loads(data.partition(b"\n")[0])
    except (ValueError, RecursionError):
        return None
