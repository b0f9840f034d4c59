"""The live table and its keys: choose an agent, request something of it, acknowledge alarms."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from rich.console import Console, RenderableType
from rich.live import Live

from phm.core.clock import Clock
from phm.gcs import operator, table
from phm.gcs.agent import PHM_COMPONENT
from phm.gcs.alarms import Alarms
from phm.gcs.events import GcsEvent, describe
from phm.gcs.keyboard import Keyboard
from phm.gcs.operator import Exchange, OperatorCommand
from phm.gcs.station import GroundStation
from phm.gcs.subscriber_queue import SubscriberQueue
from phm.wire.status_line import agent_name

REDRAW_S = 0.5
KEPT_LINES, KEPT_ANSWERS = 20, 3
ANSWER_SHOWN_S = 60.0
KEYS = "up/down: choose an agent   Enter: actions   a: acknowledge   q: quit"
MENU_KEYS = "up/down: choose   Enter: send the request   Esc: back"

Json = Mapping[str, Any]


class LiveView:
    """Runs in the calling thread. notes: messages about the program itself."""

    def __init__(self, station: GroundStation, clock: Clock, notes: Callable[[], list[str]]) -> None:
        self._station, self._clock, self._notes = station, clock, notes
        self._queue = SubscriberQueue(clock)
        station.subscribe(self._queue)
        self._lines: deque[tuple[float, str]] = deque(maxlen=KEPT_LINES)
        self._answers: deque[tuple[float, str]] = deque(maxlen=KEPT_ANSWERS)
        self._exchanges: list[Exchange] = []
        self._alarms = Alarms()
        self._selected = ""
        self._menu: int | None = None
        """The chosen line of the menu; None: it is closed."""

    def run(self, stop: threading.Event, end: float | None, console: Console) -> None:
        """Show the table and update it in place until `stop` is set, the clock is at `end`, or `q` is pressed."""
        with (
            Keyboard(self._clock, stop) as keyboard,
            Live(self.draw(console), console=console, screen=True, auto_refresh=False) as live,
        ):
            while not stop.is_set() and (end is None or self._clock.mono() < end):
                keys = keyboard.read(REDRAW_S)
                if self.turn(keys):
                    return
                if self.events():
                    console.bell()
                live.update(self.draw(console, active=keyboard.active), refresh=True)

    def events(self) -> bool:
        """Take the new events; whether one of them is a new CRITICAL line."""
        now, rings = self._clock.mono(), False
        for item in self._queue.take(0.0):
            rings |= self._alarms.take(item.event, _agent_of(item.event))
            for exchange in self._exchanges:
                exchange.hear(item.event, now)
            if text := describe(item.event):
                self._lines.append((item.event.at.mono, text))
        for exchange in [one for one in self._exchanges if one.done(now)]:
            self._exchanges.remove(exchange)
            if exchange.command.has_reply or not exchange.accepted:
                self._answers.append((now, exchange.answer()))
        return rings

    def turn(self, keys: list[str]) -> bool:
        """Handle the keys; whether the program is to end."""
        for key in keys:
            if key == "q":
                return True
            if key == "a":
                self._alarms.acknowledge()
            elif self._menu is None:
                self._choose_agent(key)
            else:
                self._choose_action(key)
        return False

    def draw(self, console: Console, *, active: bool = False) -> RenderableType:
        """active: keys are read."""
        now, body = self._clock.mono(), self._station.snapshot()[1].body
        lines = [f"{table.ago(max(0.0, now - at)):>10}  {text}" for at, text in self._lines]
        return table.render(
            body,
            lines,
            width=console.width,
            height=console.height,
            notes=self._notes(),
            selected=self._selected,
            alarms=self._alarms.names,
            dialog=self._dialog(now, active=active),
        )

    # ------------------------------------------------------------ keys

    def _choose_agent(self, key: str) -> None:
        names = [agent["name"] for agent in self._agents()]
        if key == "escape":
            self._selected = ""
        elif key in ("up", "down") and names:
            known = self._selected in names
            step = 1 if key == "down" else -1
            place = (names.index(self._selected) + step) % len(names) if known else 0 if step > 0 else -1
            self._selected = names[place]
        elif key == "enter" and (agent := self._agent()) is not None:
            self._menu = 0
            if agent["presence"] in ("alive", "late"):
                self._request(agent, operator.list_containers())

    def _choose_action(self, key: str) -> None:
        agent = self._agent()
        choices = operator.menu(agent) if agent is not None else []
        if agent is None or key == "escape":
            self._menu = None
        elif key in ("up", "down"):
            self._menu = ((self._menu or 0) + (1 if key == "down" else -1)) % len(choices)
        elif key == "enter":
            command = choices[min(self._menu or 0, len(choices) - 1)][1]
            self._menu = None
            self._request(agent, command)

    def _request(self, agent: Json, command: OperatorCommand) -> None:
        now = self._clock.mono()
        if self._station.silent:
            self._answers.append((now, "--silent: nothing can be sent"))
            return
        if agent["presence"] not in ("alive", "late"):
            self._answers.append((now, f"{agent['name']} {command.text}: not sent, the agent is {agent['presence']}"))
            return

        def send(confirmation: int) -> None:
            self._station.command(agent["agent"], agent["component"], command, confirmation, agent["link"] or "")

        self._exchanges.append(Exchange(agent["name"], command, send, now))

    def _agents(self) -> list[Json]:
        return list(self._station.snapshot()[1].body["agents"])

    def _agent(self) -> Json | None:
        return next((agent for agent in self._agents() if agent["name"] == self._selected), None)

    # ------------------------------------------------------------ lines

    def _dialog(self, now: float, *, active: bool) -> list[str]:
        """Alarms, answers, and what the keys do."""
        lines = [text] if (text := self._alarms.text()) else []
        agent = self._agent() if self._menu is not None else None
        if agent is not None:
            lines.append(f"{agent['name']}:   {MENU_KEYS}")
            choices = operator.menu(agent)
            chosen = min(self._menu or 0, len(choices) - 1)
            lines += [f"{'>' if place == chosen else ' '} {text}" for place, (text, _) in enumerate(choices)]
        elif active:
            lines.append(KEYS)
        lines += [
            f"{one.name} {one.command.text}: sent, no answer yet" for one in self._exchanges if one.command.has_reply
        ]
        return lines + [text for at, text in self._answers if now - at <= ANSWER_SHOWN_S]


def _agent_of(event: GcsEvent) -> str:
    """Name of the agent that a line of text is about."""
    body = event.body
    number, component = body.get("agent") or body.get("system", 0), body.get("component", PHM_COMPONENT)
    relayed = number != body.get("system")
    return agent_name(number) + ("" if component == PHM_COMPONENT or relayed else f"/{component}")
