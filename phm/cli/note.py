"""`phm note`: a line of the operator's, or of a test that injects a fault, in the running daemon's log."""

from __future__ import annotations

import click

from phm.cli.approve import tell
from phm.cli.options import run_dir_option


@click.command(epilog='Example: phm note "propeller 3 replaced"')
@click.argument("text")
@run_dir_option
@click.pass_context
def command(ctx: click.Context, text: str, run_dir: str) -> None:
    """Write a line into the running daemon's log.

    The line is of the kind INJECT. Exit code 0: it is noted; 1: the daemon does not answer.
    """
    tell(ctx, run_dir, {"do": "note", "kind": "INJECT", "text": text})
