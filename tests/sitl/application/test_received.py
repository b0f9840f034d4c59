"""What the application's nodes have received, as they record it and as a fault's observer reads it, without PHM."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sitl.application import received
from sitl.application.behaviour import SIGNALS
from sitl.application.reading import ends
from sitl.application.received import WRITE_S, Reception, Record, Sample
from sitl.faults import _application, all_faults
from sitl.faults._node_signal import NodeSignal

NOW_S = 1000.0
STEADY = {"rate_hz": 10.0, "age_s": 0.05, "same": 0, "lost": 0, "stamp_s": 0.0}


def reception(*samples: Sample) -> dict[str, float]:
    found = Reception()
    for sample in samples:
        found.add(sample)
    return found.summary(10.0)


def messages(period_s: float, count: int = 20, step: int = 1, stamp_s: float = 0.0) -> list[Sample]:
    """The last one at 10.0 s."""
    return [Sample(10.0 - period_s * (count - 1 - at), at, at * step, stamp_s) for at in range(count)]


@pytest.mark.parametrize("period_s", [0.01, 0.1, 0.2, 1.0, 5.0])
def test_the_rate_is_that_of_the_newest_messages(period_s: float) -> None:
    """At any rate; before them it may have been another."""
    early = [Sample(-100.0 + at, at, at) for at in range(5)]
    assert reception(*early, *messages(period_s))["rate_hz"] == pytest.approx(1 / period_s)


def test_one_late_message_does_not_change_the_rate() -> None:
    """On a busy machine messages are late: the observer accepts 20 %."""
    steady = messages(0.2)
    late = [*steady[:-3], Sample(steady[-3].at + 0.35, "late", 17), *steady[-2:]]
    for seen in (late, late[:-2], [*steady[:-1], Sample(steady[-1].at + 0.35, "late", 19)]):
        assert reception(*seen)["rate_hz"] == pytest.approx(5.0, rel=0.15)


def test_a_pause_before_the_newest_messages_is_not_in_their_rate() -> None:
    """The rate of a topic that is back is known after three messages; half of the rate is not a pause."""
    back = [*(Sample(sample.at - 8.0, sample.content) for sample in messages(0.2)), *messages(0.2, count=3)]
    assert reception(*back)["rate_hz"] == pytest.approx(5.0)
    half = [*(Sample(sample.at - 4.0, sample.content) for sample in messages(0.2)), *messages(0.4, count=9)]
    assert reception(*half)["rate_hz"] == pytest.approx(2.5)


def test_wrong_data_is_counted() -> None:
    """Repeated content, numbers that are left out, and the largest distance of a stamp from the clock."""
    assert reception(*messages(0.1)) == {"rate_hz": 10.0, "age_s": 0.0, "same": 0, "lost": 0, "stamp_s": 0.0}
    frozen = [Sample(sample.at, "same", sample.count) for sample in messages(0.1)]
    assert reception(*frozen)["same"] == 11
    assert reception(*messages(0.1, step=2))["lost"] == 11
    assert reception(*messages(0.1, stamp_s=-3600.0))["stamp_s"] == 3600.0
    assert reception(Sample(9.8, "a", 900), Sample(9.9, "b", 1))["lost"] == 0


def test_no_message_and_one_message_have_no_rate() -> None:
    """Without any message there is no age either."""
    assert (reception()["rate_hz"], reception()["age_s"]) == (0.0, -1.0)
    assert reception(Sample(9.0, "a"))["rate_hz"] == 0.0


def test_a_record_is_written_into_an_existing_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice a second at most; nodes outside of the application's image have no such folder and write nothing."""
    now = [NOW_S]
    monkeypatch.setattr(received, "time", SimpleNamespace(monotonic=lambda: now[0]))
    record = Record("node_2", tmp_path)
    record.listener("topic_1")(SimpleNamespace(data="node_1 1"))
    assert [record.due(), record.due()] == [True, False]
    now[0] += WRITE_S
    assert [record.due(), record.due()] == [True, False]
    (file,) = tmp_path.iterdir()
    found = json.loads(file.read_text())
    assert file.name == "node_2.json"
    assert found["at"] == now[0]
    assert set(found["topics"]["topic_1"]) == set(STEADY)
    assert Record("node_2", tmp_path / "none").due()


@pytest.mark.parametrize(("text", "expected"), [("node_1 node_2\n", ("node_1", "node_2")), (None, ("", ""))])
def test_a_file_names_the_ends_of_the_topic_with_a_header(
    tmp_path: Path, text: str | None, expected: tuple[str, str]
) -> None:
    """Without the file there is no such topic."""
    if text is not None:
        (tmp_path / "reading").write_text(text)
    assert ends(tmp_path / "reading") == expected


def test_each_fault_of_a_node_sends_the_signal_of_its_behaviour() -> None:
    """Numbers, since `kill` has no names for signals of real time."""
    names = {name: fault.signal_number for name, fault in all_faults().items() if isinstance(fault, NodeSignal)}
    expected = {
        "executor_deadlocked": "deadlocked",
        "callback_blocked": "blocked",
        "data_frozen": "frozen",
        "stamps_shifted": "shifted",
        "samples_lost": "lossy",
    }
    assert {name: SIGNALS[int(number)] for name, number in names.items()} == {name: expected[name] for name in names}


class World:
    """A running application of three nodes in a ring, whose root is a folder."""

    def __init__(self, proc: Path) -> None:
        self.proc = proc
        self.state = {"Running": True, "Paused": False, "Pid": 42}
        self.folder = proc / "42" / "root" / "tmp" / "received"
        self.folder.mkdir(parents=True)
        for number in (1, 2, 3):
            self.write(f"node_{number}", {f"topic_{(number - 2) % 3 + 1}": STEADY})

    @property
    def agent(self) -> Any:
        command = ["python", "-m", "sitl.application.app", "--agent", "agent_1", "--nodes", "3", "--rate", "10"]
        return SimpleNamespace(app=SimpleNamespace(attrs={"State": self.state, "Config": {"Cmd": command}}))

    def write(self, node: str, topics: dict[str, Any], age_s: float = 0.0) -> None:
        record = {"at": NOW_S - age_s, "topics": topics}
        (self.folder / f"{node}.json").write_text(json.dumps(record))

    def works(self) -> bool:
        return _application.works(self.agent, self.proc)


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    monkeypatch.setattr(_application, "time", SimpleNamespace(monotonic=lambda: NOW_S))
    return World(tmp_path)


def test_an_application_works_while_each_node_receives_its_topics(world: World) -> None:
    """At the rates that its command states."""
    assert world.works()


@pytest.mark.parametrize(
    "topic",
    [
        {**STEADY, "rate_hz": 5.0},
        {**STEADY, "rate_hz": 20.0},
        {**STEADY, "age_s": 2.0},
        {**STEADY, "age_s": -1.0, "rate_hz": 0.0},
        None,
    ],
)
def test_a_topic_that_is_slow_fast_silent_or_gone_does_not_work(world: World, topic: dict[str, float] | None) -> None:
    """One such topic is enough."""
    world.write("node_2", {"topic_1": topic} if topic else {})
    assert not world.works()


def test_a_node_that_no_longer_writes_does_not_work(world: World) -> None:
    """Its record is old, or it has none in this container."""
    world.write("node_1", {"topic_3": STEADY}, age_s=_application.FRESH_S + 1)
    assert not world.works()
    (world.folder / "node_1.json").unlink()
    assert not world.works()


@pytest.mark.parametrize("state", [{"Running": False, "Pid": 0}, {"Paused": True}])
def test_an_application_that_does_not_run_does_not_work(world: World, state: dict[str, Any]) -> None:
    """Whatever its files say."""
    world.state |= state
    assert not world.works()


@pytest.mark.parametrize("wrong", [{}, {"same": 3}, {"lost": 2}, {"stamp_s": 3600.0}, {"rate_hz": 4.0}])
def test_data_is_good_if_content_numbers_and_stamps_are(world: World, wrong: dict[str, float]) -> None:
    """Of the topic that these faults use."""
    assert not _application.data_is_good(world.agent, world.proc)
    world.write("node_2", {"topic_1": STEADY, "reading": {**STEADY, **wrong}})
    assert _application.data_is_good(world.agent, world.proc) is not bool(wrong)
