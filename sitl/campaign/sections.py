"""The sections of a campaign's report: tables with a title and an introduction. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from sitl.campaign import fault_rows, irregular, single_rows, table
from sitl.campaign.evidence import RATIO
from sitl.campaign.groups import Group
from sitl.campaign.table import Rows
from sitl.campaign.targets import short as missed_targets, slower
from sitl.campaign.verdict import FLOOR_S


@dataclass(frozen=True)
class Section:
    """A table, or a list of sentences where `head` is empty."""

    title: str
    words: str
    head: tuple[str, ...] = ()
    rows: Rows = field(default_factory=list)
    sentences: Sequence[str] = ()


def sections(groups: Sequence[Group]) -> list[Section]:
    """All of them, in order. Without trials there are none."""
    if not groups:
        return []
    first = groups[0]
    return [
        Section(
            "Beside the paper's Table 2",
            "Mean over the seeds ± half of the 95 % confidence interval (Student's t); one seed has no interval. "
            "Numbers without a unit are totals, except alarms per fault.",
            table.head("metric", groups, "paper, Table 2"),
            table.paper_comparison(groups),
        ),
        Section(
            "Spread over the seeds",
            "Standard deviation; smallest to largest value.",
            table.head("metric", groups),
            table.spreads(groups),
        ),
        Section(
            "What ended the faults",
            "The paper counts the faults that an action of its tool has ended. The share is of all injected faults.",
            table.head("ended by", groups),
            table.endings(groups),
        ),
        Section(
            "Both definitions",
            "Mean / p50 / p95 / max over all faults, and for how many of them it happened.",
            table.head("", groups),
            table.definitions(groups),
        ),
        Section(
            "Confirmed from outside",
            "PHM's record beside the injector's own observation of the world, before the fault was cleared. A recovery "
            "counts when both say that the fault is over, from the later of the two moments.",
            table.head("number of faults", groups),
            table.outside(groups),
        ),
        Section(
            "The only fault of an agent, and with others",
            "In three of eight trials two or three faults are on one agent, one after the other without a pause.",
            table.head("faults", groups),
            single_rows.rows(groups),
        ),
        Section(
            "Not in a mean or a count",
            "",
            table.head("what is left out", groups),
            [*table.left_out(groups), *irregular.rows(groups)],
        ),
        Section("Further figures", "", table.head("figure", groups), [*table.beyond(groups), *slower(groups)]),
        Section(
            "Differences from what is shipped",
            "Computed from the configuration and the application of each profile. `for FAULT`: in the trials of that "
            "fault alone, on the agent N that gets it.",
            fault_rows.DIFFERENCES,
            fault_rows.differences(groups),
        ),
        Section(
            f"Evidence limit ({first.name})",
            "The earliest moment at which anything on board could know of the fault, and the mean detection divided by "
            "its average: where the evidence is periodic, a fault begins at any moment of the period. A limit below "
            f"{FLOOR_S:g} s counts as {FLOOR_S:g} s. While the engine is away, the limit of what only the engine knows is its "
            f"return: a container's files, but not its end, which its cgroup shows. A ratio above {RATIO:g} needs an explanation, which holds up to the "
            "stated ratio. `disturbed`: between the fault and its detection, PHM of that agent reported a busy CPU "
            "(`host/cpu`) or that the Docker Engine does not respond, or acted on it for another fault. It waits for the CPU "
            "and the engine then, and reports no symptom that the load or the action explains.",
            fault_rows.EVIDENCE,
            fault_rows.evidence(first.all),
        ),
        Section(
            f"Classes of faults ({first.name})",
            "Seconds; one row for each class that was injected.",
            fault_rows.CLASSES,
            fault_rows.classes(first.all),
        ),
        Section(
            "Classes by profile and load",
            "Number injected: mean detection, number that an action has ended.",
            table.head("fault", groups, "layer"),
            fault_rows.classes_by_group(groups),
        ),
        Section(
            f"Injected fewer than {fault_rows.LEAST} times",
            "",
            sentences=fault_rows.rare(groups),
        ),
        Section("Not injected, and why", "", sentences=fault_rows.excluded(groups)),
        Section("What is not as it should be", "", sentences=problems(groups)),
        Section(
            f"Every injected fault ({first.name})",
            "Seconds; `paper`: by its definition. `scripts/campaign --report-only --html` shows the faults of all "
            "profiles and loads.",
            fault_rows.FAULTS,
            fault_rows.faults(first),
        ),
    ]


def problems(groups: Sequence[Group]) -> list[str]:
    """Missed targets, unexplained ratios, and the problems of single faults."""
    return [
        *missed_targets(groups),
        *(sentence for group in groups for sentence in fault_rows.unexplained(group)),
        *(sentence for group in groups for sentence in fault_rows.short(group)),
    ]
