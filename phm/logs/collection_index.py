"""What was collected from where, kept in the folder of the logs. Without it everything is fetched again."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from phm.logs.bundle import file_name
from phm.logs.copies import BROKEN, text_of
from phm.wire import json_log

MOST_BYTES = 20_000_000
MOST_LINES = 100
"""Of a log, in which an agent is looked for: each line names it."""
Agent = tuple[str, int | None]
"""Name and id."""


@dataclass
class Index:
    """sources: the folder of each source. agents: whose each folder is. marks: the keys of the complete files of each
    ``FOLDER/LOG``, by their marks."""

    sources: dict[str, str] = field(default_factory=dict)
    agents: dict[str, Agent] = field(default_factory=dict)
    marks: dict[str, dict[str, str]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Index:
        """What of it can be used: it may be damaged, or come with the folder from someone else."""
        try:
            with path.open("rb") as stream:
                found = json.loads(stream.read(MOST_BYTES))
        except (OSError, ValueError, RecursionError):
            found = {}
        sources, agents, marks = (_object(_object(found).get(name)) for name in ("sources", "agents", "marks"))
        known = {name: agent for name, value in agents.items() if (agent := _agent(value)) is not None}
        usable = {value for value in known if file_name(value) == value and not (path.parent / value).is_symlink()}
        return cls(
            {name: value for name, value in _texts(sources).items() if value in usable},
            known,
            {name: _texts(_object(value)) for name, value in marks.items()},
        )

    def write(self, path: Path) -> None:
        """Through no link: the folder may come from someone else, with a link under the name of the new file."""
        made = path.with_suffix(".tmp")
        made.unlink(missing_ok=True)
        with made.open("x", encoding="utf-8") as stream:
            json.dump(asdict(self), stream, separators=(",", ":"))
        os.replace(made, path)


def agent_of(path: Path) -> Agent | None:
    """The agent whose log it is, by its first event."""
    left = MOST_BYTES
    try:
        with path.open("rb") as plain:
            stream = text_of(plain, path)
            for _ in range(MOST_LINES):
                line = stream.readline(max(0, left))
                left -= len(line)
                event = json_log.parse(line) or {}
                if (agent := _agent([event.get("agent"), event.get("agent_id")])) is not None:
                    return agent
    except BROKEN:
        pass
    return None


def _agent(value: object) -> Agent | None:
    if not isinstance(value, list) or len(value) != 2 or not isinstance(value[0], str) or not value[0]:
        return None
    return value[0][:100], value[1] if isinstance(value[1], int) else None


def _object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _texts(found: Mapping[str, Any]) -> dict[str, str]:
    return {name: value for name, value in found.items() if isinstance(value, str)}
