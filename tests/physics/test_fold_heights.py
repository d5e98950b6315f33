"""The story of the ten fold heights: its elastica with thickness, and its statistics on heights of known make."""

from __future__ import annotations

import fold_heights
import numpy as np
import pytest

from clothbench.reference.mechanics import fold_coefficients


def test_without_thickness_it_is_the_elasticas_fold():
    assert fold_heights.thick_fold(0.0) == pytest.approx(fold_coefficients()[0], rel=1e-5)


def test_thick_cloth_stands_higher_and_not_by_less_than_one_layer():
    thin, thick = fold_heights.thick_fold(0.01), fold_heights.thick_fold(0.1)
    assert thin - fold_heights.thick_fold(0.0) > 0.01
    assert thick - fold_heights.thick_fold(0.0) > 0.1


def test_the_tables_relation_is_no_balance_of_weight_and_bending_alone():
    exponent, low, high = fold_heights.exponent(2000)
    assert low < exponent < high
    assert low > 3.1  # a strip with one length in it has 3


def test_an_offset_and_a_scale_that_were_put_in_are_found(monkeypatch):
    heights = 0.002 + 0.9 * fold_heights.elastica(fold_heights.ETAS)
    monkeypatch.setattr(fold_heights, "HEIGHTS", heights)
    found = fold_heights.fitted("offset and scale", heights, fold_heights.elastica(fold_heights.ETAS))
    np.testing.assert_allclose(found, [0.002, -0.1], atol=1e-9)
    assert fold_heights.score("offset and scale").left_out == pytest.approx(0.0, abs=1e-9)
    assert fold_heights.score("scale").left_out > 1e-4


def test_thickness_alone_explains_nothing_of_the_table():
    thickness, left = fold_heights.thickness_alone((0.0, 3e-4))
    assert thickness == 0.0
    assert left == pytest.approx(fold_heights.score("nothing").fitted, rel=1e-4)
