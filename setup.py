"""What pyproject.toml cannot say: files of config/ become phm/shipped/ in the wheel."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

SOURCE = Path(__file__).resolve().parent / "config"
SHIPPED = ("phm.schema.json", "phm.yaml", "fastdds.xml", "examples/*.yaml", "systemd/phm.service")


class BuildWithConfig(build_py):
    """An editable installation reads config/ itself (`phm.config.shipped`)."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        target = Path(self.build_lib, "phm", "shipped")
        for path in (path for pattern in SHIPPED for path in SOURCE.glob(pattern)):
            copy = target / path.relative_to(SOURCE)
            copy.parent.mkdir(parents=True, exist_ok=True)
            self.copy_file(str(path), str(copy))


setup(cmdclass={"build_py": BuildWithConfig})
