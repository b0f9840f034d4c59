"""Which faults a soak injects, and in which order."""

from __future__ import annotations

import itertools

from sitl.faults import all_faults
from sitl.soak.runner import draws, soak_faults


def test_only_faults_that_leave_phm_running_are_injected() -> None:
    """None of PHM itself, of its configuration or of the whole machine; each once before one comes again."""
    names = soak_faults(all_faults(), 8)
    assert not names.keys() & {
        "phm_killed",
        "phm_stopped",
        "power_loss",
        "engine_restarted",
        "cpu_hog",
        "clock_stepped",
    }
    assert {"node_killed", "container_killed", "gcs_radio_cut"} <= names.keys()
    drawn = list(itertools.islice(draws(names, 8, 5), 2 * len(names)))
    assert sorted(each.fault for each in drawn[: len(names)]) == sorted(names)
    assert drawn == list(itertools.islice(draws(names, 8, 5), 2 * len(names)))
    assert {each.agent for each in drawn} <= set(range(1, 9))
