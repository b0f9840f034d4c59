"""`phm approve`: the operator's yes to what PHM only advises. Imports click and the standard library."""

from __future__ import annotations

from typing import Any

import click

from phm.cli.options import run_dir_option
from phm.wire import control


@click.command(epilog="Example: phm approve ab12-1")
@click.argument("fault")
@run_dir_option
@click.pass_context
def command(ctx: click.Context, fault: str, run_dir: str) -> None:
    """Say yes to the action that PHM advises for an open fault.

    The daemon then does it once, whatever the recovery mode and the armed state say; budget and back-off still hold. The
    approval ends after recovery.approval (60 s), or when the situation changes.
    Exit code 0: it says what will be done; 1: there is nothing to approve, or the daemon does not answer.
    """
    tell(ctx, run_dir, {"do": "approve", "fault": fault})


def tell(ctx: click.Context, run_dir: str, request: dict[str, Any]) -> None:
    """Ask the daemon and print its answer as one sentence; ends with 0 when it did what was asked, else 1."""
    from phm.wire.text import one_line

    try:
        click.echo(one_line(control.ask(run_dir, request)))
    except (control.NoAnswer, control.Refused) as error:
        click.echo(one_line(str(error)), err=True)
        ctx.exit(1)
