"""Runs a module as a program that ends with the process that started it.

``python -m phm.simulation.bound_process PARENT MODULE [ARGUMENT...]``, where PARENT is the process id of the starter
"""

from __future__ import annotations

import runpy
import sys

from phm.core.parent_death import die_with_parent

if __name__ == "__main__":
    die_with_parent(int(sys.argv[1]))
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
