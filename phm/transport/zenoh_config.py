"""Zenoh's own configuration, made of the section `fleet`. Imports nothing of Zenoh until it is asked to make one."""

from __future__ import annotations

import json
import re
from typing import Any

from phm.core.extras import remedy
from phm.core.settings import FleetSettings

RETRY_MS = (500, 4000)
"""Zenoh's first and longest pause between attempts to reconnect to a router."""
_SOURCE_PLACE = re.compile(r"\s+at /\S+?\.rs:\d+\.?")
_MAX_WORDS = 200


def config_options(settings: FleetSettings) -> dict[str, Any]:
    """What differs from Zenoh's defaults, by its path there."""
    tls = settings.tls
    chosen: dict[str, Any] = {
        "mode": settings.mode,
        "connect/endpoints": list(settings.connect),
        # A client tries each endpoint once, and the thread that opened it tries again: with a limit here Zenoh 1.10 would
        # spend all of it on the first. A peer is open immediately and continues to connect in the background.
        "connect/timeout_ms": 0 if settings.mode == "client" else -1,
        "connect/exit_on_failure": settings.mode == "client",
        "connect/retry": {"period_init_ms": RETRY_MS[0], "period_max_ms": RETRY_MS[1]},
        "listen/endpoints": list(settings.listen),
        # Only named endpoints: no multicast scouting, and agents do not connect to one another through gossip of a router,
        # which would be half a million connections in a fleet of 1000.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # Of no use between machines, and each session of a router locks memory for it: with the usual limit of 8 MB for that,
        # a router took 350 sessions and refused the next.
        "transport/shared_memory/enabled": False,
        "transport/unicast/open_timeout": int(settings.deadline * 1000),
        "transport/link/tx/lease": int(settings.lease * 1000),
    }
    files = {
        "root_ca_certificate": tls.ca,
        "connect_certificate": tls.certificate,
        "connect_private_key": tls.key,
        "listen_certificate": tls.certificate if settings.listen else None,
        "listen_private_key": tls.key if settings.listen else None,
    }
    chosen |= {f"transport/link/tls/{name}": path for name, path in files.items() if path is not None}
    chosen["transport/link/tls/verify_name_on_connect"] = tls.verify_name
    chosen["transport/link/tls/enable_mtls"] = tls.certificate is not None
    return chosen


def make_config(settings: FleetSettings) -> Any:
    """A `zenoh.Config`. Raises ImportError without the package, `zenoh.ZError` for what Zenoh does not take."""
    import zenoh

    made = zenoh.Config()
    for path, value in config_options(settings).items():
        made.insert_json5(path, json.dumps(value))
    return made


def error_text(error: BaseException) -> str:
    """The message of an error in one line, without the position in Zenoh's sources."""
    if isinstance(error, ImportError):
        return f"eclipse-zenoh cannot be imported: {remedy('fleet')}"
    said = _SOURCE_PLACE.sub("", str(error)).strip() or type(error).__name__
    said = "".join(char if char.isprintable() else " " for char in said[: 2 * _MAX_WORDS])
    return said if len(said) <= _MAX_WORDS else f"{said[: _MAX_WORDS - 2]}.."
