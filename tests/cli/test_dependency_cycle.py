"""A plug-in whose units depend on each other is a configuration error of each verb that builds checks."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm import api
from tests.cli.test_cli import invoke


class CyclicUnits(api.Check):
    """A plug-in whose units depend on each other."""

    name, slot, layer = "cyclic", api.Slot.USER_1, api.Layer.CUSTOM

    @property
    def units(self) -> tuple[api.Unit, ...]:
        return api.Unit("cyclic/a", needs=("cyclic/b",)), api.Unit("cyclic/b", needs=("cyclic/a",))

    def run(self, world: api.World) -> api.Result:
        return api.ok("never reached")


@pytest.mark.parametrize("verb", [("run",), ("once",), ("validate",), ("checks", "--graph")])
def test_a_dependency_cycle_of_units_is_a_configuration_error(
    verb: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One sentence that names the cycle, exit code 78."""
    monkeypatch.setattr("phm.runtime.configuration.checks", lambda: {"cyclic": CyclicUnits})
    file = tmp_path / "phm.yaml"
    file.write_text("agent: {id: 3}\n")
    result = invoke(*verb, "-c", str(file))
    assert result.exit_code == 78
    assert result.stderr.startswith(f"{file}: checks: dependency cycle: cyclic/")
