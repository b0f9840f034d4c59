"""Seeds that no one chose: they follow from the id of the commit that is measured."""

from __future__ import annotations

import hashlib
import re
import subprocess
from pathlib import Path

from sitl.harness.compose_stack import ROOT

_COMMIT = re.compile(r"[0-9a-f]{40}(-dirty)?")


def seed_of(commit: str, index: int) -> int:
    """Seed `index` (from 0) of a commit: the first 32 bits of the SHA-256 of ``COMMIT/INDEX``, as a number.

    COMMIT is the full id. Anyone can compute it: ``printf COMMIT/0 | sha256sum | cut -c 1-8``, in hexadecimal.
    """
    return int(hashlib.sha256(f"{commit[:40]}/{index}".encode("ascii")).hexdigest()[:8], 16)


def checked_out() -> str:
    """The full id of the commit of this working tree, with ``-dirty`` if files differ from it. LookupError: not in git."""
    argv = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude", "*"]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=30, check=False)
    found = done.stdout.strip()
    if done.returncode or not _COMMIT.fullmatch(found):
        raise LookupError(
            f"the commit of {ROOT} is not known ({done.stderr.strip() or found}): give it with --commit ID"
        )
    return found


def in_history(commit: str, root: Path = ROOT) -> bool:
    """Whether a commit is the one of this working tree or one before it. True where that cannot be known: without a
    repository, or in one whose history is not complete.
    """

    def git(*argv: str) -> tuple[int, str]:
        done = subprocess.run(["git", "-C", str(root), *argv], capture_output=True, text=True, timeout=30, check=False)
        return done.returncode, done.stdout.strip()

    if git("rev-parse", "--is-shallow-repository") != (0, "false"):
        return True
    return git("merge-base", "--is-ancestor", commit, "HEAD")[0] == 0


def full_id(text: str) -> str:
    """A commit id given as an option. Raises ValueError for one that is not complete."""
    if not _COMMIT.fullmatch(text):
        raise ValueError(
            f"{text!r} is not the full id of a commit: 40 hexadecimal digits, as `git rev-parse HEAD` prints"
        )
    return text
