"""`phm once`: runs every check once and prints the results."""

from __future__ import annotations

import json

import click

from phm.cli.options import config_option, json_option, load_configuration, unusable_keys_are_configuration_errors


@click.command(epilog="Example: phm once --json | jq .status_array")
@config_option
@json_option
@click.pass_context
def command(ctx: click.Context, config: str | None, as_json: bool) -> None:
    """Run every check once and print the results.

    Changes nothing: no recovery, no MAVLink, no log.
    Exit code 0: no check reports ERROR; 1: a check reports ERROR; 78: the configuration is invalid.
    """
    configuration = load_configuration(config, links=False)
    from phm.runtime.single_pass import run_once
    from phm.wire.report import report_json

    with unusable_keys_are_configuration_errors():
        units = run_once(configuration)
    report = report_json(configuration.settings.agent.name, units)
    if as_json:
        click.echo(json.dumps(report, indent=2))
    else:
        from phm.cli import terminal

        terminal.report(report)
    ctx.exit(1 if any(check["level"] == "ERROR" for check in report["checks"]) else 0)
