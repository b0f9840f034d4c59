"""A network that is missing, or was recreated under the same name: the actions on a fake engine."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import pytest

from phm import testing
from phm.facts import Attachment, ContainerFact
from phm.probes.docker_facts import container_fact
from phm.recovery.actions.join_network import JoinNetwork
from phm.recovery.actions.reconnect import Reconnect
from phm.recovery.actions.restart import Restart
from phm.recovery.actions.start import Start
from phm.recovery.base import Action, ActionContext, NotYet
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.testing import FakeClock
from phm.transport.docker import DockerEngine, EngineBroken, EngineTimeout
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Status
from tests.recovery.action_bench import Bench, bench, fault

OFF = fault("network/app", "disconnected")
APP = {"name": "app", "recover": True, "networks": ["swarm"]}


def changes(fake: FakeEngine) -> list[str]:
    return [call.rsplit("/", 1)[-1] for call in fake.calls if call.startswith("POST")]


def agent(
    fake: FakeEngine, ask: DockerEngine, *, exists: bool, attached: dict[str, str] | None = None, **state: Any
) -> Bench:
    """`app`, attached to networks by these ids; the network `swarm` has the id `new` if it exists."""
    fake.containers["app"] = container("app", networks=attached or {}, **state)
    if exists:
        fake.networks["swarm"] = {"Id": "new"}
    return bench(ask, containers=[APP])


def waits(made: Bench, action: type[Action]) -> str:
    return action().waits_for(made.target("app"), OFF, made.context())


@pytest.mark.parametrize("action", [Reconnect, Restart, JoinNetwork])
def test_actions_wait_for_a_missing_network(fake: FakeEngine, ask: DockerEngine, action: type[Action]) -> None:
    """Above all a restart, which does not bring a network back."""
    made = agent(fake, ask, exists=False)
    assert "there is no network swarm" in waits(made, action)
    fake.networks["swarm"] = {"Id": "new"}
    assert waits(made, action) == ""
    assert changes(fake) == []


def test_a_network_removed_before_the_connection_is_waited_for(fake: FakeEngine, ask: DockerEngine) -> None:
    """It existed when the action was decided on: not a failure of the container, and nothing was changed."""
    made = agent(fake, ask, exists=False)
    with pytest.raises(NotYet, match="no network swarm"):
        made.run(Reconnect, "app", OFF)
    assert changes(fake) == []


@pytest.mark.parametrize("code", [403, 404])
def test_a_network_recreated_during_the_connection_is_waited_for(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """Its old id is rejected; a socket proxy, which knows only the new one, returns 403: not a refusal to connect to
    the new one.
    """
    made = agent(fake, ask, exists=True)
    connect = ask.connect

    def late(network: str, container: str, aliases: Any = (), addresses: Any = ()) -> None:
        fake.networks["swarm"] = {"Id": "newer"}
        fake.fault = Status(code, "no", route="/connect")
        connect(network, container, aliases, addresses)

    monkeypatch.setattr(ask, "connect", late)
    with pytest.raises(NotYet):
        made.run(Reconnect, "app", OFF)


def test_a_network_whose_id_begins_with_the_name_is_not_matched(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine accepts the beginning of an id in place of a name."""
    made = bench(ask, containers=[{**APP, "networks": ["abc"]}])
    fake.containers["app"] = container("app")
    fake.networks["other"] = {"Id": "abc"}
    with pytest.raises(NotYet):
        made.run(Reconnect, "app", OFF)


def test_an_existing_network_is_connected_while_another_is_missing(fake: FakeEngine, ask: DockerEngine) -> None:
    """The missing one is waited for."""
    made = agent(fake, ask, exists=True)
    made.settings.containers[0].networks.append("radio")
    words = made.run(Reconnect, "app", OFF)
    assert "reconnected app to swarm" in words and "no network radio" in words
    assert [attached.network_id for attached in made.fact("app").networks] == ["new"]  # type: ignore[union-attr]


def test_a_missing_network_is_waited_for_when_the_others_are_connected(fake: FakeEngine, ask: DockerEngine) -> None:
    """There is nothing to do until it exists, so no action begins."""
    made = agent(fake, ask, exists=True, attached={"swarm": "new"})
    made.settings.containers[0].networks.append("radio")
    assert "there is no network radio" in waits(made, Reconnect)
    made = agent(fake, ask, exists=True)
    made.settings.containers[0].networks.append("radio")
    assert waits(made, Reconnect) == ""


@pytest.mark.parametrize("mode", ["host", "none", "container:other"])
def test_a_container_without_its_own_networks_waits_for_none(fake: FakeEngine, ask: DockerEngine, mode: str) -> None:
    """It is never connected to one."""
    made = agent(fake, ask, exists=False)
    fake.containers["other"] = container("other")
    fake.containers["app"]["HostConfig"]["NetworkMode"] = mode
    assert waits(made, Restart) == ""


def test_a_stopped_container_is_started_on_the_recreated_network(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine refuses to start a container attached to a removed network, even if one of that name exists."""
    made = agent(fake, ask, exists=True, attached={"swarm": "old"}, status="exited")
    fake.networks["swarm"] = {"Id": "new"}
    assert waits(made, Start) == ""
    made.run(Start, "app", fault("container/app", "exited"))
    fact = made.fact("app")
    assert fact is not None and fact.running
    assert [attached.network_id for attached in fact.networks] == ["new"]


class Remembered(Bench):
    """PHM has seen how `app` was attached to `swarm`."""

    seen = Attachment("swarm", "new", "10.9.0.7", aliases=("camera",), fixed_addresses=("10.9.0.7",))

    def context(self) -> ActionContext:
        known = {("app", "swarm"): self.seen}
        return replace(super().context(), last_attachment=lambda key, network: known.get((key, network)))


def killed_off_its_network(fake: FakeEngine, ask: DockerEngine, **more: Any) -> Remembered:
    """`app`, which was killed and disconnected from `swarm`."""
    fake.containers["app"] = container("app", networks={}, status="exited")
    fake.networks["swarm"] = {"Id": "new"}
    return Remembered(ask, testing.settings(containers=[{**APP, **more}]))


@pytest.mark.parametrize("action", [Start, Restart])
def test_a_stopped_container_is_started_on_the_network_that_it_was_disconnected_from(
    fake: FakeEngine, ask: DockerEngine, action: type[Action]
) -> None:
    """Else it runs, its nodes are lost, and the next step would be a useless restart."""
    made = killed_off_its_network(fake, ask)
    made.run(action, "app", fault("container/app", "exited"))
    fact = made.fact("app")
    assert fact is not None and fact.running
    assert [(on.network_id, on.fixed_addresses) for on in fact.networks] == [("new", ("10.9.0.7",))]
    assert "camera" in fact.networks[0].aliases


def test_a_stopped_container_of_unknown_attachments_is_only_started(fake: FakeEngine, ask: DockerEngine) -> None:
    """Without its aliases and addresses, the connection would differ from what the user configured."""
    made = agent(fake, ask, exists=True, status="exited")
    made.run(Start, "app", fault("container/app", "exited"))
    assert changes(fake) == ["start"]


def test_a_connection_that_fails_does_not_prevent_the_start(fake: FakeEngine, ask: DockerEngine) -> None:
    """Neither does one that is refused in flight: the container starts, and its network is reported."""
    made = killed_off_its_network(fake, ask)
    fake.fault = Status(500, "no", route="/connect")
    made.run(Start, "app", fault("container/app", "exited"))
    fact = made.fact("app")
    assert fact is not None and fact.running and not fact.networks


def test_a_connection_without_an_address_is_made_again(fake: FakeEngine, ask: DockerEngine) -> None:
    """It is incomplete."""
    made = agent(fake, ask, exists=True, attached={"swarm": "new"})
    fake.containers["app"]["NetworkSettings"]["Networks"]["swarm"]["IPAddress"] = ""
    assert made.run(Reconnect, "app", OFF) == "reconnected app to swarm"
    assert changes(fake) == ["disconnect", "connect"]
    assert made.run(Reconnect, "app", OFF) == "app is already connected"


SILENT = fault("network/app", "address_silent")


def two_networks(fake: FakeEngine, ask: DockerEngine, **radio: Any) -> Bench:
    """`app` is on both: 10.9.0.2 on `swarm`, 10.9.0.3 on `radio`."""
    fake.containers["app"] = container("app", networks={"swarm": "new", "radio": "r"})
    fake.networks |= {"swarm": {"Id": "new"}, "radio": {"Id": "r", **radio}}
    return bench(ask, containers=[{**APP, "networks": ["swarm", "radio"]}])


@pytest.mark.parametrize(
    ("silent", "words", "done"),
    [
        ({"10.9.0.3"}, "reconnected app to radio", ["POST /networks/radio/disconnect", "POST /networks/r/connect"]),
        (set(), "app is already connected", []),
    ],
)
def test_only_the_network_with_the_silent_address_is_connected_again(
    fake: FakeEngine, ask: DockerEngine, silent: set[str], words: str, done: list[str]
) -> None:
    """The container gets a new interface there: on a healthy network its sockets would leave their multicast groups for nothing."""
    made = two_networks(fake, ask)
    context = replace(made.context(), reachable=lambda address: address not in silent)
    assert Reconnect().run(made.target("app"), SILENT, context) == words
    assert [call for call in fake.calls if call.startswith("POST")] == done


def test_one_lost_echo_does_not_disconnect_a_network(fake: FakeEngine, ask: DockerEngine) -> None:
    """As in the check, the second ping decides."""
    made = two_networks(fake, ask)
    answers = iter([False, True, False, False])
    context = replace(made.context(), reachable=lambda address: next(answers))
    assert Reconnect().run(made.target("app"), SILENT, context) == "reconnected app to radio"


@pytest.mark.parametrize(
    ("mode", "mine", "judged"), [(None, {}, False), ("host", {}, False), ("default", {"radio": "r"}, True)]
)
def test_an_address_that_phm_cannot_reach_does_not_disconnect_a_network(
    fake: FakeEngine, ask: DockerEngine, mode: str | None, mine: dict[str, str], judged: bool
) -> None:
    """On the host's network PHM does not reach a macvlan, so silence there says nothing; on that network itself it does."""
    made = two_networks(fake, ask, Driver="macvlan")
    me = None if mode is None else container_fact(container("phm", networks=mine))
    if me is not None and mode is not None:
        me = replace(me, network_mode=mode)
    context = replace(made.context(), reachable=lambda address: address == "10.9.0.2", own_container=lambda: me)
    words = Reconnect().run(made.target("app"), SILENT, context)
    assert ("reconnected app to radio" in words) is judged
    assert ("POST /networks/radio/disconnect" in fake.calls) is judged
    assert "POST /networks/swarm/disconnect" not in fake.calls


BOTH = {"IPv4Address": "10.9.0.7", "IPv6Address": "fd00::7"}


def test_a_container_gets_both_fixed_addresses_back(fake: FakeEngine, ask: DockerEngine) -> None:
    """IPv4 and IPv6: the address that is left out would be one that Docker chooses."""
    made = agent(fake, ask, exists=True, attached={"swarm": "old"})
    fake.containers["app"]["NetworkSettings"]["Networks"]["swarm"]["IPAMConfig"] = BOTH
    fake.networks["swarm"] = {"Id": "new"}
    made.run(Reconnect, "app", OFF)
    assert fake.containers["app"]["NetworkSettings"]["Networks"]["swarm"]["IPAMConfig"] == BOTH


NODES = {"nodes": [{"name": "/agent_1/node_1", "container": "app"}]}


@pytest.mark.parametrize(
    ("armed", "more", "done"),
    [
        (False, {"ros": NODES}, ["connect", "restart"]),
        (True, {"ros": NODES}, ["connect"]),
        (False, {}, ["connect"]),
        (False, {"ros": NODES, "recovery": {"ladders": {"disconnected": ["reconnect"]}}}, ["connect"]),
        (
            False,
            {"ros": NODES, "recovery": {"ladders": {"disconnected": ["reconnect", "restart"]}}},
            ["connect", "restart"],
        ),
    ],
)
def test_nodes_are_restarted_on_a_new_interface_unless_the_vehicle_may_be_armed(
    fake: FakeEngine, ask: DockerEngine, armed: bool, more: dict[str, Any], done: list[str]
) -> None:
    """Their sockets have not joined its multicast groups, so nothing that starts later would find them. Other containers, and a
    ladder that has no restart, get none.
    """
    fake.containers["app"] = container("app", networks={})
    fake.networks["swarm"] = {"Id": "new"}
    made = bench(ask, containers=[APP], **more)
    made.armed = armed
    action = Reconnect()
    words = action.run(made.target("app"), OFF, made.context())
    assert changes(fake) == done
    restarted = "restart" in done
    assert ("and restarted it, because its sockets had left their multicast groups" in words) is restarted
    assert ("until it is restarted, which is not done now" in words) is armed
    assert action.dependents_within_s == (None if restarted else Reconnect.dependents_within_s)


def test_nodes_are_not_restarted_while_another_network_is_missing(fake: FakeEngine, ask: DockerEngine) -> None:
    """As for every restart: the engine may refuse to start the container. Once that network is there, it is connected and restarted."""
    fake.containers["app"] = container("app", networks={})
    fake.networks["swarm"] = {"Id": "new"}
    made = bench(ask, containers=[{**APP, "networks": ["swarm", "radio"]}], ros=NODES)
    words = made.run(Reconnect, "app", OFF)
    assert "reconnected app to swarm" in words and "no network radio" in words
    assert changes(fake) == ["connect"]
    fake.networks["radio"] = {"Id": "radio-id"}
    assert "and restarted it" in made.run(Reconnect, "app", OFF)
    assert changes(fake) == ["connect", "connect", "restart"]


def test_a_proxy_that_refuses_restarts_does_not_refuse_reconnections(fake: FakeEngine, ask: DockerEngine) -> None:
    """The reconnection was permitted and done: it is verified, and tried again for the next fault."""
    agent(fake, ask, exists=True)
    made = bench(ask, containers=[APP], ros=NODES)
    fake.fault = Status(403, "no", route="/restart")
    action = Reconnect()
    words = action.run(made.target("app"), OFF, made.context())
    assert "reconnected app to swarm" in words and "which is not done now" in words
    assert action.dependents_within_s == Reconnect.dependents_within_s


def test_nodes_that_an_operator_holds_meanwhile_are_not_restarted(fake: FakeEngine, ask: DockerEngine) -> None:
    """Reconnecting takes seconds: what is true when it begins need not be true when it ends."""
    agent(fake, ask, exists=True)
    made = bench(ask, containers=[APP], ros=NODES)
    context = replace(made.context(), on_hold=lambda key: "on hold until 12:34:05 UTC by operator (uid 0)")
    words = Reconnect().run(made.target("app"), OFF, context)
    assert words.endswith("which is not done now: it is on hold until 12:34:05 UTC by operator (uid 0)")
    assert changes(fake) == ["connect"]


class Stepping(FakeClock):
    """Who waits moves the clock."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        self.advance(timeout_s or 0.0)
        return event.is_set()


@pytest.mark.parametrize("armed", [False, True])
def test_a_suspension_of_phm_delays_the_restart_and_does_not_prevent_it(
    fake: FakeEngine, ask: DockerEngine, armed: bool
) -> None:
    """On a busy machine PHM is suspended now and then: heartbeats that it reads then may be old, those of the next seconds are not.
    Seen in a campaign: the nodes stayed apart for 40 s, until the next step of the ladder."""
    agent(fake, ask, exists=True)
    made = bench(ask, containers=[APP], ros=NODES)
    clock = Stepping()
    began = clock.mono()
    known = ArmedState.ARMED if armed else ArmedState.DISARMED

    def status() -> ArmedStatus:
        suspended_s = began + 2.5 - clock.mono()
        return (
            ArmedStatus(ArmedState.UNKNOWN, "suspended", suspended_s)
            if suspended_s >= 0
            else ArmedStatus(known, "known")
        )

    words = Reconnect().run(made.target("app"), OFF, replace(made.context(), armed=status, clock=clock))
    assert 2.5 < clock.mono() - began < 3.0
    assert ("and restarted it" in words) is not armed


def test_a_container_that_an_operator_stops_during_that_wait_is_not_started(
    fake: FakeEngine, ask: DockerEngine
) -> None:
    """What was known before the wait is old after it."""
    agent(fake, ask, exists=True)
    made = bench(ask, containers=[APP], ros=NODES)
    clock = Stepping()
    began = clock.mono()

    def status() -> ArmedStatus:
        if clock.mono() == began:
            return ArmedStatus(ArmedState.UNKNOWN, "suspended", 2.5)
        fake.containers["app"] = container("app", status="exited", networks={"swarm": "new"})
        return ArmedStatus(ArmedState.DISARMED, "known")

    Reconnect().run(made.target("app"), OFF, replace(made.context(), armed=status, clock=clock))
    assert changes(fake) == ["connect"]


def test_phm_joins_the_existing_networks(fake: FakeEngine, ask: DockerEngine) -> None:
    """A missing network does not prevent it from joining the others."""
    made = agent(fake, ask, exists=True)
    made.settings.containers[0].networks.insert(0, "radio")
    fake.containers["phm"] = container("phm")
    me = testing.container("phm", id=fake.containers["phm"]["Id"])
    restarts: list[str] = []
    context = replace(made.context(), own_container=lambda: me, restart_ros=restarts.append)
    assert JoinNetwork().run(made.target("app"), OFF, context) == "PHM joined network swarm"
    assert restarts == ["PHM joined a network"]


def own(fake: FakeEngine, attached: dict[str, str]) -> ContainerFact:
    """PHM's container, with an alias and fixed addresses on these networks."""
    fake.containers["phm"] = container("phm", networks=attached)
    for endpoint in fake.containers["phm"]["NetworkSettings"]["Networks"].values():
        endpoint.update({"Aliases": ["phm", "agent1-phm"], "IPAMConfig": BOTH})
    return container_fact(fake.containers["phm"])


@pytest.mark.parametrize("listed", [True, False])
def test_phm_joins_a_recreated_network_with_its_aliases_and_addresses(
    fake: FakeEngine, ask: DockerEngine, listed: bool
) -> None:
    """Routers and ground stations find PHM by them. If the engine does not list the old attachment any more, PHM remembers it."""
    made = agent(fake, ask, exists=True)
    before = own(fake, {"swarm": "old"})
    fake.networks["swarm"] = {"Id": "new"}
    if not listed:
        fake.containers["phm"]["NetworkSettings"]["Networks"].clear()
    context = replace(
        made.context(),
        own_container=lambda: container_fact(fake.containers["phm"]),
        own_attachment=lambda name: next(one for one in before.networks if one.name == name),
    )
    assert JoinNetwork().run(made.target("app"), OFF, context) == "PHM joined network swarm"
    after = fake.containers["phm"]["NetworkSettings"]["Networks"]["swarm"]
    assert (after["NetworkID"], after["Aliases"], after["IPAMConfig"]) == ("new", ["phm", "agent1-phm"], BOTH)


def test_phm_joins_a_network_that_refuses_its_address(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another container has it now, or the new network has another subnet. Without the network PHM would see nothing there."""
    made = agent(fake, ask, exists=True)
    me = own(fake, {"swarm": "old"})
    fake.networks["swarm"] = {"Id": "new"}
    connect = ask.connect

    def refuse(network: str, container: str, aliases: Any = (), addresses: Any = ()) -> None:
        if addresses:
            raise EngineBroken("no configured subnet contains IP address 10.9.0.7")
        connect(network, container, aliases)

    monkeypatch.setattr(ask, "connect", refuse)
    context = replace(made.context(), own_container=lambda: me)
    assert JoinNetwork().run(made.target("app"), OFF, context) == "PHM joined network swarm"
    after = fake.containers["phm"]["NetworkSettings"]["Networks"]["swarm"]
    assert (after["Aliases"], after["IPAMConfig"]) == (["phm", "agent1-phm"], None)


def both_off(fake: FakeEngine, ask: DockerEngine) -> tuple[Bench, ActionContext]:
    """Neither `app` nor PHM's own container is on the network."""
    made = agent(fake, ask, exists=True)
    fake.containers["phm"] = container("phm")
    me = testing.container("phm", id=fake.containers["phm"]["Id"])
    return made, replace(made.context(), own_container=lambda: me)


def test_phm_joins_the_network_to_which_it_reconnects_a_container(fake: FakeEngine, ask: DockerEngine) -> None:
    """Both have lost it: otherwise the container's unit stays bad, and the reconnection counts as failed after 30 s."""
    restarts: list[str] = []
    made, context = both_off(fake, ask)
    words = Reconnect().run(made.target("app"), OFF, replace(context, restart_ros=restarts.append))
    assert words == "reconnected app to swarm; PHM joined network swarm"
    assert restarts == ["PHM joined a network"]
    assert changes(fake) == ["connect", "connect"]


def test_a_container_is_reconnected_even_if_phm_cannot_join(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reconnection has succeeded; `join_network` follows for what is left."""
    made, context = both_off(fake, ask)
    connect = ask.connect

    def only_app(network: str, container: str, aliases: Any = (), addresses: Any = ()) -> None:
        if container == "phm":
            raise EngineTimeout("no answer")
        connect(network, container, aliases, addresses)

    monkeypatch.setattr(ask, "connect", only_app)
    assert Reconnect().run(made.target("app"), OFF, context) == "reconnected app to swarm"
