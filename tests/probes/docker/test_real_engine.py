"""The Docker probe with real containers and networks on the real engine."""

from __future__ import annotations

import contextlib
import hashlib
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.core.model import Level, Result
from phm.facts import CannotTell, ContainerFact
from phm.probes.container_watcher import ContainerWatcher
from phm.probes.docker import Docker
from phm.probes.docker_event import CONTAINER_ACTIONS, DockerEvent
from phm.probes.files import Files
from phm.testing import settings
from phm.transport.docker import DockerEngine, EngineConflict, EngineError, EngineMissing
from phm_checks.unknown_containers import UnknownContainers
from sitl.faults.address_silent import set_link
from sitl.faults.base import freeze
from tests.fakes.until import until
from tests.probes.docker.conftest import printed

pytestmark = pytest.mark.engine

ILL = ["touch", "/tmp/ill"]
HEALTH = {
    "test": ["CMD", "test", "!", "-e", "/tmp/ill"],
    "interval": 500_000_000,
    "retries": 1,
    "timeout": 60_000_000_000,
}
"""Healthy from the first moment on, however late a busy machine starts the program of the container, until ILL is run."""


def probe(engine: DockerEngine, *names: str) -> Docker:
    return Docker(
        engine, settings(containers=[{"name": name} for name in names]).containers, settings().docker, SystemClock()
    )


def fact_of(docker: Docker, name: str) -> ContainerFact:
    docker.invalidate()
    fact = docker.container(name)
    assert fact is not None
    return fact


@pytest.fixture
def received(engine: DockerEngine, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., list[DockerEvent]]]:
    """Start a watcher on the real engine; the list fills as events arrive. None counts as lost because a busy machine is late."""
    watches: list[ContainerWatcher] = []
    monkeypatch.setattr("phm.probes.container_watcher.CONFIRM_S", 30.0)

    def start(**more: Any) -> list[DockerEvent]:
        events: list[DockerEvent] = []
        chosen = settings(docker={"compare": 60.0}, **more)
        watch = ContainerWatcher(engine, chosen.containers, chosen.docker, SystemClock(), events.append)
        watches.append(watch)
        watch.start()
        until(watch.healthy, "the watcher to connect")
        return events

    yield start
    for watch in watches:
        watch.stop()


@contextlib.contextmanager
def published(container: Any) -> Iterator[list[str]]:
    """The actions that the engine publishes about the state of a container from now on, read by docker-py until it ends."""
    # The engine answers before it collects events: without a time, a busy one would miss the first.
    since = f"{time.time():.9f}"
    stream, sent = container.client.events(since=since, filters={"container": container.id}, decode=True), []

    def read() -> None:
        for event in stream:
            action = str(event["Action"]).partition(":")[0]
            if action in CONTAINER_ACTIONS:
                sent.append(action)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield sent
    finally:
        stream.close()
        reader.join()


def test_the_engine_responds(engine: DockerEngine) -> None:
    """The version is the engine's own."""
    assert probe(engine).engine()[0].isdigit()


def test_the_states_of_a_container_are_read(real: Any, engine: DockerEngine) -> None:
    """running, paused, running, exited with its code, and running again as another generation."""
    made = real.container("trap 'exit 7' TERM; echo ready; while :; do sleep 0.1; done")
    docker = probe(engine, made.name)
    until(lambda: b"ready" in made.logs(), "the program to take the signal")
    first = fact_of(docker, made.name)
    assert (first.status, first.running, first.health, first.restart_policy) == ("running", True, "none", "no")
    engine.pause(made.name)
    assert fact_of(docker, made.name).status == "paused"
    engine.unpause(made.name)
    engine.stop(made.name, 60)
    stopped = fact_of(docker, made.name)
    assert (stopped.status, stopped.exit_code, stopped.oom_killed) == ("exited", 7, False)
    engine.start(made.name)
    second = fact_of(docker, made.name)
    assert second.running
    assert second.generation != first.generation
    engine.restart(made.name, 10)
    assert fact_of(docker, made.name).generation != second.generation
    engine.kill(made.name)
    until(lambda: fact_of(docker, made.name).exit_code == 137, "the kill to be visible")
    made.remove(force=True)
    docker.invalidate()
    assert docker.container(made.name) is None


def test_a_failing_healthcheck_is_read_with_its_output(real: Any, engine: DockerEngine) -> None:
    """healthy while the command succeeds, unhealthy with its streak when it fails."""
    made = real.container("exec sleep 600", healthcheck=HEALTH)
    docker = probe(engine, made.name)
    until(lambda: fact_of(docker, made.name).health == "healthy", "healthy")
    made.exec_run(ILL)
    until(lambda: fact_of(docker, made.name).health == "unhealthy", "unhealthy")
    assert fact_of(docker, made.name).health_streak >= 1


def test_an_oom_kill_is_detected(real: Any, engine: DockerEngine) -> None:
    """The engine reports that the kernel killed the container."""
    made = real.container(
        "exec python3 -c 'x = bytearray(200 << 20)'", mem_limit="32m", memswap_limit="32m", start=False
    )
    docker = probe(engine, made.name)
    made.start()
    until(lambda: fact_of(docker, made.name).status == "exited", "the container's end")
    assert fact_of(docker, made.name).exit_code == 137
    # The engine learns of the end and of its cause by two messages of containerd, in any order.
    until(lambda: fact_of(docker, made.name).oom_killed, "the cause", lambda: fact_of(docker, made.name))


def test_events_of_a_real_container_trigger_its_checks(
    real: Any, engine: DockerEngine, received: Callable[..., list[DockerEvent]]
) -> None:
    """Each change of state that the engine publishes arrives once and in order; runs of its healthcheck do not."""
    made = real.container("exec sleep 600", start=False, healthcheck=HEALTH)
    events = received(containers=[{"name": made.name}])
    with published(made) as sent:
        made.start()
        until(lambda: "healthy" in [event.detail for event in events], "healthy")
        made.exec_run(ILL)
        until(lambda: "unhealthy" in [event.detail for event in events], "unhealthy")
        freeze(made)
        made.unpause()
        made.kill()
        until(lambda: "die" in [event.action for event in events], "death")
        until(lambda: "die" in sent, "death, by another reader")
    actions = [event.action for event in events if event.kind == "container"]
    assert actions == sent
    # The engine publishes a pause twice, with its end, if it learns from containerd only after the end that it paused.
    once = re.sub("(pause unpause )+", r"\1", " ".join(actions))
    assert once == "start health_status health_status pause unpause kill die"
    assert "exit code 137" in [event.detail for event in events]
    assert not any(event.lost for event in events)


def test_restarts_by_the_engine_are_counted_and_a_manual_start_resets_the_count(
    real: Any, engine: DockerEngine, received: Callable[..., list[DockerEvent]]
) -> None:
    """The counter distinguishes the engine from an operator; each start is another generation, published once."""
    made = real.container(
        "test -e /tmp/go || { until test -e /tmp/go; do sleep 0.1; done; exit 3; }; exec sleep 600", start=False
    )
    made.update(restart_policy={"Name": "always"})
    docker = probe(engine, made.name)
    events = received(containers=[{"name": made.name}])
    made.start()
    first = fact_of(docker, made.name)
    made.exec_run(["touch", "/tmp/go"])
    until(lambda: [event.starts for event in events].count(True) == 2, "the restart by the policy")
    again = fact_of(docker, made.name)
    assert (first.restart_count, again.restart_count) == (0, 1)
    made.restart(timeout=0)
    until(lambda: "restart" in [event.action for event in events], "the manual restart")
    by_hand = fact_of(docker, made.name)
    assert by_hand.restart_count == 0
    assert len({first.generation, again.generation, by_hand.generation}) == 3
    assert [event.starts for event in events].count(True) == 3


def test_networks_are_disconnected_and_connected_with_ids(
    real: Any, engine: DockerEngine, received: Callable[..., list[DockerEvent]]
) -> None:
    """Disconnected, then connected again with its alias: visible as events and as facts, by the network's id."""
    network = real.network()
    made = real.container(network=network.name)
    docker = probe(engine, made.name)
    assert docker.network_id(network.name) == network.id
    assert [(at.name, at.network_id) for at in fact_of(docker, made.name).networks] == [(network.name, network.id)]
    events = received(containers=[{"name": made.name, "networks": [network.name]}])
    engine.disconnect(network.name, made.name, force=True)
    assert fact_of(docker, made.name).networks == ()
    engine.connect(network.id, made.name, aliases=("nav",))
    joined = fact_of(docker, made.name).networks[0]
    assert joined.network_id == network.id
    assert "nav" in joined.aliases
    assert joined.address
    until(lambda: "connect" in [event.action for event in events], "both events")
    said = [(event.key, event.action, event.container) for event in events]
    if (
        len(said) == 3
    ):  # the engine itself sends `disconnect` twice; on a busy machine so late that it counts as another one
        assert said[0] == said.pop(1)
    assert said == [
        (network.name, "disconnect", made.name),
        (network.name, "connect", made.name),
    ]
    assert docker.network_id(real.name()) == ""


def test_an_address_responds_as_long_as_its_container_exists(real: Any, engine: DockerEngine) -> None:
    """A container on a bridge responds, even when paused; a removed one does not."""
    network = real.network()
    made = real.container(network=network.name)
    docker = probe(engine, made.name)
    address = fact_of(docker, made.name).networks[0].address
    until(lambda: docker.reachable(address), "an answer")
    assert not docker.reachable(address.rpartition(".")[0] + ".254")


def test_an_address_behind_a_disabled_interface_is_silent_immediately(real: Any, engine: DockerEngine) -> None:
    """The interface of a container that responded before goes down: ARP, which still has its entry, does not count."""
    network = real.network()
    made = real.container(network=network.name)
    real.container(network=network.name)  # a bridge without any live port forgets all neighbours by itself
    docker = probe(engine, made.name)
    address = fact_of(docker, made.name).networks[0].address
    until(lambda: docker.reachable(address), "an answer")
    set_link(socket.if_indextoname(int(printed(made, "cat", "/sys/class/net/eth0/iflink"))), up=False)
    assert not docker.reachable(address)


def test_an_echo_is_answered_where_the_kernel_allows_it(real: Any) -> None:
    """In a container ICMP is unprivileged, so a firewalled TCP stack can still be reached; no root is needed."""
    network = real.network()
    peer = real.container(network=network.name)
    peer.reload()
    address = peer.attrs["NetworkSettings"]["Networks"][network.name]["IPAddress"]
    source = Path(__file__).resolve().parents[3] / "phm"
    program = (
        "from phm.probes import ping; import socket, sys; "
        "echo = ping._echo(socket.AF_INET, sys.argv[1]); assert echo is not None; "
        "import select; assert select.select([echo], [], [], 60)[0] and echo.recv(256); "
        "assert ping.answers(sys.argv[1]); print('answers')"
    )
    mine = real.container(
        network=network.name,
        volumes={str(source): {"bind": "/src/phm", "mode": "ro"}},
        user="1000:1000",
        cap_drop=["ALL"],
    )

    def said() -> str:
        code, output = mine.exec_run(
            ["python3", "-c", program, address], environment={"PYTHONPATH": "/src"}, user="1000:1000"
        )
        assert code == 0, output
        return str(output.decode()).strip()

    assert until(said, "its output, which a busy engine may lose") == "answers"


def test_the_own_container_is_found_from_inside(real: Any, engine: DockerEngine, tmp_path: Path) -> None:
    """/proc inside a real container has the id by which the engine knows it."""
    made = real.container()
    for file in ("mountinfo", "cgroup"):
        (tmp_path / file).write_text(printed(made, "cat", f"/proc/self/{file}"))
    me = Docker(engine, [], settings().docker, SystemClock(), proc=tmp_path).own_container()
    assert me is not None
    assert me.id == made.id


def test_a_real_unknown_container_is_reported_until_it_ends(real: Any, engine: DockerEngine) -> None:
    """Its start and its end wake the check. Configured and ignored containers are not unknown."""
    app, tool = real.container(), real.container(name=f"tool-{real.name()}")
    chosen = settings(
        containers=[{"name": app.name}],
        docker={"compare": 60.0, "unknown_containers": {"level": "warn", "ignore": ["tool-*"]}},
    )
    (check,) = UnknownContainers.build(chosen)
    world = testing.world(docker=Docker(engine, chosen.containers, chosen.docker, SystemClock()))
    woken = threading.Event()
    watch = ContainerWatcher(
        engine, chosen.containers, chosen.docker, SystemClock(), lambda event: None, on_other=woken.set
    )
    watch.start()
    until(watch.healthy, "the watcher to connect")

    def named(name: str) -> bool:
        return any(other.name == name for other in world.docker.others())

    woken.clear()
    unknown = real.container()
    assert woken.wait(60.0)
    until(lambda: named(unknown.name), "the unknown container")
    result = check.run(world)
    assert isinstance(result, Result) and (result.level, result.condition) == (Level.WARN, "container_unknown")
    assert not named(app.name) and named(tool.name) and f"{tool.name} (" not in result.summary
    woken.clear()
    unknown.kill()
    assert woken.wait(60.0)
    until(lambda: not named(unknown.name), "its end")
    watch.stop()


def test_a_label_finds_a_real_container(real: Any, engine: DockerEngine) -> None:
    """Two containers with one label are ambiguous until one of them stops."""
    label = {"phm.test.role": real.name()}
    one, two = real.container(labels=label), real.container(labels=label)
    entry = {"label": f"phm.test.role={label['phm.test.role']}", "alias": "app"}
    docker = Docker(engine, settings(containers=[entry]).containers, settings().docker, SystemClock())
    with pytest.raises(CannotTell, match="names 2 containers"):
        docker.container("app")
    one.kill()
    one.wait()  # a newer engine answers before the container has ended
    assert fact_of(docker, "app").id == two.id


def test_a_file_is_the_same_by_volume_and_by_engine(
    real: Any, engine: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mode, size and digest of one file agree for both ways, symlinks included."""
    monkeypatch.setattr("phm.probes.files.DIGEST_S", 120.0)  # the machine may be busy
    volume = real.volume()
    made = real.container(
        "umask 022; head -c 3000000 /dev/urandom > /data/model; chmod 750 /data/model; cp -p /data/model /opt/model; "
        "ln -s /data/model /opt/link; ln -s model /opt/same; touch /data/done; exec sleep 600",
        volumes={volume.name: {"bind": "/data", "mode": "rw"}},
    )
    docker = probe(engine, made.name)
    files = Files(docker, engine, settings().docker, SystemClock())
    until(lambda: files.inspect(made.name, "/data/done", digest=False), "the files", lambda: fact_of(docker, made.name))
    wanted = hashlib.sha256(engine.read_file(made.name, "/opt/model", 4 << 20)).hexdigest()
    seen = {
        path: files.inspect(made.name, path, digest=True)
        for path in ("/data/model", "/opt/model", "/opt/link", "/opt/same")
    }
    for path, fact in seen.items():
        assert fact is not None, path
        assert (fact.kind, fact.size, fact.mode, fact.executable, fact.sha256) == ("file", 3000000, 0o750, True, wanted)
        assert fact.seen_through == ("volume" if path == "/data/model" else "engine")
    directory = files.inspect(made.name, "/etc", digest=True)
    assert directory is not None
    assert (directory.kind, directory.seen_through) == ("directory", "engine")
    assert files.inspect(made.name, "/opt/none", digest=True) is None
    engine.stop(made.name, 0)
    assert files.inspect(made.name, "/opt/model", digest=True) == seen["/opt/model"]


def test_symlinks_in_a_volume_show_nothing_of_the_host(real: Any, engine: DockerEngine) -> None:
    """A link to /etc/hostname in a volume is the container's own file, read through the engine."""
    volume = real.volume()
    made = real.container(
        "ln -s /etc/os-release /data/escape; ln -s ../../../../../../etc/shadow-of-host /data/climb; touch /data/done; exec sleep 600",
        volumes={volume.name: {"bind": "/data", "mode": "rw"}},
    )
    docker = probe(engine, made.name)
    files = Files(docker, engine, settings().docker, SystemClock())
    until(lambda: files.inspect(made.name, "/data/done", digest=False), "the files", lambda: fact_of(docker, made.name))
    seen = files.inspect(made.name, "/data/escape", digest=False)
    assert seen is not None
    assert (seen.kind, seen.seen_through) == ("file", "engine")
    assert files.inspect(made.name, "/data/climb", digest=False) is None


def test_processes_of_a_real_container_are_listed(real: Any, engine: DockerEngine) -> None:
    """The process list needs no exec."""
    made = real.container("exec sleep 321")
    until(lambda: any(row[-1] == "sleep 321" for row in engine.top(made.name)["Processes"]), "the program")


def test_refusals_of_the_real_engine_have_their_kinds(real: Any, engine: DockerEngine) -> None:
    """404 and 409 mean the same from the real engine as from the fake one."""
    with pytest.raises(EngineMissing):
        engine.inspect(real.name())
    with pytest.raises(EngineMissing):
        engine.start(real.name())
    made = real.container()
    engine.pause(made.name)
    with pytest.raises(EngineConflict):
        engine.pause(made.name)
    with pytest.raises(EngineError):
        engine.connect(real.name(), made.name)
    with pytest.raises(EngineMissing):
        engine.stat_path(made.name, "/no/such/path")
