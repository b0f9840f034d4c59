"""Commands of the documents are valid shell; their programs, options, scripts and files exist."""

from __future__ import annotations

import gzip
import re
import shlex
import subprocess
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import click
import pytest

from phm.cli import VERBS, group
from tests.docs.blocks import Block, blocks
from tests.docs.examples import ROOT, pages

FOREIGN = frozenset(
    [
        "./waf",
        "apt",
        "arducopter",
        "bash",
        "cat",
        "cd",
        "chmod",
        "chown",
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
        "mavlogdump.py",
        "mavproxy.py",
        "mkdir",
        "mv",
        "nc",
        "pip",
        "pipx",
        "printf",
        "pytest",
        "python3",
        "ros2",
        "scp",
        "sed",
        "sha256sum",
        "source",
        "ssh",
        "stat",
        "sysctl",
        "systemctl",
        "tail",
        "tee",
        "timedatectl",
        "touch",
        "udevadm",
        "ulog_messages",
        "useradd",
        "usermod",
    ]
)
"""Programs that are not part of PHM: only PHM's files among their arguments are looked at."""
LOGS = ROOT / "docs" / "reference" / "logs.md"
INLINE = re.compile(r"`(?:\$ )?((?:phm|scripts/\w+|python -m \w[\w.]*)(?: [^`\n]*)?)`")
FILES = re.compile(r"^(?:docker|config|scripts|docs|sitl|tests|phm|checks)/[\w./-]+$")
GENERATED = {"docker/agent.env", "docker/compose.override.yaml"}
"""Made by the reader."""
REPLACES = re.compile(r"(?:^|[&;] )(?:mv|cat) (\S+) (?:> )?\S+(?: *$| [&;])")
"""Puts one file in the place of another."""
OF_PYTEST = "--hypothesis-profile"
"""Options of pytest's plug-ins, for scripts that pass their arguments on."""


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


def typed(block: Block) -> list[str]:
    """Each typed line of a console block, continued lines joined."""
    text = block.text.replace("\\\n", " ")
    return [line[2:] for line in text.splitlines() if line.startswith("$ ")]


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
    if program == "sudo":
        return problem(arguments[2:] if arguments[:1] == ["-u"] else arguments)
    program = re.sub(r"^[\w./~-]+/bin/|^\$\(command -v (\w+)\)$", r"\1", program)  # of an environment
    if program == "phm":
        return of_phm(arguments)
    if program == "docker":
        return of_phm(in_container(arguments))
    if program == "python" and "-m" in arguments:
        at = arguments.index("-m") + 1
        return of_module(arguments[at], arguments[at + 1 :])
    if program.startswith("scripts/"):
        return of_script(program, arguments)
    if program == "python" or program in FOREIGN:
        return ""
    return f"{program} is not a program that the documents may name: see FOREIGN"


def in_container(arguments: list[str]) -> list[str]:
    """What `docker run`, `docker exec` and those of Compose pass to `phm`; empty: another command."""
    if "--entrypoint" in arguments:
        return []
    if "exec" in arguments and arguments.count("phm") > 1:
        return arguments[len(arguments) - arguments[::-1].index("phm") :]
    if "run" in arguments:
        starts = (at for at, word in enumerate(arguments) if re.fullmatch(r"phm|phm-sidecar(?::\w+)?", word))
        return next((arguments[at + 1 :] for at in starts if arguments[at - 1] != "--name"), [])
    return []


def of_module(module: str, arguments: list[str]) -> str:
    """Whether the module exists, and its source or that of its package names these options."""
    if module == "pytest":
        return ""
    return unknown(arguments, module_source(module), module)


def of_script(script: str, arguments: list[str]) -> str:
    """Whether the script, or the module that it starts, names these options."""
    text = (ROOT / script).read_text("utf-8")
    started = re.findall(r"-m (sitl[\w.]*|tests[\w.]*)", text)
    more = OF_PYTEST if "pytest" in text else ""
    return unknown(arguments, text + "".join(map(module_source, started)) + more, script)


def unknown(arguments: list[str], source: str, program: str) -> str:
    if not source:
        return f"there is no module {program}"
    options = [word.partition("=")[0] for word in arguments if word.startswith("--")]
    missing = [option for option in options if not re.search(rf"(?<![\w-]){option}(?![\w-])", source)]
    return f"{program} has no option {missing[0]}" if missing else ""


@cache
def module_source(module: str) -> str:
    """Its file and those beside and below it, of which one has the options; empty: there is no such module."""
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return ""
    return "".join(path.read_text("utf-8") for path in sorted(Path(spec.origin).parent.rglob("*.py")))


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


def unguarded(lines: list[str]) -> list[str]:
    """Lines that replace a file by the output of a command, also if the command failed and the output is empty."""
    written = {name for line in lines for name in re.findall(r"> (\S+)", line)}
    return [
        line
        for line in lines
        if any(name in written and f"> {name} && " not in line for name in REPLACES.findall(line))
    ]


@pytest.mark.parametrize("block", blocks("console"), ids=str)
def test_a_console_block_can_be_run(block: Block) -> None:
    """It has a typed line, bash can parse each, and verbs, options, modules, scripts and files exist."""
    lines = typed(block)
    assert lines, f"{block}: no line begins with `$ `: write the command, or label the block `text`"
    parsed = subprocess.run(["bash", "-n"], input="\n".join(lines), capture_output=True, text=True)
    assert (parsed.returncode, parsed.stderr) == (0, ""), f"{block}: {parsed.stderr}"
    for line in lines:
        for words in simple_commands(line):
            assert not problem(words), f"{block}: {line}: {problem(words)}"


@pytest.mark.parametrize(("place", "line"), inline_lines())
def test_a_command_in_the_text_can_be_run(place: str, line: str) -> None:
    """The same for commands in sentences and tables."""
    for words in simple_commands(line.replace("...", "")):
        assert not problem(words), f"{place}: {line}: {problem(words)}"


def test_the_shell_reads_a_record_with_its_rotated_files_in_order(tmp_path: Path) -> None:
    """The newest rotated file is not compressed yet, and 12 of them come in another order by their names alone."""
    record = {"": 13, ".1": 12} | {f".{number}.gz": 13 - number for number in range(2, 13)}
    for ending, number in record.items():
        line = b"%d\n" % number
        (tmp_path / f"phm.jsonl{ending}").write_bytes(gzip.compress(line) if ending.endswith(".gz") else line)
    pipes = re.findall(r"`((?:cat|ls|zcat) [^`]*phm\.jsonl[^`]*)`", LOGS.read_text("utf-8"))
    assert pipes, LOGS
    for pipe in pipes:
        command = pipe.partition(" | jq ")[0]
        done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, ""), pipe
        assert done.stdout.split() == [str(number) for number in range(1, 14)], pipe


def test_the_verbs_of_the_group_are_the_documented_ones() -> None:
    """An unknown verb is rejected, so the tests above are effective."""
    assert problem(shlex.split("docker compose run --rm phm validat")) and problem(["scripts/soak", "--hourly"])
    assert problem(shlex.split("python -m sitl up --agent-count 8")) and problem(["python", "-m", "sitl.none"])
    assert problem(shlex.split("sudo -u phm /opt/phm/bin/phm statsu")) and problem(["sudo", "unknown"])
    assert of_phm(["statsu"]) and of_phm(["status", "--no-such-option"]) and not of_phm(["status", "--watch"])


def test_the_output_of_a_command_that_failed_replaces_no_file() -> None:
    """It would be an empty `phm.yaml`, with which PHM does not start the next time: `&&` comes before `mv` or `cat`."""
    assert unguarded(["phm learn > a", "mv a b && phm reload"]) and unguarded(["phm learn > a", "cat a > b"])
    assert not unguarded(["phm learn > a && mv a b", "mv c d/", "cat c > d"])
    assert unguarded([line for block in blocks("console") for line in typed(block)]) == []


def test_commands_for_the_container_of_phm_are_those_of_compose() -> None:
    """Compose gives the container another name than that of its service, `phm`."""
    found = [
        str(page.relative_to(ROOT))
        for page in pages()
        if re.search(r"docker (?:logs|exec)(?: -\w+)* phm\b", page.read_text("utf-8"))
    ]
    assert found == []
