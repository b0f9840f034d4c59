"""Write the generated examples and pictures of the documents: `python -m tests.docs.examples`.

A line `<!-- example: NAME -->` in a document stands before a fenced block; its contents are what `EXAMPLES[NAME]`
returns, made by the real code from the recorded inputs of `tests.docs.story`. `tests/docs/test_examples.py` fails when a
document or a picture is not up to date.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from click.testing import CliRunner
from rich.console import Console

from phm.cli import group, init, render
from phm.core.model import Level, Slot
from phm.gcs import table
from phm.wire import fault_timeline
from phm.wire.tunnel import PeerState, PeerView
from tests.docs.story import ROOT as ROOT, play
from tests.fakes.engine import FakeEngine, container
from tests.gcs.bench import Ground, beat, pilot, said, told

MARK = re.compile(r"(<!-- example: ([\w-]+) -->\n+ *```\w*\n)(.*?)(^ *```$)", re.MULTILINE | re.DOTALL)
PICTURES = ROOT / "docs" / "pictures"
WIDTH = 120
FONT = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)


def _console(width: int) -> Console:
    return Console(file=io.StringIO(), record=True, width=width, highlight=False, markup=False, emoji=False)


def _shown(target: Console, show: Callable[[], object]) -> None:
    """Have what `phm` prints go to `target`."""
    before, render.console = render.console, lambda: target
    try:
        show()
    finally:
        render.console = before


@contextlib.contextmanager
def _from_root() -> Iterator[None]:
    before = os.getcwd()
    os.chdir(ROOT)
    try:
        yield
    finally:
        os.chdir(before)


def _text(show: Callable[[], object], command: str) -> str:
    target = _console(WIDTH)
    _shown(target, show)
    return "\n".join([f"$ {command}", *(line.rstrip() for line in target.export_text().splitlines())])


def _run(command: str) -> str:
    """What the command prints, run from the root of the repository."""
    with _from_root():
        result = CliRunner().invoke(group, command.split()[1:], prog_name="phm", env={"COLUMNS": str(WIDTH)})
    return "\n".join([f"$ {command}", *(line.rstrip() for line in result.output.splitlines())])


def _init() -> str:
    """`phm init` on a terminal: one container, Enter at each question."""
    app = container("ros_app", health="healthy", networks=["swarm_net"])
    app["HostConfig"]["NetworkMode"] = "swarm_net"
    app["Config"]["Image"] = "my_ros_app:1.4"
    before, init.on_terminal = init.on_terminal, lambda: True
    try:
        with tempfile.TemporaryDirectory() as place, FakeEngine(f"{place}/engine.sock") as fake:
            fake.containers["ros_app"] = app
            words = ["init", f"{place}/phm", "--no-ros", "--socket", fake.url]
            output = CliRunner().invoke(group, words, input="\n" * 5).output.replace(f"{place}/", "~/")
    finally:
        init.on_terminal = before
    return "\n".join(["$ .venv/bin/phm init ~/phm", *(line.rstrip() for line in output.splitlines())])


def _faults() -> list[dict[str, Any]]:
    return fault_timeline.build_timelines(play().record, [])


def _log() -> str:
    """The text log from the injected fault to its end, units that stay OK left out of the report."""
    lines = play().text_log
    first = next(i for i, line in enumerate(lines) if " NOTE:" in line)
    kept = [line for line in lines[first:] if not re.search(r"\((?:9|1[0-9])\)|BYPASS", line)]
    return "\n".join(kept)


def _event(event: str, **where: object) -> str:
    found = (line for line in play().record if line["event"] == event)
    line = next(line for line in found if all(line[key] == value for key, value in where.items()))
    return json.dumps(line, indent=2)


def _once_json() -> str:
    document = play().during
    check = next(check for check in document["checks"] if check["level"] == "ERROR")
    keys = ("agent", "status_array", "slots")
    return json.dumps({**{key: document[key] for key in keys}, "checks": [check]}, indent=2)


def _ground() -> Mapping[str, Any]:
    """Agent 1 is well, 2 has a dead node, the radio of 3 has failed, 7 is lost."""
    made = Ground()
    made.hear(*(beat(number) for number in (1, 3, 7)), pilot(1, armed=True), pilot(2), pilot(7))
    made.hear(said(7, "A07 OK 11111111", 6), said(1, "A01 OK 11111111", 6))
    view = PeerView(1, gcs=True, autopilot=True, radio=True, peers={3: PeerState.ALIVE})
    bad = beat(2, {Slot.NODES: Level.ERROR, Slot.TOPICS: Level.STALE, Slot.RATES: Level.STALE})
    made.wait(30, beat(1), bad, told(1, view), pilot(1, armed=True), pilot(2))
    made.hear(said(2, "A02 FAIL 6 node_1 dead"))
    return {**made.whole(), "system": 254, "component": 190, "problems": [], "frames_refused": 0}


def _gcs() -> str:
    target = _console(80)
    target.print(table.render(_ground(), [], height=None))
    lines = (line.rstrip() for line in target.export_text().splitlines())
    return "\n".join(["$ phm gcs udpin:0.0.0.0:14551", *lines])


def _timeline() -> str:
    (fault,) = _faults()
    return _text(lambda: render.timeline(fault, True), f"phm faults {fault['fault']}")


EXAMPLES: dict[str, Callable[[], str]] = {
    "validate": lambda: _run("phm validate -c config/phm.yaml"),
    "checks": lambda: _run("phm checks"),
    "graph": lambda: _run("phm checks --graph -c config/phm.yaml"),
    "init": _init,
    "help": lambda: _run("phm --help"),
    "once": lambda: _text(lambda: render.report(play().during), "phm once"),
    "once-json": _once_json,
    "status": lambda: _text(lambda: render.status(play().during, ""), "phm status"),
    "faults": lambda: _text(lambda: render.faults(_faults(), True), "phm faults"),
    "timeline": _timeline,
    "gcs": _gcs,
    "log": _log,
    "transition": lambda: _event("transition", unit="nodes/agent_1/node_1", level="ERROR"),
    "fault-opened": lambda: _event("fault_opened"),
    "action": lambda: _event("action", phase="verified"),
}


def _picture(title: str, show: Callable[[Console], object], width: int) -> str:
    target = _console(width)
    show(target)
    drawn = target.export_svg(title=title, unique_id="phm")
    return "\n".join(line.rstrip() for line in FONT.sub("", drawn).splitlines()) + "\n"


def _status_picture() -> str:
    """Slots 1 to 8 alone, so that the picture stays small."""
    during = {**play().during, "checks": [check for check in play().during["checks"] if check["slot"] <= 8]}
    return _picture("phm status", lambda target: _shown(target, lambda: render.status(during, "")), 116)


SHOWN: dict[str, Callable[[], str]] = {
    "status.svg": _status_picture,
    "gcs.svg": lambda: _picture("phm gcs", lambda target: target.print(table.render(_ground(), [], height=None)), 84),
}


def pages() -> Iterator[Path]:
    """The documents of the project."""
    yield from (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("**/*.md")))


def updated(text: str) -> str:
    """The text with its examples as the code makes them now. Raises KeyError for an unknown name."""

    def block(match: re.Match[str]) -> str:
        indent = re.match(r" *", match.group(4))
        pad = indent.group() if indent else ""
        body = "".join(f"{pad}{line}".rstrip() + "\n" for line in EXAMPLES[match.group(2)]().splitlines())
        return match.group(1) + body + match.group(4)

    return MARK.sub(block, text)


def main() -> None:
    """Bring documents and pictures up to date."""
    for page in pages():
        text = page.read_text("utf-8")
        if (new := updated(text)) != text:
            page.write_text(new, "utf-8")
            sys.stdout.write(f"{page.relative_to(ROOT)}\n")
    PICTURES.mkdir(exist_ok=True)
    for name, make in SHOWN.items():
        (PICTURES / name).write_text(make(), "utf-8")


if __name__ == "__main__":
    main()
