"""The note of an injection in PHM's own log, of which `phm report` makes Table 2 of the paper."""

from __future__ import annotations

from docker.errors import DockerException

from sitl.faults.base import Agent, Fault

LIMIT_S = 20
"""For the start of `phm note` on a busy machine; its request itself has a deadline of 5 s."""


def text(fault: Fault, agent: Agent) -> str:
    """`INJECT node_killed: nodes/agent_1/node_1`, with the units at which an alarm is due."""
    return f"INJECT {fault.name}: {', '.join(fault.places(agent)) or 'no alarm is due'}"


def write(fault: Fault, agent: Agent) -> str:
    """Have the agent's PHM write the note, just before the injection. Empty, or why it could not be written."""
    try:
        code, output = agent.sidecar.exec_run(["timeout", str(LIMIT_S), "phm", "note", text(fault, agent)])
    except (LookupError, OSError, DockerException) as error:
        return f"{type(error).__name__}: {error}"
    if code == 0:
        return ""
    said = output.decode(errors="replace").strip() if isinstance(output, bytes) else ""
    return said or f"`phm note` ended with {code}"
