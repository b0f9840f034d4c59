"""What an operator does on the page: with the keyboard alone, with confirmation, and with the agent's answer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from phm.core.model import Level, Slot
from phm.transport.dialect import mavlink
from phm.wire import tunnel
from tests.fakes.until import until
from tests.gcs.test_daemon import agent
from tests.gcs.web.browser.scene import Fleet, GroundProcess, fleet, ground, tab

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GroundProcess]:
    """With a real agent 7, whose container has not opted in to recovery."""
    with ground(tmp_path_factory.mktemp("ground")) as made:
        folder = tmp_path_factory.mktemp("agent")
        permitted = ["status", "details", "check", "restart", "hold"]
        daemon = agent(folder, 7, f"udpout:127.0.0.1:{made.mavlink}", engine=True, commands=permitted)
        daemon.start()
        yield made
        daemon.stop()


@pytest.fixture(scope="module")
def agents(station: GroundProcess) -> Iterator[Fleet]:
    with fleet(station.mavlink, [1, 2, 3], 0.5) as made:
        yield made


@pytest.fixture
def page(browser: Browser, station: GroundProcess, agents: Fleet) -> Iterator[Page]:
    with tab(browser, station.url) as made:
        expect(made.locator(".rows .row")).to_have_count(4)
        yield made


def containers(page: Page) -> None:
    """Have the page list the containers of agent 7."""
    if page.get_by_role("button", name="restart app").count() == 0:
        page.get_by_role("button", name="list containers").click()
    expect(page.get_by_role("button", name="restart app")).to_be_visible()


def confirmation(page: Page, request: str) -> str:
    """What the dialog of a request says; the request is not sent."""
    page.get_by_role("button", name=request).click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_be_visible()
    words = dialog.inner_text()
    dialog.get_by_role("button", name="Cancel").click()
    expect(dialog).to_be_hidden()
    return words


def test_a_restart_is_confirmed_and_the_refusal_says_why(page: Page, station: GroundProcess) -> None:
    """The dialog says what will happen; Cancel sends nothing; the agent's reason is shown."""
    page.goto(f"{station.url}#/agent/A07")
    containers(page)
    page.get_by_role("button", name="restart app").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("stops the container app and starts it again")
    expect(dialog.get_by_role("button", name="Cancel")).to_be_focused()
    page.keyboard.press("Enter")
    expect(dialog).to_be_hidden()
    expect(page.locator(".requests")).not_to_contain_text("restart")
    page.get_by_role("button", name="restart app").click()
    dialog.get_by_role("button", name="Yes, restart").click()
    expect(page.locator(".toasts .t-error")).to_contain_text("A07 restart app")
    expect(page.locator(".toasts .t-error")).to_contain_text("recover")
    expect(page.locator(".requests .g-error")).to_contain_text("recover")


def test_the_confirmation_of_a_restart_follows_the_arming(page: Page, station: GroundProcess, agents: Fleet) -> None:
    """Also when the vehicle is armed after its containers were listed."""
    agents.armed[1] = False
    try:
        agents.send_tunnel(1, tunnel.details("containers", "1 ros_app")[0])
        page.goto(f"{station.url}#/agent/A01")
        expect(page.locator("#panel .facts")).to_contain_text("autopilot disarmed")
        assert "starts it again. The agent decides" in confirmation(page, "restart ros_app")
        agents.armed[1] = True
        until(
            lambda: "starts it again. The vehicle is armed." in confirmation(page, "restart ros_app"),
            "the sentence",
            step=lambda: page.wait_for_timeout(50),
        )
    finally:
        del agents.armed[1]


def test_an_approval_is_confirmed_and_the_answer_is_shown(page: Page, station: GroundProcess, agents: Fleet) -> None:
    """The dialog names the action and how long the approval is valid; only then is the command sent, here by the keyboard alone."""
    vehicle = agents.vehicles[3]

    def approvals() -> list[Any]:
        """The station sends all commands on its one link: those to other agents arrive here, too."""
        received = [one for one in vehicle.receive() if one.get_type() == "COMMAND_LONG"]
        return [one for one in received if (one.target_system, one.command) == (3, 31010)]

    agents.levels[3] = {Slot.CONTAINER: Level.ERROR}
    try:
        vehicle.heartbeat(agents.levels[3])
        agents.say(3, "A03 ADVISE 2 restart ros_app #17 60s", 4)
        page.goto(f"{station.url}#/agent/A03")
        page.get_by_role("button", name="approve restart ros_app (#17)").click()
        dialog = page.get_by_role("dialog")
        expect(dialog).to_contain_text("does what it advises for fault #17: restart ros_app. The approval is valid for")
        expect(dialog.get_by_role("button", name="Cancel")).to_be_focused()
        assert not approvals()
        page.keyboard.press("Tab")
        expect(dialog.get_by_role("button", name="Yes, approve")).to_be_focused()
        page.keyboard.press("Enter")
        (asked, *_) = until(approvals, "the command")
        assert (asked.param1, asked.param2) == (2, 17)
        to = asked.get_srcSystem(), asked.get_srcComponent()
        vehicle.send(mavlink.MAVLink_command_ack_message(31010, mavlink.MAV_RESULT_ACCEPTED, 0, 0, *to))
        expect(page.locator(".requests")).to_contain_text("A03 approve #17 restart ros_app: accepted")
    finally:
        del agents.levels[3]


def test_a_hold_for_the_chosen_time_is_accepted_and_released(page: Page, station: GroundProcess) -> None:
    """The agent confirms both."""
    page.goto(f"{station.url}#/agent/A07")
    containers(page)
    page.get_by_role("button", name="hold app").click()
    page.get_by_label("For", exact=True).select_option("5")
    page.get_by_role("button", name="Yes, hold").click()
    expect(page.locator("#panel .log")).to_contain_text("A07 HOLD 2 app 5 min")
    page.get_by_role("button", name="release app").click()
    page.get_by_role("button", name="Yes, release").click()
    expect(page.locator("#panel .log")).to_contain_text("A07 HOLD 2 app released")


def test_the_keyboard_is_enough(page: Page) -> None:
    """Rows by arrow keys, Enter opens, Escape returns to the row, and a request is sent and answered."""
    page.keyboard.press("Tab")
    expect(page.locator(".skip")).to_be_focused()
    row = page.locator(".row[data-name=A07] button")
    for _ in range(20):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.closest('.rows') !== null"):
            break
    page.keyboard.press("Home")
    for _ in range(4):
        if page.evaluate("document.activeElement.closest('.row').dataset.name") == "A07":
            break
        page.keyboard.press("ArrowDown")
    expect(row).to_be_focused()
    assert row.evaluate("node => getComputedStyle(node).outlineStyle") == "solid"
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="A07")).to_be_focused()
    check = page.get_by_role("button", name="run all checks")
    expect(check).to_be_visible()
    for _ in range(20):
        page.keyboard.press("Tab")
        if check.evaluate("node => node === document.activeElement"):
            break
    page.keyboard.press("Enter")
    expect(page.locator(".toasts")).to_contain_text("A07 run all checks: accepted")
    page.keyboard.press("Escape")
    expect(page.locator("#panel")).to_be_hidden()
    expect(row).to_be_focused()


def test_requests_appear_when_a_busy_server_answers_again(page: Page) -> None:
    """The panel of an agent asks again by itself."""
    busy = [True]
    page.route("**/api/choices*", lambda route: route.abort() if busy else route.continue_())
    page.locator(".row[data-name=A07] button").click()
    expect(page.get_by_text("No requests: the server does not answer.")).to_be_visible()
    busy.clear()
    expect(page.get_by_role("button", name="run all checks")).to_be_visible()


def test_a_new_critical_is_shown_and_rings_until_it_is_acknowledged(page: Page, agents: Fleet) -> None:
    """It rings, flashes and marks its agent; silence ends the bell alone; to acknowledge ends the mark, not the silence."""
    page.evaluate(
        """() => { window.tones = 0; const real = AudioContext.prototype.createOscillator;
        AudioContext.prototype.createOscillator = function () { window.tones++; return real.call(this); }; }"""
    )
    page.get_by_role("button", name="Sound").click()
    expect(page.get_by_role("button", name="Sound on")).to_be_visible()
    before = int(page.evaluate("window.tones"))
    agents.say(2, "A02 FAIL 11111011 6 planner dead")
    alarms = page.get_by_role("region", name="Alarms")
    expect(alarms).to_contain_text("A02 (1)")
    expect(page.locator(".row[data-name=A02] .bell")).to_have_text("! 1")
    expect(page.locator("#said")).to_contain_text("New CRITICAL: A02")
    page.wait_for_function("before => window.tones > before", arg=before)
    assert "flash" in str(page.locator("body").get_attribute("class"))
    alarms.get_by_role("button", name="Silence for").click()
    expect(alarms).to_contain_text("silenced")
    silenced = int(page.evaluate("window.tones"))
    agents.say(2, "A02 FAIL 11110011 5 camera missing")
    expect(alarms).to_contain_text("A02 (2)")
    assert int(page.evaluate("window.tones")) == silenced
    alarms.get_by_role("button", name="Acknowledge all").click()
    expect(page.locator(".row[data-name=A02] .bell")).to_have_text("")
    expect(alarms).to_contain_text("all agents are silenced for")
    alarms.get_by_role("button", name="End the silence").click()
    expect(alarms).to_be_hidden()
    agents.say(2, "A02 FAIL 11110001 6 mapper dead")
    page.wait_for_function("silenced => window.tones > silenced", arg=silenced)
    alarms.get_by_role("button", name="Acknowledge all").click()
    expect(alarms).to_be_hidden()


def test_the_panel_of_an_agent_ends_the_silence_of_all(page: Page, station: GroundProcess, agents: Fleet) -> None:
    """To end its own silence would change nothing: the button says whose silence it ends."""
    agents.say(3, "A03 FAIL 11111011 6 gripper dead")
    alarms = page.get_by_role("region", name="Alarms")
    expect(alarms).to_contain_text("A03 (1)")  # else the buttons may be about an earlier alarm
    alarms.get_by_role("button", name="Silence for").click()
    alarms.get_by_role("button", name="Acknowledge all").click()
    page.goto(f"{station.url}#/agent/A03")
    page.locator("#panel").get_by_role("button", name="End the silence of all agents").click()
    expect(page.locator("#panel .own-alarm")).to_be_empty()
    expect(alarms).to_be_hidden()
