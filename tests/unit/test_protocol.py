"""The papers' protocol: its trials become cells, its tables and pages are of the fits that they say."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from clothbench_metrics.node_error import NodeError
from conftest import ROOT, swinging_recording

from clothbench import ClothbenchError, write_recording
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.analysis_tables import percent, spread
from clothbench.studies.calibration.cell import set_up
from clothbench.studies.calibration.run import _published_of
from clothbench.studies.calibration.transfer import confusions, transfers


def stand_ins(folder):
    for fabric in ("silk", "wool"):
        for trial in ("sway-1", "sway-2", "sway-long"):
            made = swinging_recording(f"{fabric}/{trial}", fabric=fabric, notes={"experiment": "sway"})
            write_recording(made, folder / f"{fabric}-{trial}.nc")
    return folder


def config(folder, **changes):
    suite = {"name": "s", "case": "experiment", "each": ["*-1", "*-2"]}
    base = {
        "model": "mass_spring", "optimizer": "ga", "metric": "node_error", "effects": [], "report": [],
        "study": "calibration",
        "tracker": "markers", "scene": {}, "options": {}, "bounds": {}, "budget": 10, "seed": 0, "jobs": 1,
        "timeout": None, "out": "runs", "rerun": False, "analysis": {}, "recordings": str(folder),
    }  # fmt: skip
    return {**base, **changes, "suite": {**suite, **changes.get("suite", {})}}


def test_each_trial_is_a_case_whose_others_are_held_out(tmp_path):
    cells = plan(config(stand_ins(tmp_path)), catalogue())
    assert [c.case for c in cells] == ["silk/sway-1", "silk/sway-2", "wool/sway-1", "wool/sway-2"]
    assert {s.name: s.split for s in cells[1].recordings} == {
        "silk/sway-1": "held_out", "silk/sway-2": "fit", "silk/sway-long": "held_out",
    }  # fmt: skip
    with pytest.raises(ClothbenchError, match=r"'suite.each' .* matches none"):
        plan(config(tmp_path, suite={"each": ["velvet"]}), catalogue())


def test_rivals_are_the_other_fabrics_same_trials(tmp_path):
    cells = plan(config(stand_ins(tmp_path), analysis={"confusion": {"cases": ["silk/*"]}}), catalogue())
    assert {s.name for s in cells[0].rivals} == {"wool/sway-1", "wool/sway-2"}
    assert cells[2].rivals == ()
    assert cells[0].key != dataclasses.replace(cells[0], rivals=()).key


def test_fixed_parameters_and_effects_follow_case_and_model(tmp_path):
    suite = {"fixed": {"silk/*": {"zeta": 0.2}}, "effects": {"mass_spring": ["added_mass"]}}
    cells = plan(config(stand_ins(tmp_path), suite=suite), catalogue())
    assert [dict(c.fixed) for c in cells] == [{"zeta": 0.2}] * 2 + [{}] * 2
    assert cells[0].effects == ("added_mass",)


def test_a_parameter_with_a_number_is_held_in_all_cases(tmp_path):
    suite = {"fixed": {"zeta": 0.2, "silk/*": {"k2": 1.0}}}
    cells = plan(config(stand_ins(tmp_path), suite=suite), catalogue())
    assert [dict(c.fixed) for c in cells] == [{"zeta": 0.2, "k2": 1.0}] * 2 + [{"zeta": 0.2}] * 2


def test_the_parameter_of_an_effect_is_held_by_its_dotted_name(tmp_path):
    """A parser of settings takes the dot for a level, as it does in the name of a case with its parameter."""
    suite = {
        "fixed": {
            "linear_drag": {"coefficient": 0.5},
            "*": {"zeta": 0.2},
            "silk/*": {"linear_drag": {"coefficient": 2}},
        }
    }
    cells = plan(config(stand_ins(tmp_path), effects=["linear_drag"], suite=suite), catalogue())
    held = [{"linear_drag.coefficient": 2.0, "zeta": 0.2}] * 2 + [{"linear_drag.coefficient": 0.5, "zeta": 0.2}] * 2
    assert [dict(c.fixed) for c in cells] == held
    with pytest.raises(ClothbenchError, match=r"no parameter 'linear_drag.coeficient'; did you mean 'linear_drag.coef"):
        plan(
            config(tmp_path, effects=["linear_drag"], suite={"fixed": {"linear_drag": {"coeficient": 1}}}), catalogue()
        )


@pytest.mark.parametrize(
    ("suite", "found"),
    [
        ({"fixed": {"zta": 0.2}}, r"'suite.fixed': no parameter 'zta'; did you mean 'zeta'\? there are: k1, k2, zeta"),
        (
            {"fixed": {"silkk/*": {"zeta": 0.2}}},
            r"'suite.fixed': 'silkk/\*' matches none of the cases silk/sway-1, .*~suite",
        ),
        ({"textile": {"sikl/sway-1": "soft", "wool/*": "stiff"}}, "'suite.textile': 'sikl/sway-1' matches none"),
        (
            {"fixed": {"*": {"zta": 0.2}}},
            r"'suite.fixed': no parameter 'zta'; did you mean 'zeta'\? there are: k1, k2, zeta",
        ),
        ({"fixed": {"*": {"zeta": -0.2}}}, "'zeta' is fixed at -0.2 1, expected 0 or above"),
        ({"effects": {"mass_sprng": ["added_mass"]}}, "'suite.effects': no model named .* did you mean 'mass_spring'"),
        ({"published": {"node_eror": {"paper": 1.0}}}, "'suite.published': no metric named .* 'node_error'"),
        (
            {"published": {"node_error": {"paper": "much cm"}}},
            "published.node_error.paper' is 'much cm', expected a num",
        ),
    ],
)
def test_what_a_suite_says_of_nothing_is_refused(tmp_path, suite, found):
    with pytest.raises(ClothbenchError, match=found):
        plan(config(stand_ins(tmp_path), suite=suite), catalogue())


def test_a_paper_s_figures_keep_the_unit_that_the_suite_states(tmp_path):
    """2.5 cm are no 2.5 mm because the run's error is in mm."""
    figures = {"node_error": {"soft": "2.5 cm", "stiff": 3}, "fold": {"not asked": 1.0}}
    (cell, *_) = plan(config(stand_ins(tmp_path), suite={"published": figures}), catalogue())
    bench = SimpleNamespace(cell=cell, trials=[SimpleNamespace(metric=NodeError("mm"))], others=())
    found = [(row["name"], row["value"], row["unit"]) for row in _published_of(bench)]
    assert found == [("soft", 2.5, "cm"), ("stiff", 3.0, "mm")]


def test_a_map_over_a_parameter_that_nothing_has_is_refused_before_the_run(tmp_path):
    folder = stand_ins(tmp_path)
    wrong = {"map": {"parameters": ["k1", "bnd"]}}
    with pytest.raises(
        ClothbenchError, match=r"'analysis.map.parameters': no parameter 'bnd'; there are: k1, k2, zeta"
    ):
        plan(config(folder, analysis=wrong), catalogue())
    assert plan(config(folder, analysis={"map": {}}), catalogue())  # over bend and stretch, which other models have


def test_a_suite_may_speak_of_other_models_and_recordings(tmp_path):
    fixed = {"*": {"theta": 0.0, "quadratic_drag.normal": 1.0, "bend_ratio": 1.0}}
    textile = {"silk/*": "soft", "wool/*": "stiff", "cotton_white": "medium"}
    assert plan(config(stand_ins(tmp_path), suite={"fixed": fixed, "textile": textile}), catalogue())
    alone = {"select": ["wool/*"], "fixed": {"silk/*": {"zeta": 0.2}}}
    assert plan(config(tmp_path, suite=alone), catalogue())


def test_bounds_may_be_of_parameters_that_only_some_cells_search(tmp_path):
    suite = {"fixed": {"silk/*": {"zeta": 0.2}}}
    found = plan(config(stand_ins(tmp_path), suite=suite, bounds={"zeta": [0.1, 0.5]}), catalogue())
    assert len(found) == 4
    with pytest.raises(ClothbenchError, match=r"no parameter 'zta'; did you mean 'zeta'\? there are: k1, k2, zeta"):
        plan(config(tmp_path, suite=suite, bounds={"zta": [0.1, 0.5]}), catalogue())


@pytest.mark.parametrize(
    ("recordings", "wrong", "found"),
    [
        ("drape", {"bounds": {"H1_typo": [0, 1]}}, "no parameter 'H1_typo'; there are: D1"),
        ("drape", {"suite": {"fixed": {"*": {"H1_typo": 1.0}}}}, "'suite.fixed': no parameter 'H1_typo'"),
        (
            "drape",
            {"options": {"mass_spring_verlet": {"no_such": 3}}},
            "no option 'no_such'; there are: resolution, dt, ",
        ),
        (
            "drape",
            {"scene": {"spacing": 0.02}, "finer": {"spacing": 0.01, "share": 0.5}, "budget": 1},
            "expected at least 2 evaluations",
        ),
        ("shake", {"bounds": {"H1_typo": [0, 1]}}, "no parameter 'H1_typo'; there are: D1"),
    ],
)
def test_settings_are_held_against_a_model_before_images_are_tracked(recordings, wrong, found):
    """Of drapes the scene is known; of depth frames, in which the cloth has to be found first, the parameters are."""
    told = {"drape": {"tracker": "drape", "metric": "drape"}, "shake": {"tracker": "depth_mesh"}}[recordings]
    given = {"model": "mass_spring_verlet", **told, **wrong, "recordings": f"builtin:{recordings}"}
    suite = {"case": "fabric", "each": [], "select": ["ribbed*", "damped*"], **wrong.get("suite", {})}
    with pytest.raises(ClothbenchError, match=found):
        plan(config("", **{**given, "suite": suite}), catalogue())


def test_an_option_reaches_the_tracker_and_makes_another_cell(tmp_path):
    suite = {"each": ["silk/sway-1"]}
    usual = plan(config(stand_ins(tmp_path), suite=suite), catalogue())[0]
    told = plan(config(tmp_path, suite=suite, options={"markers": {"sigma": 0.02}}), catalogue())[0]
    assert [set_up(c, catalogue()).trials[0].observation.sigma for c in (usual, told)] == [1e-3, 0.02]
    assert usual.key != told.key
    with pytest.raises(ClothbenchError, match=r"no option 'sgma'; did you mean 'sigma'\? there are: material,"):
        plan(config(tmp_path, suite=suite, options={"markers": {"sgma": 0.02}}), catalogue())


def test_air_is_not_searched_for_in_sheets_at_rest_whatever_the_model():
    from omegaconf import OmegaConf

    suite = OmegaConf.to_container(OmegaConf.load(ROOT / "suites" / "suite" / "static_dynamic.yaml"))
    changes = {k: v for k, v in suite.items() if k != "suite"} | {"model": ["baraff_witkin", "mass_spring"]}
    cells = plan(config("builtin:static_dynamic", **changes, suite={**suite["suite"], "select": ["satin/*"]}),
                 catalogue())  # fmt: skip
    for cell in cells:
        names = set_up(cell, catalogue()).space.names
        assert any("drag" in name for name in names) == ("waving" in cell.case), (cell.label, names)


def test_one_mesh_spacing_serves_cloth_of_any_size(recording):
    from clothbench.recordings.scenes import scene_of

    assert scene_of(recording, spacing=0.05).resolution == (5, 5)
    assert scene_of(dataclasses.replace(recording, cloth_width=0.4), spacing=0.05).resolution == (9, 5)


def row(case, recording, value, split, key):
    return {"case": case, "recording": recording, "value": value, "split": split, "key": key, "metric": "fold",
            "objective": "fold", "model": "m", "effects": "", "optimizer": "o", "seed": 0, "unit": "px"}  # fmt: skip


def table_three():
    """The satin example of the paper: experiment 1 gives 106.4 + 272.8, experiment 2 gives 114.1 + 178.6."""
    rows, starts = [], []
    for fabric, shift in (("satin", 0.0), ("linen", 5.0)):
        for n, (mine, other) in {1: (106.4, 272.8), 2: (178.6, 114.1)}.items():
            key, case = f"{fabric}{n}", f"{fabric}/waving-{n}"
            rows += [row(case, case, mine + shift, "fit", key),
                     row(case, f"{fabric}/waving-{3 - n}", other + shift, "held_out", key),
                     row(case, f"{fabric}/waving-long", 300.0, "held_out", key)]  # fmt: skip
            starts.append({"key": key, "start": 200.0})
    return rows, starts


def test_the_fit_with_the_least_sum_over_both_trials_is_chosen():
    moved = {t.case: t for t in transfers(*table_three())}
    first, second = moved["satin/waving-1"], moved["satin/waving-2"]
    assert (first.total, second.total) == pytest.approx((379.2, 292.7))
    assert (first.chosen, second.chosen) == (False, True)
    assert first.group == "satin/waving"
    assert first.start == 200.0
    assert transfers([row("all", "a", 1.0, "fit", "k"), row("all", "b", 1.0, "fit", "k")], []) == []


def test_fits_with_other_budgets_or_settings_are_never_summed():
    rows, starts = table_three()
    longer = [{**r, "key": r["key"] + "+", "value": r["value"] / 2, "budget": 600} for r in rows]
    both = transfers([{**r, "budget": 40} for r in rows] + longer, starts)
    assert {t.way for t in both} == {"m · o · fold · 40 evaluations", "m · o · fold · 600 evaluations"}
    short = {t.case: t.total for t in both if "40" in t.way}
    assert short == pytest.approx({t.case: t.total for t in transfers(rows, starts)})
    assert sum(t.chosen for t in both) == 4


def test_a_trial_that_was_fitted_again_counts_once_in_the_sum():
    """As with a further `report`, of which the fit is the same and the cell another."""
    rows, starts = table_three()
    again = [{**r, "key": r["key"] + "+", "finished": "later"} for r in rows]
    one = [r for r in again if r["case"].endswith("-1")]
    for more in (one, again):
        both = transfers(rows + more, starts)
        assert [(t.case, t.total, t.chosen) for t in both] == [
            (t.case, t.total, t.chosen) for t in transfers(rows, starts)
        ]
        assert {t.key for t in both if t.case.endswith("-1")} == {r["key"] for r in one}
    assert transfers([r for r in rows if r["case"].endswith("-1")] + one, starts) == []


def test_a_trial_that_was_lost_when_it_was_fitted_again_counts_as_before():
    rows, starts = table_three()
    again = [{**r, "key": r["key"] + "+", "finished": "later"} for r in rows]
    lost = [{**r, "value": None if r["recording"] == "satin/waving-2" else r["value"]} for r in again]
    found = {t.case: t for t in transfers(rows + lost, starts)}
    assert {case: t.key for case, t in found.items()} == {
        "satin/waving-1": "satin1", "satin/waving-2": "satin2", "linen/waving-1": "linen1+", "linen/waving-2": "linen2+"
    }  # fmt: skip
    assert found["satin/waving-2"].total == pytest.approx(292.7)


def test_settings_of_a_case_of_its_own_make_no_other_way():
    rows, starts = table_three()
    own = [{**r, "settings": r["case"][:5]} for r in rows]
    assert {t.way for t in transfers(own, starts)} == {"m · o · fold"}
    other = [{**r, "key": r["key"] + "+", "settings": "other"} for r in rows]
    assert len({t.way for t in transfers(own + other, starts)}) == 3


def test_the_matrix_is_of_chosen_fits_and_finds_the_nearest():
    rows, starts = table_three()
    found = [
        {"key": key, "fabric": key[:5], "recorded_fabric": seen, "trial": f"waving-{n}", "unit": "px",
         "value": 10.0 if key[:5] == seen else 30.0}
        for key in ("satin1", "satin2", "linen2") for seen in ("satin", "linen") for n in (1, 2)
    ]  # fmt: skip
    (matrix,) = confusions(found, rows, starts)
    assert matrix.error == {"linen": {"satin": 30.0, "linen": 10.0}, "satin": {"satin": 10.0, "linen": 30.0}}
    assert matrix.right == 2
    again = [{**r, "key": r["key"] + "+", "finished": "later"} for r in rows]
    assert confusions(found, rows + again, starts) == [matrix]  # cells of the same fits that were not asked for it
    lost = [{**r, "value": None} if (r["key"], r["recorded_fabric"]) == ("satin2", "satin") else r for r in found]
    assert confusions(lost, rows, starts)[0].nearest("satin") == "linen"


def test_fabrics_are_compared_on_the_trials_that_all_of_them_were_held_against():
    """On the first trial satin's parameters are nearest to satin; they alone were held against the harder second."""
    rows, starts = table_three()
    errors = {("satin2", "satin"): (10.0, 50.0), ("linen2", "satin"): (20.0,), ("satin2", "linen"): (30.0, 30.0),
              ("linen2", "linen"): (10.0, 20.0)}  # fmt: skip
    found = [
        {"key": key, "fabric": key[:5], "recorded_fabric": seen, "trial": f"waving-{n}", "unit": "px", "value": value}
        for (key, seen), values in errors.items() for n, value in enumerate(values)
    ]  # fmt: skip
    (matrix,) = confusions(found, rows, starts)
    assert matrix.error == {"linen": {"satin": 20.0, "linen": 15.0}, "satin": {"satin": 10.0, "linen": 30.0}}
    assert matrix.right == 2


def test_numbers_beyond_hundred_percent_are_not_spelt_out():
    assert percent(250.0) == percent(np.inf) == "> 100 %"
    assert percent(9.18) == "9.18 %"
    assert percent(None) == "–"
    assert spread([1.0, None]) is None
    assert spread([1.0, 3.0]) == pytest.approx(100 * np.sqrt(2) / 2)


def all_tables():
    """One row or more of every analysis, as the store would give them."""
    about = {"case": "satin/waving-2", "key": "satin2", "symbol": "k", "unit": "N/m", "reason": ""}
    found = [
        {"key": key, "fabric": key[:5], "recorded_fabric": seen, "trial": "waving-1", "unit": "px", "value": 10.0}
        for key in ("satin2", "linen2")
        for seen in ("satin", "linen")
    ]
    vary = [
        {**about, "name": n, "value": 1.0, "percent": p, "slope": 0.0, "curvature": 0.0}
        for n, p in (("bend", 9.2), ("damping", np.inf))
    ]
    errors = {"error_start": 9.0, "error": 5.0, "error_unit": "px"}
    again = [{**about, **errors, "name": "bend", "repeat": n, "start": 1.0, "value": 1.0 + n / 10} for n in range(3)]
    size = {"main": 3.0, "main_half": 0.2, "total": 1.0, "total_half": None}
    felt = [{**about, **size, "name": "bend", "method": "morris", "evaluations": 40, "lost": 0}]
    axes = {"x_name": "bend", "x_unit": "N·m", "y_name": "stretch", "y_unit": "N/m"}
    drawn = [
        {**about, **axes, "x": x, "y": y, "error": None if x == 1.0 else y, "unit": "px"}
        for x in (1e-7, 1e-2, 1.0)
        for y in (5.0, 50.0)
    ]
    return {
        "starts": table_three()[1],
        "confusion": found,
        "variability": vary,
        "perturbations": [],
        "repeats": again,
        "sensitivity": felt,
        "map": drawn,
    }


def test_the_page_shows_every_analysis():
    import json

    from clothbench.studies.calibration.analysis_page import analysis_section

    page = analysis_section(table_three()[0], all_tables()).whole
    for word in (
        "292.7 ✓",
        "Which fabric is it?",
        "Repeated fits",
        "> 100 %",
    ):
        assert word in page
    data = page.split('id="analyses">')[1].split("</script>")[0]
    figures = json.loads(data)
    assert len(figures) == 3
    assert page.count("<figure>") == 3
    assert page.count("<table data-heat") == 1  # which fabric is it
    (heat,) = (f for f in figures if f["data"][0]["type"] == "heatmap")
    assert heat["data"][0]["z"] == [[5.0, 5.0, None], [50.0, 50.0, None]]
    assert heat["layout"]["xaxis"]["type"] == "log"
    assert analysis_section([], {name: [] for name in all_tables()}) is None


def test_the_terminal_shows_every_analysis(capsys):
    from clothbench.display.terminal import console
    from clothbench.studies.calibration.analysis_tables import analyses

    for shown in analyses(table_three()[0], all_tables()):
        console().print(shown)
    said = capsys.readouterr().out
    for word in ("E1 + E2", "292.7 ✓", "which fabric is it?", "variability", "> 100 %", "repeated fits", "Morris"):
        assert word in said
    shown = analyses(table_three()[0], {name: [] for name in all_tables()})
    assert not any("variability" in str(one.title) for one in shown)
