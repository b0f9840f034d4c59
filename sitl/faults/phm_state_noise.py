"""PHM's state on the disk turns into noise."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

from sitl.faults._processes import held, kill
from sitl.faults._volumes import behind
from sitl.faults.base import Agent, Fault
from sitl.faults.phm_killed import RUN, daemon

FOLDER = "/var/lib/phm"
NAME = "state.json"
LEAST = 64
"""Bytes of noise, also where a file was empty."""


class Injection(Fault):
    """Replaces the content of each file in PHM's state folder by random bytes and kills PHM, as a loss of power does that damages the
    disk. PHM must start with an empty state, keep the damaged file beside the new one, and say so."""

    name, title, unit = "phm_state_noise", "PHM's state replaced by noise", "companion"
    condition = "phm_problem"
    level = "WARN"
    layer = "companion"
    healable = False
    passes = True
    cause = "a disk was damaged while PHM lost its power"
    evidence, evidence_s = "the kernel ends the process, and the engine reports the end of its container", 0.1

    _pid = 0

    def inject(self, agent: Agent) -> float:
        folder, self._pid = behind(agent.sidecar, FOLDER), daemon(agent)
        with held([self._pid]) as daemons:
            moment = time.monotonic()
            for file in folder.iterdir():
                if file.is_file():
                    _fill(file)
            if not (folder / NAME).exists():  # nothing has happened yet that PHM keeps
                (folder / NAME).write_bytes(os.urandom(LEAST))
                os.chmod(folder / NAME, 0o644)
            for each in daemons:
                kill(each)
        return moment

    def clear(self, agent: Agent) -> None:
        sidecar = agent.sidecar
        if sidecar.status != "running":
            sidecar.start()

    def restored(self, agent: Agent) -> bool | None:
        try:
            json.loads((behind(agent.sidecar, FOLDER) / NAME).read_bytes())
        except (OSError, ValueError):
            return False
        pids = agent.processes(agent.sidecar, RUN)
        return len(pids) == 1 and self._pid not in pids


def _fill(file: Path) -> None:
    """The same file, owner and mode, with noise of the same length."""
    size = max(file.stat().st_size, LEAST)
    with file.open("r+b") as stream:
        stream.write(os.urandom(size))
