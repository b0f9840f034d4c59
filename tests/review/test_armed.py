"""Armed periods of a vehicle without a log of PHM: what the ground or its autopilot's own log says ends with that record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from phm.review import document, record
from phm.review.events import Event
from phm.review.external_entry import ExternalEntry
from phm.review.part import Part
from tests.review.records import T0, Ground, report

Said = tuple[float, bool | str]
DAY_S = 86400.0


def ground(folder: Path, run: str, begin: float, end: float, said: Sequence[Said]) -> None:
    """A record of the ground from begin to end. said: armed or not at a time, or lost while armed, 5 s after the last heartbeat."""
    folder.mkdir(exist_ok=True)
    made = Ground(folder / f"{run}.jsonl", run)
    lines = [(begin, "slots", {"agent": 3, "name": "A03", "slots": {"1": "OK"}}), (end, "snapshot", {})]
    lines += [(at, "snapshot", {}) for at in range(int(begin) + 60, int(end), 60)]
    for at, word in said:
        lost = word == "lost"
        body = {
            "presence": "lost" if lost else "alive",
            "armed": lost or word,
            "mode": 0,
            "age_s": 5.0 if lost else 0.0,
        }
        lines.append((at, "autopilot", {"system": 3, **body}))
    for at, kind, body in sorted(lines, key=lambda line: line[0]):
        made.event(at, kind, **body)
    made.close()


def armed(folder: Path) -> list[list[float]]:
    (agent,) = report(folder)["agents"]
    return [[begin - T0, end - T0] for begin, end in agent["armed"]]


def test_an_autopilot_that_is_lost_while_armed_was_armed_until_its_last_heartbeat(tmp_path: Path) -> None:
    """It crashed; its next battery is in an hour later."""
    ground(tmp_path, "g1", 0, 3700, [(1, False), (60, True), (300, "lost"), (3600, False)])
    assert armed(tmp_path) == [[60, 295]]


def test_an_autopilot_that_is_armed_when_it_is_received_again_was_so_in_the_gap(tmp_path: Path) -> None:
    """A gap of the link in flight does not make two flights."""
    ground(tmp_path, "g1", 0, 500, [(1, False), (60, True), (300, "lost"), (330, True), (400, False), (450, "lost")])
    assert armed(tmp_path) == [[60, 400]]


def test_an_armed_period_ends_with_the_record_of_the_ground(tmp_path: Path) -> None:
    """The next day's record begins disarmed."""
    ground(tmp_path, "g1", 0, 300, [(1, False), (60, True)])
    ground(tmp_path, "g2", DAY_S, DAY_S + 120, [(DAY_S + 1, False), (DAY_S + 60, True), (DAY_S + 100, False)])
    assert armed(tmp_path) == [[60, 300], [DAY_S + 60, DAY_S + 100]]


def test_a_ground_that_is_restarted_in_flight_or_recorded_beside_another_has_one_flight(tmp_path: Path) -> None:
    """g2 begins after the end of g1, and is armed from its first heartbeat on; g3 was there all the time."""
    ground(tmp_path / "a", "g1", 0, 300, [(1, False), (60, True)])
    ground(tmp_path / "a", "g2", 340, 500, [(341, True), (400, False)])
    assert armed(tmp_path / "a") == [[60, 400]]
    ground(tmp_path / "a", "g3", 10, 600, [(11, False), (60, True), (200, "lost"), (210, True), (402, False)])
    assert armed(tmp_path / "a") == [[60, 402]]


def test_an_armed_period_ends_with_the_last_entry_of_a_file_of_others() -> None:
    """The battery was lost in flight; the next file is that of the next day."""
    part = Part()
    for at, file, what, began in (
        (100, "1.bin", "arming", True),
        (160, "1.bin", "statustext", False),
        (DAY_S + 100, "2.bin", "arming", True),
        (DAY_S + 200, "2.bin", "arming", False),
    ):
        entry = ExternalEntry.of(Event(what, system=3, utc_s=T0 + at, text=what, began=began), file)
        assert entry is not None
        part.others.append(entry)
    (agent,) = document.build(record.build(part))["agents"]
    assert [[begin - T0, end - T0] for begin, end in agent["armed"]] == [[100, 160], [DAY_S + 100, DAY_S + 200]]


def test_a_disarming_that_only_another_ground_received_ends_the_period(tmp_path: Path) -> None:
    """The vehicle was out of range of one ground meanwhile."""
    ground(tmp_path, "g1", 0, 600, [(1, False), (60, True), (200, "lost"), (400, True), (450, False)])
    ground(tmp_path, "g2", 10, 600, [(11, False), (60, True), (250, False), (400, True), (450, False)])
    assert armed(tmp_path) == [[60, 250], [400, 450]]
