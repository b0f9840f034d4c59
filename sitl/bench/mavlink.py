"""What PHM's reports cost on the link to the ground: as PHM sends them, and the same reports as JSON and as DiagnosticArray.

``scripts/bench mavlink`` runs entire swarms, each agent with the real reporters, budget and codec, on its own clock, so
the figures are the same on every machine. Whenever an agent reports its state (the refresh, or a change), the same report is
measured in the other forms, too: complete, as JSON or diagnostics are sent. Not measured with these are the heartbeats,
which carry the status word every few seconds, and what JSON or DDS put around a message.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from phm.core.model import UnitState
from phm.transport.priority import RADIO_BYTES_S, SWARM_BYTES_S, default_periods
from sitl.bench.report_sizes import FORMS, Size, load, sizes
from sitl.harness.machine import machine
from sitl.simulation.fleet import Fleet

REPORTS = Path(__file__).resolve().parents[1] / "recorded"
COUNTS = (1, 8, 30, 100)
SHARE = 0.1
SETTLE_S = 120.0
"""What an agent saved up at its start has left by then."""
SMALL, LARGE_SHARE = 30, 0.06
"""Up to this many agents stay within PHM's share of the radio, 5 %; larger swarms within 6 %."""


@dataclass(frozen=True)
class Row:
    """Bytes a second of all agents together on one link. `failing` of the `agents` have a fault.

    heartbeats, texts, tunnels: what of `mavlink` is what. json, deflated, diagnostics: the same reports in these forms;
    diagnostics is None where ROS is not installed. reports: per second, by which these are weighted.
    """

    agents: int
    failing: int
    heartbeat_s: float
    refresh_s: float
    mavlink: float
    heartbeats: float
    texts: float
    tunnels: float
    reports: float
    json: float
    deflated: float
    diagnostics: float | None


class Swarm:
    """A fleet whose agents say what the recorded reports say."""

    def __init__(
        self, count: int, healthy: Sequence[UnitState], bad: Sequence[UnitState], weights: dict[str, Size]
    ) -> None:
        self.fleet = Fleet(count, units=healthy, step_s=0.25 if count <= 30 else 1.0)
        self._bad, self._weights = bad, weights
        self.failing: set[int] = set()

    def fail(self, count: int) -> None:
        """This many agents, spread over the fleet, have the fault from now on."""
        numbers = list(self.fleet.agents)
        self.failing = set(numbers[:: max(1, len(numbers) // count)][:count])
        for number in self.failing:
            self.fleet.agents[number].tick(self._bad)

    def measure(self, seconds: float) -> Row:
        """Of the next `seconds` of the fleet's clock."""
        out, reported = self._out(), self._reported()
        self.fleet.run(seconds)
        left = {kind: count / seconds for kind, count in (self._out() - out).items()}
        weight: Counter[str] = Counter()
        count = 0
        for number, reports in (self._reported() - reported).items():
            size = self._weights["bad" if number in self.failing else "healthy"]
            count += reports
            for form in FORMS:
                weight[form] += reports * (getattr(size, form) or 0)
        agents = len(self.fleet.agents)
        known = self._weights["healthy"].diagnostics is not None
        return Row(
            agents,
            len(self.failing),
            *default_periods(agents),
            sum(left.values()),
            left.get("HEARTBEAT", 0.0),
            left.get("STATUSTEXT", 0.0),
            left.get("TUNNEL", 0.0),
            count / seconds,
            weight["json"] / seconds,
            weight["deflated"] / seconds,
            weight["diagnostics"] / seconds if known else None,
        )

    def _out(self) -> Counter[str]:
        return sum((agent.port.bytes_by for agent in self.fleet.agents.values()), Counter())

    def _reported(self) -> Counter[int]:
        """How often each agent reported its own state: refreshes, and changes of its units."""
        return Counter(
            {
                number: sum(
                    times for key, times in agent.port.sent_keys.items() if key == "refresh" or key in agent.units
                )
                for number, agent in self.fleet.agents.items()
            }
        )


def run(
    counts: Sequence[int], seconds: float, units: tuple[Sequence[UnitState], Sequence[UnitState]], console: Console
) -> Iterator[Row]:
    """Two rows for each count: nothing happens; a tenth of the agents, and at least one, has the fault."""
    weights = {"healthy": sizes(units[0]), "bad": sizes(units[1])}
    for count in counts:
        with console.status(f"{count} agents settle"):
            swarm = Swarm(count, *units, weights)
            swarm.fleet.run(SETTLE_S)
        for failing in (0, max(1, round(count * SHARE))):
            with console.status(f"{count} agents, {failing} of them failing"):
                if failing:
                    swarm.fail(failing)
                yield swarm.measure(seconds)


def table(rows: Sequence[Row]) -> Table:
    made = Table(
        title="Bytes a second of the whole swarm on one link",
        caption=f"MAVLink is heartbeats (HEARTBEAT), text (STATUSTEXT) and tunnel (TUNNEL); radio: its part of the {RADIO_BYTES_S:g} "
        "bytes/s that a 64 kbit/s radio carries; CDR: DiagnosticArray",
        box=box.SIMPLE,
        pad_edge=False,
        collapse_padding=True,
    )
    for name in ("agents", "failing", "heartbeats", "text", "tunnel", "MAVLink", "radio", "JSON", "deflated", "CDR"):
        made.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        others = (row.json, row.deflated, row.diagnostics)
        made.add_row(
            str(row.agents),
            str(row.failing),
            f"{row.heartbeats:.1f}",
            f"{row.texts:.1f}",
            f"{row.tunnels:.1f}",
            f"{row.mavlink:.1f}",
            f"{100 * row.mavlink / RADIO_BYTES_S:.1f} %",
            *("no ROS" if value is None else f"{value:.0f}" for value in others),
            end_section=bool(row.failing),
        )
    return made


def one_report(units: tuple[Sequence[UnitState], Sequence[UnitState]]) -> str:
    """Bytes of a single report in each form."""
    lines = []
    for name, states in zip(("healthy", "failing"), units, strict=True):
        size = sizes(states)
        cdr = "not known: no ROS here" if size.diagnostics is None else f"{size.diagnostics}"
        lines.append(
            f"One report of an agent that is {name}: {size.mavlink} bytes as status line, {size.json} as JSON, "
            f"{size.deflated} deflated, {cdr} as DiagnosticArray ({len(states)} units)."
        )
    return "\n".join(lines)


def verdict(rows: Sequence[Row]) -> list[str]:
    """The aims that are missed, in words (docs/reference/mavlink.md, The budget)."""
    missed = []
    for row in rows:
        aim = SWARM_BYTES_S if row.agents <= SMALL else RADIO_BYTES_S * LARGE_SHARE
        if row.mavlink > aim:
            missed.append(f"{row.agents} agents, {row.failing} failing: {row.mavlink:.0f} bytes/s, aim {aim:.0f}")
    return missed


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/bench mavlink",
        description=__doc__,
        epilog="Example: phm status --json > mine.json; scripts/bench mavlink --healthy mine.json --agents 8",
    )
    parser.add_argument("--agents", type=int, nargs="+", default=list(COUNTS), metavar="N", help="swarms (1 8 30 100)")
    parser.add_argument(
        "--seconds", type=float, default=240.0, metavar="S", help="of the swarm's clock that are weighed (240)"
    )
    parser.add_argument(
        "--healthy",
        type=Path,
        default=REPORTS / "healthy.json",
        metavar="FILE",
        help="the report of a healthy agent, of `phm status --json`",
    )
    parser.add_argument(
        "--failing", type=Path, default=REPORTS / "failing.json", metavar="FILE", help="the same of one with a fault"
    )
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    chosen = parser.parse_args(arguments)
    if not all(1 <= count <= 249 for count in chosen.agents) or chosen.seconds < 1:
        parser.error("--agents takes 1 to 249, --seconds 1 or more")
    console = Console(stderr=chosen.json)
    try:
        units = load(chosen.healthy), load(chosen.failing)
    except (OSError, ValueError, KeyError) as error:
        parser.error(f"a report cannot be read: {error}; `phm status --json` makes one")
    rows = []
    for row in run(chosen.agents, chosen.seconds, units, console):
        rows.append(row)
        console.print(f"{row.agents} agents, {row.failing} failing: {row.mavlink:.1f} bytes/s", style="dim")
    missed = verdict(rows)
    if chosen.json:
        weights = {name: asdict(sizes(states)) for name, states in zip(("healthy", "failing"), units, strict=True)}
        figures = {"machine": machine(), "seconds": chosen.seconds, "one_report": weights, "missed": missed}
        print(json.dumps({**figures, "figures": list(map(asdict, rows))}, indent=2))
    else:
        console.print(table(rows), one_report(units), sep="\n")
        console.print("All aims are met." if not missed else f"Missed: {'; '.join(missed)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
