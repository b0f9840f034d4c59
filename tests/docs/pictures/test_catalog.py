"""The pictures of README and docs: each is shown with its text, is there, and shows what the text says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.examples import ROOT, pages
from tests.docs.pictures import catalog

IMAGE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
AGAIN = "run `scripts/demo --pictures`"


def shown() -> list[tuple[Path, str, Path]]:
    """Each picture in a document: the document, the alternative text, and the file."""
    found = []
    for page in pages():
        for alt, place in IMAGE.findall(page.read_text("utf-8")):
            if not place.startswith("https://"):
                found.append((page, " ".join(alt.split()), (page.parent / place).resolve()))
    return found


def test_each_picture_is_shown_and_each_shown_one_exists() -> None:
    """Files, catalog and documents have the same pictures."""
    files = set(catalog.FOLDER.iterdir())
    assert {path.name for path in files} == set(catalog.PICTURES)
    assert {path for _, _, path in shown()} == files


def test_the_alternative_text_is_what_the_picture_was_tested_for() -> None:
    """A picture has the text of the catalog wherever it is shown."""
    for page, alt, path in shown():
        assert alt == catalog.PICTURES[path.name].alt, page.relative_to(ROOT)


def test_files_are_small() -> None:
    catalog.check_files(catalog.FOLDER, catalog.PICTURES)


@pytest.mark.parametrize("name", catalog.TERMINAL)
def test_a_terminal_shows_what_its_caption_says(name: str) -> None:
    """Also nothing of the machine it was made on, and no font of another server."""
    svg = (catalog.FOLDER / name).read_text("utf-8")
    catalog.check(name, "\n".join(catalog.svg_lines(svg)))
    assert "url(http" not in svg, AGAIN
