"""The folder of faults: complete, named as its files, each expected at a unit that the demonstration watches."""

from __future__ import annotations

import inspect
import itertools
from pathlib import Path

import pytest

from phm.config import load
from sitl import faults, proof
from sitl.demo import STORY
from sitl.derived import derived, write
from sitl.faults.base import Fault

FILES = sorted(path.stem for path in Path(faults.__file__).parent.glob("*.py") if path.stem not in ("__init__", "base"))


def test_every_file_is_one_fault() -> None:
    """Each file gives exactly one fault, under the name of the file."""
    assert sorted(faults.all_faults()) == FILES


@pytest.mark.parametrize("name", FILES)
def test_a_fault_says_what_it_is(name: str) -> None:
    """A fault has a title, a unit, a way in, and an own way out."""
    fault = faults.all_faults()[name]
    assert fault.name == name
    assert fault.title.strip() == fault.title != ""
    assert "/" in fault.unit
    assert inspect.getdoc(type(fault))
    assert type(fault).clear is not Fault.clear


def test_titles_differ() -> None:
    """No two rows of a table have the same title."""
    titles = [fault.title for fault in faults.all_faults().values()]
    assert len(set(titles)) == len(titles)


def test_the_demonstration_and_the_proof_play_faults_that_exist() -> None:
    """The proof plays every fault exactly once; the demonstration some of them."""
    assert sorted(proof.ORDER) == FILES
    assert set(STORY) <= set(FILES)
    assert set(proof.LEFT_ALONE) <= set(FILES)


def test_neighbours_in_the_proof_break_different_units() -> None:
    """The same unit broken twice in a row could pass for one fault that came back."""
    units = [faults.all_faults()[name].unit for name in proof.ORDER]
    assert all(one != two for one, two in itertools.pairwise(units))


@pytest.mark.parametrize("mode", ["act", "advise", "off"])
def test_the_proof_has_a_valid_configuration(mode: str) -> None:
    """What is derived from the shipped file is a configuration without mistakes, in every mode and with relaunch."""
    for relaunch in (False, True):
        settings = load(write(proof.configuration(mode, relaunch=relaunch)))
        assert settings.recovery.mode == mode
        assert settings.recovery.budget > len(proof.ORDER)
        assert settings.containers[0].files[0].restore == "image"
        assert bool(settings.ros.nodes[0].relaunch) is relaunch


def test_deriving_refuses_what_is_not_there() -> None:
    """A line that the shipped configuration no longer has is an error, not a change that silently does nothing."""
    with pytest.raises(ValueError, match="0 times, expected once"):
        derived({"\n  budget: 6": "\n  budget: 7"})


def test_the_critical_file_is_the_one_of_the_image() -> None:
    """The content that the proof expects is the content that docker/Dockerfile writes."""
    from sitl.faults.file_deleted import CONTENT, CRITICAL

    written = CONTENT.decode().replace("\n", "\\n")
    dockerfile = (Path(faults.__file__).parents[2] / "docker" / "Dockerfile").read_text("utf-8")
    assert f"printf '{written}' >{CRITICAL}" in dockerfile
