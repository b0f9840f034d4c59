"""`phm run`: the daemon."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import click

from phm.cli.options import config_option, load_settings, loops_are_configuration_errors


@contextmanager
def uncollected() -> Iterator[None]:
    """What is made inside stays to the end: looking for garbage among it would be a tenth of the start, and again later."""
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        gc.enable()


@click.command(epilog="Example: phm run -c /etc/phm/phm.yaml")
@config_option
@click.pass_context
def command(ctx: click.Context, config: str | None) -> None:
    """Run the daemon until SIGTERM.

    Reads the configuration, then checks, heals and tells until SIGTERM or SIGINT. A bad configuration ends
    it with exit code 78 before anything is opened.
    """
    with uncollected():
        settings = load_settings(config)
        import logging

        logging.basicConfig(level=logging.WARNING, format="phm: %(levelname)s: %(name)s: %(message)s")
        from phm import daemon

    with loops_are_configuration_errors():
        code = daemon.run(settings)
    ctx.exit(code)
