"""`phm run`: the daemon."""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

import click

from phm.cli.options import config_option, load_settings, loops_are_configuration_errors

if TYPE_CHECKING:
    from phm.core.settings import Settings


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
def command(config: str | None) -> None:
    """Run the daemon until SIGTERM.

    Reads the configuration, then checks, recovers and reports until SIGTERM or SIGINT; SIGHUP reloads it, as `phm reload`
    does. A bad configuration ends it with exit code 78 before anything is opened, another PHM with the same state_dir
    or run_dir with 75.
    """
    with uncollected():
        settings = load_settings(config)
        logging.basicConfig(level=logging.WARNING, format="phm: %(levelname)s: %(name)s: %(message)s")
        from phm.core.instance_lock import AlreadyRunning
        from phm.runtime import service

    try:
        with loops_are_configuration_errors():
            code = service.run(settings, lambda: _read_again(config))
    except AlreadyRunning as error:
        click.echo(f"phm run: {error}", err=True)
        code = os.EX_TEMPFAIL
    leave(code)


def _read_again(config: str | None) -> Settings:
    from phm.cli.reading import read

    return read(config).settings


def leave(code: int) -> NoReturn:
    """End the process without the interpreter's own finalization: all is closed or given up, and a thread that is still
    inside a library (Zenoh closing a session on a busy machine) would abort the process there with SIGABRT."""
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
