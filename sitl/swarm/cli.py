"""The commands of ``python -m sitl``: up, down, status, logs, inject, clear."""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from docker.errors import DockerException
from rich import box
from rich.table import Table

from sitl.faults import all_faults
from sitl.harness.console import make_console
from sitl.swarm import active_faults, cost, startup
from sitl.swarm.options import DEFAULT_NAME, MOST_AGENTS, PROFILES, Options
from sitl.swarm.swarm import Swarm

Verb = Callable[[argparse.Namespace], int]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code. 0: done, or all is OK; 1: it failed, or something is not OK; 2: wrong arguments."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    chosen = _parser().parse_args(words)
    verb: Verb = chosen.verb
    try:
        return verb(chosen)
    except (LookupError, ValueError, RuntimeError, OSError, DockerException) as error:
        print(f"sitl: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m sitl", description="A simulated swarm on this machine: docs/development/sitl.md."
    )
    verbs = parser.add_subparsers(required=True, metavar="COMMAND")
    up = _verb(verbs, "up", _up, "start a swarm and wait until every agent is OK")
    up.add_argument("--agents", type=int, default=8, metavar="N", help=f"how many, 1 to {MOST_AGENTS} (8)")
    up.add_argument("--nodes", type=int, default=3, help="ROS nodes of each agent, in a ring (3)")
    up.add_argument("--rate", type=float, default=5.0, metavar="HZ", help="rate of each topic (5)")
    up.add_argument("--graph", default="", metavar="FILE", help="another node graph, in YAML")
    up.add_argument("--interval", type=float, default=20.0, metavar="SECONDS", help="between full reports of PHM (20)")
    up.add_argument("--mode", choices=("act", "advise", "off"), default="act", help="recovery.mode (act)")
    up.add_argument("--autopilot", choices=("sim", "ardupilot", "px4"), default="sim", help="which autopilot (sim)")
    up.add_argument("--autopilot-path", default="", metavar="FILE", help="a SITL binary of this machine")
    up.add_argument("--autopilot-image", default="", metavar="IMAGE", help="a Docker image that has one")
    up.add_argument(
        "--autopilot-command", default="", metavar="WORDS", help="how it is started: docs/development/sitl.md"
    )
    up.add_argument(
        "--profile",
        choices=PROFILES,
        default="tuned",
        help="how much is configured for PHM, in it and in the application: docs/development/campaign.md (tuned)",
    )
    up.add_argument("--seed", type=int, default=0, help="of losses that are drawn at random (0)")
    up.add_argument("--no-build", action="store_true", help="use the present images")
    down = _verb(verbs, "down", _down, "remove everything that belongs to a swarm")
    down.add_argument("--keep-logs", action="store_true", help="leave the folder with PHM's logs")
    status = _verb(verbs, "status", _status, "show the state of each agent; exit code 0 if all are OK")
    status.add_argument("--json", action="store_true", help="for programs")
    spent = _verb(verbs, "cost", _cost, "processor time and memory of each container")
    spent.add_argument("--for", dest="seconds", type=float, default=20.0, metavar="SECONDS", help="time to watch (20)")
    logs = _verb(verbs, "logs", _logs, "PHM's log, or the output of a container")
    logs.add_argument("agent", type=int, nargs="?", help="number of the agent (all, one after the other)")
    logs.add_argument("--service", choices=("phm", "ros_app", "air"), help="the output of this container instead")
    logs.add_argument("-n", "--lines", type=int, default=40, help="how many of the last lines (40)")
    logs.add_argument("-f", "--follow", action="store_true", help="go on as lines come")
    inject = _verb(verbs, "inject", _inject, "inject a fault, with a note in PHM's log; without one, list them")
    inject.add_argument("fault", nargs="?", help="name of the fault")
    inject.add_argument("--agent", type=int, default=1, metavar="K", help="into this agent (1)")
    clear = _verb(verbs, "clear", _clear, "undo what was injected")
    clear.add_argument("--agent", type=int, default=None, metavar="K", help="only in this agent")
    verbs.add_parser(
        "campaign", help="inject many faults and evaluate how PHM handles them: docs/development/campaign.md"
    )
    return parser


def _verb(
    verbs: argparse._SubParsersAction[argparse.ArgumentParser], name: str, verb: Verb, what: str
) -> argparse.ArgumentParser:
    parser = verbs.add_parser(name, help=what, description=what[0].upper() + what[1:] + ".")
    parser.set_defaults(verb=verb)
    parser.add_argument("--name", default=DEFAULT_NAME, help=f"of the swarm ({DEFAULT_NAME})")
    return parser


def _up(chosen: argparse.Namespace) -> int:
    options = Options(
        agents=chosen.agents,
        name=chosen.name,
        interval_s=chosen.interval,
        nodes=chosen.nodes,
        rate_hz=chosen.rate,
        graph=str(Path(chosen.graph).resolve()) if chosen.graph else "",
        mode=chosen.mode,
        autopilot=chosen.autopilot,
        autopilot_path=_binary(chosen),
        autopilot_image=chosen.autopilot_image,
        autopilot_command=chosen.autopilot_command,
        seed=chosen.seed,
        build=not chosen.no_build,
        profile=chosen.profile,
    )
    swarm = Swarm(options)
    # A shell that starts this in the background has SIGINT ignored; an interrupted `up` must not leave half a swarm.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        startup.up(swarm, lambda words: print(words, flush=True))
    except KeyboardInterrupt:
        print("interrupted: removing what was started", file=sys.stderr)
        swarm.down()
        return 130
    print(f"{options.agents} agents are OK; a ground station connects to {swarm.ground_url}")
    print(f"logs: {swarm.folder / 'logs'}; the end: python -m sitl down --name {swarm.name}")
    return 0


def _binary(chosen: argparse.Namespace) -> str:
    """A path of this machine, or one inside the image."""
    if not chosen.autopilot_path or chosen.autopilot_image:
        return str(chosen.autopilot_path)
    return str(Path(chosen.autopilot_path).resolve())


def _down(chosen: argparse.Namespace) -> int:
    removed = Swarm(Options(name=chosen.name)).down(keep_logs=chosen.keep_logs)
    print(f"{removed} containers, networks and volumes removed")
    return 0


def _status(chosen: argparse.Namespace) -> int:
    swarm = Swarm.load(chosen.name)
    rows = swarm.status()
    if chosen.json:
        print(
            json.dumps({"name": swarm.name, "ground": swarm.ground_url, "took": swarm.took, "agents": rows}, indent=2)
        )
    else:
        table = Table(title=f"{swarm.name}, ground station at {swarm.ground_url}", box=box.SIMPLE_HEAD)
        for heading in ("agent", "application", "PHM", "status array", "not OK"):
            table.add_column(heading)
        for row in rows:
            array = "".join("-" if digit is None else str(digit) for digit in row["array"] or ())
            table.add_row(row["name"], row["app"], row["sidecar"], array or "none yet", row["why"] or "-")
        make_console(json=False).print(table)
    return 0 if all(row["healthy"] for row in rows) else 1


def _cost(chosen: argparse.Namespace) -> int:
    swarm = Swarm.load(chosen.name)
    rows = cost.measure(swarm.name, chosen.seconds)
    table = Table(title=f"{swarm.name}, {chosen.seconds:g} s; up took {swarm.took}", box=box.SIMPLE_HEAD)
    for heading in (
        "containers",
        "CPU, % of a core, mean",
        "max",
        "sum",
        "CPU s since start, mean",
        "MB, mean",
        "max",
        "sum",
    ):
        table.add_column(heading, justify="left" if heading == "containers" else "right")
    for service in (*sorted({row.service for row in rows}), "all"):
        some = [row for row in rows if service in (row.service, "all")]
        cpu, memory = [row.cpu_percent for row in some], [row.memory_mb for row in some]
        since = sum(row.cpu_s for row in some) / len(some)
        figures = (sum(cpu) / len(cpu), max(cpu), sum(cpu), since, sum(memory) / len(memory), max(memory), sum(memory))
        table.add_row(f"{len(some)} {service}", *(f"{figure:.1f}" for figure in figures))
    make_console(json=False).print(table)
    return 0 if rows else 1


def _logs(chosen: argparse.Namespace) -> int:
    swarm = Swarm.load(chosen.name)
    if chosen.service:
        project = "air" if chosen.service == "air" else str(chosen.agent or 1)
        argv = ["docker", "logs", "--tail", str(chosen.lines)]
        argv += ["--follow"] if chosen.follow else []
        return subprocess.call([*argv, f"{swarm.name}-{project}-{chosen.service}-1"])
    files = [
        swarm.folder / "logs" / str(agent.number) / "phm.log"
        for agent in swarm.agents
        if chosen.agent in (None, agent.number)
    ]
    if not files:
        raise LookupError(f"there is no agent {chosen.agent}: allowed are 1 to {len(swarm.agents)}")
    argv = ["tail", "-n", str(chosen.lines), *(["-F"] if chosen.follow else []), *map(str, files)]
    try:
        return subprocess.call(argv)
    except KeyboardInterrupt:
        return 0


def _inject(chosen: argparse.Namespace) -> int:
    if chosen.fault is None:
        for name, fault in all_faults().items():
            print(f"{fault.layer:10} {name:24} {fault.title}")
        return 0
    swarm = Swarm.load(chosen.name)
    fault, no_note = active_faults.inject(swarm, chosen.agent, chosen.fault)
    where = ", ".join(fault.places(swarm.agents[chosen.agent - 1])) or "no fault"
    print(f"{fault.title}: injected into agent {chosen.agent}; expected of PHM: {fault.condition} at {where}")
    if no_note:
        print(f"sitl: PHM's log has no note of it: {no_note}", file=sys.stderr)
    return 0


def _clear(chosen: argparse.Namespace) -> int:
    swarm = Swarm.load(chosen.name)
    cleared = active_faults.clear(swarm, chosen.agent)
    print(f"cleared: {', '.join(cleared) or 'nothing was injected'}; all links are as they were at the start")
    return 0
