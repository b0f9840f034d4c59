"""The crafted log of PX4 is one: PX4's own library reads the same from it."""

from __future__ import annotations

from pathlib import Path

from pyulog import ULog

from phm.review import source_ulog
from phm.review.external_entry import plain
from phm.review.lines import FileSegment, Problems
from tests.review import crafted_ulog
from tests.review.records import T0


def test_pyulog_reads_the_same_states_and_texts(tmp_path: Path) -> None:
    """Arming states by their changes, and each text with its time since boot; the colours are removed here alone."""
    file = tmp_path / "1.ulg"
    file.write_bytes(crafted_ulog.log(T0 + 50))
    theirs = ULog(str(file))
    mine = list(source_ulog.read(FileSegment(str(file)), Problems()))
    boot = T0
    assert not theirs.file_corruption and theirs.initial_parameters["MAV_SYS_ID"] == mine[0].system == 7
    changes = theirs.get_dataset("vehicle_status").list_value_changes("arming_state")
    assert [(t / 1e6, state == 2) for t, state in changes[1:]] == [
        (round(event.utc_s - boot, 3), event.began) for event in mine if event.event == "arming"
    ]
    assert [(entry.timestamp / 1e6, plain(entry.message)) for entry in theirs.logged_messages] == [
        (round(event.utc_s - boot, 3), event.text) for event in mine if event.event == "statustext"
    ]
