"""`phm doctor`: what PHM can use on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from phm.cli.options import config_option, json_option

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from phm.doctor.context import DoctorContext
    from phm.doctor.row import Row

_STYLES = {"ok": "green", "limited": "yellow", "missing": "bold red"}


@click.command(epilog="Example: docker compose exec phm phm doctor")
@config_option
@json_option
@click.pass_context
def command(ctx: click.Context, config: str | None, as_json: bool) -> None:
    """Show what PHM can use on this machine, and what is missing.

    Each row is ok, limited (PHM works, but with less) or missing, with what to do about it. Changes nothing. Works
    without configuration, Docker Engine and ROS. Attach its output to a report of a problem.
    Exit code 0: nothing is missing; 1: something is.
    """
    from phm.doctor.examination import examine

    found = examine(doctor_context(config))
    good = not any(row.state == "missing" for rows in found.values() for row in rows)
    if as_json:
        listed = [{"group": group, **asdict(row)} for group, rows in found.items() for row in rows]
        click.echo(json.dumps({"ok": good, "rows": listed}, indent=2))
    else:
        _show(found)
    ctx.exit(0 if good else 1)


def doctor_context(config: str | None) -> DoctorContext:
    """With the configuration where there is a valid one, else with the defaults."""
    from phm.config import ConfigError, find
    from phm.core.settings import Settings
    from phm.doctor.context import DoctorContext
    from phm.runtime.configuration import read

    if config is None and not find(None).exists():
        return DoctorContext(Settings())
    try:
        good = read(config)
    except ConfigError as error:
        return DoctorContext(Settings(), problem=str(error.problems[0]), invalid=str(find(config)))
    return DoctorContext(good.settings, good.file)


def _show(found: Mapping[str, Sequence[Row]]) -> None:
    from phm.cli import terminal

    terminal.doctor(
        [
            (group if row is rows[0] else "", row.name, row.state, row.text, row.remedy)
            for group, rows in found.items()
            for row in rows
        ],
        _STYLES,
    )
