"""The page and the stream of `phm gcs`: `--web` and `--serve`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import click

from phm.cli.web_options import listen_options, listening, require_aiohttp

if TYPE_CHECKING:
    from phm.core.clock import Clock
    from phm.gcs.station import GroundStation
    from phm.gcs.web.config_delivery import DeliveryTarget


class GroundPart(Protocol):
    """A part of `phm gcs` with a separate thread. about: a note for the operator, empty for none."""

    def start(self) -> None: ...
    def close(self) -> None: ...
    def about(self) -> str: ...


@dataclass(frozen=True)
class WebChoice:
    """The options as given. history: a path, `none`, or None for the default. edit: files that the page may write. deliver: file, address and key."""

    web: tuple[str, int] | None
    serve: tuple[str, int] | None
    token_file: str | None
    tls_cert: str | None
    tls_key: str | None
    behind_proxy: bool
    history: str | None
    edit: tuple[str, ...] = ()
    deliver: tuple[tuple[str, str, str], ...] = ()

    def history_path(self) -> Path | None:
        """None: the history ends with the program."""
        from phm.gcs.web.history.locations import default_path

        if self.history == "none":
            return None
        return default_path() if self.history is None else Path(self.history)

    def check(self) -> None:
        """Raises UsageError and ClickException."""
        needs = {
            "--token-file": self.token_file,
            "--tls-cert": self.tls_cert,
            "--tls-key": self.tls_key,
            "--behind-proxy": self.behind_proxy,
        }
        given = [option for option, value in needs.items() if value]
        if given and self.web is None and self.serve is None:
            raise click.UsageError(f"{given[0]} needs --web or --serve.")
        if self.edit and self.web is None:
            raise click.UsageError("--edit needs --web.")
        files = [file for file, _, _ in self.deliver]
        for file in files:
            if file not in self.edit:
                raise click.UsageError(f"--deliver needs a file of --edit: add --edit {file}.")
            if files.count(file) > 1:
                raise click.UsageError(f"--deliver names {file} twice: each file belongs to one agent.")
        if self.deliver and self.token_file is None:
            raise click.UsageError(
                "--deliver needs --token-file FILE: without it, every user of this computer could run programs on the agents."
            )
        if self.history is not None and self.web is None:
            raise click.UsageError("--history needs --web.")
        for option, wanted in (("--web", self.web), ("--serve", self.serve)):
            if wanted is not None:
                require_aiohttp(option)


def make_parts(choice: WebChoice, station: GroundStation, clock: Clock) -> list[GroundPart]:
    """The servers that are wanted, not yet started. Raises ClickException."""
    found: list[GroundPart] = []
    if choice.serve is not None:
        found.append(_stream(choice, choice.serve, station, clock))
    if choice.web is not None:
        found.append(_page(choice, choice.web, station, clock))
    return found


def show_record(record: str, speed: float, choice: WebChoice, wait: Callable[[], object]) -> None:
    """Serve the page of a record until `wait` returns. Raises UsageError and ClickException."""
    if choice.web is None:
        raise click.UsageError("--replay needs --web: the record is shown on the page.")
    if choice.serve is not None or choice.history is not None:
        raise click.UsageError("--replay shows a record: it cannot be used with --serve and --history.")
    choice.check()
    from phm.core.clock import SystemClock
    from phm.gcs.web.replay.page import ReplayPage
    from phm.gcs.web.replay.record import RecordError, load

    options = listen_options(
        choice.web, choice.token_file, choice.tls_cert, choice.tls_key, behind_proxy=choice.behind_proxy
    )
    try:
        found = load(record)
    except RecordError as error:
        raise click.ClickException(f"--replay {error}") from None
    page = listening("--web", choice.web, lambda: ReplayPage(found, options, SystemClock(), speed))
    click.echo(f"serving {page.url}: replay of {record}, {found.end:.0f} s", err=True)
    try:
        page.start()
        wait()
    finally:
        page.close()


def _stream(choice: WebChoice, where: tuple[str, int], station: GroundStation, clock: Clock) -> GroundPart:
    from phm.gcs.web import stream

    options = listen_options(
        where, choice.token_file, choice.tls_cert, choice.tls_key, behind_proxy=choice.behind_proxy, stream=True
    )
    server = listening("--serve", where, lambda: stream.serve(station, options, clock))
    click.echo(f"serving events at {server.address[0]}:{server.address[1]}", err=True)
    return server


def _page(choice: WebChoice, where: tuple[str, int], station: GroundStation, clock: Clock) -> GroundPart:
    from phm.gcs.web.config_delivery import ConfigDelivery
    from phm.gcs.web.config_editor import ConfigEditor
    from phm.gcs.web.page import GroundPage
    from phm.gcs.web.routes import checks
    from phm.runtime.configuration import plan_of

    options = listen_options(
        where, choice.token_file, choice.tls_cert, choice.tls_key, behind_proxy=choice.behind_proxy
    )
    extra = {
        checks.EXTRA: ConfigEditor(plan_of, choice.edit),
        checks.DELIVERY: ConfigDelivery({file: _target(place, key) for file, place, key in choice.deliver}),
    }
    page = listening("--web", where, lambda: GroundPage(station, options, clock, choice.history_path(), extra))
    click.echo(f"page at {page.url}", err=True)
    return page


def _target(place: str, key: str) -> DeliveryTarget:
    """The target of `--deliver`. Raises ClickException."""
    from phm.gcs.web.config_delivery import DeliveryTarget
    from phm.transport.mavlink_signing import InvalidKey, read_key

    host, _, port = place.rpartition(":")
    if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
        raise click.UsageError(f"--deliver {place}: write the agent's delivery.listen as HOST:PORT, e.g. 10.0.0.7:9465")
    try:
        return DeliveryTarget(host.strip("[]"), int(port), read_key(key, "--deliver"))
    except InvalidKey as error:
        raise click.ClickException(str(error)) from None
