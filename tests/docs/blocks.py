"""The fenced code blocks of the documents."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from functools import cache

from tests.docs.examples import MARK, ROOT, pages

FENCED_LINE = re.compile(r"^ *(?:```|~~~)", re.MULTILINE)
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

    @property
    def shown(self) -> list[str]:
        """The lines of a console block that no one types: what a command prints."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [line for line in lines if not line.startswith("$ ")]


def blocks(*languages: str) -> list[Block]:
    """All blocks of these languages, in all documents."""
    return [block for block in _all() if block.language in languages] if languages else list(_all())


@cache
def _all() -> tuple[Block, ...]:
    found = []
    for page in pages():
        text = page.read_text("utf-8")
        marked = [match.span() for match in MARK.finditer(text)]
        for match in FENCE.finditer(text):
            generated = any(begin <= match.start() < end for begin, end in marked)
            line = text.count("\n", 0, match.start()) + 1
            name = str(page.relative_to(ROOT))
            found.append(Block(name, line, match[2], textwrap.dedent(match[3]), generated))
    return tuple(found)


def containing(language: str, words: str) -> list[Block]:
    """Blocks of a language, not generated, with these words, each of which one checker understands."""
    return [block for block in blocks(language) if words in block.text and not block.generated]
