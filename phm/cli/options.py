"""Options that several verbs share, and reading the configuration or exiting with every problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from phm.core.settings import Settings

F = TypeVar("F", bound=Callable[..., Any])

EX_CONFIG = 78
"""sysexits.h: the configuration is invalid."""


def config_option(function: F) -> F:
    """Adds `-c/--config PATH`."""
    return click.option(
        "-c",
        "--config",
        "config",
        type=click.Path(dir_okay=False),
        default=None,
        envvar="PHM_CONFIG",
        show_envvar=True,
        help="Configuration file.  [default: /etc/phm/phm.yaml, else config/phm.yaml]",
    )(function)


def run_dir_option(function: F) -> F:
    """Adds `--run-dir PATH`."""
    return click.option(
        "--run-dir",
        envvar="PHM_RUN_DIR",
        show_envvar=True,
        default="/run/phm",
        show_default=True,
        help="The daemon's run_dir, which contains its status and its control socket.",
    )(function)


def json_option(function: F) -> F:
    """Adds `--json`."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")(function)


def load_settings(path: str | None) -> Settings:
    """The configuration; exits with 78 and every problem on stderr when it is invalid."""
    from phm.cli.reading import read
    from phm.config import ConfigError

    try:
        return read(path).settings
    except ConfigError as error:
        click.echo(str(error), err=True)
        raise click.exceptions.Exit(EX_CONFIG) from None


@contextmanager
def loops_are_configuration_errors() -> Iterator[None]:
    """Exit with 78 for problems that are found only while the daemon is built: dependency cycles and unusable signing keys."""
    from phm.core.dependency_graph import DependencyCycle
    from phm.transport.mavlink_signing import InvalidKey

    try:
        yield
    except DependencyCycle as error:
        click.echo(f"checks: {error}", err=True)
        raise click.exceptions.Exit(EX_CONFIG) from None
    except InvalidKey as error:
        click.echo(str(error), err=True)
        raise click.exceptions.Exit(EX_CONFIG) from None
