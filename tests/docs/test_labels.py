"""Every fenced block of the documents has a checker: a test that runs it, or compares it with the code.

`CHECKERS` is the list. A checker is a test with the parameter `block`, and takes the blocks among its parameters; so a block
of a label whose blocks differ (`text`) has a checker when a test names it. Generated blocks have one together.
"""

from __future__ import annotations

from importlib import import_module

import pytest

from tests.docs import test_examples
from tests.docs.blocks import FENCED_LINE, Block, blocks
from tests.docs.examples import ROOT, pages
from tests.docs.walk import walked

TYPED = "test_commands.test_a_console_block_can_be_run"
SHOWN = "test_answers.test_the_program_prints_what_the_block_shows"
CHECKERS: dict[str, tuple[str, ...]] = {
    "console": (TYPED, SHOWN),
    "dockerfile": ("test_images.test_a_block_is_a_part_of_a_dockerfile",),
    "json": ("test_json.test_a_json_block_has_the_keys_of_the_code",),
    "json5": ("test_json5.test_the_router_accepts_the_block",),
    "python": ("test_python.test_a_python_block_imports_existing_names",),
    "sql": ("test_sql.test_the_query_has_the_answer_of_the_records",),
    "text": (
        "test_messages.test_a_message_is_the_one_of_the_code",
        "test_messages.test_a_line_is_in_the_log_of_the_example",
        "test_text.test_a_diagram_has_names_of_the_code",
        "test_text.test_the_console_of_mavproxy_names_what_phm_answers",
        "test_text.test_the_file_of_tokens_is_accepted",
        "test_text.test_the_line_is_the_first_of_the_shipped_file",
    ),
    "toml": ("test_python.test_an_entry_point_is_of_a_group_that_phm_reads",),
    "yaml": ("test_config.test_a_yaml_block_is_valid",),
}
"""By label: `FILE.FUNCTION` in this folder."""


def taken(checker: str) -> list[Block]:
    """The blocks among the parameters of a checker. Raises AttributeError when there is no such test."""
    file, _, function = checker.partition(".")
    marks = getattr(import_module(f"tests.docs.{file}"), function).pytestmark
    return [block for mark in marks if mark.name == "parametrize" and mark.args[0] == "block" for block in mark.args[1]]


def lacking(block: Block) -> str:
    """Why the block is not checked completely, or an empty string."""
    if block.generated:
        return "" if ROOT / block.page in test_examples.PAGES else "its page is not generated again"
    if block.language not in CHECKERS:
        return f"the label {block.language!r} is none of {', '.join(sorted(CHECKERS))}"
    found = [checker for checker in CHECKERS[block.language] if block in taken(checker)]
    if block.language == "console":
        shown = block.shown and not walked(block)
        return "" if TYPED in found and (SHOWN in found or not shown) else "no test runs it and compares what it shows"
    return "" if found else "no checker of CHECKERS takes it: write one, or generate the block"


@pytest.mark.parametrize("block", blocks(), ids=str)
def test_a_block_has_a_checker(block: Block) -> None:
    """A block that nothing runs, compares or generates is refused, also with a known label."""
    assert not lacking(block), f"{block}: {lacking(block)}"


@pytest.mark.parametrize("checker", [checker for row in CHECKERS.values() for checker in row])
def test_a_checker_exists_and_takes_a_block(checker: str) -> None:
    """A renamed test is not a checker, nor is one whose blocks have gone."""
    assert taken(checker), f"{checker} takes no block"


def test_no_block_escapes() -> None:
    """Each line that begins or ends a block is one of a found block, in every document."""
    fences = sum(len(FENCED_LINE.findall(page.read_text("utf-8"))) for page in pages())
    assert fences == 2 * len(blocks())


@pytest.mark.parametrize(
    ("language", "text"), [("sh", "ls"), ("", "x"), ("text", "free text"), ("console", "$ phm status\nnot so\n")]
)
def test_a_block_without_a_checker_is_found(language: str, text: str) -> None:
    """An unknown label, no label, a text that no test names, and a shown line that nothing compares."""
    assert lacking(Block("docs/index.md", 1, language, text, generated=False))
