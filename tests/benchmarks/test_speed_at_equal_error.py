"""Simulated seconds per second at equal error, beside the peers: a step is worth what it gets right.

A swung sheet of textbook cloth (`timing.swung_sheet`); the error is the RMS distance over nodes and frames to the same
equations' own converged motion on the same mesh, at most 2 mm. Each setting takes the longest step of a ladder that
keeps to it. What a model does to come to rest before the motion is not counted.

The truth of all of a peer's solvers is its explicit one with half a stable step. Too few sweeps of Newton's `vbd`,
which leave the cloth too soft and too slow to move, are thus errors: on 21 × 21 nodes 13 mm with 5 sweeps in 2 ms, and
still 9 mm with 20 in 1.4 ms. It becomes accurate enough where it is fifty times as slow as Newton's explicit solver.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.rollout import Rollout
from clothbench.display.terminal import console
from clothbench.plugins.discovery import Catalogue, Plugin, catalogue
from clothbench.studies.speed import bench, timing
from clothbench.studies.speed.tables import speed_tables

SIDES = (21, 41)
IMPLICIT = [0.016 * 2 ** (-k / 2) for k in range(8)]  # s, 16 to 1.4 ms
SHORTER = IMPLICIT[4:] + [IMPLICIT[-1] * 2 ** (-k / 2) for k in range(1, 5)]  # s, 4 to 0.35 ms
LONGEST = 1.2  # of the step that a peer's model takes by itself: 0.96 of the longest stable one
OWN = {
    "baraff_witkin": ("baraff_witkin", {}, IMPLICIT),
    "baraff_witkin, 1 %": ("baraff_witkin", {"tolerance": 1e-2}, IMPLICIT),
    "baraff_witkin, Euler": ("baraff_witkin", {"integrator": "implicit_euler"}, IMPLICIT),
    "inextensible": ("inextensible", {}, IMPLICIT),
    "inextensible, 1e-4": ("inextensible", {"tolerance": 1e-4}, IMPLICIT),
}
PEERS = {
    "mujoco, Euler": ("mujoco", {"step_scale": LONGEST}, [None]),
    "mujoco, discrete": ("mujoco", {"integrator": "discrete"}, SHORTER),
    "newton, semi_implicit": ("newton", {"step_scale": LONGEST}, [None]),
}
FASTEST_PEERS = ("newton, semi_implicit", "mujoco, Euler")  # at either size


@functools.cache
def truth(name: str, side: int) -> np.ndarray:
    """Positions (T, N, 3) m of the converged motion."""
    scale = 0.5 if name in ("mujoco", "newton") else 0.25
    with timing.on_threads(1):
        return timing.swung(catalogue().make("models", name, step_scale=scale), side)[0]


@functools.cache
def accurate(setting: str, side: int) -> timing.Accurate:
    """What a setting of `OWN` or `PEERS` reaches; a skip without its library."""
    name, options, ladder = (OWN | PEERS)[setting]
    factory = catalogue().load("models", name)
    if reason := getattr(factory, "skip_reason", lambda: None)():
        pytest.skip(reason)
    if ladder != [None]:
        return timing.at_equal_error(lambda dt: factory(dt=dt, **options), side, truth(name, side), ladder)
    with timing.on_threads(1):
        model = factory(**options)
        error = timing.rms_distance(timing.swung(model, side)[0], truth(name, side))
        speed = timing.moving_speed(model, side)
    return timing.Accurate(speed.simulated * speed.nodes / speed.node_steps, error, speed)


@pytest.mark.bench
@pytest.mark.parametrize("setting", [*OWN, *PEERS])
@pytest.mark.parametrize("side", SIDES)
def test_speed_at_equal_error(benchmark, side, setting):
    benchmark.group = f"{side} × {side} nodes, at equal error"
    found = benchmark.pedantic(accurate, args=(setting, side), rounds=1)
    assert found.error <= timing.TOLERABLE
    benchmark.extra_info |= {
        "step_ms": 1e3 * found.step, "error_mm": 1e3 * found.error, "realtime_factor": found.speed.realtime_factor,
    }  # fmt: skip


@pytest.mark.bench
@pytest.mark.parametrize("setting", ["inextensible", "baraff_witkin, 1 %"])
@pytest.mark.parametrize("side", SIDES)
def test_several_times_as_fast_as_any_peer_at_equal_error(side, setting):
    best = max(accurate(peer, side).speed.realtime_factor for peer in FASTEST_PEERS)
    assert accurate(setting, side).speed.realtime_factor >= 4 * best


@pytest.mark.bench
def test_bdf2_takes_steps_several_times_as_long_as_euler():
    assert accurate("baraff_witkin", 21).step >= 3 * accurate("baraff_witkin, Euler", 21).step


@pytest.mark.bench
@pytest.mark.parametrize("sweeps", [5, 20])
def test_newtons_vbd_needs_more_sweeps_than_it_is_given(sweeps):
    newton = catalogue().load("models", "newton")
    if reason := newton.skip_reason():
        pytest.skip(reason)
    position, _ = timing.swung(newton(solver="vbd", iterations=sweeps, dt=2e-3), 21)
    assert timing.rms_distance(position, truth("newton", 21)) >= 3 * timing.TOLERABLE


# --- how it is measured: on a toy whose error is its step ---------------------------------------------------


class Toy:
    """Its nodes are off by its step in metres; a step takes as long as another."""

    kind, parameters, capabilities, pace = "implicit", None, frozenset({"dynamic"}), 1e-5
    longest = 5e-3  # s, beyond which it does not get to its end
    spans: tuple[float, ...] = ()

    def __init__(self, dt: float = 4e-4, step_scale: float = 1.0):
        self.dt = dt * step_scale

    def of_material(self, material, scene):
        return np.array([material.stretch])

    def prepare(self, scene):
        type(self).spans += (scene.times[-1],)
        return SimpleNamespace(run=lambda theta: self.run(scene))

    def run(self, scene) -> Rollout:
        position = np.zeros((1, len(scene.times), len(scene.points), 3))
        position[..., 2] = self.dt
        status = "ok" if self.dt <= self.longest else "diverged"
        nodes, steps = scene.resolution[0] * scene.resolution[1], round(scene.times[-1] / self.dt)
        return Rollout(scene.times, position, (status,), np.array([steps]), nodes)


class Library(Toy):
    built_on = ("numpy",)


@pytest.fixture
def toys(monkeypatch):
    """Two models, of which the second counts as a peer."""
    plugins = [Plugin("models", name.lower(), f"{__name__}:{name}", "", "test", "1") for name in ("Toy", "Library")]
    found = Catalogue(tuple(plugins))
    monkeypatch.setattr(bench, "catalogue", lambda: found)
    monkeypatch.setattr(Catalogue, "load", lambda self, kind, name: {"toy": Toy, "library": Library}[name])
    monkeypatch.setattr(timing, "REPEATS", 1)
    return plugins


def test_the_longest_accurate_step_is_taken(monkeypatch):
    monkeypatch.setattr(timing, "REPEATS", 1)
    found = timing.at_equal_error(Toy, 5, timing.swung(Toy(1e-6), 5)[0], ladder=(1e-3, 8e-3, 1.5e-3, 3e-3))
    assert found.step == 1.5e-3
    assert found.error == pytest.approx(1.5e-3, abs=2e-6)
    assert Toy.spans[-2:] == (timing.BRIEF, timing.SWING)  # one subtracted from the other


def test_a_model_that_is_never_accurate_enough_has_no_speed():
    with pytest.raises(timing.FailedRun, match=r"no step from 0\.003 s on keeps its error below 2 mm"):
        timing.at_equal_error(Toy, 5, timing.swung(Toy(1e-6), 5)[0], ladder=(3e-3, 8e-3))


def test_rows_at_equal_error_stand_beside_the_fastest_peer(toys, capsys):
    own, peer = bench.equal_error(toys, 5)
    assert tuple(own) == tuple(peer) == bench.KEYS
    assert (own["model"], own["peer"], own["nodes"], own["threads"], own["batch"]) == ("toy", "library", 25, 1, 1)
    assert own["ratio"] == pytest.approx(own["realtime_factor"] / peer["realtime_factor"])
    assert (peer["peer"], peer["ratio"]) == (None, None)
    assert own["step_s"] in timing.LADDER
    assert own["error_m"] <= timing.TOLERABLE
    for shown in speed_tables([own, peer]):
        console().print(shown)
    assert "fastest peer" in capsys.readouterr().out


def test_a_swung_sheet_is_held_along_its_edge_and_seen_below_it():
    scene = timing.swung_sheet(9)
    assert len(scene.grip_material) == 9
    assert scene.points[:, 1].min() > 0
    assert scene.grip_position[-1, :, 1] == pytest.approx(timing.ASIDE)
    assert np.diff(scene.times) == pytest.approx(timing.BRIEF)
