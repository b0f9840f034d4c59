"""The pictures of README and docs: what each is called, its alternative text, and what it must show."""

from __future__ import annotations

import html
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parents[3] / "docs" / "pictures"
MAX_BYTES = 300_000
_LINE = re.compile(r'<text [^>]*clip-path="url\(#phm-line-(\d+)\)"[^>]*>([^<]*)</text>')
_PLACES = ("/tmp/", "/home/", "/root/", str(FOLDER.parents[1]))


@dataclass(frozen=True, slots=True)
class Picture:
    """alt: its text in documents, word for word. shows: texts that must be in it."""

    alt: str
    shows: tuple[str, ...]


TERMINAL = {
    "status.svg": Picture(
        "phm status of an agent: PHM has reopened the connection to the autopilot, the planner has ended, and what needs it is"
        " blocked",
        ("custom/planner", "resolved by reopen", "blocks custom/route", "blocked by custom/planner", "Status Array"),
    ),
    "gcs.svg": Picture(
        "phm gcs with four agents: the planner of A02 is not running, and the PHM of A04 is silent while its autopilot is received",
        (
            "4 agents: 1 ERROR, 1 LOST, 2 OK",
            "A02 FAIL 10 autopilot: no heartbeat",
            "A02 OK 10 reopened: autopilot: no heartbeat",
            "A02 FAIL 13 planner is not running",
            "A04 broken at companion: PHM silent",
        ),
    ),
    "demo.svg": Picture(
        "phm demo: the autopilot of A02 is lost, and the PHM of A03 is silent while its autopilot is received",
        (
            "3 agents: 1 ERROR, 1 LOST, 1 OK",
            "A02 FAIL 10 autopilot: no heartbeat",
            "A02 broken at autopilot",
            "A03 broken at companion: PHM silent",
        ),
    ),
}
"""Made from what `phm` writes to a terminal."""

PAGE = {
    "web-swarm.png": Picture(
        "The swarm: a row for each agent and a cell for each slot, the worst agents first",
        ("9 agents", "2 ERROR", "1 LOST", "2 WARN", "4 OK", "ros_app", "2 CRITICAL not acknowledged"),
    ),
    "web-agent.png": Picture(
        "One agent: the path of a command is broken at the container, and an open fault with its steps",
        ("Container BROKEN?", "ros_app exited (137)", "confirmed", "advised"),
    ),
    "web-views.png": Picture(
        "Two views: what the ground and the swarm say about each agent, and where they differ",
        ("the levels differ", "the swarm receives it, the ground does not"),
    ),
    "web-events.png": Picture(
        "Events: the log, newest first, with search, agent and least severity",
        ("A08 is lost", "A07 FAIL 10111--1 2 ros_app exited (137)", "A02 FAIL 11111001 6 planner dead"),
    ),
    "web-checks.png": Picture(
        "The Checks page: a form on the left, problems, units and changes on the right",
        ("custom[0]: tcp planner", "is 80800, allowed is 1 to 65535", "port: 80800"),
    ),
}
"""Screenshots of `phm gcs --web`."""

PICTURES = {**TERMINAL, **PAGE}


def missing(name: str, shown: str) -> list[str]:
    """The texts that the picture must show and does not. Blanks are ignored: they differ where a style changes."""
    packed = "".join(shown.split())
    return [text for text in PICTURES[name].shows if "".join(text.split()) not in packed]


def check_private(name: str, shown: str) -> None:
    """Raises AssertionError if a path or the name of this machine is in what the picture shows."""
    for private in _PLACES:
        assert private not in shown, f"{name} shows {private!r}: {shown}"
    host = socket.gethostname()
    assert host == "localhost" or not re.search(rf"\b{re.escape(host)}\b", shown), f"{name} shows {host!r}: {shown}"


def check(name: str, shown: str) -> None:
    """Raises AssertionError if the picture lacks a text, or shows something of this machine."""
    assert missing(name, shown) == [], f"{name}: {shown}"
    check_private(name, shown)


def svg_lines(svg: str) -> list[str]:
    """The lines that the SVG of a terminal shows, with the blanks within a style alone."""
    lines: dict[int, str] = {}
    for number, text in _LINE.findall(svg):
        lines[int(number)] = lines.get(int(number), "") + html.unescape(text).replace("\xa0", " ")
    return [lines[number] for number in sorted(lines)]


def check_files(folder: Path, names: Iterable[str]) -> None:
    """Raises AssertionError if a file of these is not there, or is too large for a README."""
    for name in names:
        assert 1000 < (folder / name).stat().st_size < MAX_BYTES, name
