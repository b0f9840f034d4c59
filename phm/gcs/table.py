"""The live table: agents by slots, from the same JSON that programs get. Levels are letters as well as colours.

It fits 80 columns; from WIDE columns on, each slot has a column with its name. A text that does not fit is cut in the table and is
complete in the lines below it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from phm.core.model import Slot
from phm.wire.text import one_line

Json = Mapping[str, Any]
SLOTS = tuple(str(number) for number in range(1, 16))
GAPS = ("8", "12")
"""A blank follows these slots: mission, environment of the agent, user-defined."""
HEADER = "12345678 9012 345"
NAMES = " ".join(slot.short for slot in Slot)
WIDE = 120
LEGEND = "+ ok  W warn  E error  - unknown or unused  ? not received"
_CELLS = {"OK": ("+", "green"), "WARN": ("W", "bold yellow"), "ERROR": ("E", "bold white on red")}
_NOT_KNOWN, _NOT_RECEIVED = ("-", "dim"), ("?", "magenta")
_STYLES = {
    "OK": "green",
    "WARN": "yellow",
    "ERROR": "bold red",
    "STALE": "magenta",
    "HOLD": "cyan",
    "BOOT": "cyan",
    "LOST": "bold red",
    "LEFT": "dim",
    "UNKNOWN": "magenta",
}
_GRAVITY = ("ERROR", "LOST", "WARN", "UNKNOWN", "STALE", "HOLD", "BOOT", "LEFT", "OK")
_OTHERS = 8
"""Lines beside the rows of agents: header, legend, swarm, links, problems."""


def render(
    snapshot: Json,
    events: Sequence[str] = (),
    *,
    width: int = 80,
    height: int | None = None,
    notes: Sequence[str] = (),
    selected: str = "",
    alarms: Collection[str] = (),
    dialog: Sequence[str] = (),
) -> Group:
    """The table, its header and the lines below it.

    events: the newest lines, oldest first. width, height: columns and rows of the terminal, height None for no limit. notes: messages
    about the program. selected: name of the agent to mark. alarms: names of agents with a CRITICAL line that is not acknowledged.
    dialog: lines about requests of the operator.
    """
    agents = list(snapshot["agents"])
    others = _OTHERS + len(dialog) + min(len(events), 5)
    shown, left = _choose(agents, None if height is None else max(1, height - others), selected)
    table = _agents(shown, wide=width >= WIDE, selected=selected, alarms=alarms)
    parts: list[RenderableType] = [_head(snapshot), table]
    if left:
        parts.append(_plain(f"and {len(left)} more: {_counts(left)}", "dim"))
    parts.append(Text(LEGEND, "dim"))
    parts += _below(snapshot, notes)
    parts += [_plain(line, crop=True) for line in dialog]
    room = len(events) if height is None else max(0, height - len(shown) - len(parts) - 2)
    parts += [_plain(line, "dim", crop=True) for line in (events[-room:] if room else ())]
    return Group(*parts)


def _choose(agents: list[Json], room: int | None, selected: str = "") -> tuple[list[Json], list[Json]]:
    """The agents to show and the others: where not all fit, the selected and the worst are shown, in their order."""
    if room is None or len(agents) <= room:
        return agents, []

    def rank(place: int) -> tuple[bool, int, int]:
        agent = agents[place]
        return agent["name"] != selected, _GRAVITY.index(agent["how"]), place

    ranked = sorted(range(len(agents)), key=rank)
    chosen = set(ranked[:room])
    return [agents[place] for place in sorted(chosen)], [agents[place] for place in ranked[room:]]


def _head(snapshot: Json) -> Text:
    agents = snapshot["agents"]
    received = "no agent received yet" if not agents else f"{len(agents)} agents: {_counts(agents)}"
    return _plain(f"phm gcs {snapshot['system']}/{snapshot['component']}  {received}", "bold", crop=True)


def _counts(agents: Sequence[Json]) -> str:
    hows = [agent["how"] for agent in agents]
    return ", ".join(f"{hows.count(how)} {how}" for how in _GRAVITY if how in hows)


def _agents(agents: Sequence[Json], *, wide: bool, selected: str, alarms: Collection[str]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 1, 0, 0), expand=True)
    header = NAMES if wide else HEADER
    for name, width in (("agent", None), (header, len(header)), ("is", 7), ("age", 4), ("fc", 4)):
        table.add_column(name, no_wrap=True, min_width=width)
    table.add_column("broken at", no_wrap=True, overflow="ellipsis", ratio=2)
    table.add_column("last line", no_wrap=True, overflow="ellipsis", ratio=3)
    for agent in agents:
        how = str(agent["how"])
        table.add_row(
            _name(agent, selected, alarms),
            cells(agent, wide=wide),
            Text(how, _STYLES.get(how, "")),
            _age(agent),
            _autopilot(agent),
            _hop(agent),
            _line(agent),
        )
    return table


def _name(agent: Json, selected: str, alarms: Collection[str]) -> Text:
    """The selected one is in reverse, and one with an alarm that is not acknowledged has an exclamation mark."""
    alarm = agent["name"] in alarms
    style = f"bold {'red ' if alarm else ''}{'reverse' if agent['name'] == selected else ''}".strip()
    return _plain(f"{agent['name']}{'!' if alarm else ''}", style)


def cells(agent: Json, *, wide: bool = False) -> Text:
    """A letter for each slot; wide: below the name of its column."""
    text = Text()
    received = agent["presence"] in ("alive", "late")
    for slot in SLOTS:
        known = _CELLS.get(agent["slots"].get(slot, ""), _NOT_KNOWN)
        letter, style = known if received else _NOT_RECEIVED
        if wide:
            text.append(f" {letter} ", style)
            text.append(" " if slot != SLOTS[-1] else "")
        else:
            text.append(letter, style)
            text.append(" " if slot in GAPS else "")
    return text


def age(seconds: float | None) -> str:
    """``3s``, ``12m``, ``5h``, ``9d``; ``?`` when there is none."""
    if seconds is None:
        return "?"
    for size, unit in ((60, "s"), (3600, "m"), (86400, "h")):
        if seconds < size:
            return f"{int(seconds // (size / 60 if unit != 'h' else 3600))}{unit}"
    return f"{int(seconds // 86400)}d"


def ago(seconds: float | None) -> str:
    """``3 s ago``, ``12 min ago``, ``5 h ago``, ``9 d ago``; empty when there is none."""
    short = age(seconds)
    return "" if seconds is None else f"{short[:-1]} {'min' if short[-1] == 'm' else short[-1]} ago"


def _age(agent: Json) -> Text:
    styles = {"alive": "", "late": "yellow", "left": "dim"}
    return Text(age(agent["age_s"]), styles.get(agent["presence"], "bold red"))


def _autopilot(agent: Json) -> Text:
    """The state of the vehicle's autopilot."""
    autopilot = agent["autopilot"]
    if autopilot is None:
        return Text("?", "dim")
    if autopilot["presence"] == "lost":
        return Text("lost", "bold red")
    return Text("ARM", "bold cyan") if autopilot["armed"] else Text("dis", "dim")


def _hop(agent: Json) -> Text:
    hop = agent["hop"]
    if hop is None:
        return Text("")
    return _plain(
        f"{hop['name']}{'' if hop['certain'] else '?'}: {hop['evidence']}", "red" if hop["certain"] else "yellow"
    )


def _line(agent: Json) -> Text:
    if agent["problem"]:
        return _plain(agent["problem"], "yellow")
    line = agent["line"]
    if line is None:
        says = agent["swarm_says"]
        return Text(f"by swarm: {says}", "dim") if says else Text("")
    if agent["presence"] not in ("alive", "late") and not line["via"]:
        # It is no longer true, or not known to be.
        return _plain(f"{ago(line['age_s'])}: {line['text'].removeprefix(agent['name'] + ' ')}", "dim")
    return _plain(line["text"].removeprefix(f"{agent['name']} "), "" if line["severity"] > 4 else "yellow")


def _below(snapshot: Json, notes: Sequence[str]) -> list[RenderableType]:
    """The swarm, the links, other ground stations, and problems of the ground station itself."""
    parts: list[RenderableType] = []
    swarm = snapshot["swarm"]
    if swarm and swarm["line"]:
        parts.append(_plain(f"{swarm['line']}  (A{swarm['by']:02d}, {ago(swarm['line_age_s'])})", "", crop=True))
    links = [f"{one['link']} {'open' if one['open'] else one['error']}" for one in snapshot["links"]]
    others = [f"{one['system']}/{one['component']}" for one in snapshot["stations"]]
    closed = bool(snapshot["links"]) and not all(one["open"] for one in snapshot["links"])
    words = f"links: {', '.join(links) or 'opening'}; other ground stations: {', '.join(others) or 'none'}"
    parts.append(_plain(words, "yellow" if closed else "dim", crop=True))
    parts += [_plain(_radio(radio), "dim", crop=True) for radio in snapshot["radios"]]
    parts += [_plain(note, "dim", crop=True) for note in notes]
    parts += [_plain(f"problem: {text}", "yellow") for text in snapshot["problems"]]
    return parts


def _radio(radio: Json) -> str:
    """The signal over the noise of a radio, here and at the other end."""
    here, there = (
        f"{'?' if radio[rssi] is None else radio[rssi]}/{'?' if radio[noise] is None else radio[noise]}"
        for rssi, noise in (("rssi", "noise"), ("remrssi", "remnoise"))
    )
    return f"radio of {radio['link']}: signal/noise {here}, other end {there}, {ago(radio['age_s'])}"


def _plain(text: object, style: str = "", *, crop: bool = False) -> Text:
    return Text(one_line(str(text)), style, no_wrap=crop or None, overflow="ellipsis" if crop else None)
