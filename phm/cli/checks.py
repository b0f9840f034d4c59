"""`phm checks`: what is installed."""

from __future__ import annotations

import json
from typing import Any

import click

from phm.cli.options import json_option


@click.command(epilog="Example: phm checks --json")
@json_option
@click.pass_context
def command(ctx: click.Context, as_json: bool) -> None:
    """List the checks that are installed.

    With slot, layer and the package each comes from. A check that cannot be loaded is listed with the
    reason, and the exit code is 1; so it is when there are none at all.
    """
    rows = _rows()
    if as_json:
        click.echo(json.dumps(rows, indent=2))
    else:
        from phm.cli import render

        render.checks(rows)
    if not rows:
        click.echo("No checks are installed: install the package that brings them, phm-sidecar.", err=True)
    ctx.exit(0 if rows and not any(row["problem"] for row in rows) else 1)


def _rows() -> list[dict[str, Any]]:
    """One per installed check; `slot`, `layer` are null and `problem` says why when it could not be loaded."""
    from phm import registry
    from phm.api import Check

    base: type = Check  # mypy takes no abstract class for type[T]
    rows = []
    for found in registry.find(registry.CHECKS, base):
        check: type[Check] | None = found.loaded
        rows.append(
            {
                "name": found.name,
                "slot": int(check.slot) if check else None,
                "layer": check.layer.value if check else None,
                "source": found.source,
                "description": _first_line(check.__doc__) if check else "",
                "problem": found.problem,
            }
        )
    return sorted(rows, key=lambda row: (row["slot"] or 99, row["name"]))


def _first_line(text: str | None) -> str:
    return (text or "").strip().partition("\n")[0].strip()
