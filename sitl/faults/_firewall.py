"""Rules of a firewall inside the application's network namespace, put there from the host. They go with the container's life."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from sitl.faults.base import Agent

LIMIT_S = 10.0


def drop(agent: Agent, *rules: str) -> None:
    """Drop what matches each rule, e.g. ``OUTPUT ! -o lo``. Needs root, nsenter and iptables on the engine's host."""
    for rule in rules:
        chain, *words = rule.split()
        _iptables(agent, ["-A", chain, *words, "-j", "DROP"])


def clear(agent: Agent) -> None:
    """Take all rules out again. Nothing happens to a container that does not run: it has no namespace."""
    if agent.app.attrs["State"]["Running"]:
        for chain in ("INPUT", "OUTPUT"):
            _iptables(agent, ["-F", chain])


def blocks(agent: Agent) -> bool:
    """Whether a rule that drops packets is there. A container that does not run has none."""
    return bool(agent.app.attrs["State"]["Running"]) and "-j DROP" in _iptables(agent, ["-S"])


def _iptables(agent: Agent, words: Sequence[str]) -> str:
    pid = agent.app.attrs["State"]["Pid"]
    argv = ["nsenter", f"--net=/proc/{pid}/ns/net", "iptables", "-w", *words]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(argv)} ended with {done.returncode}: {done.stderr.strip()}")
    return done.stdout
