"""The files of `phm init`: valid for the programs that read them, and right for this machine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import yaml
from hypothesis import given, strategies as st

from phm.config.loader import loads
from phm.core.settings import Settings
from phm.setup.answers import Answers
from phm.setup.machine import Application, SerialPort
from phm.setup.template_renderer import render
from phm.setup.yaml_text import quoted
from tests.docs.blocks import blocks
from tests.docs.examples import ROOT
from tests.setup.machines import application, machine

PORT = SerialPort("/dev/serial/by-id/usb-Pixhawk", 20)


def answers(*containers: str, **more: Any) -> Answers:
    given = {"recover": False, "mavlink": "none", "network": "bridge", **more}
    return Answers("agent_7", 7, containers, **given)


def made(*applications: Application, **more: Any) -> dict[str, str]:
    return render(machine(*applications, ports=(PORT,)), answers(*(one.name for one in applications), **more))


def settings(texts: dict[str, str], **environ: str) -> Settings:
    return loads(texts["phm.yaml"], environ=environ)


def service(texts: dict[str, str]) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(texts["compose.yaml"])["services"]["phm"]
    return found


def variables(texts: dict[str, str]) -> dict[str, str]:
    lines = [line for line in texts["agent.env"].splitlines() if line and not line.startswith("#")]
    return dict(line.split("=", 1) for line in lines)


@pytest.mark.parametrize("mavlink", ["none", "udpout:host.docker.internal:14550", "tcp:10.0.0.1:5760", "/dev/ttyACM0"])
@pytest.mark.parametrize("recover", [True, False])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_every_variant_is_valid(mavlink: str, recover: bool, count: int) -> None:
    """phm.yaml passes the loader with and without agent.env."""
    applications = [application(f"app_{number}", devices=["/dev/ttyACM0"]) for number in range(count)]
    critical = ("app_0",) if recover and mavlink != "none" and count else ()
    texts = made(*applications, mavlink=mavlink, recover=recover, flight_critical=critical)
    assert settings(texts) == settings(texts, **variables(texts))
    assert len(settings(texts).containers) == count
    assert service(texts)["image"].endswith("phm-sidecar:dev}")


@pytest.mark.parametrize("network", ["bridge", "host"])
def test_deliveries_are_permitted_on_request_alone(network: str) -> None:
    """Then the configuration is in a separate folder, with a key; compose.yaml is unchanged and outside of it."""
    where = ("10.0.0.7", 9465)
    plain, texts = made(network=network), made(network=network, deliver=where)
    assert texts["compose.yaml"] == plain["compose.yaml"]
    assert set(texts) == {*plain, "compose.override.yaml", "delivered/phm.yaml"} - {"phm.yaml"}
    assert loads(plain["phm.yaml"], environ={}).delivery.listen is None
    delivery = loads(texts["delivered/phm.yaml"], environ={}).delivery
    host = "10.0.0.7" if network == "host" else "0.0.0.0"
    assert (delivery.address, delivery.key) == ((host, 9465), "/etc/phm-delivered/delivery.key")
    override = yaml.safe_load(texts["compose.override.yaml"])["services"]["phm"]
    assert ("ports" in override) is (network == "bridge")


def test_a_bridged_application_has_its_networks_and_devices() -> None:
    """PHM joins the networks itself; the host is reachable for MAVLink."""
    app = application("demo-autonomy-1", service="autonomy", devices=["/dev/ttyACM0"])
    texts = made(app, recover=True, mavlink="udpout:host.docker.internal:14550")
    (entry,) = settings(texts).containers
    assert (entry.name, entry.key, entry.networks, entry.recover) == ("demo-autonomy-1", "autonomy", ["swarm"], True)
    assert [device.path for device in entry.devices] == ["/dev/ttyACM0"]
    assert "network_mode" not in service(texts)
    assert service(texts)["extra_hosts"] == ["host.docker.internal:host-gateway"]
    assert service(made(app, mavlink="/dev/ttyACM0"))["extra_hosts"] == service(texts)["extra_hosts"]


@pytest.mark.parametrize("more", [[], ["/dev/ttyACM0"]])
def test_only_character_devices_are_checked(more: list[str]) -> None:
    """A mapped folder or disk would be a fault from the start."""
    app = application("app", devices=["/dev/dri", *more])
    texts = render(machine(app, other_devices=["/dev/dri"]), answers("app"))
    assert [device.path for device in settings(texts).containers[0].devices] == more
    assert "/dev/dri is a folder" in texts["phm.yaml"]


def test_an_application_on_the_hosts_network_has_phm_there_too() -> None:
    """There is no network to reconnect."""
    texts = made(application("app", mode="host"), network="host", mavlink="udpout:127.0.0.1:14550")
    assert service(texts)["network_mode"] == "host"
    assert settings(texts).containers[0].networks == []


def test_phm_is_in_the_groups_that_own_socket_and_serial_ports() -> None:
    """By number: the image does not know the names of the host."""
    assert service(made())["group_add"] == ["998", "20"]


def test_only_the_socket_may_belong_to_the_group_of_root() -> None:
    """As for an engine without the group docker, or a rootless one. A serial port of this group is not given to PHM."""
    found = replace(machine(ports=(SerialPort("/dev/ttyS0", 0),)), socket_group_id=0)
    assert service(render(found, answers()))["group_add"] == ["0"]
    assert service(render(replace(found, socket_group_id=None), answers()))["group_add"] == []


@pytest.mark.parametrize(
    ("mavlink", "port"), [("udpin:0.0.0.0:14551", "14551:14551/udp"), ("tcpin:0.0.0.0:5760", "5760:5760/tcp")]
)
def test_the_port_of_an_endpoint_that_waits_for_peers_is_published(mavlink: str, port: str) -> None:
    """On a bridge nothing else of this machine reaches it. On the host's network it is the host's own port."""
    assert service(made(application("app"), mavlink=mavlink))["ports"] == [f"127.0.0.1:{port}"]
    assert "ports" not in service(made(application("app"), mavlink=mavlink, network="host"))
    assert "ports" not in service(made(application("app"), mavlink="udpout:10.0.0.5:14550"))
    inside = made(application("app"), mavlink=mavlink.replace("0.0.0.0", "127.0.0.1"))
    assert "ports" not in service(inside) and "listens only inside PHM's container" in inside["compose.yaml"]


def test_a_path_with_colons_is_mapped_in_the_long_form() -> None:
    """As udev names them by the place of the connector. In the short form, Compose takes a colon for the end of the path."""
    path = "/dev/serial/by-path/platform-fd500000.pcie-pci-0000:01:00.0-usb-0:1.1:1.0"
    (found,) = service(made(mavlink=path))["devices"]
    assert found == {"source": path, "target": path, "permissions": "rwm"}


def test_a_serial_endpoint_is_mapped_into_the_container() -> None:
    """At the same path."""
    texts = made(mavlink="/dev/ttyACM0")
    assert service(texts)["devices"] == ["/dev/ttyACM0:/dev/ttyACM0"]
    assert settings(texts).mavlink.endpoints[0].serial


def test_a_serial_endpoint_that_may_be_missing_has_an_alternative() -> None:
    """Docker resolves `devices` at every start of the container: a missing port would keep PHM from starting."""
    text = made(mavlink="/dev/ttyACM0")["compose.yaml"]
    assert "without the port PHM does not start" in text
    assert '# device_cgroup_rules:\n    #   - "c 166:* rw"' in text


def test_an_engine_reached_over_tcp_needs_no_socket() -> None:
    """No volume shows it to the container."""
    texts = render(machine(url="tcp://10.0.0.1:2375"), answers())
    assert settings(texts).docker.socket == "tcp://10.0.0.1:2375"
    assert not [volume for volume in service(texts)["volumes"] if "docker.sock" in volume]


def test_nodes_name_their_container_where_there_are_several() -> None:
    """A node whose container is not known names none."""
    nodes = (("/agent_7/camera", "b"), ("/agent_7/planner", ""))
    texts = made(application("a"), application("b"), nodes=nodes)
    assert [(node.name, node.container) for node in settings(texts).ros.nodes] == [
        ("/agent_7/camera", "b"),
        ("/agent_7/planner", None),
    ]


# ------------------------------------------------------------ ROS


def test_ros_variables_are_those_of_the_application() -> None:
    """Of the application that has some; quoted where necessary."""
    env = {"ROS_DOMAIN_ID": "7", "ROS_STATIC_PEERS": "10.0.0.1;x y", "ROS_DISTRO": "jazzy"}
    found = variables(made(application("web"), application("app", env=env)))
    assert found["PHM_AGENT_ID"] == "7" and found["ROS_DOMAIN_ID"] == "7" and "ROS_DISTRO" not in found
    assert found["ROS_STATIC_PEERS"] == "'10.0.0.1;x y'"


LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def test_an_application_with_the_range_localhost_is_looked_for_by_name_from_another_network_namespace() -> None:
    """PHM keeps the default range. LOCALHOST on both sides was measured as impossible there."""
    found = variables(made(application("app", env=LOCAL), application("two", env={"ROS_LOCALHOST_ONLY": "1"})))
    assert found["ROS_STATIC_PEERS"] == "app;two"
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" not in found
    shared = application("inner", mode="container:app", owner="app", env=LOCAL)
    assert variables(made(application("app"), shared))["ROS_STATIC_PEERS"] == "app"


@pytest.mark.parametrize(("mode", "network"), [("bridge", "bridge"), ("swarm", "host")])
def test_where_names_are_not_resolved_the_address_is_written(mode: str, network: str) -> None:
    """On Docker's default bridge, and from the host; the file says that the address may change."""
    texts = made(application("app", mode=mode, env=LOCAL), network=network)
    assert variables(texts)["ROS_STATIC_PEERS"] == "10.9.0.2"
    assert "another address" in texts["agent.env"]


def test_on_the_network_of_the_host_phm_takes_the_range_of_the_application() -> None:
    """There LOCALHOST works on both sides."""
    found = variables(made(application("app", mode="host", env=LOCAL), network="host"))
    assert found["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST" and "ROS_STATIC_PEERS" not in found


def test_an_application_of_another_domain_is_named() -> None:
    """One PHM has one ROS_DOMAIN_ID; the file names the containers with another one."""
    one, other = application("one", env={"ROS_DOMAIN_ID": "1"}), application("two", env={"ROS_DOMAIN_ID": "2"})
    assert "Other values are set in two" in made(one, other)["agent.env"]


def test_another_middleware_needs_another_image() -> None:
    """The environment file says so beside RMW_IMPLEMENTATION."""
    text = made(application("app", env={"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}))["agent.env"]
    assert "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in text and "image must have rmw_cyclonedds_cpp" in text


@pytest.mark.parametrize("path", ["/opt/dds.xml", "/etc/phm/dds.xml", "/opt/phm/code/phm/__init__.py"])
def test_a_profile_of_the_application_is_copied_and_never_mounted_at_a_path_that_its_image_chose(path: str) -> None:
    """A mount there could replace PHM's code. The profile that PHM ships is not copied: it only shortens leases."""
    env = {"FASTDDS_DEFAULT_PROFILES_FILE": path}
    texts = made(application("app", env=env, profile="<dds/>"))
    assert texts["application-fastdds.xml"] == "<dds/>"
    assert variables(texts)["FASTRTPS_DEFAULT_PROFILES_FILE"] == "/etc/phm/application-fastdds.xml"
    assert not [volume for volume in service(texts)["volumes"] if "application-fastdds" in volume or path in volume]
    shipped = (ROOT / "config" / "fastdds.xml").read_text("utf-8")
    assert "application-fastdds.xml" not in made(application("app", env=env, profile=shipped))


def test_the_shipped_profile_is_the_documented_one() -> None:
    """config/fastdds.xml is what the documents name."""
    assert made()["fastdds.xml"] == (ROOT / "config" / "fastdds.xml").read_text("utf-8")


@given(st.text())
def test_text_from_outside_stays_one_value(text: str) -> None:
    """Whatever a name contains, YAML reads it back."""
    plain = text.encode("utf-8", "replace").decode()
    assert yaml.safe_load(f"[{quoted(plain)}]") == [plain.replace("${", "$${")]


def test_phm_yaml_reads_the_mounts_of_the_service_in_the_guide() -> None:
    """docs/guides/compose.md puts this file, alone, beside the user's own Compose file."""
    (block,) = (one for one in blocks("yaml") if one.page == "docs/guides/compose.md" and "  phm:" in one.text)
    guide, own = yaml.safe_load(block.text), made(application("ros_app"), mavlink="udpout:host.docker.internal:14550")
    found = guide["services"]["phm"]
    mounts = dict(reversed(one.split(":")[:2]) for one in found["volumes"])
    read = loads(own["phm.yaml"], environ=found["environment"])
    assert (mounts[read.host.dev_root], mounts[read.pressure.cgroups]) == ("/dev", "/sys/fs/cgroup")
    assert read.host.dev_root == "/host/dev"
    assert found["extra_hosts"] == service(own)["extra_hosts"]
    assert set(guide["volumes"]) == {mounts["/var/log/phm"], mounts["/var/lib/phm"]}
