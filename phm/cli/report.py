"""`phm report`: what failed, when and why, from logs after the flight. Implemented in `phm.review`."""

from __future__ import annotations

import json
import re
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phm.cli.options import json_option
from phm.core.extras import remedy
from phm.wire.text import one_line

if TYPE_CHECKING:
    from phm.review.part import Part
    from phm.review.record import Record
    from phm.review.tables import Table

EXTRA = ("msgspec", "jinja2")


@click.command(epilog="Example: phm report logs/ ground.jsonl --html flight.html")
@click.argument("paths", metavar="PATH...", nargs=-1, required=True)
@click.option(
    "--flight", metavar="N", type=click.IntRange(min=1), help="Only the flight with this number in the report."
)
@click.option("--html", metavar="FILE", type=click.Path(dir_okay=False), help="Write one page that needs no network.")
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print the faults as CSV.")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print Markdown.")
@click.option(
    "--parquet",
    metavar="DIR",
    type=click.Path(file_okay=False),
    help="Add the record to a dataset of many flights, and show MTBF and MTTR of all of them.",
)
@click.option(
    "--mcap", metavar="FILE", type=click.Path(dir_okay=False), help="Write levels and faults as ROS 2 diagnostics."
)
@click.option("--compare", is_flag=True, help="Compare two records: exactly two PATHs; PATH#N is flight N of one.")
def command(
    paths: tuple[str, ...],
    flight: int | None,
    html: str | None,
    as_json: bool,
    as_csv: bool,
    as_markdown: bool,
    parquet: str | None,
    mcap: str | None,
    compare: bool,
) -> None:
    """Report what failed, when and why, from logs after the flight.

    PATH is a log of an agent, a record of `phm gcs --record`, a log of an autopilot, a recording of ROS 2, or a folder with any
    number of them; rotated and compressed files are included. Exit code 0; 1: there is no record, or not that flight.
    """
    if as_json + as_csv + as_markdown > 1:
        raise click.UsageError("choose one of --json, --csv and --markdown")
    if compare and (len(paths) != 2 or html or as_csv or parquet or mcap):
        raise click.UsageError("--compare takes two PATHs, and prints tables, --json or --markdown")
    _need((*EXTRA, *(() if parquet is None else ("duckdb", "pyarrow")), *(() if mcap is None else ("mcap",))))
    if compare:
        _compare(paths, flight, as_json, as_markdown)
        return
    made = _build(paths, flight, parquet, mcap)
    if html is not None:
        _write_page(made, html)
    if as_json:
        click.echo(json.dumps(made, separators=(",", ":")))
    elif as_csv or as_markdown:
        from phm.review import tables

        click.echo(tables.faults_csv(made) if as_csv else tables.markdown(made), nl=False)
    else:
        _show(made)
        if html is not None:
            click.echo(f"page: {html}")
        if mcap is not None:
            click.echo(f"recording: {mcap}")


def _build(
    paths: tuple[str, ...], flight: int | None, dataset: str | None = None, recording: str | None = None
) -> dict[str, Any]:
    """The document of these records, which are added to the dataset and written as a recording; exits with 1 when there is none."""
    from phm.review import document, record

    merged = record.build(_read(paths))
    if not merged.agents and not merged.grounds:
        raise click.ClickException(_nothing_read(paths, merged))
    try:
        made = document.build(merged, flight)
    except document.NoFlight as error:
        raise click.ClickException(str(error)) from None
    if dataset is not None:
        made["dataset"] = _add(merged, dataset)
    if recording is not None:
        _write_recording(merged, made, recording)
    return made


def _nothing_read(paths: tuple[str, ...], merged: Record) -> str:
    """Why files with the right names are no record: a report of nothing would read as if nothing had failed."""
    problems = merged.part.problems.found.items()
    found = [f"{path}{f':{line}' if line else ''}: {what}" for (what, path), (_, line) in problems]
    return one_line(f"no line of a record in {', '.join(paths)}: {'; '.join(found[:3]) or 'the files are empty'}")


def _add(merged: Record, dataset: str) -> dict[str, Any]:
    """Add to the dataset; its MTBF and MTTR."""
    import duckdb
    import pyarrow as pa

    from phm.review import parquet

    try:
        return {"folder": dataset, "rows": parquet.write(merged, dataset), "checks": parquet.rates(dataset)}
    except (OSError, pa.ArrowException, duckdb.Error, parquet.DatasetError) as error:
        raise click.ClickException(f"dataset {dataset}: {one_line(str(error))}") from None


def _compare(paths: tuple[str, ...], flight: int | None, as_json: bool, as_markdown: bool) -> None:
    from phm.review import comparison, comparison_text, tables

    first, second = (_build((path,), number or flight) for path, number in map(_with_flight, paths))
    made = comparison.build(first, second)
    said, shown = comparison_text.sentences(made), comparison_text.tables(made)
    if as_json:
        click.echo(json.dumps(made, separators=(",", ":")))
    elif as_markdown:
        click.echo(tables.markdown_of("Comparison", said, shown), nl=False)
    else:
        _print(said, shown)


def _with_flight(path: str) -> tuple[str, int | None]:
    """``logs#2`` is flight 2 of logs, unless there is a file of that name."""
    name, sign, number = path.rpartition("#")
    if sign and re.fullmatch(r"[1-9][0-9]{0,8}", number) and not Path(path).exists():
        return name, int(number)
    return path, None


def _need(modules: tuple[str, ...]) -> None:
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise click.ClickException(
            f"phm report needs {', '.join(missing)}: {remedy('report')} (docs/reference/report.md)"
        )


def _read(paths: tuple[str, ...]) -> Part:
    """Read all files, with a progress bar on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

    from phm.review import record_reader

    try:
        found = record_reader.find(paths)
    except record_reader.NoRecord as error:
        raise click.ClickException(str(error)) from None
    console = Console(stderr=True)
    columns = (TextColumn("reading"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=found.bytes)
        return record_reader.read(found, lambda count: bar.advance(task, count))


def _write_recording(merged: Record, made: dict[str, Any], path: str) -> None:
    from phm.review import mcap_file

    try:
        mcap_file.write(merged, made, path)
    except OSError as error:
        raise click.ClickException(f"cannot write {path}: {error.strerror}") from None


def _write_page(made: dict[str, Any], path: str) -> None:
    from phm.review import page

    try:
        Path(path).write_text(page.render(made), "utf-8")
    except OSError as error:
        raise click.ClickException(f"cannot write {path}: {error.strerror}") from None


def _show(made: dict[str, Any]) -> None:
    from phm.review import tables

    missing = made["clocks"]["missing"]
    _print([*made["sentences"], *([f"Times: {missing}."] if missing else [])], tables.tables(made))


def _print(sentences: list[str], shown: list[Table]) -> None:
    from rich import table
    from rich.text import Text

    from phm.cli import terminal

    target = terminal.console()
    for sentence in sentences:
        target.print(Text(one_line(sentence)))
    for title, head, rows in shown:
        made = table.Table(*head, title=title, title_justify="left", box=None, pad_edge=False)
        for row in rows:
            made.add_row(*(Text(cell) for cell in row))
        target.print()
        target.print(made)
