"""Plots of a campaign as self-contained SVG: no script, no font, no external file. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from html import escape

WIDTH, ROW, LEFT, RIGHT, TOP, BOTTOM = 900, 18, 270, 20, 34, 30
LOW_S, HIGH_S = 0.01, 100.0
TICKS_S = (0.01, 0.1, 1.0, 10.0, 100.0)
Marks = Sequence[tuple[str, Sequence[float]]]


def x_of(seconds: float) -> float:
    """The position of a time on the logarithmic axis; values off the axis are drawn at its ends."""
    part = math.log(min(max(seconds, LOW_S), HIGH_S) / LOW_S) / math.log(HIGH_S / LOW_S)
    return LEFT + part * (WIDTH - LEFT - RIGHT)


def strips(title: str, rows: Marks, lines: Sequence[tuple[str, float]] = ()) -> str:
    """One row of dots for each class, one dot per fault, on a logarithmic axis; `lines`: named times across all rows."""
    height = TOP + ROW * max(1, len(rows)) + BOTTOM
    body = [_axis(height), *(_line(name, seconds, height) for name, seconds in lines)]
    for place, (name, values) in enumerate(rows):
        y = TOP + ROW * (place + 0.5)
        body.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{escape(name)}</text>')
        body += [f'<circle cx="{x_of(value):.1f}" cy="{y:.1f}" r="4"/>' for value in values]
    return _svg(title, height, body)


def steps(title: str, curves: Marks, lines: Sequence[tuple[str, float]] = ()) -> str:
    """Share of the faults (0 to 100 %) done within a time, one curve for each name."""
    height, inner = 300, 300 - TOP - BOTTOM
    body = [_axis(height), *(_line(name, seconds, height) for name, seconds in lines)]
    for share in (0.0, 0.5, 0.95, 1.0):
        y = TOP + inner * (1 - share)
        body.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{100 * share:.0f} %</text>')
        body.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
    for place, (name, values) in enumerate(curves):
        path = _path(sorted(values), lambda share: TOP + inner * (1 - share))
        body.append(f'<path class="curve c{place}" d="{path}"/>')
        body.append(f'<text class="c{place}" x="10" y="{TOP + 14 + 18 * place}">{escape(name)} ({len(values)})</text>')
    return _svg(title, height, body)


def _path(ordered: Sequence[float], y_of: Callable[[float], float]) -> str:
    words = [f"M{LEFT:.1f} {y_of(0.0):.1f}"]
    for place, value in enumerate(ordered, 1):
        words.append(f"H{x_of(value):.1f} V{y_of(place / len(ordered)):.1f}")
    return " ".join(words)


def _axis(height: float) -> str:
    marks = "".join(
        f'<line class="grid" x1="{x_of(tick):.1f}" x2="{x_of(tick):.1f}" y1="{TOP}" y2="{height - BOTTOM}"/>'
        f'<text x="{x_of(tick):.1f}" y="{height - BOTTOM + 16}" text-anchor="middle">{tick:g} s</text>'
        for tick in TICKS_S
    )
    return f"<g>{marks}</g>"


def _line(name: str, seconds: float, height: float) -> str:
    x = f"{x_of(seconds):.1f}"
    return (
        f'<line class="mark" x1="{x}" x2="{x}" y1="{TOP}" y2="{height - BOTTOM}"/>'
        f'<text class="mark" x="{x}" y="{TOP - 6}" text-anchor="middle">{escape(name)}</text>'
    )


def _svg(title: str, height: float, body: Sequence[str]) -> str:
    inside = "\n".join(body)
    return (
        f'<svg viewBox="0 0 {WIDTH} {height:g}" role="img" xmlns="http://www.w3.org/2000/svg">'
        f"<title>{escape(title)}</title>\n{inside}\n</svg>"
    )
