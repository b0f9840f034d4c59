"""Makes the files of a new check package from its name. Pure: the templates are in `phm/templates`."""

from __future__ import annotations

import keyword
import re
from collections.abc import Collection
from dataclasses import dataclass
from importlib.resources import files
from string import Template

from phm.core.model import Slot

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_LONGEST = 24
"""Of a name: with it, `brief` of the sample stays within the operator's line."""


class UnusableName(Exception):
    """The name cannot be that of a check; the message says why and what is allowed."""


@dataclass(frozen=True, slots=True)
class NewCheck:
    """What is to be made. Raises UnusableName.

    name:     of the check and its entry point.
    slot:     of its results in the status array.
    period_s: how often it runs, in seconds.
    action:   whether the package gets a recovery action, too.
    """

    name: str
    slot: Slot = Slot.USER_1
    period_s: float = 5.0
    action: bool = False

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or keyword.iskeyword(self.name) or keyword.iskeyword(self.check):
            raise UnusableName(
                f"{self.name!r} cannot be the name of a check: use a Python identifier of lower-case letters, digits and _, "
                "such as photo_queue"
            )
        if len(self.name) > _LONGEST:
            raise UnusableName(f"{self.name!r} is too long: use at most {_LONGEST} characters")

    @property
    def module(self) -> str:
        """The Python package."""
        return f"phm_{self.name}"

    @property
    def check(self) -> str:
        """The class of the check."""
        return "".join(part.capitalize() for part in self.name.split("_"))

    @property
    def action_name(self) -> str:
        """The action, as in a ladder."""
        return f"clean_{self.name}"

    @property
    def condition(self) -> str:
        """What the check reports, as in a ladder."""
        return f"{self.name}_full"


def refuse_taken(name: str, taken: Collection[str]) -> None:
    """Raises UnusableName for a name among those of the installed checks."""
    if name in taken:
        raise UnusableName(f"there is a check {name!r} already, see `phm checks`: choose another name")


def render(new: NewCheck) -> dict[str, str]:
    """The text of each file, by its path below the folder of the package."""
    words = {
        "name": new.name,
        "distribution": f"phm-{new.name.replace('_', '-').rstrip('-')}",
        "module": new.module,
        "check": new.check,
        "action": f"Clean{new.check}",
        "action_name": new.action_name,
        "condition": new.condition,
        "variable": f"PHM_{new.name.upper()}_FOLDER",
        "brief": new.name.replace("_", " ").strip(),
        "slot": new.slot.name,
        "period": repr(float(new.period_s)),
        "target": '\n                target=f"disk:{FOLDER}",' if new.action else "",
        "action_point": _action_point(new),
        "action_readme": _action_readme(new),
    }
    made = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"{new.module}/check.py": "check.py",
        f"tests/test_{new.name}.py": "test.py",
    }
    if new.action:
        made |= {f"{new.module}/action.py": "action.py", f"tests/test_{new.action_name}.py": "test_action.py"}
    texts = {path: Template(_template(source)).substitute(words) for path, source in made.items()}
    return {**texts, f"{new.module}/__init__.py": f'"""A check for PHM: {new.name}."""\n'}


def _action_point(new: NewCheck) -> str:
    if not new.action:
        return ""
    return f'\n[project.entry-points."phm.actions"]\n{new.action_name} = "{new.module}.action:Clean{new.check}"\n'


def _action_readme(new: NewCheck) -> str:
    if not new.action:
        return ""
    return (
        f"- `{new.module}/action.py`: the recovery action. PHM takes it when `phm.yaml` names it:\n\n"
        f"```yaml\nrecovery:\n  ladders: {{{new.condition}: [{new.action_name}]}}\n```\n"
    )


def _template(name: str) -> str:
    return (files("phm") / "templates" / f"new_check.{name}.in").read_text(encoding="utf-8")
