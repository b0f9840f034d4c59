"""Differences between the ROS environments of an application and of PHM, as sentences."""

from __future__ import annotations

from typing import Any

import pytest

from phm.facts import RosEnvironment
from phm.probes.ros.environment_differences import differences, discovery_range, sidecar_variables

HOST = {"network_namespace": "host", "ipc_namespace": "host"}
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
PHM = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}


def app(variables: dict[str, str] | None = None, **fields: Any) -> RosEnvironment:
    return RosEnvironment("ros_app", variables or {}, **{"exact": True, **HOST, **fields})


def phm(variables: dict[str, str] | None = None, **fields: Any) -> RosEnvironment:
    return RosEnvironment("PHM", {**PHM, **(variables or {})}, **{**HOST, **fields})


def bridged(name: str, **fields: Any) -> dict[str, Any]:
    return {"network_namespace": name, "ipc_namespace": name, "networks": frozenset({"phm_net"}), **fields}


def one(application: RosEnvironment, own: RosEnvironment, **more: Any) -> str:
    (found,) = differences(application, own, **more)
    assert found.certain
    return found.text


def test_equal_environments_have_no_difference() -> None:
    """Defaults that are written out equal those that are not."""
    assert not differences(app(), phm())
    assert not differences(app({"ROS_DOMAIN_ID": "0", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}), phm())
    assert not differences(app({"ROS_DOMAIN_ID": "7"}), phm({"ROS_DOMAIN_ID": "7"}))


def test_another_domain_names_the_line_to_change() -> None:
    """In the sidecar's environment, or in phm.yaml where the domain is set there."""
    text = "ROS_DOMAIN_ID is 7 in ros_app and not set (0) in PHM: set "
    assert one(app({"ROS_DOMAIN_ID": "7"}), phm()) == f"{text}ROS_DOMAIN_ID=7 in the sidecar's environment"
    assert one(app({"ROS_DOMAIN_ID": "7"}), phm(), configured_domain=True) == f"{text}ros.domain: 7 in phm.yaml"


def test_a_variable_that_only_phm_has_may_come_from_an_entrypoint() -> None:
    """What a script sets is not in the container's configuration, so the difference is not certain."""
    (found,) = differences(app(exact=False), phm({"ROS_DOMAIN_ID": "7"}))
    assert not found.certain
    assert "unless an entrypoint script of ros_app sets it: `docker exec ros_app cat /proc/1/environ`" in found.text
    assert "remove ROS_DOMAIN_ID" in one(app(), phm({"ROS_DOMAIN_ID": "7"}))


def test_another_middleware_needs_another_image() -> None:
    """PHM's image has Fast DDS."""
    text = one(app({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}), phm())
    assert "RMW_IMPLEMENTATION is rmw_cyclonedds_cpp in ros_app and rmw_fastrtps_cpp in PHM: build PHM's image" in text


def test_both_names_of_fast_dds_are_one_middleware() -> None:
    """The dynamic variant differs in type support alone."""
    assert not differences(app({"RMW_IMPLEMENTATION": "rmw_fastrtps_dynamic_cpp"}), phm())


@pytest.mark.parametrize("variables", [{"ROS_LOCALHOST_ONLY": "1"}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}])
def test_localhost_is_the_same_by_either_variable(variables: dict[str, str]) -> None:
    """rcl gives ROS_LOCALHOST_ONLY precedence."""
    assert discovery_range(app(variables)) == "LOCALHOST"
    assert not differences(app(variables), phm({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}))


def test_localhost_in_another_network_namespace_needs_a_static_peer() -> None:
    """The application announces itself on its own loopback interface only."""
    local = app(LOCAL, **bridged("a"))
    text = one(local, phm(**bridged("b")))
    assert "set ROS_STATIC_PEERS to the name or address of ros_app in the sidecar's environment, or run" in text
    assert not differences(local, phm({"ROS_STATIC_PEERS": "172.18.0.2"}, **bridged("b")))


@pytest.mark.parametrize("variables", [LOCAL, {"ROS_LOCALHOST_ONLY": "1"}])
def test_localhost_on_both_sides_of_a_bridge_needs_two_lines(variables: dict[str, str]) -> None:
    """Measured: it works with a static peer and the default range in PHM."""
    (name,) = variables
    local = app(LOCAL, **bridged("a"))
    text = one(local, phm(variables, **bridged("b")))
    assert f"set ROS_STATIC_PEERS to the name or address of ros_app and remove {name} in the sidecar's" in text
    (found,) = differences(local, phm({**LOCAL, "ROS_STATIC_PEERS": "172.18.0.2"}, **bridged("b")))
    assert "is in another: remove ROS_AUTOMATIC" in found.text.replace("PHM ", "") and not found.certain


def test_static_peers_that_only_the_application_has_are_a_possible_cause() -> None:
    """They are set where multicast does not pass; one side that looks for the other is enough."""
    peers = {"ROS_STATIC_PEERS": "10.0.0.5"}
    (found,) = differences(app(peers, **bridged("a")), phm(**bridged("b")))
    assert "ROS_STATIC_PEERS is 10.0.0.5 in ros_app and not set in PHM" in found.text and not found.certain
    assert not differences(app(), phm(peers)) and not differences(app(peers), phm({"ROS_STATIC_PEERS": "10.0.0.6"}))
    switched_off = app({**peers, "ROS_LOCALHOST_ONLY": "1"})
    assert [one.variable for one in differences(switched_off, phm())] == ["ROS_LOCALHOST_ONLY"]


def test_a_range_of_phm_that_excludes_the_application_is_named() -> None:
    """OFF discovers nothing; LOCALHOST nothing outside of the own network namespace."""
    assert "remove ROS_AUTOMATIC_DISCOVERY_RANGE" in one(app(), phm({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}))
    assert "OFF in ros_app" in one(app({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}), phm())
    apart = phm({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, **bridged("b"))
    assert "is LOCALHOST in PHM and the discovery range is SUBNET in ros_app" in one(app(**bridged("a")), apart)


def test_a_discovery_server_must_be_known_to_both() -> None:
    """Its clients do not announce themselves to others."""
    text = one(app({"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}), phm())
    assert text.endswith("set ROS_DISCOVERY_SERVER=10.0.0.1:11811 in the sidecar's environment")


def test_networks_that_do_not_meet_are_named() -> None:
    """Host against bridge, two bridges, and no network at all."""
    assert "set network_mode: host for the sidecar" in one(app(), phm(**bridged("b")))
    other = app(**bridged("a", networks=frozenset({"app_net"})))
    assert "add app_net to the sidecar's networks" in one(other, phm(**bridged("b")))
    alone = app(**bridged("a", networks=frozenset({"none"})))
    assert "network_mode none" in one(alone, phm(**bridged("b")))
    assert not differences(app(**bridged("a")), phm(**bridged("b")))
    assert not differences(app(network_namespace=""), phm(**bridged("b")))


def test_transports_that_phm_does_not_have_are_named() -> None:
    """UDP on IPv4 reaches each application that does not switch it off."""
    assert "FASTDDS_BUILTIN_TRANSPORTS is SHM in ros_app" in one(app({"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}), phm())
    assert not differences(app({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}), phm())


def test_shared_memory_without_a_shared_ipc_namespace_is_named() -> None:
    """Only where PHM was configured to use it; with LOCALHOST, a profile of the user's own leaves it on."""
    apart, local = app(ipc_namespace="a"), {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert "set FASTDDS_BUILTIN_TRANSPORTS=UDPv4" in one(apart, phm({"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}))
    own = {**local, "FASTDDS_DEFAULT_PROFILES_FILE": "/own.xml"}
    assert "remove FASTDDS_DEFAULT_PROFILES_FILE" in one(app(local, ipc_namespace="a"), phm(own))
    assert not differences(apart, phm())


def test_localhost_in_the_application_alone_works_in_one_network_namespace() -> None:
    """Measured; PHM then also receives what other machines announce, so the difference is named, but not as certain."""
    (found,) = differences(app({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}), phm())
    assert not found.certain and "set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST in the sidecar's" in found.text


def test_a_profile_that_only_the_application_loads_is_a_possible_cause() -> None:
    """PHM's own profile changes leases alone."""
    (found,) = differences(app({"FASTDDS_DEFAULT_PROFILES_FILE": "/ws/dds.xml"}), phm())
    assert "/ws/dds.xml" in found.text and not found.certain
    assert not differences(app({"FASTRTPS_DEFAULT_PROFILES_FILE": "/etc/phm/fastdds.xml"}), phm())


def test_certain_differences_come_first() -> None:
    """They replace the general advice in a fault's text."""
    found = differences(app({"ROS_DOMAIN_ID": "7", "FASTDDS_DEFAULT_PROFILES_FILE": "/ws/dds.xml"}), phm())
    assert [one.certain for one in found] == [True, False]


def test_the_sidecar_gets_the_variables_that_decide_discovery() -> None:
    """And no others; ROS_LOCALHOST_ONLY by its present-day name."""
    variables = {
        "ROS_DOMAIN_ID": "7",
        "ROS_LOCALHOST_ONLY": "1",
        "ROS_DISTRO": "jazzy",
        "CYCLONEDDS_URI": "file:///c.xml",
    }
    domain = {"ROS_DOMAIN_ID": "7"}
    assert sidecar_variables(app(variables), same_network=True) == {**domain, **LOCAL}
    assert sidecar_variables(app(variables), same_network=False) == domain
    cyclone = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "CYCLONEDDS_URI": "file:///c.xml"}
    assert sidecar_variables(app(cyclone), same_network=True) == cyclone
