"""Folders of containers with manifests. Of what is mounted into them, a container does not see what it covers."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from phm.facts import CannotTell, Mount
from phm.probes import file_stamp, tree_comparison
from phm.probes.files import Files
from phm.testing import FakeClock, FakeDocker, container as fact, settings
from phm.transport.docker import DockerEngine
from phm.wire import manifest


def total(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def files(*mounts: Mount) -> Files:
    chosen, clock = settings().docker, FakeClock()
    return Files(FakeDocker(fact("app", mounts=mounts)), DockerEngine(chosen.socket), chosen, clock)


def bind(source: Path, destination: str) -> Mount:
    return Mount(kind="bind", source=str(source), destination=destination)


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_a_file_that_is_mounted_into_the_folder_is_compared(tmp_path: Path) -> None:
    """A healthy one is as in the manifest, an altered one is reported; what it covers in the volume does not matter."""
    write(tmp_path / "ws/config/params.yaml", "covered")
    seen = write(tmp_path / "params.yaml", "seen")
    expected = tmp_path / "ws.sha256"
    expected.write_bytes(manifest.encode({"config/params.yaml": total("seen")}))
    app = files(bind(tmp_path / "ws", "/ws"), bind(seen, "/ws/config/params.yaml"))

    def changed() -> tuple[str, ...]:
        compared = app.tree("app", "/ws", manifest=str(expected), ignore=())
        assert compared is not None and compared.differing == len(compared.changed)
        return compared.changed

    assert changed() == ()
    seen.write_text("altered")
    assert changed() == ("config/params.yaml",)


def test_folders_that_are_mounted_into_the_folder_are_read(tmp_path: Path) -> None:
    """Also one in the other, and not what they cover."""
    write(tmp_path / "ws/install/covered", "covered")
    write(tmp_path / "ws/own", "own")
    write(tmp_path / "install/lib/covered", "covered")
    write(tmp_path / "install/setup.bash", "setup")
    write(tmp_path / "lib/a.so", "a")
    app = files(
        bind(tmp_path / "lib", "/ws/install/lib"),
        bind(tmp_path / "install", "/ws/install"),
        bind(tmp_path / "ws", "/ws"),
    )
    found = app.listing("app", "/ws", ())
    assert found is not None
    assert found.sums == {"own": total("own"), "install/setup.bash": total("setup"), "install/lib/a.so": total("a")}


@pytest.mark.parametrize("hidden", ["tmpfs", "volume"])
def test_a_mount_in_the_folder_that_is_not_seen_is_not_ok(tmp_path: Path, hidden: str) -> None:
    """It is named, for the user to mount it for PHM or to ignore it."""
    write(tmp_path / "ws/run/covered", "covered")
    write(tmp_path / "ws/own", "own")
    app = files(bind(tmp_path / "ws", "/ws"), Mount(kind=hidden, source="", destination="/ws/run"))
    with pytest.raises(CannotTell, match=r"another mount .* run\b.*`ignore`"):
        app.listing("app", "/ws", ())
    found = app.listing("app", "/ws", ("run",))
    assert found is not None and set(found.sums) == {"own"}


@pytest.mark.parametrize("folder", ["/ws", "/ws/current"])
@pytest.mark.parametrize("destination", ["/ws/current/params.yaml", "/ws/v1/params.yaml", "/ws/v1/link.yaml"])
def test_links_on_the_way_to_a_mount_are_followed(tmp_path: Path, folder: str, destination: str) -> None:
    """As Docker follows them when it mounts."""
    write(tmp_path / "ws/v1/params.yaml", "covered")
    (tmp_path / "ws/v1/link.yaml").symlink_to("params.yaml")
    (tmp_path / "ws/current").symlink_to("v1")
    app = files(bind(tmp_path / "ws", "/ws"), bind(write(tmp_path / "params.yaml", "seen"), destination))
    found = app.listing("app", folder, ("current", "link.yaml"))
    assert found is not None
    assert [*found.sums.values()] == [total("seen")]


def test_a_mount_that_is_gone_is_not_seen_by_the_container_either(tmp_path: Path) -> None:
    """The kernel removes a mount with the folder below it."""
    write(tmp_path / "ws/own", "own")
    app = files(bind(tmp_path / "ws", "/ws"), bind(tmp_path, "/ws/gone"))
    found = app.listing("app", "/ws", ())
    assert found is not None and set(found.sums) == {"own"}


def test_descriptors_of_mounts_are_closed(tmp_path: Path) -> None:
    """However often the folder is looked at."""
    write(tmp_path / "ws/config/params.yaml", "covered")
    seen = write(tmp_path / "params.yaml", "seen")
    app = files(bind(tmp_path / "ws", "/ws"), bind(seen, "/ws/config/params.yaml"))
    app.listing("app", "/ws", ())
    before = len(os.listdir("/proc/self/fd"))
    app.listing("app", "/ws", (), fresh=True)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_folder_is_compared_again_only_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the folder or of the manifest. The patterns are compared with the names of a manifest once."""
    monkeypatch.setattr(file_stamp, "COARSEST_S", 0.0)  # each file counts as one that was written long ago
    calls: list[str] = []
    for name in ("compare", "_ignored"):
        real = getattr(tree_comparison, name)
        monkeypatch.setattr(tree_comparison, name, lambda *of, name=name, real=real: (calls.append(name), real(*of))[1])
    own = write(tmp_path / "ws/own", "own")
    expected = tmp_path / "ws.sha256"
    expected.write_bytes(manifest.encode({"own": total("own")}))
    app = files(bind(tmp_path / "ws", "/ws"))

    def look() -> tuple[list[str], int]:
        calls.clear()
        compared = app.tree("app", "/ws", manifest=str(expected), ignore=("*.pyc",))
        assert compared is not None
        return calls, compared.differing

    assert look() == (["_ignored", "compare"], 0)
    assert look() == ([], 0)
    own.write_text("altered")
    assert look() == (["compare"], 1)
    expected.write_bytes(manifest.encode({"own": total("altered")}))
    os.utime(expected, ns=(1, 1))  # times of files may have steps of 4 ms, and it has the same size
    assert look() == (["_ignored", "compare"], 0)
