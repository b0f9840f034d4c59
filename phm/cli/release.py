"""`phm release`: ends a hold. Imports click and the standard library."""

from __future__ import annotations

import click

from phm.cli.hold import send_request
from phm.cli.options import json_option, run_dir_option


@click.command(epilog="Example: phm release ros_app")
@click.argument("container", required=False, default="")
@run_dir_option
@json_option
@click.pass_context
def command(ctx: click.Context, container: str, run_dir: str, as_json: bool) -> None:
    """End a hold, so that recovery resumes.

    CONTAINER is its key in the configuration; without it, all holds end. Checks run again immediately, and faults that remain are
    reported and recovered as usual.
    Exit code 0: released; 1: it was not on hold, or the daemon does not answer.
    """
    send_request(ctx, run_dir, {"do": "release", "container": container}, as_json=as_json)
