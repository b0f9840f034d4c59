"""The pictures of `phm status`, `phm gcs` and `phm demo` can be made from real runs on this machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs.pictures import catalog, terminal_pictures
from tests.docs.pictures.agents import free_ports


@pytest.mark.long
def test_real_runs_show_what_the_captions_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault, the recovery of another one and a lost agent are in the tables, and in the drawings of them."""
    monkeypatch.setenv("PHM_DEMO_HOST", "false")  # the load of the machine that runs the tests is not shown
    folder, state = tmp_path / "pictures", tmp_path / "state"
    folder.mkdir()
    state.mkdir()
    terminal_pictures.take(state, folder, free_ports(), free_ports())
    catalog.check_files(folder, catalog.TERMINAL)
    for name in catalog.TERMINAL:
        catalog.check(name, "\n".join(catalog.svg_lines((folder / name).read_text("utf-8"))))
