"""Commands of the documents exist, with their options, scripts and files."""

from __future__ import annotations

import re
import shlex
from importlib.util import find_spec

import click
import pytest

from phm.cli import VERBS, group
from tests.docs.blocks import blocks
from tests.docs.examples import ROOT, pages

FOREIGN = frozenset(
    [
        "./waf",
        "arducopter",
        "bash",
        "cat",
        "cd",
        "chmod",
        "colcon",
        "cp",
        "curl",
        "cut",
        "docker",
        "echo",
        "export",
        "getent",
        "git",
        "grep",
        "groups",
        "id",
        "ip",
        "journalctl",
        "jq",
        "kill",
        "ls",
        "mavproxy.py",
        "mkdir",
        "mv",
        "nc",
        "pip",
        "printf",
        "pytest",
        "python3",
        "ros2",
        "scp",
        "sed",
        "sha256sum",
        "source",
        "stat",
        "sudo",
        "sysctl",
        "systemctl",
        "tail",
        "timedatectl",
        "touch",
        "udevadm",
        "usermod",
    ]
)
"""Programs that are not part of PHM: only PHM's files among their arguments are looked at."""
INLINE = re.compile(r"`(?:\$ )?((?:phm|scripts/\w+|python -m \w[\w.]*)(?: [^`\n]*)?)`")
FILES = re.compile(r"^(?:docker|config|scripts|docs|sitl|tests|phm|checks)/[\w./-]+$")
GENERATED = {"docker/agent.env", "docker/compose.override.yaml"}
"""Made by the reader."""


def simple_commands(line: str) -> list[list[str]]:
    """The words of each program that a line of shell starts, without redirections and assignments."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;()<>")
    lexer.whitespace_split, lexer.commenters = True, ""
    found: list[list[str]] = [[]]
    skip = False
    for word in lexer:
        if word.startswith("#"):
            break
        if skip:
            skip = False
        elif set(word) <= set("<>"):
            skip = True
        elif set(word) <= set("|&;()"):
            found.append([])
        elif found[-1] or not re.match(r"^\w+=", word):
            found[-1].append(word)
    return [words for words in found if words]


def console_lines() -> list[tuple[str, str]]:
    """Each typed line of the console blocks, continued lines joined."""
    lines = []
    for block in blocks("console", "bash"):
        text = block.text.replace("\\\n", " ")
        lines += [(str(block), line[2:]) for line in text.splitlines() if line.startswith("$ ")]
    return lines


def inline_lines() -> list[tuple[str, str]]:
    """Each command in backticks in the text."""
    found = []
    for page in pages():
        text = re.sub(r"^ *```.*?^ *```$", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
        found += [(str(page.relative_to(ROOT)), match.replace("\\|", "|")) for match in INLINE.findall(text)]
    return found


def problem(words: list[str]) -> str:
    """Why the command cannot be run, or an empty string."""
    program, arguments = words[0], words[1:]
    missing = [word for word in words if FILES.match(word) and word not in GENERATED and not (ROOT / word).exists()]
    if missing:
        return f"{missing[0]} does not exist"
    if program in (".venv/bin/python", ".venv-kilted/bin/python"):
        program = "python"
    if program == "phm":
        return of_phm(arguments)
    if program.startswith((".venv/bin/phm", "/opt/phm/")):
        return of_phm(arguments)
    if program == "docker" and "phm" in arguments:
        after = arguments[len(arguments) - arguments[::-1].index("phm") :]
        return of_phm(after) if after and arguments.count("phm") > 1 else ""
    if program == "python" and "-m" in arguments:
        module = arguments[arguments.index("-m") + 1]
        return "" if module.startswith("pytest") or find_spec(module) else f"there is no module {module}"
    if program == "python" or program in FOREIGN or program.startswith("scripts/"):
        return ""
    return f"{program} is not a program that the documents may name: see FOREIGN"


def of_phm(arguments: list[str]) -> str:
    """Whether click accepts these arguments: verb and options, not their values."""
    if not arguments or arguments[0] in ("--help", "-h", "-V", "--version") or arguments[0].isupper():
        return ""
    verb, given = arguments[0], [word for word in arguments[1:] if word != "..."]
    if verb not in VERBS:
        return "" if verb == "land" else f"there is no verb {verb}"
    with click.Context(group) as parent:
        command = group.get_command(parent, verb)
        assert command is not None
        if given and given[0] in getattr(command, "requests", {}):
            command, given = command.requests[given[0]], given[1:]  # type: ignore[attr-defined]
        context = click.Context(command, info_name=verb, parent=parent)
        try:
            command.make_parser(context).parse_args(given)
        except click.BadOptionUsage as error:
            return "" if "requires an argument" in error.message else error.message
        except click.UsageError as error:
            return error.message
    return ""


@pytest.mark.parametrize(("place", "line"), console_lines())
def test_a_console_line_can_be_run(place: str, line: str) -> None:
    """Verbs, options, modules, scripts and files exist."""
    for words in simple_commands(line):
        assert not problem(words), f"{place}: {line}: {problem(words)}"


@pytest.mark.parametrize(("place", "line"), inline_lines())
def test_a_command_in_the_text_can_be_run(place: str, line: str) -> None:
    """The same for commands in sentences and tables."""
    for words in simple_commands(line.replace("...", "")):
        assert not problem(words), f"{place}: {line}: {problem(words)}"


def test_the_verbs_of_the_group_are_the_documented_ones() -> None:
    """An unknown verb is rejected, so the tests above are effective."""
    assert of_phm(["statsu"]) and of_phm(["status", "--no-such-option"]) and not of_phm(["status", "--watch"])
