"""`phm validate`: validates a configuration file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from phm.cli.options import CONFIGURATION, EX_CONFIG, config_option, json_option

if TYPE_CHECKING:
    from phm.runtime.configuration import Configuration

COUNTED = ("units", "containers", "nodes", "topics", "endpoints")
"""In the line for a valid file; one of it is named without the last letter."""


@click.command(epilog="Example: phm validate -c config/phm.yaml")
@click.argument("file", required=False, type=CONFIGURATION)
@config_option
@json_option
@click.option(
    "--schema", is_flag=True, help="Print the JSON schema of the configuration, for editors, and validate nothing."
)
@click.option(
    "--examples", is_flag=True, help="Print the folder with the documented phm.yaml and examples, and validate nothing."
)
@click.pass_context
def command(
    ctx: click.Context, file: str | None, config: str | None, as_json: bool, schema: bool, examples: bool
) -> None:
    """Validate a configuration file and list every problem.

    It also warns about ladders of unknown conditions, about shares written as fractions, and in a container about endpoints that do
    not leave it. Opens nothing but the file. Exit code 0: valid; 78: invalid.
    """
    if schema:
        from phm.config.schema import text

        click.echo(text(), nl=False)
    elif examples:
        ctx.exit(_examples())
    else:
        ctx.exit(validate(file or config, as_json))


def _examples() -> int:
    """Print the folder. Returns 0, or 1 if there is none."""
    from phm.config.shipped import folder

    found = folder()
    if found is None:
        click.echo("phm validate: the examples are part of the wheel and of the repository, not of an image", err=True)
        return 1
    click.echo(found)
    return 0


def validate(path: str | None, as_json: bool, environ: Mapping[str, str] | None = None) -> int:
    """Print the result; problems on stderr, one a line (with as_json all on stdout). Returns 0 or 78."""
    from phm.config import ConfigError, find, fractions
    from phm.config.loader import read_file
    from phm.runtime.configuration import read_text

    variables = os.environ if environ is None else environ
    try:
        file = find(path)
        text = read_file(file)
        good = read_text(text, str(file), variables)
    except ConfigError as error:
        if as_json:
            problems = [asdict(problem) for problem in error.problems]
            click.echo(json.dumps({"ok": False, "problems": problems}, indent=2))
        else:
            count = len(error.problems)
            click.echo(str(error), err=True)
            click.echo(f"{count} problem{'s' if count != 1 else ''}", err=True)
        return EX_CONFIG
    warnings = [*_warnings(good), *fractions.warnings(text, good.file, variables)]
    if as_json:
        click.echo(json.dumps({"ok": True, **_facts(good), "problems": [], "warnings": warnings}, indent=2))
    else:
        click.echo(_line(good))
        for warning in warnings:
            click.echo(f"warning: {warning}", err=True)
    return 0


def _warnings(good: Configuration) -> list[str]:
    """What is allowed, but does not work here or is incomplete."""
    return [*_loopback(good), *_unclear_path(good), *_unknown_conditions(good)]


def _unclear_path(good: Configuration) -> list[str]:
    settings = good.settings
    if not settings.command_path_unclear or not any(entry.to_autopilot for entry in settings.mavlink.endpoints):
        return []
    return [
        f"{good.file}: mavlink.application: which container passes commands to the autopilot is not known, so the application is "
        "not part of the unit `path`. Name it, set `commands: true` at a node of `ros.nodes`, or write none"
    ]


def _unknown_conditions(good: Configuration) -> list[str]:
    """A warning and no problem: a plug-in that is installed only on the agent may report the condition."""
    from phm.checking import registry
    from phm.checking.condition_names import unnamed
    from phm.config.problems import shown, suggestion
    from phm.recovery.ladders import LADDERS

    others = [condition for condition in good.settings.recovery.ladders if condition not in LADDERS]
    return [
        f"{good.file}: recovery.ladders: unknown condition {shown(condition)}{suggestion(condition, LADDERS) or '.'} "
        "No installed check reports it, as far as their source shows; then this ladder has no effect"
        for condition in unnamed(others, registry.checks().values())
    ]


def _loopback(good: Configuration) -> list[str]:
    from phm.core.settings.metrics import is_loopback as is_own_address
    from phm.transport.own_network import is_loopback, is_private, listens_only_inside

    if not is_private():
        return []
    found = []
    inside = [entry.url for entry in good.settings.mavlink.endpoints if listens_only_inside(entry.url)]
    if inside:
        found.append(
            f"{good.file}: mavlink.endpoints: {', '.join(inside)} listens only inside PHM's container: write 0.0.0.0 in place of the address"
        )
    loopback = [entry.url for entry in good.settings.mavlink.endpoints if is_loopback(entry.url)]
    if loopback:
        found.append(
            f"{good.file}: mavlink.endpoints: {', '.join(loopback)} does not leave PHM's container. For a ground station or router on "
            "the host use udpout:host.docker.internal:14550 with `extra_hosts: [host.docker.internal:host-gateway]`, or `network_mode: "
            "host`; for one in another container, its name"
        )
    urls = [entry.url for entry in good.settings.mavlink.endpoints if entry.url.startswith(("udpin:", "tcpin:"))]
    if waiting := [url for url in urls if url not in inside]:
        found.append(
            f"{good.file}: mavlink.endpoints: {', '.join(waiting)} can be reached only by containers on PHM's networks, unless `ports:` "
            "of its Compose file publishes it"
        )
    metrics = good.settings.metrics
    if metrics.listen and is_own_address(metrics.address[0]):
        port = metrics.address[1]
        found.append(
            f"{good.file}: metrics.listen: {metrics.listen} cannot be reached from outside PHM's container. Use 0.0.0.0:{port}, and "
            f'`ports: ["127.0.0.1:{port}:{port}"]` in its Compose file, with another address of the host if Prometheus runs elsewhere'
        )
    return found


def _facts(good: Configuration) -> dict[str, str | int | float]:
    settings = good.settings
    return {
        "file": good.file,
        "agent": settings.agent.name,
        "id": settings.agent.id,
        "interval_s": settings.interval,
        "units": good.unit_count,
        "containers": len(settings.containers),
        "nodes": len(settings.ros.nodes),
        "topics": len(settings.ros.topics),
        "endpoints": len(settings.mavlink.endpoints),
    }


def _line(good: Configuration) -> str:
    facts = _facts(good)
    counted = ", ".join(f"{facts[key]} {key if facts[key] != 1 else key[:-1]}" for key in COUNTED)
    return f"{good.file}: valid, agent {facts['agent']} (id {facts['id']}), every {facts['interval_s']:g} s: {counted}"
