"""The command `phm`. Each verb is a file of this package, imported when it is used and not before.

`phm status --healthy` runs every few seconds as a container's HEALTHCHECK: nothing here may import more than
click. A verb of another package is found through the entry-point group ``phm.verbs``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from phm import __version__

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

# Verb: what `phm --help` says about it (kept here so that help needs no imports; a test compares).
VERBS = {
    "run": "Run the daemon until SIGTERM.",
    "once": "Make one pass over all checks and print it.",
    "validate": "Check a configuration file and name every problem.",
    "checks": "List the checks that are installed.",
    "status": "Show how the running daemon and its agent do.",
    "faults": "List open and recent faults, or one with its timeline.",
    "reload": "Have the running daemon reload its configuration.",
    "approve": "Say yes to the action that PHM advises for an open fault.",
    "hold": "Keep recovery from a container, or from all, for a while.",
    "release": "End a hold.",
    "note": "Write a line into the running daemon's log.",
    "proxy-rules": "Print proxy rules that allow only the calls PHM makes.",
    "gcs": "Show how all agents are, as a ground station hears them.",
}
VERB_GROUP = "phm.verbs"


class LazyGroup(click.Group):
    """A group whose verbs are imported one at a time, by name: `phm.cli.<verb>:command`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*VERBS, *sorted(_foreign_verbs())]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in VERBS:
            from importlib import import_module

            loaded = import_module(f"phm.cli.{cmd_name.replace('-', '_')}").command
        else:
            point = _foreign_verbs().get(cmd_name)
            if point is None:
                return None
            loaded = _load(point)
        if not isinstance(loaded, click.Command):
            raise click.ClickException(f"verb {cmd_name!r} is no click command: correct its package")
        return loaded

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = list(VERBS.items())
        for name, point in sorted(_foreign_verbs().items()):
            rows.append((name, f"From {point.dist.name if point.dist else point.value}."))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def _foreign_verbs() -> dict[str, EntryPoint]:
    """Verbs of other packages. Only looked for when a name is not ours, since it reads every installed package."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=VERB_GROUP) if point.name not in VERBS}


def _load(point: EntryPoint) -> object:
    try:
        return point.load()
    except Exception as error:  # the other package's code runs here; its failure is told, not hidden
        cause = f"{type(error).__name__}: {error}"
        raise click.ClickException(f"verb {point.name!r} from {point.value!r} cannot be loaded: {cause}") from error


@click.command(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: phm status --watch",
)
@click.version_option(__version__, "-V", "--version", prog_name="phm", message="%(prog)s %(version)s")
def group() -> None:
    """What failed on which agent, at which layer, and did it heal itself?"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the command line. Whatever goes wrong ends as one sentence; PHM_TRACEBACK=1 shows the rest."""
    try:
        group.main(args=None if arguments is None else list(arguments), prog_name="phm")
    except Exception as error:
        if os.environ.get("PHM_TRACEBACK"):
            raise
        from phm.wire.text import one_line

        detail = one_line(f"{type(error).__name__}: {error}")
        click.echo(f"phm: internal error: {detail} (PHM_TRACEBACK=1 shows where)", err=True)
        sys.exit(os.EX_SOFTWARE)
