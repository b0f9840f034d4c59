"""DoctorContext for tests of `phm doctor`: nothing of this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phm.core.settings import Settings
from phm.doctor.context import DoctorContext
from phm.doctor.row import Row


def doctor_context(folder: Path, *, environ: dict[str, str] | None = None, **sections: Any) -> DoctorContext:
    """With an engine that does not exist, unless `docker` names one; /dev and /proc are folders of the test."""
    (folder / "dev").mkdir(exist_ok=True)
    (folder / "proc").mkdir(exist_ok=True)
    settings = Settings.model_validate(
        {
            "docker": {"socket": f"unix://{folder}/none.sock"},
            "host": {"dev_root": str(folder / "dev")},
            "pressure": {"cgroups": str(folder / "cgroup")},
            "log": {"directory": str(folder / "log")},
            "state_dir": str(folder / "state"),
            "run_dir": str(folder / "run"),
            **sections,
        }
    )
    made = DoctorContext(settings, environ=environ or {}, proc=folder / "proc", container_mark=folder / "mark")
    made.engine.timeout_s = 60.0  # the machine may be busy
    return made


def states(rows: list[Row]) -> dict[str, str]:
    """The state of each row, by name."""
    return {row.name: row.state for row in rows}


def row(rows: list[Row], name: str) -> Row:
    return next(row for row in rows if row.name == name)
