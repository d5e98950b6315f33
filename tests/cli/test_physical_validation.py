"""`clothbench run +suite=physical_validation`: rows beside references, skips with reasons, resuming, page and gate."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from clothbench import ClothbenchError, Parameter, ParameterSpace, Rollout, Scene
from clothbench.cli.results import print_results
from clothbench.engine.pool import run_cells
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import OWN, Catalogue, Plugin
from clothbench.plugins.discovery import catalogue as installed
from clothbench.reference import mechanics as references
from clothbench.report.gate import compare_rows
from clothbench.report.page import write_page
from clothbench.studies.mechanics.checks import CHECKS, NAMES, check_named
from clothbench.studies.mechanics.figures import colours, error_figures
from clothbench.studies.mechanics.page import told_apart
from clothbench.studies.mechanics.tables import called, finest

QUICK = ("+suite=physical_validation", "model=[mass_spring]", "suite.meshes=[5,9]", "jobs=1")


class Strip:
    """A strip for small deflections, with an error that falls with the square of its cell; it only finds rest."""

    name, version = "strip", 1
    parameters = ParameterSpace((Parameter("bending", "D", "N·m", (1e-9, 1.0), "log", 1e-5, "rigidity", "beam"),))
    capabilities = frozenset({"static"})

    def of_material(self, material, scene):
        return np.array([material.bending])

    def prepare(self, scene: Scene, effects=()):
        return StripAt(scene, self.parameters)


@dataclasses.dataclass
class StripAt:
    scene: Scene
    parameters: ParameterSpace

    def run(self, theta):
        """w = q s² (s² − 4Ls + 6L²)/24D below the clamp, whose edge is the second column of nodes."""
        scene, along = self.scene, self.scene.resolution[0]
        cell = scene.width / (along - 1)
        length, s = scene.width - cell, np.maximum(scene.points[:, 0] - cell, 0.0)
        q = scene.areal_density * references.G
        below = q * s**2 * (s**2 - 4 * length * s + 6 * length**2) / (24 * theta[0, 0])
        z = -below * (1 - (cell / length) ** 2)
        frame = np.stack([scene.points[:, 0], scene.points[:, 1], z], axis=1)
        position = np.broadcast_to(frame, (1, len(scene.times), *frame.shape))
        return Rollout(scene.times, position, ("ok",), np.array([1]), along)


class Faller(Strip):
    """Free fall with the error of a first-order step; no textbook parameters, and a step that can be scaled."""

    name = "faller"
    capabilities = frozenset({"dynamic"})
    of_material = None

    def __init__(self, step_scale: float = 1.0):
        self.step_scale = step_scale

    def prepare(self, scene: Scene, effects=()):
        if len(scene.grip_material):
            raise ClothbenchError("faller: falls, and does nothing else")
        return FallerAt(scene, self.parameters, 1e-3 * self.step_scale)


@dataclasses.dataclass
class FallerAt:
    scene: Scene
    parameters: ParameterSpace
    dt: float

    def run(self, theta):
        t = self.scene.times
        position = np.zeros((1, len(t), len(self.scene.points), 3))
        position[0, :, :, 2] = -(references.G * t * (t + self.dt) / 2)[:, None]
        return Rollout(t, position, ("ok",), np.array([1]), 5)


class Crash(Faller):
    """Diverges on the finer meshes."""

    name = "crash"

    def prepare(self, scene, effects=()):
        return CrashAt(scene, self.parameters, 1e-3)


class CrashAt(FallerAt):
    def run(self, theta):
        if self.scene.resolution[0] < 9:
            return super().run(theta)
        position = np.full((1, len(self.scene.times), len(self.scene.points), 3), np.nan)
        return Rollout(self.scene.times, position, ("diverged",), np.array([1]), 5, ("it blew up",))


MODELS = {"strip": "Strip", "faller": "Faller", "crash": "Crash"}
STAND_FOR = {"added_mass": "added_mass", "drag": "quadratic_drag"}
SETTINGS = {
    "study": "mechanics",
    "tracker": "markers", "scene": {"air_density": 1.2}, "options": {}, "bounds": {}, "budget": 400, "seed": 0,
    "jobs": 1, "timeout": None, "out": "runs", "rerun": False, "recording": None, "recordings": None,
    "optimizer": None, "metric": None, "effects": [], "report": [], "data_dir": None,
}  # fmt: skip


@pytest.fixture
def catalogue(monkeypatch) -> Catalogue:
    plugins = [Plugin("models", n, f"{__name__}:{c}", "", OWN, "1") for n, c in MODELS.items()]
    others = [p for p in installed().plugins if p.kind in ("effects", "studies")]
    made = Catalogue((*plugins, *others))
    for user in ("engine.run", "report.page", "cli.results"):
        monkeypatch.setattr(f"clothbench.{user}.catalogue", lambda: made)
    return made


def settings(model, tests, meshes=(9, 17, 33), **changes):
    suite = {"name": "physical_validation", "tests": list(tests), "meshes": list(meshes), "effects": STAND_FOR}
    return {**SETTINGS, "model": model, "suite": suite, **changes}


def ran(catalogue, tmp_path, *arguments, **changes) -> tuple[Store, list[dict], list[str]]:
    said: list[str] = []
    cells = plan(settings(*arguments, **changes), catalogue)
    run_cells(cells, tmp_path, jobs=1, done=lambda _, status: said.append(status))
    return Store(tmp_path), Store(tmp_path).rows(), said


def test_values_stand_beside_their_references(catalogue, tmp_path):
    store, rows, said = ran(catalogue, tmp_path, "strip", ["cantilever_small", "convergence_sag", "free_fall"])
    assert said == ["skipped", "ok", "ok"]  # in the order of the suite
    small, order, fall = (next(r for r in rows if r["case"] == c) for c in
                          ("cantilever_small", "convergence_sag", "free_fall"))  # fmt: skip
    assert (small["metric"], small["unit"], small["optimizer"], small["effects"]) == ("tip_sag", "m", None, "")
    assert small["value"] == pytest.approx(small["reference"] * (1 - 1 / 31**2), rel=1e-6)
    assert (order["value"], order["reference"], order["metric"]) == (pytest.approx(2.0, abs=1e-3), 2.0, "order")
    assert (fall["value"], fall["status"]) == (None, "skipped")
    assert "needs motion" in fall["reason"]
    levels = [v for v in store.table("validation") if v["case"] == "cantilever_small"]
    assert [v["along"] for v in levels] == [9, 17, 33]
    assert [v["relative"] for v in levels] == pytest.approx([-1 / 7**2, -1 / 15**2, -1 / 31**2], rel=1e-4)
    assert levels[-1]["order"] == pytest.approx(2.0, abs=1e-3)


def test_a_model_without_textbook_parameters_does_what_needs_none(catalogue, tmp_path):
    _, rows, said = ran(catalogue, tmp_path, "faller", ["free_fall", "cantilever", "swing_period", "free_fold"])
    assert said == ["ok", "skipped", "skipped", "skipped"]
    fall, reasons = rows[1], {r["case"]: r["reason"] for r in rows}
    assert fall["value"] == pytest.approx(fall["reference"] * 1.002)
    assert "default parameters" in fall["reason"]
    assert "no of_material" in reasons["cantilever"]
    assert "falls, and does nothing else" in reasons["swing_period"]
    assert "no contact" in reasons["free_fold"]


def test_a_mesh_that_diverges_leaves_no_number(catalogue, tmp_path):
    store, rows, said = ran(catalogue, tmp_path, "crash", ["free_fall"], (5, 9))
    assert said == ["diverged"]
    assert (rows[0]["value"], rows[0]["reason"]) == (None, "it blew up")
    assert [v["status"] for v in store.table("validation")] == ["ok", "diverged"]


def test_a_time_limit_keeps_the_finest_mesh_that_was_reached(catalogue, tmp_path):
    _, rows, said = ran(catalogue, tmp_path, "strip", ["cantilever_small"], timeout=1e-9)
    assert said == ["timeout"]
    assert rows[0]["value"] is not None
    assert "time limit after 1 simulations" in rows[0]["reason"]


def test_a_load_that_a_mesh_cannot_show_is_skipped_and_the_others_go_on(catalogue, tmp_path):
    store, rows, said = ran(catalogue, tmp_path, "strip", ["cantilever"], (9, 17))
    assert said == ["ok"]
    assert rows[0]["reference"] == references.drop_over_reach(100.0)
    levels = store.table("validation")
    assert [v["load"] for v in levels] == [0.01, 1.0, 10.0, 100.0, 1000.0, 1e4] * 2
    assert [v["status"] for v in levels] == ["ok", "ok", "ok", "ok", "skipped", "skipped"] * 2
    assert "a mesh of 9 nodes is too coarse for it; it takes 22" in levels[4]["reason"]
    assert levels[6]["value"] == pytest.approx(levels[6]["reference"], rel=0.01)


def test_the_key_is_the_question_and_a_finished_cell_is_kept(catalogue, tmp_path):
    first = plan(settings("strip", ["free_fall"]), catalogue)[0]
    assert plan(settings("strip", ["free_fall"]), catalogue)[0].key == first.key
    for other in (settings("strip", ["free_fall"], (9, 17)), settings("strip", ["catenary"]),
                  settings("faller", ["free_fall"])):  # fmt: skip
        assert plan(other, catalogue)[0].key != first.key
    newer = dataclasses.replace(first, validation=first.validation + 1)
    assert newer.key != first.key
    assert [ran(catalogue, tmp_path, "strip", ["free_fall"])[2] for _ in range(2)] == [["skipped"], ["kept"]]


def test_the_table_of_fabrics_is_one_row_each(catalogue, tmp_path):
    _, rows, _ = ran(catalogue, tmp_path, "strip", ["fold_table"])
    assert len({r["case"] for r in rows}) == len(rows) == 10
    assert {r["case"] for r in rows} == set(check_named("fold_table").cases)
    assert {r["unit"] for r in rows} == {"m^-4 s^2"}
    assert next(r for r in rows if r["case"] == "fold_table:denim")["reference"] == 5200


@pytest.mark.slow
def test_page_and_table_show_every_model_and_test(catalogue, tmp_path, capsys):
    tests = ["free_fall", "cantilever_small", "cantilever", "convergence_sag"]
    store, _, _ = ran(catalogue, tmp_path, ["strip", "faller"], tests)
    print_results(store)
    table = capsys.readouterr().out
    for word in ("strip", "faller", "cantilever_small", "error %", "order", "skipped", "no of_material"):
        assert word in table
    text = write_page(tmp_path).read_text()
    assert text.count("plotly.js v") == 1
    assert "Cloth models against mechanics" in text
    shown = json.loads(re.search(r'id="tests">(.*?)</script>', text, re.DOTALL)[1])
    assert {entry[0] for entry in shown["legend"]} == {"strip", "faller"}
    assert len(shown["figures"]) == 1  # the cantilever over the elastica; nobody swung or folded
    assert set(shown["errors"]) == {"free_fall", "cantilever_small", "cantilever", "convergence_sag"}


def told(store: Store) -> tuple[str, list[dict]]:
    """The page's words, and the levels that its figures are drawn from."""
    return write_page(store.folder).read_text(), told_apart(store.rows(), store.table("validation"))


def test_of_one_model_on_several_meshes_the_finest_stands_for_it(catalogue, tmp_path, capsys):
    tests = ["cantilever_small"]
    for meshes in ((9, 17), (5, 9)):
        store, rows, _ = ran(catalogue, tmp_path, "strip", tests, meshes)
    assert {r["settings"] for r in rows} == {"meshes=9,17", "meshes=5,9"}
    page, levels = told(store)
    assert page.count('<th scope="col" class="n">strip</th>') == 1
    (value,) = re.findall(r"<td>cantilever_small</td><td class=\"n\">([^<]*)</td></tr>", page)
    assert value == f"{-100 / 15**2:+.3g} %"
    assert "1 of 1 within 1 %" in page  # and not 1 of 2
    (line, _) = error_figures(levels)["cantilever_small"]["data"]
    assert line["x"] == [9, 17]
    print_results(store)
    table = capsys.readouterr().out
    assert "meshes=9,17" in table
    assert "meshes=5,9" in table


def test_of_rows_that_do_not_say_their_meshes_the_levels_do(catalogue, tmp_path):
    store, rows, _ = ran(catalogue, tmp_path, "strip", ["cantilever_small"], (9, 17))
    key = rows[0]["key"]
    rows += ran(catalogue, tmp_path, "strip", ["cantilever_small"], (5, 9))[1]
    old = [{**r, "settings": None} for r in rows]
    assert {r["key"] for r in finest(old, store.table("validation"))} == {key}


def test_a_model_with_several_options_is_told_apart_everywhere(catalogue, tmp_path, capsys):
    for scale in (1.0, 0.5):
        options = {"faller": {"step_scale": scale}}
        store, _, _ = ran(catalogue, tmp_path, "faller", ["free_fall"], (5, 9), options=options)
    names = {"faller, step_scale=1.0", "faller, step_scale=0.5"}
    page, levels = told(store)
    assert colours(levels).keys() == names
    assert {line["meta"] for line in error_figures(levels)["free_fall"]["data"]} == {*names, ""}
    for name in names:
        assert f'<th scope="col" class="n">{name}</th>' in page
    print_results(store)
    table = capsys.readouterr().out
    assert "step_scale=1.0" in table
    assert "meshes" not in table


def test_a_model_as_it_is_is_told_from_one_with_an_option():
    about = {"model": "m", "case": "fall", "effects": ""}
    rows = [{**about, "settings": f"meshes=9,17{more}", "key": more} for more in ("", " integrator=bdf2")]
    assert [*map(called(rows), rows)] == ["m", "m, integrator=bdf2"]
    assert len(finest(rows)) == 2


def test_what_else_stands_for_an_effect_is_told_apart():
    rows = [{"model": "m", "case": "fall", "settings": None, "effects": e, "key": e} for e in ("drag", "lift")]
    assert [*map(called(rows), rows)] == ["m, with drag", "m, with lift"]


def test_the_gate_judges_the_distance_from_the_reference():
    row = {"suite": "s", "case": "c", "model": "m", "unit": "s", "reference": 1.0, "status": "ok"}

    def judged(base, new, **changes):
        verdict = compare_rows([{**row, **changes, "value": base}], [{**row, **changes, "value": new}])
        return next((side for side in ("worse", "better") if verdict[side]), None)

    assert judged(0.9, 1.1) is None  # as far on the other side
    assert judged(0.9, 0.8) == "worse"
    assert judged(1.2, 1.1) == "better"
    assert judged(1.0, 1.0 + 1e-6) is None
    assert judged(0.0, 0.5, reference=0.0) == "worse"
    assert judged(0.5, None) == "worse"


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"suite": {"tests": ["free_fal"]}}, "no test named 'free_fal'"),
        ({"suite": {"tests": "all", "meshes": [3]}}, "'suite.meshes' is 3"),
        ({"suite": {"tests": "all", "meshes": []}}, "'suite.meshes' is empty"),
        ({"effects": ["added_mass"]}, "setting 'effects': the tests"),
        ({"scene": {"areal_density": 0.1}}, "setting 'scene.areal_density': the tests"),
        ({"model": ["stripp"]}, "did you mean 'strip'"),
        (
            {"suite": {"tests": "terminal_speed", "effects": {"drag": "linear_drag"}}},
            "effect 'linear_drag' has no parameter 'normal', which the test 'terminal_speed' sets; it has coefficient",
        ),
        ({"seed": 7}, "setting 'seed': the tests of this suite are not fitted to anything; leave it out"),
        ({"budget": 3}, "setting 'budget': the tests"),
        ({"choice": "knee"}, "setting 'choice': the tests"),
        ({"tracker": "stripes"}, "setting 'tracker': the tests"),
    ],
)
def test_wrong_settings_are_one_line(catalogue, change, found):
    with pytest.raises(ClothbenchError, match=re.escape(found)):
        plan({**settings("strip", ["free_fall"]), **change}, catalogue)


def test_all_tests_of_all_models_are_planned(catalogue):
    cells = plan(settings(None, ["all"]), catalogue)
    assert [c.case for c in cells[: len(NAMES)]] == list(NAMES)
    assert {c.model for c in cells} == set(MODELS)
    assert len({c.key for c in cells}) == len(CHECKS) * len(MODELS)


def test_as_a_user_runs_it(clothbench):
    out = clothbench("run", *QUICK, "suite.tests=[free_fall,terminal_speed]")
    assert out.returncode == 0, out.stderr
    assert "models against references" in out.stdout
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert [(r["case"], r["status"], r["seed"]) for r in rows] == [
        ("free_fall", "ok", None), ("terminal_speed", "ok", None),
    ]  # fmt: skip
    for row in rows:
        assert row["value"] == pytest.approx(row["reference"], rel=1e-3)
    assert "kept:" in clothbench("run", *QUICK, "suite.tests=[free_fall]").stderr
    assert clothbench("compare", "runs", "runs").returncode == 0
    assert clothbench("report").returncode == 0


def test_a_test_that_does_not_exist_is_exit_2(clothbench, tmp_path):
    out = clothbench("run", *QUICK, "suite.tests=[nonsense]")
    assert out.returncode == 2
    assert "no test named 'nonsense'" in out.stderr
    assert not list(tmp_path.iterdir())
