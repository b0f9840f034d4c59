"""The note of an injection in PHM's log: its words, its moment, and that no injection depends on it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from docker.errors import APIError

from sitl.campaign import injector, publication
from sitl.campaign.arguments import parser
from sitl.campaign.injector import Injector
from sitl.campaign.main import INVALID, main
from sitl.campaign.plan import Draw
from sitl.campaign.profiles import ALL
from sitl.campaign.schedule import check_record, schedule
from sitl.campaign.trial import TRIAL, Trial
from sitl.faults import _inject_note, all_faults
from sitl.faults.base import Agent, Fault
from sitl.swarm import active_faults

COMMIT = 40 * "0"


class Noted(Agent):
    """An agent whose sidecar keeps the commands that it is asked to run; `answer`: exit code and output, or an error."""

    def __init__(self, answer: Any = (0, b"noted")) -> None:
        super().__init__("p-3", "agent_3", docker=Mock(), number=3)
        self.done: list[Any] = []
        self._answer = answer

    @property
    def sidecar(self) -> Any:
        return SimpleNamespace(exec_run=self._run)

    def _run(self, argv: list[str]) -> Any:
        self.done.append(argv)
        if isinstance(self._answer, Exception):
            raise self._answer
        return self._answer


class Recorded(Fault):
    """A fault whose injection is a step of its agent."""

    name, title, unit, condition, layer = "recorded", "recorded", "nodes/{agent}/node_1", "node_missing", "ros"
    cause = "none"

    def inject(self, agent: Agent) -> float:
        assert isinstance(agent, Noted)
        agent.done.append("injected")
        return 1.0


@pytest.fixture(autouse=True)
def world_not_observed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer of the world has a separate client of the engine."""
    monkeypatch.setattr(injector, "WorldObserver", Mock())


NOTE = ["timeout", str(_inject_note.LIMIT_S), "phm", "note", "INJECT recorded: nodes/agent_3/node_1"]
FAILED = [(1, b"the daemon does not answer"), (124, b""), (0x7F, None), APIError("is paused"), LookupError("no phm")]


def test_the_note_names_the_fault_and_its_units() -> None:
    """The words by which the report finds the fault that belongs to it."""
    assert _inject_note.text(all_faults()["node_killed"], Noted()) == "INJECT node_killed: nodes/agent_3/node_1"


@pytest.mark.parametrize("answer", FAILED, ids=str)
def test_a_note_that_fails_says_why(answer: Any) -> None:
    """A PHM that is stopped, hung, or gone."""
    assert _inject_note.write(Recorded(), Noted(answer))


@pytest.mark.parametrize("answer", [(0, b"noted"), *FAILED], ids=str)
def test_the_note_of_a_campaign_comes_before_the_injection(answer: Any) -> None:
    """And an injection does not depend on its note."""
    agent, fault = Noted(answer), Recorded()
    at_work = Injector({"recorded": fault}, {3: agent}, ALL["shipped"], lambda number, unit: False, _inject_note.write)
    made = at_work.planned([Draw("recorded", 3)])
    at_work.inject(made, lambda futures: None)
    assert agent.done == [NOTE, "injected"]
    assert (made[0].moment, made[0].error) == (1.0, "")


def test_a_campaign_writes_no_notes_unless_asked() -> None:
    """They cost CPU time of PHM, which a campaign measures."""
    agent = Noted()
    at_work = Injector({"recorded": Recorded()}, {3: agent}, ALL["shipped"], lambda number, unit: False)
    at_work.inject(at_work.planned([Draw("recorded", 3)]), lambda futures: None)
    assert agent.done == ["injected"]
    assert parser().parse_args([]).note is False


@pytest.mark.parametrize("answer", [(0, b"noted"), FAILED[0]], ids=str)
def test_the_command_writes_a_note_before_its_injection(
    answer: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a note the fault is injected all the same, and the reason is returned."""
    monkeypatch.setattr(active_faults, "all_faults", lambda: {"recorded": Recorded()})
    agents = [Noted(), Noted(), Noted(answer)]
    swarm: Any = SimpleNamespace(agents=agents, folder=tmp_path)
    _, no_note = active_faults.inject(swarm, 3, "recorded")
    assert agents[2].done == [NOTE, "injected"]
    assert no_note == ("" if answer[0] == 0 else "the daemon does not answer")


def test_a_campaign_with_notes_is_not_published(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither at its start nor from its record."""
    assert main(["--note", "--markdown", "--commit", COMMIT]) == INVALID
    assert "--note cannot be published" in capsys.readouterr().err
    monkeypatch.setattr(publication, "check_commit", Mock())
    with pytest.raises(ValueError, match="--note"):
        publication.check([Trial(TRIAL, 1, 8, 0.0, 0.0, setting={"note": True, "commit": COMMIT})])


def test_trials_with_and_without_notes_do_not_share_a_record() -> None:
    """Their figures would differ."""
    words = ["--seed", "1", "--trials", "1", "--commit", COMMIT]
    with_notes, without = (schedule(parser().parse_args([*words, *more])) for more in (["--note"], []))
    trials = [Trial("nominal", 0, 8, 0.0, 0.0, setting=made.setting(0)) for made in (with_notes, without)]
    for made, trial, other in ((with_notes, trials[0], trials[1]), (without, trials[1], trials[0])):
        check_record([trial], made, Path("record"))
        with pytest.raises(ValueError, match="other note"):
            check_record([other], made, Path("record"))
