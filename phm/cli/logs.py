"""`phm logs`: shows, follows and filters logs, and explains their lines. Implemented in `phm.logs`."""

from __future__ import annotations

import heapq
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from phm.cli.hold import Duration
from phm.cli.logs_bundle import bundle
from phm.cli.logs_collect import collect
from phm.cli.options import config_option, from_command_line, json_option, load_settings

if TYPE_CHECKING:
    from phm.logs.line_filter import LineFilter, TakeOff
    from phm.logs.reader import LogReader

POLL_S = 0.25
TAKE_OFF = "take-off"
KINDS = (
    *("ACTION", "BYPASS", "COMMAND", "DOCKER", "ESCALATED", "FAILURE", "FLIGHT", "HOLD"),
    *("NOTE", "PHM", "REPORT", "RESOLVED", "STALE", "SUCCESS", "WARNING"),
)
LEVELS = ("OK", "WARN", "ERROR", "STALE", "n/a")
_STYLES = {
    "SUCCESS": "green",
    "RESOLVED": "green",
    "WARNING": "yellow",
    "FAILURE": "bold red",
    "ESCALATED": "bold red",
    "STALE": "magenta",
    "ACTION": "cyan",
    "FLIGHT": "bold",
}
Json = Mapping[str, Any]


class _Since(click.ParamType):  # type: ignore[type-arg]
    """``take-off``, a duration before now, or a moment; gives the word, or UTC seconds."""

    name = "since"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        text = str(value).strip()
        if text == TAKE_OFF:
            return text
        try:
            moment = datetime.fromisoformat(f"{text[:-1]}+00:00" if text[-1:] in "Zz" else text)
            return (moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)).timestamp()
        except (ValueError, OverflowError):
            pass
        try:
            return time.time() - Duration().convert(text, param, ctx)
        except click.BadParameter:
            self.fail(
                f"{text!r}: must be take-off, a duration before now such as 90s, 10min or 2h, or a moment in UTC "
                "such as 2026-03-01T12:00:05",
                param,
                ctx,
            )


class WithTasks(click.Command):
    """`phm logs bundle FILE` is another command than `phm logs PATH`; a folder of that name is ``./bundle``."""

    requests: Mapping[str, click.Command] = {"bundle": bundle, "collect": collect}

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        task = self.requests.get(args[0]) if args else None
        if task is not None:
            return task.make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        if self.requests:
            with formatter.section("Other tasks"):
                formatter.write_dl([(name, one.get_short_help_str(90)) for name, one in self.requests.items()])


@click.command(cls=WithTasks, epilog="Example: phm logs -f --since take-off --unit 'nodes*'")
@click.argument("paths", metavar="[PATH]...", nargs=-1, type=click.Path(path_type=Path))
@config_option
@click.option("-f", "--follow", is_flag=True, help="Show new lines as they are written, until Ctrl-C.")
@click.option("--unit", "units", metavar="GLOB", multiple=True, help="Only matching units, e.g. 'nodes*'; repeatable.")
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    metavar="KIND",
    type=click.Choice(KINDS, case_sensitive=False),
    help="Only this kind of line, e.g. ACTION; repeatable.",
)
@click.option(
    "--level",
    "levels",
    multiple=True,
    metavar="LEVEL",
    type=click.Choice(LEVELS, case_sensitive=False),
    help="Only lines that give a unit this level, e.g. ERROR; repeatable.",
)
@click.option(
    "--since", metavar="WHEN", type=_Since(), help="take-off (of the last flight), 10min, or 2026-03-01T12:00 (UTC)."
)
@click.option("--agent", "agents", metavar="NAME|ID", multiple=True, help="Only this agent; repeatable.")
@click.option("--reports", is_flag=True, help="Also the lines of the regular reports.")
@click.option("--brief", is_flag=True, help="One line for each event, without its explanation.")
@json_option
def command(
    paths: tuple[Path, ...],
    config: str | None,
    follow: bool,
    units: tuple[str, ...],
    kinds: tuple[str, ...],
    levels: tuple[str, ...],
    since: str | float | None,
    agents: tuple[str, ...],
    reports: bool,
    brief: bool,
    as_json: bool,
) -> None:
    """Show, follow, collect or bundle logs, with explanations.

    PATH is a log, its directory, or a folder with the logs of several agents; without it, log.directory of the
    configuration. Rotated and compressed files are included; lines of several agents are in the order of their times.
    Exit code 0; 1: there is no log, or nothing in one can be read, or there is no flight in it.
    """
    from phm.logs import log_paths
    from phm.logs.line_filter import LineFilter

    given = paths or (Path(load_settings(config).log.directory),)
    since_s = since if isinstance(since, float) else None
    criteria = LineFilter(units, frozenset(kinds), frozenset(levels), agents, since_s, reports)
    try:
        logs = log_paths.readers(given, awaited=follow)
        gates = _take_offs(logs, awaited=follow) if since == TAKE_OFF else [None] * len(logs)
    except log_paths.NoLog as error:
        raise click.ClickException(str(error)) from None
    elsewhere = bool(paths) or from_command_line("config")
    show = _show_json if as_json else _Printer(brief, criteria, several=len(logs) > 1, elsewhere=elsewhere).show
    try:
        count = _print(logs, gates, criteria, show, follow=follow)
        while follow:
            time.sleep(POLL_S)
            _print(logs, gates, criteria, show, follow=True)
    except KeyboardInterrupt:
        return
    finally:
        _close(logs)
    if any(log.problems() and not log.any_read for log in logs):
        click.get_current_context().exit(1)
    if not count:
        click.echo("no line matches (regular reports are shown with --reports)", err=True)


def _take_offs(logs: Sequence[LogReader], *, awaited: bool) -> list[TakeOff | None]:
    """The gate of each log. Of a log without a flight nothing is shown; without any flight, raises NoLog.

    awaited: the logs are followed, so a log without a flight is shown from its first one on.
    """
    from phm.logs import line_filter, log_paths

    found = []
    for log in logs:
        first = log.again()
        found.append(line_filter.take_off(first))
        first.close()
    if awaited:
        if not any(found):
            click.echo("there is no flight in the log yet: waiting for take-off", err=True)
        return [gate or line_filter.TakeOff() for gate in found]
    if not any(found):
        raise log_paths.NoLog(
            "there is no flight in the log (the autopilot was not seen armed): leave out --since take-off"
        )
    return [gate or line_filter.NOTHING for gate in found]


def _print(
    logs: Sequence[LogReader], gates: Sequence[TakeOff | None], criteria: LineFilter, show: Any, *, follow: bool
) -> int:
    """Print what is new, in the order of time; how many events."""
    from phm.logs.line_filter import utc_s

    def chosen(log: LogReader, gate: TakeOff | None) -> Iterator[tuple[Json, bool, Path]]:
        for event in log.events(last=not follow):
            if gate is None or gate.takes(event):
                yield event, criteria.takes(event), log.path

    count = 0
    streams = [chosen(log, gate) for log, gate in zip(logs, gates, strict=True)]
    for event, wanted, path in heapq.merge(*streams, key=lambda one: utc_s(one[0])):
        show(event, wanted, path)
        count += wanted
    return count


def _show_json(event: Json, wanted: bool, path: Path) -> None:
    if wanted:
        click.echo(json.dumps(event, separators=(",", ":")))


class _Printer:
    """Prints events for people, with a line where numbers are missing.

    elsewhere: `phm faults` does not find the logs by itself, so the hints say where they are.
    """

    def __init__(self, brief: bool, criteria: LineFilter, several: bool, elsewhere: bool) -> None:
        from phm.cli import terminal
        from phm.logs.line_explainer import Explainer

        self._brief, self._criteria, self._several, self._elsewhere = brief, criteria, several, elsewhere
        self._explainer, self._console = Explainer(), terminal.console()

    def show(self, event: Json, wanted: bool, path: Path) -> None:
        from rich.text import Text

        from phm.wire.text import one_line

        missing = self._explainer.gap(event)
        if missing and self._criteria.covers(event):
            lines = "1 line is" if missing == 1 else f"{missing} lines are"
            self._put(Text(f"{lines} missing here: incomplete, or never written", "yellow"))
        if not wanted:
            return
        place = path.parent if path.name == "phm.jsonl" else path
        options = one_line(f" --log-dir {quote(str(place))}") if self._elsewhere else ""
        said = self._explainer.explain(event, options)
        if said.text:
            line = Text(f"{said.when} ", "dim")
            if self._several:
                line.append(f"{said.agent} ", "bold")
            line.append(said.kind, _STYLES.get(said.kind, ""))
            line.append(f" {said.text}", "")
            self._put(line)
        for label, text in () if self._brief else said.details:
            self._put(Text(f"    {label}: {text}", "dim"))

    def _put(self, line: Any) -> None:
        self._console.print(line, soft_wrap=True)


def _close(logs: Sequence[LogReader]) -> None:
    """Close, and say what could not be read."""
    for log in logs:
        log.close()
        for problem in log.problems():
            click.echo(problem, err=True)
