"""The floor that repeated motions set: how far cloth that is moved alike differs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.observation import Observation
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence

MATERIAL = np.array([[0.0, 0.1], [0.0, 0.5], [0.0, 0.9]])
SIGMA = 2e-3


def swung(name: str, hertz: float, late: float, first: float = 0.0, sway: float = 0.0, clock: float = 0.0) -> SheetCase:
    """A grip that starts to swing after `late` seconds; frames from `first` s on, at 25 Hz. sway: m, of the nodes;
    clock: s, at which the recording begins.
    """
    grip_time = np.arange(0, 8, 0.01)
    path = 0.1 * np.sin(2 * np.pi * hertz * np.maximum(grip_time - late, 0.0))
    grips = np.stack([path, 0 * path, 0 * path], axis=-1)[:, None]
    time = np.arange(first, 7.5, 0.04)
    position = np.zeros((len(time), 3, 3)) + sway * np.sin(5 * time)[:, None, None]
    observation = Observation(clock + time, position, np.ones((len(time), 3), bool), 1e-4, MATERIAL)
    recording = SimpleNamespace(grip_time=clock + grip_time, grip_position=grips, grip_material=np.zeros((1, 2)))
    return SheetCase(name, "fit", recording, observation, None)


def spread(*cases: SheetCase, late=(0.0, 0.0, 0.0), seed: int = 5) -> float:
    """Of noise on top of a model's error of 10 mm, which follows the motion."""
    random = np.random.default_rng(seed)
    residual = []
    for case, shift in zip(cases, late, strict=False):
        time = case.observation.time - shift
        error = 0.01 * np.sin(2 * np.pi * 0.8 * time)[:, None, None]
        residual.append((error + random.normal(0, SIGMA, (len(time), 3, 3))).ravel())
    return SheetEvidence(cases).repeat_spread(residual)


@pytest.mark.parametrize("first", [0.0, 0.038, 0.043])
def test_repeats_show_the_noise_below_the_error_that_they_share(first):
    one, other = swung("one", 0.8, 0.3), swung("other", 0.8, 0.7, 0.4 + first)
    assert spread(one, other, late=(0.0, 0.4)) == pytest.approx(SIGMA, rel=0.1)


def test_a_repeat_may_begin_at_another_time_of_the_clock():
    one, other = swung("one", 0.8, 0.3), swung("other", 0.8, 0.7, 0.4, clock=5.3)
    assert spread(one, other, late=(0.0, 5.7)) == pytest.approx(SIGMA, rel=0.1)


def test_noise_is_told_from_frames_that_fall_beside_each_other():
    """Between two frames, most of it of one, there is less noise than in either."""
    one, other = swung("one", 0.8, 0.3), swung("other", 0.8, 0.7, 0.4 + 0.0435)
    squares = [spread(one, other, late=(0.0, 0.4), seed=seed) ** 2 for seed in range(30)]
    assert np.mean(squares) == pytest.approx(SIGMA**2, rel=0.03)


@pytest.mark.parametrize(("moved", "found"), [(0.0, SIGMA), (0.02, 0.0)])
def test_in_grips_that_stand_still_a_repeat_is_a_sheet_that_does(moved, found):
    """Begun at the same time, not at the longest delay that is looked at; what was let go swings as it was let go."""
    assert spread(*(swung(name, 0.0, 0.0, sway=moved) for name in ("one", "other"))) == pytest.approx(found, rel=0.1)


def test_other_motions_are_no_repeats():
    assert spread(swung("one", 0.8, 0.3), swung("slower", 0.6, 0.3), swung("far later", 0.8, 4.0)) == 0.0
