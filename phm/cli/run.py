"""`phm run`: the daemon."""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import click

from phm.cli.options import config_option, load_configuration, unusable_keys_are_configuration_errors


@contextmanager
def uncollected() -> Iterator[None]:
    """Without garbage collection: what is created inside lives until the end, and scanning it takes a tenth of the start time."""
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

    Checks, reports and recovers until SIGTERM or SIGINT. SIGHUP reloads the configuration, as `phm reload` does.
    Exit code 0; 78: the configuration is invalid (nothing was opened); 75: another PHM uses the same state_dir or run_dir.
    """
    with uncollected():
        configuration = load_configuration(config)
        logging.basicConfig(level=logging.WARNING, format="phm: %(levelname)s: %(name)s: %(message)s")
        from phm.core.instance_lock import AlreadyRunning
        from phm.runtime import service
        from phm.runtime.configuration import read

    try:
        with unusable_keys_are_configuration_errors():
            code = service.run(configuration, lambda: read(config))
    except AlreadyRunning as error:
        click.echo(f"phm run: {error}", err=True)
        code = os.EX_TEMPFAIL
    end_process(code)


def end_process(code: int) -> NoReturn:
    """Exit without the interpreter's finalization: a thread that is still inside a library (Zenoh closing a session on a busy
    machine) would abort it with SIGABRT."""
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
