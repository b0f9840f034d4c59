"""`phm init`: a folder for this machine, with and without questions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner, Result

from phm.cli import group
from phm.cli.init import SOCKET, _engine
from phm.setup import discovery, ros_nodes
from phm.setup.machine import SerialPort
from tests.fakes.engine import FakeEngine
from tests.fakes.engine_faults import Status
from tests.setup.machines import described

FILES = ["agent.env", "compose.yaml", "fastdds.xml", "logs", "phm.yaml"]


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeEngine]:
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["ros_app"] = described("ros_app", env={"ROS_DOMAIN_ID": "7"})
        yield fake


def init(fake: FakeEngine, folder: Path, *options: str, typed: str = "", nodes: bool = False) -> Result:
    more = [] if nodes else ["--no-ros"]
    return CliRunner().invoke(group, ["init", str(folder), "--socket", fake.url, *more, *options], input=typed)


def test_yes_asks_nothing_and_the_result_is_valid(fake: FakeEngine, tmp_path: Path) -> None:
    """All files are there, `phm validate` accepts the configuration, and the next commands are printed."""
    done = init(fake, tmp_path / "phm", "--yes")
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "phm").iterdir()) == FILES
    assert "docker compose up -d" in done.output and "PHM reports faults and restarts nothing" in done.output
    checked = CliRunner().invoke(group, ["validate", str(tmp_path / "phm" / "phm.yaml")])
    assert checked.exit_code == 0 and "1 container," in checked.output
    assert "ROS_DOMAIN_ID=7" in (tmp_path / "phm" / "agent.env").read_text()


def test_phm_is_in_the_group_of_the_port_of_its_endpoint(
    fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of one that `phm init` lists for no other reason, such as /dev/ttyS0."""
    monkeypatch.setattr(discovery, "serial_ports", lambda dev, named=(): (SerialPort(path, 20) for path in named))
    assert init(fake, tmp_path / "phm", "--yes", "--mavlink", "/dev/ttyS0").exit_code == 0
    made = yaml.safe_load((tmp_path / "phm" / "compose.yaml").read_text())
    assert "20" in made["services"]["phm"]["group_add"]


def test_nothing_is_written_where_the_log_folder_cannot_be_made(fake: FakeEngine, tmp_path: Path) -> None:
    """So the same command with another folder succeeds, without --force."""
    (tmp_path / "file").write_text("")
    folder = tmp_path / "phm"
    done = init(fake, folder, "--yes", "--logs", str(tmp_path / "file" / "logs"))
    assert (done.exit_code, folder.exists()) == (1, False), done.output
    assert init(fake, folder, "--yes", "--logs", str(tmp_path / "logs")).exit_code == 0
    assert (tmp_path / "logs").is_dir()


def test_a_log_folder_that_phm_may_not_write_to_is_named(fake: FakeEngine, tmp_path: Path) -> None:
    """Docker makes a deleted one again as root. A folder that others use keeps its owner."""
    (tmp_path / "phm" / "logs").mkdir(parents=True)
    (tmp_path / "var").mkdir()
    for path in (tmp_path / "phm" / "logs", tmp_path / "var"):
        path.chmod(0o755)
    done = init(fake, tmp_path / "phm", "--yes")
    assert f"  sudo chown -R 10001:10001 {tmp_path}/phm/logs\n" in done.output
    done = init(fake, tmp_path / "phm", "--yes", "--force", "--logs", str(tmp_path / "var"))
    assert f"  make {tmp_path}/var writable for user 10001, or name another" in done.output
    assert "chown" not in done.output


def test_the_next_command_works_for_any_name_of_the_folder(fake: FakeEngine, tmp_path: Path) -> None:
    """One with a space is quoted."""
    done = init(fake, tmp_path / "my agent", "--yes")
    assert f"  cd '{tmp_path}/my agent' && docker compose up -d\n" in done.output


def test_options_answer_the_questions(fake: FakeEngine, tmp_path: Path) -> None:
    """`phm init` with options asks nothing and writes what they say."""
    options = ["--id", "9", "--container", "ros_app", "--recover", "--mavlink", "none", "--image", "phm:2"]
    done = init(fake, tmp_path, *options)
    assert done.exit_code == 0, done.output
    written = yaml.safe_load((tmp_path / "phm.yaml").read_text())
    assert written["containers"][0]["recover"] is True and "9" in written["agent"]["name"]
    assert "PHM_IMAGE:-phm:2" in (tmp_path / "compose.yaml").read_text()


@pytest.mark.parametrize("owned", [True, False], ids=["root", "another user"])
def test_deliveries_need_an_option(
    fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owned: bool
) -> None:
    """It makes the folder of PHM's user and a key, which stays when the files are written again."""
    owners: dict[str, tuple[int, ...]] = {}

    def own(path: Path, *ids: int, follow_symlinks: bool = True) -> None:
        if not owned:
            raise PermissionError(1, "Operation not permitted")
        owners[str(path.relative_to(tmp_path))] = ids

    monkeypatch.setattr("os.chown", own)
    done = init(fake, tmp_path, "--yes", "--logs", str(tmp_path), "--deliver", "10.0.0.7:9465")
    assert done.exit_code == 0, done.output
    key, configuration = tmp_path / "delivered" / "delivery.key", tmp_path / "delivered" / "phm.yaml"
    assert (key.stat().st_mode & 0o777, len(key.read_text().strip())) == (0o600, 64)
    assert yaml.safe_load(configuration.read_text())["delivery"]["listen"] == "0.0.0.0:9465"
    assert not (tmp_path / "phm.yaml").exists()
    expected = dict.fromkeys(("delivered", "delivered/delivery.key", "delivered/phm.yaml"), (10001, 10001))
    found = {name: ids for name, ids in owners.items() if name.startswith("delivered")}
    assert found == (expected if owned else {})
    mine = (tmp_path.stat().st_uid, tmp_path.stat().st_gid)
    assert {ids for name, ids in owners.items() if name not in expected} <= {mine}
    assert (f"sudo chown -R 10001:10001 {tmp_path / 'delivered'}" in done.output) is not owned
    before = key.read_text()
    again = init(fake, tmp_path, "--yes", "--force", "--logs", str(tmp_path), "--deliver", "10.0.0.7:9465")
    assert again.exit_code == 0, again.output
    assert key.read_text() == before


def test_deliveries_are_taken_at_an_address_of_this_machine(fake: FakeEngine, tmp_path: Path) -> None:
    """Docker publishes no name."""
    done = init(fake, tmp_path / "phm", "--yes", "--deliver", "agent.local:9465")
    assert done.exit_code == 2 and "10.0.0.7:9465" in done.output and not (tmp_path / "phm").exists()


def test_each_container_is_compared_with_what_was_written(fake: FakeEngine, tmp_path: Path) -> None:
    """A container with other ROS variables is named with the line to change; one that fits, or runs no ROS, is not."""
    localhost = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DISTRO": "jazzy"}
    fake.containers["local"] = described("local", env=localhost)
    fake.containers["camera"] = described("camera", env={"ROS_DOMAIN_ID": "8"})
    fake.containers["database"] = described("database")
    done = init(fake, tmp_path, "--yes", "--mavlink", "none")
    assert done.exit_code == 0, done.output
    (line,) = [line for line in done.output.splitlines() if "receive" in line]
    assert line.startswith(
        "PHM does not receive the ROS nodes of camera: ROS_DOMAIN_ID is 8 in camera and 7 in PHM: set "
    )


def test_a_middleware_that_the_image_may_lack_is_named(fake: FakeEngine, tmp_path: Path) -> None:
    """Otherwise only a comment in agent.env would say so."""
    fake.containers["ros_app"] = described("ros_app", env={"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    done = init(fake, tmp_path, "--yes", "--mavlink", "none")
    assert done.exit_code == 0, done.output
    assert "PHM's image must have rmw_cyclonedds_cpp: build it from a ROS base image" in done.output


def test_without_a_terminal_the_missing_options_are_named(fake: FakeEngine, tmp_path: Path) -> None:
    """Nothing is written, and nothing waits for input."""
    done = init(fake, tmp_path / "phm", "--id", "3")
    assert done.exit_code == 1
    assert "--container, --recover or --no-recover, --mavlink" in done.stderr and "--yes" in done.stderr
    assert not (tmp_path / "phm").exists()


def test_a_terminal_asks_until_the_answer_is_possible(
    fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Enter takes the default."""
    monkeypatch.setattr("phm.cli.init.on_terminal", lambda: True)
    done = init(fake, tmp_path, typed="51\n5\nros_ap\nros_app\ny\n\nros_app\n")
    assert done.exit_code == 0, done.output
    assert "SiK radios" in done.stderr and "there is no container ros_ap;" in done.stderr
    (entry,) = yaml.safe_load((tmp_path / "phm.yaml").read_text())["containers"]
    assert entry["recover"] and entry["flight_critical"]
    assert "host.docker.internal:14550" in (tmp_path / "phm.yaml").read_text()


def test_files_that_exist_are_kept(fake: FakeEngine, tmp_path: Path) -> None:
    """`--force` replaces them."""
    (tmp_path / "phm.yaml").write_text("mine")
    done = init(fake, tmp_path, "--yes")
    assert done.exit_code == 1 and "--force replaces" in done.stderr
    assert (tmp_path / "phm.yaml").read_text() == "mine"
    assert init(fake, tmp_path, "--yes", "--force").exit_code == 0
    assert (tmp_path / "phm.yaml").read_text() != "mine"


def test_without_an_engine_the_remedy_is_printed(tmp_path: Path) -> None:
    """The exit code is 1, and the message says what to start."""
    done = CliRunner().invoke(group, ["init", str(tmp_path), "--yes", "--socket", f"unix://{tmp_path}/none"])
    assert done.exit_code == 1 and "start the Docker Engine" in done.stderr
    assert "or name it with --socket" in done.stderr


def test_the_engine_is_that_of_docker(fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As for a rootless engine. Not one that PHM's container cannot reach in the same way."""
    monkeypatch.setenv("DOCKER_HOST", fake.url)
    done = CliRunner().invoke(group, ["init", str(tmp_path / "phm"), "--yes", "--no-ros"])
    assert done.exit_code == 0, done.output
    assert f"{fake.path}:/var/run/docker.sock" in (tmp_path / "phm" / "compose.yaml").read_text()
    for unreachable in ("ssh://pi@drone1", "tcp://127.0.0.1:2375", "tcp://localhost:2375", "tcp://[::1]:2375"):
        monkeypatch.setenv("DOCKER_HOST", unreachable)
        assert _engine() == SOCKET


def test_a_user_who_may_not_open_the_socket_learns_what_to_do(
    fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 1, and to use sudo, which finds only a path: pipx installs into ~/.local/bin."""
    monkeypatch.setattr("phm.cli.init.os.access", lambda *_: False)
    monkeypatch.setattr("sys.argv", ["/home/my pi/.local/bin/phm", "init"])
    fake.fault = Status(403, "no")
    done = init(fake, tmp_path / "phm", "--yes")
    assert done.exit_code == 1 and "run `sudo '/home/my pi/.local/bin/phm' init`, or" in done.stderr


def test_nodes_of_the_graph_are_written(fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are looked for with the application's ROS variables."""
    seen = []

    def nodes(environment: dict[str, str]) -> tuple[str, ...]:
        seen.append(dict(environment))
        return ("/agent_1/planner",)

    monkeypatch.setattr(ros_nodes, "nodes", nodes)
    assert init(fake, tmp_path, "--yes", nodes=True).exit_code == 0
    assert seen == [{"ROS_DOMAIN_ID": "7"}]
    assert yaml.safe_load((tmp_path / "phm.yaml").read_text())["ros"]["nodes"] == [{"name": "/agent_1/planner"}]


def test_a_graph_that_cannot_be_read_is_said(fake: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`phm init` continues without nodes."""

    def nodes(environment: dict[str, str]) -> tuple[str, ...]:
        raise ros_nodes.NoGraph("rclpy is not installed here")

    monkeypatch.setattr(ros_nodes, "nodes", nodes)
    done = init(fake, tmp_path, "--yes", nodes=True)
    assert done.exit_code == 0 and "ROS nodes are not listed: rclpy is not installed here" in done.output


def test_a_machine_without_an_application_gets_a_folder_too(fake: FakeEngine, tmp_path: Path) -> None:
    """Its configuration has no containers, and the output says what to do first."""
    fake.containers.clear()
    done = init(fake, tmp_path, "--yes")
    assert done.exit_code == 0 and "start yours first" in done.output
    assert yaml.safe_load((tmp_path / "phm.yaml").read_text())["containers"] == []
