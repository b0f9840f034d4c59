"""What a fault is, and the agent it is injected into."""

from __future__ import annotations

import contextlib
import io
import os
import stat
import tarfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar, Protocol

from docker import DockerClient
from docker.errors import APIError
from docker.models.containers import Container

NULL, ZERO = "/dev/null", "/dev/zero"
STOP_S = 3
TRIES = 3
FREEZES, FREEZE_AGAIN_S = 20, 0.5
LAYERS = ("companion", "container", "ros", "link")


class Air(Protocol):
    """The control of a swarm's emulated radios, routers and autopilots (`sitl.swarm`), as far as faults use it."""

    def set(self, agent: int, link: str, **how: Any) -> None:
        """Change one link of an agent: ``ground``, ``peers``, ``autopilot`` or ``router``."""

    def reset(self, agent: int) -> None:
        """Give all links of an agent back as they were in the beginning."""

    def split(self, groups: list[list[int]]) -> None:
        """Agents of different groups no longer receive each other; no groups: all do."""

    def autopilot(self, agent: int, what: str) -> None:
        """``hang``, ``resume`` or ``reboot``."""

    def traffic(self) -> dict[int, dict[str, int]]:
        """Counters of bytes and frames, by the agent's number."""

    def state(self) -> dict[str, Any]:
        """``agents``: what is so now, by the agent's number."""


@dataclass
class Agent:
    """One simulated agent on this machine's engine: its compose project, and names inside it.

    number: of the agent and its vehicle, also the MAVLink system id. logs: folder of PHM's log on this machine. air: the
    emulated links of the swarm that it belongs to; None: it is on its own.
    """

    project: str
    name: str
    docker: DockerClient = field(default_factory=DockerClient.from_env)
    number: int = 1
    logs: Path | None = None
    air: Air | None = None

    def container(self, service: str) -> Container:
        """The project's container of a compose service; LookupError when there is none."""
        labels = [f"com.docker.compose.project={self.project}", f"com.docker.compose.service={service}"]
        found = self.docker.containers.list(all=True, filters={"label": labels}, ignore_removed=True)
        if not found:
            raise LookupError(f"the project {self.project} has no container of service {service}")
        return found[0]

    @property
    def app(self) -> Container:
        return self.container("ros_app")

    @property
    def sidecar(self) -> Container:
        """PHM's own container."""
        return self.container("phm")

    @property
    def router(self) -> Container:
        """The MAVLink router on board; LookupError when it has none."""
        return self.container("router")

    @property
    def links(self) -> Air:
        """Its emulated links; LookupError when it has none."""
        if self.air is None:
            raise LookupError(f"{self.name} has no emulated links: start it with `python -m sitl up`")
        return self.air

    def processes(self, container: Container, word: str) -> list[int]:
        """Process ids on this machine of the processes of a container that have the word in their command line."""
        found = container.top(ps_args="-eo pid,args")
        return [int(row[0]) for row in found["Processes"] or () if word in row[1]]

    @property
    def device(self) -> Path:
        """A character device of the host made for this project alone, so that the device check has something
        that may vanish. It is a copy of /dev/null under another name."""
        return Path("/dev") / f"{self.project.replace('-', '_')}_radio"

    def make_device(self, like: str = NULL) -> None:
        """Make the device with the numbers of `like` unless it is there. Needs root."""
        if not self.device.exists():
            os.mknod(self.device, 0o666 | stat.S_IFCHR, os.stat(like).st_rdev)
            self.device.chmod(0o666)

    @property
    def generation(self) -> str:
        """Changes exactly when the application container is recreated or started again."""
        app = self.app
        return f"{app.id}@{app.attrs['State']['StartedAt']}"

    @property
    def generations(self) -> frozenset[str]:
        """Changes exactly when any of its containers is recreated or started again."""
        label = f"com.docker.compose.project={self.project}"
        found = self.docker.containers.list(all=True, filters={"label": label}, ignore_removed=True)
        return frozenset(f"{each.id}@{each.attrs['State']['StartedAt']}" for each in found)

    def renew_app(self, generation: str) -> None:
        """Restart the application container if it still is in that run: then it was not recovered."""
        if self.generation == generation:
            self.app.restart(timeout=STOP_S)

    def signal_node(self, node: str, signal_name: str) -> float:
        """Send a signal (``KILL``, or a number) to one node of the application; the moment before it was sent."""
        pid = ""
        for _ in range(TRIES):  # a busy engine now and then loses what a command has printed (seen once in 60)
            pid = pid or self.run_in_app("cat", f"/tmp/nodes/{node}.pid")
        moment = time.monotonic()
        self.run_in_app("kill", f"-{signal_name}", str(int(pid)))
        return moment

    def write_in_app(self, path: str, content: bytes, mode: int = 0o644) -> None:
        """Put a file into the application container, whether it runs or not."""
        put(self.app, path, content, mode)

    def run_in_app(self, *argv: str) -> str:
        """Run a command inside the application container and return what it printed."""
        code, output = self.app.exec_run(list(argv))
        assert isinstance(output, bytes)  # no stream was asked for
        text = output.decode(errors="replace").strip()
        if code != 0:
            raise RuntimeError(f"{' '.join(argv)} in {self.app.name} ended with {code}: {text}")
        return text


def put(container: Container, path: str, content: bytes, mode: int = 0o644) -> None:
    """Put a file into a container, whether it runs or not."""
    folder, _, name = path.rpartition("/")
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        entry = tarfile.TarInfo(name)
        entry.size, entry.mode, entry.mtime = len(content), mode, int(time.time())
        archive.addfile(entry, io.BytesIO(content))
    if not container.put_archive(folder, packed.getvalue()):
        raise RuntimeError(f"the engine did not take {path} for {container.name}")


def freeze(container: Container) -> None:
    """Pause a container. On a starved machine with cgroup v1 the kernel now and then does not freeze it in time: try again."""
    for left in reversed(range(FREEZES)):
        try:
            container.pause()
            return
        except APIError as error:
            if not left or "unable to freeze" not in str(error):
                raise
        time.sleep(FREEZE_AGAIN_S)


class Fault(ABC):
    """One kind of trouble.

    name: as in its file. title: words for a table. cause: what happens in the world when it is real.
    layer: where it is injected, one of LAYERS.
    unit: id of the unit at which PHM must see it, with ``{agent}`` for the agent's name, ``{id}`` for its number as in A01.
    condition: as what PHM must know it; it selects the ladder.
    level: ``ERROR``, for which a fault is opened, or ``WARN``, a transition.
    others: unit at which all other agents of its swarm must see it, too; empty: nowhere.
    earlier: condition of the fault that is opened at `unit` before `condition` is known; empty: none.
    also: units of further faults that it causes, independent of the first, each with a separate alarm.
    healable: whether PHM is expected to recover it. passes: it ends without anybody's doing.
    prepared: what `prepare` adds to the agent, in words; empty: nothing.
    needs: what it takes: ``air``, emulated links; ``peers``, other agents; ``configuration``, changes to the
    shipped one, which `configuration` gives; ``alone``, since all agents of the machine see it; ``starvation``, someone who
    judges its symptoms as those of one cause, which `sitl.bench.starvation` does.
    delays_record: PHM can write its record of it only once it is cleared.
    least: how many agents its swarm must have for it to be what it says.
    evidence: the earliest event on board that reveals it (a missed heartbeat, a missed period, a kernel event), and
    evidence_s: how many seconds after the injection that event happens, at the latest; None: not stated yet.
    outage_s: how long it keeps the Docker Engine from PHM: what is known through the engine alone is hidden for this long.
    evidence_period_s: its period, where that event is periodic: on average it happens half a period earlier.
    by_healthcheck: that period is the interval of the application's HEALTHCHECK, 3 s in a swarm.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    cause: ClassVar[str]
    layer: ClassVar[str]
    unit: ClassVar[str]
    condition: ClassVar[str]
    level: ClassVar[str] = "ERROR"
    others: ClassVar[str] = ""
    earlier: ClassVar[str] = ""
    also: ClassVar[tuple[str, ...]] = ()
    healable: ClassVar[bool] = True
    passes: ClassVar[bool] = False
    prepared: ClassVar[str] = ""
    needs: ClassVar[frozenset[str]] = frozenset()
    delays_record: ClassVar[bool] = False
    least: ClassVar[int] = 1
    evidence: ClassVar[str] = ""
    evidence_s: ClassVar[float | None] = None
    evidence_period_s: ClassVar[float] = 0.0
    by_healthcheck: ClassVar[bool] = False
    outage_s: ClassVar[float] = 0.0

    def places(self, agent: Agent) -> tuple[str, ...]:
        """Units at which an alarm is due, exactly one at each; none where the condition is not reported as a fault."""
        return tuple(
            unit.format(agent=agent.name, id=f"A{agent.number:02d}") for unit in (self.unit, *self.also) if unit
        )

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        """Changes to the shipped configuration without which it cannot be seen, for `sitl.harness.config_overrides`."""
        return {}

    def prepare(self, agent: Agent) -> None:
        """Create what that configuration names, before PHM watches it."""

    def dismantle(self, agent: Agent) -> None:
        """Take it out of the world again. Doing it twice is harmless."""

    @abstractmethod
    def inject(self, agent: Agent) -> float:
        """Cause it; the moment from which it was there, in seconds of the monotonic clock, never too late."""

    def clear(self, agent: Agent) -> None:
        """Undo what PHM's recovery does not undo. Doing it twice is harmless."""

    def restored(self, agent: Agent) -> bool | None:
        """Whether the world is as before the injection, observed without PHM. None: this fault cannot be observed so.

        Read-only and quick (at most 2 s): it is called repeatedly during a trial, from a separate thread. Exceptions of
        Docker mean "not now".
        """
        return None


@contextlib.contextmanager
def undoing(undo: Callable[[], None]) -> Iterator[None]:
    """Undo what was begun when its block does not reach its end, also when it is interrupted."""
    try:
        yield
    except BaseException:
        undo()
        raise


DIES_S = 60.0
"""Beside an overload, 12 s passed before an application had filled 512 MB and the kernel ended it."""


def died(app: Container, before: str) -> float:
    """The moment at which the container ended, by the engine's own stamp, up to 0.2 s later. `before`: the stamp of the end before.

    Raises TimeoutError when it has not ended within DIES_S.
    """
    until_s = time.monotonic() + DIES_S
    while time.monotonic() < until_s:
        app.reload()
        ended = str(app.attrs["State"]["FinishedAt"])
        if ended != before:
            return mono_of(ended)
        time.sleep(0.01)
    raise TimeoutError(f"{app.name} has not ended within {DIES_S:g} s")


def mono_of(engine_time: str) -> float:
    """An engine's time stamp (RFC 3339, nanoseconds) on this machine's monotonic clock."""
    head, _, fraction = engine_time.rstrip("Z").partition(".")
    utc = datetime.fromisoformat(f"{head}+00:00").timestamp() + float(f"0.{fraction or 0}")
    return time.monotonic() - (time.time() - utc)
