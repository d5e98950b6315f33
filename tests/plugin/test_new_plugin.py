"""`clothbench new-plugin` makes distributions that build, install, are found and keep every rule, as they are."""

from __future__ import annotations

import ast
import os
import tomllib

import pytest
from conftest import ROOT
from fresh_venv import make_venv, wheel_of

from clothbench import ClothbenchError
from clothbench.plugins.scaffold import SUMMARIES, create

NAMES = {"model": "veil", "effect": "syrup", "metric": "spread", "optimizer": "climber", "tracker": "sieve"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One new distribution of every kind, by kind."""
    folder = tmp_path_factory.mktemp("made")
    return {kind: create(kind, name, folder) for kind, name in NAMES.items()}


@pytest.fixture(scope="module")
def installed(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("installed")
    return make_venv(folder, [wheel_of(project, folder) for project in (ROOT, *made.values())])


def test_every_kind_has_a_template():
    assert set(NAMES) == set(SUMMARIES)


@pytest.mark.parametrize("kind", NAMES)
def test_a_new_plugin_is_whole(made, kind):
    folder, name = made[kind], NAMES[kind]
    assert folder.name == f"clothbench-{name}"
    about = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert about["entry-points"]["clothbench"] == {name: f"clothbench_{name}"}
    for path in folder.rglob("*"):
        assert path.is_dir() or "$" not in path.read_text(), path
    for path in folder.rglob("*.py"):
        ast.parse(path.read_text())
        assert max(map(len, path.read_text().splitlines())) <= 120
    assert [p.name for p in folder.parent.iterdir() if p.name.startswith(".")] == []


def test_new_plugins_are_listed_whole(installed):
    rows = installed.json("clothbench", "plugins", "--json")
    found = {r["kind"]: r for r in rows if r["distribution"] != rows[0]["distribution"]}
    assert {kind: r["name"] for kind, r in found.items()} == NAMES
    assert [r for r in rows if r["broken"]] == []
    assert {p["name"]: p["unit"] for p in found["model"]["parameters"]} == {"side": "N/m", "drag": "1/s"}


@pytest.mark.slow
def test_the_templates_ship_with_the_package(installed):
    said = installed.run("clothbench", "new-plugin", "effect", "breeze")
    assert said.startswith("clothbench-breeze: ready")
    assert (installed.away / "clothbench-breeze/src/clothbench_breeze/breeze.py").is_file()


@pytest.mark.parametrize("kind", NAMES)
def test_a_new_plugin_passes_its_own_tests(made, installed, kind):
    assert " passed" in installed.pytest(made[kind] / "tests")


def test_the_new_plugins_work_together(installed):
    chosen = [f"{kind}={NAMES[kind]}" for kind in ("model", "metric", "optimizer", "tracker")]
    installed.run(
        "clothbench", "run", "+suite=static_dynamic", "suite.select=satin/static-*", "report=[]", "effects=[]",
        "rerun=false", "budget=20", *chosen,
    )  # fmt: skip
    rows = installed.json("clothbench", "leaderboard", "--json")
    assert {r["status"] for r in rows} == {"ok"}
    assert all(0 < r["value"] < 100 and r["unit"] == "mm" for r in rows)


@pytest.mark.parametrize("name", ["", "2d", "my-model", "my model", "mo/del", "_veil", "veil_", "schön", "..", "a\n"])
def test_a_name_that_is_no_identifier_is_refused(tmp_path, name):
    refused(tmp_path, "model", name, "expected an identifier")


@pytest.mark.parametrize("name", ["class", "None", "lambda"])
def test_a_word_of_python_is_refused(tmp_path, name):
    refused(tmp_path, "model", name, "a word of Python's own")


def test_a_taken_name_is_refused(tmp_path):
    refused(tmp_path, "model", "mass_spring", "is taken by the model of clothbench")
    create("effect", "mass_spring", tmp_path)  # of another kind it is free


def test_the_name_of_an_installed_package_is_refused(tmp_path):
    refused(tmp_path, "effect", "models", "a package clothbench_models is installed")


def test_an_unknown_kind_is_refused(tmp_path):
    refused(tmp_path, "loom", "jacquard", "no kind of plugin 'loom'; there are: model")


def test_a_folder_that_exists_is_left_alone(tmp_path):
    (tmp_path / "clothbench-veil").mkdir()
    refused(tmp_path, "model", "veil", "is there already", left=["clothbench-veil"])


def test_nothing_is_left_half_written(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    refused(tmp_path, "model", "veil", "cannot be written to .No space left on device")


@pytest.mark.parametrize(
    ("kind", "name", "expected"),
    [
        ("metric", "score", "ScoreMetric"),
        ("model", "scene", "SceneModel"),
        ("tracker", "path", "PathTracker"),
        ("effect", "true", "TrueEffect"),
        ("model", "wind_2d", "Wind2d"),
    ],
)
def test_a_class_does_not_hide_what_its_module_uses(tmp_path, kind, name, expected):
    text = (create(kind, name, tmp_path) / f"src/clothbench_{name}/{name}.py").read_text()
    classes = [node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ClassDef)]
    assert classes[0] == expected


def test_the_command_says_what_to_do_next(clothbench, tmp_path):
    done = clothbench("new-plugin", "metric", "spread", "--into", "new/plugins")
    assert done.returncode == 0
    assert "new/plugins/clothbench-spread: ready; next: pip install" in done.stdout
    again = clothbench("new-plugin", "metric", "spread", "--into", "new/plugins")
    assert again.returncode == 2
    assert again.stderr.startswith("clothbench: new/plugins/clothbench-spread: is there already")
    assert len(again.stderr.splitlines()) == 1


def refused(folder, kind, name, why, left=()):
    """`create` refuses in one line and leaves nothing behind."""
    with pytest.raises(ClothbenchError, match=why) as caught:
        create(kind, name, folder)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in folder.iterdir()) == list(left)
