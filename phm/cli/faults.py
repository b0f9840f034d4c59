"""`phm faults`: open and recent faults with their timelines, from the log and the daemon's status."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from shlex import quote
from typing import Any

import click

from phm.cli.options import config_option, from_command_line, json_option, load_settings, run_dir_option
from phm.wire import fault_timeline, json_log, status_file, status_shape

RECENT = 20


@click.command(epilog="Example: phm faults ab12-1")
@click.argument("fault", required=False)
@config_option
@click.option("--log-dir", help="Directory of phm.jsonl.  [default: log.directory of the configuration]")
@run_dir_option
@json_option
@click.option(
    "--all", "everything", is_flag=True, help=f"List all faults in the log, not only the last {RECENT} closed ones."
)
@click.pass_context
def command(
    ctx: click.Context,
    fault: str | None,
    config: str | None,
    log_dir: str | None,
    run_dir: str,
    as_json: bool,
    everything: bool,
) -> None:
    """List open and recent faults, or show one with its timeline.

    FAULT is an id, as the list shows it. Works without the daemon, too, from its log alone.
    Exit code 0; 1: the fault is unknown, or there is no log, or nothing in it can be read.
    """
    directory = log_dir or load_settings(config).log.directory
    opened, running = _open_now(run_dir)
    files = _files(directory)
    if not files and not running:
        click.echo(f"no phm.jsonl in {directory}: PHM has not run here, or logs elsewhere (see --log-dir)", err=True)
        ctx.exit(1)
    found, unread = _timelines(directory, files, opened if running else None)
    if unread and not running:
        ctx.exit(1)
    if fault is not None:
        found = [episode for episode in found if episode["fault"] == fault]
        if not found:
            place = f" -c {quote(str(config))}" if from_command_line("config") else ""
            place = f" --log-dir {quote(log_dir)}" if log_dir else place
            listing = f"list all with `phm faults --all{place}`"
            click.echo(f"fault {fault} is not in the log in {directory}: {listing}", err=True)
            ctx.exit(1)
    elif not everything:
        lasting = [episode for episode in found if episode["outcome"] == "open" or episode["current"]]
        recent = [episode for episode in found if episode not in lasting][-RECENT:]
        found = [episode for episode in found if episode in lasting or episode in recent]
    _show(found, running, as_json=as_json, one=fault is not None)
    ctx.exit(1 if unread else 0)


def _files(directory: str) -> list[Path]:
    try:
        return json_log.files(directory)
    except OSError as error:
        raise click.ClickException(f"the log in {directory} cannot be read: {error.strerror}") from None


def _timelines(
    directory: str, files: Sequence[Path], opened: Sequence[Mapping[str, Any]] | None
) -> tuple[list[dict[str, Any]], bool]:
    """The faults, and whether there is a log of which nothing could be read. Says what was not read."""
    from phm.logs.reader import LogReader

    log = LogReader(Path(directory))
    events = log.events(last=True)
    first = list(islice(events, 1))
    found = fault_timeline.build_timelines(chain(first, events), opened)
    log.close()
    problems = [f"{file}: not a regular file" for file in files if not file.is_file()] + log.problems()
    for problem in problems:
        click.echo(problem, err=True)
    unread = bool(problems) and not first
    if unread:
        click.echo(f"nothing in the log in {directory} could be read: its faults are unknown", err=True)
    return found, unread


def _show(found: list[dict[str, Any]], running: bool, *, as_json: bool, one: bool) -> None:
    """one: the steps of the only fault that was found."""
    if as_json:
        click.echo(json.dumps({"running": running, "faults": found}, indent=2))
        return
    from phm.cli import terminal

    if one:
        terminal.timeline(found[0], running)
    else:
        terminal.faults(found, running)


def _open_now(run_dir: str) -> tuple[list[dict[str, Any]], bool]:
    """The open and given-up faults of the daemon, and whether a healthy daemon is running."""
    try:
        document = status_shape.read(os.fspath(run_dir))
    except status_file.NoStatus:
        return [], False
    faults = document.get("faults", {})
    opened = [*faults.get("open", []), *faults.get("given_up", [])]
    return (opened, True) if not status_file.unhealthy(document) else ([], False)
