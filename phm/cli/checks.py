"""`phm checks`: the installed checks, and the dependency graph of a configuration."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from phm.cli.options import config_option, json_option, load_configuration

if TYPE_CHECKING:
    from phm.checking.plan import CheckPlan


@click.command(epilog="Example: phm checks --graph -c config/phm.yaml")
@click.option("--graph", "as_graph", is_flag=True, help="Print the dependency graph of a configuration.")
@config_option
@json_option
@click.pass_context
def command(ctx: click.Context, as_graph: bool, config: str | None, as_json: bool) -> None:
    """List the installed checks.

    Shows slot, layer and the package of each. A check that cannot be loaded is listed with the reason.
    With --graph: the units of a configuration, each below the unit that it needs.
    Exit code 0; 1: a check cannot be loaded, or none is installed; 78: the configuration is invalid.
    """
    if as_graph:
        from phm.checking.plan import unit_rows

        plan = load_configuration(config).plan
        click.echo(json.dumps(unit_rows(plan), indent=2) if as_json else "\n".join(_tree(plan)))
        ctx.exit(0)
    rows = _rows()
    if as_json:
        click.echo(json.dumps(rows, indent=2))
    else:
        from phm.cli import terminal

        terminal.checks(rows)
    if not rows:
        click.echo("No checks are installed: install the package phm-sidecar.", err=True)
    ctx.exit(0 if rows and not any(row["problem"] for row in rows) else 1)


def _tree(plan: CheckPlan) -> Iterator[str]:
    """Each unit once, indented below the last of its direct dependencies; the others are named beside it."""
    graph = plan.graph
    entries = {entry.unit.id: entry for entry in plan.tracked}
    below: dict[str, list[str]] = {}
    for unit, entry in entries.items():
        direct = [need for need in entry.needs if need in entries]
        below.setdefault(max(direct, key=lambda need: len(graph.upstream(need)), default=""), []).append(unit)

    def lines(parent: str, above: tuple[str, ...]) -> Iterator[str]:
        for unit in below.get(parent, ()):
            also = [need for need in entries[unit].needs if need in entries and need not in above]
            said = f" (also needs {', '.join(also)})" if also else ""
            said += " (possible cause of any fault, blocks no unit)" if entries[unit].unit.suspect else ""
            yield f"{'  ' * len(above)}{unit}{said}"
            yield from lines(unit, (*above, unit))

    return lines("", ())


def _rows() -> list[dict[str, Any]]:
    """One entry per installed check. When it cannot be loaded, `slot` and `layer` are null and `problem` says why."""
    from phm.api import Check
    from phm.checking import registry

    base: type = Check  # mypy does not accept an abstract class as type[T]
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
