"""Two commands at once in one folder share its cells; two results of one cell that differ are told."""

import subprocess
import sys

import pytest

from clothbench.engine.store import Store

CELL = ("model=mass_spring", "+options.mass_spring.resolution=5", "rerun=false", "budget=60", "jobs=1")
EIGHT = ("optimizer=[ga,annealing,nelder_mead,cma_es]", "metric=[node_error,relative_error]")


def test_two_commands_in_one_folder_compute_every_cell_once(recordings_folder, tmp_path):
    command = [sys.executable, "-m", "clothbench", "run", f"recordings={recordings_folder}", *CELL, *EIGHT]
    both = [
        subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    said = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    computed = [text.count("ok: ") for text in said]
    assert min(computed) > 0, said
    assert sum(computed) == 8, said
    assert [text.count("kept: ") for text in said] == [8 - count for count in computed]
    assert not (tmp_path / "runs" / "leases").exists()


@pytest.mark.slow
def test_a_run_tells_of_a_cell_that_did_not_come_to_the_same(clothbench, recordings_folder, tmp_path):
    command = ["run", f"recordings={recordings_folder}", *CELL, "optimizer=nelder_mead", "metric=node_error"]
    assert "fault:" not in clothbench(*command).stdout
    key = Store(tmp_path / "runs").rows()[0]["key"]
    Store(tmp_path / "runs").record(key, [1.0], [2.0])
    done = clothbench(*command)
    line = f"fault:  {key} was computed twice and did not come to the same (clothbench store check runs)"
    assert done.stdout.splitlines()[-1] == line
    assert done.returncode == 0
    assert clothbench("store", "check", "runs").returncode == 1
