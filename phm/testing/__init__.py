"""Fakes for tests of checks, ours or anyone's: a clock that the test moves, and probes that hold facts.

Part of the public interface: authors of checks test them with these::

    from phm import testing

    def test_a_stopped_container_is_an_error():
        world = testing.world(docker=testing.FakeDocker(testing.container("ros_app", status="exited")))
        assert my_check.run(world).level is api.Level.ERROR

Each fake answers with the facts that it was given, until `fail` makes it raise `CannotTell`.
"""

from __future__ import annotations

from typing import Any

from phm.core.clock import Clock
from phm.core.settings import Settings
from phm.facts import (
    DeviceProbe,
    DockerProbe,
    EnvironmentProbe,
    FileProbe,
    HostProbe,
    LinkProbe,
    LogProbe,
    MessageProbe,
    PressureProbe,
    ProgramProbe,
    RosProbe,
    SelfProbe,
    SerialProbe,
    SocketProbe,
    SwarmProbe,
    World,
)
from phm.testing.clock import FakeClock
from phm.testing.containers import (
    FakeDocker,
    FakeEnvironment,
    FakeFiles,
    FakeLogs,
    FakePressure,
    FakePrograms,
    container,
)
from phm.testing.links import FakeLinks, FakeMessages, FakeRos, FakeSwarm
from phm.testing.machine import FakeDevices, FakeHost, FakeSelf, FakeSerial, FakeSockets

__all__ = [
    "FakeClock",
    "FakeDevices",
    "FakeDocker",
    "FakeEnvironment",
    "FakeFiles",
    "FakeHost",
    "FakeLinks",
    "FakeLogs",
    "FakeMessages",
    "FakePressure",
    "FakePrograms",
    "FakeRos",
    "FakeSelf",
    "FakeSerial",
    "FakeSockets",
    "FakeSwarm",
    "container",
    "settings",
    "world",
]


def world(
    *,
    clock: Clock | None = None,
    docker: DockerProbe | None = None,
    files: FileProbe | None = None,
    devices: DeviceProbe | None = None,
    host: HostProbe | None = None,
    ros: RosProbe | None = None,
    links: LinkProbe | None = None,
    swarm: SwarmProbe | None = None,
    daemon: SelfProbe | None = None,
    pressure: PressureProbe | None = None,
    environment: EnvironmentProbe | None = None,
    sockets: SocketProbe | None = None,
    messages: MessageProbe | None = None,
    serial: SerialProbe | None = None,
    programs: ProgramProbe | None = None,
    logs: LogProbe | None = None,
) -> World:
    """A world of fakes, with those parts replaced that are given."""
    return World(
        clock=clock or FakeClock(),
        docker=docker or FakeDocker(),
        files=files or FakeFiles(),
        devices=devices or FakeDevices(),
        host=host or FakeHost(),
        ros=ros or FakeRos(),
        links=links or FakeLinks(),
        swarm=swarm or FakeSwarm(),
        daemon=daemon or FakeSelf(),
        pressure=pressure or FakePressure(),
        environment=environment or FakeEnvironment(),
        sockets=sockets or FakeSockets(),
        messages=messages or FakeMessages(),
        serial=serial or FakeSerial(),
        programs=programs or FakePrograms(),
        logs=logs or FakeLogs(),
    )


def settings(**yaml_like: Any) -> Settings:
    """Settings as if these top-level keys were in `phm.yaml`; raises pydantic's ValidationError."""
    return Settings.model_validate(yaml_like)
