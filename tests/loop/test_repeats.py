"""The floor that repeated motions set: how far cloth that is moved alike differs."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.observation import Observation
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence

MATERIAL = np.array([[0.0, 0.1], [0.0, 0.5], [0.0, 0.9]])
SIGMA = 2e-3


def swung(
    name: str,
    hertz: float,
    late: float,
    first: float = 0.0,
    sway: float = 0.0,
    clock: float = 0.0,
    swings: float = np.inf,
    settles: float = np.inf,
    blur: float = 0.0,
    sigma: float = 1e-4,
    reach: float = 0.1,
    stamps: float = 100.0,
) -> SheetCase:
    """A grip that starts to swing after `late` seconds, so many times; frames from `first` s on, at 25 Hz. sway: m, of
    the nodes, which come to rest in `settles` s; clock: s, at which the recording begins; blur: m, noise of the log of
    the grip; sigma: m, that the observation states; reach: m, of the grip; stamps: 1/s, of its log.
    """
    grip_time, random = np.arange(0, 8, 1 / stamps), np.random.default_rng(len(name))
    path = reach * np.sin(2 * np.pi * np.clip(hertz * (grip_time - late), 0.0, swings))
    grips = np.stack([path, 0 * path, 0 * path], axis=-1)[:, None] + blur * random.normal(size=(len(path), 1, 3))
    time = np.arange(first, 7.5, 0.04)
    position = np.zeros((len(time), 3, 3)) + (sway * np.sin(5 * time) * np.exp(-time / settles))[:, None, None]
    observation = Observation(clock + time, position, np.ones((len(time), 3), bool), sigma, MATERIAL)
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


@pytest.mark.parametrize("swings", [1.0, 2.0, 4.0])
def test_a_motion_that_ends_long_before_the_recording_is_a_motion(swings):
    """Its grip stands still for most of the time, and the sheet does not."""
    one, other = (swung(name, 0.8, late, sway=0.05, swings=swings) for name, late in (("one", 0.3), ("other", 0.7)))
    assert spread(one, other, late=(0.0, 0.4)) == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize("settles", [0.3, 0.6, 2.0])
def test_sheets_that_were_let_go_are_no_repeats_though_they_come_to_rest(settles):
    assert spread(*(swung(name, 0.0, 0.0, sway=sway, settles=settles) for name, sway in (("a", 0.1), ("b", -0.1)))) == 0


@pytest.mark.parametrize("blur", [1e-3, 3e-3])
def test_noise_of_the_grips_logs_hides_no_repeat(blur):
    one, other = swung("one", 0.8, 0.3, blur=blur), swung("other", 0.8, 0.7, 0.4, blur=blur)
    assert spread(one, other, late=(0.0, 0.4)) == pytest.approx(SIGMA, rel=0.15)
    still = [swung(name, 0.0, 0.0, blur=blur) for name in ("one", "other")]
    assert spread(*still) == pytest.approx(SIGMA, rel=0.1)
    assert spread(one, swung("slower", 0.6, 0.3, blur=blur), swung("far later", 0.8, 4.0, blur=blur)) == 0.0


@pytest.mark.parametrize(("stamps", "hertz", "blur"), [(100, 0.8, 3e-3), (10, 2.5, 0.0), (5, 1.5, 0.0), (8, 2.0, 0.0)])
def test_a_wider_swing_is_no_repeat_of_a_narrower_one_however_seldom_grips_are_logged(stamps, hertz, blur):
    """Fast motion had passed for noise of a log with few stamps, and what noise may hide for alike."""
    narrow, wide = (swung("a", hertz, 0.0, reach=r, stamps=stamps, blur=blur) for r in (0.10, 0.13))
    assert spread(narrow, wide) == 0.0


def test_a_sheet_at_rest_is_known_for_one_though_nobody_states_its_noise():
    cases = []
    for name in ("one", "other"):
        case = swung(name, 0.0, 0.0, sigma=np.nan)
        seen, random = case.observation, np.random.default_rng(len(name))
        position = seen.position + random.normal(0, SIGMA, seen.position.shape)
        cases.append(dataclasses.replace(case, observation=dataclasses.replace(seen, position=position)))
    assert spread(*cases) == pytest.approx(SIGMA, rel=0.1)


def test_grips_that_are_alike_only_while_they_stand_still_were_not_moved_alike():
    """One moves at the beginning, the other at the end: while both rest, the sheet of the first still swings."""
    first = swung("first", 2.0, 0.2, sway=0.05, settles=2.0, swings=1.0)
    last = swung("last", 2.0, 7.2, swings=1.0)
    assert spread(first, last) == spread(last, first) == 0.0
