"""Properties of a campaign's plan for every seed."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given, strategies as st

from sitl.campaign.plan import SIZES, Class, fits, plan

NAMES = st.text("abcdefgh", min_size=1, max_size=4)
CLASSES = st.lists(
    st.builds(
        Class,
        name=NAMES,
        layer=st.sampled_from(("companion", "container", "ros", "link")),
        group=st.sampled_from(("app", "files", "host")),
        whole=st.booleans(),
        alone=st.booleans(),
    ),
    min_size=1,
    max_size=20,
    unique_by=lambda each: each.name,
)
SEEDS, AGENTS = st.integers(0, 10**6), st.integers(1, 10)


@given(SEEDS, AGENTS, CLASSES, st.integers(0, 30), st.integers(0, 30))
def test_a_seed_determines_the_campaign(seed: int, agents: int, classes: list[Class], few: int, more: int) -> None:
    """The same seed gives the same trials, and a longer campaign begins with the shorter one, so it can be resumed and
    extended.
    """
    short, long = (plan(seed, agents, trials, classes) for trials in sorted((few, more)))
    assert long[: len(short)] == short
    assert plan(seed, agents, len(long), list(reversed(classes))) == long


@given(SEEDS, AGENTS, CLASSES)
def test_simultaneous_faults_do_not_hide_each_other(seed: int, agents: int, classes: list[Class]) -> None:
    """No two faults of one group on one agent, and none beside one that affects the entire agent or swarm."""
    known = {each.name: each for each in classes}
    for number, trial in enumerate(plan(seed, agents, 24, classes), 1):
        assert trial.number == number
        assert 1 <= len(trial.draws) <= SIZES[(number - 1) % len(SIZES)]
        assert trial.kind == ("single" if len(trial.draws) == 1 else "compound")
        for place, draw in enumerate(trial.draws):
            assert 1 <= draw.agent <= agents
            others = [(known[each.fault], each.agent) for each in trial.draws[:place]]
            assert fits(known[draw.fault], draw.agent, others)
        if any(known[draw.fault].alone for draw in trial.draws):
            assert len(trial.draws) == 1


@given(SEEDS, CLASSES)
def test_every_class_is_drawn_in_turn(seed: int, classes: list[Class]) -> None:
    """In each layer no class is drawn a third time before all others were drawn once: a bag contains each class once."""
    layers = {each.name: each.layer for each in classes}
    drawn: Counter[str] = Counter()
    for trial in plan(seed, 8, 60, classes):
        for draw in trial.draws:
            drawn[draw.fault] += 1
            mine = [drawn[name] for name, layer in layers.items() if layer == layers[draw.fault]]
            assert max(mine) - min(mine) <= 1


@given(SEEDS, st.integers(2, 10))
def test_victims_alternate(seed: int, agents: int) -> None:
    """Consecutive single faults have different victims."""
    trials = plan(seed, agents, 40, [Class("a", "ros", "app")])
    assert len({draw.agent for trial in trials[: 2 * agents] for draw in trial.draws}) == agents


def test_different_seeds_give_different_campaigns() -> None:
    """The seed determines the order."""
    classes = [Class(f"fault_{number}", "ros", "app") for number in range(10)]
    assert len({plan(seed, 8, 20, classes) for seed in range(20)}) == 20


@pytest.mark.parametrize(
    ("agents", "trials", "classes"),
    [(0, 1, [Class("a", "ros", "app")]), (1, -1, [Class("a", "ros", "app")]), (1, 1, [])],
)
def test_invalid_plan_arguments_are_rejected(agents: int, trials: int, classes: list[Class]) -> None:
    """No agents, a negative number of trials or no classes raises an error."""
    with pytest.raises(ValueError, match="a campaign needs"):
        plan(1, agents, trials, classes)
