"""The user and groups of this process, beside the groups that own the engine's socket and the serial ports."""

from __future__ import annotations

import grp
import os
import pwd
from collections.abc import Iterator

from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok
from phm.setup.discovery import serial_ports

_NO_GROUP = "run it with sudo, or create the group: `sudo groupadd docker`, and restart Docker"
"""For a socket of the group of root, which Docker makes where the group docker does not exist."""


def rows(context: DoctorContext) -> Iterator[Row]:
    own = sorted({os.getegid(), *os.getgroups()})
    yield ok("user", f"uid {os.geteuid()}, groups {', '.join(map(group_name, own))}")
    yield from _socket(context)
    owners = {port.group_id: port.path for port in serial_ports(context.dev, context.endpoint_ports)}
    for number, path in owners.items():
        if os.geteuid() == 0 or number in own:
            yield ok(f"group {group_name(number)}", f"owner of {path}: PHM is a member")
        else:
            text = f"owner of {path}: PHM is not a member, so it cannot open this serial port"
            yield limited(f"group {group_name(number)}", text, _join(number, context))


def _socket(context: DoctorContext) -> Iterator[Row]:
    url = context.settings.docker.socket
    if not url.startswith("unix://"):
        yield ok("socket", f"{url} is reached over the network")
        return
    path = url.removeprefix("unix://")
    try:
        owner = os.stat(path).st_gid
    except OSError as error:
        remedy = "start the Docker Engine, or mount its socket into PHM's container"
        yield missing("socket", f"{path}: {error.strerror}", remedy)
        return
    if os.access(path, os.R_OK | os.W_OK):
        yield ok("socket", f"{path} belongs to group {group_name(owner)}: PHM may open it")
    else:
        text = f"{path} belongs to group {group_name(owner)}: PHM may not open it"
        yield missing("socket", text, _join(owner, context) if owner or context.in_container else _NO_GROUP)


def _join(number: int, context: DoctorContext) -> str:
    if context.in_container:
        return f'add "{number}" to group_add in the compose file'
    return f"sudo usermod -aG {group_name(number)} {_user()}, and log in again"


def _user() -> str:
    """Of this process, which may be another one than that of the shell, as with `sudo -u phm`."""
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def group_name(number: int) -> str:
    """The name of a group, or its number where it has none here, as in a container."""
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)
