"""`phm gcs`: the status of all agents at a ground station, live, recorded and served. Implemented in `phm.gcs`."""

from __future__ import annotations

import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

import click

from phm.cli.gcs_options import link_options, link_settings, make_station, running
from phm.cli.gcs_requests import REQUESTS
from phm.cli.gcs_web import WebChoice, make_parts, show_record
from phm.cli.web_options import address, web_options
from phm.core import threads
from phm.core.signals import Signals

ONCE_S = 5.0
POLL_S = 0.2


def _agents(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[int, ...]:
    """The agents of a text such as ``1,2,5-8``."""
    found: set[int] = set()
    for piece in (value or "").split(",") if value else ():
        first, dash, last = piece.strip().partition("-")
        if not first.isdecimal() or not (last.isdecimal() if dash else True):
            raise click.BadParameter(f"{piece!r} is not a list of agents: ids are 1 to 250, e.g. 1,2,5-8")
        ids = range(int(first), int(last or first) + 1)
        if not ids or ids[0] < 1 or ids[-1] > 250:
            raise click.BadParameter(f"{piece!r} is not a list of agents: ids are 1 to 250, e.g. 1,2,5-8")
        found.update(ids)
    return tuple(sorted(found))


class WithRequests(click.Command):
    """`phm gcs approve A05` is another command than `phm gcs URL`: a URL never equals the name of a request."""

    requests = REQUESTS

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        request = self.requests.get(args[0]) if args else None
        if request is not None:
            return request.make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Requests to an agent"):
            formatter.write_dl([(name, one.get_short_help_str(90)) for name, one in self.requests.items()])


@click.command(cls=WithRequests, epilog="Example, beside QGroundControl and MAVProxy: phm gcs udpin:127.0.0.1:14551")
@click.argument("urls", metavar="[URL]...", nargs=-1)
@link_options(default_id=254)
@click.option(
    "--silent",
    is_flag=True,
    help="Receive only: send nothing, not even heartbeats. ArduPilot then forwards nothing to this port.",
)
@click.option(
    "--pilot",
    is_flag=True,
    help="Count as the pilot's ground station: agents report it as lost when it falls silent.",
)
@click.option(
    "--expect",
    metavar="IDS",
    callback=_agents,
    help="Agents to report as missing even if never received, e.g. 1,2,5-8.",
)
@click.option("--record", type=click.Path(dir_okay=False), help="Append every event to this file as JSON lines.")
@click.option("--serve", metavar="[HOST:]PORT", callback=address, help="Serve the events to other programs over HTTP.")
@web_options("all agents")
@click.option(
    "--history",
    metavar="FILE",
    type=click.Path(dir_okay=False),
    help="Where the page keeps its history; none: until phm gcs ends.  [default: phm/gcs-history.db in $XDG_STATE_HOME]",
)
@click.option(
    "--replay", metavar="RECORD", type=click.Path(dir_okay=False), help="Show a file of --record on the page of --web."
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 1000),
    help="Speed of --replay; the page can change it.  [default: 1]",
)
@click.option(
    "--edit",
    metavar="FILE",
    multiple=True,
    type=click.Path(exists=True, dir_okay=False),
    help="Configuration on this computer that the page may write; repeatable.",
)
@click.option(
    "--deliver",
    metavar="FILE HOST:PORT KEY",
    nargs=3,
    multiple=True,
    help="Let the page send FILE, one of --edit, to the agent that listens at HOST:PORT; KEY: file with its key; repeatable.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print events as JSON lines; with --once the status of all agents as one object.",
)
@click.option("--once", is_flag=True, help="Listen for a while, print the status of all agents, and exit.")
@click.option(
    "--for",
    "seconds",
    metavar="SECONDS",
    type=click.FloatRange(min=0, min_open=True),
    help=f"Exit after this time.  [default: {ONCE_S:g} with --once, else never]",
)
@click.pass_context
def command(
    ctx: click.Context,
    urls: tuple[str, ...],
    baud: int,
    system: int,
    silent: bool,
    pilot: bool,
    key: str | None,
    unsigned: str,
    expect: tuple[int, ...],
    record: str | None,
    serve: tuple[str, int] | None,
    web: tuple[str, int] | None,
    token_file: str | None,
    tls_cert: str | None,
    tls_key: str | None,
    behind_proxy: bool,
    history: str | None,
    replay: str | None,
    speed: float | None,
    edit: tuple[str, ...],
    deliver: tuple[tuple[str, str, str], ...],
    as_json: bool,
    once: bool,
    seconds: float | None,
) -> None:
    """Show the status of all agents, as received by a ground station.

    Connects to the MAVLink network and discovers the agents by their messages. URL as in `mavlink.endpoints` of the configuration:
    udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, /dev/ttyUSB0 and so on; default: udpin:0.0.0.0:14551. On a terminal it
    shows a live table (arrow keys and Enter: request something of an agent), otherwise one line per event.

    Exit code 0; 1: a port is in use, or the record is incomplete; with --once also when an agent is in ERROR, lost or never
    received, or no agent was found.
    """
    from phm.cli import terminal
    from phm.core.clock import SystemClock
    from phm.gcs.console import ConsoleView
    from phm.gcs.live import LiveView
    from phm.gcs.recorder import Recorder

    choice = WebChoice(web, serve, token_file, tls_cert, tls_key, behind_proxy, history, edit, deliver)
    clock = SystemClock()
    if replay is not None:
        if urls or record or once or as_json:
            raise click.UsageError(
                "--replay shows a record: it cannot be used with a URL, --record, --once and --json."
            )
        with _ending() as stop:
            show_record(replay, speed or 1.0, choice, lambda: clock.wait(stop, seconds))
        return
    if speed is not None:
        raise click.UsageError("--speed needs --replay.")
    choice.check()
    clock.measure()
    station = make_station(link_settings(urls, baud, key, unsigned), system, clock, expect, silent=silent, pilot=pilot)
    book = Recorder(record, station, clock) if record else None
    parts = [*make_parts(choice, station, clock), *([book] if book is not None else [])]

    def notes() -> list[str]:
        return [part.about() for part in parts if part.about()]

    def warn(text: str) -> None:
        click.echo(text, err=True)

    good = True
    with _ending() as stop:
        show, console = ConsoleView(station, clock, _patient(stop), notes, warn), terminal.console()
        with running(station, parts):
            limit_s = seconds if seconds is not None else ONCE_S if once else None
            end = None if limit_s is None else clock.mono() + limit_s
            if once:
                clock.wait(stop, limit_s)
                good = show.once(console, as_json=as_json)
            elif as_json or not console.is_terminal:
                show.lines(stop, end, as_json=as_json)
            else:
                LiveView(station, clock, notes).run(stop, end, console)
        if as_json and not once:
            show.rest(0.0, as_json=True)
    if book is not None and book.about():
        warn(book.about())
        good = False
    ctx.exit(0 if good else 1)


def _patient(stop: threading.Event) -> Callable[[str], None]:
    """Prints a line; gives up when the program is to exit while its output is not read."""

    def echo(text: str) -> None:
        # Windows cannot ask whether output is read.
        with suppress(OSError, ValueError):  # not a file: tests of the command line
            while (
                sys.platform != "win32" and not select.select([], [sys.stdout], [], 0.0 if stop.is_set() else POLL_S)[1]
            ):
                if stop.is_set():
                    return
        click.echo(text)

    return echo


@contextmanager
def _ending() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set, for an orderly exit; a second signal exits immediately."""
    stop, over = threading.Event(), threading.Event()
    seen: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        if len(seen) > 1:
            raise KeyboardInterrupt

    def follow(signals: Signals) -> None:
        while not over.is_set():
            if signals.wait(POLL_S):
                stop.set()

    with Signals(signal.SIGTERM, signal.SIGINT, handler=end) as signals:
        thread = threading.Thread(target=follow, args=(signals,), name="phm-gcs-signals", daemon=True)
        threads.start(thread)
        try:
            yield stop
        finally:
            over.set()
            threads.join(thread, 2 * POLL_S)
