"""CPU weights that are lowered for a starved container and restored; on the real engine, directly and behind the proxy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from phm import testing
from phm.core.model import Layer, Level, Result, Slot, Stamp, UnitState
from phm.facts import CannotTell, ContainerFact
from phm.probes.docker_facts import container_fact
from phm.recovery.actions.cpu_weights import CALM_S, DEFAULT_SHARES, LOW_SHARES, CpuWeights
from phm.recovery.actions.relieve import Relieve
from phm.recovery.actions.unpause import Unpause
from phm.recovery.attempt import Attempt
from phm.recovery.base import Action, ActionContext, LoweredWeight, NotNeeded, Target
from phm.recovery.ownership import Shared
from phm.runtime.sections import action_settings
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine, EngineMissing
from tests.recovery.action_bench import Bench, bench, fault

STARVED = fault("pressure/app", "cpu_starved")
UNIT = "pressure/app"


class Published:
    """Replaces the pipeline: one unit, set by the test."""

    def __init__(self) -> None:
        self.level, self.since = Level.ERROR, 0.0
        self.notes: list[str] = []

    def states(self) -> tuple[UnitState, ...]:
        result = Result(self.level, "so")
        return (UnitState(UNIT, "pressure", Slot.HOST, Layer.DOCKER, self.level, result, Stamp(0.0, self.since)),)

    def note(self, kind: str, text: str) -> None:
        self.notes.append(text)


class Scene:
    """A flight-critical container `app`, and `other`, whose weight may be lowered."""

    def __init__(self, engine: DockerEngine, real: Any, *, shares: int = 0) -> None:
        self.app, self.other = real.container(), real.container(cpu_shares=shares)
        self.bench: Bench = bench(
            engine,
            containers=[
                {"name": self.app.name, "alias": "app", "recover": True, "flight_critical": True},
                {"name": self.other.name, "alias": "other"},
            ],
            recovery={"relieve": ["other"]},
            mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14599", "leads_to": "autopilot"}]},
        )
        self.clock, self.published = FakeClock(), Published()
        self.relief = self.restarted()

    def restarted(self) -> CpuWeights:
        """As a new PHM has it, without what was lowered before."""
        engine = self.bench.engine
        return CpuWeights(engine, lambda ref: container_fact(engine.inspect(ref)), self.published, self.clock)

    def relieve(self) -> str:
        context = replace(self.bench.context(), relief=self.relief)
        return Relieve().run(self.bench.target("app"), STARVED, context)

    def shares(self, made: Any) -> int:
        made.reload()
        return int(made.attrs["HostConfig"]["CpuShares"])

    def calm(self, for_s: float) -> None:
        self.published.level, self.published.since = Level.OK, self.clock.mono()
        self.clock.advance(for_s)
        self.relief.tick()


@pytest.mark.engine
@pytest.mark.parametrize("shares", [0, 512])
def test_the_weight_is_lowered_in_flight_and_restored_when_no_longer_needed(
    real: Any, engine: DockerEngine, shares: int
) -> None:
    """Only of containers named in `recovery.relieve`, also while armed; then restored to its former value."""
    scene = Scene(engine, real, shares=shares)
    scene.bench.armed = True
    assert scene.relieve() == f"lowered the CPU weight of other to {LOW_SHARES}"
    assert (scene.shares(scene.other), scene.shares(scene.app)) == (LOW_SHARES, 0)
    assert isinstance(scene.relieve(), NotNeeded)
    scene.relief.tick()
    scene.calm(CALM_S - 1)
    assert scene.shares(scene.other) == LOW_SHARES
    scene.calm(CALM_S)
    assert scene.shares(scene.other) == (shares or DEFAULT_SHARES)
    assert scene.relief.kept() == () and len(scene.published.notes) == 1


@pytest.mark.engine
def test_a_restarted_phm_restores_lowered_weights(real: Any, engine: DockerEngine) -> None:
    """And weights that are still low when PHM ends are restored immediately."""
    scene = Scene(engine, real)
    scene.relieve()
    kept = scene.relief.kept()
    scene.relief = scene.restarted()
    scene.relief.restore(kept)
    assert isinstance(scene.relieve(), NotNeeded), "the low weight is not saved as the container's own"
    scene.relief.end()
    assert scene.shares(scene.other) == DEFAULT_SHARES


@pytest.mark.engine
def test_a_recreated_container_keeps_its_own_weight(real: Any, engine: DockerEngine) -> None:
    """PHM restores only the container that it changed, and no other of the same name."""
    scene = Scene(engine, real)
    scene.relieve()
    name = scene.other.name
    scene.other.remove(force=True)
    again = real.container(name=name, cpu_shares=128)
    scene.calm(CALM_S)
    assert scene.shares(again) == 128
    assert scene.relief.kept() == () and scene.published.notes == []


class Shares:
    """Replaces the engine: the CPU weight of one container."""

    def __init__(self) -> None:
        self.shares = DEFAULT_SHARES

    def inspect(self, ref: str) -> Mapping[str, Any]:
        return {"HostConfig": {"CpuShares": self.shares}}

    def set_cpu_shares(self, container: str, shares: int) -> None:
        self.shares = shares


def test_a_weight_stays_low_until_no_starved_container_needs_it() -> None:
    """Two starved containers share one relief, also over a restart of PHM: the first that is calm does not end it for the other."""
    engine, published, clock = Shares(), SimpleNamespace(states=tuple, notes=[]), FakeClock()
    published.note = lambda kind, text: published.notes.append(text)
    cam = testing.container("cam")

    def relief() -> CpuWeights:
        return CpuWeights(cast(Any, engine), lambda key: cam, published, clock)

    def state(unit: str, level: Level) -> UnitState:
        return UnitState(
            unit, "pressure", Slot.HOST, Layer.DOCKER, level, Result(level, "so"), Stamp(0.0, clock.mono())
        )

    first = relief()
    assert [first.lower("cam", cam, unit, cast(Any, engine)) for unit in ("pressure/a", "pressure/b")] == [True, False]
    after = relief()
    after.restore(first.kept())
    for calm, shares in ((1, LOW_SHARES), (2, DEFAULT_SHARES)):
        levels = {"pressure/a": Level.OK, "pressure/b": Level.OK if calm == 2 else Level.ERROR}
        states = tuple(state(unit, level) for unit, level in levels.items())
        published.states = lambda states=states: states
        clock.advance(CALM_S)
        after.tick()
        assert engine.shares == shares
    assert after.kept() == () and published.notes == [f"restored the CPU weight of cam to {DEFAULT_SHARES}"]


def test_a_weight_that_is_lowered_again_while_it_is_restored_is_restored_later() -> None:
    """By the thread of another starved container."""
    cam = testing.container("cam")

    class Slow(Shares):
        again = True

        def set_cpu_shares(self, container: str, shares: int) -> None:
            super().set_cpu_shares(container, shares)
            if shares == 512 and self.again:
                self.again = False
                assert relief.lower("cam", cam, "pressure/b", cast(Any, self))

    engine = Slow()
    engine.shares = LOW_SHARES
    relief = CpuWeights(cast(Any, engine), lambda ref: cam, Published(), FakeClock())
    relief.restore([LoweredWeight("cam", cam.id, 512, "pressure/a")])
    relief.tick()
    assert engine.shares == LOW_SHARES and "pressure/b" in [entry.unit for entry in relief.kept()]
    relief.tick()
    assert (engine.shares, relief.kept()) == (512, ())


def test_a_low_weight_that_phm_has_not_set_is_not_changed() -> None:
    """It is the container's own."""
    engine, clock = Shares(), FakeClock()
    engine.shares = LOW_SHARES
    relief = CpuWeights(cast(Any, engine), lambda ref: testing.container("cam"), Published(), clock)
    assert not relief.lower("cam", testing.container("cam"), UNIT, cast(Any, engine))
    assert relief.kept() == ()


@pytest.mark.parametrize("removed", [False, True])
def test_the_weight_of_a_container_that_is_no_longer_configured_is_restored(*, removed: bool) -> None:
    """A reload may remove it from the configuration: the engine is asked by id. Nothing remains of one that was removed."""
    engine, published = Shares(), Published()
    engine.shares = LOW_SHARES
    cam = testing.container("cam")

    def known(ref: str) -> ContainerFact:
        if removed:
            raise EngineMissing("there is no such container")
        if ref != cam.id:
            raise CannotTell(f"no container {ref} is configured")
        return cam

    relief = CpuWeights(cast(Any, engine), known, published, FakeClock())
    relief.restore([LoweredWeight("cam", cam.id, 512, "pressure/gone")])
    relief.tick()
    assert (engine.shares, relief.kept()) == (LOW_SHARES if removed else 512, ())
    assert published.notes == ([] if removed else ["restored the CPU weight of cam to 512"])


def old_weight(shares: int) -> int:
    """cpu.weight as older versions of runc and crun set it."""
    return 1 + (shares - 2) * 9999 // 262142


def new_weight(shares: int) -> int:
    """The same since opencontainers/runc pull request 4785."""
    log = math.log2(shares)
    return math.ceil(10 ** ((log * log + 125 * log) / 612 - 7 / 34))


class Weighted(Shares):
    """An engine on cgroup v2: shares that are not set leave the weight of the kernel, 100."""

    def __init__(self, convert: Callable[[int], int], shares: int = 0) -> None:
        self.shares, self.convert = shares, convert
        self.weight = convert(shares) if shares else 100

    def set_cpu_shares(self, container: str, shares: int) -> None:
        self.shares, self.weight = shares, self.convert(shares)

    def relief(self) -> CpuWeights:
        cam = testing.container("cam")
        return CpuWeights(cast(Any, self), lambda key: cam, Published(), FakeClock(), lambda fact: self.weight)

    def lower(self, relief: CpuWeights) -> bool:
        return relief.lower("cam", testing.container("cam"), UNIT, cast(Any, self))


@pytest.mark.parametrize("convert", [old_weight, new_weight])
@pytest.mark.parametrize("shares", [0, 128, 1024, 4096])
def test_the_weight_of_the_kernel_is_as_before(convert: Callable[[int], int], shares: int) -> None:
    """Also of a container without cpu_shares, which the older conversion gives 39 for 1024; and by a PHM that was restarted."""
    engine = Weighted(convert, shares)
    before = engine.weight
    first = engine.relief()
    assert engine.lower(first) and engine.shares == LOW_SHARES
    assert not engine.lower(first)
    after = engine.relief()
    after.restore(first.kept())
    after.end()
    assert engine.weight == before
    assert engine.shares == shares or not shares, "what the user has set"


@pytest.mark.parametrize("weight", [0, 5000])
def test_without_a_known_conversion_the_default_of_the_engine_is_restored(weight: int) -> None:
    """No mount of the host's cgroups, or a container runtime that converts in another way."""
    engine = Weighted(lambda shares: weight)
    engine.weight = weight and 100
    relief = engine.relief()
    assert engine.lower(relief)
    relief.end()
    assert engine.shares == DEFAULT_SHARES


def test_relieve_applies_to_a_flight_critical_container_with_configured_others() -> None:
    """Opt-in twice: only named containers give way, and only for flight-critical ones."""
    named = settings(containers=[{"name": "app"}, {"name": "other"}], recovery={"relieve": ["other"]})
    app = named.containers[0]
    assert not Relieve.applies(Target.of(app), STARVED, action_settings(named))
    critical = Target.of(app.model_copy(update={"flight_critical": True}))
    assert Relieve.applies(critical, STARVED, action_settings(named))
    assert not Relieve.applies(critical, STARVED, action_settings(settings(containers=[{"name": "app"}])))


def relieve_with(
    facts: Mapping[str, ContainerFact], *, after: Sequence[str] = (), others: Mapping[str, str] | None = None
) -> list[str]:
    """The containers that are relieved for the flight-critical `app`; all others may be. others: network modes of containers that
    are not configured, by their names."""
    lowered: list[str] = []
    may = [key for key in facts if key != "app"]
    named = settings(
        containers=[{"name": "app", "flight_critical": True, "after": list(after)}, *({"name": key} for key in may)],
        recovery={"relieve": may},
    )
    relief = SimpleNamespace(lower=lambda key, *more: bool(lowered.append(key)) or True)
    unconfigured = others or {}
    engine = SimpleNamespace(
        inspect=lambda ref: {"Id": f"id of {ref}", "Name": f"/{ref}", "HostConfig": {"NetworkMode": unconfigured[ref]}}
    )
    context = SimpleNamespace(
        settings=action_settings(named),
        container=facts.__getitem__,
        relief=relief,
        engine=engine,
        on_hold=lambda key: "",
    )
    Relieve().run(Target.of(named.containers[0]), STARVED, cast(ActionContext, context))
    return lowered


@pytest.mark.parametrize("kind", ["network_mode", "pid_mode", "ipc_mode"])
def test_what_a_flight_critical_container_shares_is_not_relieved(kind: str) -> None:
    """It would slow down the container that it is to relieve."""
    mode: dict[str, Any] = {kind: "container:vpn"}
    facts = {"app": testing.container("app", **mode), "vpn": testing.container("vpn"), "cam": testing.container("cam")}
    assert relieve_with(facts) == ["cam"]


def test_what_a_flight_critical_container_shares_through_an_unconfigured_one_is_not_relieved() -> None:
    """Its network is that of the last one."""
    facts = {
        "app": testing.container("app", network_mode="container:between"),
        "vpn": testing.container("vpn"),
        "cam": testing.container("cam"),
    }
    assert relieve_with(facts, others={"between": "container:vpn"}) == ["cam"]


def test_what_a_flight_critical_container_starts_after_is_not_relieved() -> None:
    """Also if the rules of the configuration did not refuse it."""
    facts = {key: testing.container(key) for key in ("app", "vpn", "cam")}
    assert relieve_with(facts, after=["vpn"]) == ["cam"]


@pytest.mark.engine
def test_weights_that_are_lowered_repeatedly_stay_low_for_longer(real: Any, engine: DockerEngine) -> None:
    """Otherwise the two would alternate: each time for twice as long, up to ten minutes."""
    scene = Scene(engine, real)
    for calm_s in (CALM_S, 2 * CALM_S, 4 * CALM_S):
        scene.relieve()
        scene.calm(calm_s - 1)
        assert scene.shares(scene.other) == LOW_SHARES
        scene.calm(calm_s)
        assert scene.shares(scene.other) == DEFAULT_SHARES


@pytest.mark.parametrize(("kind", "held"), [(Relieve, "relieve:app"), (Unpause, "app")])
def test_relieve_does_not_hold_the_starved_container(kind: type[Action], held: str) -> None:
    """A failure there meanwhile is not its consequence, and is a fault as usual."""
    holds: list[str] = []
    locks = SimpleNamespace(
        acquire=lambda target, owner: True,
        release=lambda target, owner: None,
        begin_action=lambda target, *more, **marks: holds.append(target),
    )
    pipeline = SimpleNamespace(is_stopping=lambda target: False)
    named = settings(containers=[{"name": "app", "flight_critical": True}], recovery={"relieve": []})
    context = SimpleNamespace(settings=named, engine=None)
    shared = Shared(cast(Any, pipeline), FakeClock(), cast(Any, locks), cast(Any, None), lambda unit: 0.0)
    attempt = Attempt(
        Target.of(named.containers[0]),
        STARVED,
        kind,
        last=True,
        context=cast(Any, context),
        shared=shared,
        guard=None,
        verify_s=30.0,
    )
    assert attempt.begin()
    assert holds == [held]
    attempt._unlock()
