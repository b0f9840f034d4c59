"""Something takes so much memory that PHM must report it."""

from __future__ import annotations

import time
from collections.abc import Mapping

import psutil

from sitl.faults._load_container import LASTS_S, loaded, start_load, stop_load
from sitl.faults.base import Agent, Fault

WARN, ERROR, TAKEN = 0.04, 0.05, 0.08
"""Shares of this machine's memory above what is used when PHM is configured: limits for PHM, and what is taken."""
HOLD = "import time\nheld = bytearray(b'x') * {size}\ntime.sleep({lasts_s})\n"


class Injection(Fault):
    """Fills memory in a container that may have no more. The machine is never brought near its end: PHM's limits are set
    just above what is in use. Every agent of this machine sees it."""

    name, title, unit = "memory_full", "memory used up", "host/memory"
    condition = "memory_high"
    layer = "companion"
    cause = "a process beside the application leaks memory"
    evidence, evidence_s = "the available memory falls below the limit, while it is filled", 0.4
    healable = False
    needs = frozenset({"alone", "configuration"})

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        used = psutil.virtual_memory().percent / 100
        section = "\n  memory:\n    # WARN from here. Unit: percent. Allowed: `0%` to `100%`, not above `error`. Required.\n    warn: 85%"
        error = "\n    # ERROR from here. Unit: percent. Allowed: `0%` to `100%`. Required.\n    error: 95%"
        changed = section.replace("85%", f"{100 * (used + WARN):.1f}%") + error.replace(
            "95%", f"{100 * (used + ERROR):.1f}%"
        )
        return {section + error: changed}

    def inject(self, agent: Agent) -> float:
        size = int(psutil.virtual_memory().total * TAKEN)
        moment = time.monotonic()
        start_load(
            agent, HOLD.format(size=size, lasts_s=LASTS_S), mem_limit=size + 64 * 2**20, memswap_limit=size + 64 * 2**20
        )
        return moment

    def clear(self, agent: Agent) -> None:
        stop_load(agent)

    def restored(self, agent: Agent) -> bool | None:
        return not loaded(agent)
