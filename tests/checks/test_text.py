"""Wording that the checks share."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from phm.api import error, ok, warn
from phm_checks import _text


@given(st.text(max_size=300), st.text(max_size=60))
def test_a_brief_is_at_most_38_printable_ascii_characters(subject: str, words: str) -> None:
    """Whatever external names and texts contain, the operator's line stays short and plain."""
    text = _text.brief(subject, words)
    assert len(text) <= _text.BRIEF_MAX
    assert text.isascii() and (not text or text.isprintable())


def test_a_long_name_keeps_its_end_and_the_verdict() -> None:
    """Compose names differ at the end, and the verdict matters most."""
    text = _text.brief("a_very_long_project_name-with-service-3", "exited 137")
    assert len(text) == _text.BRIEF_MAX
    assert text.startswith("..")
    assert text.endswith("-service-3 exited 137")


@given(st.text(max_size=2000))
def test_cleaned_text_is_one_printable_line(text: str) -> None:
    """Output of a container cannot break the log format of one line per event."""
    cleaned = _text.clean(text, 100)
    assert len(cleaned) <= 100
    assert cleaned.isprintable()


@pytest.mark.parametrize(
    ("first", "second", "near"),
    [
        ("/agent_1/node_1", "/agent_1/nod_1", True),
        ("/agent_1/node_1", "/agent_1/node_2", True),
        ("/agent_1/node_1", "/agent_1/ndoe_1", True),
        ("/agent_1/node_1", "/agent_1/node_11", True),
        ("/agent_1/node_1", "/agent_1/node_1", False),
        ("/agent_1/node_1", "/agent_1/planner", False),
    ],
)
def test_names_one_edit_apart_are_similar(first: str, second: str, near: bool) -> None:
    """Missing, changed, swapped and added characters are typing mistakes; equal names are not."""
    assert _text.one_edit_apart(first, second) is near
    assert _text.one_edit_apart(second, first) is near


def test_a_node_in_another_namespace_is_suggested() -> None:
    """A forgotten namespace is the most common reason for a missing node."""
    assert "/node_1" in _text.did_you_mean("/agent_1/node_1", ["/node_1", "/camera"])
    assert not _text.did_you_mean("/agent_1/node_1", ["/camera"])


def test_a_jittering_number_is_stable_in_text() -> None:
    """A brief that changes with each sample would be sent to the ground with each sample."""
    steady = _text.StableNumber(share=0.05)
    assert [steady.show("cpu", value) for value in (92.0, 93.0, 90.0, 99.0)] == [92.0, 92.0, 92.0, 99.0]
    steady.forget("cpu")
    assert steady.show("cpu", 97.0) == 97.0


def test_a_long_list_is_truncated_with_a_note() -> None:
    """A hundred missing files make one readable sentence."""
    assert _text.listed([f"f{i}" for i in range(9)]) == "f0, f1, f2, f3, f4 and 4 more"
    assert _text.listed([]) == "none"


@pytest.mark.parametrize(
    ("briefs", "text"),
    [
        (["a dead"], "a dead"),
        (["a dead", "b dead"], "a b dead"),
        (["a dead", "b slow"], "a dead (+1)"),
        (["a dead", "a dead"], "a dead (+1)"),
        (["a dead", "b dead", "c dead", "d dead"], "a dead (+3)"),
        ([f"{'x' * 20} dead", f"{'y' * 20} dead"], f"{'x' * 20} dead (+1)"),
        ([f"{'x' * 33} dead", "b slow"], f"{'x' * 33} (+1)"),
        (["", ""], ""),
    ],
)
def test_one_brief_for_several_findings(briefs: list[str], text: str) -> None:
    """Each further one changes it; what is less bad than the first does not."""
    findings = [error("", brief=brief, condition="bad") for brief in briefs]
    assert _text.combined([warn("", brief="e slow", condition="bad"), *findings, ok("f")]) == text
    assert len(text) <= _text.BRIEF_MAX


def test_several_findings_become_one_result() -> None:
    """It is the first of the worst, with the texts of all that are not OK."""
    dead = error("c is dead", brief="c dead", condition="dead", target="c")
    found = _text.merged([ok("a works"), warn("b is slow", brief="b slow", condition="slow"), dead], {"units": 3})
    assert found == error("b is slow. c is dead.", brief="c dead", condition="dead", target="c", values={"units": 3})
