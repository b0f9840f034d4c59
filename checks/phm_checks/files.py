"""Slot 3: the application's files exist, are executable where required, and are unaltered."""

from __future__ import annotations

from collections.abc import Sequence

from phm import api
from phm.api import Slot
from phm_checks._per_container import PerContainer
from phm_checks._text import brief, clean, ending, last, listed, merged

SETTLE_S = 0.2
"""Programs that replace a file often remove the old one first; the check runs on each change in a volume."""


class Files(PerContainer):
    """All configured files of one container.

    The unit does not depend on a running container: files of a stopped container are visible too, and a missing file may
    be the reason why it stopped.
    """

    name, slot = "files", Slot.FILES
    period_s = 5.0
    deadline_s = 20.0

    @classmethod
    def wanted(cls, entry: api.ContainerSettings) -> bool:
        return bool(entry.files)

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.unit_id, needs=("engine",), target=self.key, settle_s=SETTLE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return super().wakes | {"file"}

    def run(self, world: api.World) -> api.Result:
        """All problems in the summary, the first in the brief; ERROR wins over files that cannot be read."""
        # Files that recovery can restore come first: the condition of the first selects the action.
        ordered = sorted(self.entry.files, key=lambda wanted: wanted.restore is None)
        self._alone: list[str] = []
        findings = [self._judge(world, wanted) for wanted in ordered]
        first = api.worst(findings)
        values: dict[str, api.Value] = {
            "files": len(findings),
            "files_bad": sum(finding.level.bad for finding in findings),
        }
        if first.level is api.Level.OK:
            paths = listed((wanted.path for wanted in self.entry.files), cut=ending)
            notes = [
                f"{path} is mounted as a single file: if the host replaces it, the container keeps the old one until its next "
                "start; mount its folder"
                for path in self._alone
            ]
            return api.ok("; ".join([f"File check passed: {paths}", *notes]), values=values)
        return merged(findings, values)

    def _judge(self, world: api.World, wanted: api.FileSettings) -> api.Result:
        where = f"{wanted.path} in {self.key}"
        if wanted.manifest is not None:
            return self._folder(world, wanted, wanted.manifest, where)
        try:
            fact = world.files.inspect(self.key, wanted.path, digest=wanted.sha256 is not None)
            if fact is None and wanted.present and world.docker.container(self.key) is None:
                return api.stale(f"{where} cannot be checked: container {self.key} does not exist")
        except api.CannotTell as reason:
            return api.stale(f"{where} cannot be checked: {clean(str(reason))}")
        if fact is None:
            return self._absent(wanted, where)
        if not wanted.present:
            words = f"{where} exists, expected to be absent: remove it"
            return self._bad(wanted, words, "unexpected", "file_unexpected")
        if wanted.executable and (fact.kind != "file" or not fact.executable):
            words = f"{where} is not executable (mode {fact.mode & 0o7777:04o}), expected an execute bit: `chmod +x` it"
            return self._bad(wanted, words, "not executable", "file_not_executable")
        if fact.kind == "file" and self._is_mounted(world, wanted.path):
            self._alone.append(wanted.path)
        return self._content(wanted, fact, where)

    def _is_mounted(self, world: api.World, path: str) -> bool:
        """Whether a bind mount shows exactly this path; of a file, the container then sees the inode of its start."""
        try:
            container = world.docker.container(self.key, self.period_s)
        except api.CannotTell:
            return False
        return container is not None and any((one.kind, one.destination) == ("bind", path) for one in container.mounts)

    def _folder(self, world: api.World, wanted: api.FileSettings, manifest: str, where: str) -> api.Result:
        try:
            tree = world.files.tree(self.key, wanted.path, manifest=manifest, ignore=wanted.ignore)
        except api.CannotTell as reason:
            return api.stale(f"{where} cannot be checked: {clean(str(reason))}")
        if tree is None:
            return self._absent(wanted, where)
        if tree.differing:
            kinds = (("changed", tree.changed), ("missing", tree.missing), ("new", tree.new))
            found = "; ".join(f"{kind}: {listed(paths, 8, cut=ending)}" for kind, paths in kinds if paths)
            count = "1 file differs" if tree.differing == 1 else f"{tree.differing} files differ"
            words = (
                f"{where} differs from its manifest {last(manifest)}: {count}: {found}. Restore them, or update the manifest "
                "with `phm learn`"
            )
            kind, name = next((kind, paths[0]) for kind, paths in kinds if paths)
            more = f" +{tree.differing - 1}" if tree.differing > 1 else ""
            return self._bad(wanted, words, f"{kind}{more}", "tree_altered", subject=name)
        if tree.pending:
            return api.stale(
                f"{where} is being read: {tree.files - tree.pending} of {tree.files} files so far are as expected"
            )
        if tree.unreadable:
            return api.stale(
                f"{where} cannot be checked completely: PHM cannot read {listed(tree.unreadable, cut=ending)}"
            )
        return api.ok(f"{where} has all {tree.files} files of its manifest, unaltered")

    def _absent(self, wanted: api.FileSettings, where: str) -> api.Result:
        if not wanted.present:
            return api.ok(f"{where} is absent, as expected")
        words = f"{where} is missing: restore it, or check the volume that provides it"
        return self._bad(wanted, words, "missing", "file_missing")

    def _content(self, wanted: api.FileSettings, fact: api.FileFact, where: str) -> api.Result:
        if wanted.sha256 is None:
            return api.ok(f"{where} exists")
        if fact.kind != "file":
            return self._bad(
                wanted, f"{where} is a {fact.kind}, expected a file with a SHA-256", "altered", "file_altered"
            )
        if not fact.sha256:
            return api.stale(f"{where} exists, but its SHA-256 could not be read")
        if fact.sha256.lower() != wanted.sha256.lower():
            words = (
                f"{where} was altered: SHA-256 {fact.sha256[:12]}..., expected {wanted.sha256[:12].lower()}...: restore it, "
                "or configure the new checksum"
            )
            return self._bad(wanted, words, "altered", "file_altered")
        return api.ok(f"{where} exists and is unaltered")

    def _bad(
        self, wanted: api.FileSettings, words: str, short: str, condition: str, *, subject: str = ""
    ) -> api.Result:
        found = api.error(words, brief=brief(last(subject or wanted.path), short), condition=condition, target=self.key)
        return found.with_evidence(api.Evidence(file=wanted.path))
