"""The record of trials on disk, and the reports generated from it."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from sitl.campaign import plots
from sitl.campaign.report import BEGIN, END, as_html, as_json, as_markdown, between_marks
from sitl.campaign.trial import Cost, Load, RaisedWarning, Start, Summary, Trial, append, from_json, load, to_json
from tests.fakes.campaign_trials import alarm, injection, trial

EVIL = "</script><script>window.hit = 1</script><img src=x onerror='window.hit = 1'>"
DRAWN = """() => [...document.querySelectorAll("#plots canvas")].map((one) => {
  // Pixels of a strong colour: grid and words are grey.
  const { data } = one.getContext("2d").getImageData(0, 0, one.width, one.height);
  let count = 0;
  for (let at = 0; at < data.length; at += 4) {
    const colours = data.slice(at, at + 3);
    if (data[at + 3] > 200 && Math.max(...colours) - Math.min(...colours) > 90) count += 1;
  }
  return count;
})"""
SETTING = {"seed": 7, "commit": "0123abc", "planned": 20, "machine": "x86_64, 2 cores", "day": "2026-01-01"}


def unwrapped(text: str) -> str:
    """A document in one line."""
    return " ".join(text.split())


def full_trial() -> Trial:
    """A trial that uses every part of the record."""
    return trial(
        warned=[RaisedWarning(1, "rates/a", 8, 5.0, ["rate_low"], "slow")],
        starts=[Start(2, 3.0)],
        blind=[(3, 1.0, 2.0)],
        received={1: 100},
        cost=[Cost(1, 2.0, 0.1, 70.0)],
        summaries=[Summary(3, 3.0, ["nodes/a"], 3.5)],
        machine=[Load(4.0, 99.0, 40.0, 30.0, 0.0)],
        changed=["x"],
        setting=SETTING,
    )


def test_a_trial_is_read_as_written() -> None:
    """All fields are read as they were written."""
    assert from_json(to_json(full_trial())) == full_trial()


def test_unknown_keys_are_ignored() -> None:
    """A newer version may write more."""
    data = json.loads(to_json(full_trial()))
    data["more"] = data["injections"][0]["more"] = 1
    assert from_json(json.dumps(data)) == full_trial()


@pytest.mark.parametrize("line", ["", "7", "[]", "{}", '{"v": 1}', '{"v": 3}', '{"v": 2, "injections": [7]}', "{"])
def test_an_invalid_trial_is_rejected(line: str) -> None:
    """ValueError for any content."""
    with pytest.raises(ValueError):
        from_json(line)


@given(st.data())
def test_a_truncated_file_keeps_its_complete_trials(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """A campaign that was killed while writing resumes: the truncated line is skipped, and new trials start on a new
    line.
    """
    file = tmp_path_factory.mktemp("campaign") / "trials.jsonl"
    for number in (1, 2, 3):
        append(file, trial(number=number))
    content = file.read_bytes()
    cut = data.draw(st.integers(0, len(content)))
    file.write_bytes(content[:cut])
    kept = [each.number for each in load(file)]
    assert kept == [1, 2, 3][: len(kept)]
    assert len(kept) >= content[:cut].count(b"\n")
    append(file, trial(number=9))
    assert [each.number for each in load(file)][-1] == 9
    assert [each.number for each in load(file)][: len(kept)] == kept


def test_a_repeated_trial_replaces_the_first(tmp_path: Path) -> None:
    """Of several with one kind and number the last one counts; a missing file is empty."""
    file = tmp_path / "trials.jsonl"
    assert load(file) == []
    append(file, trial())
    append(file, trial(healthy_after=9.0))
    assert [each.healthy_after for each in load(file)] == [9.0]


class Page(HTMLParser):
    """The external resources that an HTML page requests."""

    def __init__(self) -> None:
        super().__init__()
        self.foreign: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.foreign += [value or "" for name, value in attrs if name in ("src", "href")]


def test_the_page_is_self_contained() -> None:
    """No external resource; its policy permits its own code alone; external text cannot become markup."""
    html = as_html([trial(injections=[injection(title=EVIL)])])
    page = Page()
    page.feed(html)
    assert (page.foreign, "img" in page.tags, html.count("<script")) == ([], False, 2)
    policy = re.search(
        r"default-src &#39;none&#39;; script-src &#39;sha256-([\w+/=]+)&#39;; style-src &#39;sha256-", html
    )
    code = html.partition('<script type="module">')[2].partition("</script>")[0]
    assert policy is not None and policy[1] == base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    assert not re.search(r"url\(|@import", html.partition("<script")[0])


@pytest.mark.browser
def test_a_browser_draws_every_plot(tmp_path: Path) -> None:
    """A real one, without a violation of the policy: curves, and dots in a row for each class."""
    from playwright.sync_api import sync_playwright

    file, said = tmp_path / "page.html", []
    file.write_text(as_html([trial(injections=[injection(title=EVIL)])]), "utf-8")
    with sync_playwright() as programs:
        browser = programs.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page()
        page.set_default_timeout(120_000)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(file.as_uri())
        page.wait_for_selector("html[data-ready=yes]")
        titles = page.locator("#plots h3").all_inner_texts()
        drawn = page.evaluate(DRAWN)
        assert (said, page.evaluate("window.hit")) == ([], None)
        browser.close()
    assert [title.split()[0] for title in titles] == ["Share", "Detection:", "Recovery:"]
    assert all(count > 20 for count in drawn) and len(drawn) == 3


def test_curves_and_dots_are_those_of_the_times() -> None:
    """A curve is the share of the values up to each time; dots are in order of time, in the row of their class."""
    curve = plots.steps("t", [("a", [2.0, 1.0, 2.0, 500.0]), ("none", [])]).series
    assert [(one.name, list(one.x), list(one.y)) for one in curve] == [
        ("a (4)", [plots.LOW_S, 1.0, 2.0, plots.HIGH_S], [0.0, 25.0, 75.0, 100.0])
    ]
    dots = plots.strips("t", [("a", [3.0]), ("b", [4.0, 1.0])])
    assert (list(dots.series[0].x), list(dots.series[0].y), dots.rows) == ([1.0, 3.0, 4.0], [1.0, 0.0, 1.0], ["a", "b"])


def test_reports_can_be_made_of_empty_and_full_campaigns() -> None:
    """Each format can be made of an empty campaign, too, and states how many of the planned trials were made."""
    full = full_trial()
    for trials in ([full], [full, trial(number=2, alarms=[], acts=[], lines=[], healthy_after=None, setting=SETTING)]):
        assert json.loads(as_json(trials))["groups"][0]["seeds"] == [7]
        for text in (as_html(trials), unwrapped(as_markdown(trials))):
            assert f"{len(trials)} of 20 planned trials" in text
            assert "commit 0123abc" in text
            assert "14.82 s" in text
    assert json.loads(as_json([]))["groups"] == []
    assert "No trial was run." in as_html([])
    assert "No trial was run." in as_markdown([])


def test_each_profile_and_load_has_a_column() -> None:
    """One record may hold several campaigns; the differences of each from what is shipped are listed."""
    differences = [{"of": "configuration", "key": "recovery.budget", "shipped": 5, "here": 100}]
    trials = [
        trial(setting={**SETTING, "profile": "tuned", "load": "quiet", "differences": differences}),
        trial(setting={**SETTING, "profile": "shipped", "load": "busy"}),
        trial(setting={**SETTING, "profile": "shipped", "load": "quiet"}),
    ]
    text = as_markdown(trials)
    assert "| metric | paper, Table 2 | shipped, quiet | tuned, quiet | shipped, busy |" in text
    assert "| tuned, quiet | configuration | recovery.budget | 5 | 100 |" in text
    assert "- shipped, busy: node killed: 1" in text, "it was injected fewer than three times"


def test_a_missed_fault_is_in_every_report() -> None:
    """It is named with its trial and agent, in JSON, HTML and Markdown."""
    bad = [trial(number=4, alarms=[alarm(0.4, "network/ros_app")], acts=[], lines=[])]
    sentence = (
        "campaign: seed 1, trial 4, node_killed on A03: reported at network/ros_app, expected at nodes/agent_3/node_1"
    )
    assert sentence in json.loads(as_json(bad))["problems"]
    assert sentence in as_html(bad)
    assert sentence in unwrapped(as_markdown(bad))


def test_markdown_tables_are_well_formed() -> None:
    """A bar or a line break in a summary does not break a table; every row has as many cells as its header."""
    bad = trial(injections=[injection(title="a|b\nc")])
    columns: int | None = None
    for line in as_markdown([bad]).splitlines():
        if not line.startswith("|"):
            columns = None
            continue
        columns = columns or line.count("|")
        assert line.count("|") == columns


def test_the_result_replaces_the_previous_one() -> None:
    """Only the text between the marks changes; a page without marks is rejected."""
    assert between_marks(f"a\n{BEGIN}\nold\n{END}\nz", "new") == f"a\n{BEGIN}\nnew\n{END}\nz"
    with pytest.raises(ValueError, match="no marks"):
        between_marks("a", "new")


@given(st.floats(0, 1e6, allow_nan=False))
def test_times_stay_on_the_axis(seconds: float) -> None:
    """A value off the axis is drawn at its end; a longer time is never further left."""
    assert plots.LOW_S <= plots.on_axis(seconds) <= plots.HIGH_S
    assert plots.on_axis(seconds) <= plots.on_axis(seconds * 2)
