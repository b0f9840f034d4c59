"""Options that several verbs share, and reading the configuration or exiting with every problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from phm.core.settings import Settings
    from phm.runtime.configuration import Configuration

F = TypeVar("F", bound=Callable[..., Any])

EX_CONFIG = 78
"""sysexits.h: the configuration is invalid."""
CONFIGURATION = click.Path(readable=False)
"""Click checks nothing: it would exit with 2, after which systemd restarts PHM forever. Reading the file reports it, with 78."""


def config_option(function: F) -> F:
    """Adds `-c/--config PATH`."""
    return click.option(
        "-c",
        "--config",
        "config",
        type=CONFIGURATION,
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


def from_command_line(name: str) -> bool:
    """Whether this option of the present command was typed: a command that is named in a hint needs it, too."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def load_settings(path: str | None) -> Settings:
    """The settings of a valid configuration; exits as `load_configuration` does."""
    return load_configuration(path).settings


def load_configuration(path: str | None, *, links: bool = True) -> Configuration:
    """The configuration with its checks, see `read`; exits with 78 and every problem on stderr when it is invalid."""
    from phm.config import ConfigError
    from phm.runtime.configuration import read

    try:
        return read(path, links=links)
    except ConfigError as error:
        click.echo(str(error), err=True)
        raise click.exceptions.Exit(EX_CONFIG) from None


@contextmanager
def unusable_keys_are_configuration_errors() -> Iterator[None]:
    """Exit with 78 for a problem that is found only while the daemon is built: an unusable signing key."""
    from phm.transport.mavlink_signing import InvalidKey

    try:
        yield
    except InvalidKey as error:
        click.echo(str(error), err=True)
        raise click.exceptions.Exit(EX_CONFIG) from None
