"""What console blocks show below a command is what `phm` prints: it runs here, and talks to the real server of the daemon.

Pages that are carried out (`tests.docs.walk`) and generated blocks have their own tests.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.config import ConfigError, load
from phm.core.settings import Settings
from phm.runtime.configuration import FIXED
from phm.runtime.reloader import ReloadOutcome
from phm.wire.delivery import DeliveryAnswer
from tests.commands import test_control_server, test_delivery_server
from tests.commands.long_limits import lengthen_limits
from tests.docs.blocks import Block, blocks
from tests.docs.test_commands import simple_commands
from tests.docs.walk import Step, commands, walked
from tests.recovery.holds.scene import Scene

SHOWING = [block for block in blocks("console") if block.shown and not block.generated and not walked(block)]
CONTAINER, KNOWN = "ros_app", "cam"
"""The container of the documents, and that of the scene in its place."""
MINIMAL = "agent: {name: agent_1, id: 1}\ncontainers: [{name: ros_app}]\n"
VOLATILE = ((r"\d\d:\d\d:\d\d", "TIME"), (r"uid \d+", "uid N"))


class Deliveries(test_delivery_server.Bench):
    """An agent A07 that accepts a configuration with a new section `custom`."""

    def _execute(self, text: str, base: str, who: str) -> DeliveryAnswer:
        return DeliveryAnswer(True, ReloadOutcome(True, ("custom",)).text(), base)


class Daemon(test_control_server.Daemon):
    """The control socket with real holds and real approvals; a configuration is reloaded as the test says."""

    def __init__(self, folder: Path) -> None:
        self.scene = Scene(
            mode="advise", ladders={"exited": ["start"]}, actions=("start",), bad={f"container/{KNOWN}": "exited"}
        )
        super().__init__(folder / "run", self.scene.service)

    def approve(self, fault: str) -> str:
        return self.scene.agent.executor.approve(fault)

    def fault(self) -> str:
        """The fault for which an action is advised."""
        agent = self.scene.agent
        agent.until(agent.pipeline.open_faults, "the fault")
        return agent.pipeline.open_faults()[0].id

    def close(self) -> None:
        self.control.close()
        self.scene.stop()


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lengthen_limits(monkeypatch)


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    made = Daemon(tmp_path)
    yield made
    made.close()


def reloaded(step: Step, folder: Path) -> ReloadOutcome:
    """The outcome for the sections that the step names, or for a file with its mistake at the same line."""
    first = step.shown[0]
    if ":" in first.partition(" ")[0].rstrip(":"):
        file, line, key, value = _mistake(first)
        (folder / Path(file).name).write_text("\n" * (line - 1) + f"{key}: {value}\n{MINIMAL}")
        with pytest.raises(ConfigError) as caught:
            load(str(folder / Path(file).name), environ={})
        return ReloadOutcome(False, problems=caught.value.problems)
    named = set(re.findall(r"\w+", first.replace("restart PHM to apply", ""))) & set(Settings.model_fields)
    sections = [name for name in Settings.model_fields if name in named]
    return ReloadOutcome(
        True, tuple(name for name in sections if name not in FIXED), tuple(name for name in sections if name in FIXED)
    )


def _mistake(line: str) -> tuple[str, int, str, str]:
    found = re.match(r"(/[\w/.]+):(\d+): (\w+): '(\w+)'", line)
    assert found, line
    return found[1], int(found[2]), found[3], found[4]


def printed(step: Step, daemon: Daemon, folder: Path) -> str:
    """What the command prints, in the words of the document."""
    words = phm_words(step.command)
    if words[0] == "deliver":
        return delivered(words, folder)
    if words[0] == "reload":
        outcome = reloaded(step, folder)
        daemon.reload = outcome.as_json
    if words[0] == "approve":
        words[1] = daemon.fault()
    if words[0] == "release":
        daemon.phm("hold", KNOWN)
    _, output = daemon.phm(*(KNOWN if word == CONTAINER else word for word in words))
    return output.replace(KNOWN, CONTAINER).replace(f"{folder}/", "/etc/phm/")


def delivered(words: list[str], folder: Path) -> str:
    """`phm deliver` of files with the names of the document, to a real port."""
    for word in words:
        if word.endswith((".yaml", ".orig", ".key")):
            content = test_delivery_server.KEY.hex() if word.endswith(".key") else "old"
            (folder / word).write_text(content)
            (folder / word).chmod(0o600)
    agent = Deliveries()
    try:
        host, port = agent.where
        given = [f"{host}:{port}" if re.fullmatch(r"[\d.]+:\d+", word) else word for word in words]
        given = [str(folder / word) if (folder / word).is_file() else word for word in given]
        return CliRunner().invoke(group, given).output
    finally:
        agent.server.close()


def phm_words(command: str) -> list[str]:
    """The words after `phm`."""
    ((program, *words),) = simple_commands(command)
    assert program == "phm", command
    return words


def steady(text: str) -> str:
    """The text without times and user ids."""
    for pattern, instead in VOLATILE:
        text = re.sub(pattern, instead, text)
    return text


@pytest.mark.parametrize("block", SHOWING, ids=str)
def test_the_program_prints_what_the_block_shows(block: Block, daemon: Daemon, tmp_path: Path) -> None:
    """Each command of the block is run, and prints these lines and no other."""
    done: list[list[str]] = []
    for step in commands(block.text):
        done.append(steady(printed(step, daemon, tmp_path)).splitlines())
        assert done[-1] == [steady(line) for line in step.shown], f"{block}: $ {step.command}"
    assert done
