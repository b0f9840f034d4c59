"""The questions of `phm init`: which are asked, their defaults, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

from phm.setup.answers import Answers
from phm.setup.machine import Machine
from phm.setup.questions import Interview, InvalidAnswer
from tests.setup.machines import application, machine

APP, CAMERA = application("app"), application("camera", mode="host")


def interview(found: Machine | None = None, **given: Any) -> Interview:
    made = Interview(found or machine(APP), given)
    made.check()
    return made


def defaults(asked: Interview) -> tuple[list[str], Answers]:
    """The keys of the questions, and the answers when each default is taken."""
    keys = []
    while question := asked.next():
        keys.append(question.key)
        asked.answer(question, question.default)
    return keys, asked.answers()


def test_at_most_five_questions_are_asked() -> None:
    """The fifth only where PHM may restart containers and reports by MAVLink."""
    assert defaults(interview())[0] == ["id", "containers", "recover", "mavlink"]
    assert defaults(interview(recover=True))[0] == ["id", "containers", "mavlink", "flight_critical"]
    assert defaults(interview(recover=True, mavlink="none"))[0] == ["id", "containers"]
    assert defaults(interview(id=3, containers=["app"], recover=False, mavlink="none"))[0] == []


def test_defaults_watch_everything_and_restart_nothing() -> None:
    """The ground station of this machine is reached through the bridge's gateway."""
    stopped = application("old", status="exited")
    answers = defaults(interview(machine(APP, stopped), id=7))[1]
    assert (answers.name, answers.id, answers.containers, answers.recover) == ("agent_7", 7, ("app",), False)
    assert (answers.network, answers.mavlink) == ("bridge", "udpout:host.docker.internal:14550")
    assert (answers.flight_critical, answers.logs) == ((), "./logs")


def test_one_container_on_the_hosts_network_decides() -> None:
    """PHM then uses the host's network as well, unless an option says otherwise."""
    answers = defaults(interview(machine(APP, CAMERA)))[1]
    assert (answers.network, answers.mavlink) == ("host", "udpout:127.0.0.1:14550")
    assert defaults(interview(machine(APP, CAMERA), containers=["app"]))[1].network == "bridge"
    assert defaults(interview(machine(APP, CAMERA), network="bridge"))[1].network == "bridge"


def test_without_containers_ros_runs_on_the_host() -> None:
    """There is nothing to restart, either."""
    keys, answers = defaults(interview(machine()))
    assert (keys, answers.network) == (["id", "containers", "mavlink"], "host")


def test_containers_that_are_not_watched_do_not_set_the_network() -> None:
    """ROS runs on the host, and a container on a bridge that runs, too, has nothing to do with it."""
    answers = defaults(interview(machine(APP), containers=["none"]))[1]
    assert (answers.containers, answers.network, answers.mavlink) == ((), "host", "udpout:127.0.0.1:14550")


def test_a_container_brings_the_owner_of_its_network() -> None:
    """Without it, PHM would not be on that network."""
    found = machine(application("app", mode="container:1", owner="pod"), application("pod", mode="host"))
    answers = defaults(interview(found, containers=["app"]))[1]
    assert (answers.containers, answers.network) == (("pod", "app"), "host")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"id": 51}, "--id: 51 .*SiK"),
        ({"id": 0}, "1 to 250"),
        ({"name": "my agent"}, "--name: 'my agent'"),
        ({"containers": ["ap"]}, "--container: there is no container ap; running containers: app"),
        ({"mavlink": "udp:1"}, "--mavlink: .*udpout:HOST:PORT.*or none"),
        ({"mavlink": "udpout://10.0.0.5:14550"}, "--mavlink: .*write udpout:HOST:PORT, without //"),
        ({"mavlink": "/dev/ttyAMA0,115200"}, "--mavlink: .*the speed is the key 'baud'"),
        ({"containers": ["app"], "flight_critical": ["gone"]}, "--flight-critical: there is no container gone"),
        ({"flight_critical": ["app"], "recover": False}, "no meaning with --no-recover"),
        ({"containers": ["app"], "flight_critical": ["app"], "mavlink": "none"}, "needs --mavlink"),
    ],
)
def test_an_impossible_option_is_refused_with_what_is_possible(given: dict[str, Any], said: str) -> None:
    """The error names the option."""
    with pytest.raises(InvalidAnswer, match=said):
        interview(**given)


def test_open_questions_are_named_by_their_options() -> None:
    """What --yes would answer."""
    assert interview(id=1).open_flags() == ["--container", "--recover or --no-recover", "--mavlink"]


def test_a_log_folder_is_a_path_and_not_a_volume() -> None:
    """Compose takes a bare name for a volume."""
    assert defaults(interview(logs="log"))[1].logs == "./log"
    assert defaults(interview(logs="/var/log/agent"))[1].logs == "/var/log/agent"
