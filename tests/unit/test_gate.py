"""The regression gate: what counts as worse, and what is only noise."""

import pytest

from clothbench.engine.rows import failure
from clothbench.report.gate import IDENTITY, compare_rows, markdown
from clothbench.studies.fold_path.cell import FoldPathCell, PathSettings


def row(value, half=1.0, status="ok", **changes):
    about = dict.fromkeys(IDENTITY, "x") | {"seed": 0}
    low, high = (value - half, value + half) if value is not None else (None, None)
    return {**about, "value": value, "low": low, "high": high, "unit": "mm", "status": status, "reason": "", **changes}


@pytest.mark.parametrize(
    ("base", "new", "side"),
    [
        (row(10.0), row(10.5), None),
        (row(10.0), row(10.75), None),  # within 5 % and a fifth of √2 half-widths
        (row(10.0), row(10.8), "worse"),
        (row(10.0), row(8.0), "better"),
        (row(10.0), row(None, status="diverged"), "worse"),
        (row(None, status="error"), row(5.0), "better"),
        (row(10.0, half=0.0, low=None, high=None), row(10.0 + 1e-9, half=0.0), None),
        (row(10.0, half=0.0), row(10.6, half=0.0), "worse"),
        (row(10.0), row(float("nan")), "worse"),
    ],
)
def test_judgement(base, new, side):
    verdict = compare_rows([base], [new])
    assert [s for s in ("worse", "better") if verdict[s]] == ([side] if side else [])
    assert verdict["passed"] == (side != "worse")


def test_a_missing_row_fails_and_a_new_one_does_not():
    assert not compare_rows([row(1.0), row(1.0, case="y")], [row(1.0)])["passed"]
    verdict = compare_rows([row(1.0)], [row(1.0), row(1.0, case="y")])
    assert verdict["passed"]
    assert verdict["added"] == 1


def test_a_wide_interval_of_what_got_worse_is_no_excuse():
    assert not compare_rows([row(5.0)], [row(500.0, half=2790.0)])["passed"]


def test_a_number_in_another_unit_is_worse_and_says_so():
    (change,) = compare_rows([row(5.0)], [row(0.006, half=0.001, unit="m")])["worse"]
    assert change["reason"] == "found a number in m, expected mm as in BASE"
    shown = markdown(compare_rows([row(5.0)], [row(0.006, half=0.001, unit="m")]))
    assert "`5 mm`" in shown
    assert "`0.006 m`" in shown


def two_cells(keys, values=(10.0, 50.0), recordings=("easy", "hard"), evaluations=(20, 20)):
    """Rows of two cells about the same mean, of other recordings or budgets."""
    cells = zip(keys, values, recordings, evaluations, strict=True)
    return [
        row(value, recording=one, key=key, evaluations=count)
        for key, value, recording, count in cells
        for one in (recording, None)
    ]


@pytest.mark.parametrize("order", [1, -1])
def test_every_cell_is_compared_with_its_own(order):
    old = two_cells("ab")
    for new in (two_cells("ab"), two_cells("yz")):  # of another version: whose recordings are the same
        assert compare_rows(old, new[::order]) == compare_rows(old, old)
    worse = compare_rows(old, two_cells("yz", values=(12.0, 50.0)))["worse"]
    assert [(r["recording"], r["new"]) for r in worse] == [("easy", 12.0), (None, 12.0)]


@pytest.mark.parametrize("order", [1, -1])
def test_of_cells_about_the_same_those_with_as_many_evaluations_are_compared(order):
    budgets = {"recordings": ("r", "r"), "evaluations": (20, 80)}
    old, new = two_cells("ab", **budgets), two_cells("yz", **budgets)[::order]
    assert compare_rows(old, new)["passed"]
    assert compare_rows(old, new)["compared"] == 4


def test_what_may_be_about_any_of_several_cells_is_compared_with_none():
    old = two_cells("ab", recordings=("r", "r"))
    verdict = compare_rows(old, two_cells("yz", recordings=("r", "r")))
    assert not verdict["passed"]
    assert verdict["compared"] == 0
    assert {r["reason"] for r in verdict["missing"]} == {
        "several cells are about this (2 of BASE, 2 of NEW), none with one key"
    }


def failed_and_well():
    """The row of a cell that failed as a whole, as a run writes it, and the rows of one that did well."""
    cell = FoldPathCell("paths", "chanel", "computed", "kirchhoff_love", PathSettings(), {})
    (failed,) = failure(cell, "error", "boom").tables["rows"]
    well = [
        {**failed, **row(1.0, recording=one, split=split, case=failed["case"]), "suite": "paths"}
        | {name: failed[name] for name in ("model", "effects", "optimizer", "metric", "seed")}
        for split in ("fit", "held_out")
        for one in (None, "r1")
    ]
    return failed, well


def test_how_a_search_ended_well_is_no_reason_why_a_row_is_worse():
    for status, why in (("ok", ""), ("timeout", "stopped after 9 s, as asked")):
        told = {"status": status, "reason": why or "budget spent"}
        (change,) = compare_rows([row(1.0)], [row(2.0, **told)])["worse"]
        assert change["reason"] == why


def test_a_cell_that_failed_as_a_whole_lost_each_of_its_rows():
    failed, well = failed_and_well()
    verdict = compare_rows(well, [failed])
    assert [(r["split"], r["recording"], r["status"], r["reason"]) for r in verdict["worse"]] == [
        (split, one, "error", "boom") for split in ("fit", "held_out") for one in (None, "r1")
    ]
    assert verdict["missing"] == []
    assert verdict["added"] == 0
    verdict = compare_rows([failed], well)
    assert verdict["passed"]
    assert [(r["split"], r["unit"]) for r in verdict["better"]] == [
        (s, "mm") for s in ("fit", "fit", "held_out", "held_out")
    ]
    verdict = compare_rows([failed, row(3.0)], [failed, row(3.0)])
    assert (verdict["passed"], verdict["compared"]) == (True, 1)


def test_a_failed_cell_lost_its_rows_of_other_metrics_too():
    failed, well = failed_and_well()
    others = [{**one, "metric": "folds", "unit": ""} for one in well]
    verdict = compare_rows([*well, *others], [failed])
    assert len(verdict["worse"]) == len(well) + len(others)
    assert not verdict["missing"]
    # Computed by another version it has another key: then only what was asked for is known to be the same.
    verdict = compare_rows([*well, *others], [{**failed, "key": "another"}])
    assert len(verdict["worse"]) == len(well)
    assert len(verdict["missing"]) == len(others)


def test_nothing_to_compare_is_no_pass():
    assert not compare_rows([], [row(1.0)])["passed"]
    failed, _ = failed_and_well()  # both sides lost all that they could have been compared by
    assert not compare_rows([failed], [failed])["passed"]


def test_of_several_results_the_one_with_the_same_key_counts():
    base = [row(10.0, key="a"), row(5.0, key="b")]
    verdict = compare_rows(base, base)
    assert verdict["passed"]
    assert verdict["missing"] == []
    assert compare_rows([row(5.0, key="b")], base)["passed"]


def test_markdown_for_a_pull_request_says_the_worst_first_and_holds_no_strangers_markup():
    strange = row(None, status="error", reason="fell | over\n[here](http://x) @all `code`")
    base = [row(10.0), row(10.0, case="y"), row(3.0, case="z")]
    lines = markdown(compare_rows(base, [row(8.0), {**strange, "case": "y"}])).splitlines()
    assert lines[0] == "**gate failed: 2 rows compared, 1 worse, 1 missing, 1 better, 0 only in NEW**"
    assert [line.split(" | ")[0] for line in lines[4:]] == ["| `missing`", "| `worse`", "| `better`"]
    assert lines[5].endswith("| `10 mm` | `error` | `fell \\| over [here](http://x) @all 'code'` |")
    many = compare_rows([row(1.0, case=str(k)) for k in range(9)], [])
    assert markdown(many, most=4).splitlines()[-1] == "and 5 more: `clothbench compare BASE NEW`"


def test_a_row_without_a_number_says_its_own_status():
    lines = markdown(compare_rows([row(None, status="diverged")], [row(5.0)])).splitlines()
    assert "| `diverged` | `5 mm` |" in lines[4]


def test_without_changes_markdown_is_one_line():
    assert markdown(compare_rows([row(1.0)], [row(1.0)])).splitlines() == [
        "**gate passed: 1 rows compared, 0 worse, 0 missing, 0 better, 0 only in NEW**"
    ]
