"""What candidates are made of is compiled beside the calibration, by a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys

ASK = """
import sys, time
import psutil
from clothbench.core.kernels import lies_on_disk
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.compiling import compiled_ahead, kernels_of

class Problem:
    def make(self, kind, name):
        return catalogue().make(kind, name)

kernels = kernels_of(Problem().make("effects", "linear_drag")) + kernels_of(Problem().make("effects", "total_mass"))
assert len(kernels) == 3 and not kernels_of(Problem().make("effects", "clock_offset"))
print(all(map(lies_on_disk, kernels)))
began = time.monotonic()
with compiled_ahead(Problem(), ["clock_offset", "no_such_effect", "linear_drag", "total_mass"]):
    beside = len(psutil.Process().children())
    while sys.argv[1] == "wait" and not all(map(lies_on_disk, kernels)) and time.monotonic() - began < 100:
        time.sleep(0.1)
print(beside, len(psutil.Process().children()), all(map(lies_on_disk, kernels)))
"""


def told(folder, word: str, threads: int) -> list[str]:
    """Whether the three kernels lie on disk before; processes beside that one meanwhile and afterwards; and whether
    they lie there then.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "CLOTHBENCH_THREADS": str(threads)}
    done = subprocess.run([sys.executable, "-c", ASK, word], capture_output=True, text=True, env=environment)
    assert not done.returncode, done.stderr
    return done.stdout.split()


def test_another_process_compiles_what_no_disk_has(tmp_path):
    assert told(tmp_path, "wait", 2) == ["False", "1", "0", "True"]
    assert told(tmp_path, "wait", 2) == ["True", "0", "0", "True"]


def test_it_ends_with_what_is_done_meanwhile(tmp_path):
    assert told(tmp_path, "go", 2) == ["False", "1", "0", "False"]


def test_there_is_none_where_there_is_one_core(tmp_path):
    assert told(tmp_path, "go", 1) == ["False", "0", "0", "False"]
