"""`phm run`: the daemon."""

from __future__ import annotations

import click

from phm.cli.options import config_option, load_settings, loops_are_configuration_errors


@click.command(epilog="Example: phm run -c /etc/phm/phm.yaml")
@config_option
@click.pass_context
def command(ctx: click.Context, config: str | None) -> None:
    """Run the daemon until SIGTERM.

    Reads the configuration, then checks, heals and tells until SIGTERM or SIGINT. A bad configuration ends
    it with exit code 78 before anything is opened.
    """
    settings = load_settings(config)
    import logging

    logging.basicConfig(level=logging.WARNING, format="phm: %(levelname)s: %(name)s: %(message)s")
    from phm import daemon

    with loops_are_configuration_errors():
        code = daemon.run(settings)
    ctx.exit(code)
