"""`phm new-check`: writes the package of a check that can be installed and tested without changes."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import NoReturn

import click


@click.command(epilog="Example: phm new-check photo_queue --action && pip install -e ./photo_queue")
@click.argument("name")
@click.option(
    "--into",
    "parent",
    type=click.Path(file_okay=False, path_type=Path),
    default=".",
    help="Parent of the new folder NAME.  [default: the current one]",
)
@click.option(
    "--slot",
    type=click.IntRange(1, 15),
    default=13,
    show_default=True,
    help="Slot of its results; 13 to 15 are for your checks.",
)
@click.option("--period", default="5s", show_default=True, help="Duration between two runs, such as 500ms or 10s.")
@click.option("--action", is_flag=True, help="Write a recovery action, too.")
def command(name: str, parent: Path, slot: int, period: str, action: bool) -> None:
    """Write the package of a new check.

    Makes the folder NAME with a check, its test, the entry point by which PHM finds it, and a README.
    It can be installed and its tests pass: then replace the sample by what you want to check.
    Exit code 0; 1: nothing was written.
    """
    from phm.core.model import Slot
    from phm.setup import new_check
    from phm.setup.folder import write_new

    period_s = _seconds(period)
    try:
        new = new_check.NewCheck(name, Slot(slot), period_s, action)
        new_check.refuse_taken(name, _installed())
        if find_spec(new.module) is not None:
            _fail(f"there is a Python package {new.module} already: choose another name")
        write_new(parent / name, new_check.render(new))
    except new_check.UnusableName as error:
        _fail(str(error))
    except FileExistsError:
        _fail(f"{parent / name} exists already: nothing was written; remove it, or choose another name or --into")
    except OSError as error:
        _fail(f"{error.filename or parent / name} cannot be written: {error.strerror or error}")
    click.echo(f"wrote {parent / name}")
    click.echo("Next, in the Python environment of PHM:")
    click.echo(f"  pip install -e {_shown(parent / name)} && pytest {quote(str(parent / name))}")
    click.echo(f"  phm checks                 # lists {name}")
    click.echo(f"Then edit {parent / name / new.module / 'check.py'}.")


def _installed() -> set[str]:
    """Names of installed checks, also of those that cannot be loaded."""
    from phm.api import Check
    from phm.checking import registry

    base: type = Check  # mypy does not accept an abstract class as type[T]
    return {found.name for found in registry.find(registry.CHECKS, base)}


def _seconds(text: str) -> float:
    from pydantic import TypeAdapter, ValidationError

    from phm.core.settings import Seconds

    try:
        period_s = float(TypeAdapter(Seconds).validate_python(text))
    except (ValidationError, ValueError):
        period_s = math.nan
    if not 0.1 <= period_s <= 86400:
        raise click.UsageError(f"--period {text}: must be a duration of 0.1s to 24h, such as 500ms or 10s.")
    return period_s


def _shown(folder: Path) -> str:
    """The folder as pip takes it for a folder and not for the name of a package."""
    return quote(str(folder) if folder.is_absolute() else f"./{folder}")


def _fail(text: str) -> NoReturn:
    raise click.ClickException(text)
