"""The command `phm`. Each verb is a module of this package, imported only when it is used.

`phm status --healthy` runs every few seconds as a container's HEALTHCHECK, so this module imports nothing but click.
Verbs of other packages are found through the entry-point group ``phm.verbs``.
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

# Verb: its line in `phm --help` (kept here so that help needs no imports; a test compares them).
VERBS = {
    "init": "Create a folder with everything needed to start PHM.",
    "doctor": "Show what PHM can use on this machine, and what is missing.",
    "run": "Run the daemon until SIGTERM.",
    "once": "Run every check once and print the results.",
    "validate": "Validate a configuration file and list every problem.",
    "learn": "Watch a healthy agent and write a configuration for it.",
    "checks": "List the installed checks.",
    "new-check": "Write the package of a new check.",
    "status": "Show daemon and agent status.",
    "faults": "List open and recent faults, or show one with its timeline.",
    "reload": "Reload the configuration of the running daemon.",
    "deliver": "Send a configuration to an agent over IP, which applies it.",
    "approve": "Approve the recommended action for an open fault.",
    "hold": "Suspend recovery of one container or of all.",
    "release": "End a hold, so that recovery resumes.",
    "note": "Write a line into the running daemon's log.",
    "proxy-rules": "Print Docker proxy rules that allow only the calls PHM makes.",
    "logs": "Show, follow, collect or bundle logs, with explanations.",
    "report": "Report what failed, when and why, from logs after the flight.",
    "gcs": "Show the status of all agents, as received by a ground station.",
    "demo": "Show three simulated agents and two faults on this machine.",
}
EX_SOFTWARE = 70
"""As in sysexits.h; `os` has it on POSIX alone."""
VERB_GROUP = "phm.verbs"


class LazyGroup(click.Group):
    """Imports each verb by name when it is used: `phm.cli.<verb>:command`."""

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
            raise click.ClickException(f"verb {cmd_name!r} is not a click command: fix the package that provides it")
        return loaded

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = list(VERBS.items())
        for name, point in sorted(_foreign_verbs().items()):
            rows.append((name, f"From {point.dist.name if point.dist else point.value}."))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def _foreign_verbs() -> dict[str, EntryPoint]:
    """Verbs of other packages. Used only for names that are not PHM's own, because it reads every installed package."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=VERB_GROUP) if point.name not in VERBS}


def _load(point: EntryPoint) -> object:
    try:
        return point.load()
    except Exception as error:  # the other package's code runs here; report its failure
        cause = f"{type(error).__name__}: {error}"
        raise click.ClickException(f"verb {point.name!r} from {point.value!r} cannot be loaded: {cause}") from error


@click.command(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: phm status --watch",
)
@click.version_option(__version__, "-V", "--version", prog_name="phm", message="%(prog)s %(version)s")
def group() -> None:
    """Prognostics and health monitoring for a drone's companion computer.

    Detects, reports and recovers failures across radio, Docker and ROS 2.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. An unexpected error is printed as one sentence; PHM_TRACEBACK=1 shows the traceback."""
    try:
        group.main(args=None if arguments is None else list(arguments), prog_name="phm")
    except Exception as error:
        if os.environ.get("PHM_TRACEBACK"):
            raise
        from phm.wire.text import one_line

        detail = one_line(f"{type(error).__name__}: {error}")
        click.echo(f"phm: internal error: {detail} (set PHM_TRACEBACK=1 for the traceback)", err=True)
        sys.exit(EX_SOFTWARE)
