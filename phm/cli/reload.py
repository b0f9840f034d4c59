"""`phm reload`: reloads the configuration of the running daemon. Imports click and the standard library."""

from __future__ import annotations

import json
from typing import Any

import click

from phm.cli.options import EX_CONFIG, json_option, run_dir_option
from phm.wire import control

WAIT_S = 40.0


@click.command(epilog="Example: phm validate && phm reload")
@run_dir_option
@json_option
@click.pass_context
def command(ctx: click.Context, run_dir: str, as_json: bool) -> None:
    """Reload the configuration of the running daemon.

    The daemon validates the file that it was started with. If it is invalid, every problem is printed, and the old configuration
    remains active. Sections that need a restart of PHM are named.
    Exit code 0: reloaded; 78: the configuration is invalid; 1: not reloaded for another reason, or the daemon does not answer.
    """
    try:
        outcome = json.loads(control.ask(run_dir, {"do": "reload"}, WAIT_S))
    except (control.NoAnswer, control.Refused, ValueError) as error:
        outcome = {"ok": False, "changed": [], "restart": [], "problems": [], "why": str(error), "text": str(error)}
    if as_json:
        click.echo(json.dumps(outcome, indent=2))
    else:
        _print(outcome)
    ctx.exit(0 if outcome["ok"] else EX_CONFIG if outcome["problems"] else 1)


def _print(outcome: dict[str, Any]) -> None:
    from phm.wire.text import one_line

    for problem in outcome["problems"]:
        click.echo(one_line(problem["text"]), err=True)
    if count := len(outcome["problems"]):
        count = outcome.get("total", count)  # PHM may be older than this command
        click.echo(f"{count} problem{'s' if count != 1 else ''}: the old configuration remains active", err=True)
    else:
        click.echo(one_line(outcome["text"]), err=not outcome["ok"])
