"""`phm status`: shows the daemon's status file. Imports click and the standard library."""

from __future__ import annotations

import json
from typing import Any

import click

from phm.cli.options import json_option, run_dir_option
from phm.cli.web_options import web_options
from phm.wire import status_file


@click.command(epilog="Example, as a container's HEALTHCHECK: phm status --healthy")
@run_dir_option
@json_option
@click.option("--healthy", is_flag=True, help="Print one sentence; exit code 0 when the daemon is healthy, else 1.")
@click.option("--watch", is_flag=True, help="Refresh every second until Ctrl-C.")
@web_options("this agent")
@click.option(
    "--history",
    type=click.Path(dir_okay=False),
    help="Where the page keeps its history; none: until it ends.  [default: page-history.db in /var/lib/phm, else in $XDG_STATE_HOME/phm]",
)
@click.pass_context
def command(
    ctx: click.Context,
    /,
    run_dir: str,
    as_json: bool,
    healthy: bool,
    watch: bool,
    web: tuple[str, int] | None,
    history: str | None,
    **access: Any,
) -> None:
    """Show daemon and agent status.

    Exit code 0: the daemon is running and healthy, whatever the status of the agent; 1: it is not. The status file of a
    daemon that was killed is detected.
    """
    if as_json + healthy + watch + bool(web) > 1:
        raise click.UsageError("Use only one of --json, --healthy, --watch and --web.")
    if any((*access.values(), history)) and not web:
        raise click.UsageError("--token-file, --tls-cert, --tls-key, --behind-proxy and --history need --web.")
    if web:
        _serve(run_dir, web, history, access)
        return
    if watch:
        _watch(run_dir)
        return
    document, problem = _read(run_dir, shown=not healthy)
    if healthy:
        click.echo(problem or f"PHM is healthy: monitoring {len(document.get('checks', ()))} units.", err=bool(problem))
    elif as_json:
        click.echo(json.dumps({**document, "healthy": not problem, "problem": problem}, indent=2))
    elif document:
        from phm.cli import terminal

        terminal.status(document, problem)
    else:
        click.echo(problem, err=True)
    ctx.exit(1 if problem else 0)


def _read(run_dir: str, *, shown: bool = True) -> tuple[dict[str, Any], str]:
    """The status, empty when there is none, and why the daemon is not healthy, else empty. shown: the complete status is needed."""
    try:
        document = _complete(run_dir) if shown else status_file.read(run_dir)
    except status_file.NoStatus as error:
        return {}, f"PHM is not healthy: {error}."
    reason = status_file.unhealthy(document)
    return document, f"PHM is not healthy: {reason}." if reason else ""


def _complete(run_dir: str) -> dict[str, Any]:
    from phm.wire import status_shape  # not imported for a health check

    return status_shape.read(run_dir)


def _watch(run_dir: str) -> None:
    from phm.cli import terminal

    try:
        terminal.watch(lambda: _read(run_dir))
    except KeyboardInterrupt:
        return


def _serve(run_dir: str, where: tuple[str, int], history: str | None, access: dict[str, Any]) -> None:
    """Serve the page until Ctrl-C or SIGTERM. history: as given."""
    import signal
    import threading
    from pathlib import Path

    from phm.cli import web_options

    web_options.require_aiohttp("--web")
    from phm.core.clock import SystemClock
    from phm.gcs.web.agent_page import AgentPage
    from phm.gcs.web.history.locations import agent_path

    path = None if history == "none" else agent_path() if history is None else Path(history)
    options = web_options.listen_options(where, **access)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: ended.set())
    page = web_options.listening(
        "--web", where, lambda: AgentPage(lambda: _read(run_dir), options, SystemClock(), path)
    )
    try:
        page.start()
        click.echo("; ".join(filter(None, (f"page at {page.url}", page.about()))), err=True)
        ended.wait()
    finally:
        page.close()
