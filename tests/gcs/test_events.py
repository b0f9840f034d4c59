"""The lines of `phm gcs` that describe events."""

from __future__ import annotations

import pytest

from phm.core.model import Stamp
from phm.gcs.events import GcsEvent, describe


@pytest.mark.parametrize(("slots", "words"), [((2,), "1 slot becomes OK"), ((2, 3), "2 slots become OK")])
def test_slots_that_become_ok_are_counted(slots: tuple[int, ...], words: str) -> None:
    """Those that fail are named; for the others the number is enough."""
    changed = {str(slot): ("STALE", "OK") for slot in slots} | {"4": ("OK", "ERROR")}
    body = {"system": 1, "name": "A01", "state": "ACTIVE", "changed": changed}
    line = describe(GcsEvent(Stamp(0.0, 0.0), "slots", body))
    assert line.endswith(f" ACTIVE, slot 4 OK -> ERROR, {words}")
