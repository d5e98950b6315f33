"""What the tests of effects share: the models they run through, and hanging, falling and clamped sheets."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.optimize import curve_fit

from clothbench import ClothbenchError, Material, Scene
from clothbench.core.optional import absent
from clothbench.core.protocols import Effect, Model
from clothbench.plugins.discovery import OWN, catalogue

G = 9.81
STRETCH, BENDING = 30.0, 1e-7  # N/m and N·m of the soft, limp strip
STIFF = 1000.0  # N/m of a sheet that hardly stretches


def dynamic_models() -> list[Any]:
    """Every built-in model that moves and takes effects; one that cannot be loaded fails its own tests, one whose
    library is not installed is skipped with that reason.
    """
    found, names = catalogue(), []
    for plugin in found.plugins:
        if plugin.kind == "models" and plugin.distribution == OWN:
            with contextlib.suppress(ClothbenchError):
                model = found.load("models", plugin.name)
                if {"dynamic", "effects"} <= set(model.capabilities):
                    reason = absent(model)
                    marks = [pytest.mark.skip(reason=reason)] if reason else []
                    names.append(pytest.param(plugin.name, marks=marks))
    return names


on_every_model = pytest.mark.parametrize("name", dynamic_models())


def effect_named(name: str) -> Effect:
    return catalogue().make("effects", name)


def cloth(name: str, scene: Scene, stretch: float) -> tuple[np.ndarray, float, float]:
    """Parameters of a limp cloth (P,), its stiffness along warp or weft, C₁₁ = C₂₂, and across, C₁₂ [N/m].

    A test that looks at stretch asks for less than STIFF; a model that does not stretch is left out of it.
    """
    model = catalogue().make("models", name)
    if name == "mass_spring":  # springs along, across and on both diagonals: C₁₁ = 2 k₁, C₁₂ = k₁
        return np.array([stretch / 1.5, 0.01, 0.001]), stretch / 0.75, stretch / 1.5
    if not hasattr(model, "of_material"):
        pytest.skip(f"{name} has no `of_material`: its stiffness is not known here")
    theta, twice = (_textbook(model, scene, stretch), _textbook(model, scene, 2 * stretch))
    if stretch < STIFF and np.array_equal(theta, twice):
        pytest.skip(f"{name} does not stretch")
    if name == "mass_spring_verlet":  # C₁₂ is its diagonals', the shear; then E = C₁₁ − C₁₂²/C₁₁ gives C₁₁
        return theta, stretch * (1 + np.sqrt(2)) / 2, stretch / 2
    return theta, stretch, 0.0


def _textbook(model: Model, scene: Scene, stretch: float) -> np.ndarray:
    """Parameters (P,) for a stretch and a shear of half of it [N/m], limp: or with no bending if it has none."""
    for bending in (BENDING, 0.0):
        with contextlib.suppress(ClothbenchError):
            return model.of_material(Material(bending, stretch, stretch / 2), scene)  # type: ignore[attr-defined]
    pytest.skip(f"{model.name} cannot be a limp textbook material")


def run(name: str, scene: Scene, theta: np.ndarray, *pairs: tuple[str, Sequence[float]]) -> np.ndarray:
    """Positions (T, N, 3) m of one run with effects by name, each with its values."""
    model = catalogue().make("models", name)
    effects = [effect_named(effect) for effect, _ in pairs]
    columns = np.concatenate([theta, *(np.asarray(values, dtype=float) for _, values in pairs)])
    rollout = model.prepare(scene, effects).run(columns[None])
    assert rollout.status == ("ok",)
    return rollout.position[0]


def hanging(
    width: float,
    length: float,
    times: np.ndarray,
    points: Sequence[Sequence[float]],
    shape: tuple[int, int],
    *,
    moved: Callable[[np.ndarray], np.ndarray] | None = None,
    density: float = 0.2,
) -> Scene:
    """A sheet in the x–z plane held along its top edge, node by node; `moved(t) -> (K, 3)` shifts all grips."""
    held = np.stack([np.linspace(0.0, width, shape[0]), np.zeros(shape[0])], axis=1)
    clock = np.linspace(0.0, times[-1], 400)
    at = np.stack([held[:, 0], 0 * held[:, 0], 0 * held[:, 0]], axis=1)
    path = at[None] + (moved(clock)[:, None] if moved else np.zeros((400, 1, 3)))
    return Scene(width, length, density, clock, held, path, times, np.array(points), resolution=shape)


def falling(times: np.ndarray, slope: float) -> Scene:
    """A free sheet of 0.2 m × 0.2 m and 0.1 kg/m², level or turned by `slope` rad about x, dropped from rest."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.2, 5)))
    start = np.stack([u, v * np.cos(slope), v * np.sin(slope)], axis=1)
    return Scene(0.2, 0.2, 0.1, times[[0, -1]], np.zeros((0, 2)), np.zeros((2, 0, 3)), times,
                 np.stack([u, v], axis=1), resolution=(5, 5), start=start)  # fmt: skip


def fall(name: str, times: np.ndarray, *pairs: tuple[str, Sequence[float]], slope: float = 0.0) -> np.ndarray:
    """Positions (T, 25, 3) m of a falling sheet that has no drag of its own."""
    scene = falling(times, slope)
    return run(name, scene, cloth(name, scene, STIFF)[0], *pairs)


def terminal_speed(name: str, *pairs: tuple[str, Sequence[float]]) -> float:
    """Of the level sheet of 0.1 kg/m² after three seconds [m/s]."""
    position = fall(name, np.array([0.0, 3.0, 3.5]), *pairs)
    speed = -(position[2, :, 2] - position[1, :, 2]) / 0.5
    assert np.ptp(speed) < 1e-3 * speed.mean()
    return float(speed.mean())


def swing_frequency(name: str, *pairs: tuple[str, Sequence[float]], length: float = 0.3) -> float:
    """Frequency [Hz] of the small free swing of a limp sheet held along its top edge and pulled once."""
    times = np.arange(0.8, 6.0, 0.02)

    def pull(t):  # slowly enough to leave the third mode and those above it alone
        return np.stack([0 * t, 1e-3 * np.exp(-(((t - 0.4) / 0.12) ** 2)), 0 * t], axis=1)

    scene = hanging(0.075, length, times, [(0.0375, length)], (4, 13), moved=pull)
    y = run(name, scene, cloth(name, scene, STIFF)[0], *pairs)[:, 0, 1]

    def modes(t, f, second, a, b, c, d, slow, quick):
        w = 2 * np.pi * f * t
        first = (a * np.sin(w) + b * np.cos(w)) * np.exp(-slow * t)
        return first + (c * np.sin(second * w) + d * np.cos(second * w)) * np.exp(-quick * t)

    guess = [1.0, 2.3, 0.5, 0.5, 0.1, 0.1, 0.01, 0.1]
    best, _ = curve_fit(modes, times - times[0], y / np.abs(y).max(), p0=guess, maxfev=20000)
    return float(best[0])
