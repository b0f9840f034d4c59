"""A ROS child without ROS, for tests of its supervision: implements the protocol and misbehaves on request.

    python tests/fakes/ros_child.py BEHAVIOUR [FOLDER]

Behaviours: `good`; `garbage` (good, between lines that are not messages); `long` (good, after a line of
several megabytes); `blind` (a snapshot, then only such lines);
`exit` (a snapshot, then code 3); `mute` (a snapshot, then nothing); `never` (nothing at all);
`crash` (SIGSEGV after a snapshot); `twice` (good, and lists its node twice); `stale_name` (the same, in the first child only);
`stubborn` (good, and ignores its closed input); `no_input` (good, and never reads);
`slow` (good, after a text for the log, and only once the file `go` is in FOLDER).
FOLDER gets a file per start.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import time
from pathlib import Path


def main(behaviour: str, folder: str = "") -> int:
    wanted = json.loads(sys.stdin.buffer.readline())
    if folder:
        Path(folder, str(os.getpid())).touch()
    first = not folder or len(list(Path(folder).iterdir())) == 1
    times = 2 if behaviour == "twice" or (behaviour == "stale_name" and first) else 1
    if behaviour == "never":
        return _wait_for_end()
    _before_the_first_snapshot(behaviour, Path(folder))
    began_s = time.monotonic()
    while True:
        _snapshot(wanted, time.monotonic() - began_s, times)
        if behaviour == "blind":
            return _blind()
        if behaviour == "garbage":
            _write(b'[WARN] stray library output\n\xff\xfe\n["graph"]\n[1,2]\n["tick",[NaN,{}]]\n\n')
        elif behaviour == "exit":
            sys.stderr.write("it went wrong\n")
            return 3
        elif behaviour == "mute":
            return _wait_for_end()
        elif behaviour == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if behaviour == "no_input":
            time.sleep(0.05)
            continue
        readable, _, _ = select.select([0], [], [], 0.05)
        if readable and behaviour != "stubborn" and not os.read(0, 100):
            return 0


def _before_the_first_snapshot(behaviour: str, folder: Path) -> None:
    if behaviour == "long":
        _write(b"x" * 3_000_000 + b"\n")
    elif behaviour == "slow":
        _write(b'["log",["one peer is unknown"]]\n')
        while not (folder / "go").exists():
            select.select([], [], [], 0.02)


def _snapshot(wanted: dict[str, object], up_s: float, times: int) -> None:
    topics = wanted["topics"]
    assert isinstance(topics, list)
    empty: list[object] = [[], [], None]
    picture = ["graph", [up_s, {"/a/n": times}, {t["name"]: empty for t in topics}, 1, True, [], 0.0, []]]
    _write(json.dumps(picture).encode() + b"\n")


def _write(data: bytes) -> None:
    while data:
        data = data[os.write(1, data) :]


def _blind() -> int:
    while not select.select([0], [], [], 0.1)[0]:
        _write(b"x" * 1_500_000 + b'\n["tick",[1.0,{},1,0.0]]\n')
    return 0


def _wait_for_end() -> int:
    while os.read(0, 100):
        pass
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
