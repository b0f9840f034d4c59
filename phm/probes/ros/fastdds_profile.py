"""How the ROS child's own participant discovers others: variables and a Fast DDS profile, set before rclpy is loaded.

With the discovery range LOCALHOST, rmw_fastrtps selects shared memory whatever FASTDDS_BUILTIN_TRANSPORTS says. Two
containers on the host's network share no /dev/shm: each takes the other for local and its data is lost. So the child
builds the same discovery (unicast to 127.0.0.1, no multicast) over UDP alone, which every LOCALHOST node also has.
"""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from phm.probes.ros.sandbox import OWN_PROFILE, PROFILE_VARIABLES

FOLDERS = (Path("/dev/shm"), Path("/tmp"))  # noqa: S108 (the names of the files are random)
"""Where the profile is written; the sandbox lets the child remove it from the first one alone."""
MAX_PEERS = 32
"""How many processes of a host are looked for by unicast: the number of rmw_fastrtps for LOCALHOST; 4 is Fast DDS's own."""
_PEER = "<locator><udpv4><address>{}</address></udpv4></locator>"
_PEERS = """
<initialPeersList>{}</initialPeersList>
<metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>"""
"""A list of unicast addresses to listen on replaces Fast DDS's own, which has a multicast address."""
_TRANSPORT = f"""<transport_descriptors><transport_descriptor>
<transport_id>udp</transport_id><type>UDPv4</type><maxInitialPeersRange>{MAX_PEERS}</maxInitialPeersRange>
</transport_descriptor></transport_descriptors>
"""
_USE_TRANSPORT = """
<userTransports><transport_id>udp</transport_id></userTransports><useBuiltinTransports>false</useBuiltinTransports>"""
LEASE_S = 20
"""How long other participants keep PHM's after its last announcement: Fast DDS's own. A node with a longer lease than PHM's that is
stopped for a time between both drops PHM while PHM keeps the node, and sends PHM nothing any more (`unreceived_nodes`). A node with a
shorter lease, as in config/fastdds.xml, keeps PHM while PHM drops it; then PHM lacks its names and looks again with a new participant
(`unnamed_participants`). Nodes keep the readers of a killed child for so long. These are best effort, but for latched topics, and
block no publisher that keeps a limited number of messages. Measured with Jazzy on 2026-11-28: beside a node with a lease of 1 s, a child
that was stopped for 12 s needed a new participant in one of two runs with 5 s, in none of two with 20 s. For a node that was stopped
for 8 s, both were equal."""
PEERS_MOST_S = 3
"""Seconds between two announcements: one for each static peer, so that all together get MAX_PEERS packets a second over a radio, but at
most as many as Fast DDS itself waits. More peers get more packets."""
_OFTEN = "<leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>"
_TO_PEERS = """<leaseAnnouncement><sec>{}</sec><nanosec>0</nanosec></leaseAnnouncement>
<initialAnnouncements><count>20</count><period><sec>0</sec><nanosec>250000000</nanosec></period></initialAnnouncements>"""
_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles>
{transport}<participant profile_name="phm" is_default_profile="true"><rtps>{use}<builtin><discovery_config>
<leaseDuration><sec>{lease_s}</sec></leaseDuration>
{announcements}
</discovery_config>{peers}</builtin></rtps></participant>
</profiles></dds>
"""


def adapt(environ: MutableMapping[str, str]) -> None:
    """Set what the child needs in `environ`. A profile of the user's own wins. Where no file can be written, there is none.

    Raises OSError: a static peer cannot be resolved, as rmw_fastrtps does.
    """
    environ.pop(OWN_PROFILE, None)
    if environ.get("ROS_DISCOVERY_SERVER"):
        # An ordinary client learns only of the endpoints that match its own.
        environ.setdefault("ROS_SUPER_CLIENT", "TRUE")
    if any(environ.get(name) for name in PROFILE_VARIABLES):
        return
    before = dict(environ)
    text = profile(environ)
    try:
        path = _write(text)
    except OSError:
        environ.clear()
        environ.update(before)
        return
    environ.update(dict.fromkeys((*PROFILE_VARIABLES, OWN_PROFILE), path))


def remove(environ: MutableMapping[str, str]) -> None:
    """Remove the file that `adapt` has written."""
    with contextlib.suppress(OSError, KeyError):
        os.unlink(environ[OWN_PROFILE])


def _write(text: str) -> str:
    """The path of a new file. Not a file in memory: Fast DDS resolves the path first, and that of /proc/self/fd/N leads nowhere."""
    for folder in FOLDERS:
        with contextlib.suppress(OSError):
            _remove_left(folder)
            file, name = tempfile.mkstemp(".xml", f"{_prefix()}{os.getpid()}-", folder)
            with open(file, "w", encoding="utf-8") as opened:
                opened.write(text)
            return name
    raise OSError(f"no file can be written in {' or '.join(map(str, FOLDERS))}")


def _remove_left(folder: Path) -> None:
    """Remove files of children that were killed."""
    for path in folder.glob(f"{_prefix()}*"):
        pid = path.name.removeprefix(_prefix()).partition("-")[0]
        if not Path("/proc", pid).exists():
            with contextlib.suppress(OSError):
                path.unlink()


def _prefix() -> str:
    """Process ids are of this PID namespace; /dev/shm may be shared with others."""
    return f"phm-fastdds-{os.stat('/proc/self/ns/pid').st_ino}-"


def profile(environ: MutableMapping[str, str]) -> str:
    """The profile; changes the discovery range in `environ` where the profile does it instead.

    The participant announces itself four times a second instead of once in three seconds. A node that starts (or was restarted) is
    seen once it has received that: measured 0.5 s instead of up to 4 s. With static peers it does so for its first 5 s only.
    """
    peers = _static_peers(environ)
    announcements = _TO_PEERS.format(min(PEERS_MOST_S, len(peers))) if peers else _OFTEN
    transport = use = listed = ""
    if environ.get("FASTDDS_BUILTIN_TRANSPORTS") == "UDPv4" and (peers or localhost(environ)):
        transport, use = _TRANSPORT, _USE_TRANSPORT
        if localhost(environ):
            addresses = ["127.0.0.1", *map(socket.gethostbyname, peers)]
            listed = _PEERS.format("".join(map(_PEER.format, addresses)))
            # For SUBNET, rmw_fastrtps would add a multicast address; for this it changes nothing and adds no peers.
            environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
            environ.pop("ROS_STATIC_PEERS", None)
            environ.pop("ROS_LOCALHOST_ONLY", None)
    return _PROFILE.format(transport=transport, use=use, lease_s=LEASE_S, announcements=announcements, peers=listed)


def _static_peers(environ: Mapping[str, str]) -> list[str]:
    """Those of ROS_STATIC_PEERS, which ROS_LOCALHOST_ONLY=1 switches off as in rcl."""
    names = "" if environ.get("ROS_LOCALHOST_ONLY") == "1" else environ.get("ROS_STATIC_PEERS", "")
    return [name for name in names.split(";") if name]


def localhost(environ: MutableMapping[str, str]) -> bool:
    """Whether the discovery range is LOCALHOST."""
    only = environ.get("ROS_LOCALHOST_ONLY") == "1"
    return only or environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
