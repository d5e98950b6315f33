"""What the tests of `baraff_witkin` and `inextensible` share: free strips that vibrate and sheets that swing, how fast
they go and how fast they come to rest."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from clothbench import Scene
from clothbench.core.protocols import Model
from clothbench.plugins.discovery import catalogue
from clothbench.studies.mechanics.scenes import LENGTH, first_mode, swinging
from clothbench.studies.mechanics.trials import Trial

G, DENSITY = 9.81, 0.2


def lattice(width: float, height: float, shape: tuple[int, int]) -> np.ndarray:
    """The nodes of an even grid, (n, 2) m, row by row."""
    u, v = np.meshgrid(np.linspace(0, width, shape[0]), np.linspace(0, height, shape[1]))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def simulate(model: Model, scene: Scene, *theta) -> np.ndarray:
    """Positions (T, N, 3) m of one run that goes well."""
    rollout = model.prepare(scene).run(np.array([theta], dtype=float))
    assert rollout.status == ("ok",)
    return rollout.position[0]


def error(name: str, trial: Trial, reference: float | None = None, **options) -> float:
    """How far off a trial of the validation suite is, as a share of its reference."""
    model = catalogue().make("models", name, **options)
    position = simulate(model, trial.scene, *model.of_material(trial.material, trial.scene))
    return trial.measure(trial.scene, position) / (reference or trial.reference) - 1


def damped_wave(time: np.ndarray, signal: np.ndarray, omega: float) -> tuple[float, float]:
    """ω₀ [rad/s] and decay γ [1/s] of e^(−γt) (a sin ωt + b cos ωt) + c fitted to a signal, ω₀² = ω² + γ²."""
    scale = np.abs(signal).max()

    def misfit(p):
        fade = np.exp(-p[1] * time)
        base = np.stack([fade * np.sin(p[0] * time), fade * np.cos(p[0] * time), np.ones_like(time)], axis=1)
        return base @ np.linalg.lstsq(base, signal / scale, rcond=None)[0] - signal / scale

    found = least_squares(misfit, [omega, 0.02 * omega], x_scale=[omega, omega], xtol=1e-12, ftol=1e-12)
    assert np.sqrt((found.fun**2).mean()) < 0.03  # it is such a wave
    return float(np.hypot(*found.x)), float(found.x[1])


# --- free vibration ---------------------------------------------------------------------------------------------------

BEAM = 0.2, 0.05  # m
WAVE = 4.730040744862704 / BEAM[0]  # 1/m, of a beam free at both ends: cos(kL) cosh(kL) = 1


def beam_mode(u: np.ndarray) -> np.ndarray:
    """Deflection of the lowest mode at u [m], 1 at the ends."""
    end = WAVE * BEAM[0]
    ratio = (np.cosh(end) - np.cos(end)) / (np.sinh(end) - np.sin(end))
    return (np.cosh(WAVE * u) + np.cos(WAVE * u) - ratio * (np.sinh(WAVE * u) + np.sin(WAVE * u))) / 2


def beam_frequency(bending: float) -> float:
    """ω [rad/s] of a strip free all around."""
    return WAVE**2 * np.sqrt(bending / DENSITY)


def bent_beam(bending: float, along: int) -> Scene:
    """A weightless strip let go 1 mm bent, for four periods."""
    shape = along, max(3, (along - 1) // 4 + 1)
    uv = lattice(*BEAM, shape)
    start = np.column_stack([uv, 1e-3 * beam_mode(uv[:, 0])])
    times = np.linspace(0, 4 * 2 * np.pi / beam_frequency(bending), 161)
    return Scene(*BEAM, DENSITY, np.array([0.0, 1.0]), np.zeros((0, 2)), np.zeros((2, 0, 3)), times, uv,
                 gravity=(0.0, 0.0, 0.0), resolution=shape, start=start)  # fmt: skip


def beam_vibration(model: Model, bending: float, along: int, theta) -> tuple[float, float]:
    """ω₀ and γ of a bent strip's lowest mode."""
    scene = bent_beam(bending, along)
    deflection = simulate(model, scene, *theta)[:, :, 2]
    return damped_wave(scene.times, deflection @ beam_mode(scene.points[:, 0]), beam_frequency(bending))


# --- swinging sheets --------------------------------------------------------------------------------------------------

PENDULUM = 2.404825557695773 / 2 * np.sqrt(G / LENGTH)  # rad/s, of the sheet in `swing_wave`


def swing_wave(model: Model, theta, along: int = 9) -> tuple[float, float]:
    """ω₀ and γ of the small swing of a hanging sheet of 0.15 kg/m²."""
    scene = swinging(along, 0.003, 3.0, 0.01)
    y = simulate(model, scene, *theta)[1:, :, 1].reshape(len(scene.times) - 1, along, -1)
    return damped_wave(scene.times[1:], (y - y[:, :1]).mean(axis=2) @ first_mode(along), PENDULUM)


def aside(times: np.ndarray, along: int = 13, step: float = 0.03) -> Scene:
    """A strip of 0.3 m that hangs, steps aside within 0.4 s, and swings; seen along its middle."""
    shape = (along - 1) // 4 + 1, along
    held = np.stack([np.linspace(0, 0.075, shape[0]), np.zeros(shape[0])], axis=1)
    clock = np.linspace(0.0, 0.4, 200)
    s = clock / 0.4
    moved = step * s**3 * (10 - 15 * s + 6 * s**2)
    path = np.stack([held[:, 0] + 0 * moved[:, None], 0 * held[:, 0] + moved[:, None], np.zeros((200, shape[0]))], -1)
    points = np.stack([np.full(along, 0.0375), np.linspace(0, 0.3, along)], axis=1)
    return Scene(0.075, 0.3, DENSITY, clock, held, path, times, points, resolution=shape)


def shaken(times: np.ndarray, nodes: int, amplitude: float = 0.06) -> Scene:
    """A square sheet of 0.3 m held at two corners that go to and fro at 1.5 Hz, seen at its nodes."""
    clock = np.linspace(0.0, max(times[-1], 0.1), 200)
    y = amplitude * np.clip(clock / 0.3, 0, 1) ** 2 * np.sin(2 * np.pi * 1.5 * clock)
    held = np.array([[0.0, 0.0], [0.3, 0.0]])
    path = np.stack([held[:, 0] + 0 * clock[:, None], np.repeat(y[:, None], 2, 1), np.zeros((200, 2))], axis=-1)
    return Scene(0.3, 0.3, DENSITY, clock, held, path, times, lattice(0.3, 0.3, (nodes, nodes)),
                 resolution=(nodes, nodes))  # fmt: skip


def slack(times: np.ndarray, nodes: int) -> Scene:
    """The same sheet at rest, with its two corners a fifth nearer to each other than they are on the cloth."""
    scene = shaken(times, nodes, 0.0)
    u, v = scene.points.T
    start = np.stack([0.8 * u, 0.02 * np.sin(np.pi * u / 0.3) * (1 - v / 0.6), -v], axis=1)
    path = scene.grip_position * np.array([0.8, 1.0, 1.0])
    return Scene(0.3, 0.3, DENSITY, scene.grip_time, scene.grip_material, path, times, scene.points,
                 resolution=(nodes, nodes), start=start)  # fmt: skip
