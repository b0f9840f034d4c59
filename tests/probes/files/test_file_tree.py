"""Checksums of a folder, and the comparison with its manifest."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.facts import CannotTell
from phm.probes import file_tree
from phm.probes.file_tree import TreeListing, TreeReader
from phm.probes.tree_comparison import Manifests, compare
from phm.testing import FakeClock
from phm.wire import manifest


class Folder:
    """A folder that a reader reads."""

    def __init__(self, path: Path) -> None:
        self.path, self.reader = path, TreeReader(FakeClock())
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


def test_a_file_is_read_again_only_when_it_changed(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_large_folder_is_read_in_several_looks(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """So much in each; what was not read is pending."""
    monkeypatch.setattr(file_tree, "LOOK_BYTES", 8)
    for name in "abcd":
        folder.write(name)
    assert [len(folder.read().pending) for _ in range(2)] == [2, 0]
    assert folder.read().sums == dict.fromkeys("abcd", total())


def test_limits(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_hostile_names(folder: Folder) -> None:
    """Any byte may be in a name; nothing is interpreted."""
    for name in (b"\xff\xfe", b"line\nbreak", b"* ? [", b"-rf"):
        (folder.path / os.fsdecode(name)).write_text("text")
    found = folder.read()
    assert len(found.sums) == 4
    assert manifest.decode(manifest.encode(found.sums)) == found.sums


def test_the_comparison_names_what_differs() -> None:
    found = TreeListing({"same": "1", "altered": "2", "added": "3"}, set(), set(), 30)
    fact = compare({"same": "1", "altered": "0", "gone": "4", "skip.pyc": "5"}, found, ["*.pyc"])
    assert (fact.changed, fact.missing, fact.new, fact.differing) == (("altered",), ("gone",), ("added",), 3)
    assert (fact.files, fact.size) == (3, 30)


def test_what_could_not_be_read_is_not_missing() -> None:
    """A file that is pending, and one in a folder that PHM may not read."""
    found = TreeListing({}, {"pending"}, {"private"}, 0)
    fact = compare({"pending": "1", "private/key": "2"}, found, [])
    assert (fact.differing, fact.pending, fact.unreadable) == (0, 1, ("private",))


def test_names_are_limited_and_counted() -> None:
    found = TreeListing({f"f{number:03}": "1" for number in range(100)}, set(), set(), 0)
    fact = compare({}, found, [])
    assert fact.differing == 100 and len(fact.new) == fact.MAX_NAMED


def test_a_manifest_is_read_again_when_it_changes(tmp_path: Path) -> None:
    path, manifests = tmp_path / "m", Manifests()
    path.write_text(f"{'a' * 64}  one\n")
    assert set(manifests.read(str(path))) == {"one"}
    path.write_text(f"{'a' * 64}  other\n")
    assert set(manifests.read(str(path))) == {"other"}


@pytest.mark.parametrize("text", [None, "nonsense"])
def test_a_manifest_that_cannot_be_read_says_so(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "m"
    if text is not None:
        path.write_text(text)
    with pytest.raises(CannotTell, match="phm learn"):
        Manifests().read(str(path))
