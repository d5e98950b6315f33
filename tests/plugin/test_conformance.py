"""Every built-in plugin keeps every rule of the kit; plugins made wrong on purpose break each of them."""

from __future__ import annotations

import ast
import dataclasses
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import wrong_models
import wrong_plugins
from clothbench_metrics.drape import Drape

import clothbench.testing
from clothbench import ClothbenchError
from clothbench.plugins.discovery import KINDS, OWN, catalogue
from clothbench.testing import (
    ConformanceError,
    check_effect,
    check_metric,
    check_model,
    check_optimizer,
    check_plugin,
    check_tracker,
    rule_names,
    scenes,
    weight,
)

BUILT_IN = [
    (plugin.kind, plugin.name, rule)
    for plugin in catalogue().plugins
    if plugin.kind in KINDS and plugin.distribution == OWN
    for rule in rule_names(plugin.kind)
]


@pytest.mark.parametrize(("kind", "name", "rule"), BUILT_IN, ids=["-".join(case) for case in BUILT_IN])
def test_built_in_plugins_keep_every_rule(kind, name, rule):
    (outcome,) = check_plugin(kind, name, only=[rule])
    assert outcome.rule == rule


def broken(check, make, rule):
    """The one line with which `check` refuses a plugin for breaking `rule`."""
    with pytest.raises(ConformanceError) as caught:
        check(make, only=[rule])
    line = str(caught.value)
    assert "\n" not in line
    assert f": {rule}: found " in line
    assert ", expected " in line
    return line


@pytest.mark.parametrize(("make", "rule", "found"), wrong_models.CASES, ids=wrong_models.IDS)
def test_a_wrong_model_is_found_out(make, rule, found):
    assert found in broken(check_model, make, rule)


@pytest.mark.parametrize(("make", "rule", "found"), wrong_plugins.EFFECTS, ids=lambda case: str(case)[:40])
def test_a_wrong_effect_is_found_out(make, rule, found):
    assert found in broken(check_effect, make, rule)


@pytest.mark.parametrize(("make", "rule", "found"), wrong_plugins.METRICS, ids=lambda case: str(case)[:40])
def test_a_wrong_metric_is_found_out(make, rule, found):
    assert found in broken(check_metric, make, rule)


@pytest.mark.parametrize(("make", "rule", "found"), wrong_plugins.OPTIMIZERS, ids=lambda case: str(case)[:40])
def test_a_wrong_optimizer_is_found_out(make, rule, found):
    assert found in broken(check_optimizer, make, rule)


@pytest.mark.parametrize(("make", "rule", "found"), wrong_plugins.TRACKERS, ids=lambda case: str(case)[:40])
def test_a_wrong_tracker_is_found_out(make, rule, found):
    assert found in broken(check_tracker, make, rule)


def test_every_rule_can_be_broken():
    cases = {
        "models": wrong_models.CASES,
        "effects": wrong_plugins.EFFECTS,
        "metrics": wrong_plugins.METRICS,
        "optimizers": wrong_plugins.OPTIMIZERS,
        "trackers": wrong_plugins.TRACKERS,
    }
    for kind, wrong in cases.items():
        assert {rule for _, rule, _ in wrong} == set(rule_names(kind)), kind


@pytest.mark.parametrize(
    ("check", "make"),
    [
        (check_metric, wrong_plugins.HonestMetric),
        (check_metric, wrong_plugins.Tracing),
        (check_metric, wrong_plugins.Smoothed),
        (check_metric, wrong_plugins.Speeds),
        (check_optimizer, wrong_plugins.HonestOptimizer),
        (check_tracker, wrong_plugins.HonestTracker),
        (check_effect, wrong_plugins.HonestEffect),
    ],
)
def test_the_honest_plugin_behind_the_wrong_ones_passes(check, make):
    check(make)


def test_a_static_model_is_only_asked_what_it_can_answer():
    outcomes = check_model(wrong_models.Static, scenes={"hanging": scenes.hanging()})
    skipped = {outcome.rule for outcome in outcomes if outcome.skipped}
    assert {"lets effects act", "converges with smaller steps"} <= skipped
    assert "follows the grips" not in skipped


def test_a_model_may_refine_its_steps_by_a_method():
    (outcome,) = check_model(wrong_models.Refinable, only=["converges with smaller steps"])
    assert not outcome.skipped


@pytest.mark.parametrize(
    "rule", ["moves along with the room", "turns along with gravity", "is pulled down", "follows the grips"]
)
def test_a_sound_model_keeps_its_rules_in_scenes_with_a_table_and_with_a_start_in_motion(rule):
    """The room moves with all that stands in it, and what was thrown does not fall as what was let go."""
    fall = scenes.free_fall()
    velocity = np.broadcast_to([0.6, -0.4, 1.2], fall.start.shape)
    of_its_own = {"thrown": dataclasses.replace(fall, velocity=velocity), "carried": scenes.carried()}
    check_model(wrong_models.Faulty, scenes=of_its_own, only=[rule])


@pytest.mark.parametrize(
    ("unit", "holds"),
    [("N·m·s", (1, -1)), ("kg/(m²·s)", (1, -1)), ("m^-4 s^2", (0, 2)), ("s²/m²", (0, 2)), ("N s / m", (1, -1)),
     ("m/N", (-1, 2)), ("1/(N·s)", (-1, 1)), ("mN/mm", (1, -2)), ("g/m**2", (1, 0)), ("1", (0, 0)), ("%", (0, 0)),
     ("1/s", (0, -1)), ("GPa", (1, -2)), ("solver units", None), ("px", None), ("10^-6 N", None)],
)  # fmt: skip
def test_what_a_unit_holds_of_kilogram_and_second(unit, holds):
    assert weight.holds(unit) == holds


def test_a_rule_that_does_not_apply_says_why():
    (outcome,) = check_effect(wrong_plugins.HonestEffect, only=["keeps to its own memory"])
    assert outcome.skipped == "has no kernel"


def test_an_optimizer_that_never_ends_is_told_and_not_waited_for():
    class Endless(wrong_plugins.HonestOptimizer):
        done = property(lambda self: False, lambda self, value: None)

        def ask(self):
            return self.space.defaults[None]

    assert "at most the budget of 150" in broken(check_optimizer, Endless, "keeps what it offers")


def test_a_metric_of_two_kinds_is_checked_on_both():
    class Both(Drape):
        kinds = frozenset({"silhouette", "nodes"})

    assert len(check_metric(Drape)) == len(rule_names("metrics"))
    assert "on a waving sheet" in broken(check_metric, Both, "gives whole scores")


def test_what_compared_nothing_is_not_kept():
    """Points of which none is held, and a model of which no run comes to its end."""
    hanging = scenes.hanging()
    free = dataclasses.replace(hanging, points=hanging.points[:5], start=hanging.start[:5])
    (outcome,) = check_model(wrong_models.Static, scenes={"free": free}, only=["follows the grips"])
    assert outcome.skipped == "no point that is looked at is held in free"

    class Lost(wrong_models.Static):
        def prepare(self, scene, effects=()):
            simulation = super().prepare(scene, effects)

            def run(theta):
                return dataclasses.replace(simulation.run(theta), status=("diverged",) * len(theta))

            return SimpleNamespace(parameters=simulation.parameters, run=run)

    for rule in ("follows the grips", "rests when held still"):
        found = broken(lambda make, **more: check_model(make, scenes={"hanging": hanging}, **more), Lost, rule)
        assert "no run that came to its end in hanging" in found


def test_a_plugin_that_cannot_be_made_is_told_in_one_line():
    def make():
        raise ValueError("no such file")

    with pytest.raises(ConformanceError, match="model make: making it: found ValueError: no such file"):
        check_model(make)


def test_unknown_kinds_and_rules_are_refused():
    with pytest.raises(ClothbenchError, match="no kind of plugin 'mops'; there are: models"):
        check_plugin("mops", "wet")
    with pytest.raises(ClothbenchError, match="no conformance rule 'shines'; there are: has all members"):
        check_metric(wrong_plugins.HonestMetric, only=["shines"])


def test_raw_data_given_by_the_author_is_not_passed_over(tmp_path):
    with pytest.raises(ConformanceError, match="found ClothbenchError: tracks recordings only"):
        check_tracker(wrong_plugins.HonestTracker, source=tmp_path)


def test_the_kit_names_no_built_in_plugin():
    names = {p.name for p in catalogue().plugins if p.distribution == OWN and p.kind in KINDS}
    for path in Path(clothbench.testing.__file__).parent.glob("*.py"):
        texts = {n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)}
        assert not (names & {t for t in texts if isinstance(t, str)}) - {"fold", "profile", "silhouette"}, (
            path
        )  # other things, too


def test_importing_the_kit_costs_nothing():
    code = "import sys, clothbench.testing; sys.exit('numpy' in sys.modules or 'numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_toy_fits_have_their_bottom_where_they_say():
    from clothbench.testing.toys import bowl, valley

    for problem, bottom in ((bowl(3), [0.62, 0.31, 0.73]), (valley(3), [0.75, 0.75, 0.75])):
        theta = problem.space.from_unit(np.array([bottom]))
        assert problem.evaluate(theta).value[0] == pytest.approx(0.0, abs=1e-9)
