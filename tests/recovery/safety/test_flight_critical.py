"""A container that is flight-critical, or whose action would take down one that is, is left alone unless disarmed."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any, cast

import pytest

from phm import testing
from phm.core.settings import Settings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.attempt import NOT_ABOUT_A_CONTAINER, READS
from phm.recovery.base import FlightCriticalError, Impact
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.recovery.safety.flight_critical import FlightCriticalGuard
from phm.testing import settings
from phm.transport.docker import DockerEngine, EngineMissing
from phm.transport.docker_session import DockerSession
from tests.recovery.action_bench import guarded


class Scene:
    """`vpn`, whose network `fc_app` shares; `planner` starts after `fc_app`'s owner; `camera` is alone. `fc_app` is critical."""

    def __init__(self, **critical: Any) -> None:
        self.state = ArmedState.ARMED
        self.unknown: set[str] = set()
        self.me: ContainerFact | None = testing.container("phm")
        vpn = testing.container("vpn")
        self.facts = {
            "vpn": vpn,
            "fc_app": replace(testing.container("fc_app"), network_mode=f"container:{vpn.id}"),
            "camera": testing.container("camera"),
            "base": testing.container("base"),
        }
        self.settings: Settings = settings(
            containers=[
                {"name": "vpn", "recover": True, "after": ["base"]},
                {"name": "fc_app", "recover": True, "flight_critical": True, **critical},
                {"name": "camera", "recover": True},
                {"name": "base", "recover": True},
            ],
            mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14550"}]},
        )
        self.flight_critical_guard = FlightCriticalGuard(
            self.settings.containers,
            self.fact,
            lambda: self.me,
            lambda: ArmedStatus(self.state, "it is armed"),
            self.inspect,
        )
        self.unconfigured = [testing.container("gateway"), testing.container("bystander")]

    def uses(self, user: str, modes: dict[str, str]) -> None:
        """The container joins namespaces of others and no network."""
        joined: dict[str, Any] = {"network_mode": "bridge", **{kind: f"container:{of}" for kind, of in modes.items()}}
        if user in self.facts:
            self.facts[user] = replace(self.facts[user], **joined)
        else:
            self.unconfigured = [replace(fact, **joined) if fact.name == user else fact for fact in self.unconfigured]

    def fact(self, key: str) -> ContainerFact | None:
        if key in self.unknown:
            raise CannotTell("the engine does not answer")
        return self.facts.get(key)

    def inspect(self, ref: str) -> dict[str, Any]:
        fact = self.known_as(ref)
        host = {"NetworkMode": fact.network_mode, "PidMode": fact.pid_mode, "IpcMode": fact.ipc_mode}
        return {"Id": fact.id, "Name": f"/{fact.name}", "HostConfig": host}

    def known_as(self, ref: str) -> ContainerFact:
        """The container that the engine means by `ref`. Raises EngineMissing."""
        every = [*self.facts.values(), *self.unconfigured, *([self.me] if self.me else [])]
        for fact in every:
            if ref.removeprefix("/") == fact.name or (len(ref) > 5 and fact.id.startswith(ref)):
                return fact
        raise EngineMissing(f"there is no {ref}")


class Calls:
    """Replaces the engine and records the calls that reached it; `after` runs after each call."""

    def __init__(self, scene: Scene) -> None:
        self.made: list[str] = []
        self.scene = scene

    def _note(self, name: str) -> None:
        self.made.append(name)

    def restart(self, ref: str, stop_timeout_s: float = 5.0) -> None:
        self._note(f"restart {ref}")

    def start(self, ref: str) -> None:
        self._note(f"start {ref}")

    def stop(self, ref: str) -> None:
        self._note(f"stop {ref}")
        self.scene.state = ArmedState.ARMED

    def disconnect(self, network: str, container: str, force: bool = False) -> None:
        self._note(f"disconnect {container}")
        self.scene.state = ArmedState.ARMED

    def connect(
        self, network: str, container: str, aliases: tuple[str, ...] = (), addresses: tuple[str, ...] = ()
    ) -> None:
        self._note(f"connect {container}")

    def kill(self, ref: str, signal: str = "SIGKILL") -> None:
        self._note(f"kill {ref}")

    def remove(self, ref: str) -> None:
        self._note(f"remove {ref}")

    def set_cpu_shares(self, container: str, shares: int) -> None:
        self._note(f"weight of {container}")

    def call(self, fn: Any, *, deadline_s: float | None = None, what: str = "answer") -> None:
        self._note("call")

    def inspect(self, ref: str) -> dict[str, Any]:
        return self.scene.inspect(ref)


def engine(scene: Scene) -> tuple[DockerEngine, Calls]:
    calls = Calls(scene)
    return guarded(cast(DockerEngine, calls), scene.flight_critical_guard), calls


@pytest.mark.parametrize("state", [ArmedState.ARMED, ArmedState.UNKNOWN])
@pytest.mark.parametrize(
    ("target", "reach", "words"),
    [
        ("fc_app", Impact.NOTHING, "flight-critical, and"),
        ("fc_app", Impact.CONTAINER, "flight-critical, and"),
        ("vpn", Impact.NOTHING, ""),
        ("vpn", Impact.NETWORK, "would take down fc_app, which is flight-critical"),
        ("vpn", Impact.CONTAINER, "would take down fc_app, which is flight-critical"),
        ("base", Impact.NETWORK, ""),
        ("base", Impact.CONTAINER, "would take down fc_app, which is flight-critical"),
        ("camera", Impact.CONTAINER, ""),
    ],
)
def test_criticality_is_inherited_from_dependents(state: ArmedState, target: str, reach: Impact, words: str) -> None:
    """By a shared network namespace and by `after`, also over two steps; a container without critical dependents is not
    restricted.
    """
    scene = Scene()
    scene.state = state
    found = scene.flight_critical_guard.forbids(target, reach)
    assert words in found
    assert bool(found) is bool(words)
    scene.state = ArmedState.DISARMED
    assert scene.flight_critical_guard.forbids(target, reach) == ""


@pytest.mark.parametrize("kind", ["pid_mode", "ipc_mode"])
def test_a_shared_pid_or_ipc_namespace_counts_like_a_shared_network(kind: str) -> None:
    """A restart of its owner ends the processes in it, or separates its /dev/shm; a reconnection does neither."""
    scene = Scene()
    shared: dict[str, Any] = {kind: f"container:{scene.facts['camera'].id}"}
    scene.facts["fc_app"] = replace(scene.facts["fc_app"], network_mode="bridge", **shared)
    assert "would take down fc_app" in scene.flight_critical_guard.forbids("camera", Impact.CONTAINER)
    assert scene.flight_critical_guard.forbids("camera", Impact.NETWORK) == ""
    assert scene.flight_critical_guard.forbids("vpn", Impact.CONTAINER) == ""


CHAINS = [
    (("network_mode", "network_mode"), True),
    (("pid_mode", "pid_mode"), False),
    (("ipc_mode", "ipc_mode"), False),
    (("network_mode", "pid_mode"), False),
]
"""What `fc_app` joins of `gateway`, which is not configured, and that of `camera`; and whether its network is that of `camera`."""


@pytest.mark.parametrize("ref", ["gateway", "id-of-gateway"])
@pytest.mark.parametrize(("kinds", "network"), CHAINS)
def test_criticality_is_inherited_through_a_container_that_is_not_configured(
    kinds: tuple[str, str], network: bool, ref: str
) -> None:
    """It only uses a namespace of the other one, or ends with the other one, so the flight-critical one loses what it shares."""
    scene = Scene()
    scene.uses("fc_app", {kinds[0]: ref})
    scene.uses("gateway", {kinds[1]: "id-of-camera"})
    forbids = scene.flight_critical_guard.forbids
    assert "would take down fc_app, which is flight-critical" in forbids("camera", Impact.CONTAINER)
    assert bool(forbids("camera", Impact.NETWORK)) is network
    assert forbids("vpn", Impact.CONTAINER) == ""
    ask, calls = engine(scene)
    with pytest.raises(FlightCriticalError, match="restart of camera was not done: it would take down fc_app"):
        ask.restart("camera")
    assert calls.made == []


def test_a_chain_may_have_several_unconfigured_containers_and_after() -> None:
    """`fc_app` uses the network of `vpn`, which starts after `base`, which is behind two that are not configured."""
    scene = Scene()
    scene.uses("base", {"network_mode": "gateway"})
    scene.uses("gateway", {"network_mode": "bystander"})
    scene.uses("bystander", {"network_mode": "camera"})
    for target in ("camera", "base"):
        assert "would take down fc_app" in scene.flight_critical_guard.forbids(target, Impact.CONTAINER)
    ask, _ = engine(scene)
    with pytest.raises(FlightCriticalError, match="restart of bystander was not done: it would take down fc_app"):
        ask.restart("bystander")


def test_while_the_owner_of_a_used_namespace_is_unknown_no_other_container_is_taken_down() -> None:
    """It was removed, or the engine or a proxy does not say: whose namespace it was is not known. On the ground, and with a
    flight-critical container that does not run, nothing is at stake.
    """
    scene = Scene()
    scene.uses("fc_app", {"network_mode": "removed"})
    guard = scene.flight_critical_guard
    for impact in (Impact.NETWORK, Impact.CONTAINER):
        assert "not known (fc_app uses a namespace of removed, which was removed)" in guard.forbids("camera", impact)
    assert guard.forbids("camera", Impact.NOTHING) == ""
    scene.state = ArmedState.DISARMED
    assert guard.forbids("camera", Impact.CONTAINER) == ""
    scene.state = ArmedState.ARMED
    scene.facts["fc_app"] = replace(scene.facts["fc_app"], status="exited")
    assert guard.forbids("camera", Impact.CONTAINER) == ""


def test_when_armed_act_permits_actions_on_flight_critical_containers() -> None:
    """For some containers being down is worse than a restart, which only the user can know."""
    flight_critical_guard = Scene(when_armed="act").flight_critical_guard
    assert [flight_critical_guard.forbids(key, Impact.CONTAINER) for key in ("fc_app", "vpn")] == ["", ""]


def test_a_container_with_unknown_dependents_is_left_alone() -> None:
    """An engine that does not report whose network a container shares does not permit the action."""
    scene = Scene()
    scene.unknown.add("fc_app")
    assert "not known (the engine does not answer)" in scene.flight_critical_guard.forbids("vpn", Impact.CONTAINER)


def test_an_approval_is_valid_only_for_its_armed_state() -> None:
    """Given while armed it permits nothing when the state is no longer known."""
    scene = Scene()
    assert scene.flight_critical_guard.forbids("fc_app", Impact.CONTAINER, ArmedState.ARMED) == ""
    assert scene.flight_critical_guard.forbids("fc_app", Impact.CONTAINER, ArmedState.UNKNOWN)
    assert scene.flight_critical_guard.forbids("fc_app", Impact.CONTAINER, ArmedState.DISARMED)


def test_the_armed_state_is_checked_before_each_call() -> None:
    """A restart that was decided on the ground is not done when the vehicle has been armed meanwhile."""
    scene = Scene()
    scene.state = ArmedState.DISARMED
    ask, calls = engine(scene)
    ask.restart(scene.facts["fc_app"].id)
    scene.state = ArmedState.ARMED
    for ref in (scene.facts["fc_app"].id, "fc_app", scene.facts["vpn"].id):
        with pytest.raises(FlightCriticalError, match="was not done"):
            ask.restart(ref)
    ask.inspect("fc_app")
    ask.restart("camera")
    ask.connect("net", "phm")
    assert calls.made[1:] == ["restart camera", "connect phm"]


@pytest.mark.parametrize("short", ["/fc_app", "id-of-fc", "/vpn", "id-of-v"])
def test_a_container_is_protected_under_each_name_that_the_engine_accepts(short: str) -> None:
    """With a slash before its name, and by the beginning of its id."""
    ask, calls = engine(Scene())
    for call in (ask.restart, ask.kill, ask.remove, lambda ref: ask.disconnect("net", ref)):
        with pytest.raises(FlightCriticalError, match=r"of (fc_app|vpn) was not done"):
            call(short)
    assert calls.made == []


@pytest.mark.parametrize("kind", ["network_mode", "pid_mode", "ipc_mode"])
def test_an_unconfigured_container_is_protected_if_a_flight_critical_one_uses_its_namespace(kind: str) -> None:
    """PHM's configuration does not name it, but its restart would disturb the flight-critical one."""
    scene = Scene()
    gateway = scene.unconfigured[0]
    shared: dict[str, Any] = {"network_mode": "bridge", kind: f"container:{gateway.id}"}
    scene.facts["fc_app"] = replace(scene.facts["fc_app"], **shared)
    ask, calls = engine(scene)
    for ref in (gateway.id, "gateway", "/gateway"):
        with pytest.raises(FlightCriticalError, match="restart of gateway was not done: it would take down fc_app"):
            ask.restart(ref)
    ask.remove("bystander")
    ask.start("gateway")
    scene.state = ArmedState.DISARMED
    ask.restart("gateway")
    assert calls.made == ["remove bystander", "start gateway", "restart gateway"]


def test_phm_may_connect_itself_to_networks_but_not_restart_what_a_flight_critical_container_uses() -> None:
    """Its own container is protected like any other, except from its own changes of networks."""
    scene = Scene()
    assert scene.me is not None
    scene.facts["fc_app"] = replace(scene.facts["fc_app"], network_mode=f"container:{scene.me.id}")
    ask, calls = engine(scene)
    ask.connect("net", "phm")
    with pytest.raises(FlightCriticalError, match="restart of phm was not done"):
        ask.restart("phm")
    assert calls.made == ["connect phm"]


def test_a_call_that_names_no_container_is_refused_while_armed() -> None:
    """What it would take down cannot be known."""
    scene = Scene()
    ask, calls = engine(scene)
    with pytest.raises(FlightCriticalError, match="names no container"):
        ask.call(lambda client: client.restart("fc_app"))
    scene.state = ArmedState.DISARMED
    ask.call(lambda client: client.restart("fc_app"))
    assert calls.made == ["call"]


def test_a_container_that_does_not_exist_is_reported_as_missing() -> None:
    """While armed as on the ground, so that an action may ignore it."""
    ask, calls = engine(Scene())
    with pytest.raises(EngineMissing):
        ask.remove("nothing")
    assert calls.made == []


def test_a_call_is_not_made_if_the_engine_does_not_say_which_container_it_means() -> None:
    """An answer without an id could be about a flight-critical container."""
    scene = Scene()
    scene.unconfigured.append(testing.container("unclear", id=""))
    ask, calls = engine(scene)
    with pytest.raises(CannotTell, match="described unclear without an id"):
        ask.restart("unclear")
    assert calls.made == []


@pytest.mark.parametrize(
    ("down", "up"), [(("stop",), ("start",)), (("disconnect", "net"), ("connect", "net"))], ids=["stop", "disconnect"]
)
def test_an_action_may_restart_what_it_has_taken_down(down: tuple[str, ...], up: tuple[str, ...]) -> None:
    """Armed between the two calls: an incomplete action would be worse. Another action may not."""
    scene = Scene()
    scene.state = ArmedState.DISARMED
    ask, calls = engine(scene)
    getattr(ask, down[0])(*down[1:], "fc_app")
    assert scene.state is ArmedState.ARMED
    getattr(ask, up[0])(*up[1:], "fc_app")
    assert calls.made == [f"{down[0]} fc_app", f"{up[0]} fc_app"]
    other, _ = engine(scene)
    with pytest.raises(FlightCriticalError):
        getattr(other, up[0])(*up[1:], "fc_app")


def test_the_cpu_weight_of_what_a_flight_critical_container_depends_on_is_not_lowered() -> None:
    """It would be starved with that container; and lowering a weight does not permit a start."""
    scene = Scene()
    ask, calls = engine(scene)
    for ref in ("fc_app", "vpn", "base"):
        with pytest.raises(FlightCriticalError, match="set_cpu_shares"):
            ask.set_cpu_shares(ref, 64)
    ask.set_cpu_shares("camera", 64)
    scene.state = ArmedState.DISARMED
    ask.set_cpu_shares("fc_app", 64)
    scene.state = ArmedState.ARMED
    with pytest.raises(FlightCriticalError, match="start"):
        ask.start("fc_app")
    assert calls.made == ["weight of camera", "weight of fc_app"]


def test_every_engine_call_is_read_only_or_guarded() -> None:
    """A call added later cannot be forgotten: it names its container, or it is in one of two short lists."""
    public = {
        name: member
        for name, member in inspect.getmembers(DockerEngine, callable)
        if not name.startswith("_") and inspect.isfunction(member)
    }
    classes = {each.__name__ for each in DockerEngine.__mro__} - {DockerSession.__name__}
    own = {name for name, member in public.items() if member.__qualname__.partition(".")[0] in classes}
    assert own >= READS
    for name in own - READS - NOT_ABOUT_A_CONTAINER:
        assert {"container", "ref"} & set(inspect.signature(public[name]).parameters), name
