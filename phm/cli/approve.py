"""`phm approve`: approves a recommended action. Imports click and the standard library."""

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
    """Approve the recommended action for an open fault.

    FAULT is its id, as `phm status` shows it. The daemon executes the action once, regardless of recovery mode and armed state;
    budget and back-off still apply. The approval expires after recovery.approval (60 s), or when the situation changes.
    Exit code 0: approved; prints what will be done. 1: nothing to approve, or the daemon does not answer.
    """
    send_request(ctx, run_dir, {"do": "approve", "fault": fault})


def send_request(ctx: click.Context, run_dir: str, request: dict[str, Any]) -> None:
    """Send a request and print the answer as one sentence; exits with 1 when it was refused."""
    from phm.wire.text import one_line

    try:
        click.echo(one_line(control.ask(run_dir, request)))
    except (control.NoAnswer, control.Refused) as error:
        click.echo(one_line(str(error)), err=True)
        ctx.exit(1)
