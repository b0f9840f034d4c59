"""PHM itself, its Python, and the configuration."""

from __future__ import annotations

import platform
from collections.abc import Iterator

from phm import __version__
from phm.doctor.context import Surroundings
from phm.doctor.row import Row, limited, missing, ok


def rows(surroundings: Surroundings) -> Iterator[Row]:
    where = "in a container" if surroundings.in_container else "without a container"
    yield ok("version", f"PHM {__version__}, Python {platform.python_version()}, {where}")
    if surroundings.configuration:
        yield ok("configuration", f"{surroundings.configuration} is valid")
    elif surroundings.problem:
        yield missing("configuration", surroundings.problem, "correct the file; `phm validate` lists every problem")
    else:
        yield limited(
            "configuration", "none, so the defaults are examined", "`phm init` writes one; -c FILE names another"
        )
