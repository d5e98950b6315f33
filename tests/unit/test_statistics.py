"""The statistics that every part shares, against tables, other formulas and chance."""

import numpy as np
import pytest

from clothbench.core.statistics import (
    differences,
    jackknife_half_width,
    repeated,
    standing_out,
    t_interval,
    uncut_half,
)
from clothbench.engine.judgement import half


@pytest.mark.parametrize(("count", "critical"), [(5, 1.715), (10, 2.290), (20, 2.708)])
def test_what_stands_out_does_so_from_grubbs_tabled_values_on(count, critical):
    """5 % on both sides together: Grubbs and Beck 1972, Extension of sample sizes and percentage points, table I."""
    others = np.linspace(-1, 1, count - 1)
    outliers = np.linspace(0, 40, 40001)
    rows = np.column_stack([np.tile(others, (len(outliers), 1)), outliers])
    excess = (rows[:, -1] - rows.mean(axis=1)) / rows.std(axis=1, ddof=1)
    below, above = (rows[np.argmax(excess > critical + step)] for step in (-0.002, 0.002))
    assert not standing_out(below).any()
    assert np.flatnonzero(standing_out(above)).tolist() == [count - 1]
    assert np.flatnonzero(standing_out(-above)).tolist() == [count - 1]


def test_by_chance_one_in_twenty_samples_has_something_that_stands_out():
    samples = np.random.default_rng(3).normal(size=(4000, 8))
    share = np.mean([standing_out(sample).any() for sample in samples])
    assert 0.04 < share < 0.06


@pytest.mark.parametrize("values", [[], [1.0], [1.0, 5.0], [2.0, 2.0, 2.0, 2.0]])
def test_nothing_stands_out_of_too_few_or_equal_values(values):
    assert standing_out(np.array(values)).tolist() == [False] * len(values)


def test_the_jackknife_of_a_mean_is_student_s_interval():
    values = np.random.default_rng(5).normal(3.0, 2.0, 9)
    without = np.array([np.delete(values, k).mean() for k in range(9)])
    low, high = t_interval(values)
    assert jackknife_half_width((without - values.mean())[:, None])[0] == pytest.approx((high - low) / 2)


def test_half_of_an_interval_that_is_cut_at_0_is_its_longer_side():
    assert uncut_half(1.0, 0.0, 3.0) == 2.0
    assert uncut_half(5.0, 3.0, 7.0) == 2.0
    assert half({"value": 1.0, "low": 0.0, "high": 3.0}) == 2.0
    assert half({"value": 1.0, "low": None, "high": None}) == 0.0


def test_values_that_no_search_came_to_are_told_by_being_the_same_to_the_last_digits():
    values = np.array([2.0, 3.0, 3.0 * (1 + 1e-14), 2.5, 4.0])
    assert repeated(values, 2.0 * (1 - 1e-14)).tolist() == [True, True, True, False, False]
    assert not repeated(np.array([1.0, 1.0 + 1e-6]), 0.0).any()
    assert repeated(np.zeros(0), 1.0).tolist() == []


@pytest.mark.parametrize("order", [3, 4, 5, 6, 7])
def test_differences_have_the_noise_of_one_sample_and_nothing_of_a_polynomial(order):
    random = np.random.default_rng(order)
    at = np.sort(np.arange(4000) / 30 + random.uniform(-0.2, 0.2, 4000) / 30)
    assert differences(at, random.normal(size=4000), order).std() == pytest.approx(1, rel=0.05)
    near = at[:40] - at[20]
    assert differences(near, near ** (order - 1), order) == pytest.approx(0, abs=1e-9)
    assert len(differences(at[:order], at[:order], order)) == 0
