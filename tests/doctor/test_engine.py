"""`phm doctor`: the Docker Engine."""

from __future__ import annotations

import socket
from pathlib import Path

from phm.doctor.engine import rows
from tests.doctor.places import doctor_context, row, states
from tests.fakes.engine import FakeEngine
from tests.fakes.engine_faults import Status
from tests.setup.machines import described


def test_an_engine_that_answers_is_ok(tmp_path: Path) -> None:
    """A container of the configuration that it does not have is missing."""
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["app"] = described("app")
        containers = [{"name": "app"}, {"name": "gone"}]
        found = list(rows(doctor_context(tmp_path, docker={"socket": fake.url}, containers=containers)))
    assert states(found) == {"version": "ok", "rights": "ok", "containers": "ok", "container gone": "missing"}
    assert row(found, "version").text == "Docker Engine 20.10.24, API 1.41"


def test_a_container_is_found_by_its_name_alone(tmp_path: Path) -> None:
    """As the daemon finds it: a Compose service is another name, and one that has exited exists."""
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["drone-app-1"] = described("drone-app-1")
        fake.containers["drone-app-1"]["Config"]["Labels"]["com.docker.compose.service"] = "app"
        fake.containers["job"] = described("job", status="exited")
        part = fake.containers["job"]["Id"][:12]
        containers = [{"name": name} for name in ("drone-app-1", "app", "job", part)]
        found = list(rows(doctor_context(tmp_path, docker={"socket": fake.url}, containers=containers)))
    assert {name: state for name, state in states(found).items() if name.startswith("container ")} == {
        "container app": "missing",
        "container job": "limited",
        f"container {part}": "missing",
    }
    assert "drone-app-1" in row(found, "container app").remedy
    assert "exited" in row(found, "container job").text


def test_an_engine_that_is_too_old_is_limited(tmp_path: Path) -> None:
    """The remedy names the oldest version that is supported."""
    with FakeEngine(tmp_path / "engine.sock", api="1.40") as fake:
        found = list(rows(doctor_context(tmp_path, docker={"socket": fake.url})))
    assert row(found, "version").state == "limited" and "20.10" in row(found, "version").remedy


def test_without_an_engine_the_remedy_is_to_start_it(tmp_path: Path) -> None:
    """One row, whose text does not repeat the remedy."""
    (only,) = rows(doctor_context(tmp_path))
    assert only.state == "missing" and only.remedy.startswith("start the Docker Engine")
    assert only.remedy not in only.text


def test_an_engine_that_was_stopped_is_started_first(tmp_path: Path) -> None:
    """It leaves its socket behind. A restart of PHM's container helps only if the engine runs."""
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "none.sock"))
    (only,) = rows(doctor_context(tmp_path))
    assert only.text.startswith("no Docker Engine listens at unix://")
    assert only.remedy.startswith("start it") and "restart PHM's container" in only.remedy


def test_a_proxy_that_refuses_limits_the_rights(tmp_path: Path) -> None:
    """An engine that answers with 403 is reached through a proxy. PHM's own one does not permit the list, and need not: the
    containers of the configuration are looked up one by one.
    """
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["app"] = described("app")
        fake.fault = Status(403, "no", route="/containers/json")
        containers = [{"name": "app"}, {"name": "gone"}]
        found = list(rows(doctor_context(tmp_path, docker={"socket": fake.url}, containers=containers)))
    assert states(found) == {"version": "ok", "rights": "limited", "container gone": "missing"}
    assert "proxy" in row(found, "rights").remedy and "GET" not in row(found, "rights").remedy
