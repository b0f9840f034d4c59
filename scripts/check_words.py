"""Find words that PHM's vocabulary replaces by standard terms, in code, messages and documents.

Run by `scripts/check`. `scripts/words.yaml` has the words, the exceptions with their reasons, and under `rewrite` the
directories that still contain such words: at most the stated number each, which may only fall. `--report` prints counts
per directory and never fails, `--list PATH...` prints each hit, `--shrink` lowers the numbers to the present counts.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "scripts" / "words.yaml"
# `_`, digits and a change of case separate words: `word_at` and `isWord` both contain `word`.
BEGIN, END = r"(?:(?<![A-Za-z])|(?-i:(?<=[a-z])(?=[A-Z])))", r"(?!(?-i:[a-z]))"
BETWEEN = r"(?:[ _]|\s*\n[\s#>*]*)"


@dataclass(frozen=True)
class Hit:
    """One banned word in one file; `line` counts from 1."""

    path: str
    line: int
    word: str
    instead: str


class Rules:
    """The contents of `words.yaml`. Raises ValueError when the file is malformed."""

    def __init__(self, text: str) -> None:
        data = yaml.safe_load(text)
        self.instead: dict[str, str] = data["words"]
        self.skip: list[str] = [entry["path"] for entry in data["skip"]]
        self.rewrite: dict[str, int] = data["rewrite"] or {}
        self._allow: list[dict[str, str]] = data["allow"]
        words = (word.replace(" ", BETWEEN) for word in self.instead)
        self._pattern = re.compile("|".join(f"({BEGIN}(?:{word}){END})" for word in words), re.IGNORECASE)

    def skipped(self, path: str) -> bool:
        """Whether the file at `path`, relative to the repository, is not checked."""
        return any(path == entry or path.startswith(entry.rstrip("/") + "/") for entry in self.skip)

    def hits(self, path: str, text: str) -> list[Hit]:
        """All banned words in `text` that no exception permits."""
        allowed = [(hit.start(), hit.end()) for rule in self._for(path) for hit in re.finditer(rule["text"], text)]
        entries, found = list(self.instead.values()), []
        for match in self._pattern.finditer(text):
            if not any(begin <= match.start() and match.end() <= end for begin, end in allowed):
                line = text.count("\n", 0, match.start()) + 1
                found.append(Hit(path, line, match.group(), entries[(match.lastindex or 1) - 1]))
        return found

    def _for(self, path: str) -> list[dict[str, str]]:
        return [rule for rule in self._allow if path.startswith(rule.get("path", ""))]


def find(rules: Rules, only: list[str]) -> list[Hit]:
    """The hits in all tracked text files, or in those below the paths `only`."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "--", *only]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=30).stdout
    found: list[Hit] = []
    for name in sorted(filter(None, listed.split("\0"))):
        if rules.skipped(name) or not (ROOT / name).is_file():
            continue
        try:
            found += rules.hits(name, name + "\n" + (ROOT / name).read_text("utf-8"))
        except UnicodeDecodeError:
            continue
    return [Hit(hit.path, max(hit.line - 1, 1), hit.word, hit.instead) for hit in found]


def area(rules: Rules, path: str) -> str:
    """The longest entry under `rewrite` that contains the file; empty when none does."""
    return max((entry for entry in rules.rewrite if f"{path}/".startswith(f"{entry}/")), key=len, default="")


def judge(rules: Rules, hits: list[Hit]) -> list[str]:
    """The problems: each hit outside of `rewrite`, and each area with more hits than its number."""
    counts = Counter(area(rules, hit.path) for hit in hits)
    problems = [
        f"{hit.path}:{hit.line}: {' '.join(hit.word.split())!r}: use {hit.instead}"
        for hit in hits
        if not area(rules, hit.path)
    ]
    return problems + [
        f"{entry}: {counts[entry]} banned words, at most {number}: `scripts/check_words.py --list {entry}` shows them"
        for entry, number in rules.rewrite.items()
        if counts[entry] > number
    ]


def report(hits: list[Hit]) -> str:
    """Counts per directory with the most frequent words."""
    words: dict[str, Counter[str]] = {}
    for hit in hits:
        parts = hit.path.split("/")[:-1]
        words.setdefault("/".join(parts[:3]) or ".", Counter())[" ".join(hit.word.lower().split())] += 1
    rows = sorted(words.items(), key=lambda row: -row[1].total())
    lines = [f"{c.total():5} {where:32} {', '.join(f'{w} {n}' for w, n in c.most_common(8))}" for where, c in rows]
    return "\n".join([f"{len(hits):5} in all", *lines])


def shrink(rules: Rules, counts: Counter[str]) -> None:
    """Write lower counts under `rewrite`; entries without hits go away. No number rises."""
    kept = {path: min(number, counts[path]) for path, number in rules.rewrite.items() if counts[path]}
    head = LIST.read_text("utf-8").partition("\nrewrite:")[0]
    lines = "".join(f"  {path}: {number}\n" for path, number in sorted(kept.items()))
    LIST.write_text(f"{head}\nrewrite:\n{lines}" if lines else f"{head}\nrewrite: {{}}\n", "utf-8")


def main() -> int:
    """Print what is found; 1 when an area has more hits than it may have."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--report", action="store_true", help="print counts per directory; never fails")
    parser.add_argument("--shrink", action="store_true", help="lower the numbers under `rewrite` to the present counts")
    parser.add_argument("--list", nargs="+", default=[], metavar="PATH", help="print each hit below these paths")
    chosen = parser.parse_args()
    rules = Rules(LIST.read_text("utf-8"))
    hits = find(rules, chosen.list)
    if chosen.list:
        for hit in hits:
            print(f"{hit.path}:{hit.line}: {hit.word}: use {hit.instead}")
        return 0
    if chosen.report:
        print(report(hits))
        return 0
    if chosen.shrink:
        shrink(rules, Counter(area(rules, hit.path) for hit in hits))
        return 0
    problems = judge(rules, hits)
    print("\n".join(problems), end="\n" if problems else "")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
