"""Frames per second of the renderer and of the metric around it, on one thread, in one run after warm-up."""

import numpy as np
import pytest

from clothbench import Camera, Observation, Projector, Rollout
from clothbench.core.parallel import set_thread_count
from clothbench.plugins.discovery import catalogue
from clothbench.vision.orientation import angle_map
from clothbench.vision.render import striped
from clothbench.vision.surface import surface_of

FRAMES = 50
CAMERA = Camera.looking_at((0, -1.2, 0.84), (0, 0, 0.84), (120, 128), 0.40)
PROJECTOR = Projector(Camera.looking_at((0, -1.2, 1.68), (0, 0, 0.84), (800, 800), 0.8), 16.4)


@pytest.fixture
def one_thread():
    set_thread_count(1)
    yield
    set_thread_count(0)


@pytest.fixture(scope="module")
def sheet():
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 9), np.linspace(0, 0.3, 9)))
    y = 0.03 * np.sin(2 * np.pi * u / 0.15) * v / 0.3 * np.cos(np.arange(FRAMES) / 5)[:, None]
    position = np.stack([np.broadcast_to(u - 0.15, y.shape), y, np.broadcast_to(1 - v, y.shape)], axis=-1)
    return np.stack([u, v], axis=1), position


def frames_per_second(benchmark, work):
    work()
    benchmark.pedantic(work, rounds=5)
    rate = FRAMES / benchmark.stats.stats.median
    benchmark.extra_info["frames_per_s"] = round(rate)
    assert np.isfinite(rate)


def test_speed_of_drawing_stripes(benchmark, sheet, one_thread):
    surface = surface_of(sheet[0], 4)
    frames_per_second(benchmark, lambda: striped(CAMERA, PROJECTOR, surface, sheet[1]))


def test_speed_of_angle_maps(benchmark, sheet):
    image, _ = striped(CAMERA, PROJECTOR, surface_of(sheet[0], 4), sheet[1])
    frames_per_second(benchmark, lambda: [angle_map(i, 2.0) for i in image])


def test_speed_of_the_fold_metric(benchmark, sheet, one_thread):
    """Drawing, filters, angles and comparison together: what one evaluation pays per frame."""
    uv, position = sheet
    time = np.arange(FRAMES) / 30
    seen = Observation(time, position, np.ones(position.shape[:2], bool), 1e-3, uv)
    rollout = Rollout(time, 1.01 * position[None], ("ok",), np.ones(1, int), 81)
    metric = catalogue().make("metrics", "fold", pixels=124)
    frames_per_second(benchmark, lambda: metric(seen, rollout))
