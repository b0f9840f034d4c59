"""Every fenced block of the documents has a label out of a fixed list."""

from __future__ import annotations

import pytest

from tests.docs.blocks import Block, blocks

LABELS = frozenset({"console", "dockerfile", "json", "json5", "python", "sh", "sql", "text", "toml", "yaml"})


@pytest.mark.parametrize("block", blocks(), ids=str)
def test_a_block_has_a_known_label(block: Block) -> None:
    """A block without a label, or with a new one, is refused."""
    assert block.language in LABELS, f"{block}: the label {block.language!r} is none of {', '.join(sorted(LABELS))}"
