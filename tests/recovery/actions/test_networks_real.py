"""A network that is removed and recreated on the real engine: its containers are reconnected and never restarted."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from docker.errors import APIError

from phm.core.model import ActionEvent, FaultOpened, Phase
from phm.recovery.actions.start import Start
from phm.transport.docker import DockerEngine
from tests.recovery.action_bench import bench, fault
from tests.recovery.test_recovery_real import RUN, Phm, Start as StartPhm, phm

__all__ = ["phm"]

pytestmark = pytest.mark.engine

UNIT = "network/app"


def entry(app: Any, network: Any) -> dict[str, Any]:
    return {"name": app.name, "alias": "app", "recover": True, "networks": [network.name]}


def remove_network(daemon: Phm, network: Any, app: Any) -> None:
    """Remove it as `docker compose down` of its project does: at the moment in which PHM reconnects the application to
    it.
    """
    original, gone = daemon.daemon.components.probes.engine.connect, threading.Event()

    def connect(network_: str, container: str, aliases: Any, addresses: Any) -> None:
        if not gone.is_set():
            network.reload()
            for other in network.containers:  # PHM's own
                network.disconnect(other, force=True)
            network.remove()
            gone.set()
        original(network_, container, aliases, addresses)

    patch(daemon, connect)
    network.disconnect(app, force=True)
    daemon.until(gone.is_set, "the network to be removed")


def patch(daemon: Phm, connect: Callable[[str, str, Any, Any], None]) -> None:
    """Make PHM connect containers by this function; the arguments have the names of the original."""

    def named(network: str, container: str, aliases: Any = (), addresses: Any = ()) -> None:
        connect(network, container, aliases, addresses)

    daemon.daemon.components.probes.engine.connect = named  # type: ignore[method-assign]


def attached(app: Any) -> list[str]:
    app.reload()
    return [str(each["NetworkID"]) for each in app.attrs["NetworkSettings"]["Networks"].values()]


def started_at(app: Any) -> str:
    app.reload()
    return str(app.attrs["State"]["StartedAt"])


def condition(daemon: Phm) -> str:
    states = daemon.daemon.pipeline.states()
    return next(state.result.condition for state in states if state.unit == UNIT)


def assert_only_connected(daemon: Phm, app: Any, network: Any, before: str) -> None:
    daemon.until(lambda: attached(app) == [network.id], "the container to be on the new network")
    daemon.until(lambda: not daemon.daemon.pipeline.open_faults(), "the end of the fault")
    assert started_at(app) == before
    acted = {event.action for event in daemon.events if isinstance(event, ActionEvent)}
    assert "reconnect" in acted
    assert acted <= {"reconnect", "join_network"}
    assert daemon.count(Phase.ESCALATED) == 0
    assert daemon.daemon.pipeline.given_up() == ()


def test_a_quickly_recreated_network_is_reconnected(real: Any, phm: StartPhm) -> None:
    """Removed and created within moments, under the same name with another id."""
    network = real.network()
    app = real.container(RUN, network=network.name)
    daemon = phm([entry(app, network)], verify="60s")
    before = started_at(app)
    remove_network(daemon, network, app)
    new = real.network(network.name)
    assert new.id != network.id
    assert_only_connected(daemon, app, new, before)


def test_a_long_missing_network_is_waited_for(real: Any, phm: StartPhm) -> None:
    """However long: no attempt is used up, nothing is restarted, and its creation resumes the action."""
    network = real.network()
    app = real.container(RUN, network=network.name)
    daemon = phm([entry(app, network)], verify="60s")
    before = started_at(app)
    remove_network(daemon, network, app)
    daemon.until(lambda: condition(daemon) == "network_missing", "PHM to see that it is missing")
    daemon.passes(3)
    assert started_at(app) == before
    assert [fault.unit for fault in daemon.daemon.pipeline.open_faults()] == [UNIT]
    new = real.network(network.name)
    assert_only_connected(daemon, app, new, before)


def test_a_stopped_container_is_started_on_the_new_network(real: Any, engine: DockerEngine) -> None:
    """The engine refuses: the container is attached to a removed network."""
    network = real.network()
    app = real.container(RUN, network=network.name)
    app.stop(timeout=1)
    network.remove()
    made = bench(engine, containers=[entry(app, network)])
    exited = fault("container/app", "exited")
    assert "there is no network" in Start().waits_for(made.target("app"), exited, made.context())
    new = real.network(network.name)
    with pytest.raises(APIError, match="not found"):
        app.start()
    assert Start().waits_for(made.target("app"), exited, made.context()) == ""
    made.run(Start, "app", exited)
    assert attached(app) == [new.id]
    assert app.status == "running"


def test_phm_and_the_application_lose_the_network_together(real: Any, phm: StartPhm) -> None:
    """PHM first detects that it is itself off the network and joins; then the application is off the network, and is
    connected.

    PHM runs on the host here, so another container represents its own.
    """
    network = real.network()
    app, own = real.container(RUN, network=network.name), real.container(RUN, network=network.name)
    daemon = phm([entry(app, network)], docker={"container": own.name}, verify="60s")
    before, lost = started_at(app), threading.Event()
    original = daemon.daemon.components.probes.engine.connect

    def connect(network_: str, container: str, aliases: Any, addresses: Any) -> None:
        original(network_, container, aliases, addresses)
        if not lost.is_set():
            lost.set()
            network.disconnect(app, force=True)

    patch(daemon, connect)
    network.disconnect(own, force=True)
    daemon.until(lambda: attached(own) == [network.id] and attached(app) == [network.id], "both to be connected")
    daemon.until(lambda: not daemon.daemon.pipeline.open_faults(), "the end of the fault")
    assert started_at(app) == before
    conditions = [event.fault.result.condition for event in daemon.events if isinstance(event, FaultOpened)]
    assert conditions == ["sidecar_disconnected"]
    started = [
        event.action for event in daemon.events if isinstance(event, ActionEvent) and event.phase is Phase.STARTED
    ]
    assert list(dict.fromkeys(started)) == [
        "join_network",
        "reconnect",
    ]  # an engine that answers late is asked to join again
