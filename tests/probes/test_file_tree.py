"""Checksums of a folder, and the comparison with its manifest."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from phm.facts import CannotTell
from phm.probes import file_stamp, file_tree, tree_comparison
from phm.probes.file_tree import TreeListing, TreeReader
from phm.probes.tree_comparison import Comparison, Manifests
from phm.testing import FakeClock
from phm.wire import manifest


class Folder:
    """A folder that a reader reads."""

    def __init__(self, path: Path) -> None:
        self.path, self.clock = path, FakeClock()
        self.reader = TreeReader(self.clock)
        self.number = os.open(path, os.O_PATH)

    def write(self, name: str, text: str = "text") -> None:
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)

    def read(self, *ignore: str) -> TreeListing:
        return self.reader.read(self.number, ignore, fresh=True)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Folder]:
    (tmp_path / "tree").mkdir()
    made = Folder(tmp_path / "tree")
    yield made
    os.close(made.number)


@pytest.fixture
def old(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each file counts as one that was written long ago."""
    monkeypatch.setattr(file_stamp, "COARSEST_S", 0.0)


def total(text: str = "text") -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def test_all_files_are_found(folder: Folder) -> None:
    """By their path in the folder; folders themselves do not count, and what is ignored is not read."""
    for name in ("a", "below/b", "below/deep/c", "__pycache__/x.pyc", "log/today.txt"):
        folder.write(name)
    assert folder.read("__pycache__", "log/*.txt").sums == {name: total() for name in ("a", "below/b", "below/deep/c")}


def test_links_are_not_followed(folder: Folder, tmp_path: Path) -> None:
    """Neither to files nor to folders, nor in circles; a link that leads elsewhere has another checksum."""
    (tmp_path / "secret").write_text("secret")
    (folder.path / "out").symlink_to(tmp_path / "secret")
    (folder.path / "up").symlink_to("..")
    first = folder.read().sums
    assert set(first) == {"out", "up"} and total("secret") not in first.values()
    (folder.path / "up").unlink()
    (folder.path / "up").symlink_to("../..")
    assert folder.read().sums["up"] != first["up"]


def test_pipes_are_not_opened(folder: Folder) -> None:
    """Opening one would block."""
    os.mkfifo(folder.path / "pipe")
    folder.write("a")
    assert set(folder.read().sums) == {"a"}


@pytest.mark.usefixtures("old")
def test_a_file_is_read_again_only_when_it_changed(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sums of the others are kept."""
    folder.write("a")
    folder.write("b")
    folder.read()
    folder.write("a", "other")
    reads: list[str] = []
    real = file_tree._Walk._read

    def read(walk: file_tree._Walk, number: int, path: str) -> None:
        reads.append(path)
        real(walk, number, path)

    monkeypatch.setattr(file_tree._Walk, "_read", read)
    assert folder.read().sums == {"a": total("other"), "b": total()}
    assert reads == ["a"]


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """File times in steps, as those of FAT, and as those of ext4 in steps of 4 ms before Linux 6.13."""

    def stamp(info: os.stat_result) -> file_stamp.Stamp:
        return info.st_dev, info.st_ino, info.st_size, 0, 0

    for module in (file_tree, tree_comparison):
        monkeypatch.setattr(module, "stamp", stamp)


@pytest.mark.usefixtures("coarse")
def test_a_change_of_equal_size_is_seen_within_the_resolution_of_the_file_times(folder: Folder) -> None:
    """Files that were written just now are read again."""
    for number in "123":
        folder.write("a", number)
        assert folder.read().sums == {"a": total(number)}


@pytest.mark.usefixtures("coarse")
def test_a_manifest_is_read_again_within_the_resolution_of_the_file_times(tmp_path: Path) -> None:
    """The same for manifests."""
    path, manifests = tmp_path / "manifest", Manifests()
    for number in "123":
        path.write_bytes(manifest.encode({"a": total(number)}))
        assert manifests.read(str(path)) == {"a": total(number)}


def test_a_file_of_a_while_ago_is_settled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one from before the clock was set back."""
    (tmp_path / "a").write_text("a")
    info = os.stat(tmp_path / "a")
    for later_s, last in ((0.0, False), (1.9, False), (2.1, True), (-3600.0, True)):
        monkeypatch.setattr(file_stamp, "time", lambda later_s=later_s: info.st_ctime + later_s)
        assert file_stamp.settled(info) is last


@pytest.mark.usefixtures("old")
def test_a_large_folder_is_read_in_several_looks(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """So much in each; what was not read is pending."""
    monkeypatch.setattr(file_tree, "SCAN_BYTES", 8)
    for name in "abcd":
        folder.write(name)
    assert [len(folder.read().pending) for _ in range(2)] == [2, 0]
    assert folder.read().sums == dict.fromkeys("abcd", total())


def test_too_many_files_or_nested_folders_are_refused(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too many files, and too many folders in each other."""
    monkeypatch.setattr(file_tree, "MAX_FILES", 2)
    for name in "abc":
        folder.write(name)
    with pytest.raises(CannotTell, match="more than 2 files"):
        folder.read()
    assert set(folder.read("c").sums) == {"a", "b"}
    monkeypatch.setattr(file_tree, "MAX_DEPTH", 1)
    folder.write("d/e/f")
    with pytest.raises(CannotTell, match="folders deep"):
        folder.read("a", "b")


def test_a_folder_with_endless_names_is_refused(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each path is kept: 50,000 files behind 60 folders with names of 250 characters would take more memory than PHM may use."""
    monkeypatch.setattr(file_tree, "MAX_PATHS", 5000, raising=False)
    deep = "/".join(letter * 100 for letter in "abcdefgh")
    folder.write(f"{deep}/1")
    assert len(folder.read().sums) == 1
    folder.clock.advance(1000.0)
    folder.write(f"{deep}/2")
    with pytest.raises(CannotTell, match="names of its files and folders are too long"):
        folder.read()


def slow_files(monkeypatch: pytest.MonkeyPatch, clock: FakeClock, seconds: dict[str, float]) -> list[str]:
    """Reading each of these files takes this long; returns the list of files that are read."""
    reads: list[str] = []
    real_read, real_walk_read, current = os.read, file_tree._Walk._read, [""]

    def walk_read(walk: file_tree._Walk, number: int, path: str) -> None:
        current[0] = path
        reads.append(path)
        real_walk_read(walk, number, path)

    def read(number: int, size: int) -> bytes:
        clock.advance(seconds.get(current[0], 0.0))
        return real_read(number, size)

    monkeypatch.setattr(file_tree._Walk, "_read", walk_read)
    monkeypatch.setattr(os, "read", read)
    return reads


def slow_names(monkeypatch: pytest.MonkeyPatch, clock: FakeClock, name_s: float) -> list[str]:
    """Each name of a folder takes this long; returns the list of names that were taken."""
    taken: list[str] = []
    real = os.scandir

    @contextmanager
    def scandir(number: int) -> Iterator[Iterator[os.DirEntry[str]]]:
        def each() -> Iterator[os.DirEntry[str]]:
            for entry in entries:
                clock.advance(name_s)
                taken.append(entry.name)
                yield entry

        with real(number) as entries:
            yield each()

    monkeypatch.setattr(os, "scandir", scandir)
    return taken


@pytest.mark.parametrize("ignore", [(), ("*",)])
def test_a_huge_folder_is_left_before_all_its_names_are_in_memory(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, ignore: tuple[str, ...]
) -> None:
    """Names that are ignored count as well."""
    monkeypatch.setattr(file_tree, "MAX_ENTRIES", 5, raising=False)
    for number in range(20):
        folder.write(f"{number}")
    taken = slow_names(monkeypatch, folder.clock, 0.0)
    with pytest.raises(CannotTell, match="more than 5 files and folders"):
        folder.read(*ignore)
    assert len(taken) == 6


def test_names_that_come_slowly_end_the_walk(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Already while they are read, not only after all are."""
    for number in range(20):
        folder.write(f"{number}")
    taken = slow_names(monkeypatch, folder.clock, file_tree.WALK_S / 4)
    with pytest.raises(CannotTell, match="cannot be listed within"):
        folder.read()
    assert len(taken) < 20


@pytest.mark.usefixtures("old")
def test_a_walk_that_failed_is_not_repeated_at_once(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its problem stays until the next walk is due by cost; then checksums of before are still known."""
    for name in "abc":
        folder.write(name)
    reads = slow_files(monkeypatch, folder.clock, {})
    folder.read()
    taken = slow_names(monkeypatch, folder.clock, 1.0)
    monkeypatch.setattr(file_tree, "MAX_FILES", 2)
    for _ in range(5):
        folder.clock.advance(5.0)
        with pytest.raises(CannotTell, match="more than 2 files"):
            folder.reader.read(folder.number, ())
    assert len(taken) == 3
    monkeypatch.setattr(file_tree, "MAX_FILES", 3)
    folder.clock.advance(3.0 * file_tree.SHARE)
    assert len(folder.reader.read(folder.number, ()).sums) == 3
    assert reads == ["a", "b", "c"]


@pytest.fixture
def slow(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> Folder:
    """The folder with two files and a large one, of which two bytes are read in one scan."""
    monkeypatch.setattr(file_tree, "_PIECE", 2)
    for name in "abc":
        folder.write(name)
    slow_files(monkeypatch, folder.clock, {"a": file_tree.FILE_S + 1.0})
    return folder


@pytest.mark.usefixtures("old")
def test_a_large_file_is_read_in_several_scans(slow: Folder) -> None:
    """Without hiding the others: those are read first in the next one."""
    first, second = slow.read(), slow.read()
    assert (first.pending, first.unreadable, first.part) == ({"a", "b", "c"}, set(), 2)
    assert second.sums == dict.fromkeys("abc", total()) and not second.pending


@pytest.mark.usefixtures("old")
def test_a_large_file_that_changed_is_read_from_its_beginning(slow: Folder) -> None:
    """Also if it changed between two scans, of which each reads a part of it."""
    slow.read()
    slow.write("a", "other")
    listings = [slow.read() for _ in range(3)]
    assert [listing.part for listing in listings] == [2, 4, 0]
    assert [listing.unreadable for listing in listings] == [{"a"}, set(), set()]
    assert listings[-1].sums["a"] == total("other")


@pytest.mark.parametrize("coarsest_s", [0.0, 1e12])
def test_a_large_file_that_is_written_all_the_time_is_named(
    slow: Folder, monkeypatch: pytest.MonkeyPatch, coarsest_s: float
) -> None:
    """It can never be read completely. It is read as seldom as a folder without pending files."""
    monkeypatch.setattr(file_stamp, "COARSEST_S", coarsest_s)
    for other in "bc":
        (slow.path / other).unlink()
    slow.read()
    for turn in range(3):
        slow.write("a", f"text{turn}")
        began_s, listing = slow.clock.mono(), slow.read()
        assert (listing.pending, listing.unreadable) == (set(), {"a"})
        assert slow.reader._next_s - slow.clock.mono() >= file_tree.SHARE * (slow.clock.mono() - began_s)


@pytest.mark.usefixtures("old")
def test_a_large_file_that_changes_all_the_time_does_not_starve_the_others(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files that waited longest come first in each scan."""
    monkeypatch.setattr(file_tree, "SCAN_BYTES", 8)
    for name in "bcdefg":
        folder.write(name)
    for turn in range(8):
        folder.write("a", f"{turn}" * 100)
        listing = folder.read()
    assert {"b", "c", "d", "e", "f", "g"} <= set(listing.sums)


@pytest.mark.parametrize("settled", [True, False])
def test_a_file_that_grows_while_it_is_read_is_left_in_time(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, settled: bool
) -> None:
    """However much of it there is: nothing may keep the reader for long."""
    monkeypatch.setattr(file_stamp, "COARSEST_S", 0.0 if settled else 1e12)
    folder.write("a")
    reads, real = [0], os.read

    def read(number: int, size: int) -> bytes:
        piece = real(number, size)
        reads[0] += 1
        assert reads[0] < 100
        folder.clock.advance(file_tree.FILE_S / 4)
        folder.write("a", "text" * (reads[0] + 1))
        return piece

    monkeypatch.setattr(os, "read", read)
    listing = folder.read()
    assert (listing.pending | listing.unreadable, listing.part, reads[0]) == ({"a"}, 0, 5)


def test_hostile_file_names_are_read_and_not_interpreted(folder: Folder) -> None:
    """Any byte may be in a name; nothing is interpreted."""
    for name in (b"\xff\xfe", b"line\nbreak", b"* ? [", b"-rf"):
        (folder.path / os.fsdecode(name)).write_text("text")
    found = folder.read()
    assert len(found.sums) == 4
    assert manifest.decode(manifest.encode(found.sums)) == found.sums


def test_the_comparison_names_what_differs() -> None:
    """Changed, missing and new files are named; ignored ones are not counted."""
    found = TreeListing({"same": "1", "altered": "2", "added": "3"}, set(), set(), 30)
    fact = Comparison(["*.pyc"]).of({"same": "1", "altered": "0", "gone": "4", "skip.pyc": "5"}, found)
    assert (fact.changed, fact.missing, fact.new, fact.differing) == (("altered",), ("gone",), ("added",), 3)
    assert (fact.files, fact.size) == (3, 30)


def test_files_that_could_not_be_read_are_not_missing() -> None:
    """A file that is pending, and one in a folder that PHM may not read."""
    found = TreeListing({}, {"pending"}, {"private"}, 0)
    fact = Comparison([]).of({"pending": "1", "private/key": "2"}, found)
    assert (fact.differing, fact.pending, fact.unreadable) == (0, 1, ("private",))


def test_names_are_limited_and_counted() -> None:
    """All differences are counted, and a limited number is named."""
    found = TreeListing({f"f{number:03}": "1" for number in range(100)}, set(), set(), 0)
    fact = Comparison([]).of({}, found)
    assert fact.differing == 100 and len(fact.new) == fact.MAX_NAMED


def test_a_manifest_that_is_ignored_entirely_is_not_ok() -> None:
    """Nothing is compared, so nothing is known; a new file is still a difference."""
    with pytest.raises(CannotTell, match="`ignore` covers all files of its manifest"):
        Comparison(["*"]).of({"a": "1", "below/b": "2"}, TreeListing())
    assert Comparison(["*.pyc"]).of({"a.pyc": "1"}, TreeListing({"evil": "2"})).new == ("evil",)


def test_a_manifest_is_read_again_when_it_changes(tmp_path: Path) -> None:
    """Without a restart of PHM."""
    path, manifests = tmp_path / "m", Manifests()
    path.write_text(f"{'a' * 64}  one\n")
    assert set(manifests.read(str(path))) == {"one"}
    path.write_text(f"{'a' * 64}  other\n")
    assert set(manifests.read(str(path))) == {"other"}


@pytest.mark.parametrize("text", [None, "nonsense"])
def test_a_manifest_that_cannot_be_read_says_so(tmp_path: Path, text: str | None) -> None:
    """The remedy is `phm learn`, which writes it."""
    path = tmp_path / "m"
    if text is not None:
        path.write_text(text)
    with pytest.raises(CannotTell, match="phm learn"):
        Manifests().read(str(path))
