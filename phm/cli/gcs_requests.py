"""`phm gcs approve`, `restart` and `check`: one request to one agent, and its answer."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from phm.cli.gcs_options import DEFAULT_URL, link_options, link_settings, make_station, running
from phm.cli.options import json_option

if TYPE_CHECKING:
    from phm.core.clock import Clock
    from phm.gcs.operator import Exchange, OperatorCommand
    from phm.gcs.station import GroundStation
    from phm.gcs.subscriber_queue import SubscriberQueue

FOUND_S = 10.0
ADVICE_S = 8.0
"""An agent sends its full state to a new ground station within this time, unless several stations have just appeared."""
AFTER_S = 2.0
POLL_S = 0.1
_AGENT = re.compile(r"[Aa]?0*([1-9][0-9]{0,2})")
_FAULT = re.compile(r"(?:#|\S+-)?([0-9]{1,9})")

Json = Mapping[str, Any]
F = TypeVar("F", bound=Callable[..., Any])


class _Agent(click.ParamType):  # type: ignore[type-arg]
    """An agent, given as ``A05``, ``a5`` or ``5``."""

    name = "agent"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        found = _AGENT.fullmatch(str(value))
        if found is None or int(found[1]) > 250:
            self.fail(f"{value!r} is not an agent: write its name in the table or its id, e.g. A05 or 5", param, ctx)
        return int(found[1])


def _request_options(function: F) -> F:
    """Add the options that say where to find the agents."""
    options = [
        click.option(
            "--url",
            "urls",
            metavar="URL",
            multiple=True,
            help=f"Where the agents are received, as for `phm gcs`; repeatable.  [default: {DEFAULT_URL}]",
        ),
        link_options(default_id=253),
        click.option(
            "--for",
            "seconds",
            metavar="SECONDS",
            type=click.FloatRange(min=0),
            default=AFTER_S,
            show_default=True,
            help="After the answer, print the lines of the agent for this time.",
        ),
        json_option,
    ]
    for option in reversed(options):
        function = option(function)
    return function


@click.command(epilog="Example: phm gcs approve A05 17")
@click.argument("agent", type=_Agent())
@click.argument("fault", required=False)
@_request_options
@click.pass_context
def approve(ctx: click.Context, /, agent: int, fault: str | None, **options: Any) -> None:
    """Approve the action that an agent advises: `A05 ADVISE 2 restart ros_app #17 60s`.

    FAULT is the number behind the #; it can be left out if one action is advised. An approval is valid for the time at the end
    of the line: if the action is not possible within it, it must be approved again. Exit code 0; 1: refused, or no answer.
    """
    from phm.gcs import operator

    def choose(client: _Client) -> OperatorCommand:
        if fault is None:
            return client.only_advice()
        found = _FAULT.fullmatch(fault)
        if found is None:
            raise click.UsageError(f"{fault!r} is not the number of a fault: write 17, #17 or the fault's id")
        return operator.approve(int(found[1]))

    ctx.exit(_run(agent, choose, **options))


@click.command(epilog="Example: phm gcs restart A05 ros_app")
@click.argument("agent", type=_Agent())
@click.argument("container")
@_request_options
@click.pass_context
def restart(ctx: click.Context, /, agent: int, container: str, **options: Any) -> None:
    """Restart a container of an agent.

    CONTAINER is its name or alias in the configuration of the agent, or its position there, from 1. The agent applies its own
    rules: `recover: true`, arming, budget. Exit code 0; 1: refused, or no answer.
    """
    ctx.exit(_run(agent, lambda client: client.container(container), **options))


@click.command(epilog="Example: phm gcs check A05")
@click.argument("agent", type=_Agent())
@_request_options
@click.pass_context
def check(ctx: click.Context, /, agent: int, **options: Any) -> None:
    """Have an agent run all its checks now.

    Exit code 0; 1: refused, or no answer.
    """
    from phm.gcs import operator

    ctx.exit(_run(agent, lambda client: operator.run_checks(), **options))


REQUESTS: dict[str, click.Command] = {"approve": approve, "restart": restart, "check": check}


class _Client:
    """Sends requests to one agent."""

    def __init__(self, station: GroundStation, queue: SubscriberQueue, clock: Clock, agent: int) -> None:
        self._station, self._queue, self._clock, self._agent = station, queue, clock, agent
        self._never = threading.Event()
        self.lines: list[str] = []
        self._advised = self._complete = False
        """Advice was received; and since the last one a refresh, with which an agent's full state ends."""

    def find(self) -> None:
        """Wait until the agent is received. Raises ClickException."""
        if not self._until(lambda: self._there() is not None, FOUND_S):
            raise click.ClickException(
                f"agent {self._agent} was not received within {FOUND_S:g} s: is it switched on, and are its frames "
                "forwarded to this port? `phm gcs` shows who is received (docs/reference/gcs.md)"
            )

    def only_advice(self) -> OperatorCommand:
        """Wait for the full state of the agent: a radio may send a second action seconds after the first.

        Raises ClickException.
        """
        from phm.gcs import operator

        self._until(lambda: bool(self._row()["advice"]), ADVICE_S)
        if self._row()["advice"]:
            self._until(lambda: self._complete or len(self._row()["advice"]) > 1, ADVICE_S)
        row = self._row()
        name, advice = row["name"], row["advice"]
        if not advice:
            raise click.ClickException(f"no recommended action of {name} was received: if it has one, give its number")
        numbers = "; ".join(f"{one['fault']}: {one['action']} {one['target']}" for one in advice)
        if len(advice) > 1:
            raise click.UsageError(f"{name} advises several actions, choose one by its number: {numbers}")
        if not self._complete:
            raise click.UsageError(
                f"{name} may advise more than has arrived, choose the action by its number: {numbers}"
            )
        return operator.approve(advice[0]["fault"], f"{advice[0]['action']} {advice[0]['target']}".strip())

    def container(self, name: str) -> OperatorCommand:
        from phm.gcs import operator

        if name.isdecimal() and int(name) > 0:
            return operator.restart(int(name))
        listed = self.send(operator.list_containers())
        if not listed.accepted:
            raise click.ClickException(f"{listed.answer()}; give the position of the container instead of its name")
        self._until(lambda: bool(self._row()["containers"]), ADVICE_S)
        known = self._row()["containers"]
        if name not in known:
            raise click.ClickException(f"{self._row()['name']} has no container {name!r}: it has {', '.join(known)}")
        return operator.restart(known.index(name) + 1, name)

    def send(self, command: OperatorCommand) -> Exchange:
        """Send a command and wait for its answer."""
        from phm.gcs.operator import Exchange

        row = self._row()

        def transmit(confirmation: int, nonce: float) -> None:
            self._station.command(row["agent"], row["component"], command, confirmation, nonce, row["link"] or "")

        exchange = Exchange(row["name"], command, transmit, self._clock.mono())
        while not exchange.done(self._clock.mono()):
            self._take(exchange)
        return exchange

    def follow(self, seconds: float, echo: Callable[[str], None]) -> None:
        """Print the lines of the agent."""
        end, shown = self._clock.mono() + seconds, 0
        while True:
            for line in self.lines[shown:]:
                echo(line)
            shown = len(self.lines)
            if self._clock.mono() >= end:
                return
            self._take()

    def _take(self, exchange: Exchange | None = None) -> None:
        for item in self._queue.take(POLL_S):
            body = item.event.body
            if exchange is not None:
                exchange.receive(item.event, self._clock.mono())
            if item.event.event != "text" or body.get("agent") != self._agent:
                continue
            if body.get("kind") == "change":
                self.lines.append(body["text"])
            if body.get("word") == "ADVISE":
                self._advised, self._complete = True, False
            elif body.get("kind") == "refresh":
                self._complete = self._advised

    def _until(self, found: Callable[[], bool], limit_s: float) -> bool:
        end = self._clock.mono() + limit_s
        while not found():
            if self._clock.mono() >= end:
                return False
            self._take()
        return True

    def _there(self) -> Json | None:
        rows = self._station.snapshot()[1].body["agents"]
        return next((row for row in rows if row["agent"] == self._agent and row["presence"] in ("alive", "late")), None)

    def _row(self) -> Json:
        row = self._there()
        if row is None:
            raise click.ClickException(f"agent {self._agent} is no longer received")
        return row


def _run(
    agent: int,
    choose: Callable[[_Client], OperatorCommand],
    *,
    urls: tuple[str, ...],
    baud: int,
    system: int,
    key: str | None,
    unsigned: str,
    seconds: float,
    as_json: bool,
) -> int:
    """Send the request and print the answer; the exit code."""
    from phm.core.clock import SystemClock
    from phm.gcs.subscriber_queue import SubscriberQueue

    clock = SystemClock()
    station = make_station(link_settings(urls, baud, key, unsigned), system, clock)
    queue = SubscriberQueue(clock)
    station.subscribe(queue)
    with running(station):
        client = _Client(station, queue, clock, agent)
        client.find()
        command = choose(client)
        client.lines.clear()
        exchange = client.send(command)
        if not as_json:
            click.echo(exchange.answer())
        client.follow(seconds, (lambda line: None) if as_json else click.echo)
    if as_json:
        answer = {"agent": agent, "request": command.text, "result": exchange.result, "text": exchange.reply}
        click.echo(json.dumps({**answer, "lines": client.lines}, indent=2))
    return 0 if exchange.accepted else 1
