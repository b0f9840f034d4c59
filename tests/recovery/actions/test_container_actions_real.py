"""The actions on the real engine: files are restored, programs start, dependents follow, and repeating is harmless."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from phm.facts import NotPermitted
from phm.recovery.actions.relaunch import Relaunch
from phm.recovery.actions.restart import Restart
from phm.recovery.actions.restore_file import RestoreFile
from phm.recovery.actions.start import Start
from phm.recovery.base import ActionFailed, FlightCriticalError
from phm.transport.docker import DockerEngine
from tests.fakes.until import until
from tests.proxy.haproxy import BehindProxy
from tests.recovery.action_bench import Bench, bench, fault

pytestmark = pytest.mark.engine

PROGRAM = "/bin/printenv"
"""An executable that every base image has, behind a symbolic link on most."""
DAMAGE = {
    "rm": f"rm {PROGRAM}",
    "chmod -x": f"chmod a-x {PROGRAM}",
    "overwrite": f"echo x > {PROGRAM}",
}
EXITED = fault("container/app", "exited")
MISSING = fault("files/app", "file_missing")


def inside(made: Any, command: str) -> str:
    """The output of a command that must succeed."""
    code, output = made.exec_run(["sh", "-c", command])
    assert code == 0, output
    return str(output.decode()).strip()


def printed(made: Any, command: str) -> str:
    """The same of one that prints something: a busy engine now and then loses what a command has printed."""
    return until(lambda: inside(made, command), "the command's output")


def only(engine: DockerEngine, made: Any, **more: Any) -> Bench:
    return bench(engine, containers=[{"name": made.name, "alias": "app", "recover": True, **more}])


def refused(action: Callable[[], object]) -> None:
    """Behind the proxy: creating a container, and writing into another folder than the file's own."""
    with pytest.raises(NotPermitted, match="HTTP 403"):
        action()


def left_over(real: Any, made: Any) -> list[str]:
    """Those of other tests come and go meanwhile: they are not asked for, and none that has gone since is missed."""
    filters = {"label": "phm.restore=1", "name": made.id[:12]}
    return [entry.name for entry in real.client.containers.list(all=True, filters=filters, ignore_removed=True)]


@pytest.mark.parametrize("source", ["image", "golden"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_program_is_restored(
    real: Any, engine: DockerEngine, tmp_path: Path, damage: str, source: str
) -> None:
    """After rm, chmod -x and overwriting; with content, mode and owner as before; repeating it is harmless."""
    made = real.container()
    before = printed(made, f"stat -L -c '%a %u %g' {PROGRAM}; sha256sum < {PROGRAM}")
    golden = tmp_path / "golden"
    golden.write_bytes(engine.read_file(made.id, printed(made, f"readlink -f {PROGRAM}")))
    golden.chmod(0o755)
    digest = hashlib.sha256(golden.read_bytes()).hexdigest()
    restore = "image" if source == "image" else str(golden)
    file = {"path": PROGRAM, "executable": True, "sha256": digest, "restore": restore}
    bench_ = only(engine, made, files=[file])
    inside(made, DAMAGE[damage])
    if source == "image" and isinstance(engine, BehindProxy):
        refused(lambda: bench_.run(RestoreFile, "app", MISSING))
        return
    assert "restored in app" in bench_.run(RestoreFile, "app", MISSING)
    assert printed(made, f"stat -L -c '%a %u %g' {PROGRAM}; sha256sum < {PROGRAM}") == before
    assert printed(made, f"{PROGRAM} PATH")
    assert "as configured" in bench_.run(RestoreFile, "app", MISSING)
    assert left_over(real, made) == []


def test_a_file_is_restored_into_a_volume_of_a_stopped_container(
    real: Any, engine: DockerEngine, tmp_path: Path
) -> None:
    """Missing directories are created again, and the container need not run."""
    volume = real.volume()
    made = real.container("exit 0", volumes={volume.name: {"bind": "/data", "mode": "rw"}})
    golden = tmp_path / "golden"
    golden.write_bytes(b"good")
    made.wait(timeout=60)
    path = "/data/deep/er/file"
    bench_ = only(engine, made, files=[{"path": path, "restore": str(golden)}])
    if isinstance(engine, BehindProxy):
        refused(lambda: bench_.run(RestoreFile, "app", MISSING))
        return
    bench_.run(RestoreFile, "app", MISSING)
    assert engine.read_file(made.id, path) == b"good"
    other = real.container(volumes={volume.name: {"bind": "/seen", "mode": "ro"}})
    assert printed(other, "cat /seen/deep/er/file") == "good"


def test_a_file_that_the_image_lacks_is_reported(real: Any, engine: DockerEngine) -> None:
    """And no container remains."""
    made = real.container()
    bench_ = only(engine, made, files=[{"path": "/nowhere/file", "restore": "image"}])
    if isinstance(engine, BehindProxy):
        refused(lambda: bench_.run(RestoreFile, "app", MISSING))
        return
    with pytest.raises(ActionFailed, match="not in the image"):
        bench_.run(RestoreFile, "app", MISSING)
    assert left_over(real, made) == []


def test_relaunch_starts_a_program_with_the_containers_user_and_environment(real: Any, engine: DockerEngine) -> None:
    """Detached, no shell, one copy however often it is repeated."""
    made = real.container(user="1234", environment={"WHO": "me"})
    run = ["sh", "-c", 'echo "$WHO $(id -u) $0" > /tmp/said; exec sleep 4321', "a b;reboot"]
    node = {"name": "/one", "container": "app", "relaunch": run}
    bench_ = bench(engine, containers=[{"name": made.name, "alias": "app", "recover": True}], ros={"nodes": [node]})
    gone = fault("nodes/one", "node_missing", node="/one")
    bench_.run(Relaunch, "app", gone)
    # Not the shell before it, whose command line has these words, too.
    until(lambda: any(row[-1] == "sleep 4321" for row in engine.top(made.id)["Processes"]), "the program to run")
    assert printed(made, "cat /tmp/said") == "me 1234 a b;reboot"


def test_a_repeated_relaunch_starts_one_copy(real: Any, engine: DockerEngine) -> None:
    """The running command is found among the container's processes."""
    made = real.container()
    node = {"name": "/one", "container": "app", "relaunch": ["sleep", "4322"]}
    bench_ = bench(engine, containers=[{"name": made.name, "alias": "app", "recover": True}], ros={"nodes": [node]})
    gone = fault("nodes/one", "node_missing", node="/one")
    bench_.run(Relaunch, "app", gone)

    def copies() -> int:
        return sum("sleep 4322" in row[-1] for row in engine.top(made.id)["Processes"])

    until(lambda: copies() == 1, "the program to run")
    with pytest.raises(ActionFailed, match="second copy"):
        bench_.run(Relaunch, "app", gone)
    assert copies() == 1


def test_dependents_follow_in_order_and_share_the_new_namespace(real: Any, engine: DockerEngine) -> None:
    """`side` shares the network of `app`, `late` starts after `side`; all are restarted, one after another."""
    app = real.container("trap 'exit 0' TERM; while :; do sleep 0.1; done")
    side = real.container("trap 'exit 0' TERM; while :; do sleep 0.1; done", network_mode=f"container:{app.id}")
    late = real.container("trap 'exit 0' TERM; while :; do sleep 0.1; done")
    apart = real.container()
    entries = [
        {"name": late.name, "alias": "late", "recover": True, "after": ["side"]},
        {"name": apart.name, "alias": "apart", "recover": True},
        {"name": side.name, "alias": "side", "recover": True},
        {"name": app.name, "alias": "app", "recover": True},
    ]
    made = bench(engine, containers=entries)

    def started() -> dict[str, str]:
        return {one["alias"]: engine.inspect(str(one["name"]))["State"]["StartedAt"] for one in entries}

    for action in (Restart, Start, Restart):
        before = started()
        if action is Start:
            engine.kill(app.id)
        made.run(action, "app", EXITED)
        after = started()
        assert before["app"] < after["app"] < after["side"] < after["late"]
        assert before["apart"] == after["apart"]
    assert printed(side, "readlink /proc/1/ns/net") == printed(app, "readlink /proc/1/ns/net")
    assert made.run(Start, "app", EXITED) == "app is already running"
    assert started() == after


def test_a_dependent_in_its_pid_namespace_is_restarted(real: Any, engine: DockerEngine) -> None:
    """It was killed with the first process of that namespace."""
    app = real.container("trap 'exit 0' TERM; while :; do sleep 0.1; done")
    side = real.container(pid_mode=f"container:{app.id}", init=False)
    entries = [{"name": one.name, "alias": alias, "recover": True} for one, alias in ((side, "side"), (app, "app"))]
    made = bench(engine, containers=entries)
    assert made.run(Restart, "app", EXITED) == "restarted app; restarted side, which depends on it"
    assert engine.inspect(side.id)["State"]["Running"]
    assert printed(side, "readlink /proc/self/ns/pid") == printed(app, "readlink /proc/self/ns/pid")


def test_a_dependent_in_its_ipc_namespace_is_restarted(real: Any, engine: DockerEngine) -> None:
    """It ran on with the /dev/shm of the previous run, which the restarted container does not see."""
    app = real.container("trap 'exit 0' TERM; while :; do sleep 0.1; done", ipc_mode="shareable")
    side = real.container("trap 'exit 0' TERM; while :; do sleep 0.1; done", ipc_mode=f"container:{app.id}")
    entries = [{"name": one.name, "alias": alias, "recover": True} for one, alias in ((side, "side"), (app, "app"))]
    made = bench(engine, containers=entries)
    assert made.run(Restart, "app", EXITED) == "restarted app; restarted side, which depends on it"
    inside(app, "echo new > /dev/shm/file")
    assert printed(side, "cat /dev/shm/file") == "new"


def test_an_armed_flight_critical_container_is_protected_under_each_name(real: Any, engine: DockerEngine) -> None:
    """So is one that is not configured and whose network it shares; the proxy refuses names that are not exact."""
    gateway = real.container()
    app = real.container(network_mode=f"container:{gateway.id}")
    made = bench(
        engine,
        containers=[{"name": app.name, "alias": "app", "recover": True, "flight_critical": True}],
        mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14599", "leads_to": "autopilot"}]},
    )
    made.armed = True
    ask = made.context().engine
    before = [engine.inspect(one.id)["State"]["StartedAt"] for one in (app, gateway)]
    for one in (app, gateway):
        for ref in (one.name, one.id, one.id[:12]):
            with pytest.raises((FlightCriticalError, NotPermitted)):
                ask.restart(ref)
        with pytest.raises((FlightCriticalError, NotPermitted)):
            ask.disconnect("bridge", f"/{one.name}", force=True)
    assert [engine.inspect(one.id)["State"]["StartedAt"] for one in (app, gateway)] == before


@pytest.mark.parametrize("kind", ["network_mode", "pid_mode", "ipc_mode"])
def test_an_armed_flight_critical_container_is_protected_behind_one_that_is_not_configured(
    real: Any, engine: DockerEngine, kind: str
) -> None:
    """Both are in the namespace of `app`; the proxy does not say what it is not configured for, and that counts as critical."""
    app = real.container(**({"ipc_mode": "shareable"} if kind == "ipc_mode" else {}))
    own_init = {"init": False} if kind == "pid_mode" else {}
    between = real.container(**{kind: f"container:{app.id}"}, **own_init)
    pilot = real.container(**{kind: f"container:{between.id}"}, **own_init)
    space = f"readlink /proc/self/ns/{kind.removesuffix('_mode').replace('network', 'net')}"
    assert printed(pilot, space) == printed(app, space)
    made = bench(
        engine,
        containers=[
            {"name": app.name, "alias": "app", "recover": True},
            {"name": pilot.name, "alias": "pilot", "recover": True, "flight_critical": True},
        ],
        mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14599", "leads_to": "autopilot"}]},
    )
    made.armed = True
    before = engine.inspect(app.id)["State"]["StartedAt"]
    with pytest.raises(FlightCriticalError, match=r"would take down pilot|what it would take down is not known"):
        made.run(Restart, "app", EXITED)
    assert engine.inspect(app.id)["State"]["StartedAt"] == before
