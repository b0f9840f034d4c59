"""Text helpers that the checks share: sanitizing of external names and output, lists, and stable numbers.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from phm import api

UNNAMED = "(unnamed)"
NAMED = 3
"""Maximum number of subjects in a brief about several."""
BRIEF_MAX = 38
"""Maximum length of `Result.brief` in characters: what a STATUSTEXT leaves besides agent, word and slot."""


def clean(text: str, most: int = 200) -> str:
    """External text as one printable line of at most `most` characters."""
    line = " ".join("".join(char if char.isprintable() else " " for char in text[: most * 4]).split())
    return line if len(line) <= most else f"{line[: most - 3]}..."


def ending(text: str, most: int = 200) -> str:
    """As `clean`, but the start is cut off: the ends of paths differ more."""
    line = clean(text[-most * 4 :], most * 4)
    return line if len(line) <= most else f"...{line[3 - most :]}"


def brief(subject: str, words: str = "") -> str:
    """`subject words` in at most 38 ASCII characters. Cuts the start of the subject first: the ends of names differ more."""
    name = clean(subject).encode("ascii", "replace").decode()
    tail = clean(words).encode("ascii", "replace").decode()
    room = BRIEF_MAX - len(tail) - (1 if tail else 0)
    if len(name) > room:
        name = f"..{name[len(name) - max(room, 2) + 2 :]}" if room > 2 else ""
    return f"{name} {tail}".strip()[:BRIEF_MAX]


def combined(findings: Sequence[api.Result]) -> str:
    """One brief for several findings: `A03 A05 lost` if the same is wrong with up to NAMED subjects, else the first of the worst and the
    number of the others: `A03 lost (+4)`.

    PHM sends a changed brief to the ground, so that each further failure of a unit is reported. Findings that are less bad than the
    first one do not count.
    """
    first = api.worst(findings)
    briefs = [finding.brief for finding in findings if finding.level is first.level]
    if len(briefs) < 2 or not first.brief:
        return first.brief
    names = [text.partition(" ")[0] for text in briefs]
    words = {text.partition(" ")[2] for text in briefs}
    together = f"{' '.join(names)} {min(words)}"
    if len(words) == 1 and len(set(names)) == len(names) <= NAMED and len(together) <= BRIEF_MAX:
        return together
    more = f" (+{len(briefs) - 1})"  # not `+1` alone, which a refresh line has for further units
    return f"{first.brief[: BRIEF_MAX - len(more)].rstrip()}{more}"


def merged(findings: Sequence[api.Result], values: api.Values) -> api.Result:
    """The first of the worst findings, with the summaries of all that are not OK and one brief for them."""
    summary = joined([finding.summary for finding in findings if finding.level is not api.Level.OK])
    return replace(api.worst(findings), summary=summary, brief=combined(findings), values=values)


def last(name: str) -> str:
    """The last part of a path or a ROS name, which people use as its short name."""
    return name.rstrip("/").rpartition("/")[2] or name


def listed(names: Iterable[str], most: int = 5, *, cut: Callable[[str, int], str] = clean) -> str:
    """`a, b, c and 4 more`; `none` if there are none. An empty name becomes `(unnamed)`. cut: `clean` or `ending`."""
    every = [cut(name, 80) or UNNAMED for name in names]
    if not every:
        return "none"
    shown = ", ".join(every[:most])
    return shown if len(every) <= most else f"{shown} and {len(every) - most} more"


def span(seconds: float) -> str:
    """A readable duration: `0.4 s`, `12 s`, `5 min`."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 60:.0f} min"


def one_edit_apart(first: str, second: str) -> bool:
    """Whether one inserted, deleted, changed or swapped character turns one name into the other."""
    if first == second or abs(len(first) - len(second)) > 1:
        return False
    short, long = sorted((first, second), key=len)
    at = next((i for i, char in enumerate(short) if char != long[i]), len(short))
    if len(short) < len(long):
        return short[at:] == long[at + 1 :]
    swapped = short[:at] + short[at : at + 2][::-1] + short[at + 2 :]
    return short[at + 1 :] == long[at + 1 :] or swapped == long


def did_you_mean(wanted: str, there: Iterable[str]) -> str:
    """A sentence that suggests names one edit away or in another namespace; empty if there are none."""
    names = list(there)
    near = [name for name in names if one_edit_apart(wanted, name)]
    near += [name for name in names if name not in near and name != wanted and last(name) == last(wanted)]
    return f" Did you mean {listed(near, 3)}?" if near else ""


class StableNumber:
    """Keeps the number in a text unchanged until the value has moved by more than `share` of it.

    PHM sends a changed brief to the ground, so a jittering number must not change it at each reading.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._shown: dict[str, float] = {}

    def show(self, subject: str, value: float) -> float:
        """The number to show for `subject`. Subjects come from the configuration, so there are few."""
        shown = self._shown.get(subject)
        if shown is None or abs(value - shown) > self._share * abs(shown):
            self._shown[subject] = shown = value
        return shown

    def forget(self, subject: str) -> None:
        """Reset after the subject has recovered: the next number is shown unchanged."""
        self._shown.pop(subject, None)


def joined(sentences: Sequence[str]) -> str:
    """Findings as one text, each ending with a full stop."""
    return " ".join(text if text.endswith((".", "?", "!")) else f"{text}." for text in sentences)
