"""A vehicle and programs that connect to it; all of them end with the test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

import pytest

from tests.interop.programs import Program
from tests.interop.vehicle import Vehicle

SomeProgram = TypeVar("SomeProgram", bound=Program)


@pytest.fixture
def vehicle(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Vehicle]:
    """Unsigned, or signed with the passphrase that a test gives as the parameter `vehicle`."""
    made = Vehicle(tmp_path, getattr(request, "param", ""))
    yield made
    made.close()


@pytest.fixture
def ends(vehicle: Vehicle) -> Iterator[Callable[[SomeProgram], SomeProgram]]:
    """A function that registers a program: it ends with the test, before the vehicle."""
    with ExitStack() as stack:

        def end_with_the_test(program: SomeProgram) -> SomeProgram:
            stack.callback(program.close)
            return program

        yield end_with_the_test
