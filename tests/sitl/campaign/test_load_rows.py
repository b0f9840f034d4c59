"""Rows about load: aims on a busy machine, what lasts, and alarms with nothing injected."""

from __future__ import annotations

from sitl.campaign.groups import groups
from sitl.campaign.table import beyond, outside
from sitl.campaign.targets import evaluated, slower
from sitl.campaign.trial import NOMINAL, Load, Trial
from tests.fakes.campaign_trials import T0, alarm, injection, trial


def test_a_class_of_the_quiet_group_alone_does_not_change_the_aim_of_the_busy_one() -> None:
    """The times under load are compared class by class: a quiet group with a slow fault that the other lacks changes nothing."""

    def made(load: str, number: int, after: float, fault: str) -> Trial:
        setting = {"profile": "shipped", "load": load, "seed": 1}
        return trial(
            number=number, injections=[injection(fault=fault, title=fault)], alarms=[alarm(after)], setting=setting
        )

    quiet = [made("quiet", 1, 0.4, "a"), made("quiet", 2, 1.0, "b")]
    busy = [
        made("busy", 1, 0.7, "a"),
        *(made("busy", number, 2.1, "b") for number in (2, 3)),
        made("busy", 4, 50.0, "c"),
    ]
    aims = []
    for more in ([], [made("quiet", 3, 60.0, "slow")]):
        found = groups([*quiet, *more, *busy])
        (each,) = (each for each in evaluated(found[1], found) if each.metric.name == "Fault detection, mean")
        aims.append((each.aim, each.met))
        assert slower(found)[0][1:] == ("-", "1 of 2"), "only b: 2.1 s after 1.0 s"
    assert aims == [("<= twice quiet, by class (2 in both): 1.40 s of 1.40 s", True)] * 2


def test_what_both_say_to_last_is_about_healable_faults_first() -> None:
    """A fault that nothing on board can end lasts as it was injected, which the injector mostly reads from its own setting."""
    lasting = [injection(healable=healable, world=None) for healable in (True, False, False)]
    found = groups([trial(number=n, injections=[each], alarms=[alarm(0.4)], acts=[]) for n, each in enumerate(lasting)])
    rows = {each[0]: each[1] for each in outside(found)}
    assert [rows[name] for name in rows if name.startswith("both say that it is not over")] == ["1", "2"]


def test_alarms_about_the_machine_with_nothing_injected_are_shown() -> None:
    """Confirmed by the load, so not false; nevertheless alarms."""
    samples = [Load(T0 - 2 + second, cpu=99.0, memory=50.0, disk=50.0) for second in range(3)]
    found = groups([trial(kind=NOMINAL, injections=[], alarms=[alarm(0.5, "host/cpu", 5)], acts=[], machine=samples)])
    (row,) = (row for row in beyond(found) if row[0] == "Nothing injected")
    assert row[1].endswith("0 false alarms, 1 about `host/*` confirmed by the load")
