"""The examples in examples/ are a stranger's plugins: built as wheels, installed, found, checked and run."""

from __future__ import annotations

import importlib.util
import shutil

import pytest
from conftest import ROOT
from fresh_venv import make_venv, wheel_of

EXAMPLE = ROOT / "examples" / "clothbench-xpbd"
SIMULATORS = {name: ROOT / "examples" / f"clothbench-{name}" for name in ("taichi", "pybullet")}


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """An environment with all the wheels and none of the repository."""
    folder = tmp_path_factory.mktemp("stranger")
    return make_venv(folder, [wheel_of(project, folder) for project in (ROOT, EXAMPLE, *SIMULATORS.values())])


def test_its_plugins_are_listed_beside_the_built_in_ones(stranger):
    rows = stranger.json("clothbench", "plugins", "--json")
    assert [r for r in rows if r["broken"]] == []
    theirs = {(r["kind"], r["name"]) for r in rows if r["distribution"] == "clothbench-xpbd 0.1.0"}
    assert theirs == {("model", "xpbd"), ("effect", "hem")}
    (model,) = (r for r in rows if r["name"] == "xpbd")
    assert {p["name"]: p["unit"] for p in model["parameters"]} == {"k1": "N/m", "k2": "N/m", "tau": "s"}


@pytest.mark.slow
def test_its_own_tests_pass(stranger):
    away = stranger.away / "example"  # its tests and settings only: what is tested is the installed wheel
    shutil.copytree(EXAMPLE / "tests", away / "tests")
    shutil.copy(EXAMPLE / "pyproject.toml", away)
    assert " passed" in stranger.pytest(away)


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_simulator_keeps_the_rules_or_says_that_it_is_not_there(stranger, name):
    away = stranger.away / name
    shutil.copytree(SIMULATORS[name] / "tests", away / "tests")
    shutil.copy(SIMULATORS[name] / "pyproject.toml", away)
    assert (" passed" if importlib.util.find_spec(name) else " skipped") in stranger.pytest(away)


SUITE = ("clothbench", "run", "+suite=xpbd", "suite.select=satin/static-*", "budget=25", "rerun=false")


@pytest.fixture(scope="module")
def said(stranger):
    """What a run of its suite says."""
    return stranger.run(*SUITE)


@pytest.mark.slow
def test_its_suite_runs_and_compares_its_model(stranger, said):
    assert "xpbd" in said
    rows = stranger.json("clothbench", "leaderboard", "--json")
    assert {r["suite"] for r in rows} == {"xpbd"}
    assert {r["model"] for r in rows} == {"xpbd", "mass_spring"}
    assert {r["effects"] for r in rows} == {"quadratic_drag,hem"}
    assert {r["split"] for r in rows} == {"fit", "held_out"}
    assert {r["status"] for r in rows} == {"ok"}
    fits = {r["model"]: r for r in rows if r["metric"] == "node_error" and r["split"] == "fit" and r["recording"]}
    assert all(0 < r["value"] < 30 and r["unit"] == "mm" for r in fits.values())


@pytest.mark.slow
def test_a_finished_cell_is_not_run_again(stranger, said):
    before = stranger.json("clothbench", "leaderboard", "--json")
    stranger.run(*SUITE)
    assert stranger.json("clothbench", "leaderboard", "--json") == before
