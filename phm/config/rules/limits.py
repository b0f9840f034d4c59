"""Pairs of limits in order, and unique disks."""

from __future__ import annotations

from phm.config.node import ConfigNode
from phm.config.rules.common import in_order, report_duplicates, same_path
from phm.core.settings import Celsius, Hertz, HostSettings, Percent, RecoverySettings, Seconds, TopicSettings

PRESSURE_SHARES = ("throttled", "waiting", "memory", "io", "pids", "host_memory", "host_io")


def limits_are_in_order(root: ConfigNode) -> None:
    places = [("host", key, Percent) for key in ("cpu", "memory", "disk")]
    places += [("pressure", key, Percent) for key in PRESSURE_SHARES]
    for section, key, kind in (*places, ("pressure", "memory_faults", Hertz)):
        limit = root.get(section, key)
        warn, error = limit.get("warn"), limit.get("error")
        if warn.given and error.given:
            in_order(warn, error, kind, (0.0, 0.0))
    host, recovery = HostSettings(), RecoverySettings()
    pair = root.get("host", "temperature_warn"), root.get("host", "temperature_error")
    in_order(*pair, Celsius, (host.temperature_warn, host.temperature_error))
    for topic in root.get("ros", "topics").records():
        if topic.get("error_tolerance").given:
            tolerance = TopicSettings.model_fields["tolerance"].default
            in_order(topic.get("tolerance"), topic.get("error_tolerance"), Percent, (tolerance, tolerance))
    pair = root.get("recovery", "backoff"), root.get("recovery", "backoff_max")
    in_order(*pair, Seconds, (recovery.backoff, recovery.backoff_max))
    in_order(root.get("recovery", "reserve"), root.get("recovery", "budget"), int, (recovery.reserve, recovery.budget))
    in_order(
        root.get("recovery", "hold"), root.get("recovery", "hold_max"), Seconds, (recovery.hold, recovery.hold_max)
    )


def disks_are_unique(root: ConfigNode) -> None:
    """Each disk is in `host.disks` once."""
    report_duplicates("disk", ((same_path(place.text), place) for place in root.get("host", "disks").texts))
