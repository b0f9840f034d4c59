"""Bringing a swarm up: in phases, few agents at a time, each step begun when the one before is known to be done."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from threading import Event

from docker.errors import APIError
from docker.models.containers import Container

from sitl.harness.compose_stack import ROOT
from sitl.harness.config_overrides import write
from sitl.simulation.ports import INSIDE
from sitl.swarm import config, engine, external_autopilots, workspace
from sitl.swarm.health import HealthMonitor
from sitl.swarm.options import Options
from sitl.swarm.swarm import Swarm, SwarmAgent

BUILD_LIMIT_S = 1200.0
AIR_LIMIT_S = 30.0
APP_LIMIT_S = 90.0
PHM_LIMIT_S = 90.0
HEALTHY_LIMIT_S = 180.0
LOCK_LIMIT_S = 0.0
POLL_S = 0.4
LAST_LINES = 5
UP = b" is up"
"""What a node of the application prints when it is in the graph."""


def running_or_started(options: Options, progress: Callable[[str], None]) -> tuple[Swarm, bool]:
    """The running swarm of this name, or one that was started for the caller; and whether it was.

    A start that fails or is interrupted leaves only logs behind. LookupError: the running swarm has another size, profile or
    configuration, and what to do about it. RuntimeError: as `up`.
    """
    try:
        swarm = Swarm.load(options.name)
    except LookupError:
        swarm = Swarm(options)
        progress(f"starting {options.agents} agents")
        up(swarm, progress, clean=True)
        return swarm, True
    down = f"take it down (`python -m sitl down --name {options.name}`) or give another --name"
    if len(swarm.agents) != options.agents:
        raise LookupError(
            f"the running swarm {options.name} has {len(swarm.agents)} agents, not {options.agents}: {down}"
        )
    if (swarm.options.profile, dict(swarm.options.changes)) != (options.profile, dict(options.changes)):
        raise LookupError(f"the running swarm {options.name} was not started for the profile {options.profile}: {down}")
    return swarm, False


def up(swarm: Swarm, progress: Callable[[str], None] = print, *, clean: bool = False) -> None:
    """Start everything and wait until all is OK. RuntimeError says what did not start.

    What was started stays for inspection until `Swarm.down`. clean: it is removed if not all of it starts.
    """
    # Report configuration errors before anything is made.
    config.text(swarm.options, 1)
    external_autopilots.check(swarm.options)
    with workspace.locked(swarm.name, LOCK_LIMIT_S) as lock:
        if engine.resources(swarm.docker, swarm.name):
            raise RuntimeError(
                f"the swarm {swarm.name} already exists: `python -m sitl down --name {swarm.name}` first"
            )
        shutil.rmtree(swarm.folder, ignore_errors=True)
        swarm.folder.mkdir(parents=True)
        swarm.save()
        try:
            swarm.took = _bring_up(swarm, lock, progress)
        except BaseException:  # also when the user interrupts
            if clean:
                swarm.remove(keep_logs=True)
            raise
        swarm.save()


def _bring_up(swarm: Swarm, lock: int, progress: Callable[[str], None]) -> dict[str, float]:
    """Start in phases and return the seconds of each phase."""
    at_once = max(1, os.cpu_count() or 1)
    took: dict[str, float] = {}

    def phase(name: str, work: Callable[[], None]) -> None:
        began = time.monotonic()
        work()
        took[name] = round(time.monotonic() - began, 2)
        progress(f"{name}: {took[name]:.1f} s")

    if swarm.options.build:
        phase("images", _images)
    phase("air", lambda: _air(swarm, lock))
    phase("containers", lambda: _staggered(swarm.agents, at_once, lambda agent, _: _create(swarm, agent, lock)))
    nodes = len(config.graph(swarm.options))
    phase(
        "applications",
        lambda: _staggered(swarm.agents, at_once, lambda agent, stop: _application(swarm, agent, nodes, stop)),
    )
    phase("sidecars", lambda: _staggered(swarm.agents, at_once, _sidecar))
    phase("all OK", lambda: swarm.wait_healthy(HEALTHY_LIMIT_S))
    return took


def _images() -> None:
    done = subprocess.run(
        [str(ROOT / "scripts" / "image")], capture_output=True, text=True, timeout=BUILD_LIMIT_S, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"scripts/image ended with {done.returncode}: {(done.stderr or done.stdout).strip()}")


def _air(swarm: Swarm, lock: int) -> None:
    options = swarm.options
    variables = {
        "PHM_SWARM": swarm.name,
        "PHM_AGENTS": str(options.agents),
        "PHM_SEED": str(options.seed),
        "PHM_PILOTS": external_autopilots.urls(options),
    }
    engine.compose(f"{swarm.name}-air", engine.AIR_FILES, ["up", "--detach", "--no-build"], variables, [lock])
    _until(lambda: _connected(swarm), AIR_LIMIT_S, _air_container(swarm), Event())


def _air_container(swarm: Swarm) -> Container:
    return swarm.docker.containers.get(f"{swarm.name}-air-air-1")


def _connected(swarm: Swarm) -> bool:
    control = engine.published(swarm.docker, swarm.name, INSIDE.control)
    ground = engine.published(swarm.docker, swarm.name, INSIDE.ground)
    if control is None or ground is None:
        return False
    swarm.air.address, swarm.ground_url = control, f"tcp:{ground[0]}:{ground[1]}"
    try:
        return bool(swarm.air.state())
    except (OSError, ValueError):
        return False


def _create(swarm: Swarm, agent: SwarmAgent, lock: int) -> None:
    """Containers, network and volumes, nothing started."""
    assert agent.logs is not None  # a swarm's agents have one
    agent.logs.mkdir(parents=True, exist_ok=True)
    agent.logs.chmod(0o777)  # PHM is an ordinary user in its container, with a number this host need not know
    agent.config.parent.mkdir(parents=True, exist_ok=True)
    write(config.text(swarm.options, agent.number), agent.config)
    agent.make_device()
    engine.compose(agent.project, _files(swarm, agent), ["create", "--no-build"], _variables(swarm, agent), [lock])


def recreate(swarm: Swarm, agent: SwarmAgent, service: str) -> None:
    """Replace and start the container of one service of a running swarm, as `up` made it."""
    words = ["up", "--detach", "--no-build", "--no-deps", "--force-recreate", service]
    engine.compose(agent.project, _files(swarm, agent), words, _variables(swarm, agent))


def _files(swarm: Swarm, agent: SwarmAgent) -> list[str]:
    """The Compose files of an agent."""
    more = [engine.AS_FOUND_FILE] if swarm.options.profile == "as-found" else []
    return [
        *engine.AGENT_FILES,
        *external_autopilots.write(swarm.options, agent.number, agent.config.parent),
        *more,
    ]


def _variables(swarm: Swarm, agent: SwarmAgent) -> dict[str, str]:
    return {
        **engine.groups(),
        "PHM_SWARM": swarm.name,
        "PHM_AGENT": agent.name,
        "PHM_AGENT_ID": str(agent.number),
        "PHM_INTERVAL": f"{swarm.options.interval_s:g}",
        "PHM_APP": f"{agent.project}-ros_app-1",
        "PHM_NETWORK": f"{agent.project}_net",
        "PHM_DEVICE": str(agent.device),
        "PHM_LOGS": str(agent.logs),
        "PHM_CONFIG": str(agent.config),
        "PHM_ROUTER_PORT": str(INSIDE.router_of(agent.number)),
        "PHM_GRAPH": json.dumps([plan.as_words() for plan in config.graph(swarm.options)]),
        "ROS_DOMAIN_ID": str(agent.number),
    }


def _application(swarm: Swarm, agent: SwarmAgent, nodes: int, stop: Event) -> None:
    if swarm.options.autopilot != "sim":
        _started(agent.container(external_autopilots.SERVICE))
    app = agent.app
    _started(app)
    _until(lambda: app.logs().count(UP) >= nodes, APP_LIMIT_S, app, stop)


def _sidecar(agent: SwarmAgent, stop: Event) -> None:
    _started(agent.router)
    watch, sidecar = HealthMonitor(agent.record), agent.sidecar
    _started(sidecar)
    _until(lambda: watch.update().array is not None, PHM_LIMIT_S, sidecar, stop)


def _started(container: Container) -> None:
    try:
        container.start()
    except APIError as error:
        raise RuntimeError(f"{container.name} did not start: {error.explanation or error}") from error


def _staggered(agents: Iterable[SwarmAgent], at_once: int, work: Callable[[SwarmAgent, Event], None]) -> None:
    """All of them, few at a time. When one fails or the user interrupts, none is begun any more and those at work end soon."""
    stop = Event()
    with ThreadPoolExecutor(at_once) as pool:
        waiting = [pool.submit(work, agent, stop) for agent in agents]
        try:
            for one in as_completed(waiting):
                one.result()
        finally:
            stop.set()
            for one in waiting:
                one.cancel()


def _until(done: Callable[[], bool], limit_s: float, container: Container, stop: Event) -> None:
    """Ask again and again. RuntimeError, with the container's last words, when it has ended or the time is over."""
    end = time.monotonic() + limit_s
    while not done():
        container.reload()
        gone = container.status in ("exited", "restarting", "dead")
        if gone or time.monotonic() > end:
            what = f"is {container.status}" if gone else f"is not ready after {limit_s:g} s"
            words = container.logs(tail=LAST_LINES).decode(errors="replace").strip()
            raise RuntimeError(f"{container.name} {what}; its last words: {words or 'none'}")
        if stop.wait(POLL_S):
            return
