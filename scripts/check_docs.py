"""Whether the documents keep up with the code, whether no file names a machine, and limits of source files.

Run by `scripts/check`. Prints every problem and ends with 1 when there is one.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

from phm.cli import VERBS
from phm.core.settings import Settings

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
SOURCE = re.compile(r"`((?:phm|checks|docker|config|tests|sitl|scripts)/[a-z0-9_/.-]+\.(?:py|yaml|json|xml))`")
GROUPS = ("phm.checks", "phm.reporters", "phm.actions")
# Written in parts, so that this file does not name what it forbids.
HOSTS = (
    ("py" + "pi", "org"),
    ("files", "python" + "hosted"),
    ("deb", "debian"),
    ("archive", "ubuntu"),
    ("registry", "npm" + "js"),
)
HOST = re.compile("|".join(re.escape(".".join(parts)) for parts in HOSTS))
MACHINE_PATH = re.compile(r"(?<![\w./-])/(?:{})/".format("|".join(("wo" + "rk", "ro" + "ot/\\.pyenv"))))
EXEMPT = {"LICENSE"}
WIDTH = 100
"""Columns of a line of prose; tables, code, pictures and links are longer where they must be."""
UNWRAPPED = ("|", "<", "![")
CELL_END = re.compile(r"(?<!\\)\|")
SEPARATOR = re.compile(r"\|(?: ?:?-+:? ?\|)+")
MAX_TEST_LINES = 500
UNFORMATTED = re.compile(r"# fmt: (?:skip|off)$", re.MULTILINE)
MAX_UNFORMATTED = 48
"""Statements that the formatter leaves unchanged: tables in code. The number may only fall."""


def tracked() -> list[Path]:
    """The files of the project: those git knows or would add."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=30,
    ).stdout
    return [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]


def broken_links(files: list[Path]) -> Iterator[str]:
    """Relative links in Markdown whose file or heading does not exist."""
    for path in files:
        if path.suffix != ".md":
            continue
        for target, heading in LINK.findall(path.read_text("utf-8")):
            if "://" in target or target.startswith("mailto:"):
                continue
            page = path.parent / target if target else path
            if not page.exists():
                yield f"{path.relative_to(ROOT)}: the link to {target} leads nowhere"
            elif heading and page.suffix == ".md" and heading not in headings(page):
                yield f"{path.relative_to(ROOT)}: {target}#{heading}: there is no such heading"


def missing_files(files: list[Path]) -> Iterator[str]:
    """Source files that Markdown names and that do not exist."""
    for path in files:
        if path.suffix == ".md":
            for name in SOURCE.findall(path.read_text("utf-8")):
                if not (ROOT / name).exists():
                    yield f"{path.relative_to(ROOT)}: there is no file {name}"


def headings(page: Path) -> set[str]:
    """The anchors of a page, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def long_lines(files: list[Path]) -> Iterator[str]:
    """Lines of prose that are wider than WIDTH. One long word, such as a link, may be."""
    for path in files:
        if path.suffix != ".md":
            continue
        code = False
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            code ^= line.lstrip().startswith("```")
            words = line.split()
            if not code and len(line) > WIDTH and len(words) > 1 and not words[0].startswith(UNWRAPPED):
                yield f"{path.relative_to(ROOT)}:{number}: {len(line)} columns, at most {WIDTH}"


def broken_tables(files: list[Path]) -> Iterator[str]:
    """Tables of Markdown without a header, e.g. after an empty line in one, and rows with another number of columns."""
    for path in files:
        if path.suffix != ".md":
            continue
        code, columns = False, 0
        lines = path.read_text("utf-8").splitlines()
        for number, line in enumerate(lines, 1):
            code ^= line.lstrip().startswith("```")
            if code or not line.startswith("|"):
                columns = 0
                continue
            cells = len(CELL_END.findall(line))
            if not columns and not (number < len(lines) and SEPARATOR.fullmatch(lines[number])):
                yield f"{path.relative_to(ROOT)}:{number}: a table without a header: remove an empty line above it, or add one"
            elif columns and cells != columns:
                yield f"{path.relative_to(ROOT)}:{number}: a row of {cells - 1} columns in a table of {columns - 1}"
            columns = columns or cells


def undocumented() -> Iterator[str]:
    """Verbs, entry points and sections of the configuration that no document mentions; phm.yaml is one, since it explains each key."""
    pages = [ROOT / "README.md", ROOT / "config" / "phm.yaml", *sorted((ROOT / "docs").glob("**/*.md"))]
    text = "\n".join(page.read_text("utf-8") for page in pages)
    for verb in VERBS:
        if f"phm {verb}" not in text:
            yield f"docs: the command `phm {verb}` is mentioned nowhere"
    for group in GROUPS:
        for point in distribution("phm-sidecar").entry_points.select(group=group):
            if not re.search(rf"\b{re.escape(point.name)}\b", text):
                yield f"docs: {point.name} of {group} is mentioned nowhere"
    for section in Settings.model_fields:
        if not re.search(rf"(`{section}[`.:]|^\s*#?{section}:)", text, re.MULTILINE):
            yield f"docs: the configuration's `{section}` is mentioned nowhere"


def machine_names(files: list[Path]) -> Iterator[str]:
    """Hosts of package registries and folders of one machine: they mean nothing on another."""
    for path in files:
        if path.name in EXEMPT:
            continue
        try:
            lines = path.read_text("utf-8").splitlines()
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(lines, 1):
            if HOST.search(line) or MACHINE_PATH.search(line):
                yield f"{path.relative_to(ROOT)}:{number}: names a registry's host or a folder of one machine"


def long_tests(files: list[Path]) -> Iterator[str]:
    """Modules of tests/ with more than MAX_TEST_LINES lines: split them by subject."""
    for path in files:
        name = path.relative_to(ROOT)
        if path.suffix == ".py" and name.parts[0] == "tests":
            lines = len(path.read_text("utf-8").splitlines())
            if lines > MAX_TEST_LINES:
                yield f"{name}: {lines} lines, at most {MAX_TEST_LINES}: split it by subject"


def unformatted(files: list[Path]) -> Iterator[str]:
    """More statements that are not formatted than MAX_UNFORMATTED."""
    count = sum(len(UNFORMATTED.findall(path.read_text("utf-8"))) for path in files if path.suffix == ".py")
    if count > MAX_UNFORMATTED:
        yield f"{count} statements have `fmt: skip`, at most {MAX_UNFORMATTED}: let the formatter do it"


def main() -> int:
    """Print all problems; 0 when there is none."""
    files = tracked()
    problems = [
        *broken_links(files),
        *missing_files(files),
        *long_lines(files),
        *broken_tables(files),
        *undocumented(),
        *machine_names(files),
        *long_tests(files),
        *unformatted(files),
    ]
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
