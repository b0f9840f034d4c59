"""A delivered configuration on the agent: what is refused changes nothing, and the file is the old or the new one."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from phm.commands.delivery_server import DeliveryServer
from phm.config.atomic_write import replace
from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.runtime.configuration import fixed_sections, read
from phm.runtime.daemon import Daemon
from phm.runtime.delivery import Delivery, open_server
from phm.runtime.reloader import ReloadOutcome
from phm.testing import settings
from phm.wire.delivery import DeliveryAnswer, version_of
from tests.fakes.until import until
from tests.runtime.running import ROOT

OLD, NEW = "agent: {id: 7, name: A07}\ninterval: 20s\n", "agent: {id: 7, name: A07}\ninterval: 30s\n"
WHO = "10.0.0.5"
ON_BOARD = {"PHM_SECRET": "swordfish"}


class Agent:
    """The file of an agent, and what its daemon would say."""

    def __init__(self, folder: Path, text: str = OLD) -> None:
        self.file = folder / "phm.yaml"
        self.file.write_text(text)
        self.armed = ArmedStatus(ArmedState.DISARMED, "the autopilot is disarmed")
        self.reloads: list[str] = []
        self.outcomes: list[ReloadOutcome] = []
        self.meanwhile: Callable[[], object] = lambda: None
        self.notes: list[str] = []
        found = read(str(self.file), ON_BOARD)
        self.delivery = Delivery(str(self.file), fixed_sections(found.settings), self._daemon, self._reload, ON_BOARD)

    def _daemon(self) -> Daemon:
        made = SimpleNamespace(
            components=SimpleNamespace(armed=SimpleNamespace(now=self._armed_now)),
            pipeline=SimpleNamespace(note=lambda kind, text: self.notes.append(text)),
        )
        return cast(Daemon, made)

    def _armed_now(self) -> ArmedStatus:
        present = self.armed
        self.meanwhile()
        return present

    def _reload(self) -> str:
        self.reloads.append(self.file.read_text())
        return (self.outcomes.pop(0) if self.outcomes else ReloadOutcome(True, ("interval",))).as_json()

    @property
    def backup(self) -> Path:
        return self.file.with_name("phm.yaml.bak")

    def deliver(self, text: str = NEW, base: str = OLD) -> DeliveryAnswer:
        return self.delivery.execute(text, version_of(base), WHO)

    def refused(self, text: str = NEW, base: str = OLD, kept: str = OLD) -> DeliveryAnswer:
        """The answer to what must change nothing."""
        answer = self.deliver(text, base)
        assert not answer.ok
        assert (self.file.read_text(), self.reloads) == (kept, [])
        assert sorted(each.name for each in self.file.parent.iterdir() if each.name.startswith(".")) == []
        assert any(WHO in note for note in self.notes)
        assert answer.present == version_of(kept)
        return answer


@pytest.fixture
def agent(tmp_path: Path) -> Agent:
    return Agent(tmp_path)


def test_a_delivered_configuration_is_written_and_reloaded(agent: Agent) -> None:
    """The previous one is kept, permissions stay, and the log says who sent it."""
    agent.file.chmod(0o640)
    answer = agent.deliver()
    assert (answer.ok, answer.text, answer.present) == (True, "configuration reloaded: interval", version_of(NEW))
    assert (agent.file.read_text(), agent.backup.read_text(), agent.reloads) == (NEW, OLD, [NEW])
    assert {each.stat().st_mode & 0o777 for each in (agent.file, agent.backup)} == {0o640}
    assert len(agent.notes) == 1 and WHO in agent.notes[0] and version_of(NEW)[:12] in agent.notes[0]


@pytest.mark.parametrize("state", [ArmedState.ARMED, ArmedState.UNKNOWN])
def test_nothing_is_changed_unless_the_vehicle_is_known_to_be_disarmed(agent: Agent, state: ArmedState) -> None:
    """Also when it is armed while the configuration is validated."""
    agent.armed = ArmedStatus(state, "the autopilot has been silent for 9 s")
    assert "silent for 9 s" in agent.refused().text
    agent.armed = ArmedStatus(ArmedState.DISARMED, "the autopilot is disarmed")
    agent.meanwhile = lambda: setattr(agent, "armed", ArmedStatus(state, "the autopilot was armed meanwhile"))
    assert "meanwhile" in agent.refused().text


def test_a_change_by_someone_else_is_not_overwritten(agent: Agent) -> None:
    """The answer says which version the agent has, so that an operator can decide to replace it."""
    other = OLD.replace("20s", "25s")
    agent.file.write_text(other)
    answer = agent.refused(kept=other)
    assert "another configuration" in answer.text and answer.present == version_of(other)
    assert agent.deliver(base=other).ok


def test_a_change_while_it_is_validated_is_not_overwritten(agent: Agent) -> None:
    """An editor on the agent saved just now."""
    other, calls = OLD.replace("20s", "25s"), iter(range(9))
    original = agent.delivery._check_content

    def check(text: str) -> None:
        original(text)
        if next(calls) == 0:
            agent.file.write_text(other)

    agent.delivery._check_content = check  # type: ignore[method-assign]
    assert "meanwhile" in agent.refused(kept=other).text


def test_an_arming_while_it_is_written_changes_nothing(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """The vehicle is armed while the copy of the previous file is written: a slow disk takes a while."""

    def slow(path: Path, data: bytes, like: Path | None = None) -> None:
        replace(path, data, like)
        agent.armed = ArmedStatus(ArmedState.ARMED, "the autopilot was armed meanwhile")

    monkeypatch.setattr("phm.runtime.delivery.replace", slow)
    assert "meanwhile" in agent.refused().text


def test_an_invalid_configuration_is_refused_with_the_messages_of_validate(agent: Agent) -> None:
    """With lines and keys, so that the page shows them at the field."""
    answer = agent.refused("agent: {id: 7, name: A07}\ninterval: soon\nhost: 3\n")
    assert [(each["line"], each["key"]) for each in answer.problems] == [(2, "interval"), (3, "host")]
    assert answer.problems[0]["text"].startswith(f"{agent.file}:2: interval: ")
    assert "2 problems" in answer.text


def test_the_agents_own_variables_count(tmp_path: Path) -> None:
    """They are the agent's: a configuration with an unknown one is invalid there."""
    agent = Agent(tmp_path)
    known, unknown = (f"{NEW}notify: {{urls: ['json://host/${{{name}}}']}}\n" for name in ("PHM_SECRET", "PHM_OTHER"))
    assert [each["key"] for each in agent.refused(unknown).problems] == ["notify.urls[0]"]
    assert agent.deliver(known).ok
    assert "swordfish" not in agent.file.read_text()


def test_a_value_of_the_agents_variables_is_not_in_the_answer(tmp_path: Path) -> None:
    """The answer is not encrypted. Messages without a value stay."""
    agent = Agent(tmp_path)
    answer = agent.refused(f"{NEW}notify: {{urls: ['x: ${{PHM_SECRET}}']}}\nhost: 3\n")
    assert [(each["line"], each["key"]) for each in answer.problems] == [(3, "notify.urls[0]"), (4, "host")]
    assert "swordf" not in "".join((json.dumps(answer.problems), answer.text, *agent.notes))
    assert "phm validate" in answer.problems[0]["text"] and "section with keys" in answer.problems[1]["message"]


@pytest.mark.parametrize(
    "line",
    [
        "agent: {id: 8, name: A07}",
        "agent: {id: 7, name: A07}\nmavlink: {commands: [restart]}",
        "agent: {id: 7, name: A07}\ndelivery: {listen: '127.0.0.1:1', key: /k}",
        "agent: {id: 7, name: A07}\nstate_dir: /tmp/elsewhere",
    ],
)
def test_settings_that_a_reload_cannot_apply_are_refused(agent: Agent, line: str) -> None:
    """It would be unknown whether PHM starts with it; and an operator cannot lock himself out."""
    answer = agent.refused(f"{line}\n")
    assert "cannot be changed by a delivery" in answer.text
    assert len(answer.problems) == 1


def test_the_same_configuration_is_refused(agent: Agent) -> None:
    """Nothing is written or reloaded."""
    assert "already" in agent.refused(OLD).text


def test_an_empty_text_asks_for_the_version(agent: Agent) -> None:
    """It changes nothing and leaves no line in the log."""
    answer = agent.deliver("")
    assert (answer.ok, answer.present, agent.reloads, agent.notes) == (True, version_of(OLD), [], [])


@pytest.mark.parametrize("failure", [errno.EROFS, errno.EBUSY])
def test_a_read_only_mount_is_refused_with_the_lines_to_change(
    agent: Agent, monkeypatch: pytest.MonkeyPatch, failure: int
) -> None:
    """As in the shipped Compose files: one mounts the folder read-only, the other the file alone."""

    def fail(*_arguments: object, **_options: object) -> None:
        raise OSError(failure, os.strerror(failure))

    monkeypatch.setattr("phm.runtime.delivery.replace", fail)
    text = agent.refused().text
    assert f"{agent.file} cannot be replaced: {os.strerror(failure)}" in text
    assert "`-f docker/compose.deliver.yaml`" in text and "`- FOLDER:/etc/phm-delivered` under volumes" in text
    assert f"`PHM_CONFIG: /etc/phm-delivered/{agent.file.name}` under environment" in text


def test_the_previous_file_returns_if_the_reload_fails(agent: Agent) -> None:
    """And PHM reloads once more, because the first reload may have been late instead of refused."""
    agent.outcomes = [ReloadOutcome(False, why="an action is in progress (restart of app)")]
    answer = agent.deliver()
    assert not answer.ok and "previous configuration is back" in answer.text and "restart of app" in answer.text
    assert (agent.file.read_text(), agent.reloads) == (OLD, [NEW, OLD])
    assert answer.present == version_of(OLD)
    assert any("is back" in note for note in agent.notes)


def test_the_previous_file_returns_if_phm_fails(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a reload raises, the file is the one that PHM runs with."""

    def fail() -> str:
        raise OSError("a defect")

    monkeypatch.setattr(agent.delivery, "_reload", fail)
    answer = agent.deliver()
    assert not answer.ok and "previous file is back" in answer.text and "a defect" not in answer.text
    assert agent.file.read_text() == OLD


def test_a_second_reload_that_fails_is_not_a_return(agent: Agent) -> None:
    """The first one may have been applied late: then PHM runs with another configuration than that of its file, and the answer says so."""
    late, busy = "PHM did not answer within 30 s", "an action is in progress"
    agent.outcomes = [ReloadOutcome(False, why=late), ReloadOutcome(False, why=busy)]
    answer = agent.deliver()
    assert not answer.ok and "configuration is back" not in answer.text
    assert late in answer.text and busy in answer.text and "phm reload" in answer.text
    assert (agent.file.read_text(), agent.notes[-1]) == (OLD, answer.text)


def test_a_link_stays_a_link(agent: Agent, tmp_path: Path) -> None:
    """The file that it leads to is replaced."""
    real = tmp_path / "real.yaml"
    agent.file.rename(real)
    agent.file.symlink_to(real)
    assert agent.deliver().ok
    assert agent.file.is_symlink() and real.read_text() == NEW


# ---------------------------------------------------------------- file systems


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Callable[..., None]]:
    """Mounts; all of it is unmounted at the end."""
    assert os.geteuid() == 0, "these tests mount their own file system: run them as root"
    places: list[str] = []

    def mount(*words: str) -> None:
        subprocess.run(["mount", *words], check=True)
        if "remount" not in words[1]:
            places.append(words[-1])

    yield mount
    for place in reversed(places):
        subprocess.run(["umount", place], check=True)


def test_a_read_only_folder_is_named_with_a_remedy(tmp_path: Path, mounted: Callable[..., None]) -> None:
    """As /etc/phm is in a container."""
    mounted("-t", "tmpfs", "tmpfs", str(tmp_path))
    agent = Agent(tmp_path)
    mounted("-o", "remount,ro", str(tmp_path))
    words = agent.refused().text
    assert "Read-only" in words and "compose.deliver.yaml" in words and "phm reload" in words


def test_a_file_that_is_a_mount_is_named_with_a_remedy(tmp_path: Path, mounted: Callable[..., None]) -> None:
    """Docker mounts single files, which no program can replace."""
    agent, source = Agent(tmp_path), tmp_path / "on-the-host.yaml"
    source.write_text(OLD)
    mounted("--bind", str(source), str(agent.file))
    words = agent.refused().text
    assert "- FOLDER:/etc/phm-delivered" in words and source.read_text() == OLD


def test_a_full_disk_leaves_the_old_file(tmp_path: Path, mounted: Callable[..., None]) -> None:
    """And no part of the new one."""
    mounted("-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path))
    agent = Agent(tmp_path)
    assert "space" in agent.refused(NEW + "#" * 200_000).text


def test_a_disk_that_is_full_meanwhile_lets_the_old_file_return(tmp_path: Path, mounted: Callable[..., None]) -> None:
    """Its copy takes its name, which needs no space."""
    mounted("-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path))
    agent = Agent(tmp_path)
    agent.outcomes = [ReloadOutcome(False, why="an action is in progress"), ReloadOutcome(True)]
    reload = agent._reload

    def fill() -> str:
        with contextlib.suppress(OSError):
            (tmp_path / "full").write_bytes(b"x" * 200_000)
        return reload()

    agent.delivery._reload = fill
    answer = agent.deliver()
    assert not answer.ok and "configuration is back" in answer.text
    assert (agent.file.read_text(), agent.reloads) == (OLD, [NEW, OLD])


KILLED = """
import sys
from pathlib import Path
from phm.config.atomic_write import replace
path, texts = Path(sys.argv[1]), [b"a" * 200_000, b"b" * 200_000]
while True:
    for text in texts:
        replace(path, text)
        print(flush=True)
"""


@pytest.mark.parametrize("after", [1, 2, 5])
def test_a_writer_that_is_killed_leaves_a_complete_file(tmp_path: Path, after: int) -> None:
    """The old or the new one, whenever it is killed."""
    file = tmp_path / "phm.yaml"
    file.write_bytes(b"a" * 200_000)
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(file)], stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert process.stdout is not None
    for _ in range(after):
        process.stdout.readline()
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert file.read_bytes() in (b"a" * 200_000, b"b" * 200_000)


DELIVERING = """
import sys
from pathlib import Path
from tests.runtime.test_delivery import NEW, OLD, Agent
agent = Agent(Path(sys.argv[1]))
while True:
    for text, base in ((NEW, OLD), (OLD, NEW)):
        answer = agent.deliver(text, base)
        assert answer.ok, answer
        print(flush=True)
"""


@pytest.mark.parametrize("after", [1, 4])
def test_an_agent_that_is_killed_during_a_delivery_starts_with_a_valid_file(tmp_path: Path, after: int) -> None:
    """Also its backup is complete, and the next delivery works."""
    process = subprocess.Popen(
        [sys.executable, "-c", DELIVERING, str(tmp_path)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks")))},
    )
    assert process.stdout is not None
    for _ in range(after):
        assert process.stdout.readline() == b"\n"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    file = tmp_path / "phm.yaml"
    present = file.read_text()
    assert present in (OLD, NEW) and file.with_name("phm.yaml.bak").read_text() in (OLD, NEW)
    read(str(file), ON_BOARD)
    other = OLD if present == NEW else NEW
    assert Agent(tmp_path, present).deliver(other, present).ok
    assert file.read_text() == other


def test_a_file_is_replaced_in_one_step(tmp_path: Path) -> None:
    """A reader that opens it at any moment sees one of the two, never a part."""
    file, texts = tmp_path / "phm.yaml", {b"a" * 200_000, b"b" * 200_000}
    file.write_bytes(b"a" * 200_000)
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(file)], stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    seen: set[bytes] = set()

    def observe() -> bool:
        seen.add(file.read_bytes())
        return seen >= texts

    try:
        until(observe, "both contents")
    finally:
        process.kill()
        process.communicate()
    assert seen == texts
    replace(file, b"c")
    assert file.read_bytes() == b"c"


# ---------------------------------------------------------------- the port


def opened(delivery: Delivery, made: Settings) -> tuple[DeliveryServer | None, str]:
    return open_server(delivery, made.delivery, made.mavlink.signing.key, made.agent.name, SystemClock())


def test_the_key_of_mavlink_is_not_accepted(tmp_path: Path) -> None:
    """Every ground station and autopilot of the swarm has it, and with a configuration one can run programs."""
    key, same = tmp_path / "mavlink.key", tmp_path / "delivery.key"
    for each in (key, same):
        each.write_text("ab" * 32)
        each.chmod(0o600)
    delivery = cast(Any, SimpleNamespace(execute=None, note=None))
    wanted = settings(mavlink={"signing": {"key": str(key)}}, delivery={"listen": "127.0.0.1:9465", "key": str(same)})
    server, problem = opened(delivery, wanted)
    assert server is None and "key of mavlink.signing" in problem
    same.write_text("cd" * 32)
    assert opened(delivery, wanted)[1] == ""
    same.chmod(0o644)
    server, problem = opened(delivery, wanted)
    assert server is None and "chmod 600" in problem and problem.startswith("delivery.key: ")


def test_nothing_listens_by_default() -> None:
    """Delivery is for those who want it."""
    assert opened(cast(Any, None), settings()) == (None, "")


def test_an_answer_is_never_larger_than_its_reader_takes() -> None:
    """Whatever the number and length of the problems."""
    problem = {"line": 1, "key": "k" * 9000, "message": "\u2028" * 9000, "text": "t" * 9000}
    text = DeliveryAnswer(False, "x" * 9000, problems=(problem,) * 5000).as_json()
    assert len(text) <= 65_536 and json.loads(text)["problems"]
