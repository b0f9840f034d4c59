"""A bench for each test of the ROS probe."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.fakes.ros_bench import Bench


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()
