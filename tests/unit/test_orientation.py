"""Steerable filters: the angle of gratings, the appendix's sums against brute force, and where folds are marked."""

import numpy as np
import pytest

from clothbench.vision.orientation import SPACING, TAPS, angle_map, energy_direction, fold_mask, responses, turned


def grating(direction, wavelength=6.3, size=64):
    """Stripes whose grey changes along `direction` rad (x to the right, y down)."""
    y, x = np.mgrid[0:size, 0:size]
    return 0.5 + 0.4 * np.cos(2 * np.pi / wavelength * (x * np.cos(direction) + y * np.sin(direction)))


@pytest.mark.parametrize("degrees", [-80, -45, -10, 0, 20, 45, 70, 90])
@pytest.mark.parametrize("wavelength", [5.0, 6.3, 8.0])
def test_a_grating_has_the_angle_it_was_drawn_with(degrees, wavelength):
    angle = angle_map(grating(np.radians(degrees), wavelength), blur=2.0)
    away = turned(angle[16:-16, 16:-16] - np.float32(np.radians(degrees)))
    assert np.abs(away).max() < np.radians(1.5)


def test_the_sums_of_the_appendix_are_the_energy_s_second_harmonic():
    """Steer both filters to many angles, square, add: its Fourier coefficients at 2θ are C2 and C3."""
    image = np.random.default_rng(4).normal(size=(40, 40))
    r = responses(image).astype(np.float64)
    theta = np.linspace(0, np.pi, 64, endpoint=False)[:, None, None]
    c, s = np.cos(theta), np.sin(theta)
    second = c**2 * r[0] + 2 * c * s * r[1] + s**2 * r[2]
    third = c**3 * r[3] + 3 * c**2 * s * r[4] + 3 * c * s**2 * r[5] + s**3 * r[6]
    energy = second**2 + third**2
    cosine, sine = np.empty((40, 40)), np.empty((40, 40))
    energy_direction(r, cosine, sine)
    for found, wave in ((cosine, np.cos), (sine, np.sin)):
        expected = 2 * (energy * wave(2 * theta)).mean(axis=0)
        np.testing.assert_allclose(found, expected, atol=2e-6 * energy.max())  # the paper rounds H2's shape


def test_differences_are_the_same_modulo_pi():
    assert turned(np.array([np.pi - 0.1, -np.pi + 0.1, 0.3])) == pytest.approx([-0.1, 0.1, 0.3])


def test_folds_are_marked_where_the_angle_changes_and_not_at_the_hem():
    y, x = np.mgrid[0:96, 0:96]
    bent = y + 6 * np.sin(2 * np.pi * x / 48)  # two folds side by side, turning points every 24 px
    silhouette = np.zeros((96, 96), bool)
    silhouette[10:86, 6:90] = True
    angle = angle_map(np.where(silhouette, 0.5 + 0.4 * np.cos(2 * np.pi * bent / 6.3), 0.0), 1.5)
    fold = fold_mask(angle, silhouette, 0.04)
    row = fold[40:50].mean(axis=0)
    assert row[[12, 36, 60]].min() > 0.9  # crests and troughs: the slope of the stripes changes sign
    assert row[[24, 48, 72]].max() < 0.1  # between them it is steepest and changes least
    assert not fold[:10].any()
    assert not fold[:, : 6 + TAPS // 2].any()
    flat = angle_map(grating(np.pi / 2, size=96), 1.5)
    assert not fold_mask(flat, silhouette, 0.04).any()


def test_the_filters_answer_best_to_the_stripes_they_are_meant_for():
    """|FT| of G2 peaks at 2 rad per unit of its argument: π/SPACING px from stripe to stripe."""
    best = np.pi / SPACING
    waves = (0.6 * best, best, 1.8 * best)
    strength = {w: np.abs(responses(grating(np.pi / 2, w))[2, 20:-20, 20:-20]).max() for w in waves}
    assert max(strength, key=strength.get) == best
