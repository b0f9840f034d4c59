"""The class of a message type for a raw reader: installed beside PHM, created from its name, or from the application.

Runs only in the child. The order is by trust: a class created from the name uses nothing of the application; mounted
packages of the application run their code here and were not tested together with PHM.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from phm.probes.ros.mounted_packages import MountedPackages
from phm.probes.ros.opaque_types import OpaqueTypes, TypeUnavailable
from phm.probes.ros.protocol import INSTALLS

_NAME = re.compile(r"([a-z][a-z0-9_]{0,99})/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]{0,99})")
_any_types = OpaqueTypes()
_mounted: dict[str, Any] = {}
"""Types found in the application's folders, which are searched once: a large topic is subscribed every few seconds."""


class UnknownType(Exception):
    """Messages of this type cannot be read; the text gives each method and why it failed."""


def load_type(name: str, publishers: Iterable[Any] = ()) -> Any:
    """The class of `package/msg/Type`, for raw readers only. Raises UnknownType.

    publishers: rclpy's TopicEndpointInfo of its publishers; a class created from the name announces their type hash.
    """

    def opaque(package: str, kind: str, short: str) -> Any:
        try:
            return _any_types.make(package, kind, short, _announced(name, publishers))
        except TypeUnavailable as reason:
            raise TypeUnavailable(f"it cannot be read by its name alone, as {reason}") from None

    return _load(name, "", [opaque])


def load_decodable(name: str) -> Any:
    """The class of `package/msg/Type` for decoding messages: installed beside PHM, or in `ros.installs`. Raises UnknownType."""
    return _load(name, "its fields cannot be read: ", [])


def _load(name: str, words: str, others: Sequence[Callable[[str, str, str], Any]]) -> Any:
    """Installed beside PHM, else by one of the other ways, and from the application's folders last."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise UnknownType(f"type unknown: {name!r} is not the name of a ROS type")
    mounted = MountedPackages(os.environ.get(INSTALLS, "").split(os.pathsep))
    ways: list[Callable[[str, str, str], Any]]
    ways = [partial(_installed, mounted), *others, partial(_from_application, name, mounted)]
    reasons = []
    for way in ways:
        try:
            return way(*match.groups())
        except TypeUnavailable as reason:
            reasons.append(str(reason))
    raise UnknownType(f"type unknown: {words}{name} {'; '.join(reasons)}")


def _from_application(name: str, mounted: MountedPackages, package: str, kind: str, short: str) -> Any:
    if name not in _mounted:
        _mounted[name] = mounted.load(package, kind, short)
    return _mounted[name]


def _installed(mounted: MountedPackages, package: str, kind: str, short: str) -> Any:
    """Names come from the network: only names with the form of a message package are imported."""
    try:
        spec = importlib.util.find_spec(package)
        folders = (spec.submodule_search_locations if spec else None) or ()
        if any(Path(folder, kind).is_dir() and not mounted.holds(folder) for folder in folders):
            return getattr(importlib.import_module(f"{package}.{kind}"), short)
    except (ImportError, AttributeError, ValueError) as error:
        raise TypeUnavailable(f"is not installed beside PHM ({error})") from error
    raise TypeUnavailable("is not installed beside PHM")


def _announced(name: str, publishers: Iterable[Any]) -> bytes:
    """The type hash that a publisher of this type reports, or empty: before Jazzy there is none."""
    for publisher in publishers:
        reported = getattr(publisher, "topic_type_hash", None)
        if reported is not None and reported.version == 1 and publisher.topic_type == name:
            return bytes(reported.value)
    return b""
