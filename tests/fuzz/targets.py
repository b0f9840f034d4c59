"""The definition of a fuzz target: a check that accepts all data of its strategies. Each is a small file in this directory.

pytest runs a few hundred cases of each; `scripts/fuzz MINUTES` runs them for that time, with new seeds.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings, strategies as st

CASES = int(os.environ.get("PHM_FUZZ_CASES", "100"))
_QUIET = list(HealthCheck)


@dataclass
class Target:
    """cases: how many it has run so far in this process."""

    name: str
    check: Callable[..., None]
    strategies: dict[str, st.SearchStrategy[Any]]
    cases: int = 0

    def run(self, number: int, cases: int) -> None:
        """Run that many cases generated from a seed. Raises the error of the check, with its smallest case in the notes."""

        def counted(**made: Any) -> None:
            self.cases += 1
            self.check(**made)

        chosen = settings(
            max_examples=cases,
            deadline=None,
            database=None,
            suppress_health_check=_QUIET,
            print_blob=False,
            phases=(Phase.generate, Phase.shrink),
        )
        counted.__name__ = self.check.__name__
        seed(number)(chosen(given(**self.strategies)(counted)))()


def folder() -> str:
    """A directory for files that a target shares between its cases, removed with the process."""
    made = tempfile.mkdtemp(prefix="phm-fuzz-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


TARGETS: dict[str, Target] = {}


def fuzzed(name: str, **strategies: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Turn a check into a target and a test."""

    def wrap(check: Callable[..., None]) -> Callable[..., None]:
        TARGETS[name] = Target(name, check, strategies)
        chosen = settings(max_examples=CASES, deadline=None, suppress_health_check=_QUIET)
        test: Callable[..., None] = chosen(given(**strategies)(check))
        return test

    return wrap
