"""The Checks page in a real browser: someone who knows no YAML adds a check."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from phm.gcs.web.config_delivery import ConfigDelivery, DeliveryTarget
from phm.gcs.web.config_editor import ConfigEditor
from phm.gcs.web.options import ListenOptions, Tokens
from phm.gcs.web.routes.checks import DELIVERY, EXTRA
from phm.runtime.configuration import plan_of
from phm.wire.delivery import DeliveryAnswer, version_of
from tests.commands.test_delivery_server import KEY, Bench
from tests.fakes.until import until
from tests.gcs.web.browser.scene import LIMIT_MS, chromium, tab
from tests.gcs.web.swarm import ground

pytestmark = pytest.mark.browser

expect.set_options(timeout=LIMIT_MS)
TEXT = """\
# Our bench. <img src=x onerror=alert(1)>
agent: {name: "${NAME:-a7}", id: 7}
containers:
  - name: app  # the application
    recover: true
log:
  # How many are kept.
  files: 3
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as launched:
        yield launched


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a7.yaml"
    path.write_text(TEXT)
    return path


@pytest.fixture
def page(browser: Browser, file: Path) -> Iterator[Page]:
    editor = ConfigEditor(plan_of, [str(file)])
    with (
        ground(ListenOptions(port=0), extra={EXTRA: editor}) as here,
        tab(browser, f"{here.page.url}checks", viewport={"width": 1400, "height": 1000}) as opened,
    ):
        opened.on("dialog", lambda dialog: dialog.accept())
        expect(opened.locator("#state")).to_contain_text("not changed, valid")
        yield opened


def axe(page: Page) -> list[str]:
    """The violations that axe finds, by rule and place."""
    found: list[dict[str, Any]] = Axe().run(page).response["violations"]
    return [f"{rule['id']}: {node['target']}" for rule in found for node in rule["nodes"]]


def section(page: Page, key: str) -> Any:
    return page.locator(f'[data-key="{key}"]')


def test_a_check_is_added_without_yaml(page: Page, file: Path) -> None:
    """The reader picks a type, sees what is wrong at the field, previews units and changes, and saves; the comments stay."""
    page.get_by_label("Type of a new entry of custom").select_option("tcp")
    page.get_by_role("button", name="Add to custom").click()
    name = section(page, "custom[0].name")
    expect(name.locator(".problem")).to_contain_text("is missing")
    expect(name.locator("input")).to_be_focused()
    name.locator("input").fill("planner")
    section(page, "custom[0].host").locator("input").fill("127.0.0.1")
    section(page, "custom[0].port").locator("input").fill("8080")
    slot = section(page, "custom[0].slot").locator("input")
    slot.fill("99")
    slot.press("Tab")
    expect(section(page, "custom[0].slot").locator(".problem")).to_contain_text("1 to 15")
    expect(slot).to_have_attribute("aria-invalid", "true")
    expect(page.locator("#problems")).to_contain_text("custom[0].slot")
    assert axe(page) == []
    slot.fill("14")
    slot.press("Tab")
    expect(page.locator("#state")).to_contain_text("changed, not saved, valid")
    expect(page.locator("#units tr.new")).to_contain_text("custom/planner")
    expect(page.locator("#units tr.new")).to_contain_text("+ new")
    added = page.locator("#diff .added")
    expect(added.filter(has_text="name: planner")).to_have_count(1)
    assert axe(page) == []
    assert file.read_text() == TEXT
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.locator("#state")).to_contain_text("a7.yaml: saved")
    expect(page.locator("#diff-count")).to_have_text("none")
    text = file.read_text()
    assert text.startswith(TEXT)
    for line in ("custom:", "  - type: tcp", "    name: planner", "    port: 8080", "    slot: 14"):
        assert line in text.splitlines(), text


def test_the_heads_of_the_units_are_whole_words_on_a_tablet(page: Page) -> None:
    """A narrow column does not break its head."""
    page.set_viewport_size({"width": 1024, "height": 768})
    heads = page.get_by_role("columnheader", name=re.compile("^(Slot|Change)$"))
    expect(heads).to_have_count(2)
    for head in heads.all():
        box = head.bounding_box()
        assert box is not None and box["height"] < 40


def test_values_of_the_file_are_text_never_markup(page: Page) -> None:
    """Also in the preview, the changes and the messages; nothing runs."""
    section(page, "log").locator("summary").click()
    files = section(page, "log.files").locator("input")
    hostile = "<img src=x onerror=document.title='bad'>"
    files.fill(hostile)
    files.press("Tab")
    expect(page.locator("#diff")).to_contain_text(hostile)
    expect(section(page, "log.files").locator(".problem")).to_contain_text("img src")
    assert page.locator("img").count() == 0
    assert page.title() == "Checks - PHM"


def test_a_file_of_any_shape_is_shown(page: Page) -> None:
    """Values of the wrong type, unknown types and keys that look like places are problems, never a failure of the page."""
    text = (
        "containers: text\nlog: [1]\nros: {nodes: {a: b}, topics: [3]}\ninterval: {a: 1}\nchecks: {'a].[0': {enabled: 3, 'x]': 1}}\n"
        "custom: [{type: constructor}, {type: __proto__}, 7, {type: tcp, name: [1]}]\n'b]c[': 1\n"
    )
    page.locator("#upload").set_input_files({"name": "b.yaml", "mimeType": "text/yaml", "buffer": text.encode()})
    expect(page.locator("#state")).to_contain_text("b.yaml: not changed")
    for _ in range(4):
        page.locator("#form details:not([open]) > summary").evaluate_all("nodes => nodes.forEach(node => node.click())")
    expect(section(page, "interval").locator(".problem")).to_contain_text("a mapping")
    for link in page.locator("#problems button").all():
        link.click()
    section(page, "containers").locator("input, .add button").last.click()
    expect(page.locator("#notice")).to_contain_text("is not a list")


def test_a_click_on_save_includes_the_field_that_it_leaves(page: Page, file: Path) -> None:
    """The last input is saved, too, also when the server has not answered yet."""
    section(page, "log").locator("summary").click()
    files = section(page, "log.files").locator("input")
    files.fill("4")
    files.press("Tab")
    expect(page.locator("#save")).to_be_enabled()
    files.fill("5")
    page.locator("#save").click()
    expect(page.locator("#state")).to_contain_text("a7.yaml: saved")
    assert file.read_text() == TEXT.replace("files: 3", "files: 5")


def test_the_form_works_by_keyboard_alone(page: Page, file: Path) -> None:
    """Open a section, change a value, undo it, change it again and save."""
    section(page, "log").locator("summary").focus()
    page.keyboard.press("Enter")
    files = section(page, "log.files").locator("input")
    files.focus()
    page.keyboard.press("Control+A")
    page.keyboard.type("5")
    page.keyboard.press("Tab")
    expect(page.locator("#diff")).to_contain_text("files: 5")
    page.locator("#undo").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#state")).to_contain_text("not changed")
    expect(files).to_have_value("3")
    files.focus()
    page.keyboard.press("Control+A")
    page.keyboard.type("4")
    page.keyboard.press("Tab")
    expect(page.locator("#save")).to_be_enabled()
    page.locator("#save").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#state")).to_contain_text("a7.yaml: saved")
    assert file.read_text() == TEXT.replace("files: 3", "files: 4")


def test_form_and_yaml_show_the_same(page: Page) -> None:
    """A text is applied to the form; broken YAML says its line, and the form waits."""
    page.locator("#box-yaml summary").click()
    page.locator("#yaml").fill("containers:\n  - name: web\n    ready: {services: [/go]}\nros: {nodes: [\n")
    page.get_by_role("button", name="Apply the text").click()
    expect(page.locator("#problems")).to_contain_text("line")
    expect(page.locator("#form")).to_have_attribute("inert", "")
    page.locator("#yaml").fill("containers:\n  - name: web\n    ready: {services: [/go]}\n")
    page.get_by_role("button", name="Apply the text").click()
    expect(page.locator("#state")).to_contain_text("valid")
    section(page, "containers[0]").locator("> summary").click()
    expect(section(page, "containers[0].name").locator("input")).to_have_value("web")
    section(page, "containers[0].ready").locator("> summary").click()
    section(page, "containers[0].ready.services").locator("> summary").click()
    expect(section(page, "containers[0].ready.services[0]").locator("input")).to_have_value("/go")
    page.get_by_role("button", name="Remove containers[0]: web").click()
    expect(page.locator("#yaml")).to_have_value("containers: []\n")


def test_every_section_of_the_schema_opens(page: Page) -> None:
    """With all of it open, axe finds nothing."""
    for _ in range(4):
        closed = page.locator("#form details:not([open]) > summary")
        closed.evaluate_all("nodes => nodes.forEach(node => node.click())")
        page.locator("#form details[open] > .body > *").first.wait_for()
    page.locator("aside details:not([open]) > summary").evaluate_all("nodes => nodes.forEach(node => node.click())")
    assert page.locator("#form input, #form select").count() > 100
    assert axe(page) == []


def test_the_commands_deliver_only_what_the_agent_accepts(page: Page, file: Path, tmp_path: Path) -> None:
    """Run as the agent's shell would: an invalid file changes nothing, a valid one replaces the old one, which is kept."""
    page.locator("#box-deliver summary").click()
    page.locator("#target").fill(str(file))
    page.locator("#host").fill("pilot@10.0.0.7")
    words = shlex.split(page.locator("#commands").text_content() or "")
    assert words[:3] == ["scp", "./a7.yaml", f"pilot@10.0.0.7:{file}.new"] and words[3:5] == ["ssh", "pilot@10.0.0.7"]
    environ = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PHM_RUN_DIR": str(tmp_path),
    }
    new, old = Path(f"{file}.new"), Path(f"{file}.bak")
    new.write_text("interval: never\n")
    assert subprocess.run(words[5], shell=True, env=environ, capture_output=True).returncode == 78
    assert file.read_text() == TEXT and not old.exists()
    new.write_text(TEXT.replace("files: 3", "files: 4"))
    done = subprocess.run(words[5], shell=True, env=environ, capture_output=True)
    assert b"PHM is not running" in done.stderr and file.read_text() == new.read_text() and old.read_text() == TEXT


def test_nothing_for_a_shell_gets_into_the_commands(page: Page) -> None:
    """Only names and paths that need no quotes are accepted."""
    page.locator("#box-deliver summary").click()
    page.locator("#host").fill("pilot@10.0.0.7")
    page.locator("#container").fill("phm")
    for field, text in (("host", "-oProxyCommand=x@y"), ("target", "/etc/$(id)"), ("container", "a;b")):
        expect(page.locator("#commands")).to_contain_text("docker exec phm phm reload")
        good = page.locator(f"#{field}").input_value()
        page.locator(f"#{field}").fill(text)
        expect(page.locator("#commands")).to_contain_text("Enter the")
        page.locator(f"#{field}").fill(good)


def test_the_pages_lead_to_each_other(page: Page) -> None:
    """Where configurations can be edited, the swarm's page says so."""
    page.get_by_role("link", name="Swarm").click()
    page.locator("#tab-checks").click()
    expect(page.locator("#state")).to_contain_text("not changed")


def test_a_configuration_with_problems_is_saved_after_a_question(page: Page, file: Path) -> None:
    """Cancel leaves the file unchanged."""
    interval = section(page, "interval").locator("input")
    interval.fill("never")
    interval.press("Tab")
    expect(page.locator("#state")).to_contain_text("1 problem")
    dialog = page.get_by_role("dialog", name="Save it anyway?")
    page.locator("#save").click()
    expect(dialog).to_contain_text("an agent would refuse it")
    dialog.get_by_role("button", name="Cancel").click()
    expect(dialog).to_be_hidden()
    assert file.read_text() == TEXT
    page.locator("#save").click()
    dialog.get_by_role("button", name="Yes, save").click()
    until(
        lambda: "a7.yaml: saved" in page.locator("#state").inner_text(),
        "the file to be saved",
        lambda: (page.locator("#notice").inner_text(), page.locator("#dialog").inner_text()),
        step=lambda: page.wait_for_timeout(50),
    )
    assert "interval: never" in file.read_text()


def test_an_upload_is_edited_and_downloaded(page: Page, file: Path, tmp_path: Path) -> None:
    """Without a file of the ground's disk: nothing can be saved there, the result is downloaded."""
    page.locator("#upload").set_input_files({"name": "b.yaml", "mimeType": "text/yaml", "buffer": TEXT.encode()})
    expect(page.locator("#state")).to_contain_text("b.yaml: not changed")
    section(page, "containers").get_by_role("button", name="Add to containers").click()
    section(page, "containers[1].name").locator("input").fill("camera")
    section(page, "containers[1].name").locator("input").press("Tab")
    expect(page.locator("#diff")).to_contain_text("name: camera")
    expect(page.locator("#save")).to_be_disabled()
    with page.expect_download() as started:
        page.get_by_role("button", name="Download").click()
    assert started.value.suggested_filename == "b.yaml"
    started.value.save_as(tmp_path / "got.yaml")
    assert (tmp_path / "got.yaml").read_text() == TEXT.replace("recover: true\n", "recover: true\n  - name: camera\n")
    assert file.read_text() == TEXT


def test_a_viewer_sees_no_configuration(browser: Browser, file: Path) -> None:
    """It may have secrets: the page asks for an operator's token."""
    editor = ConfigEditor(plan_of, [str(file)])
    options = ListenOptions(port=0, tokens=Tokens("v" * 32, "o" * 32))
    with ground(options, extra={EXTRA: editor}) as here, tab(browser, f"{here.page.url}checks") as opened:
        opened.get_by_label("Token of an operator").fill("v" * 32)
        opened.get_by_role("button", name="Log in").click()
        expect(opened.locator("#notice")).to_contain_text("need the role operate")
        assert opened.locator("#editor").is_hidden()
        assert "Our bench" not in opened.content()
        opened.goto(here.page.url)
        expect(opened.locator("#tab-swarm")).to_be_visible()
        expect(opened.locator("#tab-checks")).to_be_hidden()


class Refusing(Bench):
    """An agent that has another configuration at first, and then finds a problem."""

    def _execute(self, text: str, base: str, who: str) -> DeliveryAnswer:
        self.executed.append((text, base, who))
        assert self.go.wait(LIMIT_MS / 1000)
        if not text:
            return DeliveryAnswer(True, "nothing was delivered", version_of("theirs"))
        if base != version_of("theirs"):
            return DeliveryAnswer(False, "the agent has another configuration <b>here</b>", version_of("theirs"))
        problem = {"line": 4, "key": "containers[0].name", "message": "is not known here", "text": "a7.yaml:4: ..."}
        return DeliveryAnswer(
            False, "the configuration is invalid on the agent: 1 problem", version_of("theirs"), (problem,)
        )


def test_a_saved_file_is_delivered_and_the_agents_problems_are_at_the_fields(browser: Browser, file: Path) -> None:
    """After a question each for the delivery and for replacing what someone else has changed."""
    agent = Refusing()
    extra = {
        EXTRA: ConfigEditor(plan_of, [str(file)]),
        DELIVERY: ConfigDelivery({str(file): DeliveryTarget(*agent.where, KEY)}),
    }
    with (
        ground(ListenOptions(port=0), extra=extra) as here,
        tab(browser, f"{here.page.url}checks", viewport={"width": 1400, "height": 1000}) as page,
    ):
        expect(page.locator("#state")).to_contain_text("not changed, valid")
        page.locator("#box-deliver summary").click()
        dialog = page.get_by_role("dialog", name=f"Deliver {file} to")
        page.locator("#deliver").click()
        expect(dialog).to_contain_text("replaces its own")
        assert axe(page) == []
        page.keyboard.press("Enter")
        expect(dialog).to_be_hidden()
        assert agent.executed == []
        page.locator("#deliver").click()
        dialog.get_by_role("button", name="Yes, deliver").click()
        dialog = page.get_by_role("dialog", name="Replace whatever the agent has?")
        expect(dialog).to_contain_text("the agent has another configuration <b>here</b>")
        expect(dialog.get_by_role("button", name="Cancel")).to_be_focused()
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.locator("#delivered")).to_have_text("A07: the configuration is invalid on the agent: 1 problem")
        page.locator("#problems button").click()
        expect(section(page, "containers[0].name").locator(".problem")).to_contain_text("is not known here")
        assert [text for text, _, _ in agent.executed] == [TEXT, "", TEXT]
        interval = section(page, "interval").locator("input")
        interval.fill("30s")
        interval.press("Tab")
        expect(page.locator("#deliver")).to_be_disabled()
        assert axe(page) == []
    agent.server.close()


def test_a_file_that_is_opened_meanwhile_is_not_delivered(browser: Browser, file: Path, tmp_path: Path) -> None:
    """The answer, and the question that follows, are about the file whose button was pressed."""
    agent, other = Refusing(), tmp_path / "a8.yaml"
    other.write_text(TEXT.replace("7", "8"))
    files, target = [str(file), str(other)], DeliveryTarget(*agent.where, KEY)
    extra = {EXTRA: ConfigEditor(plan_of, files), DELIVERY: ConfigDelivery(dict.fromkeys(files, target))}
    with ground(ListenOptions(port=0), extra=extra) as here, tab(browser, f"{here.page.url}checks") as page:
        expect(page.locator("#state")).to_contain_text("a7.yaml: not changed, valid")
        page.locator("#box-deliver summary").click()
        agent.go.clear()
        page.locator("#deliver").click()
        page.get_by_role("button", name="Yes, deliver").click()
        expect(page.locator("#delivered")).to_have_text("delivering...")
        page.locator("#file").select_option(str(other))
        expect(page.locator("#state")).to_contain_text("a8.yaml: not changed, valid")
        agent.go.set()
        page.get_by_role("button", name="Yes, replace").click()
        expect(page.locator("#delivered")).to_have_text("A07: the configuration is invalid on the agent: 1 problem")
        assert [text for text, _, _ in agent.executed] == [TEXT, "", TEXT]
        expect(page.locator("#state")).to_contain_text("a8.yaml: not changed, valid")
    agent.server.close()


def test_a_delivery_without_an_answer_may_have_been_applied(browser: Browser, file: Path) -> None:
    """The connection to the page's server breaks: the page does not say that nothing was done."""
    target = DeliveryTarget("127.0.0.1", 9, KEY)
    extra = {EXTRA: ConfigEditor(plan_of, [str(file)]), DELIVERY: ConfigDelivery({str(file): target})}
    with ground(ListenOptions(port=0), extra=extra) as here, tab(browser, f"{here.page.url}checks") as page:
        page.route("**/api/config/deliver", lambda route: route.abort())
        expect(page.locator("#state")).to_contain_text("not changed, valid")
        page.locator("#box-deliver summary").click()
        page.locator("#deliver").click()
        page.get_by_role("button", name="Yes, deliver").click()
        expect(page.locator("#delivered")).to_contain_text("it is not known whether the configuration was applied")


def test_without_an_agent_nothing_is_offered(page: Page) -> None:
    """Then the commands to copy remain."""
    page.locator("#box-deliver summary").click()
    expect(page.locator("#deliver")).to_be_hidden()
    expect(page.locator("#commands")).to_be_visible()


def test_the_tab_is_there_with_a_file_to_edit_alone(browser: Browser, file: Path) -> None:
    """Without --edit, the page of the swarm does not offer what it cannot save."""
    for files, shown in (([], False), ([str(file)], True)):
        with (
            ground(ListenOptions(port=0), extra={EXTRA: ConfigEditor(plan_of, files)}) as here,
            tab(browser, here.page.url) as page,
        ):
            # Another document first: a request of a document that is left never finishes.
            page.goto("about:blank")
            with page.expect_event("requestfinished", lambda one: one.url.endswith("/api/config"), timeout=LIMIT_MS):
                page.goto(here.page.url)
            expect(page.locator("#tab-checks")).to_be_visible(visible=shown)
            if not shown:
                page.goto(f"{here.page.url}checks")
                expect(page.locator("#upload")).to_be_visible()
