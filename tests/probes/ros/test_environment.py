"""Reading the ROS environment: of processes where PHM may, else of the container's configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.settings import RosSettings
from phm.facts import CannotTell, ProcessFact
from phm.facts.ros_environment import MAX_VALUE
from phm.probes.docker_facts import container_fact
from phm.probes.ros.environment import (
    FRESH_S,
    RosEnvironments,
    of_container,
    of_host_processes,
    of_phm,
    read_environ,
)

ID = "0123456789abcdef" * 4
OTHER = "fedcba9876543210" * 4


def process(proc: Path, pid: int, environ: dict[str, str], container: str = "", *, ros: bool = True) -> None:
    """A process in a copy of /proc."""
    folder = proc / str(pid)
    (folder / "ns").mkdir(parents=True)
    (folder / "environ").write_bytes(b"".join(f"{name}={value}\0".encode() for name, value in environ.items()))
    (folder / "cgroup").write_text(f"0::/system.slice/docker-{container}.scope\n" if container else "0::/init.scope\n")
    (folder / "maps").write_text("7f00 r-xp /opt/ros/jazzy/lib/librcl.so\n" if ros else "")
    (folder / "cmdline").write_bytes(b"/ws/driver\0--ros-args\0")
    (folder / "ns" / "net").symlink_to("net:[1]")


def inspected(*environ: str, **host: Any) -> dict[str, Any]:
    return {
        "Id": ID,
        "Name": "/ros_app",
        "State": {"Status": "running", "Pid": 40},
        "Config": {"Env": list(environ)},
        "HostConfig": host,
    }


def test_of_a_container_only_ros_variables_are_kept() -> None:
    """An environment may hold secrets."""
    fact = container_fact(inspected("PATH=/bin", "TOKEN=secret", "ROS_DOMAIN_ID=7", "broken"))
    assert fact.ros_variables == {"ROS_DOMAIN_ID": "7"}


def test_long_and_unprintable_values_are_cut() -> None:
    """Container configurations are foreign data."""
    fact = container_fact(inspected(f"ROS_STATIC_PEERS={'a' * 5000}", "ROS_DISTRO=ja\nz\x1bzy"))
    assert len(fact.ros_variables["ROS_STATIC_PEERS"]) == MAX_VALUE
    assert fact.ros_variables["ROS_DISTRO"] == "ja?z?zy"


def test_a_process_that_may_be_read_is_better_than_the_configuration(tmp_path: Path) -> None:
    """What an entrypoint script exported is visible there; the children of the first process run the nodes."""
    process(tmp_path, 40, {"ROS_DOMAIN_ID": "1"}, ID)
    process(tmp_path, 41, {"ROS_DOMAIN_ID": "2"}, ID)
    fact = container_fact(inspected("ROS_DOMAIN_ID=0"))
    found = of_container(fact, [ProcessFact(40), ProcessFact(41, parent=40)], tmp_path)
    assert found.exact and found.variables == {"ROS_DOMAIN_ID": "2"}
    assert of_container(fact, [], tmp_path).variables == {"ROS_DOMAIN_ID": "1"}


def test_a_process_of_another_container_is_not_read(tmp_path: Path) -> None:
    """In PHM's own PID namespace the engine's process ids belong to others."""
    process(tmp_path, 40, {"ROS_DOMAIN_ID": "1"}, OTHER)
    found = of_container(container_fact(inspected("ROS_DOMAIN_ID=0")), [], tmp_path)
    assert not found.exact and found.variables == {"ROS_DOMAIN_ID": "0"}


def test_an_environment_that_may_not_be_read_is_empty(tmp_path: Path) -> None:
    """As for a process that has ended."""
    assert read_environ(99, tmp_path) == {}


@pytest.mark.parametrize(
    ("host", "network", "ipc"),
    [
        ({"NetworkMode": "phm_net", "IpcMode": "private"}, ID, ID),
        ({"NetworkMode": "host", "IpcMode": "host"}, "host", "host"),
        ({"NetworkMode": f"container:{OTHER}", "IpcMode": f"container:{OTHER}"}, OTHER, OTHER),
    ],
)
def test_namespaces_are_named_by_their_owner(host: dict[str, str], network: str, ipc: str) -> None:
    """So that two containers can be compared."""
    found = of_container(container_fact(inspected(**host)), [], Path("/nowhere"))
    assert (found.network_namespace, found.ipc_namespace) == (network, ipc)


def test_phm_has_the_environment_of_its_ros_child() -> None:
    """With its defaults, and the domain of phm.yaml."""
    found = of_phm(RosSettings(domain=7), {"ROS_DOMAIN_ID": "1", "ROS_STATIC_PEERS": "10.0.0.1"}, None)
    assert found.variables["ROS_DOMAIN_ID"] == "7"
    assert found.variables["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"
    assert found.network_namespace == "host"


def test_ros_processes_on_the_host_are_listed_once_for_each_environment(tmp_path: Path) -> None:
    """For an application without containers: those of containers and without ROS are left out."""
    (tmp_path / "self" / "ns").mkdir(parents=True)
    (tmp_path / "self" / "ns" / "net").symlink_to("net:[1]")
    process(tmp_path, 900001, {"ROS_DOMAIN_ID": "3"})
    process(tmp_path, 900002, {"ROS_DOMAIN_ID": "3"})
    process(tmp_path, 900003, {"ROS_DOMAIN_ID": "4"}, ros=False)
    process(tmp_path, 900004, {"ROS_DOMAIN_ID": "5"}, ID)
    (found,) = of_host_processes(tmp_path)
    assert (found.name, found.variables, found.network_namespace) == (
        "/ws/driver --ros-args",
        {"ROS_DOMAIN_ID": "3"},
        "host",
    )


class Engine(testing.FakeDocker):
    """Counts the questions."""

    asked = 0

    def container(self, name: str) -> Any:
        self.asked += 1
        return super().container(name)


def test_the_comparison_is_kept_for_some_seconds() -> None:
    """A check asks four times a second; an engine that hangs is not asked each time either."""
    clock, docker = testing.FakeClock(), Engine(testing.container("ros_app", ros_variables={"ROS_DOMAIN_ID": "7"}))
    probe = RosEnvironments(docker, RosSettings(), clock, {}, Path("/nowhere"))
    assert [one.variable for one in probe.differences("ros_app")] == ["ROS_DOMAIN_ID"]
    asked = docker.asked
    probe.differences("ros_app")
    assert docker.asked == asked
    docker.fail("the engine is silent")
    clock.advance(FRESH_S)
    for _ in range(2):
        with pytest.raises(CannotTell, match="silent"):
            probe.differences("ros_app")
    assert docker.asked == asked + 1


def test_of_a_container_that_does_not_exist_nothing_can_be_said() -> None:
    """It is the check `container` that reports it."""
    probe = RosEnvironments(testing.FakeDocker(), RosSettings(), testing.FakeClock(), {}, Path("/nowhere"))
    with pytest.raises(CannotTell, match="does not exist"):
        probe.differences("ros_app")
