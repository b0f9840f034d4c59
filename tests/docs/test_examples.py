"""Generated examples of the documents match the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs import examples

PAGES = [page for page in examples.pages() if examples.MARK.search(page.read_text("utf-8"))]
AGAIN = "run `PYTHONPATH=.:checks .venv/bin/python -m tests.docs.examples`"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(examples.ROOT)))
def test_examples_are_up_to_date(page: Path) -> None:
    """Each marked block contains the output of the code."""
    text = page.read_text("utf-8")
    assert text == examples.updated(text), AGAIN


def test_each_example_is_used() -> None:
    """No example is unused, and no document names one that does not exist."""
    used = {match[1] for page in PAGES for match in examples.MARK.findall(page.read_text("utf-8"))}
    assert used == set(examples.EXAMPLES)
