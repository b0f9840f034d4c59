"""`phm deliver`: sends a configuration to an agent over an IP network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from phm.cli.options import EX_CONFIG, json_option
from phm.cli.web_options import address
from phm.wire.text import one_line

if TYPE_CHECKING:
    from phm.wire.delivery import DeliveryAnswer


@click.command(epilog="Example: phm deliver a07.yaml 10.0.0.7:9465 --key a07.key --base a07.yaml.orig")
@click.argument("file", type=click.Path())
@click.argument("agent", metavar="HOST:PORT", callback=address)
@click.option(
    "--key",
    required=True,
    type=click.Path(dir_okay=False),
    help="File with the agent's `delivery.key`.",
)
@click.option("--base", type=click.Path(dir_okay=False), help="The configuration that FILE was made from.")
@click.option("--any", "whatever", is_flag=True, help="Replace the agent's configuration without comparing it.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    file: str,
    agent: tuple[str, int],
    key: str,
    base: str | None,
    whatever: bool,
    as_json: bool,
) -> None:
    """Send a configuration to an agent over IP, which applies it.

    The agent needs `delivery` in its configuration. It validates FILE, replaces its own file, reloads, and returns to the previous
    file if that fails. It refuses while the vehicle is armed or may be, and when its file is not the one of --base. Never by radio.
    Exit code 0: applied; 78: FILE is invalid on the agent; 1: not applied, or no answer.
    """
    from phm.config import ConfigError
    from phm.config.loader import read_file
    from phm.gcs import delivery_client
    from phm.transport.mavlink_signing import InvalidKey, read_key
    from phm.wire.delivery import version_of

    if (base is None) != whatever:
        raise click.UsageError(
            "Give either --base FILE, the configuration of the agent that FILE was made from, or --any."
        )
    try:
        text = read_file(Path(file))
        secret = read_key(key, "--key")
        version = version_of(read_file(Path(base))) if base is not None else delivery_client.present(agent, secret)
        name, answer = delivery_client.deliver(agent, secret, text, version)
    except (ConfigError, InvalidKey) as error:
        raise click.ClickException(str(error)) from None
    except delivery_client.DeliveryFailed as error:  # has words of the program that answers there
        raise click.ClickException(one_line(str(error))) from None
    _print(name, answer, as_json=as_json)
    ctx.exit(0 if answer.ok else EX_CONFIG if answer.problems else 1)


def _print(name: str, answer: DeliveryAnswer, *, as_json: bool) -> None:
    if as_json:
        found = {
            "ok": answer.ok,
            "agent": name,
            "text": answer.text,
            "present": answer.present,
            "problems": answer.problems,
        }
        click.echo(json.dumps(found, indent=2))
        return
    for problem in answer.problems:
        click.echo(one_line(problem["text"]), err=True)
    click.echo(one_line(f"{name}: {answer.text}"), err=not answer.ok)
