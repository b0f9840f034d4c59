"""Which fault of the history a line is about."""

from __future__ import annotations

from typing import Any

import pytest

from phm.gcs.web.history.faults import FaultEntry, FaultList


class Book:
    """A list of faults, and all of them that it has returned, by key. Each line is one second later."""

    def __init__(self) -> None:
        self._list, self._utc_s, self.found = FaultList(), 0.0, dict[str, FaultEntry]()

    def take(self, *texts: str, **body: Any) -> None:
        for text in texts:
            self._utc_s += 1
            kind = "refresh" if " 11111111" in text else "change"
            line = {
                "event": "text",
                "who": "A07",
                "utc_s": self._utc_s,
                "phm": True,
                "kind": kind,
                "text": text,
                **body,
            }
            self.found.update((one.key, one) for one in self._list.take(line))

    def open(self) -> list[str]:
        return [one.text for one in self.found.values() if one.open]

    def steps(self, text: str) -> list[str]:
        (fault,) = [one for one in self.found.values() if one.text == text]
        return [step["step"] for step in fault.steps]


@pytest.fixture
def book() -> Book:
    return Book()


@pytest.mark.parametrize(
    ("line", "step"),
    [
        ("A07 GAVE UP 2 ros_app exited 1 #17", "gave up"),
        ("A07 GAVE UP 2 router: ros_app exited 1 #17", "gave up"),
        ("A07 ADVISE 2 restart ros_app #17 60s", "advised"),
        ("A07 APPROVED 2 restart ros_app", "approved"),
        ("A07 EXPIRED 2 restart ros_app", "expired"),
    ],
)
def test_a_step_is_at_the_fault_that_its_line_names(book: Book, line: str, step: str) -> None:
    """Not at a newer one of the slot."""
    book.take("A07 FAIL 2 ros_app exited 1", "A07 FAIL 2 nav exited 1", line)
    assert book.steps("ros_app exited 1") == ["confirmed", step]
    assert book.steps("nav exited 1") == ["confirmed"]


def test_a_step_of_another_fault_keeps_the_number_of_a_fault(book: Book) -> None:
    """A line that names no known fault is at the newest one only if that is not known to be another."""
    book.take("A07 FAIL 2 ros_app exited 1", "A07 ADVISE 2 restart ros_app #17 60s", "A07 ADVISE 2 restart nav #18 60s")
    assert [(one.number, book.steps(one.text)) for one in book.found.values()] == [(17, ["confirmed", "advised"])]


def test_the_result_of_a_request_is_not_a_fault(book: Book) -> None:
    """It says nothing about the state of the container."""
    book.take("A07 WARN 2 restart refused: ros_app")
    assert not book.found


def test_a_refresh_with_one_failing_unit_ends_the_others(book: Book) -> None:
    """It knows exactly one."""
    book.take("A07 FAIL 12 A03 lost", "A07 FAIL 12 A03 A05 lost", "A07 FAIL 12 A05 lost", "A07 FAIL 6 node_1 dead")
    book.take("A07 FAIL 11111111 12 A05 lost +1")
    assert len(book.open()) == 4
    book.take("A07 FAIL 11111111 12 A05 lost")
    assert book.open() == ["A05 lost"]


def test_a_measured_value_that_changes_is_one_fault(book: Book) -> None:
    """Its end names the last value; a number that names something is another fault."""
    book.take("A07 WARN 9 disk / 86 %", "A07 WARN 9 disk / 88 %", "A07 WARN 9 disk / 94 %", "A07 WARN 9 camera 1 dead")
    book.take("A07 WARN 9 camera 2 dead")
    assert book.open() == ["disk / 94 %", "camera 1 dead", "camera 2 dead"]
    book.take("A07 OK 9 cleared: disk / 94 %")
    assert book.open() == ["camera 1 dead", "camera 2 dead"]


def test_only_a_heartbeat_with_ok_ends_a_fault(book: Book) -> None:
    """A slot that is unknown, as on hold, says nothing about its faults."""
    book.take("A07 FAIL 6 planner dead")
    book.take("", event="slots", changed={"6": ["ERROR", "STALE"]})
    assert (book.open(), book.steps("planner dead")) == (["planner dead"], ["confirmed"])
    book.take("", event="slots", changed={"6": ["STALE", "OK"]})
    assert (book.open(), book.steps("planner dead")) == ([], ["confirmed", "recovered"])
