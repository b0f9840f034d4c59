"""Type `process`: as many processes run as expected."""

from __future__ import annotations

from phm import api
from phm_checks._custom.base import CustomCheck, Finding, bad, good
from phm_checks._text import listed


class Process(CustomCheck):
    """Counts the processes whose command line has all words."""

    def observe(self, world: api.World) -> Finding:
        entry, words = self.entry, " ".join(self.entry.process)
        listing = world.docker.processes(entry.container) if entry.container else world.programs.processes()
        found = [fact for fact in listing if all(word in fact.command for word in entry.process)]
        where = f" in {entry.container}" if entry.container else ""
        text = f"{len(found)} processes with {words!r}{where}"
        if len(found) < entry.min_count:
            return bad(f"{text}, expected {entry.min_count} or more", f"{len(found)} running", processes=len(found))
        if entry.max_count is not None and len(found) > entry.max_count:
            pids = listed(str(fact.pid) for fact in found)
            return bad(
                f"{text} (pids {pids}), expected at most {entry.max_count}",
                f"{len(found)} running",
                processes=len(found),
            )
        return good(text, processes=len(found))
