"""Parameters: bounds, scales, and what is refused."""

import numpy as np
import pytest

from clothbench import ClothbenchError, Parameter, ParameterSpace

STIFFNESS = Parameter("k", "k", "N/m", (1.0, 100.0), "log", 10.0, "a stiffness", "nobody")
RATIO = Parameter("r", "r", "1", (-1.0, 3.0), "linear", 0.0, "a ratio", "nobody")
SPACE = ParameterSpace((STIFFNESS, RATIO))


def test_unit_cube_and_values_are_inverse():
    unit = np.random.default_rng(0).random((50, 2))
    np.testing.assert_allclose(SPACE.to_unit(SPACE.from_unit(unit)), unit, atol=1e-12)


def test_a_log_scale_has_its_geometric_mean_in_the_middle():
    np.testing.assert_allclose(SPACE.from_unit(np.array([0.5, 0.5])), [10.0, 1.0])


def test_points_outside_the_cube_land_on_its_face():
    np.testing.assert_allclose(SPACE.from_unit(np.array([[2.0, -1.0]])), [[100.0, -1.0]])


def test_at_bound():
    assert SPACE.at_bound(np.array([100.0, 0.5])).tolist() == [True, False]
    near, far = 100 ** (0.9 * 1e-3), 100 ** (1.1 * 1e-3)  # by so much of the scaled range
    assert SPACE.at_bound(np.array([[near, -0.9964], [100 / near, 2.9964]])).all()
    assert not SPACE.at_bound(np.array([[far, -0.9956], [100 / far, 2.9956]])).any()


def test_prefix_join_and_lookup():
    joined = SPACE.joined(ParameterSpace((RATIO,)).prefixed("drag"))
    assert joined.names == ("k", "r", "drag.r")
    assert joined["drag.r"].unit == "1"
    with pytest.raises(ClothbenchError, match="no parameter 'x'; there are: k, r"):
        SPACE["x"]


def test_bounded_moves_the_default_inside():
    space = SPACE.bounded({"k": (20.0, 50.0)})
    assert space["k"].default == 20.0
    assert space["r"] is not None


def test_bounds_of_a_log_scale_may_begin_at_0_not_below():
    assert SPACE.bounded({"k": (0.0, 50.0)})["k"].scale == "linear"
    with pytest.raises(ClothbenchError, match=r"bounds of 'k' are \[-1, 50\] N/m, expected 0 or above"):
        SPACE.bounded({"k": (-1.0, 50.0)})


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"unit": ""}, "no unit"),
        ({"scale": "cubic"}, "scale is 'cubic'"),
        ({"bounds": (3.0, 1.0)}, "expected finite and increasing"),
        ({"bounds": (0.0, 100.0)}, "log scale needs a lower bound above 0"),
        ({"default": 1000.0}, "outside its bounds"),
        ({"name": "two words"}, "identifier"),
    ],
)
def test_a_wrong_parameter_is_refused(change, found):
    with pytest.raises(ClothbenchError, match=found):
        Parameter(**{**STIFFNESS.__dict__, **change})


def test_names_twice_are_refused():
    with pytest.raises(ClothbenchError, match="named twice"):
        ParameterSpace((RATIO, RATIO))


@pytest.mark.parametrize("theta", [np.ones(3), np.ones((2, 2, 2)), [[np.nan, 1.0]]])
def test_wrong_parameter_sets_are_refused(theta):
    with pytest.raises(ClothbenchError, match="parameter sets"):
        SPACE.check(theta)
