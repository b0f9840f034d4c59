"""What `phm init` finds on a machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from docker import APIClient

from phm.facts import CannotTell
from phm.setup.discovery import inspect_machine, serial_ports
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine
from tests.fakes.engine_faults import Status
from tests.setup.machines import described

LIMIT_S = 60.0


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeEngine]:
    with FakeEngine(tmp_path / "engine.sock") as fake:
        yield fake


def test_applications_are_found_with_what_ros_reads(fake: FakeEngine, tmp_path: Path) -> None:
    """Image, Compose service, network and ROS variables; nothing else of the environment."""
    labels = {"com.docker.compose.project": "agent", "com.docker.compose.service": "autonomy"}
    fake.containers["app"] = described("app", env={"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "jazzy"}, labels=labels)
    found = inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path)
    (app,) = found.applications
    assert (app.name, app.image, app.service, app.networks) == ("app", "app:1", "autonomy", ("swarm",))
    assert app.ros.variables == {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "jazzy"}
    assert found.engine == "20.10.24" and found.socket == fake.path
    assert found.socket_group_id == Path(fake.path).stat().st_gid


@pytest.mark.parametrize("rootless", [True, False])
def test_the_socket_of_a_rootless_engine_belongs_to_root_in_containers(
    rootless: bool, fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There the user of the engine is root, and the number of its group on the host is that of another group."""
    os.chown(fake.path, -1, os.getegid() or 4242)
    options = ["name=seccomp,profile=builtin", *(["name=rootless"] if rootless else [])]
    monkeypatch.setattr(APIClient, "info", lambda self: {"SecurityOptions": options})
    found = inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path)
    assert found.socket_group_id == (0 if rootless else os.getegid() or 4242)


def test_a_fast_dds_profile_is_read_from_the_container(fake: FakeEngine, tmp_path: Path) -> None:
    """One that cannot be read is left out."""
    profile = {"FASTDDS_DEFAULT_PROFILES_FILE": "/opt/dds.xml"}
    fake.containers["a"] = described("a", env=profile, files={"/opt/dds.xml": b"<dds/>"})
    fake.containers["b"] = described("b", env=profile)
    assert [one.profile for one in inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path).applications] == [
        "<dds/>",
        "",
    ]


def test_phm_and_finished_jobs_are_not_applications(fake: FakeEngine, tmp_path: Path) -> None:
    """A container that Docker keeps running is one, also while it is stopped."""
    fake.containers["phm"] = described("phm", entrypoint=["ros-entrypoint", "phm"])
    fake.containers["page"] = described("page", entrypoint=["ros-entrypoint"])
    fake.containers["page"]["Config"]["Cmd"] = ["sh", "-c", "phm status --web 0.0.0.0:8080 & exec phm run"]
    fake.containers["job"] = described("job", status="exited")
    fake.containers["kept"] = described("kept", status="exited")
    fake.containers["kept"]["HostConfig"]["RestartPolicy"] = {"Name": "unless-stopped"}
    found = inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path)
    assert [one.name for one in found.applications] == ["kept"]
    assert [one.name for one in found.sidecars] == ["phm", "page"]


def test_the_owner_of_a_shared_network_is_found_by_id(fake: FakeEngine, tmp_path: Path) -> None:
    """The engine names it by id, the configuration by name."""
    fake.containers["pod"] = described("pod")
    fake.containers["app"] = described("app", mode=f"container:{fake.containers['pod']['Id']}")
    found = inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path)
    assert [one.owner for one in found.applications] == ["pod", ""]


def test_an_engine_that_refuses_is_named(fake: FakeEngine, tmp_path: Path) -> None:
    """The error says what to do, also where nothing listens."""
    fake.fault = Status(403, "no")
    with pytest.raises(CannotTell, match="socket proxy"):
        inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path)
    with pytest.raises(CannotTell, match="start the Docker Engine"):
        inspect_machine(DockerEngine(f"unix://{tmp_path}/none.sock"), tmp_path)


def test_mapped_folders_and_disks_are_no_character_devices(fake: FakeEngine, tmp_path: Path) -> None:
    """Docker maps all devices of a folder. One that is missing now may be a character device."""
    (tmp_path / "bus" / "usb").mkdir(parents=True)
    (tmp_path / "ttyACM0").symlink_to("/dev/null")
    fake.containers["app"] = described("app", devices=["/dev/bus/usb", "/dev/ttyACM0", "/dev/ttyACM1"])
    assert inspect_machine(DockerEngine(fake.url, LIMIT_S), tmp_path).other_devices == {"/dev/bus/usb"}


def test_each_serial_port_is_listed_once_by_its_stable_name(tmp_path: Path) -> None:
    """Ordinary files and other devices are not serial ports."""
    by_id = tmp_path / "serial" / "by-id"
    by_id.mkdir(parents=True)
    (tmp_path / "ttyACM0").symlink_to("/dev/null")
    (by_id / "usb-Holybro_Pixhawk6X").symlink_to("../../ttyACM0")
    (tmp_path / "ttyUSB0").write_text("")
    (tmp_path / "ttyUSB1").symlink_to("gone")
    (port,) = serial_ports(tmp_path, ["/dev/ttyACM0", "/dev/ttyS0"])
    assert port.path == "/dev/serial/by-id/usb-Holybro_Pixhawk6X"
    assert port.group_id == Path("/dev/null").stat().st_gid


def test_a_port_that_an_endpoint_names_is_listed(tmp_path: Path) -> None:
    """Not each of /dev/ttyS*: most of them lead nowhere."""
    (tmp_path / "ttyS0").symlink_to("/dev/null")
    (tmp_path / "ttyS1").symlink_to("/dev/zero")
    assert [port.path for port in serial_ports(tmp_path, ["/dev/ttyS0", "/opt/ttyS1"])] == ["/dev/ttyS0"]
