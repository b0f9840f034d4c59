"""The ROS settings of PHM's container: the application's own variables and Fast DDS profile, so that PHM finds its nodes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from phm.setup.discovery import PROFILE_VARIABLES, ROS_VARIABLES
from phm.setup.machine import Application

FOLDER = "/etc/phm"
"""Where PHM's container sees the written folder."""
APPLICATION_PROFILE = "application-fastdds.xml"
_PLAIN = re.compile(r"[A-Za-z0-9_./:;,@=+-]*")
_COPIED = tuple(name for name in ROS_VARIABLES if name not in (*PROFILE_VARIABLES, "ROS_DISTRO"))


@dataclass(frozen=True, slots=True)
class RosSettings:
    """lines:   of agent.env.
    profile: a copy of the application's Fast DDS profile, to be written as APPLICATION_PROFILE; empty for none.
    mount:   where that file is mounted; empty where it is seen in FOLDER.
    """

    lines: str
    profile: str = ""
    mount: str = ""


def ros_settings(watched: Sequence[Application], shipped_profile: str) -> RosSettings:
    """shipped_profile: PHM's own for applications, which only shortens leases, so that PHM itself does not need it."""
    one = source(watched)
    if one is None:
        return RosSettings("# ROS 2: the values of your application.\nROS_DOMAIN_ID=0")
    lines = [f"# ROS 2: as in container {one.name}; PHM must use the same."]
    if "ROS_DOMAIN_ID" not in one.environment:
        lines.append("ROS_DOMAIN_ID=0")
    lines += [f"{name}={_value(one.environment[name])}" for name in _COPIED if name in one.environment]
    others = [each.name for each in watched if each is not one and _differs(each, one)]
    if others:
        lines.append(f"# Other values are set in {', '.join(others)}: PHM does not see the nodes there.")
    if not one.profile or one.profile.strip() == shipped_profile.strip():
        return RosSettings("\n".join(lines))
    path = next(one.environment[name] for name in PROFILE_VARIABLES if name in one.environment)
    mounted = not path.startswith(f"{FOLDER}/") and _PLAIN.fullmatch(path) is not None and ":" not in path
    seen = path if mounted else f"{FOLDER}/{APPLICATION_PROFILE}"
    lines += [
        f"# {APPLICATION_PROFILE}, a copy of the application's profile.",
        *(f"{n}={seen}" for n in PROFILE_VARIABLES),
    ]
    return RosSettings("\n".join(lines), one.profile, path if mounted else "")


def source(watched: Sequence[Application]) -> Application | None:
    """The application with the most ROS variables; the first of several; None without containers."""
    return max(watched, key=lambda one: len(one.environment), default=None)


def _differs(one: Application, other: Application) -> bool:
    """Whether a container with ROS variables has others; one without any is most likely not a ROS application."""
    return bool(one.environment) and any(one.environment.get(name) != other.environment.get(name) for name in _COPIED)


def _value(text: str) -> str:
    """As Compose reads it from an env file: in single quotes nothing is expanded."""
    if _PLAIN.fullmatch(text):
        return text
    clean = "".join(char for char in text if char.isprintable() and char != "'")
    return f"'{clean}'"
