"""Compiled code is keyed by the content of all its sources: an edit of a helper in another file shows at once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from clothbench_models.mass_spring import MassSpring
from conftest import ROOT

from clothbench.testing import scenes

HELPER = """
from clothbench.modelling import kernel
from yarn.numbers import TWO

@kernel
def double(x):
    return TWO * x
"""
CALLER = """
from clothbench.modelling import kernel
from yarn.helper import double
from yarn import numbers

@kernel
def answer(x):
    return double(x) + numbers.ONE

@kernel(signature="float64(float64)")
def stated(x):
    return 10.0 * double(x)
"""
ASK = """
from yarn.caller import answer, stated
print(answer(3.0), stated(3.0), sum(answer.stats.cache_hits.values()), sum(stated.stats.cache_hits.values()))
"""


@pytest.fixture
def yarn(tmp_path):
    """A package of two kernel files and one of numbers."""
    folder = tmp_path / "yarn"
    folder.mkdir()
    for name, text in {"__init__": "", "helper": HELPER, "caller": CALLER, "numbers": "ONE, TWO = 1.0, 2.0\n"}.items():
        (folder / f"{name}.py").write_text(text)
    return folder


def run(folder: Path, code: str, *more: Path) -> str:
    """What the code prints in a process of its own, with these folders before all others."""
    paths = os.pathsep.join(map(str, (folder, *more)))
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment,
                         cwd=folder, check=False)  # fmt: skip
    assert out.returncode == 0, out.stderr
    return out.stdout


def edited(file: Path, old: str, new: str) -> None:
    """A change that leaves size and time stamp as they were."""
    text, stamp = file.read_text(), file.stat().st_mtime_ns
    assert old in text
    file.write_text(text.replace(old, new.ljust(len(old))))
    assert file.stat().st_size == len(text.encode())
    os.utime(file, ns=(stamp, stamp))


def test_what_was_not_edited_comes_from_the_disk(yarn):
    assert run(yarn.parent, ASK).split() == ["7.0", "60.0", "0", "0"]
    assert run(yarn.parent, ASK).split() == ["7.0", "60.0", "1", "1"]


def test_an_edit_of_a_helper_is_seen_by_who_calls_it(yarn):
    run(yarn.parent, ASK)
    edited(yarn / "helper.py", "TWO * x", "x + TWO")
    assert run(yarn.parent, ASK).split() == ["6.0", "50.0", "0", "0"]


@pytest.mark.parametrize(("old", "new", "found"), [("2.0", "5.0", "16.0"), ("1.0", "9.0", "15.0")])
def test_so_is_a_number_that_was_built_in(yarn, old, new, found):
    run(yarn.parent, ASK)
    edited(yarn / "numbers.py", old, new)
    assert run(yarn.parent, ASK).split()[0] == found


@pytest.mark.parametrize(
    "wrapped", ["try:\n    {}\nexcept ImportError:\n    double = None", "if True:\n  with open(__file__):\n    {}"]
)
def test_so_is_a_helper_that_is_imported_below_the_top(yarn, wrapped):
    line = "from yarn.helper import double"
    caller = yarn / "caller.py"
    caller.write_text(caller.read_text().replace(line, wrapped.format(line)))
    run(yarn.parent, ASK)
    edited(yarn / "helper.py", "TWO * x", "x + TWO")
    assert run(yarn.parent, ASK).split() == ["6.0", "50.0", "0", "0"]


def test_an_index_of_somebody_else_is_as_good_as_none(yarn):
    run(yarn.parent, ASK)
    for index in (yarn / "__pycache__").glob("*.nbi"):
        index.write_bytes(b"of another time")
    assert run(yarn.parent, ASK).split() == ["7.0", "60.0", "0", "0"]


@pytest.mark.parametrize("folder", ["clothbench", "plugins", "examples"])
def test_there_is_one_decorator(folder):
    """numba's own would be keyed by one file's time stamp."""
    for path in (ROOT / folder).rglob("*.py*"):
        if path.suffix in (".py", ".txt") and path != ROOT / "clothbench" / "core" / "kernels.py":
            assert "njit" not in path.read_text(), f"{path.relative_to(ROOT)} compiles by itself"


@pytest.fixture
def copy(tmp_path):
    """The packages whose kernels the models move by, in a folder where they may be edited."""
    for package in ("clothbench", "plugins/models/clothbench_models"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / Path(package).name, ignore=ignored)
    return tmp_path


@pytest.mark.slow
def test_a_models_motion_follows_an_edit_of_a_shared_kernel(copy):
    """The grips of the shared time loop, moved by a centimetre in a copy: the sheet hangs a centimetre lower."""
    code = (
        "from clothbench_models.mass_spring import MassSpring\nfrom clothbench.testing import scenes\n"
        "scene = scenes.hanging(); sheet = MassSpring(resolution=5).prepare(scene)\n"
        "print(sheet.run(sheet.parameters.defaults[None]).position[0, -1, :, 2].max())"
    )
    sheet = MassSpring(resolution=5).prepare(scenes.hanging())
    before = sheet.run(sheet.parameters.defaults[None]).position[0, -1, :, 2].max()  # of the original
    loop = copy / "clothbench" / "modelling" / "time_loop.py"
    edited(loop, "        3, segment, g, c\n    ]\n", "3,segment,g,c]-.01*(c==2)\n")
    assert float(run(copy, code)) == pytest.approx(before - 0.01, abs=1e-6)


def test_kernels_of_all_models_follow_an_edit_of_their_time_loop(copy):
    """Their machine code is looked up under another digest; that of a kernel without a part in the time loop is not."""
    models = [f"clothbench_models.{name}_kernels" for name in ("mass_spring", "baraff_witkin", "inextensible", "shell")]
    names = [*models, "clothbench.modelling.self_contact"]
    code = (
        f"import importlib\nfrom clothbench.core.kernels import digest_of\nnames = {names}\n"
        "for name in names: importlib.import_module(name)\nprint(*map(digest_of, names))"
    )
    before = run(copy, code).split()
    edited(copy / "clothbench" / "modelling" / "time_loop.py", "        3, segment, g, c\n", "3,segment,g,c+0")
    changed = [old != new for old, new in zip(before, run(copy, code).split(), strict=True)]
    assert dict(zip(names, changed, strict=True)) == {name: name in models for name in names}
