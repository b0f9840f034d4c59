"""`phm hold`: suspends recovery of a container. Imports click and the standard library."""

from __future__ import annotations

import json
import re
from typing import Any

import click

from phm.cli.options import json_option, run_dir_option
from phm.wire import control

_DURATION = re.compile(r"([0-9]+(?:\.[0-9]+)?) *(s|min|h)")
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


class Duration(click.ParamType):  # type: ignore[type-arg]
    """``90s``, ``10min``, ``1.5h``; gives seconds."""

    name = "duration"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        match = _DURATION.fullmatch(str(value).strip())
        if match is None:
            self.fail(
                f"{value!r} is not a duration: write a number with s, min or h, e.g. 90s, 10min or 1.5h", param, ctx
            )
        return float(match[1]) * _SECONDS[match[2]]


@click.command(epilog='Example: phm hold ros_app --for 20min --reason "swapping firmware"')
@click.argument("container", required=False, default="")
@click.option("--for", "for_s", type=Duration(), default=None, help="How long, e.g. 10min.  [default: recovery.hold]")
@click.option("--reason", default="", help="Shown in the status, in the log and at the ground station.")
@run_dir_option
@json_option
@click.pass_context
def command(ctx: click.Context, container: str, for_s: float | None, reason: str, run_dir: str, as_json: bool) -> None:
    """Suspend recovery of one container or of all.

    CONTAINER is its key in the configuration; without it, all containers are on hold. During a hold PHM takes no action on the
    container, and its faults raise no alarm. An action in progress is finished first. A new hold replaces an earlier one.
    `phm release` ends it; starting the container does not.
    Exit code 0: on hold; 1: refused, or the daemon does not answer.
    """
    send_request(
        ctx, run_dir, {"do": "hold", "container": container, "for_s": for_s, "reason": reason}, as_json=as_json
    )


def send_request(ctx: click.Context, run_dir: str, request: dict[str, Any], *, as_json: bool) -> None:
    """Send a request and print the answer; exits with 1 when it was refused."""
    from phm.wire.text import one_line

    try:
        answer = control.ask_all(run_dir, request)
    except (control.NoAnswer, control.Refused) as error:
        if as_json:
            click.echo(json.dumps({"ok": False, "error": str(error)}))
        else:
            click.echo(one_line(str(error)), err=True)
        ctx.exit(1)
    click.echo(json.dumps(answer) if as_json else one_line(str(answer.get("text"))))
