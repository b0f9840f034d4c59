"""The manifest of a folder, in the format of sha256sum."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from phm.wire import manifest

SUM = "ab" * 32
NAMES = st.binary(min_size=1, max_size=20).map(
    lambda raw: raw.replace(b"\0", b"_").replace(b"/", b"_").decode("utf-8", "surrogateescape")
)


@given(st.dictionaries(NAMES.filter(lambda name: name not in (".", "..")), st.just(SUM), max_size=5))
def test_any_file_name_survives(files: dict[str, str]) -> None:
    """Also bytes that are not UTF-8, line breaks and backslashes."""
    assert manifest.decode(manifest.encode(files, "a comment\nof two lines")) == files


def test_sha256sum_reads_it(tmp_path: Path) -> None:
    """A manifest of PHM is valid for `sha256sum --strict`, whatever the names of the files are."""
    for name in ("plain", "back\\slash", "line\nbreak"):
        (tmp_path / name).write_text(name)
    sums = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in tmp_path.iterdir()}
    (tmp_path / "sums").write_bytes(manifest.encode(sums))
    done = subprocess.run(["sha256sum", "-c", "--strict", "sums"], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_manifest_of_sha256sum_is_read(tmp_path: Path) -> None:
    """Also with a name that sha256sum must escape."""
    (tmp_path / "line\nbreak").write_text("x")
    (tmp_path / "plain").write_text("x")
    done = subprocess.run("sha256sum ./*", shell=True, cwd=tmp_path, capture_output=True, check=True)
    total = hashlib.sha256(b"x").hexdigest()
    assert manifest.decode(done.stdout) == {"line\nbreak": total, "plain": total}


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"# ok\nnonsense\n", "line 2 is not a checksum"),
        (f"{SUM}  /etc/passwd\n".encode(), "line 1 names a path outside"),
        (f"{SUM}  a/../../b\n".encode(), "line 1 names a path outside"),
        (b"\0" * (manifest.MAX_BYTES + 1), "larger than"),
    ],
)
def test_invalid_manifests_are_refused(data: bytes, problem: str) -> None:
    """The error names what is wrong."""
    with pytest.raises(ValueError, match=problem):
        manifest.decode(data)
