"""`phm note`: writes an operator's line into the running daemon's log."""

from __future__ import annotations

import click

from phm.cli.approve import send_request
from phm.cli.options import run_dir_option


@click.command(epilog='Example: phm note "propeller 3 replaced"')
@click.argument("text")
@run_dir_option
@click.pass_context
def command(ctx: click.Context, text: str, run_dir: str) -> None:
    """Write a line into the running daemon's log.

    The line has the kind NOTE and at most 500 characters. Exit code 0: written; 1: the daemon does not answer.
    """
    send_request(ctx, run_dir, {"do": "note", "text": text})
