"""Measurement of the load of the machine that all agents share."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from sitl.campaign import machine_load
from sitl.campaign.machine_load import MachineMeter, sample
from tests.fakes.until import until

BEFORE_S = 3600.0
"""Longer than a test may take."""
PRESSURE = "some avg10=3.00 avg60=0.00 avg300=0.00 total=1\nfull avg10=2.50 avg60=0.00 avg300=0.00 total=1\n"


def test_a_sample_has_the_load_of_this_machine(tmp_path: Path) -> None:
    """CPU, memory and disk in percent; the kernel's figure of I/O pressure, or None where it has none."""
    file = tmp_path / "io"
    file.write_text(PRESSURE, "ascii")
    found = sample(file)
    assert all(0 <= value <= 100 for value in (found.cpu, found.memory, found.disk))
    assert found.io_stalled == 2.5
    assert sample(tmp_path / "none").io_stalled is None


def test_samples_from_before_a_trial_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """An alarm at its beginning may be about the load before; older samples are dropped. Start and stop may come twice."""
    monkeypatch.setattr(machine_load, "BEFORE_S", BEFORE_S)
    meter = MachineMeter()
    meter.stop()
    meter.start()
    meter.start()
    until(meter.samples, "the first sample")
    meter.stop()
    meter.stop()
    until(lambda: not any(thread.name == "machine-load" for thread in threading.enumerate()), "the end of the thread")
    first = meter.samples()
    meter.begin()
    assert first and meter.samples() == first
    for each in first:
        each.mono -= BEFORE_S + 1
    meter.begin()
    assert meter.samples() == []
