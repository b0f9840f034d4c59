"""How the time of `phm report` grows with the size of the record: time, CPU, memory and rate for each size. With --flights and --page:
what a dataset of many flights and the page of many agents cost.

The records are generated (`sitl.bench.report_records`), and removed after each measurement. The command is that of a user, with all its
processes; memory is the most that they used together (proportional set size, asked five times a second). The files were written just
before, so most of them come from the memory of the kernel, if they fit there.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from sitl.bench import report_outputs, report_records
from sitl.bench.report_run import run
from sitl.harness.machine import machine

GB = 1_000_000_000
RESERVE = 2 * GB
"""So much of the disk stays free."""
MOST = 100_000
"""Flights of a dataset, agents of a page."""


@dataclass(frozen=True)
class Row:
    """text_bytes: of the record, not compressed. disk_bytes: of its files. cpu_s, memory_bytes: of all processes together."""

    form: str
    text_bytes: int
    disk_bytes: int
    files: int
    lines: int
    time_s: float
    cpu_s: float
    memory_bytes: int

    @property
    def mb_s(self) -> float:
        return self.text_bytes / 1e6 / self.time_s


def measure(form: str, size: int, agents: int, made: list[report_records.Line], where: Path) -> Row:
    """Generate, report, and remove. Raises SystemExit if there is no room, or the report fails."""
    with tempfile.TemporaryDirectory(prefix="phm-bench-report-", dir=where) as name:
        folder = Path(name) / "logs"
        report_records.write(folder, size, agents, compressed=form == "compressed", made=made)
        files = [path for path in folder.rglob("*") if path.is_file()]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with (Path(name) / "report.json").open("w+b") as output:
            time_s, memory = run([str(folder), "--json"], output.fileno())
            output.seek(0)
            said = json.load(output)["files"]
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if said["problems"]:
            raise SystemExit(f"the report could not read what was generated: {said['problems'][:3]}")
        disk = sum(path.stat().st_size for path in files)
        return Row(form, size, disk, len(files), said["lines"], time_s, cpu_s, memory)


def markdown(rows: Sequence[Row]) -> str:
    """A table for docs/reference/performance.md."""
    head = ("record", "on disk", "files", "lines", "time", "CPU", "rate", "memory")
    cells = [
        (
            f"{row.text_bytes / GB:g} GB, {row.form}",
            f"{row.disk_bytes / GB:.3g} GB",
            f"{row.files}",
            f"{row.lines / 1e6:.3g} million",
            f"{row.time_s:.1f} s",
            f"{row.cpu_s:.1f} s",
            f"{row.mb_s:.0f} MB/s",
            f"{row.memory_bytes / 1e6:.0f} MB",
        )
        for row in rows
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *cells))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="scripts/bench report", description=__doc__)
    parser.add_argument("--sizes", type=_sizes, default=[0.1, 1.0, 10.0], help="GB of text, such as 0.1,1,10")
    parser.add_argument("--forms", nargs="+", choices=("plain", "compressed"), default=["plain", "compressed"])
    parser.add_argument("--agents", type=int, default=8)
    parser.add_argument(
        "--folder", type=Path, default=Path(tempfile.gettempdir()), help="where the records are written"
    )
    parser.add_argument(
        "--flights",
        type=int,
        default=0,
        help="instead of --sizes: MTBF over a dataset of this many flights, such as 1000",
    )
    parser.add_argument(
        "--page",
        metavar="AGENTS",
        type=int,
        default=0,
        help="instead of --sizes: the page of an hour of this many agents",
    )
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    if min(given.flights, given.page) < 0 or max(given.flights, given.page) > MOST:
        parser.error(f"--flights and --page are from 1 to {MOST}")
    if given.flights or given.page:
        _outputs(given.flights, given.page, given.folder, given.json)
        return
    needed, free = int(max(given.sizes) * GB) + RESERVE, shutil.disk_usage(given.folder).free
    if free < needed:
        parser.error(
            f"{given.folder} has {free / GB:.1f} GB free, and {needed / GB:.1f} are needed: name another --folder"
        )
    made = report_records.pattern()
    rows = []
    for form in given.forms:
        for size in given.sizes:
            print(f"{size:g} GB, {form} ...", file=sys.stderr, flush=True)
            rows.append(measure(form, int(size * GB), given.agents, made, given.folder))
    if given.json:
        print(json.dumps({"machine": machine(), "rows": [{**asdict(row), "mb_s": row.mb_s} for row in rows]}, indent=2))
    else:
        print(f"{machine()}\n\n{markdown(rows)}")


def _outputs(flights: int, agents: int, where: Path, as_json: bool) -> None:
    found: dict[str, report_outputs.Dataset | report_outputs.Page] = {}
    if flights:
        found["dataset"] = report_outputs.dataset(flights, report_records.pattern(report_outputs.FLIGHT_S), where)
    if agents:
        found["page"] = report_outputs.page(agents, report_records.pattern(report_outputs.PAGE_S), where)
    if as_json:
        print(json.dumps({"machine": machine(), **{key: asdict(row) for key, row in found.items()}}, indent=2))
    else:
        print("\n".join((machine(), "", *map(report_outputs.text, found.values()))))


def _sizes(text: str) -> list[float]:
    found = [float(part) for part in text.split(",")]
    if not found or not all(0.0001 <= size <= 1000 for size in found):
        raise argparse.ArgumentTypeError("sizes are from 0.0001 to 1000 GB, such as 0.1,1,10")
    return found


if __name__ == "__main__":
    main()
