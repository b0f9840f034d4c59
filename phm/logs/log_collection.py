"""One folder with the logs of many agents, each in a separate folder, that is brought up to date in each run."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from phm.core.file_lock import locked
from phm.facts import CannotTell
from phm.logs.bundle import file_name
from phm.logs.collection_index import Agent, Index, agent_of
from phm.logs.copies import Copies
from phm.logs.log_copier import BASES, RECORD, Copied, LogSource, Progress, fetch

INDEX = ".phm-collect.json"
"""What was collected from where. Without it everything is fetched again, and nothing is there twice."""
_STAGING = ".phm-collect-"


@dataclass
class CollectedLogs:
    """What a source gave. folder: of its agent, relative; empty: nothing. missing: (file, why)."""

    source: str
    agent: str = ""
    folder: str = ""
    fetched: int = 0
    unchanged: int = 0
    bytes: int = 0
    missing: list[tuple[str, str]] = field(default_factory=list)


class InUse(Exception):
    """Another `phm logs collect` writes into the folder."""


class Collection:
    """The folder. Thread-safe: `take` may run for several sources at the same time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._claimed: dict[str, str] = {}
        """The source of each agent's folder in this run."""
        self._index = Index()

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Lock the folder while the context lasts. Raises InUse if another collection writes into it, and OSError if it cannot be written."""
        self.folder.mkdir(parents=True, exist_ok=True)
        busy = InUse(f"another `phm logs collect` writes into {self.folder}")
        with locked(self.folder / f"{INDEX}.lock", busy):
            for left in self.folder.glob(f"{_STAGING}*"):  # of a run that was ended by force
                shutil.rmtree(left, ignore_errors=True)
            self._index = Index.read(self.folder / INDEX)
            yield

    def take(self, source: LogSource, progress: Progress) -> CollectedLogs:
        """Fetch what is new. Raises OSError if it cannot be written."""
        made = CollectedLogs(source.name)
        with tempfile.TemporaryDirectory(prefix=_STAGING, dir=self.folder) as staging:
            folder = self._index.sources.get(source.name, "")
            try:
                for base in BASES:
                    copied = fetch(source, base, self._known(folder, base), Path(staging), progress)
                    if base == RECORD and not copied.any:
                        made.missing.append((RECORD, "there is none"))
                    if copied.files:
                        folder = self._place(source, base, copied, folder)
                        made.folder, made.agent = folder, self._index.agents[folder][0]
                    made.fetched, made.bytes = made.fetched + copied.count, made.bytes + copied.bytes
                    made.unchanged += copied.unchanged
                    made.missing += copied.missing
            except CannotTell as error:
                made.missing.append(("logs", str(error)))
        return made

    def _known(self, folder: str, base: str) -> dict[str, str]:
        """What need not be fetched again: the files that are here."""
        marks = self._index.marks.get(f"{folder}/{base}") if folder else None
        there = Copies(self.folder / folder, base).keys() if marks else set()
        return {mark: key for mark, key in (marks or {}).items() if key in there}

    def _place(self, source: LogSource, base: str, copied: Copied, folder: str) -> str:
        """Put the copies into the folder of their agent, which is returned. folder: as far as it is known."""
        with self._lock:
            if base == RECORD or not folder:
                folder = self._folder_of(source.name, copied, folder)
            copies = Copies(self.folder / folder, base)
            copies.take(copied.files)
            there = copies.keys()
            marks = {**self._index.marks.get(f"{folder}/{base}", {}), **copied.marks}
            self._index.marks[f"{folder}/{base}"] = {mark: key for mark, key in marks.items() if key in there}
            self._index.write(self.folder / INDEX)
        return folder

    def _folder_of(self, source: str, copied: Copied, before: str) -> str:
        """The folder of the agent that the log names: its name, and if another agent has that, also its id."""
        staged = [each.staged for each in copied.files if each.staged is not None]
        named = before or source.removeprefix("container ").partition(" at ")[0].rpartition("/")[2]
        agent = next(filter(None, map(agent_of, staged)), None) or self._index.agents.get(before) or (named, None)
        names = [file_name(agent[0]), file_name(f"{agent[0]}-{agent[1]}")]
        names += [f"{names[1]}-{number}" for number in range(2, 1000)]
        keys = {each.key for each in copied.files}
        folder = next(name for name in names if self._fits(name, source, agent, keys))
        self._claimed.setdefault(folder, source)
        self._index.sources[source], self._index.agents[folder] = folder, agent
        return folder

    def _fits(self, folder: str, source: str, agent: Agent, keys: set[str]) -> bool:
        """Whether the logs of this source may be put there. Not through a link: the folder may come from someone else."""
        if (self.folder / folder).is_symlink():
            return False
        if self._index.agents.get(folder, agent) != agent:
            return False
        if self._claimed.get(folder, source) == source:
            return True
        return bool(keys & Copies(self.folder / folder, RECORD).keys())  # the same log, from two places
