"""The record of trials on the disk, and the reports made from it."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given, strategies as st

from sitl.campaign import plots
from sitl.campaign.report import BEGIN, END, Setting, as_html, as_json, as_markdown, between_marks
from sitl.campaign.trial import Cost, Start, Trial, Warned, append, from_json, load, to_json
from tests.fakes.campaign_trials import alarm, injection, trial

SETTING = Setting(7, "x86_64, 2 cores", "2026-01-01", planned=20)


def full() -> Trial:
    """A trial that uses every part of the record."""
    return trial(
        warned=[Warned(1, "rates/a", 8, 5.0, ["rate_low"], "slow")],
        starts=[Start(2, 3.0)],
        blind=[(3, 1.0, 2.0)],
        received={1: 100},
        cost=[Cost(1, 2.0, 0.1, 70.0)],
        changed=["x"],
        setting={"seed": 7},
    )


def test_a_trial_survives_its_line() -> None:
    """What is written is what is read, whole."""
    assert from_json(to_json(full())) == full()


def test_keys_of_tomorrow_are_left_out() -> None:
    """A newer program may say more."""
    data = json.loads(to_json(full()))
    data["more"] = data["injections"][0]["more"] = 1
    assert from_json(json.dumps(data)) == full()


@pytest.mark.parametrize("line", ["", "7", "[]", "{}", '{"v": 1}', '{"v": 2}', '{"v": 1, "injections": [7]}', "{"])
def test_what_is_no_trial_is_refused(line: str) -> None:
    """ValueError, whatever stands there."""
    with pytest.raises(ValueError):
        from_json(line)


@given(st.data())
def test_a_torn_file_keeps_its_whole_trials(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """A campaign that was killed while it wrote goes on: the torn line is skipped, and what is appended stands alone."""
    file = tmp_path_factory.mktemp("campaign") / "trials.jsonl"
    for number in (1, 2, 3):
        append(file, trial(number=number))
    whole = file.read_bytes()
    cut = data.draw(st.integers(0, len(whole)))
    file.write_bytes(whole[:cut])
    kept = [each.number for each in load(file)]
    assert kept == [1, 2, 3][: len(kept)]
    assert len(kept) >= whole[:cut].count(b"\n")
    append(file, trial(number=9))
    assert [each.number for each in load(file)][-1] == 9
    assert [each.number for each in load(file)][: len(kept)] == kept


def test_a_trial_done_again_replaces_the_first(tmp_path: Path) -> None:
    """Of several with one kind and number the last one counts; a file that is not there is empty."""
    file = tmp_path / "trials.jsonl"
    assert load(file) == []
    append(file, trial())
    append(file, trial(well_after=9.0))
    assert [each.well_after for each in load(file)] == [9.0]


class Page(HTMLParser):
    """What an HTML page asks for from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.foreign: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.foreign += [value or "" for name, value in attrs if name in ("src", "href")]


def test_the_page_stands_by_itself() -> None:
    """No script, no font, nothing from elsewhere; what came from outside cannot become markup."""
    made = trial(injections=[injection(title="<script>alert(1)</script>")])
    html = as_html([made], SETTING)
    page = Page()
    page.feed(html)
    assert (page.foreign, "script" in page.tags, "svg" in page.tags) == ([], False, True)
    assert not re.search(r"url\(|@import", html)
    for drawing in re.findall(r"<svg.*?</svg>", html, re.DOTALL):
        ElementTree.fromstring(drawing)


def test_reports_of_nothing_and_of_everything() -> None:
    """Each form is made of an empty campaign, too, and says how many of the planned trials were made."""
    for trials in ([], [full()], [full(), trial(number=2, alarms=[], acts=[], lines=[], well_after=None)]):
        assert json.loads(as_json(trials, SETTING))["setting"]["seed"] == 7
        assert "Table 2" in as_html(trials, SETTING)
        text = as_markdown(trials, SETTING)
        assert f"{len(trials)} of 20 planned trials" in text
        assert "14.82 s" in text


def test_what_falls_short_stands_in_every_report() -> None:
    """A missed fault is named with its trial and agent, in JSON, HTML and Markdown alike."""
    bad = [trial(number=4, alarms=[alarm(0.4, "network/ros_app")], acts=[], lines=[])]
    sentence = "trial 4, node_killed on A03: reported at network/ros_app, expected at nodes/agent_3/node_1"
    assert sentence in json.loads(as_json(bad, SETTING))["short"]
    assert sentence in as_html(bad, SETTING)
    assert sentence in as_markdown(bad, SETTING)


def test_markdown_tables_hold_together() -> None:
    """A bar or a line break in a summary does not break a table; every row has as many cells as its head."""
    bad = trial(injections=[injection(title="a|b\nc")])
    columns: int | None = None
    for line in as_markdown([bad], SETTING).splitlines():
        if not line.startswith("|"):
            columns = None
            continue
        columns = columns or line.count("|")
        assert line.count("|") == columns


def test_the_result_replaces_the_one_before() -> None:
    """Only what stands between the marks changes; a page without marks is refused."""
    assert between_marks(f"a\n{BEGIN}\nold\n{END}\nz", "new") == f"a\n{BEGIN}\nnew\n{END}\nz"
    with pytest.raises(ValueError, match="no marks"):
        between_marks("a", "new")


@given(st.floats(0, 1e6, allow_nan=False))
def test_times_stay_on_the_axis(seconds: float) -> None:
    """What is off the axis stands at its end; longer is never further left."""
    assert plots.LEFT <= plots.x_of(seconds) <= plots.WIDTH - plots.RIGHT
    assert plots.x_of(seconds) <= plots.x_of(seconds * 2)
