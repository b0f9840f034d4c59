"""Files of containers: read directly from volumes, and through the engine otherwise."""

from __future__ import annotations

import hashlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from phm.facts import CannotTell, ContainerFact, DockerProbe, FileFact, Mount
from phm.probes import file_tree
from phm.probes.docker_facts import container_fact
from phm.probes.files import MAX_BYTES, Files
from phm.probes.inotify import FileWatcher
from phm.probes.volume_path import OutsideVolumes, SeenAt, resolve
from phm.testing import FakeClock, FakeDocker, container as fact, settings
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang
from tests.probes.docker.conftest import HUNG_S


class Mounted:
    """A container `app` with one mount on /data, which PHM sees as `here`, and the engine's view of it."""

    def __init__(self, here: Path, fake: FakeEngine, ask: DockerEngine) -> None:
        self.here, self.fake = here, fake
        here.mkdir()
        self.fact: ContainerFact = fact(
            "app", id="c1", mounts=(Mount(kind="bind", source=str(here), destination="/data"),)
        )
        fake.containers["app"] = container("app", container_id="c1")
        self.probe: DockerProbe = FakeDocker(self.fact)
        self.files = Files(self.probe, ask, settings().docker, FakeClock())

    def read(self, path: str, *, digest: bool = False) -> FileFact | None:
        return self.files.inspect("app", path, digest=digest)

    def engine_has(self, path: str, content: bytes) -> None:
        self.fake.containers["app"]["_files"][path] = content

    @property
    def archive_calls(self) -> int:
        return sum("archive" in call for call in self.fake.calls)


@pytest.fixture
def mounted(tmp_path: Path, fake: FakeEngine, ask: DockerEngine) -> Mounted:
    return Mounted(tmp_path / "volume", fake, ask)


def test_a_file_in_a_volume_is_read_without_the_engine(mounted: Mounted) -> None:
    """The volume is read directly, with mode, size and digest, while the engine hangs."""
    (mounted.here / "model.bin").write_bytes(b"weights")
    (mounted.here / "model.bin").chmod(0o750)
    mounted.fake.fault = Hang()
    seen = mounted.read("/data/model.bin", digest=True)
    assert seen == FileFact("/data/model.bin", "file", 7, 0o750, True, hashlib.sha256(b"weights").hexdigest(), "volume")


def test_a_volume_is_read_while_the_engine_is_down(mounted: Mounted) -> None:
    """The mounts are known from before; a file outside of volumes is unknown."""
    (mounted.here / "model.bin").write_bytes(b"weights")
    mounted.read("/data/model.bin")
    assert isinstance(mounted.probe, FakeDocker)
    mounted.probe.fail("the engine is down")
    assert mounted.read("/data/model.bin") is not None
    (mounted.here / "model.bin").unlink()
    assert mounted.read("/data/model.bin") is None
    with pytest.raises(CannotTell, match="the engine is down"):
        mounted.read("/opt/app")


def test_a_missing_file_and_a_directory_in_a_volume_are_distinguished(mounted: Mounted) -> None:
    """Absence in a volume is certain, and a directory is not a file."""
    assert mounted.read("/data/none") is None
    assert mounted.read("/data/none/deeper") is None
    directory = mounted.read("/data", digest=True)
    assert directory is not None
    assert (directory.kind, directory.sha256) == ("directory", "")


@pytest.mark.parametrize(("own", "seen_through"), [("", "engine"), ("install", "volume")])
def test_a_volume_with_a_subpath_is_another_folder_than_the_whole_volume(
    own: str, seen_through: str, tmp_path: Path, fake: FakeEngine, ask: DockerEngine
) -> None:
    """PHM would report the application's files as missing. The application may replace that folder of the volume by a
    link, so PHM does not look for it there."""
    (tmp_path / "setup.bash").write_text("")
    app = container("app", container_id="c1", mounts=[volume("/ws")])
    app["HostConfig"]["Mounts"] = [
        {"Type": "volume", "Source": "app", "Target": "/ws", "VolumeOptions": {"Subpath": "install"}}
    ]
    me = container("phm", container_id="c2", mounts=[volume(str(tmp_path))])
    me["HostConfig"]["Mounts"] = [
        {"Type": "volume", "Source": "app", "Target": str(tmp_path), "VolumeOptions": {"Subpath": own}}
    ]
    probe = FakeDocker(container_fact(app), me=container_fact(me))
    fake.containers["app"] = app
    app["_files"]["/ws/setup.bash"] = b""
    seen = Files(probe, ask, settings().docker, FakeClock()).inspect("app", "/ws/setup.bash", digest=False)
    assert seen is not None and seen.seen_through == seen_through


def volume(destination: str) -> dict[str, object]:
    source = "/var/lib/docker/volumes/app/_data"
    return {"Type": "volume", "Name": "app", "Source": source, "Destination": destination, "RW": True}


def test_a_file_outside_of_volumes_is_read_through_the_engine(mounted: Mounted) -> None:
    """The image's own files come from the archive route and are hashed as a stream."""
    mounted.engine_has("/opt/app", b"binary")
    seen = mounted.read("/opt/app", digest=True)
    assert seen is not None
    assert (seen.seen_through, seen.sha256, seen.kind) == ("engine", hashlib.sha256(b"binary").hexdigest(), "file")
    assert mounted.read("/opt/none") is None


def test_a_digest_is_read_again_only_when_the_file_changed(mounted: Mounted) -> None:
    """Reading a large file every few seconds would wear the SD card: size, times and inode decide."""
    file = mounted.here / "model.bin"
    file.write_bytes(b"one")
    first = mounted.read("/data/model.bin", digest=True)
    again = mounted.read("/data/model.bin", digest=True)
    assert first == again
    file.write_bytes(b"two")
    os.utime(file, ns=(1, 1))
    changed = mounted.read("/data/model.bin", digest=True)
    assert changed is not None
    assert changed.sha256 == hashlib.sha256(b"two").hexdigest()
    mounted.engine_has("/opt/app", b"binary")
    mounted.read("/opt/app", digest=True)
    before = list(mounted.fake.calls).count("GET /containers/c1/archive")
    mounted.read("/opt/app", digest=True)
    assert list(mounted.fake.calls).count("GET /containers/c1/archive") == before


def test_a_file_that_is_too_large_is_rejected_before_it_is_read(
    mounted: Mounted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its size is known, and reading a gibibyte every few seconds would wear the SD card. A slow one is not read again."""
    file = mounted.here / "bag.mcap"
    file.touch()
    os.truncate(file, MAX_BYTES + 1)
    read: list[bytes] = []
    sha256 = hashlib.sha256
    monkeypatch.setattr(hashlib, "sha256", lambda: SimpleNamespace(update=read.append, hexdigest=sha256().hexdigest))
    with pytest.raises(CannotTell, match="too large to be read: 1024 MiB or more"):
        mounted.read("/data/bag.mcap", digest=True)
    assert read == []
    os.truncate(file, 1 << 20)
    monkeypatch.setattr("phm.probes.files.DIGEST_S", -1.0)
    for _ in range(3):
        with pytest.raises(CannotTell, match="too large"):
            mounted.read("/data/bag.mcap", digest=True)
    assert len(read) == 1


def test_a_symlink_within_the_volume_is_followed(mounted: Mounted) -> None:
    """Relative links, and absolute ones with the container's own paths, lead to the file."""
    (mounted.here / "v2").mkdir()
    (mounted.here / "v2" / "model").write_bytes(b"new")
    (mounted.here / "current").symlink_to("v2")
    (mounted.here / "absolute").symlink_to("/data/v2/../v2/model")
    for path in ("/data/current/model", "/data/absolute", "/data/./v2/../current//model"):
        seen = mounted.read(path)
        assert seen is not None
        assert (seen.kind, seen.size, seen.seen_through) == ("file", 3, "volume")


@pytest.mark.parametrize("target", ["/etc/passwd", "../../../../../../../../etc/passwd", "../secret"])
def test_a_symlink_out_of_the_volume_never_leads_to_phms_own_files(mounted: Mounted, target: str) -> None:
    """Any program that writes to the volume controls the target: it is resolved in the container, by the engine."""
    (mounted.here.parent / "secret").write_bytes(b"of PHM")
    (mounted.here / "link").symlink_to(target)
    assert mounted.read("/data/link", digest=True) is None
    assert mounted.archive_calls > 0
    mounted.engine_has("/data/link", b"of the container")
    seen = mounted.read("/data/link", digest=True)
    assert seen is not None
    assert (seen.seen_through, seen.sha256) == ("engine", hashlib.sha256(b"of the container").hexdigest())


def test_symlinks_in_a_cycle_are_missing_files(mounted: Mounted) -> None:
    """The search ends after as many links as the kernel follows."""
    (mounted.here / "a").symlink_to("b")
    (mounted.here / "b").symlink_to("a")
    assert mounted.read("/data/a") is None


def test_a_pipe_is_not_opened(mounted: Mounted) -> None:
    """Reading a pipe without a writer would block the check: its kind is `other`, and it has no digest."""
    os.mkfifo(mounted.here / "pipe")
    seen = mounted.read("/data/pipe", digest=True)
    assert seen is not None
    assert (seen.kind, seen.sha256) == ("other", "")


def test_a_volume_that_phm_may_not_read_is_read_through_the_engine(
    mounted: Mounted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PHM is not root: EACCES in the volume proves nothing about the file."""
    (mounted.here / "private").mkdir()
    mounted.engine_has("/data/private/key", b"k")
    real_open = os.open

    def forbidden(path: Any, *args: Any, **kwargs: Any) -> int:
        if path == "key":
            raise PermissionError(13, "Permission denied")
        return real_open(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", forbidden)
    seen = mounted.read("/data/private/key")
    assert seen is not None
    assert seen.seen_through == "engine"


def test_a_mount_below_a_volume_that_phm_does_not_see_hides_its_files(mounted: Mounted) -> None:
    """A tmpfs on /data/cache: the container does not see what the volume has there."""
    (mounted.here / "cache").mkdir()
    (mounted.here / "cache" / "old").write_bytes(b"")
    with pytest.raises(OutsideVolumes):
        resolve("/data/cache/old", {"/data": SeenAt(str(mounted.here)), "/data/cache": None})


def test_phm_in_a_container_uses_its_own_mounts(tmp_path: Path, fake: FakeEngine, ask: DockerEngine) -> None:
    """The same volume by name, or a directory that contains the source of the bind, as mounted in PHM's container."""
    named, host = tmp_path / "named", tmp_path / "host"
    (host / "maps").mkdir(parents=True)
    named.mkdir()
    (named / "a").write_bytes(b"1")
    (host / "maps" / "b").write_bytes(b"22")
    app = fact(
        "app",
        id="c1",
        mounts=(
            Mount(kind="volume", source="/var/lib/docker/volumes/m/_data", destination="/models", name="m"),
            Mount(kind="bind", source="/srv/swarm/maps", destination="/maps"),
            Mount(kind="bind", source="/srv/other", destination="/other"),
        ),
    )
    me = fact(
        "phm",
        mounts=(
            Mount(kind="volume", source="/elsewhere", destination=str(named), name="m"),
            Mount(kind="bind", source="/srv/swarm", destination=str(host)),
        ),
    )
    fake.containers["app"] = container("app", container_id="c1", files={"/other/c": b"333"})
    files = Files(FakeDocker(app, me=me), ask, settings().docker, FakeClock())
    sizes = {}
    for path in ("/models/a", "/maps/b", "/other/c"):
        seen = files.inspect("app", path, digest=False)
        assert seen is not None
        sizes[path] = (seen.size, seen.seen_through)
    assert sizes == {"/models/a": (1, "volume"), "/maps/b": (2, "volume"), "/other/c": (3, "engine")}


@pytest.mark.parametrize("at", ["/srv/swarm/ws/data", "/srv/swarm/ws/data/maps"])
def test_a_link_in_the_place_of_a_mounts_source_never_leads_to_phms_own_files(
    tmp_path: Path, fake: FakeEngine, ask: DockerEngine, at: str
) -> None:
    """A program that writes to a folder that PHM sees controls what is at the source of other mounts below it."""
    host, private = tmp_path / "host", tmp_path / "private"
    (host / "ws").mkdir(parents=True)
    (private / "maps").mkdir(parents=True)
    for folder in (private, private / "maps"):
        (folder / "secret").write_bytes(b"of PHM")
    (host / "ws" / "data").symlink_to(private)
    app = fact("app", id="c1", mounts=(Mount(kind="bind", source=at, destination="/data"),))
    me = fact("phm", mounts=(Mount(kind="bind", source="/srv/swarm", destination=str(host)),))
    fake.containers["app"] = container("app", container_id="c1", files={"/data/secret": b"of the container"})
    files = Files(FakeDocker(app, me=me), ask, settings().docker, FakeClock())
    seen = files.inspect("app", "/data/secret", digest=True)
    assert seen is not None
    assert (seen.seen_through, seen.sha256) == ("engine", hashlib.sha256(b"of the container").hexdigest())


def test_a_remote_engine_has_other_paths(tmp_path: Path, fake: FakeEngine, ask: DockerEngine) -> None:
    """Behind tcp:// the source of a mount is meaningless here, even if such a path exists."""
    (tmp_path / "a").write_bytes(b"ours")
    app = fact("app", id="c1", mounts=(Mount(kind="bind", source=str(tmp_path), destination="/data"),))
    fake.containers["app"] = container("app", container_id="c1", files={"/data/a": b"theirs!"})
    files = Files(FakeDocker(app), ask, settings(docker={"socket": "tcp://192.0.2.1:2375"}).docker, FakeClock())
    seen = files.inspect("app", "/data/a", digest=False)
    assert seen is not None
    assert (seen.size, seen.seen_through) == (7, "engine")


def test_a_file_on_a_tmpfs_is_unknown(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine cannot read a tmpfs: its `not found` does not prove that the file is missing."""
    app = fact("app", id="c1", mounts=(Mount(kind="tmpfs", source="", destination="/run"),))
    fake.containers["app"] = container("app", container_id="c1")
    files = Files(FakeDocker(app), ask, settings().docker, FakeClock())
    with pytest.raises(CannotTell, match="is in memory"):
        files.inspect("app", "/run/lock", digest=False)


def test_without_a_container_its_files_are_unknown(ask: DockerEngine) -> None:
    """A container that does not exist is reported by its own check, not as a missing file."""
    files = Files(FakeDocker(), ask, settings().docker, FakeClock())
    with pytest.raises(CannotTell, match="container app does not exist"):
        files.inspect("app", "/etc/hosts", digest=False)


def test_with_a_hung_engine_a_file_is_unknown(mounted: Mounted, ask: DockerEngine) -> None:
    """Outside of volumes a silent engine does not mean a missing file."""
    mounted.fake.fault, ask.timeout_s = Hang(), HUNG_S
    with pytest.raises(CannotTell):
        mounted.read("/opt/app")


def test_a_folder_that_hangs_does_not_block_other_folders(mounted: Mounted, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second look at the same folder waits for a limited time, and cannot tell."""
    for name in ("stuck", "healthy"):
        (mounted.here / name).mkdir()
        (mounted.here / name / name).write_text("text")
    hangs, go_on, real = threading.Event(), threading.Event(), file_tree._Walk._read

    def read(walk: file_tree._Walk, number: int, path: str) -> None:
        if path == "stuck":
            hangs.set()
            go_on.wait(120)
        real(walk, number, path)

    monkeypatch.setattr(file_tree._Walk, "_read", read)
    monkeypatch.setattr(file_tree, "BUSY_S", 0.01, raising=False)
    threading.Thread(target=mounted.files.listing, args=("app", "/data/stuck", ()), name="stuck", daemon=True).start()
    try:
        assert hangs.wait(60)
        with ThreadPoolExecutor(1) as pool:
            try:
                healthy = pool.submit(mounted.files.listing, "app", "/data/healthy", ()).result(60)
                assert healthy is not None and set(healthy.sums) == {"healthy"}
                with pytest.raises(CannotTell, match="still reading"):
                    pool.submit(mounted.files.listing, "app", "/data/stuck", ()).result(60)
            finally:
                go_on.set()
    finally:
        go_on.set()


def test_a_change_in_a_volume_triggers_the_check(tmp_path: Path, fake: FakeEngine, ask: DockerEngine) -> None:
    """The application's changes to its own files and to symlinks count."""
    here = tmp_path / "volume"
    here.mkdir()
    app = fact("app", id="c1", mounts=(Mount(kind="bind", source=str(here), destination="/data"),))
    triggered, watcher = threading.Semaphore(0), FileWatcher()
    files = Files(FakeDocker(app), ask, settings().docker, FakeClock(), watcher, triggered.release)
    try:
        (here / "models").mkdir()
        (here / "current").symlink_to("models")
        assert files.inspect("app", "/data/current/model.bin", digest=False) is None
        assert triggered.acquire(timeout=60), "the watch has started, and the file is checked once more"
        (here / "models/model.bin").write_bytes(b"weights")
        assert triggered.acquire(timeout=60)
        assert files.inspect("app", "/data/current/model.bin", digest=False) is not None
        while triggered.acquire(timeout=0.2):
            pass
        (here / "models/model.bin").chmod(0o755)
        assert triggered.acquire(timeout=60)
    finally:
        watcher.close()
