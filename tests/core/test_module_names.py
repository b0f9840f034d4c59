"""Names of modules: nouns of the field, so that a reader finds by search what a module has."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_VERBS = """
accept act add apply approve ask attach await begin build call cancel check choose clean clear close collect compare
compute connect convert copy create decide decode delete deliver detect do draw drop edit emit encode escalate evaluate
explain export fetch fill filter find fix follow forward gather generate get give handle heal hear hold import inject
inspect install join judge keep kill know learn leave listen load look make measure merge mount move notify observe open
pack parse patch play prepare print probe publish put read receive reconnect recover register relaunch release relieve
reload remove rename render reopen repair replace reply restart restore resume retry return run save say scan search see
select send set share show sign sort split start stop sum suspend take test track translate try unpack unpause update
use validate verify wait walk warn watch write
"""
VERBS = frozenset(_VERBS.split())
"""No module has one of these as its whole name. Words that this project uses as nouns are not listed: a report, a store."""
METAPHORS = frozenset(("air", "birth", "death", "door", "ear", "eyes", "hands", "lives", "mind", "mouth", "pilots"))
"""Those that scripts/words.yaml allows in sentences, where some have their usual meaning."""

NAMED_LIKE_COMMANDS = "phm/cli/"
"""`phm/cli/NAME.py` has the command `phm NAME`."""
NAMED_LIKE_ACTIONS = "phm/recovery/actions/"
"""`phm/recovery/actions/NAME.py` has the action that is called NAME in the configuration, the log and STATUSTEXT."""
EXEMPT = {
    "phm/core/settings/notify.py": "the section `notify` of the configuration",
    "phm/learn/": "the package of the command `phm learn`",
    "phm/reporters/notify.py": "the reporter of that section, under its name",
    "sitl/bench/load.py": "the noun: the load of a machine",
}


def names() -> Iterator[str]:
    """Paths of modules and packages; a package ends in a slash."""
    for folder in (ROOT / "phm", ROOT / "checks" / "phm_checks", ROOT / "sitl"):
        for file in folder.rglob("*.py"):
            path = file.relative_to(ROOT)
            yield path.parent.as_posix() + "/" if file.name == "__init__.py" else path.as_posix()


def bad(path: str) -> bool:
    """Only the last part: the module's own name, without the underscore of a private one."""
    return Path(path).stem.strip("_") in VERBS | METAPHORS


def test_no_module_is_called_by_a_bare_verb_or_a_metaphor() -> None:
    """`loader`, not `load`: a verb says nothing about what it is done to, and is in each search a hundred times."""
    found = {path for path in names() if bad(path) and not path.startswith((NAMED_LIKE_COMMANDS, NAMED_LIKE_ACTIONS))}
    assert sorted(found - EXEMPT.keys()) == []
    assert sorted(EXEMPT.keys() - found) == [], "these are no longer there: remove them from the list"


def test_modules_named_like_commands_and_actions_have_them() -> None:
    """A module with a verb in these folders is exempt because it has the command or the action of that name."""
    for path in (path for path in names() if bad(path) and path.endswith(".py")):
        text, name = (ROOT / path).read_text("utf-8"), Path(path).stem
        if path.startswith(NAMED_LIKE_ACTIONS):
            assert f'name = "{name}"' in text, path
        elif path.startswith(NAMED_LIKE_COMMANDS):
            defined = {node.name for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
            assert "command" in defined, path
