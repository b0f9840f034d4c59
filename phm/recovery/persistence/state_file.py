"""The state on the disk: `state_dir/state.json`, replaced atomically whenever something has changed.

Temporary file, fsync, rename, fsync of the folder; written by a thread of the bus, so that a slow or full disk never
delays recovery. An invalid file is renamed and reported, and PHM starts with an empty state.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.core.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, HoldChanged, Phase
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.persistence.state_codec import InvalidState, decode, encode
from phm.wire.status_file import place

NAME = "state.json"
MAX_BYTES = 4_000_000
KEPT_CORRUPT = 3
_ASIDE = re.compile(re.escape(NAME) + r"\.corrupt-\d{8}T\d{6}Z")
"""Only files that PHM renamed itself are removed, not an operator's copy."""
ALONG_S = 0.25
"""A change within this time of the last write waits for the next tick."""


class StateFile:
    """`state_dir/state.json`. Its methods raise only what they document."""

    def __init__(self, directory: str, clock: Clock, boot: str | None = None) -> None:
        self.path = Path(directory) / NAME
        self._clock = clock
        self._boot = place()["machine_boot"] if boot is None else boot

    def load(self, window_s: float) -> tuple[PersistedState, str]:
        """The state, empty when there is none, and a sentence when a file is invalid or cannot be read."""
        try:
            with self.path.open("rb") as stream:
                data = stream.read(MAX_BYTES + 1)
        except FileNotFoundError:
            return PersistedState(), ""
        except OSError as error:
            return (
                PersistedState(),
                f"cannot read {self.path}: {error.strerror or error}; PHM starts with an empty state",
            )
        try:
            return self._parse(data, window_s), ""
        except InvalidState as error:
            return PersistedState(), self._rename_invalid(str(error))

    def save(self, state: PersistedState) -> None:
        """Replace the file. Raises OSError."""
        data = json.dumps(encode(state, self._boot, self._clock.stamp()), separators=(",", ":")).encode("ascii")
        if len(data) > MAX_BYTES:
            raise OSError(f"the state has grown to {len(data)} bytes")
        directory = self.path.parent
        directory.mkdir(parents=True, exist_ok=True)
        temporary = directory / f"{NAME}.tmp"
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()  # a leftover of a power cut
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(self.path)
        folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _parse(self, data: bytes, window_s: float) -> PersistedState:
        if len(data) > MAX_BYTES:
            raise InvalidState(f"it is larger than {MAX_BYTES} bytes")
        try:
            document = json.loads(data)
        except (ValueError, RecursionError):
            raise InvalidState("it is not JSON") from None
        return decode(document, self._boot, self._clock.stamp(), window_s)

    def _rename_invalid(self, reason: str) -> str:
        utc = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(max(0.0, min(self._clock.utc(), 1e11))))
        aside = self.path.with_name(f"{NAME}.corrupt-{utc}")
        try:
            self.path.replace(aside)
        except OSError as error:
            return f"{self.path} is invalid ({reason}) and cannot be renamed: {error.strerror or error}"
        earlier = [entry for entry in self.path.parent.glob(f"{NAME}.corrupt-*") if _ASIDE.fullmatch(entry.name)]
        for old in sorted(earlier)[:-KEPT_CORRUPT]:
            with contextlib.suppress(OSError):  # e.g. a directory of that name
                old.unlink()
        return f"{self.path} is invalid ({reason}); renamed to {aside.name}, PHM starts with an empty state"


class StateWriter:
    """A subscriber of the bus that keeps the file up to date. All but `problem` runs in the bus's thread."""

    kinds = (FaultOpened, FaultClosed, ActionEvent, HoldChanged)
    period_s = 1.0

    def __init__(
        self, file: StateFile, pipeline: Pipeline, recovery: Callable[[], RecoveryState], clock: Clock
    ) -> None:
        self._file, self._pipeline, self._recovery, self._clock = file, pipeline, recovery, clock
        self._written: PersistedState | None = None
        self._tried_at = float("-inf")
        self._problem = ""

    @staticmethod
    def key(event: Event) -> str:
        """All events are equal: each means that something may have changed."""
        return "changed"

    def handle(self, event: Event) -> None:
        # An action that has begun must count even if PHM is killed, or the power fails, within the next moment.
        begins = isinstance(event, ActionEvent) and event.phase is Phase.STARTED
        if begins or self._clock.mono() - self._tried_at >= ALONG_S:
            self.tick()

    def tick(self) -> None:
        """Write when something has changed; an unwritable folder is tried again at each tick, and reported."""
        state = self.state()
        if state == self._written:
            return
        self._tried_at = self._clock.mono()
        try:
            self._file.save(state)
        except OSError as error:
            reason = error.strerror or error
            self._problem = (
                f"cannot write {self._file.path}: {reason}; faults and budgets do not survive a restart of PHM"
            )
        else:
            self._written, self._problem = state, ""

    def state(self) -> PersistedState:
        """The current state to keep. Thread-safe."""
        faults, given_up = plain(self._pipeline.open_faults()), plain(self._pipeline.given_up())
        return PersistedState(
            faults, given_up, self._recovery(), self._clock.steps.kept(), self._pipeline.fault_count()
        )

    def problem(self) -> str:
        return self._problem


def plain(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Faults without the numbers behind them, which change with each run and are not kept."""
    return tuple(replace(fault, result=replace(fault.result, values={})) for fault in faults)
