"""Runs the groups of `phm doctor` side by side, each with a deadline."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping

from phm.doctor import clock, devices, engine, kernel, mavlink, permissions, program, ros, storage
from phm.doctor.context import DoctorContext
from phm.doctor.row import Row

Group = Callable[[DoctorContext], Iterable[Row]]

GROUPS: Mapping[str, Group] = {
    "phm": program.rows,
    "engine": engine.rows,
    "permissions": permissions.rows,
    "devices": devices.rows,
    "kernel": kernel.rows,
    "ros": ros.rows,
    "clock": clock.rows,
    "mavlink": mavlink.rows,
    "storage": storage.rows,
}
"""By the name of the group, in the order in which they are shown."""
LIMIT_S = 20.0
"""For a group: a start of rclpy on a busy Raspberry Pi takes several seconds."""


def examine(
    context: DoctorContext, groups: Mapping[str, Group] = GROUPS, limit_s: float = LIMIT_S
) -> dict[str, list[Row]]:
    """The rows of each group; a group that hangs or fails has one row that says so. Never raises."""
    found: dict[str, list[Row]] = {}
    threads = []
    for name, group in groups.items():
        thread = threading.Thread(target=_run, args=(name, group, context, found), name=f"doctor-{name}", daemon=True)
        thread.start()
        threads.append(thread)
    end = time.monotonic() + limit_s
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    late = Row("answer", "limited", f"not known within {limit_s:g} s", "run `phm doctor` again; if it stays, report it")
    return {name: found.get(name, [late]) for name in groups}


def _run(name: str, group: Group, context: DoctorContext, found: dict[str, list[Row]]) -> None:
    try:
        found[name] = list(group(context))
    except Exception as error:  # one group must not hide the others
        found[name] = [Row("answer", "limited", f"{type(error).__name__}: {error}", "report this as a defect of PHM")]
