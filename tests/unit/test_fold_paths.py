"""The study of folding paths: its settings, a strip and a sheet led along one, layers, its table and its page."""

from dataclasses import replace

import numpy as np
import pytest
from clothbench_models.kirchhoff_love import KirchhoffLove

from clothbench import ClothbenchError
from clothbench.cli.run import composed
from clothbench.core.folding import FoldPath, FoldState
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.engine.study import Results
from clothbench.engine.suite import plan as whole_plan
from clothbench.plugins.discovery import catalogue
from clothbench.studies.fold_path.cell import (
    NOT_USED,
    FoldPathCell,
    PathSettings,
    chosen_ways,
    path_settings,
    refuse_settings,
)
from clothbench.studies.fold_path.page import sections
from clothbench.studies.fold_path.run import geometric, parameters
from clothbench.studies.fold_path.sheet import led, material, scene
from clothbench.studies.fold_path.tables import lines, show


def cell(way: str = "computed", model: str = "kirchhoff_love", options=None, **about) -> FoldPathCell:
    return FoldPathCell("paths", "chanel", way, model, PathSettings(**about), options or {})


def values(store: Store) -> dict[str, float]:
    return {r["metric"]: r["value"] for r in store.rows()}


@pytest.fixture(scope="module")
def computed(tmp_path_factory) -> Store:
    store = Store(tmp_path_factory.mktemp("computed"))
    assert run_cell(cell(friction=0.1), store.folder) == "ok"
    return store


def test_a_strip_on_its_own_path_lands_where_it_should(computed):
    found = values(computed)
    assert found["landing_error"] == found["slip"] == 0
    assert 0.02 < found["friction"] < 0.1
    steps = computed.table("fold_path")
    assert {s["phase"] for s in steps} == {1, 2, 3}
    assert (steps[-1]["x"], steps[-1]["z"]) == pytest.approx((0, 0), abs=1e-9)


def test_table_and_page_show_it(computed):
    results = Results(computed, computed.rows(), tuple(r["key"] for r in computed.rows()))
    (line,) = lines(results, "paths")
    assert (line["fabric"], line["way"], line["status"], line["desk"]) == ("chanel", "computed", "ok", 0.1)
    assert show(results)[0].row_count == 1
    (section,) = sections(results)
    assert "chanel" in section.whole
    assert len(section.data["fold-paths"]) == 3


def test_strips_of_several_lengths_and_desks_are_told_apart(tmp_path, monkeypatch):
    """What was asked of one fabric at three lengths is no median of three fabrics."""

    def follow(self, places, theta, friction):
        state = FoldState(np.insert(places, 2, 0.0, axis=1), np.zeros((len(places), 9, 2)), 0 * places[:, 0],
                          1 + 0 * places[:, 0], ("ok",) * len(places))  # fmt: skip
        return FoldPath(state.pull, state, state.pull, 0.05 + state.pull)

    monkeypatch.setattr("clothbench_models.folding.FoldingStrip.follow", follow)
    asked = [(1.0, 0.1), (0.5, 0.1), (0.5, 0.3)]
    for length, friction in asked:
        assert run_cell(cell("triangular", length=length, friction=friction), tmp_path) == "ok"
    store = Store(tmp_path)
    results = Results(store, store.rows(), tuple(r["key"] for r in store.rows()))
    names = {f"length={length}, friction={friction}" for length, friction in asked}
    assert {x["settings"] for x in lines(results, "paths")} == names
    (shown,) = show(results)
    assert set(next(c for c in shown.columns if c.header == "settings")._cells) == names
    (section,) = sections(results)
    assert section.whole.count("median of 1 of 1 fabric.") == 3
    paths, frictions = section.data["fold-paths"][:2]
    assert {line["name"] for line in paths["data"]} == {f"triangular, {name}" for name in names}
    assert {line["name"] for line in frictions["data"]} == {f"chanel, triangular, {name}" for name in names}


def test_a_strip_on_a_path_that_needs_more_than_the_desk_gives_lands_beside(tmp_path):
    """The triangle knows of no loop: the strip is pushed back until friction holds it."""
    store = Store(tmp_path)
    assert run_cell(cell("triangular", friction=0.1), tmp_path) == "ok"
    found = values(store)
    assert found["friction"] > 0.1
    assert found["slip"] < -5
    assert found["landing_error"] == pytest.approx(-found["slip"])
    assert "slips by up to" in next(r["reason"] for r in store.rows() if r["metric"] == "friction")


def test_friction_needed_is_that_of_a_desk_that_holds(tmp_path):
    """A strip that slips begins each step where its desk bears it: 5.3 is what the first place takes by itself."""
    store = Store(tmp_path)
    assert run_cell(cell("circular", friction=0.1), tmp_path) == "ok"
    found, steps = values(store), store.table("fold_path")
    assert found["friction"] == pytest.approx(8.28, abs=0.02)
    assert max(s["needed"] for s in steps) == found["friction"]
    assert found["slip"] > 50


@pytest.mark.slow
def test_a_sheet_folds_along_the_path_of_its_strip(tmp_path):
    store = Store(tmp_path)
    about = cell(model="baraff_witkin", options={"baraff_witkin": {"integrator": "rk45"}},
                 length=0.5, width=0.1, nodes=21, seconds=2.0)  # fmt: skip
    assert run_cell(about, tmp_path) == "ok"
    found = values(store)
    assert abs(found["landing_error"]) < 5
    assert found["edge_spread"] < 2
    assert "friction" not in found
    shapes = [s for s in store.table("fold_shapes") if s["frame"] == 12]
    assert 0.22 < max(s["x"] for s in shapes) < 0.3  # half its length, and the loop


def test_a_sheet_is_led_from_rest_to_rest_and_lies_where_the_strip_does():
    places = np.array([[0.3, 0.2], [0.0, 0.0]])
    at = led(places, 0.5, np.array([0.0, 0.01, 0.99, 1.0]))
    assert at[[0, -1]] == pytest.approx(np.array([[0.5, 0.0], [0.0, 0.0]]))
    assert np.linalg.norm(at[1] - at[0]) < 1e-5
    world = scene(cell(length=0.5, nodes=11, width=0.2), places)
    assert world.resolution == (11, 5)
    assert world.start[:, 0] == pytest.approx(world.points[:, 0])
    assert world.grips_at(world.times[-1:])[0, :, 0] == pytest.approx(0.0, abs=1e-9)


def test_an_edge_of_thick_cloth_comes_down_on_the_lower_layer():
    """By the thickness above the desk where it lands, and from the desk itself, where it sets out."""
    places = np.array([[0.3, 0.2], [0.0, 0.0]])
    thick, thin = (scene(cell(length=0.5, nodes=11, width=0.2, thickness=h), places) for h in (0.02, 0.0))
    z, through = thick.grip_position[:, 0, 2], thin.grip_position[:, 0, 2]
    assert (z[0], z[-1], through[-1]) == pytest.approx((0.0, 0.02, 0.0), abs=1e-9)
    assert (z >= through).all()
    high = through > 0.02
    np.testing.assert_allclose(z[high], through[high])


@pytest.mark.parametrize("way", ["triangular", "circular"])
def test_a_geometric_path_sets_out_at_the_lift_and_passes_the_corner(way):
    places = geometric(cell(way, length=0.5, lift=0.01))
    assert places[0, 1] == pytest.approx(0.01)
    assert places[-1] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.abs(places - 0.25).max(axis=1).min() < 1e-12
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps[0] < 0.1 * 0.01 * 2**0.5 + 1e-12
    assert (np.diff(steps[:10]) > 0).all()


@pytest.mark.parametrize(("way", "fabric"), [("triangular", "chanel"), ("circular", "coating")])
def test_friction_needed_on_a_geometric_path_is_no_matter_of_how_finely_it_is_cut(way, fabric, monkeypatch):
    """48 equal steps from the flat strip on had told 0.16 where 96 told 0.34."""
    about = replace(cell(way), fabric=fabric)
    model = KirchhoffLove()
    strip, theta = model.strip(1.0), parameters(model, about)

    def needed() -> float:
        start = geometric(about)
        return float(strip.follow(start[start[:, 0] > 0.9], theta, np.inf).needed.max())

    as_it_is = needed()
    monkeypatch.setattr("clothbench.studies.fold_path.run.STEPS", 96)
    monkeypatch.setattr("clothbench.studies.fold_path.run.GROWTH", 1.05)
    assert needed() == pytest.approx(as_it_is, rel=0.005)


def test_layers_weigh_together_and_bend_as_they_are_joined():
    """n layers: n ρ on n D if they slide on each other, on n³ D if they cannot."""
    single, loose, bonded = cell(), cell(layers=2), cell(layers=2, bonded=True)
    assert loose.eta_b == single.eta_b
    assert bonded.eta_b == single.eta_b / 4
    assert material(loose).bending == pytest.approx(2 * material(single).bending)
    assert material(bonded).bending == pytest.approx(8 * material(single).bending)


def test_cloth_too_stiff_to_be_folded_is_told(tmp_path):
    assert run_cell(cell(layers=20, bonded=True), tmp_path) == "diverged"
    assert "too stiff" in Store(tmp_path).rows()[0]["reason"] or "no fold" in Store(tmp_path).rows()[0]["reason"]


def test_options_of_what_is_not_in_use_ask_nothing_else():
    plain, planner = cell(model="baraff_witkin"), {"kirchhoff_love": {"poisson": 0.2}}
    assert cell(model="baraff_witkin", options={"mass_spring": {"resolution": 9}}).key == plain.key
    assert cell(model="baraff_witkin", options={"baraff_witkin": {"integrator": "rk45"}}).key != plain.key
    assert cell(model="baraff_witkin", options=planner).key != plain.key  # which plans its path


def test_numbers_of_another_version_of_the_study_are_another_question():
    assert replace(cell(), testbed=1).key != cell().key


def test_a_model_that_folds_nothing_over_is_left_out(tmp_path):
    assert run_cell(cell(model="linear_stretch"), tmp_path) == "skipped"
    assert "contact" in Store(tmp_path).rows()[0]["reason"]


def test_a_model_without_such_a_material_is_left_out(tmp_path):
    assert run_cell(cell("triangular", model="mass_spring"), tmp_path) == "skipped"
    assert "no small-strain bending rigidity" in Store(tmp_path).rows()[0]["reason"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"layers": 2}, "say with 'suite.path.bonded'"),
        ({"layers": 0}, r"'suite\.path\.layers' is 0, expected a whole number, at least 1"),
        ({"bonded": 1}, "'suite.path.bonded' is 1, expected true or false"),
        ({"thickness": -0.001}, "'suite.path.thickness' is -0.001, expected a number, at least 0"),
        ({"friction": -0.1}, "'suite.path.friction' is -0.1, expected a number above 0"),
        ({"lift": 0.5}, r"'suite\.path\.lift' is 0\.5 m, expected less than half the strip's 1 m"),
        ({"planner": 3}, "'suite.path.planner' is 3"),
        ({"speed": 1}, "setting of 'suite.path' 'speed' is not known"),
    ],
)
def test_settings_are_checked(given, told):
    with pytest.raises(ClothbenchError, match=told):
        path_settings(given)
    with pytest.raises(ClothbenchError, match="there is no 'straight'"):
        chosen_ways(["straight"])
    with pytest.raises(
        ClothbenchError, match=r"'suite\.path\.ways' is empty; give some, for example .computed,triangular"
    ):
        chosen_ways([])
    assert chosen_ways(None) == ["computed", "triangular", "circular"]
    assert chosen_ways(["circular", "circular"]) == ["circular"]
    with pytest.raises(ClothbenchError, match="setting 'timeout': nothing is measured or fitted"):
        refuse_settings({**dict.fromkeys(NOT_USED, ()), "timeout": 9.0, "scene": {}})
    with pytest.raises(ClothbenchError, match="setting 'seed': nothing is measured or fitted"):
        refuse_settings({**dict.fromkeys(NOT_USED, ()), "seed": 7, "scene": {}})


def test_an_empty_choice_of_fabrics_is_none():
    with pytest.raises(ClothbenchError, match=r"setting 'suite\.select' is empty"):
        whole_plan(composed(["suite=fold_over", "suite.select=[]"]), catalogue())


def test_a_model_that_is_named_twice_is_run_once():
    cells = whole_plan(composed(["suite=fold_over", "model=[mass_spring,mass_spring]"]), catalogue())
    assert len({cell.key for cell in cells}) == len(cells) > 1
