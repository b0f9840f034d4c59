"""In all tests of the built-in checks, their results are as the scheduler accepts them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from phm import api
from phm.checking.registry import checks
from phm.checking.result_check import checked

Run = Callable[[api.Check, api.World], api.Result | Mapping[str, api.Result]]


@pytest.fixture(autouse=True)
def accepted_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """A result that is refused becomes STALE, which would hide what the check has found."""
    for check in checks().values():
        monkeypatch.setattr(check, "run", _verified(check.run))


def _verified(run: Run) -> Run:
    def verified(check: api.Check, world: api.World) -> api.Result | Mapping[str, api.Result]:
        answer = run(check, world)
        for result in [answer] if isinstance(answer, api.Result) else answer.values():
            assert checked(result) is result, checked(result).summary
        return answer

    return verified
