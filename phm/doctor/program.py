"""PHM itself, its Python, and the configuration."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from shlex import quote

from phm import __version__
from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok


def rows(context: DoctorContext) -> Iterator[Row]:
    where = "in a container" if context.in_container else "without a container"
    yield ok("version", f"PHM {__version__}, Python {platform.python_version()}, {where}")
    if context.configuration:
        yield ok("configuration", f"{context.configuration} is valid")
    elif context.problem:
        command = f"phm validate -c {quote(context.invalid)}"
        yield missing("configuration", context.problem, f"correct the file; `{command}` lists every problem")
    else:
        yield limited(
            "configuration", "none, so the defaults are examined", "`phm init` writes one; -c FILE names another"
        )
