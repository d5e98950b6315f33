"""The regression gate: what counts as worse, and what is only noise."""

import pytest

from clothbench.report.gate import IDENTITY, compare_rows


def row(value, half=1.0, status="ok", **changes):
    about = dict.fromkeys(IDENTITY, "x")
    low, high = (value - half, value + half) if value is not None else (None, None)
    return {**about, "value": value, "low": low, "high": high, "unit": "mm", "status": status, "reason": "", **changes}


@pytest.mark.parametrize(
    ("base", "new", "side"),
    [
        (row(10.0), row(10.5), None),
        (row(10.0), row(11.8), None),  # within √2 half-widths and 5 %
        (row(10.0), row(12.0), "worse"),
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


def test_nothing_to_compare_is_no_pass():
    assert not compare_rows([], [row(1.0)])["passed"]


def test_of_several_results_the_one_with_the_same_key_counts():
    base = [row(10.0, key="a"), row(5.0, key="b")]
    verdict = compare_rows(base, base)
    assert verdict["passed"]
    assert verdict["missing"] == []
    assert compare_rows([row(5.0, key="b")], base)["passed"]
