"""The MAVLink endpoints of the configuration: free ports, reachable addresses, serial ports that can be opened."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator

from phm.core.settings import EndpointSettings
from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok
from phm.probes.serial_port_users import users
from phm.transport.own_network import HOST_NAME, is_loopback, is_private, listens_only_inside
from phm.transport.serial_errors import place
from phm.wire import status_file

_ADD_HOST = f'add `extra_hosts: ["{HOST_NAME}:host-gateway"]` to PHM\'s service, or with host networking use 127.0.0.1'


def rows(context: DoctorContext) -> Iterator[Row]:
    endpoints = context.settings.mavlink.endpoints
    if not endpoints:
        yield ok("endpoints", "none configured: nothing is sent to the ground")
    for endpoint in endpoints:
        if endpoint.serial:
            yield _serial(endpoint, context)
        elif endpoint.url.startswith(("udpin", "tcpin")):
            yield _listening(endpoint, context)
        else:
            yield _sending(endpoint)


def _serial(endpoint: EndpointSettings, context: DoctorContext) -> Row:
    path = place(endpoint.url, str(context.dev))
    if not os.path.exists(path):
        remedy = f"connect it; in a container, add `devices: [{path}]` to the compose file"
        return missing(endpoint.key, f"{path} does not exist", remedy)
    if not os.access(path, os.R_OK | os.W_OK):
        remedy = "add the group of the port, which `phm doctor` lists; in a container also `devices` or `device_cgroup_rules`"
        return missing(endpoint.key, f"{path} may not be opened", remedy)
    taken = [user for user in users(path, context.proc) if not _running(context)]
    if taken:
        text = f"{path} is in use by {', '.join(taken)}"
        return limited(endpoint.key, text, "only one program can use a serial port: stop it, or use a MAVLink router")
    return ok(endpoint.key, f"{path} at {endpoint.baud} bit/s")


def _listening(endpoint: EndpointSettings, context: DoctorContext) -> Row:
    scheme, host, port = _parts(endpoint)
    kind = socket.SOCK_DGRAM if scheme == "udpin" else socket.SOCK_STREAM
    if is_private() and listens_only_inside(endpoint.url):
        text = f"{endpoint.url} listens only inside PHM's container"
        return limited(endpoint.key, text, f"write {scheme}:0.0.0.0:{port}")
    few = "; only containers on PHM's networks reach it, unless `ports:` of its Compose file publishes it"
    reach = few if is_private() else ""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family, kind) as probe:
            if kind == socket.SOCK_STREAM:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host.strip("[]"), port))
    except OSError as error:
        if error.errno == errno.EADDRINUSE and _running(context):
            return ok(endpoint.key, f"{endpoint.url}: port in use while PHM is running{reach}")
        remedy = f"find the other program: ss -lntup 'sport = :{port}'; or use another port"
        return missing(endpoint.key, f"{endpoint.url}: {error.strerror or error}", remedy)
    return ok(endpoint.key, f"{endpoint.url}: the port is free{reach}")


def _sending(endpoint: EndpointSettings) -> Row:
    _, host, port = _parts(endpoint)
    try:
        address = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_DGRAM)[0][4][0]
    except OSError as error:
        remedy = _ADD_HOST if host == HOST_NAME else "correct the host in the url"
        return missing(endpoint.key, f"{host} cannot be resolved: {error.strerror or error}", remedy)
    if not is_loopback(endpoint.url):
        return ok(endpoint.key, f"{endpoint.url} resolves to {address}")
    if is_private():
        text = f"{endpoint.url} is the loopback of PHM's own container, where no ground station listens"
        return limited(endpoint.key, text, "use udpout:host.docker.internal:PORT, or the address of the ground station")
    return ok(endpoint.key, f"{endpoint.url}: a program on this machine")


def _parts(endpoint: EndpointSettings) -> tuple[str, str, int]:
    scheme, _, rest = endpoint.url.partition(":")
    host, _, port = rest.rpartition(":")
    return scheme, host, int(port)


def _running(context: DoctorContext) -> bool:
    """Whether a healthy PHM of this configuration has the port."""
    try:
        return not status_file.unhealthy(status_file.read(context.settings.run_dir))
    except status_file.NoStatus:
        return False
