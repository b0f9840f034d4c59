"""Runs in .venv-interop: like `mavsdk_watch.py`, but with the gRPC client, which starts its own `mavsdk_server`."""

from __future__ import annotations

import asyncio
import json
import socket
import sys
from typing import Any

from mavsdk_grpc import System


def emit(kind: str, **more: Any) -> None:
    sys.stdout.write(json.dumps({"kind": kind, **more}) + "\n")
    sys.stdout.flush()


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


async def texts(system: System) -> None:
    async for text in system.telemetry.status_text():
        emit("text", severity=text.type.name, text=text.text)


async def armed(system: System) -> None:
    async for value in system.telemetry.armed():
        emit("armed", value=value)


async def connected(system: System) -> None:
    async for state in system.core.connection_state():
        emit("connected", value=state.is_connected)


async def main(url: str) -> None:
    system = System(port=free_port())
    await system.connect(system_address=url)
    emit("ready")
    await asyncio.gather(texts(system), armed(system), connected(system))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
