"""Speed of `mass_spring` beside the peers. Asserted are ratios of what one run measured, never seconds.

The bounds lie far below what a quiet machine shows: they catch a kernel that lost its vector unit or its
threads, not a busy neighbour. Where the kernel alone is timed nothing holds the sheet, or it would settle first.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothbench_models import peers

from clothbench import bench, timing
from clothbench.plugins import catalogue

SIDES = (9, 21, 41, 65)
NODE_STEPS = 4e6  # in one timed call
TRIANGLE_CLOTH = ("mujoco", "newton")


def model(**options):
    return catalogue().make("models", "mass_spring", **options)


def peer(name: str):
    module = catalogue().load("peers", name)
    if reason := module.skip_reason():
        pytest.skip(reason)
    return module


def kernel_run(side: int, batch: int, precision: str):
    """A call that steps `batch` free sheets at the peers' step and stiffness, and the node-steps in it."""
    steps = max(50, round(NODE_STEPS / side**2 / batch))
    scene = dataclasses.replace(
        timing.hanging_sheet(side, 1.0),
        gravity=(0.0, 0.0, -0.01),  # or the longest run would fall out of sight
        grip_time=np.array([0.0, 1.0]), grip_material=np.zeros((0, 2)), grip_position=np.zeros((2, 0, 3)),
        times=np.linspace(0.0, steps * timing.STEP, 5),
    )  # fmt: skip
    simulation = model(dt=timing.STEP, precision=precision).prepare(scene)
    theta = np.tile(simulation.parameters.defaults, (batch, 1))
    mass = peers.node_mass(side, timing.SIZE, timing.AREAL_DENSITY)
    theta[:, simulation.parameters.names.index("k1")] = peers.stable_stiffness(mass, timing.STEP)
    return lambda: simulation.run(theta)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("batch", [1, 64])
@pytest.mark.parametrize("side", SIDES)
def test_kernel(benchmark, side, batch, precision):
    benchmark.group = f"{side} × {side} nodes"
    run = kernel_run(side, batch, precision)
    with timing.on_threads(1):
        rollout = benchmark.pedantic(run, rounds=3, warmup_rounds=1)
    assert set(rollout.status) == {"ok"}
    work = float(rollout.steps.sum()) * rollout.nodes
    assert rollout.nodes == side**2
    if benchmark.stats is not None:  # there are none with --benchmark-disable
        benchmark.extra_info["node_steps_per_s"] = work / benchmark.stats.stats.min


@pytest.mark.parametrize("name", [*TRIANGLE_CLOTH, "newton_springs"])
@pytest.mark.parametrize("side", SIDES)
def test_peer(benchmark, side, name):
    module = peer(name)
    benchmark.group = f"{side} × {side} nodes"
    steps = max(50, round(NODE_STEPS / 10 / side**2))
    # Its own set-up would be in the time of the call; what counts is the time that it takes for its steps.
    runs = []
    benchmark.pedantic(lambda: runs.append(module.step_sheet(side, timing.STEP, steps)), rounds=2)
    assert all(run.finite for run in runs)
    benchmark.extra_info["node_steps_per_s"] = max(run.node_steps_per_s for run in runs)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRIANGLE_CLOTH)
def test_five_times_as_fast_as_a_triangle_cloth_per_core(name):
    beside, _ = timing.time_peer(peer(name), 21)
    own = timing.time_model(model(dt=timing.STEP), 21)
    assert own.nodes == beside.nodes
    assert own.node_steps_per_s >= 5 * beside.node_steps_per_s


@pytest.mark.slow
def test_faster_than_newtons_net_of_springs_per_core():
    beside, _ = timing.time_peer(peer("newton_springs"), 21)
    assert timing.time_model(model(dt=timing.STEP), 21).node_steps_per_s >= 1.5 * beside.node_steps_per_s


@pytest.mark.slow
def test_threads_do_what_separate_processes_do():
    rows = bench.two_cores("mass_spring", 21)
    if not rows:
        pytest.skip("only one core")
    assert rows[0]["ratio"] >= 0.75
