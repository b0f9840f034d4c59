"""`phm proxy-rules`: the rules of a Docker proxy that allows only the calls that a configuration needs."""

from __future__ import annotations

import os
from pathlib import Path

import click

from phm.cli.options import EX_CONFIG, config_option, load_settings

ENGINE = "/var/run/docker.sock"


@click.command(epilog="Example: phm proxy-rules -c config/phm.yaml --output haproxy.cfg")
@config_option
@click.option("--output", type=click.Path(dir_okay=False), help="File to write.  [default: standard output]")
@click.option("--engine", default=ENGINE, show_default=True, help="Socket of the Docker Engine, as the proxy sees it.")
def command(config: str | None, output: str | None, engine: str) -> None:
    """Print Docker proxy rules that allow only the calls PHM makes.

    The rules are for HAProxy 2.4 or later, which listens at `docker.socket`; docker/compose.proxy.yaml starts one.
    Exit code 0; 78: the configuration is invalid, or does not allow exact rules.
    """
    from phm.proxy.calls import left_out
    from phm.proxy.haproxy import NoRules, rules

    settings = load_settings(config)
    try:
        text = rules(settings, engine)
    except NoRules as error:
        for problem in error.problems:
            click.echo(problem, err=True)
        raise click.exceptions.Exit(EX_CONFIG) from None
    for sentence in left_out(settings):
        click.echo(f"warning: {sentence}", err=True)
    if output is None:
        click.echo(text, nl=False)
        return
    _write(Path(output), text)


def _write(path: Path, text: str) -> None:
    """Replace the file atomically: a proxy that starts meanwhile reads the old or the new one."""
    beside = path.with_name(f".{path.name}.new")
    try:
        beside.write_text(text, encoding="utf-8")
        os.replace(beside, path)
    except OSError as error:
        raise click.ClickException(f"{path} cannot be written: {error.strerror or error}") from error
