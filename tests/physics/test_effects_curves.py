"""Effects on force-extension curves, each against its formula, and the frame that puts them together."""

from __future__ import annotations

import numpy as np
import pytest

from clothbench import ClothbenchError
from clothbench.modelling.bound_effects import BoundEffects
from clothbench.modelling.curves import acts_on_curves, acts_on_sheets, curve_of
from clothbench.plugins.discovery import catalogue

STRETCH = np.linspace(1.0, 1.5, 51)
STRAIN = STRETCH - 1
CURVE_ONLY = ("strain_locking", "limited_extension", "start_friction", "clamp_slack", "clamp_slip", "load_offset")


def force(width: float, *values: float, stretch: np.ndarray = STRETCH, effect: str) -> np.ndarray:
    """What `linear_stretch` with 40 N/m and one effect at these values gives."""
    made = catalogue()
    simulation = curve_of(made.make("models", "linear_stretch"), [made.make("effects", effect)], stretch, width)
    return simulation.run(np.array([[40.0, *values]])).force[0]


@pytest.mark.parametrize("name", CURVE_ONLY)
def test_effects_of_curves_are_refused_by_a_sheet_in_one_line(name):
    effect = catalogue().make("effects", name)
    assert acts_on_curves(effect)
    assert not acts_on_sheets(effect)
    with pytest.raises(ClothbenchError, match=f"effect '{name}' acts on force-extension curves only"):
        BoundEffects(catalogue().make("models", "mass_spring").parameters, (effect,))


def test_effects_of_sheets_are_refused_by_a_curve_and_sheets_by_name():
    made = catalogue()
    model, drag = made.make("models", "linear_stretch"), made.make("effects", "quadratic_drag")
    with pytest.raises(ClothbenchError, match="effect 'quadratic_drag' does not act on force-extension curves"):
        curve_of(model, [drag], STRETCH)
    with pytest.raises(ClothbenchError, match="'mass_spring' answers no force-extension curves"):
        curve_of(made.make("models", "mass_spring"), [], STRETCH)
    both = made.make("effects", "stretch_stiffening")
    assert acts_on_curves(both)
    assert acts_on_sheets(both)


def test_strain_locking_is_its_formula_without_slope_at_the_start():
    found = force(1.0, 8.0, 0.4, effect="strain_locking") - 40 * STRAIN
    np.testing.assert_allclose(found, 0.4 * (np.exp(8 * STRAIN) - 1 - 8 * STRAIN), atol=1e-12)
    assert abs(found[1] - found[0]) < 1e-2  # neither force nor slope at the start


def test_limited_extension_has_a_pole_that_is_cut_off():
    found = force(1.0, 1 / 0.6, 10.0, effect="limited_extension") - 40 * STRAIN
    x = STRAIN / 0.6
    np.testing.assert_allclose(found, 10 * (1 / (1 - x) - 1 - x), atol=1e-12)
    beyond = force(1.0, 1 / 0.6, 10.0, stretch=np.linspace(1.55, 1.7, 7), effect="limited_extension")
    assert np.isfinite(beyond).all()
    assert (np.diff(beyond) > 0).all()


def test_stretch_stiffening_of_a_curve_is_that_of_a_pulled_sheet():
    found = force(1.0, 500.0, effect="stretch_stiffening") - 40 * STRAIN
    law = np.where(STRAIN < 0.1, 500 * STRAIN**2, 500 * (2 * STRAIN - 0.1) * 0.1)
    np.testing.assert_allclose(found, law, atol=1e-12)


def test_start_friction_is_soon_there_and_stays():
    found = force(1.0, 2.0, 0.02, effect="start_friction") - 40 * STRAIN
    np.testing.assert_allclose(found, 2 * (1 - np.exp(-STRAIN / 0.02)), atol=1e-12)


def test_slack_moves_the_zero_and_a_slack_sample_does_not_push():
    found = force(1.0, 0.1, effect="clamp_slack")
    np.testing.assert_allclose(found, 40 * np.maximum(STRETCH / 1.1 - 1, 0), atol=1e-12)
    assert found[0] == 0.0


def test_slip_takes_a_share_of_the_way_beyond_its_onset():
    found = force(1.0, 0.5, 1.2, effect="clamp_slip")
    np.testing.assert_allclose(found, 40 * (STRAIN - 0.5 * np.maximum(STRETCH - 1.2, 0)), atol=1e-12)


def test_slack_and_slip_do_not_care_in_which_order_they_are_named():
    """Slack is pulled first, and slips then by the cloth's own stretch."""
    made, theta = catalogue(), {"clamp_slack": [0.1], "clamp_slip": [0.5, 1.2]}
    model, found = made.make("models", "linear_stretch"), []
    for names in (("clamp_slack", "clamp_slip"), ("clamp_slip", "clamp_slack")):
        curve = curve_of(model, [made.make("effects", name) for name in names], STRETCH, 1.0)
        found.append(curve.run(np.array([[40.0, *theta[names[0]], *theta[names[1]]]])).force[0])
    np.testing.assert_array_equal(*found)
    own = STRETCH / 1.1
    np.testing.assert_allclose(found[0], 40 * np.maximum(own - 0.5 * np.maximum(own - 1.2, 0) - 1, 0), atol=1e-12)


def test_a_load_cell_is_off_in_newtons_whatever_the_width():
    found = force(0.05, 0.3, effect="load_offset")
    np.testing.assert_allclose(found, 0.05 * 40 * STRAIN + 0.3, atol=1e-12)


def test_without_a_width_parameters_are_the_whole_samples_in_newtons():
    made = catalogue()
    model, effects = made.make("models", "linear_stretch"), [made.make("effects", "strain_locking")]
    known, unknown = curve_of(model, effects, STRETCH, 0.2), curve_of(model, effects, STRETCH)
    assert [p.unit for p in known.parameters] == ["N/m", "1", "N/m"]
    assert [p.unit for p in unknown.parameters] == ["N", "1", "N"]
    theta = known.parameters.defaults[None]
    np.testing.assert_allclose(known.run(theta).force, 0.2 * unknown.run(theta).force)
