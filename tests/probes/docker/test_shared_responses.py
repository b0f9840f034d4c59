"""The Docker probe: which callers share one response of the engine."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

from phm.core import run_start
from phm.core.clock import SystemClock
from phm.facts import CannotTell
from phm.testing import FakeClock
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang
from tests.fakes.until import until
from tests.probes.docker.conftest import HUNG_S
from tests.probes.docker.test_docker_probe import asked, probe


def test_checks_that_run_together_share_one_response(fake: FakeEngine, ask: DockerEngine) -> None:
    """Simultaneous requests are one; a later request gets a response from after its start."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    docker.container("app")
    docker.container("app")
    assert asked(fake, "GET /containers/app/json") == 1
    clock.advance(0.01)
    docker.container("app")
    assert asked(fake, "GET /containers/app/json") == 2


def test_a_response_from_before_the_request_is_not_shared(fake: FakeEngine, ask: DockerEngine) -> None:
    """A container that terminated without an event since another check's request is seen as such: the run began later."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    docker.container("app")
    fake.set("app", status="exited", silently=True)
    clock.advance(0.05)
    fact = docker.container("app")
    assert fact is not None
    assert fact.status == "exited"


def test_checks_that_count_from_the_same_moment_share_one_response(fake: FakeEngine, ask: DockerEngine) -> None:
    """They run one after the other. One that asks again wants to know what has changed, and no response is older than that moment."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)

    def requests(times: int, since: float) -> int:
        """How many requests so many calls in the run of a check cause."""
        before = asked(fake, "GET /containers/app/json")
        with run_start.counting_from(since):
            for _ in range(times):
                clock.advance(0.01)
                docker.container("app")
        return asked(fake, "GET /containers/app/json") - before

    looked_at = clock.mono()
    assert [requests(1, looked_at) for _ in range(3)] == [1, 0, 0]
    assert requests(2, looked_at) == 1
    docker.invalidate()
    assert [requests(1, looked_at) for _ in range(2)] == [1, 0]
    assert requests(1, clock.mono()) == 1
    clock.advance(0.01)
    docker.container("app")
    assert requests(1, looked_at) == 0


def test_a_process_list_does_not_inspect_the_container_again(fake: FakeEngine, ask: DockerEngine) -> None:
    """The check has just inspected the container, and its processes are those of that id, or the engine refuses."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    docker.container("app")
    clock.advance(0.05)
    with contextlib.suppress(CannotTell):
        docker.processes("app")
    assert asked(fake, "GET /containers/app/json") == 1


def test_an_event_invalidates_the_shared_response(fake: FakeEngine, ask: DockerEngine) -> None:
    """After an event no check gets the state from before it."""
    fake.containers["app"] = container("app")
    docker = probe(ask, {"name": "app"})
    docker.container("app")
    fake.set("app", status="exited")
    docker.invalidate()
    fact = docker.container("app")
    assert fact is not None
    assert fact.status == "exited"


def test_an_answer_that_is_young_enough_is_not_requested_again_before_the_next_event(
    fake: FakeEngine, ask: DockerEngine
) -> None:
    """For callers that name an age; without one, each call gets a new answer."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    for _ in range(3):
        docker.container("app", 10.0)
        clock.advance(4.9)
    assert asked(fake, "GET /containers/app/json") == 1
    docker.container("app", 10.0)
    docker.container("app", 10.0)
    assert asked(fake, "GET /containers/app/json") == 2
    docker.invalidate()
    docker.container("app", 10.0)
    clock.advance(0.1)
    docker.container("app")
    assert asked(fake, "GET /containers/app/json") == 4


def test_an_answer_that_is_young_enough_does_not_wait_for_a_request_under_way(
    fake: FakeEngine, ask: DockerEngine
) -> None:
    """The engine of a busy machine takes seconds, and that it is busy would be reported so much later."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    known = docker.container("app")
    clock.advance(0.1)
    fake.fault = Hang(route="/app/")

    def observe() -> None:
        with contextlib.suppress(CannotTell):
            docker.container("app")

    checking = threading.Thread(target=observe)
    checking.start()
    until(lambda: asked(fake, "GET /containers/app/json") == 2, "the request that hangs")
    assert docker.container("app", 10.0) is known
    assert checking.is_alive()
    fake.fault = None
    ask.close()
    checking.join(60)


class NotedClock(SystemClock):
    """Notes which threads have read it."""

    def __init__(self) -> None:
        super().__init__()
        self.readers: set[int | None] = set()

    def mono(self) -> float:
        self.readers.add(threading.get_ident())
        return super().mono()


def test_checks_that_waited_for_a_hung_engine_do_not_wait_again(fake: FakeEngine, ask: DockerEngine) -> None:
    """Five checks on a hung engine end together, not one timeout after the other."""
    clock = NotedClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    ask.version()
    fake.fault, ask.timeout_s = Hang(route="/app/"), HUNG_S
    errors: list[str] = []

    def observe() -> None:
        try:
            docker.container("app")
        except CannotTell as error:
            errors.append(str(error))

    threads = [threading.Thread(target=observe) for _ in range(5)]
    real_ask = docker._ask

    def ask_when_all_wait(*words: Any) -> Any:
        """On a busy machine a thread may begin long after the others, and would then rightly ask again."""
        until(lambda: {thread.ident for thread in threads} <= clock.readers, "all checks to begin")
        return real_ask(*words)

    docker._ask = ask_when_all_wait  # type: ignore[method-assign]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert len(errors) == 5
    assert asked(fake, "GET /containers/app/json") == 1
