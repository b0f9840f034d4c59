"""Agents with wrong clocks are put on the ground's time, with an error that is stated."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from phm.review.clocks import own_clock
from phm.review.votes import vote
from tests.review.records import T0, Flown, Ground, report


def swarm(folder: Path, wrong_s: float) -> None:
    """An agent with a wrong clock, and the ground that receives two lines and both edges of a flight."""
    agent, ground = Flown(folder / "agent", wrong_s=wrong_s), Ground(folder / "ground.jsonl")
    ground.event(0, "autopilot", system=1, presence="alive", armed=False, mode=5, state="ACTIVE", age_s=0.0)
    agent.until(100)
    agent.arm(True)
    ground.event(100.6, "autopilot", system=1, presence="alive", armed=True, mode=5, state="ACTIVE", age_s=0.0)
    for moment, unit in ((150, "nodes/node_1"), (200, "container/ros_app")):
        agent.until(moment)
        ground.text(moment + 0.3, 1, 6 if unit.startswith("nodes") else 2, f"{unit} gone")
        agent.fail(unit)
    agent.until(300)
    agent.arm(False)
    ground.event(300.1, "autopilot", system=1, presence="alive", armed=False, mode=5, state="ACTIVE", age_s=0.0)
    agent.until(320)
    agent.close()
    ground.close()


@pytest.mark.parametrize("wrong_s", [-86_400.0, -7.5, 3600.0])
def test_a_wrong_clock_is_corrected_by_what_the_ground_received_too(tmp_path: Path, wrong_s: float) -> None:
    """The offset is right within its stated error, and is applied to all times of the agent."""
    swarm(tmp_path, wrong_s)
    made = report(tmp_path)
    clock = made["clocks"]["runs"][0]
    assert clock["applied"] and clock["votes"] == 4
    assert clock["offset_s"] == pytest.approx(-wrong_s, abs=clock["error_s"])
    assert clock["error_s"] < 2.0
    assert made["faults"][0]["opened"] == pytest.approx(T0 + 150, abs=clock["error_s"])


def test_an_offset_within_its_error_is_shown_and_not_applied(tmp_path: Path) -> None:
    """A clock that is right stays unchanged: the delay of the radio is not its error."""
    swarm(tmp_path, 0.0)
    made = report(tmp_path)
    clock = made["clocks"]["runs"][0]
    assert (clock["applied"], clock["votes"]) == (False, 4)
    assert abs(clock["offset_s"]) < clock["error_s"]
    assert made["faults"][0]["opened"] == T0 + 150


def test_without_a_record_of_the_ground_it_is_said_that_clocks_are_not_compared(tmp_path: Path) -> None:
    """What is missing is named; no number is invented."""
    with_clock = Flown(tmp_path)
    with_clock.until(100)
    with_clock.close()
    clocks = report(tmp_path)["clocks"]
    assert clocks["reference"] == "each agent"
    assert clocks["missing"].startswith("no record of the ground (`phm gcs --record`)")
    assert clocks["runs"][0]["offset_s"] is None


def test_a_step_of_utc_does_not_move_events_of_the_same_run(tmp_path: Path) -> None:
    """Distances are those of the monotonic clock; UTC is the one that held longest, and the step is listed."""
    made = Flown(tmp_path, wrong_s=-500.0)
    made.until(20)
    made.clock.jump_utc(500.0)
    made.until(200)
    made.fail("nodes/node_1")
    made.until(260)
    made.close()
    document = report(tmp_path)
    assert document["window"]["begin"] == pytest.approx(T0)
    assert document["faults"][0]["opened"] == pytest.approx(T0 + 200)
    assert document["clocks"]["runs"][0]["steps"] == [[pytest.approx(T0 + 40), 500.0]]


def test_the_offset_is_where_most_votes_agree() -> None:
    """Repeated lines give wrong pairs; they agree with nothing. A tie decides nothing."""
    rng = random.Random(7)
    noise = [rng.uniform(-1e5, 1e5) for _ in range(200)]
    offset, error, votes = vote([*noise, 41.2, 41.9, 42.3, 42.6]) or (0.0, 0.0, 0)
    assert votes >= 4 and offset == pytest.approx(42.0, abs=error)
    assert vote([10.0, 500.0]) is None
    assert vote([]) is None


def test_a_clock_without_lines_is_the_monotonic_one() -> None:
    """There is nothing to derive UTC from."""
    assert own_clock([], 0.0).shift == 0.0


class Sender:
    """A ground station whose heartbeats several agents receive, with other frames in between."""

    def __init__(self, *agents: Flown, seed: int = 3, steps: tuple[int, ...] = (1, 1, 1, 2, 3)) -> None:
        """steps: by how much frame numbers rise between two heartbeats."""
        self.agents, self.number, self.steps = agents, 0, steps
        self.sent: list[tuple[float, int, int, int]] = []
        """Those whose number is a multiple of 8, as the ground that sends them records them."""
        self.draw = random.Random(seed)

    def until(self, seconds: float) -> None:
        """One heartbeat a second, received after a short delay of each agent's link."""
        while min(agent.now for agent in self.agents) < seconds:
            if self.number % 8 == 0:
                self.sent.append((self.agents[0].now + 1.0, 255, 190, self.number % 256))
            for agent in self.agents:
                agent.until(agent.now + 1.0, every=20.0)
                if self.draw.random() > 0.1:
                    agent.receive(255, 190, self.number % 256)
                agent.log.tick()
            self.number += self.draw.choice(self.steps)


@pytest.mark.parametrize("wrong_s", [-3600.0, -3.0, 86_400.0])
def test_agents_are_compared_by_the_heartbeats_that_both_received(tmp_path: Path, wrong_s: float) -> None:
    """Without a record of the ground; one in ten frames is lost on each link."""
    first = Flown(tmp_path / "a", 1, wrong_s=0.0)
    second = Flown(tmp_path / "b", 2, wrong_s=wrong_s, mono=7000.0)
    sky = Sender(first, second)
    sky.until(1200)
    second.fail("nodes/node_1", lasts=1.0)
    failed_s = second.now - 1.0
    first.until(1300)
    for agent in sky.agents:
        agent.close()
    made = report(tmp_path)
    assert made["clocks"]["reference"] == "agent_1"
    clock = made["clocks"]["runs"][1]
    assert clock["by"] == "heartbeats that another agent also received" and clock["applied"]
    assert clock["offset_s"] == pytest.approx(-wrong_s, abs=clock["error_s"]) and clock["error_s"] < 0.6
    assert made["faults"][0]["opened"] == pytest.approx(T0 + failed_s, abs=clock["error_s"])


def test_agents_that_received_nothing_in_common_keep_their_own_clocks(tmp_path: Path) -> None:
    """Two flights with the same ground station, at different times: no number is invented."""
    for number in (1, 2):
        made = Flown(tmp_path / str(number), number, wrong_s=100.0 * number)
        Sender(made, seed=number).until(1200)
        made.close()
    clocks = report(tmp_path)["clocks"]
    assert clocks["reference"] == "each agent" and [run["offset_s"] for run in clocks["runs"]] == [None, None]


def test_numbers_that_come_again_at_even_intervals_decide_nothing(tmp_path: Path) -> None:
    """A ground station that sends heartbeats alone fits an offset of 256 s nearly as well as the right one."""
    agents = [Flown(tmp_path / str(number), number, wrong_s=1000.0 * number) for number in (1, 2)]
    Sender(*agents, steps=(1,)).until(3000)
    for agent in agents:
        agent.close()
    assert [run["offset_s"] for run in report(tmp_path)["clocks"]["runs"]] == [None, None]


def test_a_ground_that_received_the_end_of_a_long_run_places_it(tmp_path: Path) -> None:
    """A unit that fails again and again says the same each time, more often than all can be compared."""
    draw, ground = random.Random(3), Ground(tmp_path / "ground.jsonl")
    made = Flown(tmp_path / "log", wrong_s=20.0)
    for number in range(100):
        made.until(100.0 + 50.0 * number + draw.uniform(0, 30))
        if number >= 90:
            ground.text(made.now + 0.2, 1, 6, "nodes/node_1 gone")
        made.fail("nodes/node_1", lasts=4.0)
    made.close()
    ground.close()
    (clock,) = report(tmp_path)["clocks"]["runs"]
    assert (clock["applied"], clock["votes"]) == (True, 10)
    assert clock["offset_s"] == pytest.approx(-19.8, abs=0.01)


@pytest.mark.parametrize(("wrong_s", "steps"), [(-3600.0, (1, 1, 1, 2, 3)), (6.0, (1,))])
def test_an_agent_without_a_fault_is_compared_by_the_heartbeats_of_the_ground(
    tmp_path: Path, wrong_s: float, steps: tuple[int, ...]
) -> None:
    """The ground's record has those that it sent. At even intervals they correct some seconds."""
    agent, ground = Flown(tmp_path / "log", wrong_s=wrong_s), Ground(tmp_path / "ground.jsonl")
    sky = Sender(agent, steps=steps)
    sky.until(900)
    agent.close()
    ground.received([*sky.sent, *((at, 7, 1, number) for at, _, _, number in sky.sent)])
    ground.close()
    (clock,) = report(tmp_path)["clocks"]["runs"]
    assert clock["applied"] and clock["by"] == "heartbeats that the ground also received or sent"
    assert clock["offset_s"] == pytest.approx(-wrong_s, abs=clock["error_s"]) and clock["error_s"] < 0.6


def test_even_heartbeats_of_another_day_move_nothing(tmp_path: Path) -> None:
    """A ground station begins with the number 0 each day and sends nothing else: all frames agree, at the wrong offset."""
    ground = Ground(tmp_path / "ground.jsonl")
    for day in (0.0, 86_400.0):
        agent = Flown(tmp_path / f"{day:.0f}", start=day)
        sky = Sender(agent, steps=(1,))
        sky.until(day + 240.0)
        agent.close()
    ground.received(sky.sent)
    ground.close()
    (clock,) = report(tmp_path / "0", tmp_path / "ground.jsonl")["clocks"]["runs"]
    assert clock["offset_s"] is None
    (clock,) = report(tmp_path / "86400", tmp_path / "ground.jsonl")["clocks"]["runs"]
    assert clock["offset_s"] == pytest.approx(0.0, abs=0.1)


def test_a_sender_whose_frames_have_other_numbers_on_each_link_does_not_hide_another_one(tmp_path: Path) -> None:
    """An autopilot numbers its frames on each link: of three senders that both have, one agrees."""
    agent, ground = Flown(tmp_path / "log", wrong_s=-600.0), Ground(tmp_path / "ground.jsonl")
    sky, draw, other = Sender(agent), random.Random(9), list[tuple[float, int, int, int]]()
    for second in range(10, 900, 10):
        sky.until(float(second))
        for component in (1, 2):
            agent.receive(1, component, 8 * draw.randrange(32))
            other.append((agent.now, 1, component, 8 * draw.randrange(32)))
    agent.close()
    ground.received([*sky.sent, *other])
    ground.close()
    (clock,) = report(tmp_path)["clocks"]["runs"]
    assert clock["applied"] and clock["offset_s"] == pytest.approx(600.0, abs=0.5)
