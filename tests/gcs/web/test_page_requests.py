"""What an operator requests on the page is answered by a real agent, or refused with its reason."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from phm.core.model import Level, Slot
from phm.gcs import operator
from phm.transport.dialect import mavlink
from tests.fakes.until import until
from tests.gcs.test_daemon import agent
from tests.gcs.web.swarm import Client, Ground, Live, Vehicle, ground


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    """With agent 7, whose container cannot be reached and which permits checks, restarts and holds."""
    with ground() as made:
        daemon = agent(
            tmp_path_factory.mktemp("agent"),
            7,
            f"udpout:127.0.0.1:{made.port}",
            engine=True,
            commands=["status", "details", "check", "restart", "hold"],
        )
        daemon.start()
        yield made
        daemon.stop()


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine an answer takes a while."""
    monkeypatch.setattr(operator, "RESEND_S", 15.0)
    monkeypatch.setattr(operator, "REPLY_S", 60.0)


@pytest.fixture
def live(here: Ground) -> Live:
    found = here.live()
    until(lambda: found.agent("A07").get("presence") == "alive", "the agent")
    return found


@pytest.fixture
def client(here: Ground) -> Client:
    made = here.client()
    made.session()
    return made


def command(vehicle: Vehicle) -> Any:
    """What it is asked for. The station sends all commands on its one link: those to other agents arrive here, too."""

    def asked() -> list[Any]:
        received = [one for one in vehicle.receive() if one.get_type() == "COMMAND_LONG"]
        return [one for one in received if one.target_system == vehicle.number]

    return until(asked, "the command")[0]


def answer(live: Live, number: int) -> dict[str, Any]:
    """The complete answer to a request, as the page gets it."""

    def found() -> list[dict[str, Any]]:
        said = [one for body in live.of("requests") for one in body["requests"]]
        return [one for one in said if one["id"] == number and one["state"] != "sent"]

    until(found, "the answer")
    return found()[-1]


def containers(client: Client, live: Live) -> None:
    if not live.agent("A07")["containers"]:
        sent = client.post("/api/requests", {"agent": "A07", "do": "containers"}, 202)
        answer(live, sent["id"])
        until(lambda: live.agent("A07")["containers"] == ["app"], "the containers")


def test_a_check_is_accepted_in_the_words_of_the_agent(client: Client, live: Live) -> None:
    """And the page shows it without asking again."""
    sent = client.post("/api/requests", {"agent": "A07", "do": "check"}, 202)
    assert (sent["state"], sent["accepted"]) == ("sent", None)
    found = answer(live, sent["id"])
    assert (found["state"], found["accepted"], found["late"]) == ("answered", True, False)
    assert found["sentence"] == "A07 run all checks: accepted: running all checks"
    assert found in client.get("/api/requests")["requests"]


def test_the_agent_refuses_a_restart_with_its_reason(client: Client, live: Live) -> None:
    """The container has not opted in."""
    containers(client, live)
    found = answer(live, client.post("/api/requests", {"agent": "A07", "do": "restart", "container": "app"}, 202)["id"])
    assert (found["accepted"], found["result"]) == (False, "FAILED")
    assert "recover" in found["reply"]


def test_a_hold_begins_and_ends(client: Client, live: Live) -> None:
    """For the time that the operator chose, as `phm hold` on board."""
    containers(client, live)
    ask = {"agent": "A07", "container": "app"}
    begun = answer(live, client.post("/api/requests", {**ask, "do": "hold", "for_s": 120}, 202)["id"])
    assert begun["accepted"], begun
    assert "app" in begun["reply"]
    ended = answer(live, client.post("/api/requests", {**ask, "do": "release"}, 202)["id"])
    assert ended["accepted"], ended

    def lines() -> list[str]:
        return [event["text"] for event in live.events() if event["event"] == "text"]

    until(lambda: {"A07 HOLD 2 app 120 s", "A07 HOLD 2 app released"} <= set(lines()), "both lines", lines)


def test_the_page_says_what_a_request_does(client: Client, live: Live) -> None:
    """Each choice that changes something has a sentence for its confirmation."""
    containers(client, live)
    found = client.get("/api/choices?agent=A07")["choices"]
    kinds = {(one["do"], one.get("container")) for one in found}
    assert {("check", None), ("restart", "app"), ("hold", "app"), ("release", "app")} <= kinds
    assert all(one["will"].endswith((".", "why.")) for one in found)
    assert {one["do"] for one in found if one["confirm"]} == {"restart", "hold", "release"}


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        ({"agent": "A99", "do": "check"}, 409, "there is no agent A99"),
        ({"agent": 7, "do": "check"}, 400, "agent must be the name"),
        ({"agent": "A07", "do": "reboot"}, 400, "do must be check"),
        ({"agent": "A07", "do": "approve", "fault": "17"}, 400, "fault must be a whole number"),
        ({"agent": "A07", "do": "approve", "fault": 17}, 409, "no longer advises"),
        ({"agent": "A07", "do": "restart", "container": "<b>"}, 409, "has not listed this container"),
        ({"agent": "A07", "do": "restart"}, 400, "container must be the name"),
    ],
)
def test_a_request_that_cannot_be_sent_is_refused_here(
    client: Client, live: Live, body: dict[str, Any], status: int, words: str
) -> None:
    """With a sentence, and nothing is sent."""
    assert words in client.post("/api/requests", body, status)["error"]


def test_load_values_arrive_after_a_request(client: Client, live: Live, here: Ground) -> None:
    """In the row, with the time of their reception."""
    vehicle = here.vehicle(8)
    vehicle.heartbeat()
    until(lambda: live.agent("A08"), "the agent")
    client.post("/api/requests", {"agent": "A08", "do": "load"}, 202)
    asked = command(vehicle)
    assert (asked.command, asked.param1, asked.param2) == (511, 390, 10e6)
    vehicle.send(computer(cpu=37, used=50, total=200))
    until(lambda: live.agent("A08")["values"], "the values")
    assert {"cpu": 37, "memory": 25.0}.items() <= live.agent("A08")["values"].items()
    assert "temperature" not in live.agent("A08")["values"]


@pytest.mark.parametrize(("agent", "do", "interval_us"), [(11, "rates", 10e6), (12, "rates_off", -1.0)])
def test_the_rates_of_topics_are_requested(
    client: Client, live: Live, here: Ground, agent: int, do: str, interval_us: float
) -> None:
    """As NAMED_VALUE_FLOAT, periodically."""
    vehicle = here.vehicle(agent)
    vehicle.heartbeat()
    until(lambda: live.agent(f"A{agent}"), "the agent")
    client.post("/api/requests", {"agent": f"A{agent}", "do": do}, 202)
    asked = command(vehicle)
    assert (asked.command, asked.param1, asked.param2) == (511, 251, interval_us)


def test_a_late_answer_is_shown(client: Client, live: Live, here: Ground, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the time-out the request says TIMEOUT; the answer that comes then corrects it."""
    monkeypatch.setattr(operator, "RESEND_S", 0.05)
    monkeypatch.setattr(operator, "REPLY_S", 2.0)
    vehicle = here.vehicle(9)
    vehicle.heartbeat({Slot.CONTAINER: Level.ERROR})
    vehicle.say("A09 ADVISE 2 restart app #17 60s", 4)
    until(lambda: live.agent("A09").get("advice"), "the advice")
    sent = client.post("/api/requests", {"agent": "A09", "do": "approve", "fault": 17}, 202)
    assert answer(live, sent["id"])["state"] == "timeout"
    vehicle.send(mavlink.MAVLink_command_ack_message(31010, 0, 0, 0, 254, 190))
    until(lambda: answer(live, sent["id"])["late"], "the late answer")
    found = answer(live, sent["id"])
    assert (found["state"], found["accepted"]) == ("answered", True)
    assert found["sentence"].endswith("(late)")


def test_an_agent_that_is_lost_gets_nothing(client: Client, live: Live, here: Ground) -> None:
    """The refusal says so, and there is nothing to choose from."""
    vehicle = here.vehicle(10)
    vehicle.heartbeat()
    until(lambda: live.agent("A10"), "the agent")
    vehicle.heartbeat(state=7)
    until(lambda: live.agent("A10")["presence"] == "left", "its end")
    assert "the agent is left" in client.post("/api/requests", {"agent": "A10", "do": "check"}, 409)["error"]
    assert client.get("/api/choices?agent=A10") == {"choices": [], "note": "the agent is left"}


def computer(*, cpu: int, used: int, total: int) -> Any:
    unknown = 2**32 - 1
    return mavlink.MAVLink_onboard_computer_status_message(
        time_usec=0,
        uptime=0,
        type=0,
        cpu_cores=[255] * 8,
        cpu_combined=[cpu, *[255] * 9],
        gpu_cores=[255] * 4,
        gpu_combined=[255] * 10,
        temperature_board=127,
        temperature_core=[127] * 8,
        fan_speed=[32767] * 4,
        ram_usage=used,
        ram_total=total,
        storage_type=[unknown] * 4,
        storage_usage=[unknown] * 4,
        storage_total=[unknown] * 4,
        link_type=[unknown] * 6,
        link_tx_rate=[unknown] * 6,
        link_rx_rate=[unknown] * 6,
        link_tx_max=[unknown] * 6,
        link_rx_max=[unknown] * 6,
    )
