"""Slot 4: rules of the network check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.network import Network

NET, ID = "swarm_net", "id-1"


def on(network_id: str = ID, name: str = NET, address: str = "172.20.0.3") -> tuple[api.Attachment, ...]:
    return (api.Attachment(name, network_id, address),)


def docker(me: api.ContainerFact | None = None, **fields: Any) -> testing.FakeDocker:
    fields.setdefault("networks", on())
    return testing.FakeDocker(testing.container("ros_app", **fields), networks={NET: ID}, me=me)


def evaluate(engine: testing.FakeDocker, **entry: Any) -> api.Result:
    (check,) = Network.build(testing.settings(containers=[{"name": "ros_app", "networks": [NET], **entry}]))
    result = check.run(testing.world(docker=engine))
    assert isinstance(result, api.Result)
    return result


def test_containers_without_networks_have_no_unit() -> None:
    """There is nothing to check."""
    assert list(Network.build(testing.settings(containers=[{"name": "ros_app"}]))) == []


def test_a_connected_container_that_responds_is_ok() -> None:
    """Attached to the network with this id, PHM attached too, and its address responds."""
    result = evaluate(docker(me=testing.container("phm", networks=on(address="172.20.0.2"))))
    assert result.level is api.Level.OK
    assert "172.20.0.3" in result.summary


def test_a_container_without_its_network_is_disconnected() -> None:
    """Recovery reconnects it."""
    result = evaluate(docker(networks=()))
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "disconnected", "ros_app")
    assert result.brief == "ros_app not on swarm_net"
    assert result.evidence.conclusive, "the engine lists its networks"


def test_a_network_lost_in_this_run_of_the_container_does_not_come_back_by_itself() -> None:
    """So it is a fault also in the seconds after a start, and ends the verification of an action. In a campaign a network that was
    disconnected 1.5 s after a start was reported 15 s later. After a start the engine may still attach the container."""
    (check,) = Network.build(testing.settings(containers=[{"name": "ros_app", "networks": [NET]}]))

    def certain(**fields: Any) -> bool:
        result = check.run(testing.world(docker=docker(**fields)))
        assert isinstance(result, api.Result)
        return result.evidence.certain

    assert [certain(networks=()), certain(), certain(networks=())] == [False, False, True]
    restarted = "2026-11-25T12:00:00Z"
    assert [certain(networks=(), started_at=restarted), certain(started_at=restarted)] == [False, False]
    assert certain(networks=(), started_at=restarted)
    assert not certain(networks=())


def test_an_attachment_to_a_recreated_network_is_disconnected() -> None:
    """Ids count: a recreated network of the same name is another network."""
    result = evaluate(docker(networks=on(network_id="old-id")))
    assert result.condition == "disconnected"
    assert "removed and recreated" in result.summary


def test_an_attachment_without_address_is_disconnected() -> None:
    """An incomplete endpoint carries no data."""
    result = evaluate(docker(networks=on(address="")))
    assert (result.condition, result.evidence.conclusive) == ("disconnected", False)


def test_a_network_that_does_not_exist_has_its_own_condition() -> None:
    """Connecting cannot help; the text suggests the name that Compose created."""
    engine = docker(networks=on(name=f"project_{NET}"))
    engine.networks.clear()
    result = evaluate(engine)
    assert result.condition == "network_missing"
    assert f"project_{NET}" in result.summary


def test_phm_outside_of_the_network_is_reported_without_a_ping() -> None:
    """From another network a ping proves nothing."""
    engine = docker(me=testing.container("phm", networks=on(network_id="other")))
    engine.silent.add("172.20.0.3")
    assert evaluate(engine).condition == "sidecar_disconnected"


@pytest.mark.parametrize("me", [None, testing.container("phm", network_mode="host")])
def test_phm_with_host_networking_reaches_bridge_networks(me: api.ContainerFact | None) -> None:
    """The host reaches bridge networks directly."""
    assert evaluate(docker(me=me)).level is api.Level.OK


ON_HOST = [None, testing.container("phm", network_mode="host")]


@pytest.mark.parametrize("me", ON_HOST)
def test_an_address_that_the_host_may_not_reach_is_not_judged(me: api.ContainerFact | None) -> None:
    """Linux passes nothing between an interface and its macvlan children: silence there does not show a fault."""
    engine = docker(me=me)
    engine.silent.add("172.20.0.3")
    engine.drivers[NET] = "macvlan"
    result = evaluate(engine)
    assert result.level is api.Level.OK
    assert "its address there is not checked" in result.summary and "macvlan" in result.summary
    engine.drivers[NET] = "bridge"
    assert evaluate(engine).condition == "address_silent"


def test_phm_on_a_macvlan_judges_its_addresses() -> None:
    """From the same network, silence does."""
    engine = docker(me=testing.container("phm", networks=on(address="172.20.0.2")))
    engine.silent.add("172.20.0.3")
    engine.drivers[NET] = "macvlan"
    assert evaluate(engine).condition == "address_silent"


def test_an_address_that_responded_before_is_known_to_be_reachable() -> None:
    """In this run of PHM, whatever the run of the container: a recovery may follow. Of another address the check knows nothing."""
    engine = docker(networks=(*on(), *on("id-2", "second", "172.21.0.3")))
    engine.networks["second"] = "id-2"
    (check,) = Network.build(testing.settings(containers=[{"name": "ros_app", "networks": [NET, "second"]}]))

    def never_ok(*silent: str) -> bool | None:
        engine.silent = set(silent)
        result = check.run(testing.world(docker=engine))
        assert isinstance(result, api.Result) and result.condition == "address_silent"
        return result.evidence.never_ok

    assert never_ok("172.20.0.3", "172.21.0.3") is None
    assert never_ok("172.20.0.3") is None
    engine.change("ros_app", started_at="2026-11-25T12:00:00Z")
    assert never_ok("172.20.0.3", "172.21.0.3") is False, "the second one has responded"


def test_a_silent_address_is_an_error_after_two_pings() -> None:
    """One lost echo is not a fault, two are."""
    engine = docker()
    engine.silent.add("172.20.0.3")
    assert evaluate(engine).condition == "address_silent"


def test_one_lost_echo_is_not_a_fault() -> None:
    """The second ping decides."""

    class Lossy(testing.FakeDocker):
        answers = iter([False, True])

        def reachable(self, address: str) -> bool:
            return next(self.answers)

    engine = Lossy(testing.container("ros_app", networks=on()), networks={NET: ID})
    assert evaluate(engine).level is api.Level.OK


def test_an_address_is_not_pinged_if_the_configuration_disables_it() -> None:
    """Some containers drop pings on purpose."""
    engine = docker()
    engine.silent.add("172.20.0.3")
    assert evaluate(engine, address=False).level is api.Level.OK


@pytest.mark.parametrize("mode", ["host", "container:vpn"])
def test_a_container_without_its_own_networks_is_a_bypass(mode: str) -> None:
    """It has no connection to check, and reconnecting is impossible."""
    assert evaluate(docker(network_mode=mode, networks=())).bypass


def test_network_mode_none_is_an_error_that_reconnecting_cannot_fix() -> None:
    """Docker refuses to connect such a container, so its condition has no recovery steps."""
    assert evaluate(docker(network_mode="none", networks=on(name="none", network_id="n"))).condition == "no_network"


def test_the_cause_gives_the_condition_when_several_networks_fail() -> None:
    """Disconnected comes before silent, and both are reported."""
    engine = docker()
    engine.networks["second"] = "id-2"
    engine.silent.add("172.20.0.3")
    result = evaluate(engine, networks=[NET, "second"])
    assert result.condition == "disconnected"
    assert "second" in result.summary and "172.20.0.3" in result.summary


def test_networks_of_a_stopped_container_are_stale() -> None:
    """Docker removes endpoints when a container stops; the network is not at fault."""
    assert evaluate(docker(status="exited", networks=())).level is api.Level.STALE


def test_a_silent_engine_is_not_a_network_fault() -> None:
    """CannotTell propagates."""
    engine = docker()
    engine.fail()
    with pytest.raises(api.CannotTell):
        evaluate(engine)
