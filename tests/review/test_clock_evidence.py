"""How much must agree before a record is moved: what both have may be equal by chance, and its own clock may be right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm.review.votes import Weight, candidate, moments, too_little
from tests.review.records import SLOTS, T0, Flown, Ground, report

DAY_S = 86_400.0
CASCADE = ((150.0, "nodes/node_1"), (150.5, "container/ros_app"))
"""A failure and what follows from it, as every day."""


def fly(
    agent: Flown, ground: Ground | None, units: tuple[tuple[float, str], ...], *, armed: tuple[float, float]
) -> None:
    """A flight; times are seconds since the agent's start. The ground has all of it, 0.3 s later."""
    began = agent.now
    edges: list[tuple[float, str | bool]] = [(armed[0], True), *units, (armed[1], False)]
    if ground:
        ground.event(
            began, "autopilot", system=agent.number, presence="alive", armed=False, mode=5, state="ACTIVE", age_s=0.0
        )
    for after, what in sorted(edges, key=lambda edge: edge[0]):
        agent.until(max(agent.now, began + after))
        if isinstance(what, bool):
            agent.arm(what)
            if ground:
                keys = {"presence": "alive", "mode": 5, "state": "ACTIVE", "age_s": 0.0}
                ground.event(agent.now + 0.3, "autopilot", system=agent.number, armed=what, **keys)
            continue
        if ground:
            ground.text(agent.now + 0.3, agent.number, int(SLOTS[what.partition("/")[0]][0]), f"{what} gone")
        agent.fail(what, lasts=0.2)
    agent.until(began + armed[1] + 40.0)
    agent.close()


def clocks(made: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {run["boot_id"]: run for run in made["clocks"]["runs"]}


def test_one_equal_line_of_another_day_moves_nothing(tmp_path: Path) -> None:
    """The log of one day and the ground's record of the next one: each has the failure of a node, once."""
    agent, ground = Flown(tmp_path / "log"), Ground(tmp_path / "ground.jsonl")
    agent.until(100.0)
    agent.fail("nodes/node_1")
    agent.until(300.0)
    agent.close()
    ground.event(DAY_S, "snapshot", radios=[])
    ground.text(DAY_S + 650.0, 1, 6, "nodes/node_1 gone")
    ground.close()
    made = report(tmp_path)
    (clock,) = made["clocks"]["runs"]
    assert (clock["applied"], clock["offset_s"], clock["votes"]) == (False, None, 0)
    assert clock["by"] == (
        "its own clock: of the lines and armings that the ground also received, 1 agrees at +86950.0 s, "
        "at 1 moment: 3 are needed for so large an offset"
    )
    assert made["faults"][0]["opened"] == T0 + 100.0


def test_two_days_of_one_agent_stay_two_days(tmp_path: Path) -> None:
    """The ground has recorded the second one. Both have a flight of the same length, and a failure with what follows from it."""
    first, second = Flown(tmp_path / "day1", boot="boot0001"), Flown(tmp_path / "day2", boot="boot0002", start=DAY_S)
    ground = Ground(tmp_path / "ground.jsonl")
    fly(first, None, CASCADE, armed=(100.0, 600.0))
    fly(second, ground, CASCADE, armed=(100.0, 600.5))
    ground.close()
    made = report(tmp_path)
    found = clocks(made)
    assert found["boot0002"]["votes"] == 4 and not found["boot0002"]["applied"]
    assert (found["boot0001"]["offset_s"], found["boot0001"]["applied"]) == (None, False)
    assert found["boot0001"]["by"].endswith("agree at +86400.3 s, but another run of this agent is there")
    assert made["window"]["duration_s"] > DAY_S and len(made["flights"]) == 2
    assert [fault["opened"] - T0 for fault in made["faults"]] == [150.0, 150.5, DAY_S + 150.0, DAY_S + 150.5]


def test_a_flight_of_the_same_length_on_another_day_moves_nothing(tmp_path: Path) -> None:
    """Armed and disarmed for as long as on the day of the ground's record: an automatic mission does so each day."""
    agent, other = Flown(tmp_path / "log"), Flown(tmp_path / "not collected", start=DAY_S)
    ground = Ground(tmp_path / "ground.jsonl")
    fly(agent, None, (), armed=(100.0, 600.0))
    fly(other, ground, (), armed=(100.0, 600.5))
    ground.close()
    (clock,) = report(tmp_path / "log", tmp_path / "ground.jsonl")["clocks"]["runs"]
    assert not clock["applied"] and "at 2 moments: 3 are needed" in clock["by"]


@pytest.mark.parametrize("start_s", [0.0, 1_000_000_000.0])
def test_a_clock_that_was_never_set_is_corrected(tmp_path: Path, start_s: float) -> None:
    """A computer without a battery for its clock starts in 1970, or where it was shut down; two runs begin at the same time."""
    ground = Ground(tmp_path / "ground.jsonl")
    for number, start in enumerate((0.0, 3000.0)):
        agent = Flown(tmp_path / str(number), boot=f"boot000{number}", start=start, wrong_s=start_s + 30.0 - T0 - start)
        fly(agent, ground, ((150.0 + 70.0 * number, "nodes/node_1"),), armed=(100.0, 400.0 + 90.0 * number))
    ground.close()
    made = report(tmp_path)
    assert [run["applied"] for run in made["clocks"]["runs"]] == [True, True]
    assert [fault["opened"] for fault in made["faults"]] == [
        pytest.approx(T0 + 150.0, abs=1.5),
        pytest.approx(T0 + 3220.0, abs=1.5),
    ]


def test_one_line_confirms_a_clock_that_is_nearly_right(tmp_path: Path) -> None:
    """And corrects it by some seconds, whatever the log has that the radio lost."""
    agent, ground = Flown(tmp_path / "log", wrong_s=6.0), Ground(tmp_path / "ground.jsonl")
    for moment, unit in ((100.0, "nodes/node_1"), (150.0, "container/ros_app"), (200.0, "nodes/node_1")):
        agent.until(moment)
        agent.fail(unit)
    agent.until(300.0)
    agent.close()
    ground.event(0.0, "snapshot", radios=[])
    ground.text(150.2, 1, 2, "container/ros_app gone")
    ground.close()
    (clock,) = report(tmp_path)["clocks"]["runs"]
    assert (clock["applied"], clock["votes"]) == (True, 1) and clock["offset_s"] == pytest.approx(-5.8)


def test_faults_that_the_ground_could_not_receive_are_no_evidence_against_an_offset(tmp_path: Path) -> None:
    """Ten failures while the agent was lost for the ground; the same ones count against the offset if it was not."""
    for name in ("lost", "there"):
        agent, ground = Flown(tmp_path / name, wrong_s=-3600.0), Ground(tmp_path / name / "ground.jsonl")
        ground.event(0.0, "presence", agent=1, presence="alive", was="never received", silent_s=0.0)
        units = [(200.0 + 20.0 * place, "rates/topic_1") for place in range(10)]
        kept = [(100.0, "nodes/node_1"), (150.0, "container/ros_app"), (500.0, "nodes/node_1")]
        for moment, unit in sorted([*units, *kept]):
            agent.until(moment)
            agent.fail(unit)
        for moment, unit in kept[:2]:
            ground.text(moment + 0.2, 1, int(SLOTS[unit.partition("/")[0]][0]), f"{unit} gone")
        if name == "lost":
            ground.event(210.0, "presence", agent=1, presence="lost", was="alive", silent_s=30.0)
            ground.event(450.0, "presence", agent=1, presence="alive", was="lost", silent_s=0.0)
        for moment in range(60, 540, 60):
            ground.event(float(moment), "snapshot", radios=[])
        ground.text(500.2, 1, 6, "nodes/node_1 gone")
        agent.until(600.0)
        agent.close()
        ground.close()
    (lost,) = report(tmp_path / "lost")["clocks"]["runs"]
    (there,) = report(tmp_path / "there")["clocks"]["runs"]
    assert lost["applied"] and lost["offset_s"] == pytest.approx(3600.2, abs=0.01)
    assert not there["applied"] and "3 agree at +3600.2 s, less than half of the 13" in there["by"]


def test_runs_of_one_start_of_the_machine_are_placed_together(tmp_path: Path) -> None:
    """PHM was restarted twice: what the three runs have is enough together, and would be too little for each of them."""
    ground, found = Ground(tmp_path / "ground.jsonl"), []
    for number, (start, unit) in enumerate(
        ((0.0, "nodes/node_1"), (300.0, "container/ros_app"), (600.0, "rates/topic_1"))
    ):
        agent = Flown(
            tmp_path / str(number), boot=f"boot000{number}", start=start, wrong_s=-DAY_S, machine_boot="machine1"
        )
        agent.until(start + 100.0 + 13.0 * number)
        ground.text(agent.now + 0.2, 1, int(SLOTS[unit.partition("/")[0]][0]), f"{unit} gone")
        agent.fail(unit)
        agent.until(start + 250.0)
        agent.close()
        found.append(agent)
    ground.close()
    runs = report(tmp_path)["clocks"]["runs"]
    assert [(run["applied"], run["offset_s"], run["votes"]) for run in runs] == [
        (True, pytest.approx(DAY_S + 0.2), 3)
    ] * 3
    (alone,) = report(tmp_path / "0", tmp_path / "ground.jsonl")["clocks"]["runs"]
    assert not alone["applied"]


def test_a_flight_that_continues_is_not_an_arming(tmp_path: Path) -> None:
    """PHM was restarted just after the arming that the ground received: this is not the arming of its second run."""
    ground = Ground(tmp_path / "ground.jsonl")
    for second, armed in ((50.0, False), (100.3, True), (150.0, True)):
        keys = {"presence": "alive", "mode": 5, "state": "ACTIVE", "age_s": 0.0}
        ground.event(second, "autopilot", system=1, armed=armed, **keys)
    ground.close()
    first = Flown(tmp_path, boot="boot0001")
    first.until(100.0)
    first.arm(True)
    first.until(104.0)
    first.close()
    second_run = Flown(tmp_path, boot="boot0002", start=106.0)
    second_run.arm(True)
    second_run.until(150.0)
    second_run.close()
    found = clocks(report(tmp_path))
    assert (found["boot0001"]["offset_s"], found["boot0001"]["votes"]) == (pytest.approx(0.3), 1)
    assert (found["boot0002"]["offset_s"], found["boot0002"]["votes"]) == (None, 0)


def test_regular_failures_fit_many_offsets_and_move_nothing_far(tmp_path: Path) -> None:
    """A node that fails each 60 s, on two days."""
    agent, ground = Flown(tmp_path / "log"), Ground(tmp_path / "ground.jsonl")
    for place in range(1, 10):
        agent.until(60.0 * place)
        agent.fail("nodes/node_1")
        ground.text(DAY_S + 60.0 * place + 7.0, 1, 6, "nodes/node_1 gone")
    agent.until(700.0)
    agent.close()
    ground.close()
    (clock,) = report(tmp_path)["clocks"]["runs"]
    assert clock["offset_s"] is None and clock["by"].endswith("fit several offsets")


def test_as_many_votes_at_the_own_clock_win() -> None:
    """One pair says that the clock is right within seconds, another one that it is wrong by a day."""
    assert candidate([DAY_S, 1.5]) == (1.5, 1.0, 1)
    assert (candidate([DAY_S, DAY_S + 0.2, 1.5]) or (0.0,))[0] == pytest.approx(DAY_S + 0.1)
    assert candidate([DAY_S, -DAY_S]) is None and candidate([]) is None


def test_all_of_one_kind_needs_more_moments() -> None:
    """Three failures of one slot may come at the same distances on two days, six hardly do."""

    def weight(count: int) -> Weight:
        return Weight([(6, 100.0 * place) for place in range(count)], count)

    assert "all of one kind: 6 moments" in too_little(DAY_S, weight(5), weight(5), overlapping=False)
    assert too_little(DAY_S, weight(6), weight(6), overlapping=False) == ""
    assert too_little(100.0, weight(2), weight(2), overlapping=True) == ""
    assert too_little(301.0, weight(2), weight(2), overlapping=True) != ""
    assert moments([]) == 0 and moments([5.0]) == 1 and moments([0.0, 29.0, 58.0, 88.0]) == 2
