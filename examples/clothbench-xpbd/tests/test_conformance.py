"""Model and effect keep every rule of the conformance kit, and do what their own texts say."""

import numpy as np
import pytest
from clothbench.modelling.sheet import bear_inertia
from clothbench.plugins.discovery import catalogue
from clothbench.testing import check_plugin, rule_names, scenes
from clothbench.testing.effect_case import waving_sheet

from clothbench_xpbd.hem import Hem
from clothbench_xpbd.sheet import Xpbd


@pytest.mark.parametrize("rule", rule_names("models"))
def test_the_model_keeps_every_rule(rule):
    check_plugin("models", "xpbd", only=[rule])


@pytest.mark.parametrize("rule", rule_names("effects"))
def test_the_effect_keeps_every_rule(rule):
    check_plugin("effects", "hem", only=[rule])


@pytest.mark.parametrize("rule", ["vanishes at its null values", "acts elsewhere"])
def test_the_effect_works_on_its_own_model(rule):
    check_plugin("effects", "hem", only=[rule], models=[catalogue().load("models", "xpbd")])


def test_it_comes_to_hang_as_explicit_springs_do():
    """Same springs, so with smaller steps it goes where `mass_spring` is; it shares no code with it."""
    scene, theta = scenes.hanging(), np.array([[30.0, 0.5, 0.01]])
    explicit = catalogue().make("models", "mass_spring").prepare(scene).run(theta).position
    apart = [np.abs(Xpbd(dt=dt).prepare(scene).run(theta).position - explicit).max() for dt in (1e-3, 2.5e-4)]
    assert apart[1] < 2.5e-3
    assert apart[1] < 0.3 * apart[0]


def test_the_hem_weighs_its_length():
    """The added weight is λ g times the border of a 0.2 m sheet."""
    sheet, x, v = waving_sheet()
    force = np.zeros((3, x.shape[1]))
    Hem.force(0.0, 1e-3, x, v, force, sheet, np.array([0.01]), np.zeros(0))
    assert force.sum(axis=1) == pytest.approx([0.0, 0.0, -0.01 * 0.8 * 9.81])


def test_a_hem_falls_as_fast_as_the_cloth():
    """Under gravity alone an added mass changes no acceleration, wherever it sits."""
    sheet, x, v = waving_sheet()
    force, extra = sheet.gravity[:, None] * sheet.mass, np.zeros((6, 25))
    Hem.force(0.0, 1e-3, x, v, force, sheet, np.array([0.01]), np.zeros(0))
    Hem.inertia(0.0, 1e-3, x, v, extra, sheet, np.array([0.01]), np.zeros(0))
    bear_inertia(force, sheet.mass, extra)
    assert force / sheet.mass == pytest.approx(np.tile(sheet.gravity[:, None], 25))
