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
MAX_CHOICES = 100
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
        self._alarms = Alarms(station.expected)
        self._selected = ""
        self._menu: OperatorCommand | None = None
        """The chosen command of the menu; None: it is closed."""
        self._choices: dict[OperatorCommand, str] = {}
        """The lines of the open menu as last drawn. None moves or goes away, so that a key means what the screen shows."""

    def run(self, stop: threading.Event, end: float | None, console: Console) -> None:
        """Show the table and update it in place until `stop` is set, the clock is at `end`, or `q` is pressed."""
        with (
            Keyboard(self._clock, stop) as keyboard,
            Live(self.draw(console), console=console, screen=True, auto_refresh=False) as live,
        ):
            while not stop.is_set() and (end is None or self._clock.mono() < end):
                keys = keyboard.read(REDRAW_S)
                if self.handle_keys(keys):
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
                exchange.receive(item.event, now)
            if text := describe(item.event):
                self._lines.append((item.event.at.mono, text))
        for exchange in [one for one in self._exchanges if one.done(now)]:
            self._exchanges.remove(exchange)
            if exchange.command.has_reply or not exchange.accepted:
                self._answers.append((now, exchange.answer()))
        return rings

    def handle_keys(self, keys: list[str]) -> bool:
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
        """Draw the table. active: keys are read."""
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
            self._open_menu(agent)

    def _open_menu(self, agent: Json) -> None:
        """A list of containers from before may be out of date."""
        command = operator.list_containers()
        if not self._waiting_for(agent, command):
            self._station.forget_containers(agent["agent"], agent["component"])
            if agent["presence"] in ("alive", "late"):
                self._request(agent, command)
        self._choices = {}
        self._update_choices(self._agent() or agent)
        self._menu = next(iter(self._choices))

    def _update_choices(self, agent: Json) -> None:
        """Update the choices of the menu; new ones are added at its end."""
        for text, command in operator.menu(agent):
            if command in self._choices or len(self._choices) < MAX_CHOICES:
                self._choices[command] = text

    def _choose_action(self, key: str) -> None:
        agent = self._agent()
        command = self._menu
        if agent is None or command is None or key == "escape":
            self._menu = None
        elif key in ("up", "down"):
            lines = list(self._choices)
            self._menu = lines[(lines.index(command) + (1 if key == "down" else -1)) % len(lines)]
        elif key == "enter":
            self._menu = None
            if command in _available(agent):
                self._request(agent, command)
            else:
                self._answer(f"{agent['name']} {command.text}: not sent, it is no longer available")

    def _request(self, agent: Json, command: OperatorCommand) -> None:
        about = f"{agent['name']} {command.text}"
        if self._station.silent:
            self._answer("--silent: nothing can be sent")
            return
        if agent["presence"] not in ("alive", "late"):
            self._answer(f"{about}: not sent, the agent is {agent['presence']}")
            return
        if (earlier := self._waiting_for(agent, command)) is not None:
            self._answer(f"{about}: not sent, still waiting for the answer to {earlier.command.text}")
            return

        def send(confirmation: int, nonce: float) -> None:
            self._station.command(agent["agent"], agent["component"], command, confirmation, nonce, agent["link"] or "")

        self._exchanges.append(Exchange(agent["name"], command, send, self._clock.mono()))

    def _waiting_for(self, agent: Json, command: OperatorCommand) -> Exchange | None:
        """What must be answered before this command can be sent."""
        return next((one for one in self._exchanges if one.blocks(agent["name"], command)), None)

    def _answer(self, text: str) -> None:
        self._answers.append((self._clock.mono(), text))

    def _agents(self) -> list[Json]:
        return list(self._station.snapshot()[1].body["agents"])

    def _agent(self) -> Json | None:
        return next((agent for agent in self._agents() if agent["name"] == self._selected), None)

    # ------------------------------------------------------------ lines

    def _dialog(self, now: float, *, active: bool) -> list[str]:
        """The lines about alarms, answers, and what the keys do."""
        lines = [text] if (text := self._alarms.text()) else []
        agent = self._agent() if self._menu is not None else None
        if agent is not None:
            lines.append(f"{agent['name']}:   {MENU_KEYS}")
            self._update_choices(agent)
            available = _available(agent)
            for command, text in self._choices.items():
                over = "" if command in available else " (no longer available)"
                lines.append(f"{'>' if command == self._menu else ' '} {text}{over}")
        elif active:
            lines.append(KEYS)
        lines += [
            f"{one.name} {one.command.text}: sent, no answer yet" for one in self._exchanges if one.command.has_reply
        ]
        return lines + [text for at, text in self._answers if now - at <= ANSWER_SHOWN_S]


def _available(agent: Json) -> set[OperatorCommand]:
    """The requests that the selected agent can receive now."""
    return {command for _, command in operator.menu(agent)}


def _agent_of(event: GcsEvent) -> str:
    """Name of the agent that a line of text is about."""
    body = event.body
    number, component = body.get("agent") or body.get("system", 0), body.get("component", PHM_COMPONENT)
    relayed = number != body.get("system")
    return agent_name(number) + ("" if component == PHM_COMPONENT or relayed else f"/{component}")
