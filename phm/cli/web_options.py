"""Options of the commands that serve a page: where, and who may use it."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from phm.gcs.web.options import ListenOptions

S = TypeVar("S")
F = TypeVar("F", bound=Callable[..., Any])


_CONNECTION = re.compile(r"(udpin|udpout|udpbcast|tcp|tcpin):|/|COM\d|\w+://")
"""What begins as a URL of `phm gcs`. After `--web`, which needs no value, it would be taken for an address."""


def address(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, int] | None:
    """The address in a text such as ``HOST:PORT`` or ``PORT``."""
    if value is None:
        return None
    if _CONNECTION.match(value):
        if ctx.info_name != "gcs":
            raise click.BadParameter(f"{value!r} is not HOST:PORT, e.g. 192.168.7.1:8014")
        option = param.opts[0]
        raise click.BadParameter(f"{value!r} is a connection: write it before {option}: phm gcs {value} {option} 8080")
    host, _, port = value.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise click.BadParameter(f"{value!r} needs a port from 0 to 65535, e.g. 8014 or 192.168.7.1:8014")
    return host.strip("[]") or "127.0.0.1", int(port)


def web_options(what: str) -> Callable[[F], F]:
    """Add `--web`, `--token-file`, `--tls-cert`, `--tls-key` and `--behind-proxy` to a verb. what: shown by the page, for the help."""
    path = click.Path(dir_okay=False)
    options = [
        click.option(
            "--web",
            metavar="[HOST:]PORT",
            callback=address,
            is_flag=False,
            flag_value="127.0.0.1:8080",
            help=f"Serve a page with {what} at this address; without a value at 127.0.0.1:8080.",
        ),
        click.option(
            "--token-file",
            type=path,
            help="Ask for a token: a file with 'view: TOKEN' and 'operate: TOKEN'. Required unless only this machine can connect.",
        ),
        click.option("--tls-cert", type=path, help="Certificate chain of the page (PEM), with --tls-key."),
        click.option("--tls-key", type=path, help="Private key of the page (PEM), with --tls-cert."),
        click.option("--behind-proxy", is_flag=True, help="A proxy in front of the page terminates TLS."),
    ]

    def add(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def require_aiohttp(option: str) -> None:
    """Raises ClickException without the extra."""
    try:
        import aiohttp  # noqa: F401
    except ImportError:
        from phm.core.extras import remedy

        raise click.ClickException(f"{option} needs aiohttp: {remedy('web')} (docs/reference/web.md)") from None


def listen_options(
    where: tuple[str, int],
    token_file: str | None,
    tls_cert: str | None,
    tls_key: str | None,
    *,
    behind_proxy: bool,
    stream: bool = False,
) -> ListenOptions:
    """stream: it is for `--serve`, where no client can change anything: without a token, any address is allowed. Raises
    ClickException."""
    from phm.gcs.web.options import ListenOptions, OptionError, read_tokens, tls_context

    try:
        tokens = read_tokens(token_file) if token_file else None
        options = ListenOptions(*where, tokens, tls_context(tls_cert, tls_key), behind_proxy)
        return options if stream and tokens is None and not behind_proxy else options.check()
    except OptionError as error:
        raise click.ClickException(str(error)) from None


def listening(option: str, where: tuple[str, int], make: Callable[[], S]) -> S:
    """The server that `make` creates. Raises ClickException when the address cannot be used."""
    try:
        return make()
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while ")[0]
        remedy = (
            f": another program listens there, choose another port with {option}"
            if error.errno == errno.EADDRINUSE
            else ""
        )
        raise click.ClickException(f"{option} {where[0]}:{where[1]}: {reason}{remedy}") from None
