"""What the page answers: rankings with ties, what is determined, whether more budget would help; from rows alone."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_ind

from clothbench.core.observation import Observation
from clothbench.core.protocols import Score
from clothbench.display.answer import Card
from clothbench.display.templates import rendered
from clothbench.engine.study import Results
from clothbench.estimation.intervals import error_interval
from clothbench.report.page import what_was_run
from clothbench.studies.calibration.answer import HERE, lead, leading_metric, mean_of, parameter_cards
from clothbench.studies.calibration.asked import with_settings
from clothbench.studies.calibration.budget import late_fall, settled
from clothbench.studies.calibration.estimates import contained, estimates
from clothbench.studies.calibration.leaderboard import leaderboard, same_in_all
from clothbench.studies.calibration.matrix import HOTTEST, metrics_of, one_way, several_ways
from clothbench.studies.calibration.page import told_by_unit
from clothbench.studies.calibration.parameters_page import exact, group_by_key, model_table, strip_of, truth_said
from clothbench.studies.calibration.parameters_page import numbers as parameter_numbers
from clothbench.studies.calibration.published import published_section
from clothbench.studies.calibration.ranking import (
    best_cell,
    best_of,
    cell_names,
    errors_of,
    once,
    overall,
    standings,
    unpaired_includes_zero,
    way_of,
)
from clothbench.studies.calibration.tables import error_table
from clothbench.studies.calibration.tables import overall as told_overall
from clothbench.studies.calibration.words import listed, size
from clothbench.studies.fold_path.page import answer_of as led
from clothbench.studies.folding.answer import answer_of as folded
from clothbench.studies.folding.page import fold_section, path_figure
from clothbench.studies.folding.tables import fold_table
from clothbench.studies.mechanics.answer import answer_of as meant
from clothbench.studies.mechanics.page import numbers
from clothbench.studies.mechanics.tables import observed_orders
from clothbench.studies.speed.answer import answer_of as paced
from clothbench.studies.speed.tables import _lines


def row(model: str, case: str, recording: str | None, value: float | None, **more: Any) -> dict[str, Any]:
    known = {
        "suite": "s", "case": case, "recording": recording, "split": "held_out", "model": model, "effects": "",
        "optimizer": "ga", "objective": "fold", "metric": "fold", "unit": "px", "value": value, "low": None,
        "high": None, "floor": None, "status": "ok" if value is not None else "diverged", "reason": "",
        "evaluations": 9, "wall_s": 1.0, "seed": 0, "key": f"{model}-{case}", "budget": 9, "settings": "a",
    }  # fmt: skip
    return {**known, **more}


def rows_of(errors: dict[str, list[float]], case: str = "linen") -> list[dict[str, Any]]:
    return [row(m, case, f"{case}/{n}", v) for m, values in errors.items() for n, v in enumerate(values)]


def test_a_model_that_is_better_on_every_recording_wins_however_much_they_differ():
    found = standings(rows_of({"a": [1.0, 100.0, 10.0, 50.0], "b": [2.0, 102.0, 11.5, 52.0]}), "fold")
    assert best_of(found["linen"]) == ["a"]
    first, second = overall(found)
    assert (first.way, second.way) == ("a", "b")
    assert second.recordings == 4
    assert second.ratio == pytest.approx(np.exp(np.mean(np.log([2.0, 1.02, 1.15, 1.04]))))


def test_fits_in_two_units_are_not_ranked_together():
    rows = [row("a", "linen", "linen/1", 7.0, unit="mm"), row("b", "linen", "linen/1", 0.9, unit="cm")]
    assert [(r["metric"], r["objective"]) for r in told_by_unit(rows)] == [("fold [mm]",) * 2, ("fold [cm]",) * 2]
    found = {unit: standings(told_by_unit(rows), f"fold [{unit}]")["linen"] for unit in ("mm", "cm")}
    judged = {unit: [s.value for s in case.values() if s.value is not None] for unit, case in found.items()}
    assert judged == {"mm": [7.0], "cm": [0.9]}
    assert told_by_unit(rows[:1]) == rows[:1]  # of one unit nothing need be said


@pytest.mark.parametrize(
    ("better", "worse", "ratio"),
    [
        ([0.0, 0.9, 0.9, 0.9], [0.01, 1.0, 1.0, 1.0], 4 / 2.7),
        ([0.0, 0.0, 5.0], [3.0, 3.0, 4.0], 2.8),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], np.inf),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1.0),
    ],
)
def test_an_error_of_nothing_counts_for_a_way_and_not_against_it(better, worse, ratio):
    first, second = overall(standings(rows_of({"b": better, "c": worse}), "fold"))
    assert (first.way, first.ratio, second.way) == ("b", 1.0, "c")
    assert second.ratio == pytest.approx(ratio)
    assert second.recordings == len(worse)


def test_beside_an_error_of_nothing_any_other_is_hottest():
    some = rows_of({"a": [0.0, 0.0, 0.0], "b": [5.0, 5.1, 4.9], "c": [0.0, 0.0, 0.0]})
    (_, _, squares), = several_ways("s", "fold", some, lambda *_: "").lines  # fmt: skip
    assert [(s.text, s.below, s.heat, s.best) for s in squares] == [
        ("0.00", "", 0.0, True), ("5.00", "best is 0", HOTTEST, False), ("0.00", "≈ tied", 0.0, True)
    ]  # fmt: skip


def test_a_way_that_errs_by_nothing_anywhere_has_an_answer():
    assert told(rows_of({"a": [0.0, 0.0, 0.0]}), "fold").startswith("Only a was tried.")
    said = told(rows_of({"a": [0.0, 0.0, 0.0], "b": [0.1, 0.11, 0.09]}), "fold")
    assert said.startswith("Take a. b is off where the other errs by 0 throughout (3 recordings).")


def test_ways_are_compared_over_the_recordings_that_all_of_them_have():
    """By its own mean of 3.25 the better way would be last, with a ratio of less than 1 to the first."""
    some = rows_of({"a": [1.0, 1.0, 1.0, 10.0], "b": [1.1, 1.1, 1.1]})
    found = standings(some, "fold")
    first, second = overall(found)
    assert (first.way, first.recordings, second.way, second.recordings) == ("a", 3, "b", 3)
    assert second.ratio == pytest.approx(1.1)
    assert best_of(found["linen"]) == ["a"]
    assert "Not compared, since only some of the ways were judged on them: linen/3." in told(some, "fold")
    assert "a has the least error in 1 of 1 cases." in told(some, "fold")
    (_, _, (a, b)), = several_ways("s", "fold", some, lambda *_: "").lines  # fmt: skip
    assert (a.text, a.below, a.best, b.text, b.below, b.best) == ("3.25", "", True, "1.10", "× 1.10", False)
    assert a.title == "4 recordings; compared without 1 recording that not all ways have"
    assert told(rows_of({"a": [1.0], "b": [2.0]}), "fold").count("Not compared") == 0


def test_models_that_take_turns_are_tied():
    found = standings(rows_of({"a": [1.0, 5.0, 3.0], "b": [1.2, 4.8, 3.1]}), "fold")
    assert best_of(found["linen"]) == ["a", "b"]
    assert overall(found)[1].tied


@pytest.mark.parametrize(("ways", "recordings"), [(2, 5), (5, 5), (8, 10)])
def test_of_equally_good_ways_any_is_called_worse_in_one_of_twenty_cases_at_most(ways, recordings):
    """However many there are: of eight that were compared two by two, one was in every second case or so."""
    random, count = np.random.default_rng(3), 150
    in_the_case, over_all = 0, 0
    for _ in range(count):
        errors = np.exp(0.2 * random.standard_normal((ways, recordings)))
        found = standings(rows_of({f"m{k}": one.tolist() for k, one in enumerate(errors)}), "fold")
        in_the_case += len(best_of(found["linen"])) < ways
        over_all += not all(one.tied for one in overall(found)[1:])
    assert max(in_the_case, over_all) < 0.1 * count


def test_of_one_recording_without_an_interval_nothing_is_known():
    found = standings(rows_of({"a": [1.0], "b": [1.001]}), "fold")
    assert best_of(found["linen"]) == ["a", "b"]


def test_of_two_recordings_their_own_intervals_decide():
    near = [row("a", "linen", "x", 1.0, low=0.5, high=1.5), row("b", "linen", "x", 1.4, low=0.9, high=1.9)]
    far = [near[0], row("b", "linen", "x", 3.0, low=2.5, high=3.5)]
    assert best_of(standings(near, "fold")["linen"]) == ["a", "b"]
    assert best_of(standings(far, "fold")["linen"]) == ["a"]
    half = [far[0], {**far[1], "low": None, "high": None}]  # b may be anywhere
    assert best_of(standings(half, "fold")["linen"]) == ["a", "b"]


@pytest.mark.parametrize(("apart", "best"), [(0.59, ["a", "b"]), (0.61, ["a"])])
def test_the_mean_of_two_recordings_is_surer_than_either(apart, best):
    """Of ±0.6 each, four values in a difference of two means: ±√(4 · 0.6²)/2."""
    values = {"a": (1.0, 2.0), "b": (1.0 + apart, 2.0 + apart)}
    some = [row(m, "linen", f"x{n}", v, low=v - 0.6, high=v + 0.6) for m in "ab" for n, v in enumerate(values[m])]
    assert best_of(standings(some, "fold")["linen"]) == best


def test_means_of_seeds_are_compared_by_welchs_test():
    one, other = np.array([-1.0, 0.2, 0.8]), np.array([0.05, -0.1, 0.0, 0.1, -0.05, 0.1, -0.1, 0.0])
    apart = np.linspace(0.0, 4.0, 401)
    found = [unpaired_includes_zero(one, other + by) for by in apart]
    assert found == [ttest_ind(one, other + by, equal_var=False).pvalue >= 0.05 for by in apart]
    assert True in found
    assert False in found


def test_seeds_are_repetitions_of_one_way():
    some = [
        row(m, "linen", "x", v + 0.1 * s, seed=s, key=f"{m}{s}")
        for (m, v), s in itertools.product((("a", 1.0), ("b", 2.0)), range(3))
    ]
    found = standings(some, "fold")["linen"]
    assert set(found) == {"a", "b"}
    assert found["a"].seeds == 3
    assert found["a"].value == pytest.approx(1.1)
    assert best_of(found) == ["a"]


def test_of_one_seed_one_cell_counts_whatever_else_was_asked_of_it():
    """As of `report=[]`, then `[relative_error]`, then `[marked_edges]`: three cells, and one search."""

    def cells(count: int) -> list[dict[str, Any]]:
        return [
            row(m, "linen", "x", v, low=v - 3.0, high=v + 3.0, key=f"{m}{n}", finished=f"2026-01-0{n + 1}")
            for (m, v), n in itertools.product((("a", 9.7), ("b", 9.9)), range(count))
        ]

    found = {count: standings(cells(count), "fold")["linen"] for count in (1, 3)}
    for standing in found.values():
        assert (standing["a"].seeds, standing["a"].errors) == (1, {"x": (9.7,)})
        assert best_of(standing) == ["a", "b"]
    failed = row("a", "linen", None, None, split=None, key="a9", finished="2026-01-09")
    assert standings([*cells(2), failed], "fold")["linen"]["a"].whole == ""  # nor is it one of two seeds that failed
    said = [r for case in ("linen", "satin") for r in cells(3) if not r.update(case=case)]
    assert "9.70 px over 2 recordings" in told_overall(said)[0]


def test_seeds_that_end_in_one_place_do_not_make_a_win_of_one_recording():
    def seeds(half: float | None) -> list[dict[str, Any]]:
        ends = {"low": None, "high": None}
        return [
            row(
                m,
                "linen",
                "x",
                v,
                seed=n,
                key=f"{m}{n}",
                **(ends if half is None else {"low": v - half, "high": v + half}),
            )
            for (m, v), n in itertools.product((("a", 9.7), ("b", 9.9)), range(3))
        ]

    for half, best in ((3.0, ["a", "b"]), (None, ["a", "b"]), (0.1, ["a"])):
        assert best_of(standings(seeds(half), "fold")["linen"]) == best


def test_fits_to_other_recordings_are_other_ways():
    fit = [row("a", "linen", "linen/x", 1.0, split="fit"), row("a", "linen", "linen/z", 2.0)]
    more = [row("a", "linen", f"linen/{n}", 1.0, split="fit", key="more") for n in "xy"]
    found = standings([*fit, *more, row("a", "linen", "linen/z", 4.0, key="more")], "fold")["linen"]
    assert {way: s.value for way, s in found.items()} == {"a · fitted to x": 2.0, "a · fitted to x, y": 4.0}


def test_a_way_without_a_number_is_neither_ranked_nor_tied():
    some = [*rows_of({"a": [1.0, 2.0, 3.0]}), row("b", "linen", None, None, split=None)]
    found = standings(some, "fold")
    assert best_of(found["linen"]) == ["a"]
    assert found["linen"]["b"].status == "diverged"
    assert [one.way for one in overall(found)] == ["a"]


def test_a_way_whose_seeds_mostly_fail_is_marked_and_not_ranked():
    """By its one seed alone it would be first."""
    some = rows_of({"a": [2.0, 3.0, 4.0]})
    some += [r | {"key": "b-0"} for r in rows_of({"b": [1.0, 1.0, 1.0]})]
    lost = {"split": None, "status": "diverged", "reason": "fell over"}
    some += [row("b", "linen", None, None, seed=k, key=f"b-{k}", **lost) for k in (1, 2)]
    found = standings(some, "fold")
    assert best_of(found["linen"]) == ["a"]
    assert [one.way for one in overall(found)] == ["a"]
    assert (found["linen"]["b"].value, found["linen"]["b"].whole) == (None, "1 of 3 seeds")
    assert lead(overall(found), found)["left"] == ["b"]
    (_, _, (_, square)), = several_ways("s", "fold", some, lambda suite, case: "").lines  # fmt: skip
    assert (square.text, square.below, square.title) == ("diverged", "1 of 3 seeds", "fell over")
    alone = [r for r in some if r["model"] == "b"]
    (_, _, squares), = one_way("s", "fold", alone, lambda suite, case: "").lines  # fmt: skip
    assert {(s.text, s.below) for s in squares} == {("1.00", "1 of 3 seeds")}


def test_the_terminal_says_of_how_many_cases_a_mean_is_and_mixes_no_budgets():
    some = [row("a", case, f"{case}/x", value) for case, value in (("linen", 1.0), ("satin", 3.0))]
    assert told_overall(some) == ["held out, all 2 cases: 2.00 px over 2 recordings (a · ga · fold, seed 0)"]
    lost = row("a", "wool", None, None, split=None, key="a-wool", metric="fold")
    assert told_overall([*some, lost])[0].startswith("held out, 2 of 3 cases: 2.00 px over 2 recordings")
    assert told_overall([some[0], {**some[1], "unit": "mm"}]) == []  # there is no mean of two units
    more = [row("a", case, f"{case}/x", 9.0, budget=99, key=f"{case}99") for case in ("linen", "satin")]
    assert told_overall([*some, *more]) == [
        "held out, all 2 cases: 2.00 px over 2 recordings (a · ga · fold · 9 evaluations, seed 0)",
        "held out, all 2 cases: 9.00 px over 2 recordings (a · ga · fold · 99 evaluations, seed 0)",
    ]


def test_the_terminal_says_small_errors_as_the_page_does():
    """In metres two decimals had left "0.01 … 0.01" of an error of centimetres, and no floor."""
    some = [row("a", case, f"{case}/x", 0.00988, unit="m", low=0.0071, high=0.0126, floor=0.00051) for case in "cd"]
    _, error, interval, floor = (list(column.cells)[1] for column in error_table("s", some).columns)
    assert (error, interval, floor) == ("0.00988 m", "0.00710 … 0.0126", "5.10e-4 m")
    assert told_overall(some)[0].startswith("held out, all 2 cases: 0.00988 m over")


def test_ways_are_not_ranked_by_a_metric_that_never_gave_a_number():
    lost = row("cloth", "linen", None, None, objective="area", metric="area")
    assert leading_metric([lost, *rows_of({"cloth": [1.0, 2.0]})]) == "fold"
    assert leading_metric([lost]) == "area"


def test_a_fit_that_was_not_judged_by_a_metric_is_not_one_that_failed():
    some = [row("a", "linen", "x", 1.0), row("a", "linen", "x", 1.0, metric="fold_count")]
    some += [row("a", "linen", "x", 1.2, seed=1, key="a-1")]
    assert standings(some, "fold_count")["linen"]["a"].whole == ""


def told(rows: list[dict[str, Any]], metric: str) -> str:
    """The first sentences of the page's answer."""
    found = standings(rows, metric)
    ranked = overall(found)
    error = {"error": Card("Held-out error", "5 px", "", said="5 px")}
    html = rendered(HERE, "lead.html", lead=lead(ranked, found, metric), cards=error, failed=not ranked)
    return " ".join(re.sub(r"<[^>]*>", "", html).split())


def test_a_way_that_was_not_judged_by_a_metric_is_not_said_to_have_failed():
    """As of two metrics that are minimised, without a report of either."""
    some = rows_of({"a": [1.0, 2.0, 3.0]})
    some += [r | {"metric": "mm", "objective": "mm", "key": "other"} for r in some]
    said = told(some, "fold")
    assert said.startswith("Only a · by fold is ranked. ")
    assert "not judged by fold in every case: a · by mm. With it in report they would be" in said
    assert "came to" not in said
    said = told([*some, *rows_of({"a": [1.0, 2.0, 3.0]}, "satin")], "fold")  # where the other was not even run
    assert said.endswith("Not ranked, since they have not been run in every case yet: a · by mm.")


def test_a_case_with_nothing_held_out_is_named_and_the_others_are_ranked():
    some = [r for case in ("linen", "satin") for r in rows_of({"a": [1.0, 2.0], "b": [2.0, 4.1]}, case)]
    some += [row(m, "wool", "wool/0", 1.0, split="fit") for m in ("a", "b")]
    said = told(some, "fold")
    assert said.startswith("Take a. b is 2.0")
    assert "a has the least error in 2 of 2 cases." in said
    assert "nothing was held out there: wool." in said
    *_, (case, _, (square, _)) = several_ways("s", "fold", some, lambda *_: "").lines
    assert case == "wool"
    assert (square.text, square.below) == ("–", "nothing held out")


def test_single_runs_on_other_recordings_are_no_seeds_that_failed():
    """One that held nothing out, beside one of the same model that did, and beside one of another model."""
    held = [row("a", "linen", "x", 1.5, split="fit"), row("a", "linen", "y", 1.0)]
    single = row("a", "linen", "x", 1.2, split="fit", key="single")
    found = standings([*held, single], "fold")
    assert (found["linen"]["a"].value, found["linen"]["a"].whole) == (1.0, "")
    assert "Only a was tried." in told([*held, single], "fold")
    said = told([*held, {**single, "model": "b"}], "fold")
    assert "Only a is ranked." in said
    assert "Not ranked, since nothing was held out of what they were fitted to: b." in said
    assert "There is no answer" not in said
    assert leading_metric([row("a", "linen", None, None, objective="bare", metric="bare"), *held]) == "fold"


def test_of_few_recordings_the_answer_tells_ways_apart_where_the_table_does():
    far = [row("a", "linen", "x", 5.0, low=4.5, high=5.5), row("b", "linen", "x", 500.0, low=450.0, high=550.0)]
    found = standings(far, "fold")
    assert best_of(found["linen"]) == ["a"]
    assert [one.tied for one in overall(found)] == [False, False]
    near = standings([far[0], far[1] | {"value": 5.1, "low": 4.6, "high": 5.6}], "fold")
    assert [one.tied for one in overall(near)] == [False, True]


def test_the_floor_beside_a_held_out_mean_is_its_own():
    def rows(split: str, floor: float) -> list[dict[str, Any]]:
        return [row("a", "stiff", name, 0.5, split=split, floor=floor) for name in (f"stiff/{split}", None)]

    for some, floor in (([*rows("fit", 0.385), *rows("held_out", 0.499)], "0.499"), (rows("fit", 0.385), "0.385")):
        means = re.sub("<[^>]+>", " ", leaderboard(some).partition("<details")[0]).split()
        assert [word for word in means if word in ("0.385", "0.499")] == [floor]


def test_a_way_is_called_by_what_tells_it_apart():
    some = [row("a", "linen", "x", 1.0), row("a", "linen", "x", 1.0, optimizer="cma_es"), row("b", "linen", "x", 1.0)]
    name = way_of(some)
    assert [name(r) for r in some] == ["a · ga", "a · cma_es", "b · ga"]
    assert way_of(some[:1])(some[0]) == "a"
    # Settings tell versions of the optimizer and the metric, too; these have other ones, but nothing was set otherwise.
    told = [r | {"settings": f"digest of {r.get('optimizer')}"} for r in some]
    assert [way_of(told)(r) for r in told] == ["a · ga", "a · cma_es", "b · ga"]
    other = [told[0], told[0] | {"settings": "another"}]
    assert way_of(other)(other[1]) == "a · settings another"


def asked_as(rows: list[dict[str, Any]], questions: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with words for what their cells were told, by key, beside `model` and the like."""

    def table(name: str, keys: Iterable[str], columns: Any) -> list[dict[str, Any]]:
        plain = {"model": "a", "optimizer": "ga", "metric": "fold", "tracker": "markers", "effects": [], "report": [],
                 "options": {}}  # fmt: skip
        return [{"key": k, "question": json.dumps(plain | questions[k])} for k in keys if k in questions]

    return with_settings(Results(SimpleNamespace(table=table), rows)).rows


def test_cells_that_differ_in_what_they_report_are_told_apart_by_their_keys():
    some = [row("a", "linen", "linen/x", 1.0, key=key, settings="same") for key in ("a0" * 8, "b1" * 8)]
    other = row("b", "linen", "linen/x", 1.0, key="c2" * 8, settings="same")
    names = cell_names([*some, other])
    assert [names[r["key"]][-11:] for r in some] == [" · a0a0a0a0", " · b1b1b1b1"]
    assert "c2c2" not in names[other["key"]]
    headings = [text for text in error_table("s", some).columns[0].cells if "[bold]" in text]
    assert len(set(headings)) == 2


def test_what_was_set_otherwise_is_named():
    """A sweep over an option had three headings that were the same, and "settings 33eb36" on the page."""
    some = [
        row("a", case, f"{case}/x", 1.0, key=f"{case}{n}", settings=f"{case}{n}")
        for case, n in itertools.product(("linen", "satin"), (4, 6))
    ] + [row("b", "linen", "linen/x", 2.0)]
    told = {
        key: {"options": {"ga": {"population": n}, "other": {"n": n}}, "bounds": {"bend": [0, 1e-3 if c == "s" else 1]}}
        for key in ("linen4", "linen6", "satin4", "satin6") for n, c in [(int(key[-1]), key[0])]
    }  # fmt: skip
    found = asked_as(some, told)
    assert [way_of(found)(r) for r in found] == [f"a · ga.population {n}" for n in (4, 6)] * 2 + ["b"]
    assert {*standings(found, "fold")["satin"]} == {"a · ga.population 4", "a · ga.population 6"}
    headings = [text for text in error_table("s", found).columns[0].cells if "[bold]" in text]
    assert headings[0].startswith("[bold]linen · a · ga · fold · ga.population 4[/]")
    assert len(set(headings)) == 5
    assert "ga.population 6" in leaderboard(found)
    range_of = {"linen4": {"bounds": {"k": [0, 1e-3]}}, "linen6": {"bounds": {"k": [0.5, 10.0]}}}
    assert [r["told"] for r in asked_as(some[:2], range_of)] == ["bounds.k 0 … 0.001", "bounds.k 0.5 … 10"]
    for lost in ({"linen4": {}}, {"linen4": {}, "linen6": {}}):  # a question is missing, or does not say what differs
        assert way_of(kept := asked_as(some[:2], lost))(kept[0]) == "a · settings linen4"
    long = {key: {"scene": {f"n{k}": f"{key}{k}" for k in range(9)}} for key in ("linen4", "linen6")}
    assert way_of(kept := asked_as(some[:2], long))(kept[0]) == "a · settings linen4"


def parameter(**more: Any) -> dict[str, Any]:
    known = {
        "key": "k", "name": "bend", "symbol": "k", "unit": "N·m", "meaning": "", "value": 1e-4, "low": 5e-5,
        "high": 2e-4, "at_bound": False, "truth": 1.1e-4, "lower": 1e-7, "upper": 1e-2, "scale": "log",
    }  # fmt: skip
    return {**known, **more}


def test_a_parameter_is_determined_if_its_interval_leaves_most_of_the_range_out():
    (good,) = estimates([parameter()])
    assert good.determined
    assert good.found
    assert good.place(1e-7) == 0
    assert good.place(1e-2) == 1
    (whole,) = estimates([parameter(low=1e-7, high=1e-2)])
    assert whole.why_not == "any value of the range would do"
    assert whole.found is None
    (half,) = estimates([parameter(low=1e-7, high=3e-4)])
    assert "covers 70% of the range" in half.why_not
    assert "bound" in estimates([parameter(at_bound=True)])[0].why_not
    (damaged,) = estimates([parameter(upper=-np.inf)])
    assert damaged.upper == damaged.high  # a range that is none counts for nothing
    assert estimates([parameter(low=None, high=None)])[0].why_not == "no interval"
    assert estimates([parameter(truth=1.0)])[0].found is False


def test_results_without_a_range_take_the_widest_interval_for_it():
    old = [
        {n: v for n, v in parameter(**m).items() if n not in ("lower", "upper", "scale")} for m in ({}, {"high": 9.0})
    ]
    found = estimates(old)
    assert {(e.lower, e.upper, e.log) for e in found} == {(5e-5, 9.0, True)}


def test_an_interval_holds_its_value():
    assert contained(1.0, 1.2, 2.0) == (1.0, 2.0)
    assert contained(3.0, 1.2, 2.0) == (1.2, 3.0)
    assert contained(3.0, None, 2.0) == (None, 2.0)


def test_the_interval_of_few_frames_holds_the_error():
    """The last of four frames is far off."""
    trace = np.array([[1.0, 1.0, 1.0, 9.0]])
    flat, time = np.zeros((4, 1, 3)), np.linspace(0, 0.3, 4)
    seen = Observation(time, flat, np.ones((4, 1), bool), 1e-3, np.zeros((1, 2)))
    low, high = error_interval(Score(trace.mean(axis=1), "mm", per_frame=trace), seen)
    assert low < trace.mean() < high


def test_a_search_that_still_falls_asks_for_more():
    steady, falling = np.array([9.0] + [5.0] * 19), np.linspace(9, 5, 20)
    assert late_fall(steady) == 0
    assert late_fall(falling) > 0.1
    assert late_fall(np.array([np.inf] * 15 + [5.0] * 5)) == 1.0  # until then nothing had come to a number
    some = [row("a", "linen", "x", 1.0, evaluations=20), row("b", "satin", "x", 1.0, evaluations=20)]
    value, said = settled(some, way_of(some), {"a-linen": steady, "b-satin": falling})
    assert value == "20 evaluations"
    assert "1 of 2 (satin)" in said
    assert "the order" not in said  # of what two models make of two cloths
    assert "mesh" not in said
    alike = [row("a", "linen", "x", 1.0, key="a"), row("b", "linen", "x", 1.0, key="b")]
    hard = row("a", "satin", "x", 1.0, key="hard")  # which the other model was not fitted to
    histories = {"a": np.array([4.0] * 20), "b": np.array([6.0] * 20), "hard": np.array([1e3] * 15 + [100.0] * 5)}
    assert "the order of ways was the same" in settled([*alike, hard], way_of(alike), histories)[1]
    histories = {"a": np.array([4.0] * 20), "b": np.array([6.0] * 15 + [3.0] * 5), "hard": np.array([9.0] * 20)}
    assert "the order of ways was another" in settled([*alike, hard], way_of(alike), histories)[1]
    both = settled([r | {"evaluations": 80} for r in some], way_of(some), {"a-linen": steady, "b-satin": falling})
    assert both[0] == "80 evaluations"  # 60 of them on a coarser mesh
    assert "in the last quarter of those on the finer mesh" in both[1]


def test_a_last_quarter_of_few_evaluations_does_not_tell():
    """Of ten evaluations, or of one, more change most; of 48 the last twelve may be one step in eleven parameters."""
    some = [row("a", "linen", "x", 1.0), row("b", "satin", "x", 1.0)]

    def said(*counts: int, free: int = 2) -> str:
        histories = {key: np.full(n, 5.0) for key, n in zip(("a-linen", "b-satin"), counts, strict=False)}
        return settled(some, way_of(some), histories, dict.fromkeys(histories, free))[1]

    assert (
        said(10, 10) == "a fit; too few to tell whether more would lower the error: the last quarter has 2 evaluations"
    )
    assert said(1).endswith("the last quarter has 0 evaluations")  # at three quarters no order can be another
    assert "the last quarter of 1 of 2 has 2 evaluations" in said(10, 400)
    assert "too few" in said(48, free=12)
    assert said(48).endswith("no error fell by more than 2\u00a0%: more would change little")


def test_the_first_way_has_the_least_errors_whatever_stands_before():
    some = rows_of({"a": [1.0, 2.0, 3.0], "b": [2.0, 4.1, 6.2], "c": [3.0, 6.2, 9.1]})
    assert "3 recordings). a has the least error in 1 of 1 cases." in told(some, "fold")


def test_a_recording_that_several_fits_hold_out_counts_once():
    """Of three recordings two are fitted in turn, so that the third is judged by two fits; names alone tell no two."""
    fitted = {"x": {"y": 1.0, "z": 2.0}, "y": {"x": 4.0, "z": 8.0}}
    some = [row("a", case, name, v) for case, values in fitted.items() for name, v in values.items()]
    some += [row("a", case, case, 0.5, split="fit") for case in fitted]
    assert told_overall(some) == ["held out, all 2 cases: 3.33 px over 3 recordings (a · ga · fold, seed 0)"]
    assert mean_of(some, "fold", "held_out")[:2] == (
        "3.33 px", "1.00 … 5.00: 3 recordings, too few for an interval"
    )  # fmt: skip
    assert ", 3 recordings, " in what_was_run(some)
    named_alike = [row("a", case, "swing", v) for case, v in (("silk", 1.0), ("wool", 3.0))]
    assert told_overall(named_alike) == ["held out, all 2 cases: 2.00 px over 2 recordings (a · ga · fold, seed 0)"]
    assert mean_of(named_alike, "fold", "held_out")[1].startswith("1.00 … 3.00: 2 recordings")
    assert ", 2 recordings, " in what_was_run(named_alike)


@pytest.mark.parametrize(("first", "second", "middle"), [(1.0, 4.0, 2.0), (0.0, 4.0, 2.0), (3.0, 3.0, 3.0)])
def test_a_recording_of_several_cases_has_the_geometric_mean_of_its_errors(first, second, middle):
    some = [row("a", case, "z", value) for case, value in (("x", first), ("y", second))]
    found = standings(some, "fold")
    assert errors_of(case["a"] for case in found.values()) == {"z": pytest.approx(middle)}


def test_of_one_seed_the_last_cell_with_a_number_counts():
    some = [
        row("a", "linen", "x", value, key=key, finished=f"2026-01-0{day}")
        for key, value, day in (("first", 1.0, 1), ("again", 2.0, 2), ("lost", None, 3))
    ]
    assert [r["key"] for r in once(some)] == ["again"]
    assert [r["key"] for r in once(some[::-1])] == ["again"]


def test_of_several_seeds_the_cell_that_fits_best_is_shown():
    """By what it was fitted by, over all that was fitted together."""
    some = [row("a", "linen", None, value, split="fit", key=key) for key, value in (("p", 3.0), ("q", 1.0))]
    some += [
        row("a", "linen", None, 0.1, split="fit", key="r", metric="fold_count"),
        row("a", "linen", None, 0.2, split="held_out", key="s"),
        row("a", "linen", "x", 0.3, split="fit", key="t"),
        row("a", "linen", None, None, split="fit", key="u"),
    ]
    assert best_cell(some) == "q"
    assert best_cell(some[-1:]) == "u"


def test_what_is_alike_in_all_lines_is_said_once():
    some = rows_of({"a": [1.0, 2.0]})
    assert same_in_all(some) == "model a, optimizer ga, fitted by fold, seed 0"
    heads = leaderboard(some).split("<tbody>")[0]
    assert "optimizer" not in heads
    assert "status" not in heads
    assert "status" in leaderboard([*some, row("a", "satin", None, None)])


def test_lines_of_two_objectives_are_told_apart():
    some = [row("a", "linen", "linen/x", 1.0, objective=o, key=o) for o in ("fold", "node_error")]
    heads, body, *_ = leaderboard(some).split("<tbody>")
    assert "fitted by" in heads
    assert "<td>fold</td><td>node_error</td>" in body  # judged by, fitted by
    assert "fitted by" not in leaderboard(some[:1])
    assert "fitted by" not in same_in_all([r | {"objective": None} for r in some])


def test_the_table_opens_on_the_metric_of_the_answer():
    """Of two that were minimised the first by name had come first, by which the answer does not judge."""
    some = [row("a", "linen", "linen/x", 1.0, objective=o, metric=m, floor=0.5 if m == "node_error" else None, key=o)
            for o in ("fold", "node_error") for m in ("fold", "node_error", "chamfer")]  # fmt: skip
    assert leading_metric(some) == "node_error"
    assert metrics_of(some) == ["node_error", "fold", "chamfer"]


def test_what_was_not_run_yet_is_not_said_to_have_failed():
    """As where a run was stopped: of one way there is no cell of the second case."""
    some = [r for case in ("linen", "satin") for r in rows_of({"a": [1.0, 2.0, 3.0], "b": [2.0, 4.0, 6.1]}, case)]
    some += rows_of({"c": [3.0, 6.0, 9.0]})
    said = told(some, "fold")
    assert said.endswith("Not ranked, since they have not been run in every case yet: c.")
    assert "came to no number" not in said
    lost = told([*some, row("c", "wool", None, None), *rows_of({"a": [1.0], "b": [2.0]}, "wool")], "fold")
    assert "since some of their fits came to no number: c." in lost
    assert "not been run" not in lost
    alone = told([r for r in some if r["model"] != "b"], "fold")
    assert alone.startswith("Only a is ranked.")


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"bend": 2e-4}, "bend in at least half of the fits"),
        ({"bend": 2e-4, "drag": 1e-2}, "bend in at least half of the fits, its other parameters in fewer or in none"),
    ],
)
def test_other_parameters_are_spoken_of_where_there_are_some(names, said):
    found = [parameter(name=name, low=1e-7 if high > 1e-3 else 5e-5, high=high) for name, high in names.items()]
    results: Any = SimpleNamespace(table=lambda name: found)
    (first, *_) = parameter_cards(results, {"k"})
    assert first.said == said


def test_numbers_have_three_digits():
    assert [size(v) for v in (0.00012, 3.6789, 1131.6, 74.0, 0.0, None)] == [
        "1.20e-4",
        "3.68",
        "1132",
        "74.0",
        "0.00",
        "–",
    ]
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(list("abcdef")) == "a, b, c, d and 2 more"


def test_an_interval_is_drawn_where_it_lies_and_the_truth_beside_it():
    strip = strip_of(estimates([parameter()])[0])
    assert strip is not None
    assert strip.kind == "sure"
    assert strip.left <= strip.dot <= strip.left + strip.width
    assert strip.mark == pytest.approx(60.8, abs=0.1)  # a range of five powers of ten from 1e-7
    assert "interval 5.00e-5 … 2.00e-4, true 1.10e-4" in strip.said
    grey = strip_of(estimates([parameter(low=1e-7, high=1e-2)])[0])
    assert grey is not None
    assert (grey.kind, grey.left, grey.width) == ("grey", 0.0, 100.0)
    assert "any value of the range would do" in grey.said


def test_fits_that_searched_other_ranges_are_drawn_on_one_axis():
    ends = {"value": 3.0, "low": 2.9, "high": 3.1, "truth": None}
    stiff = {"value": 300.0, "low": 290.0, "high": 310.0, "truth": None, "lower": 100.0, "upper": 1000.0}
    some = [parameter(key="soft", lower=1.0, upper=10.0, **ends), parameter(key="stiff", **stiff)]
    rows = [row("m", key, None, 1.0, key=key) for key in ("soft", "stiff")]
    shown = model_table("m", rows, group_by_key(estimates(some)), lambda r: r["case"])
    assert [(h["lower"], h["upper"]) for h in shown["heads"]] == [("1.00", "1000")]
    assert [strips[0].dot for _, _, strips in shown["lines"]] == pytest.approx([15.9, 82.6])


@pytest.mark.parametrize(("conditions", "said"), [
    ((None,), ""), ((35.0,), "Condition of the fit: 35;"),
    ((35.0, 4512.0, None), "Condition of the fits: 35 … 4.5e+03;"),
    ((35.0, np.inf), "Condition of the fits: 35 … infinite;"),
])  # fmt: skip
def test_the_condition_of_fits_is_told_below_their_parameters(conditions, said):
    keys = [f"k{i}" for i in range(len(conditions))]
    some = [parameter(key=key, condition=one) for key, one in zip(keys, conditions, strict=True)]
    rows = [row("m", key, None, 1.0, key=key) for key in keys]
    found = group_by_key(estimates(some))
    shown = model_table("m", rows, found, lambda r: r["case"])["condition"]
    assert shown.startswith(said)
    assert bool(shown) == bool(said)
    assert ("above a thousand some of the parameters move together freely." in shown) == bool(said)
    listed = parameter_numbers(rows, found, lambda r: r["case"])
    assert [f">{exact(one)}</td>" in listed for one in conditions if one] == [True for one in conditions if one]


def test_a_truth_outside_of_its_interval_is_marked_and_counted():
    found = estimates([parameter(), parameter(name="stretch", truth=1e-6), parameter(name="shear", truth=None)])
    outside = strip_of(found[1])
    assert outside is not None
    assert outside.kind == "outside"
    about = [{"key": "k", "case": "linen"}]
    said = truth_said(found, about, lambda row: row["case"])
    assert said == (
        "The truth is known: 1 of 2 intervals of determined parameters hold it, not those of stretch of linen."
    )
    assert truth_said(found[2:], about, lambda row: row["case"]) == ""


def shown(html: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def test_beside_the_paper_stands_the_error_of_the_metric_and_not_the_mean_of_its_frames():
    """They differ where nodes are missing: `node_error` takes each node's mean first, as the paper does."""
    known = {"recording": "linen/1", "split": "fit", "metric": "fold", "unit": "cm"}
    tables = {
        "published": [{"metric": "fold", "name": "paper", "value": 2.5, "unit": "cm", "key": "a-linen"}],
        "trace": [{**known, "time": t, "value": value} for t, value in ((0.0, 1.0), (1.0, 3.72), (2.0, None))],
    }
    store: Any = SimpleNamespace(table=lambda name, *_: tables[name])
    rows = [
        row("a", "linen", "linen/1", 2.52),
        row("a", "linen", None, 2.6),
        row("a", "linen", "linen/1", 9.0, metric="b"),
    ]
    section = published_section(Results(store, rows))
    assert section is not None
    cells = [shown(told) for told in re.findall(r"<td[^>]*>(.*?)</td>", section.html)]
    assert cells[2:5] == ["linen/1 (fit)", "2.52", "3.72"]
    section = published_section(Results(store, [row("a", "linen", None, None)]))
    assert section is not None
    assert "2.36" not in section.html  # a recording without a value has none here


def test_of_models_against_mechanics_the_answer_counts_references_that_are_met():
    def tested(model: str, case: str, value: float | None, reference: float, metric: str = "drop") -> dict[str, Any]:
        return row(model, case, None, value, metric=metric, reference=reference)

    rows = [
        tested("a", "fall", 1.001, 1.0), tested("a", "sag", 1.05, 1.0), tested("a", "convergence", 1.7, 2.0, "order"),
        tested("b", "fall", 1.0, 1.0), tested("b", "sag", 0.995, 1.0), tested("b", "convergence", None, 2.0, "order"),
        tested("b", "fold_table:denim", 3000.0, 5200.0, "eta_b"),
    ]  # fmt: skip
    said = shown(meant("tests", rows))
    assert "b meets the most references: 2 of 2 within 1 %" in said
    assert "b 2 of 2 farthest off: sag, -0.5 %; 1 diverged a 1 of 3 farthest off: sag, +5 %; order 1.70" in said
    assert "no model came to a value" in meant("tests", [rows[5]])


def test_only_what_the_finest_mesh_gave_meets_a_reference():
    def tested(model: str, case: str, value: float, suite: str = "tests", **more: Any) -> dict[str, Any]:
        return row(model, case, None, value, metric="drop", reference=1.0, suite=suite, **more)

    late = tested("b", "fall", 1.003, status="timeout", reason="stopped by the time limit")
    rows = [tested("a", "fall", 1.0), late, tested("b", "sag", 1.0), tested("b", "swing", 2.0)]
    said = shown(meant("tests", rows))
    assert "a meets the most references: 1 of 1" in said  # b, too, meets one, but of two
    assert "b 1 of 2" in said
    assert "1 timeout" in said
    assert "+0.3 % timeout" in shown(numbers(rows, []))
    two = shown(numbers([tested("a", "fall", 1.5, "first"), tested("a", "fall", 1.0, "second")], []))
    assert "fall +50 %" in two
    assert "fall +0 %" in two


def test_an_order_that_is_not_seen_on_the_finest_mesh_is_not_told():
    level = {"case": "free_fall", "step_scale": 1.0, "load": None}
    known = [{**level, "key": key, "order": order} for key, order in (("a", 2.0), ("a", None), ("b", None), ("b", 1.9))]
    assert observed_orders(known) == {"b": 1.9}


def test_of_folds_the_answer_counts_fabrics_within_their_range():
    def step(case: str, number: int, value: float) -> dict[str, Any]:
        known = {"reference": 10.0, "reference_low": 8.0, "reference_high": 12.0, "friction": 0.3, "slips": False}
        return {**known, "key": case, "case": case, "model": "m", "optimizer": "o", "step": number, "value": value,
                "low": value - 1, "high": value + 1, "wall_s": 2.0}  # fmt: skip

    steps = [step("denim", 1, 20.0), step("denim", 2, 10.5), step("twill", 1, 30.0), step("twill", 2, 13.0)]
    said = shown(folded("folds", steps))
    assert "m by o ends within the range of the reference for 1 of 2 fabrics, after 2 steps." in said
    for words in ("outside: twill", "Off the reference 18 %", "at the first 1.5e+02 %", "1 of 2", "no step slips"):
        assert words in said


def test_folds_that_fail_or_are_stopped_count_and_are_not_within():
    def step(key: str, optimizer: str, **more: Any) -> dict[str, Any]:
        known = {"value": 10.0, "reference": 10.0, "reference_low": 8.0, "reference_high": 12.0, "friction": 0.3,
                 "low": 9.0, "high": 11.0, "slips": False, "wall_s": 2.0, "step": 1, "model": "m", "length": 1.0,
                 "sheet": 10.0, "x": 0.9, "z": 0.1}  # fmt: skip
        return {**known, "key": key, "case": key[1:], "optimizer": optimizer, **more}

    def cell(key: str, optimizer: str, status: str = "ok", objective: str = "profile") -> dict[str, Any]:
        return row("m", key[1:], None, 1.0, key=key, optimizer=optimizer, status=status, objective=objective)

    steps = [step("adenim", "good"), step("atwill", "good", low=np.nan, high=np.nan), step("bdenim", "bad"),
             step("btwill", "bad")]  # fmt: skip
    rows = [cell("adenim", "good"), cell("atwill", "good"), cell("bdenim", "bad"), cell("btwill", "bad", "timeout"),
            cell("bwool", "bad", "error"), cell("cwool", "none", "skipped")]  # fmt: skip
    said = shown(folded("folds", steps, rows))
    assert "m by good ends within the range of the reference for 2 of 2 fabrics, after 1 steps. m by bad" in said
    assert "for 1 of 3 fabrics, after 1 steps; 2 came to no end." in said
    assert "Reference in the 95 % interval 1 of 1" in said  # the other has no interval
    assert "none" not in said
    table = shown(fold_section(rows, steps).html)
    assert "no interval" in table
    two = [cell("adenim", "o"), cell("bdenim", "o", objective="node_error")]
    assert "m by o on node_error ends" in shown(folded("folds", steps[::2], two))
    assert "node_error" in fold_section(two, steps[::2]).html
    names = {"adenim": "denim", "atwill": "twill"}
    drawn = path_figure([step("adenim", "good"), step("atwill", "good", length=0.5, z=0.4)], names)["data"]
    assert [one["name"] for one in drawn[:4]] == [
        f"{n}, {x} m" for x in ("0.5", "1") for n in ("triangular", "circular")
    ]
    assert drawn[1]["x"][-1] == 0.25  # at half its length, where the way up ends
    assert [one["name"] for one in drawn[4:]] == ["denim", "twill"]  # an older version kept no path of the reference


def test_the_grippers_path_stands_beside_that_of_the_reference():
    """Figure 9 of Petrík et al.: the reference's path, and those of its ± 2σ, from the flat strip's end on."""
    known = {"length": 1.0, "reference_x": 0.95, "reference_x_low": 0.96, "reference_x_high": 0.93, "x": 0.94}
    steps = [{**known, "key": "a", "step": 1, "z": 0.1}, {**known, "key": "a", "step": 2, "z": 0.2, "reference_x": 0.9}]
    *_, band, line, path = path_figure(steps, {"a": "denim"})["data"]
    assert (band["x"], band["y"]) == ([1.0, 0.96, 0.96, 0.93, 0.93, 1.0], [0.0, 0.1, 0.2, 0.2, 0.1, 0.0])
    assert (line["x"], line["y"], line["line"]["dash"]) == ([1.0, 0.95, 0.9], [0.0, 0.1, 0.2], "dot")
    assert line["line"]["color"] == band["line"]["color"] == path["line"]["color"]
    assert {one["legendgroup"] for one in (band, line, path)} == {"a"}  # shown and hidden together
    lost = path_figure([steps[0], {**steps[1], "reference_x_low": None}], {"a": "denim"})["data"]
    assert lost[-2]["y"] == [0.0, 0.1]


def test_folds_of_one_fabric_are_told_apart_by_what_differs():
    def cell(key: str, **more: Any) -> dict[str, Any]:
        return row("m", "denim", None, 10.0, key=key, **more)

    def names(*rows: dict[str, Any]) -> list[str]:
        steps = [{"case": r["case"], "key": r["key"], "step": 1, "value": 9.0, "low": 8.0, "high": 11.0, "slips": False,
                  "reference": 10.0, "reference_low": 8.0, "reference_high": 12.0, "friction": 0.3, "length": 1.0,
                  "sheet": 9.0, "wall_s": 1.0, "x": 0.9, "z": 0.1} for r in rows]  # fmt: skip
        section = fold_section(rows, steps)
        last, by_step, path = section.data["folds"]
        assert by_step["layout"]["xaxis"]["dtick"] == 1
        assert {"0.5", "1"} <= set(by_step["layout"]["yaxis"]["ticktext"])  # plotly's own say "5" and "1"
        told = last["data"][0]["text"]
        assert last["layout"]["yaxis"]["ticktext"] == [line["name"] for line in by_step["data"]] == told
        assert [line["name"] for line in path["data"][2:]] == told
        assert list(fold_table("folds", rows, steps).columns[0].cells) == told
        return told

    assert names(cell("a")) == ["denim"]
    assert names(cell("a"), cell("b", optimizer="es")) == ["denim · ga", "denim · es"]
    assert names(cell("a"), cell("b", seed=1)) == ["denim · seed 0", "denim · seed 1"]
    told = [cell("a", settings="length=1.0 steps=9"), cell("b", settings="length=0.5 steps=9")]
    assert names(*told) == ["denim · length=1.0", "denim · length=0.5"]
    heads = [re.findall(r'<th scope="col"[^>]*>([^<]*)', fold_section(rows, []).html)[:4] for rows in (
        [cell("a")], [cell("a"), cell("b", seed=1)], told)]  # fmt: skip
    assert [head[3] for head in heads] == ["reference", "seed", "settings"]
    assert "m by ga, length=0.5 comes to the end of none of 1 fabrics." in shown(folded("folds", [], told))


def test_paths_that_fail_on_some_fabrics_come_behind():
    def line(fabric: str, model: str, error: float | None) -> dict[str, Any]:
        status = "diverged" if error is None else "ok"
        return {"fabric": fabric, "way": "computed", "model": model, "settings": "", "landing_error": error,
                "status": status}  # fmt: skip

    found = [
        line("denim", "bad", 0.1),
        line("twill", "bad", None),
        line("denim", "good", 0.2),
        line("twill", "no", None),
    ]
    said = shown(led("paths", [*found, line("twill", "good", 0.2)]))
    assert (
        "computed path, good: lands 0.2 mm beside, median of 2 of 2 fabrics. computed path, bad: lands 0.1 mm" in said
    )
    assert "beside, median of 1 of 2 fabrics. computed path, no: lands in 0 of 1 fabric." in said


def test_of_speed_the_answer_names_the_quickest_and_the_peers():
    def timed(model: str, pace: float, **more: Any) -> dict[str, Any]:
        known = {"kind": "explicit", "nodes": 441, "threads": 1, "batch": 64, "realtime_factor": 2.0, "peer": None,
                 "ratio": None, "error_m": None}  # fmt: skip
        return {**known, "model": model, "node_steps_per_s": pace, **more}

    rows = [
        timed("a", 5e6, peer="mujoco", ratio=2.0), timed("b", 9e6, kind="implicit", peer="mujoco", ratio=4.0),
        timed("mujoco", 99e6), timed("c", 50e6, nodes=81), timed("a", 5e6, error_m=1e-3, realtime_factor=7.0),
    ]  # fmt: skip
    said = shown(paced(rows))
    assert "The quickest steps are b 's: 9.0 million node-steps/s on 441 nodes." in said
    assert "a is the quickest, 7 times real time" in said
    assert "Beside mujoco 2 × … 4 × per core, over 2 measurements" in said
    assert paced([]) == ""


def test_a_model_that_is_called_as_a_peer_is_a_model():
    """`mujoco` is the name of both."""

    def timed(model: str, pace: float, **more: Any) -> dict[str, Any]:
        known = dict.fromkeys(("precision", "options", "version", "step_s", "error_m", "peer", "ratio"))
        known |= {
            "kind": "explicit",
            "nodes": 441,
            "threads": 1,
            "batch": 64,
            "realtime_factor": 2.0,
            "note": "own step",
        }
        return {**known, "model": model, "node_steps_per_s": pace, **more}

    peer = timed("mujoco", 1e6, note="MuJoCo's membrane")
    rows = [
        peer, timed("a", 3e6, peer="mujoco", ratio=3.0), timed("mujoco", 0.4e6, peer="mujoco", ratio=0.4),
        timed("a", 3e6, peer="mujoco", ratio=60.0, error_m=1e-3, realtime_factor=50.0),
    ]  # fmt: skip
    said = shown(paced(rows))
    assert "Beside mujoco 0.4 × … 3 × per core, over 2 measurements" in said
    assert "Beside mujoco, at equal error 60 × per core, over 1 measurement" in said
    steps = [line[:2] for line in _lines(rows[:3], ["mujoco"])]
    assert steps == [["mujoco", "explicit, step 0.2 ms"], ["a", "explicit, own step"], ["mujoco", "explicit, own step"]]
    assert paced([peer]) == ""  # beside it no model was measured
