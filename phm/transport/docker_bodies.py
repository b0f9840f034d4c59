"""The bodies and queries of PHM's calls to the Docker Engine, as text.

The client sends exactly these, and the rules of the socket proxy (`phm.proxy`) allow exactly these. Pure.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from requests.models import PreparedRequest

START_EXEC = json.dumps({"Detach": True, "Tty": False})
"""Start a program created by `exec`, without a connection to its streams."""


START_ATTACHED = json.dumps({"Detach": False, "Tty": False})
"""Start a program created by `exec_attached`, and read its output until it ends."""


def exec_attached(argv: Sequence[str]) -> str:
    """Create a program to run in a container, as its user, whose output is read."""
    return json.dumps({"Cmd": list(argv), "AttachStdout": True, "AttachStderr": True})


def logs(since: str, tail: int) -> dict[str, str]:
    """Parameters of reading a container's log. since: seconds of the engine's clock, with nanoseconds after the point."""
    return {"stdout": "1", "stderr": "1", "timestamps": "1", "tail": str(tail), "since": since}


def exec_(argv: Sequence[str], user: str = "") -> str:
    """Create a program to run in a container, as its user unless another is given."""
    return json.dumps({"Cmd": list(argv), "User": user})


def cpu_shares(shares: int) -> str:
    """Change the CPU weight of a container, and nothing else."""
    return json.dumps({"CpuShares": shares})


def disconnect(container: str, *, force: bool) -> str:
    """Disconnect a container from a network."""
    return json.dumps({"Container": container, "Force": force})


def connect(container: str, aliases: Sequence[str] = (), addresses: Sequence[str] = ()) -> str:
    """Connect a container to a network, with aliases and fixed addresses: one of IPv4, one of IPv6, or both in this order."""
    endpoint: dict[str, Any] = {"Aliases": list(aliases)} if aliases else {}
    if addresses:
        endpoint["IPAMConfig"] = {"IPv6Address" if ":" in each else "IPv4Address": each for each in addresses}
    return json.dumps({"Container": container, "EndpointConfig": endpoint})


def filters(wanted: Mapping[str, Sequence[str]]) -> str:
    """The value of the parameter `filters`."""
    return json.dumps({key: list(values) for key, values in wanted.items()})


def upload(folder: str) -> dict[str, str]:
    """Parameters of an upload into `folder` that replaces no folder."""
    return {"path": folder, "noOverwriteDirNonDir": "true"}


def query(params: Mapping[str, str]) -> str:
    """`?name=value&...` as the client encodes it."""
    request = PreparedRequest()
    request.prepare_url("http://engine/", dict(params))
    return request.path_url.removeprefix("/")
