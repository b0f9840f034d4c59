"""`state.json` after power failures, disk errors and changes by other programs."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from hypothesis import strategies as st

from phm.core.model import Fault, Layer, Level, Result, Slot, Stamp
from phm.recovery.fault_cases import AttemptRecord, PersistedCase, UnfinishedAction
from phm.recovery.ownership import Generation
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.persistence.state_codec import decode, encode
from phm.recovery.persistence.state_file import NAME, StateFile
from phm.testing import FakeClock
from tests.fuzz.hostile import messages
from tests.fuzz.targets import fuzzed

NOW = Stamp(1_800_000_000.0, 1000.0)
FAULT = Fault(
    "ab12-1",
    "container/app",
    Slot.CONTAINER,
    Layer.DOCKER,
    Result(Level.ERROR, "words", "brief", "exited", "app"),
    Stamp(NOW.utc - 5, 995.0),
    blocks=("nodes/a",),
    consequences=("F2",),
)
ATTEMPT = AttemptRecord(990.0, "container/app", "exited", "start", False, False, False)
STATE = PersistedState(
    (FAULT,),
    (FAULT,),
    RecoveryState(
        {"app": (ATTEMPT,)},
        {"ab12-1": PersistedCase(("reported",))},
        {"app": UnfinishedAction("ab12-1", ATTEMPT)},
        {"app": Generation("id", "2026", 990.0, None)},
    ),
)
DOCUMENT = encode(STATE, "boot", NOW)


@fuzzed("state.json", data=messages(DOCUMENT), boot=st.sampled_from(["boot", "another", ""]))
def test_any_file_is_read_or_renamed(data: bytes, boot: str) -> None:
    """PHM starts; an accepted state can be written and read again, and a rejected file is kept for inspection."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / NAME
        path.write_bytes(data)
        clock = FakeClock(mono=NOW.mono, utc=NOW.utc)
        file = StateFile(folder, clock, boot)
        state, problem = file.load(600.0)
        assert problem.isprintable()
        if problem:
            assert state == PersistedState()
            assert not path.exists()
            return
        again = json.loads(json.dumps(encode(state, boot, NOW), allow_nan=False))
        decode(again, boot, NOW, 600.0)
        file.save(state)
        assert file.load(600.0)[1] == ""
