"""The fenced code blocks of the documents."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass

from tests.docs.examples import MARK, ROOT, pages

FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """One fenced block; `generated`: its contents come from `tests.docs.examples`."""

    page: str
    line: int
    language: str
    text: str
    generated: bool

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(*languages: str) -> list[Block]:
    """All blocks of these languages, in all documents."""
    found = []
    for page in pages():
        text = page.read_text("utf-8")
        marked = [match.span() for match in MARK.finditer(text)]
        for match in FENCE.finditer(text):
            generated = any(begin <= match.start() < end for begin, end in marked)
            line = text.count("\n", 0, match.start()) + 1
            name = str(page.relative_to(ROOT))
            found.append(Block(name, line, match[2], textwrap.dedent(match[3]), generated))
    return [block for block in found if block.language in languages] if languages else found
