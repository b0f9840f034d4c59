"""The record of one trial, one JSON object per line: complete enough to compute and verify every metric.

Times are seconds on this machine's monotonic clock, which its containers share, so PHM's own timestamps, the injector's
and the ground's can be subtracted; `utc` is the same in seconds since 1970, for readers.
"""

from __future__ import annotations

import gzip
import json
import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

VERSION = 2
NOMINAL, OFF, TRIAL = "nominal", "off", "trial"
ABORTED = "aborted"
"""A run of one of the other kinds that an error or the operator ended. It is repeated, and in no figure."""
QUIET, BUSY = "quiet", "busy"
INTERRUPTION_S = 2.0
"""A restored world that is observed broken for less than this counts as restored: all agents share this machine, and while it is
overloaded the messages of healthy ones are late, too. Before, the world must have been restored for as long."""


@dataclass
class Injection:
    """One fault on one agent. `unit`: where PHM must report it on that agent, as `condition`; empty for a fault that
    cannot be reported. `level`: ``ERROR``, which opens a fault, or ``WARN``. `others`: where the other agents must
    report it, too, together one alarm.
    """

    fault: str
    title: str
    layer: str
    agent: int
    unit: str
    condition: str
    healable: bool
    level: str = "ERROR"
    others: str = ""
    earlier: str = ""
    """Condition of the alarm that PHM opens at `unit` before it knows `condition`; empty: none."""
    cause: str = ""
    group: str = ""
    blinds: bool = False
    """While it lasts, the ground cannot receive this agent, whether its PHM runs or not."""
    phm: bool = False
    """PHM itself is affected."""
    passes: bool = False
    """It ends without being cleared."""
    also: list[str] = field(default_factory=list)
    asked: float | None = None
    """When the injector began; side effects of the injection may be seen before the fault begins."""
    moment: float | None = None
    """When the fault began, never too late, as `Fault.inject` returns it; None: the injection failed."""
    cleared: float | None = None
    """When `clear` was called."""
    renewed: bool | None = None
    """Whether `clear` recreated or started a container of the agent; None: not recorded."""
    error: str = ""
    explained_by: str = ""
    """Name of another fault of this trial on this agent which causes this one's symptoms: its alarm reports both."""
    evidence: str = ""
    """The earliest event on board that reveals the fault."""
    evidence_s: float | None = None
    """Seconds from `moment` until that event, at the latest; None: not stated."""
    evidence_period_s: float = 0.0
    """Period of an event that is periodic: on average it is half of it earlier."""
    outage_s: float = 0.0
    """How long it keeps the Docker Engine from PHM."""
    hidden_s: float = 0.0
    """How long an outage beside it on the agent hides its evidence."""
    world_seen: bool = False
    """The injector observed the world: False or True was returned by the fault's `restored` at least once."""
    world_broken: float | None = None
    """When the world was first observed to be broken; None: never, e.g. since it was restored too quickly."""
    world: float | None = None
    """When the world was observed to be restored and stayed so until the fault was cleared; None: it was not."""
    interruptions: int | None = None
    """How often it was observed broken after that, each time for less than INTERRUPTION_S; None: not counted."""
    interrupted_s: float = 0.0
    """How long, together."""


@dataclass
class Alarm:
    """A fault that PHM opened, with its present outcome. `conditions`: all its conditions, in order. `brief`: its text
    in a STATUSTEXT; empty: not recorded.
    """

    agent: int
    unit: str
    slot: int
    fault: str
    mono: float
    conditions: list[str]
    summary: str
    closed: float | None = None
    outcome: str = "open"
    by: str = ""
    brief: str = ""


@dataclass
class RaisedWarning:
    """A unit became WARN; `conditions`: all conditions, in order; `ended`: when it was OK again; `brief` as in Alarm."""

    agent: int
    unit: str
    slot: int
    mono: float
    conditions: list[str]
    summary: str
    ended: float | None = None
    brief: str = ""


@dataclass
class Act:
    """One phase of a recovery."""

    agent: int
    unit: str
    action: str
    phase: str
    mono: float
    detail: str


@dataclass
class Start:
    """PHM was started; `report`: when its first report was complete."""

    agent: int
    mono: float
    report: float | None = None


@dataclass
class Summary:
    """A periodic report of one agent. `bad`: the units that it lists as WARN or ERROR; `mono`: when it was complete."""

    agent: int
    began: float
    bad: list[str] = field(default_factory=list)
    mono: float | None = None


@dataclass
class Load:
    """Load of the machine that all agents share, measured by the campaign, in percent: CPU, memory and disk in use,
    and the share of time in which all tasks waited for a disk; None: this kernel does not measure it.
    """

    mono: float
    cpu: float
    memory: float
    disk: float
    io_stalled: float | None = None


@dataclass
class Broken:
    """The application of an agent was observed not to work, whatever was injected: from the first such observation to the next one
    that it works, or to the last one of the trial.
    """

    agent: int
    began: float
    ended: float


@dataclass
class Line:
    """A STATUSTEXT that the ground received."""

    system: int
    severity: int
    text: str
    mono: float


@dataclass
class Cost:
    """Resources used by one agent's sidecar during `seconds` of a trial: the entire container, so health checks and
    processes that ended are included. Memory is the mean of the samples, `peak_mb` the largest resident one.
    """

    agent: int
    seconds: float
    cpu_s: float
    rss_mb: float
    pss_mb: float | None = None
    peak_mb: float | None = None


@dataclass
class Trial:
    """The events between `began` and `ended`, on all agents."""

    kind: str
    number: int
    agents: int
    began: float
    utc: float
    ended: float = 0.0
    heartbeat_s: float = 2.0
    injections: list[Injection] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)
    warned: list[RaisedWarning] = field(default_factory=list)
    acts: list[Act] = field(default_factory=list)
    starts: list[Start] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    heartbeats: dict[int, list[float]] = field(default_factory=dict)
    """Of each agent's PHM, as received by the ground; the first is the last one before `began`."""
    blind: list[tuple[int, float, float]] = field(default_factory=list)
    """Agent, from, to: when the ground could not have received that agent."""
    received: dict[int, int] = field(default_factory=dict)
    """Bytes of the frames from each agent's PHM that reached the ground between `began` and `ended`."""
    cost: list[Cost] = field(default_factory=list)
    healthy_after: float | None = None
    """When all agents were OK again; None: not within the limit."""
    summaries: list[Summary] = field(default_factory=list)
    machine: list[Load] = field(default_factory=list)
    broken: list[Broken] = field(default_factory=list)
    """Of all agents; empty, too, in records of before this was observed."""
    changed: list[str] = field(default_factory=list)
    """With recovery off: what changed nevertheless."""
    differences: list[dict[str, Any]] = field(default_factory=list)
    """What this trial changed on single agents before it began: as `setting["differences"]`, with `fault` and `agent`."""
    aborted: str = ""
    """Of an aborted run: its kind, and the error that ended it."""
    setting: dict[str, Any] = field(default_factory=dict)
    """Which campaign this trial belongs to: `seed` (a number), `index` (of the seed, from 0), `commit` (full id), `profile`
    (``tuned``, ``shipped``, ``as-found``), `load` (``quiet``, ``busy``), `agents`, `autopilot`, `interval_s`,
    `machine`, `day`, `planned` (the number of trials of this seed), and `differences` from what is shipped: objects with
    `of` (``configuration``, ``application`` or ``sidecar``), `key` (a path as in ``recovery.budget``), `shipped` and `here`, each
    None where the key is absent.
    """
    v: int = VERSION

    @property
    def seconds(self) -> float:
        return self.ended - self.began

    @property
    def machine_cpu(self) -> float | None:
        """Mean CPU in use between `began` and `ended`, in percent of all cores; None: not measured."""
        used = [each.cpu for each in self.machine if self.began <= each.mono <= self.ended]
        return sum(used) / len(used) if used else None

    @property
    def campaign(self) -> tuple[str, str, int]:
        """Profile, load and seed. One record can have the trials of several campaigns."""
        return (
            str(self.setting.get("profile", "")),
            str(self.setting.get("load", "")),
            int(self.setting.get("seed", 0)),
        )


_PARTS = {
    "injections": Injection,
    "alarms": Alarm,
    "warned": RaisedWarning,
    "acts": Act,
    "starts": Start,
    "lines": Line,
    "cost": Cost,
    "summaries": Summary,
    "machine": Load,
    "broken": Broken,
}


def to_json(trial: Trial) -> str:
    """One line, without its end."""
    return json.dumps(asdict(trial), allow_nan=False)


def from_json(line: str | bytes) -> Trial:
    """The trial of a line; unknown keys are ignored. Raises ValueError for anything but a trial of this version."""
    data = json.loads(line)
    if not isinstance(data, dict) or data.get("v") != VERSION:
        raise ValueError(f"not a trial of version {VERSION}")
    data.setdefault("broken", [])
    try:
        for key, part in _PARTS.items():
            data[key] = [_made(part, each) for each in data[key]]
        data["heartbeats"] = {int(agent): times for agent, times in data["heartbeats"].items()}
        data["received"] = {int(agent): size for agent, size in data["received"].items()}
        data["blind"] = [(agent, start, end) for agent, start, end in data["blind"]]
        trial: Trial = _made(Trial, data)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"a trial lacks something or has it wrong: {error}") from None
    return trial


def _made(part: Any, data: dict[str, Any]) -> Any:
    known = {each.name for each in fields(part)}
    return part(**{key: value for key, value in data.items() if key in known})


def load(path: Path) -> list[Trial]:
    """All complete trials of a file (``.gz``: compressed), oldest first; the last of several with one campaign, kind and number counts,
    but every aborted run. A line truncated by a kill is skipped. A missing file has none.
    """
    found: dict[tuple[object, ...], Trial] = {}
    content = path.read_bytes() if path.exists() else b""
    for line in (gzip.decompress(content) if path.suffix == ".gz" else content).splitlines():
        try:
            trial = from_json(line)
        except ValueError:
            continue
        key = (trial.campaign, trial.kind, trial.number, trial.utc if trial.kind == ABORTED else None)
        found.pop(key, None)
        found[key] = trial
    return list(found.values())


def append(path: Path, trial: Trial) -> None:
    """Append the trial to the file, synced to disk; a truncated last line stays separate."""
    with path.open("a+b") as stream:
        stream.seek(0, os.SEEK_END)
        torn = False
        if stream.tell():
            stream.seek(-1, os.SEEK_END)
            torn = stream.read(1) != b"\n"
        stream.write((b"\n" if torn else b"") + to_json(trial).encode("ascii") + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
