"""Options that `phm gcs` and its requests have in common, and the station that they make."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import click

from phm.core import threads

if TYPE_CHECKING:
    from phm.cli.gcs_web import GroundPart
    from phm.core.clock import Clock
    from phm.core.settings import MavlinkSettings
    from phm.gcs.station import GroundStation

DEFAULT_URL = "udpin:0.0.0.0:14551"
IDS = (251, 254)
"""Above the agents' ids (up to 250) and below 255, the pilot's ground station."""
OPEN_S = 2.0

F = TypeVar("F", bound=Callable[..., Any])


def link_options(default_id: int) -> Callable[[F], F]:
    """How to reach the agents: `baud`, `system`, `key`, `unsigned`."""
    options = [
        click.option(
            "--baud",
            type=click.IntRange(1200, 4_000_000),
            default=57600,
            show_default=True,
            help="Bits per second of a serial port.",
        ),
        click.option(
            "--id",
            "system",
            type=click.IntRange(*IDS),
            default=default_id,
            show_default=True,
            help="MAVLink system id. 255 is reserved for the pilot's ground station, which autopilot failsafes watch.",
        ),
        click.option(
            "--key",
            type=click.Path(exists=True, dir_okay=False),
            help="File with the MAVLink signing key of the agents.",
        ),
        click.option(
            "--unsigned",
            type=click.Choice(["vehicle", "all", "none"]),
            default="vehicle",
            show_default=True,
            help="With --key: which unsigned messages to accept.",
        ),
    ]

    def add(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def link_settings(urls: tuple[str, ...], baud: int, key: str | None, unsigned: str) -> MavlinkSettings:
    """The MAVLink settings of the options. Raises UsageError."""
    from pydantic import ValidationError

    from phm.core.settings import MavlinkSettings, SigningSettings
    from phm.gcs.station import COMPONENT

    urls = urls or (DEFAULT_URL,)
    if len(set(urls)) < len(urls):
        raise click.UsageError("A URL is given twice: remove one.")
    endpoints = [{"url": url, "baud": baud, "budget": 0} for url in urls]
    # Not validated: an absolute path of Windows does not begin with a slash.
    signing = SigningSettings.model_construct(key=os.path.abspath(key) if key else None, unsigned=unsigned)
    try:
        return MavlinkSettings.model_validate({"endpoints": endpoints, "component_id": COMPONENT, "signing": signing})
    except ValidationError as error:
        raise click.UsageError(
            "; ".join(entry["msg"].removeprefix("Value error, ") for entry in error.errors())
        ) from None


def make_station(
    settings: MavlinkSettings,
    system: int,
    clock: Clock,
    expect: tuple[int, ...] = (),
    *,
    silent: bool = False,
    pilot: bool = False,
) -> GroundStation:
    """The ground station of the options. Raises UsageError."""
    from phm.gcs.station import GroundStation
    from phm.transport.mavlink_signing import InvalidKey

    try:
        return GroundStation(settings, system, clock, expect, silent=silent, pilot=pilot)
    except InvalidKey as problem:
        raise click.UsageError(str(problem).replace("mavlink.signing.key:", "--key:")) from None


def _check_ports(station: GroundStation) -> None:
    """Exits when a port to listen on is in use."""
    taken = station.taken(OPEN_S)
    if taken:
        raise click.ClickException(
            f"{taken}: another program listens there, or the address is not this machine's. Choose another port, and "
            "have the router or MAVProxy forward to it, too (docs/reference/gcs.md)"
        )


@contextmanager
def running(station: GroundStation, parts: Sequence[GroundPart] = ()) -> Iterator[None]:
    """Starts and closes the station and what shows or records it. Exits when a thread or a port is missing."""
    for part in parts:
        part.start()
    station.start()
    try:
        if missing := threads.problem():
            raise click.ClickException(missing)
        _check_ports(station)
        yield
    finally:
        station.close()
        for part in parts:
            part.close()
