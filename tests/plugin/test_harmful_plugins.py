"""A plugin that ends its process, sleeps, fills the memory, prints or forks costs its own row and nothing else."""

from __future__ import annotations

import json
import textwrap

import psutil
import pytest

SITE = {
    "harmful/__init__.py": """
        from clothbench import Registration, hookimpl

        @hookimpl
        def clothbench_optimizers():
            names = ("leaves", "vanishes", "sleeps", "fills", "prints", "forks")
            return [Registration(n, f"harmful.search:{n.title()}", "for a test") for n in names]
        """,
    "harmful/search.py": """
        import os, sys, time
        import numpy as np
        from clothbench_optimizers.nelder_mead import NelderMead

        class Harmful(NelderMead):
            version, harm = 1, None

            def __init__(self, *args, **options):
                super().__init__(*args, **options)
                type(self).harm()

        def of(name, harm):
            return type(name.title(), (Harmful,), {"name": name, "harm": staticmethod(harm)})

        def fill():
            kept = []
            while True:
                kept.append(np.ones(20_000_000))
                time.sleep(0.05)

        def fork():
            if os.fork() == 0:
                return  # and goes on as if it were the process that was asked
            if os.fork() == 0:
                time.sleep(600)

        Leaves = of("leaves", lambda: sys.exit(0))
        Vanishes = of("vanishes", lambda: os._exit(0))
        Sleeps = of("sleeps", lambda: time.sleep(600))
        Fills = of("fills", fill)
        Prints = of("prints", lambda: print("x" * 3_000_000, flush=True))
        Forks = of("forks", fork)
        """,
    "harmful-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: harmful\nVersion: 1.0\n",
    "harmful-1.0.dist-info/entry_points.txt": "[clothbench]\nharmful = harmful\n",
}
REASONS = {
    "leaves": "SystemExit",
    "vanishes": "the process that ran this cell died",
    "sleeps": "took more than 30 s, the limit (limits.seconds), and was ended",
    "fills": "of memory, the limit (limits.memory) is 1, and was ended",
}
CELL = ("model=mass_spring", "metric=node_error", "scene.resolution=[5,5]", "budget=12", "rerun=false")


@pytest.fixture
def site(tmp_path):
    for name, text in SITE.items():
        (tmp_path / "site" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "site" / name).write_text(textwrap.dedent(text).lstrip())
    return str(tmp_path / "site")


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["local", "dask"])
def test_each_has_its_own_row_and_nothing_else(clothbench, site, recordings_folder, executor):
    if executor == "dask":
        pytest.importorskip("distributed")
    done = clothbench(
        "run", f"recordings={recordings_folder}", *CELL, "optimizer=[ga,leaves,vanishes,sleeps,fills,prints,forks]",
        "limits.seconds=30", "limits.memory=1", f"executor={executor}", PYTHONPATH=site,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr[-2000:]
    assert "xxx" not in done.stdout
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    of: dict[str, list] = {}
    for row in rows:
        of.setdefault(row["optimizer"], []).append(row)
    for optimizer, reason in REASONS.items():
        ((row),) = of[optimizer]
        assert (row["status"], row["value"]) == ("error", None)
        assert reason in row["reason"]
    for optimizer in ("ga", "prints", "forks"):
        assert {row["status"] for row in of[optimizer]} == {"ok"}, of[optimizer]
    assert clothbench("store", "check", "runs").returncode == 0
    mine = [p for p in psutil.process_iter(["environ"]) if site in (p.info["environ"] or {}).get("PYTHONPATH", "")]
    assert [p.pid for p in mine if p.status() != psutil.STATUS_ZOMBIE] == []


def test_a_single_cell_of_a_stranger_cannot_take_the_command_with_it(clothbench, site, recordings_folder):
    done = clothbench("run", f"recordings={recordings_folder}", *CELL, "optimizer=vanishes", "jobs=1", PYTHONPATH=site)
    assert done.returncode == 1, done.stderr
    (row,) = json.loads(clothbench("leaderboard", "--json").stdout)
    assert (row["status"], "the process that ran this cell died" in row["reason"]) == ("error", True)


def test_a_print_in_a_worker_of_the_commands_own_is_no_part_of_its_output(clothbench, site, recordings_folder):
    pytest.importorskip("distributed")
    words = ("optimizer=prints", "executor=dask", "jobs=1")
    done = clothbench("run", f"recordings={recordings_folder}", *CELL, *words, PYTHONPATH=site)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "xxx" not in done.stdout
    assert "xxx" in done.stderr


@pytest.mark.parametrize("word", ["limits.seconds=-1", "limits.seconds=soon", "limits.memory=0", "+limits.hours=1"])
def test_a_wrong_limit_is_one_line(clothbench, recordings_folder, word):
    done = clothbench("run", f"recordings={recordings_folder}", *CELL, "optimizer=ga", word)
    assert done.returncode == 2
    assert done.stderr.startswith("clothbench: setting")
    assert done.stderr.count("\n") == 1
