"""What each package costs when a process imports it: memory that is not shared, CPU time, modules.

Run in a separate process: `python -m sitl.bench.footprint_imports MODULE...` prints one JSON object by package. A package is
charged what its own modules take, without the modules of other packages that they import.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import json
import os
import sys
import time
from functools import partial
from types import ModuleType
from typing import Any

_rollup = os.open("/proc/self/smaps_rollup", os.O_RDONLY)


def anonymous_kb() -> int:
    """Memory of this process that is not shared, in kB."""
    text = os.pread(_rollup, 4096, 0)
    at = text.index(b"Anonymous:") + 10
    return int(text[at : at + 40].split()[0])


class Meter:
    """Charges packages. `took` is by package: memory in kB, CPU seconds, modules."""

    def __init__(self) -> None:
        self.took: dict[str, list[float]] = {}
        self._inner: list[list[float]] = [[0.0, 0.0]]

    def run(self, name: str, load: Any, module: ModuleType) -> None:
        self._inner.append([0.0, 0.0])
        began_kb, began_s = anonymous_kb(), time.process_time()
        try:
            load(module)
        finally:
            total = [anonymous_kb() - began_kb, time.process_time() - began_s]
            inner = self._inner.pop()
            entry = self.took.setdefault(name.partition(".")[0], [0.0, 0.0, 0])
            for number in (0, 1):
                entry[number] += total[number] - inner[number]
                self._inner[-1][number] += total[number]
            entry[2] += 1


class _Finder(importlib.abc.MetaPathFinder):
    """Finds what the others find, with a loader that is measured."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        for finder in sys.meta_path:
            if finder is self or not hasattr(finder, "find_spec"):
                continue
            spec = finder.find_spec(name, path, target)
            if spec is not None:
                loader: Any = spec.loader
                if loader is not None and hasattr(loader, "exec_module") and not isinstance(loader, type):
                    loader.exec_module = partial(self._meter.run, name, loader.exec_module)
                return spec
        return None


def measure(modules: list[str]) -> dict[str, Any]:
    """Import them and return what was taken: `packages` by name, `before` and `after` in kB."""
    meter = Meter()
    before = anonymous_kb()
    finder = _Finder(meter)
    sys.meta_path.insert(0, finder)
    try:
        for name in modules:
            importlib.import_module(name)
    finally:
        sys.meta_path.remove(finder)
    packages = {
        name: {"kb": int(kb), "cpu_ms": round(cpu_s * 1000, 1), "modules": int(count)}
        for name, (kb, cpu_s, count) in sorted(meter.took.items(), key=lambda item: -item[1][0])
    }
    return {"before_kb": before, "after_kb": anonymous_kb(), "packages": packages}


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1:])))
