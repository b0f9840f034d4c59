"""What the page shows of a swarm that sends real frames: cells, details, the two views, events, and hostile text."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from phm.core.model import Slot
from phm.transport.dialect import mavlink
from tests.fakes.until import until
from tests.gcs.web.browser.scene import ERROR, Fleet, GroundProcess, a_bad_day, fleet, ground, tab

pytestmark = pytest.mark.browser
HOSTILE = "<img src=x onerror=alert(1)>"
RTL = "\u202e\u200f\u05d0\u05d1\u05d2"


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GroundProcess]:
    with ground(tmp_path_factory.mktemp("ground")) as made:
        yield made


@pytest.fixture(scope="module")
def agents(station: GroundProcess) -> Iterator[Fleet]:
    with fleet(station.mavlink, range(1, 13), 0.5) as made:
        a_bad_day(made)
        yield made


@pytest.fixture
def page(browser: Browser, station: GroundProcess, agents: Fleet) -> Iterator[Page]:
    with tab(browser, station.url) as made:
        expect(made.locator(".rows .row")).to_have_count(12)
        yield made


def test_the_worst_agents_are_first(page: Page) -> None:
    """Rows are in the order of their state, and then of their names."""
    expect(page.locator(".rows .row").nth(0)).to_have_attribute("data-name", "A02")
    expect(page.locator(".rows .row").nth(1)).to_have_attribute("data-name", "A07")
    expect(page.locator(".rows .row").nth(11)).to_have_attribute("data-name", "A12")


def test_a_level_has_a_text_and_a_form_besides_its_colour(page: Page) -> None:
    """Each cell has a word or a sign, and the forms of OK, WARN and ERROR differ."""
    expect(page.locator(".row[data-name=A07] .s-2")).to_have_text("ERROR")
    words = ["OK", "ERROR", "OK", "OK", "OK", "\u2013", "\u2013", "OK", "OK", *["\u2013"] * 6]
    expect(page.locator(".row[data-name=A07] .slot")).to_have_text(words)
    shape = "names => names.map((name) => getComputedStyle(document.querySelector(name), '::before').clipPath)"
    names = [f".row[data-name={name}] .s-{slot}" for name, slot in (("A07", 2), ("A05", 9), ("A01", 1))]

    def differ() -> bool:
        """In one look, and again on a busy machine, where an agent may be late."""
        shapes = set(page.evaluate(shape, names))
        return len(shapes) == 3 and "none" not in shapes

    until(differ, "three forms", lambda: page.evaluate(shape, names), step=lambda: page.wait_for_timeout(50))


def test_a_silent_agent_is_lost_and_its_age_counts_up(page: Page, agents: Fleet) -> None:
    """Its cells are no longer trusted, and it is no longer at the end."""
    agents.silent.add(11)
    row = page.locator(".row[data-name=A11]")
    expect(row.locator(".how")).to_have_text("LOST")
    expect(page.locator(".row[data-name=A11] .slot")).to_have_text(["?"] * 15)
    first = row.locator(".age").inner_text()
    expect(row.locator(".age")).not_to_have_text(first)
    agents.silent.discard(11)
    expect(row.locator(".how")).to_have_text("OK")


def test_the_details_say_where_the_path_is_broken_and_why(page: Page) -> None:
    """The first broken hop is drawn and named, and each bad check has its reason in words."""
    page.locator(".row[data-name=A07]").click()
    panel = page.locator("#panel")
    expect(panel.get_by_role("heading", level=2)).to_have_text("A07")
    expect(panel.get_by_role("img", name="Container BROKEN?")).to_be_visible()
    expect(panel.locator("svg.path .cut")).to_have_count(1)
    expect(panel.locator(".hops")).to_contain_text("ros_app exited (137)")
    expect(panel.locator(".layers")).to_contain_text("ros_app exited (137)")
    expect(panel.locator(".advice")).to_contain_text("restart ros_app")


def test_the_history_is_plotted(page: Page) -> None:
    """Heartbeat gaps have a curve and a newest value, also since the arming, whose time is shown."""
    page.locator(".row[data-name=A07]").click()
    gap = page.locator("figure", has_text="heartbeat gap")
    expect(gap.locator("strong")).to_contain_text(" s")
    drawn = "node => node.getContext('2d').getImageData(0, 0, node.width, node.height).data.some((value) => value)"
    until(lambda: gap.locator("canvas").evaluate(drawn), "the curve", step=lambda: page.wait_for_timeout(50))
    page.get_by_role("button", name="since arming").click()
    expect(page.get_by_role("button", name="since arming")).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#panel")).to_contain_text(re.compile(r"Armed since (before )?\d\d:\d\d:\d\d UTC\."))
    expect(gap.locator("strong")).to_contain_text(" s")


def test_what_is_plotted_on_request_alone_is_named(page: Page, agents: Fleet) -> None:
    """Load and rates of topics, each until it has values."""
    page.locator(".row[data-name=A01]").click()
    note = page.locator("#panel .quiet", has_text="once requested")
    expect(note).to_have_text("Plotted once requested (see Requests): load, topic rates.")
    agents.vehicles[1].send(mavlink.MAVLink_named_value_float_message(1000, b"scan", 9.5))
    expect(note).to_have_text("Plotted once requested (see Requests): load.")


def test_the_plots_of_a_flight_stay_after_it(page: Page, station: GroundProcess, agents: Fleet) -> None:
    """Until the next one; without an arming, the page says so."""
    page.locator(".row[data-name=A11]").click()
    page.get_by_role("button", name="since arming").click()
    expect(page.locator("#panel")).to_contain_text("Armed since")
    agents.armed[11] = False
    expect(page.locator("#panel")).to_contain_text(re.compile(r"Armed .*\d\d:\d\d:\d\d to \d\d:\d\d:\d\d UTC\."))
    expect(page.locator("figure", has_text="heartbeat gap").locator("strong")).to_contain_text(" s")
    page.goto(f"{station.url}#/agent/A03")
    page.get_by_role("button", name="since arming").click()
    expect(page.locator("#panel")).to_contain_text("No arming of this autopilot is known.")


def test_open_faults_have_their_steps(page: Page) -> None:
    """What was confirmed and what the agent advises, with their times."""
    page.locator(".row[data-name=A07]").click()
    fault = page.locator("#panel .fault")
    expect(fault).to_contain_text("ros_app exited (137)")
    expect(fault.locator(".steps")).to_contain_text("advised")
    expect(fault.locator(".stages .reached").last).to_contain_text("confirmed")
    expect(page.locator("#panel .log")).to_contain_text("A07 FAIL")


def test_a_recovered_fault_shows_all_stages(page: Page, agents: Fleet) -> None:
    """It stays in the list, marked as ended, with the time of each stage that the ground has received."""
    page.locator(".row[data-name=A12]").click()
    fails(agents, 12)
    agents.say(12, "A12 FAIL 6 mapper dead")
    agents.say(12, "A12 ADVISE 6 relaunch mapper #21 60s", 4)
    agents.say(12, "A12 APPROVED 6 relaunch mapper", 5)
    del agents.levels[12]
    agents.say(12, "A12 OK 6 mapper relaunched", 5)
    fault = page.locator("#panel .fault", has_text="mapper dead")
    expect(fault).to_contain_text(re.compile(r"ended \d\d:\d\d:\d\d"))
    expect(fault.locator(".stages .reached")).to_have_text(
        [re.compile(f"{name}.*\\d\\d:\\d\\d:\\d\\d") for name in ("detected", "confirmed", "action", "proof")]
    )


def fails(agents: Fleet, number: int) -> None:
    """A node of the agent fails: its heartbeats say so, too, and a healthy one would end the fault."""
    agents.levels[number] = {Slot.NODES: ERROR}
    agents.vehicles[number].heartbeat(agents.levels[number])


def test_a_fault_that_phm_gave_up_says_so(page: Page, agents: Fleet) -> None:
    """An approval that expired and an action that PHM stopped trying take the place of the action."""
    page.locator(".row[data-name=A10]").click()
    fails(agents, 10)
    agents.say(10, "A10 FAIL 6 mapper dead")
    agents.say(10, "A10 ADVISE 6 relaunch mapper #22 60s", 4)
    agents.say(10, "A10 EXPIRED 6 relaunch mapper", 4)
    failed = page.locator("#panel .fault", has_text="mapper dead").locator(".stages .failed")
    expect(failed).to_have_text(re.compile(r"EXPIRED.*\d\d:\d\d:\d\d"))
    agents.say(10, "A10 GAVE UP 6 mapper dead #22")
    expect(failed).to_have_text(re.compile(r"GAVE UP.*\d\d:\d\d:\d\d"))
    del agents.levels[10]
    agents.say(10, "A10 OK 6 mapper recovered", 5)
    stages = page.locator("#panel .fault", has_text="mapper dead").locator(".stages li")
    expect(stages.last).to_have_text(re.compile(r"recovered.*\d\d:\d\d:\d\d"))
    expect(failed).to_contain_text("GAVE UP")


def test_the_two_views_are_side_by_side_and_differences_are_marked(page: Page) -> None:
    """The digest says OK about an agent that the ground sees in WARN."""
    page.get_by_role("link", name="Two views").click()
    row = page.locator("#v-table tr", has=page.locator("th", has_text="A09"))
    expect(row).to_contain_text("\u2260 the levels differ")
    expect(page.locator("#v-table tr", has=page.locator("th", has_text="A03"))).not_to_contain_text("\u2260")
    expect(page.locator("#v-matrix .slot").first).to_be_visible()


def test_events_can_be_searched_and_filtered(page: Page, agents: Fleet) -> None:
    """By text, by agent and by severity."""
    page.get_by_role("link", name="Events").click()
    agents.say(4, "A04 FAIL 11111011 6 mapper dead")
    agents.say(6, "A06 WARN 9 memory 91%", 4)
    log = page.locator("#view-events .log li")
    expect(log.filter(has_text="A04 FAIL")).to_have_count(1)
    expect(log.filter(has_text="A06 WARN")).to_have_count(1)
    page.get_by_label("Search").fill("MEMORY")
    expect(log).to_have_count(1)
    expect(log).to_contain_text("A06")
    page.get_by_label("Search").fill("")
    page.get_by_label("At least").select_option("critical")
    expect(log.filter(has_text="A06 WARN")).to_have_count(0)
    expect(log.filter(has_text="A04 FAIL")).to_have_count(1)


def test_text_from_the_air_is_never_markup(page: Page, agents: Fleet) -> None:
    """Markup is shown as text, a text from right to left stays in its own place, and a long one does not widen the page."""
    agents.levels[3] = {Slot.NODES: ERROR}
    agents.say(3, f"A03 FAIL 11111011 6 {HOSTILE}"[:50])
    agents.say(10, f"A10 WARN 9 {RTL} evil", 4)
    agents.say(8, "A08 WARN 9 " + "x" * 39, 4)
    expect(page.locator(".row[data-name=A03] .line")).to_contain_text("<img src=x")
    expect(page.locator(".row[data-name=A08] .line")).to_contain_text("xxxx")
    page.locator(".row[data-name=A03]").click()
    expect(page.locator("#panel .layers")).to_contain_text("<img src=x")
    assert page.locator("img").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    # In one call: between two, the page may replace an element, and a removed one has no style.
    directions = "name => [...document.querySelectorAll(name)].map(node => getComputedStyle(node).unicodeBidi)"
    assert page.evaluate(directions, ".row[data-name=A10] .line") == ["isolate"]
    assert set(page.evaluate(directions, ".air")) == {"isolate"}


def test_the_page_loads_from_its_server_alone(browser: Browser, station: GroundProcess, agents: Fleet) -> None:
    """Without a connection to the internet the page is complete."""
    with tab(browser, "about:blank") as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(station.url)
        expect(page.locator(".rows .row")).to_have_count(12)
        assert [url for url in asked if not url.startswith(station.url)] == []
        assert len(asked) > 5
