"""The ROS child's own Fast DDS profile, by its environment."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from phm.probes.ros import fastdds_profile
from phm.probes.ros.fastdds_profile import MAX_PEERS, adapt, profile, remove
from phm.probes.ros.sandbox import OWN_PROFILE, PROFILE_VARIABLES

UDP = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def elements(environ: dict[str, str]) -> set[str]:
    """Names of the profile's elements."""
    return {element.tag.rpartition("}")[2] for element in ET.fromstring(profile(environ)).iter()}


def test_by_default_it_announces_often_and_changes_nothing_else() -> None:
    """Transports and peers are those of the middleware."""
    found = elements(dict(UDP))
    assert "leaseAnnouncement" in found
    assert not found & {"transport_descriptors", "initialPeersList", "metatrafficUnicastLocatorList"}


@pytest.mark.parametrize("variables", [LOCAL, {"ROS_LOCALHOST_ONLY": "1"}])
def test_localhost_goes_over_udp_without_multicast(variables: dict[str, str]) -> None:
    """rmw_fastrtps itself would add shared memory, over which another container's data is lost."""
    environ = {**UDP, **variables}
    assert {"initialPeersList", "metatrafficUnicastLocatorList", "userTransports"} <= elements(environ)
    assert environ == {**UDP, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}


def test_static_peers_stay_with_the_discovery_range() -> None:
    """ROS_LOCALHOST_ONLY=1 switches them off, as in rcl. A name is resolved, or the child ends."""
    environ = {**UDP, **LOCAL, "ROS_STATIC_PEERS": "10.0.0.1;localhost"}
    text = profile(dict(environ))
    assert text.count("<address>10.0.0.1</address>") == 1 and text.count("<address>127.0.0.1</address>") == 2
    assert "10.0.0.1" not in profile({**environ, "ROS_LOCALHOST_ONLY": "1"})
    with pytest.raises(OSError):
        profile({**environ, "ROS_STATIC_PEERS": "no.such.host.invalid"})


def test_static_peers_are_looked_for_on_more_ports() -> None:
    """Fast DDS itself finds four processes of a peer."""
    assert "maxInitialPeersRange" in elements({**UDP, "ROS_STATIC_PEERS": "10.0.0.1"})


def seconds(parent: ET.Element, name: str) -> float:
    """A duration of the profile."""
    parts = {one.tag.rpartition("}")[2]: int(one.text or "") for one in parent.iterfind(f".//{{*}}{name}/*")}
    return parts.get("sec", 0) + parts.get("nanosec", 0) / 1e9


@pytest.mark.parametrize("variables", [{}, LOCAL])
@pytest.mark.parametrize("peers", [1, 2, 3, 6])
def test_static_peers_are_not_flooded(peers: int, variables: dict[str, str]) -> None:
    """Each announcement is a packet to each port of each peer, perhaps over a radio. Only the first five seconds have more."""
    names = ";".join(f"10.0.0.{number + 1}" for number in range(peers))
    found = ET.fromstring(profile({**UDP, **variables, "ROS_STATIC_PEERS": names}))
    assert found.findtext(".//{*}maxInitialPeersRange") == str(MAX_PEERS)
    period_s = seconds(found, "leaseAnnouncement")
    assert peers * MAX_PEERS / period_s <= 40 or period_s == 3.0
    first = found.find(".//{*}initialAnnouncements")
    assert first is not None and int(first.findtext("{*}count", "")) * seconds(first, "period") == 5.0


@pytest.mark.parametrize("variables", [{}, LOCAL, {"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.1"}])
def test_without_static_peers_it_announces_often(variables: dict[str, str]) -> None:
    """To a multicast address, or on loopback."""
    assert seconds(ET.fromstring(profile({**UDP, **variables})), "leaseAnnouncement") == 0.25


def test_the_lease_is_that_of_a_node_without_a_profile() -> None:
    """A node that drops PHM's participant while PHM keeps the node sends nothing to it any more."""
    assert seconds(ET.fromstring(profile(dict(UDP))), "leaseDuration") == 20.0


def test_transports_of_the_users_own_stay() -> None:
    """A node configured for shared memory, or one that shares the IPC namespace, gets the transports of the middleware."""
    environ = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT", **LOCAL}
    assert "userTransports" not in elements(environ)
    assert environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_a_profile_of_the_users_own_wins() -> None:
    """Nothing is changed then."""
    environ = {**UDP, **LOCAL, "FASTDDS_DEFAULT_PROFILES_FILE": "/etc/phm/own.xml"}
    before = dict(environ)
    adapt(environ)
    assert environ == before


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are written."""
    monkeypatch.setattr(fastdds_profile, "FOLDERS", (Path("/nowhere"), tmp_path))
    return tmp_path


def test_the_profile_is_a_file_until_the_child_ends(folder: Path) -> None:
    """Both names are set: Fast DDS 2 and 3 read different ones. Files of children that were killed are removed."""
    left = folder / f"{fastdds_profile._prefix()}999999999-x.xml"
    left.touch()
    environ = dict(UDP)
    adapt(environ)
    (file,) = folder.iterdir()
    assert {environ[name] for name in (*PROFILE_VARIABLES, OWN_PROFILE)} == {str(file)}
    assert file.read_text() == profile(dict(UDP))
    remove(environ)
    assert not file.exists()


def test_without_a_folder_to_write_to_the_middleware_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else is changed then."""
    monkeypatch.setattr(fastdds_profile, "FOLDERS", (Path("/nowhere"),))
    environ = {**UDP, **LOCAL}
    adapt(environ)
    assert environ == {**UDP, **LOCAL}


def test_at_a_discovery_server_phm_asks_for_the_entire_graph() -> None:
    """An ordinary client learns of matching endpoints alone. A value of the user's own stays."""
    environ = {"ROS_DISCOVERY_SERVER": "10.0.0.1:11811", "FASTDDS_DEFAULT_PROFILES_FILE": "/own.xml"}
    adapt(environ)
    assert environ["ROS_SUPER_CLIENT"] == "TRUE"
    environ["ROS_SUPER_CLIENT"] = "FALSE"
    adapt(environ)
    assert environ["ROS_SUPER_CLIENT"] == "FALSE"
