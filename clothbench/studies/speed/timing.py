"""How fast a model or a peer steps, timed through its public interface: best of a few long runs.

All step the same sheet: 0.30 m square, 0.2 kg/m², held at its two upper corners, or along its upper edge where models
are timed at equal error.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.parallel import set_thread_count
from clothbench.core.protocols import Material, Simulation
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene
from clothbench.plugins.discovery import import_target

SIZE, AREAL_DENSITY = 0.30, 0.2  # m, kg/m²
STEP = 2e-4  # s; the peers', and a model's where it has an option `dt`
FIRST_SPAN, LONGEST_SPAN = 0.1, 300.0  # s of simulated time; lengthened until a run takes long enough
MIN_SECONDS = 0.3  # wall time of a run beside which its set-up is negligible
REPEATS = 3
PATIENCE = 15.0  # s of wall time after which a measurement is not repeated: so long a run is a mean in itself
COARSE = 9  # nodes a side of the sheet that compiles what settles one: on the others a first run takes minutes
ROUNDS = 3  # of threads and separate processes in turn
CLOTH = Material(bending=1e-5, stretch=300.0, shear=150.0)  # a light shirting
ASIDE, RAMP, SWING = 0.1, 0.5, 1.5  # m, s and s: how far and fast a swung sheet's edge moves, and how long it is seen
TOLERABLE = 2e-3  # m, RMS over nodes and frames
BRIEF = 0.02  # s from frame to frame
LADDER = tuple(0.016 * 2 ** (-k / 2) for k in range(18))  # s, the steps that are tried, from the longest on


class FailedRun(ClothbenchError):
    """A rollout that cannot be timed, since it did not get to its end."""


@dataclass(frozen=True)
class Speed:
    """One timed run: nodes of one sheet; node-steps and simulated time [s] of all sheets; wall time [s]."""

    nodes: int
    node_steps: float
    simulated: float
    seconds: float

    @property
    def node_steps_per_s(self) -> float:
        return self.node_steps / self.seconds

    @property
    def realtime_factor(self) -> float:
        """Simulated seconds of all sheets per second of wall time."""
        return self.simulated / self.seconds


def time_model(model: Any, side: int, batch: int = 1, threads: int = 1) -> Speed:
    """A model with `batch` sheets of side × side nodes at its default parameters, on so many threads.

    The simulated time is the scene's; steps that settle the sheet first count as work, not as time.
    """
    ready = _Prepared(model, side, batch)
    with on_threads(threads):
        ready.warm_up()
        return best_of(ready.run)


def time_settling(model: Any, side: int) -> Speed:
    """A model that finds rest only: one sheet of side × side nodes, its grips still, settled on one thread.

    A step is an iteration of its search for rest, all of them counted; no time passes in it.
    """
    runs: list[Speed] = []
    begun = time.perf_counter()
    with on_threads(1):
        _settled(model, min(side, COARSE))
        while not runs or (len(runs) < REPEATS and time.perf_counter() - begun < PATIENCE):
            runs.append(_settled(model, side))
    return max(runs, key=lambda s: s.node_steps_per_s)


def _settled(model: Any, side: int) -> Speed:
    simulation = model.prepare(hanging_sheet(side, FIRST_SPAN, sway=0.0))
    begun = time.perf_counter()
    rollout = simulation.run(simulation.parameters.defaults[None])
    return _speed(rollout, side, 0.0, time.perf_counter() - begun)


def time_peer(peer: Any, side: int) -> tuple[Speed, str]:
    """A peer's module (see the hook `clothbench_peers`): one sheet on one thread; and the peer's version."""
    version = ""

    def run(span: float) -> Speed:
        nonlocal version
        steps = round(span / STEP)
        done = peer.step_sheet(side, STEP, steps)
        if not done.finite:
            raise FailedRun(f"its sheet of {side} × {side} nodes blew up")
        version, work = done.version, done.nodes * steps
        return Speed(done.nodes, work, steps * STEP, work / done.node_steps_per_s)

    return best_of(run), version


def best_of(run: Callable[[float], Speed]) -> Speed:
    """The fastest of `REPEATS` runs of the same simulated span [s], made long enough first."""
    span, best, spent, repeats = FIRST_SPAN, None, 0.0, 0
    while best is None or (repeats < REPEATS and spent < PATIENCE):
        speed = run(span)
        if speed.seconds < MIN_SECONDS and span < LONGEST_SPAN:
            span = min(LONGEST_SPAN, span * max(1.5, 1.2 * MIN_SECONDS / speed.seconds))
            best, repeats = None, 0
            continue
        repeats, spent = repeats + 1, spent + speed.seconds
        if best is None or speed.node_steps_per_s > best.node_steps_per_s:
            best = speed
    return best


def hanging_sheet(side: int, span: float, sway: float = 0.01) -> Scene:
    """The sheet of side × side nodes; its corners go 2 · sway m to and fro, once in two seconds, for `span` s."""
    held = np.array([[0.0, 0.0], [SIZE, 0.0]])
    stamps = np.linspace(0.0, span, max(3, round(span / 0.02) + 1))
    aside = sway * (1 - np.cos(np.pi * stamps))[:, None] * np.array([[0.0, 1.0, 0.0]])
    inner = np.linspace(0.1, 0.9, 5) * SIZE
    points = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
    return Scene(
        width=SIZE, height=SIZE, areal_density=AREAL_DENSITY, resolution=(side, side),
        grip_time=stamps, grip_material=held, grip_position=np.insert(held, 1, 0.0, axis=1) + aside[:, None],
        times=np.linspace(0.0, span, max(2, round(span * 30) + 1)), points=points,
    )  # fmt: skip


class _Prepared:
    """A model and a batch of its default parameters, prepared anew only when the span changes."""

    def __init__(self, model: Any, side: int, batch: int) -> None:
        self.model, self.side, self.batch = model, side, batch
        self._simulation: Simulation | None = None
        self._span = 0.0

    def warm_up(self) -> None:
        """One sheet for a short time: compiles what is compiled, and shows whether it can be run at all."""
        self._run_for(FIRST_SPAN, 1)

    def run(self, span: float) -> Speed:
        return self._run_for(span, self.batch)

    def _run_for(self, span: float, batch: int) -> Speed:
        simulation = self._prepared(span)
        theta = np.tile(simulation.parameters.defaults, (batch, 1))
        start = time.perf_counter()
        rollout = simulation.run(theta)
        seconds = time.perf_counter() - start
        return _speed(rollout, self.side, span * batch, seconds)

    def _prepared(self, span: float) -> Simulation:
        if self._simulation is None or span != self._span:
            self._span, self._simulation = span, self.model.prepare(hanging_sheet(self.side, span))
        return self._simulation


def _speed(rollout: Rollout, side: int, simulated: float, seconds: float) -> Speed:
    """What a rollout of so many simulated seconds that took so long says; an error if it did not get to its end."""
    for member, status in enumerate(rollout.status):
        if status != "ok":
            why = rollout.reasons[member] if rollout.reasons else status
            raise FailedRun(f"its sheet of {side} × {side} nodes could not be timed: {why}")
    work = float(np.sum(rollout.steps)) * rollout.nodes
    if not work > 0:
        raise FailedRun("its rollout counts no steps")
    return Speed(rollout.nodes, work, simulated, seconds)


@contextmanager
def on_threads(count: int) -> Iterator[None]:
    set_thread_count(count)
    try:
        yield
    finally:
        set_thread_count(0)


# --- speed at equal error -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Accurate:
    """The longest step [s] that is accurate enough, the error with it [m] and the speed."""

    step: float
    error: float
    speed: Speed


def at_equal_error(
    make: Callable[[float], Any], side: int, truth: np.ndarray, ladder: Sequence[float] = LADDER
) -> Accurate:
    """The speed of the model that `make(step)` gives, with the longest step that errs by no more than `TOLERABLE`.

    The error is the RMS distance over nodes and frames from `truth`, what `swung` gives for a converged simulation of
    the same equations on the same mesh. One sheet on one thread.
    """
    with on_threads(1):
        for step in sorted(ladder, reverse=True):
            model = make(step)
            try:
                error = rms_distance(swung(model, side)[0], truth)
                if error <= TOLERABLE:
                    return Accurate(step, error, moving_speed(model, side))
            except FailedRun:
                continue
    raise FailedRun(f"no step from {min(ladder):.2g} s on keeps its error below {1e3 * TOLERABLE:g} mm")


def moving_speed(model: Any, side: int, span: float = SWING) -> Speed:
    """The speed of the sheet in motion: of a run over `span` s less what a run takes that ends when the motion begins.

    What is spent on settling and set-up is in neither; the second run is the more exactly the shorter the first.
    """
    brief: list[Speed] = []
    whole: list[Speed] = []
    begun = time.perf_counter()
    while not whole or (len(whole) < REPEATS and time.perf_counter() - begun < PATIENCE):
        brief.append(swung(model, side, BRIEF)[1])
        whole.append(swung(model, side, span)[1])
    short, long = (min(runs, key=lambda s: s.seconds) for runs in (brief, whole))
    seconds = max(long.seconds - short.seconds, 1e-9)
    return Speed(long.nodes, long.node_steps - short.node_steps, long.simulated - short.simulated, seconds)


def swung(model: Any, side: int, span: float = SWING) -> tuple[np.ndarray, Speed]:
    """Positions (T, N, 3) m of the swung sheet of textbook cloth, and how fast it ran with its settling.

    Seconds are those of this process's cores, not the wall's: one-thread runs take so long that neighbours would show.
    """
    scene = swung_sheet(side, span)
    simulation = model.prepare(scene)
    theta = model.of_material(CLOTH, scene)[None]
    begun = time.process_time()
    rollout = simulation.run(theta)
    seconds = time.process_time() - begun
    return rollout.position[0], _speed(rollout, side, span, seconds)


def swung_sheet(
    side: int, span: float = SWING, points: np.ndarray | None = None, times: np.ndarray | None = None
) -> Scene:
    """The sheet of side × side nodes, held along its whole upper edge; that steps aside, and the sheet swings.

    Every node of the edge is held; points (N, 2) m and times (T,) s are where and when it is seen: below the edge,
    fifty times a second. Held at two corners, it would soon move so chaotically that no step is short enough.
    """
    held = np.stack([np.linspace(0, SIZE, side), np.zeros(side)], axis=1)
    stamps = np.linspace(0.0, RAMP, 41)
    s = stamps / RAMP
    aside = ASIDE * s**3 * (10 - 15 * s + 6 * s**2)
    path = np.insert(held, 1, 0.0, axis=1) + aside[:, None, None] * np.array([0.0, 1.0, 0.0])
    across, down = np.meshgrid(np.linspace(0, SIZE, 11), np.linspace(SIZE / 10, SIZE, 10))
    return Scene(
        width=SIZE, height=SIZE, areal_density=AREAL_DENSITY, resolution=(side, side),
        grip_time=stamps, grip_material=held, grip_position=path,
        times=np.linspace(0.0, span, round(span / BRIEF) + 1) if times is None else times,
        points=np.stack([across.ravel(), down.ravel()], axis=1) if points is None else points,
    )  # fmt: skip


def rms_distance(one: np.ndarray, other: np.ndarray) -> float:
    """RMS over nodes and frames of the distance between positions (T, N, 3) m."""
    return float(np.sqrt(((one - other) ** 2).sum(axis=-1).mean()))


# --- threads against separate processes ---------------------------------------------------------------------


def share_of_processes(target: str, options: dict[str, Any], side: int, batch: int, cores: int) -> tuple[Speed, float]:
    """A batch on `cores` threads, and its node-steps/s over those of as many one-thread processes together.

    Each process takes its share of the batch. Threads and processes take turns, so that a busy machine slows
    both: given are the best run on threads and the median of the ratios of neighbouring turns.
    """
    ready = _Prepared(import_target(target)(**options), side, batch)
    with on_threads(cores), ExitStack() as stack:
        share = max(1, batch // cores)
        workers = [stack.enter_context(_worker(target, options, side, share)) for _ in range(cores)]
        ready.warm_up()
        for worker in workers:
            _answer(worker)
        turns, shares = [], []
        for _ in range(ROUNDS):
            turns.append(ready.run(FIRST_SPAN))
            for worker in workers:
                _start(worker)
            shares.append(turns[-1].node_steps_per_s / sum(_answer(worker) for worker in workers))
    return max(turns, key=lambda s: s.node_steps_per_s), statistics.median(shares)


@contextmanager
def _worker(target: str, options: dict[str, Any], side: int, batch: int) -> Iterator[subprocess.Popen]:
    code = "from clothbench.studies.speed.timing import work; work()"
    command = [sys.executable, "-c", code, target, json.dumps(options), str(side), str(batch)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _start(worker: subprocess.Popen) -> None:
    assert worker.stdin is not None
    worker.stdin.write("run\n")
    worker.stdin.flush()


def _answer(worker: subprocess.Popen) -> float:
    """The next number that a worker writes; an error if it ended instead."""
    assert worker.stdout is not None
    line = worker.stdout.readline()
    if not line:
        raise FailedRun("a separate process ended before it had run")
    return float(line)


def work() -> None:
    """Main function of a separate process: a 0 when ready, then one run's node-steps/s for each line read."""
    target, options, side, batch = sys.argv[1:]
    answers, sys.stdout = sys.stdout, sys.stderr  # what a plugin prints is no answer
    ready = _Prepared(import_target(target)(**json.loads(options)), int(side), int(batch))
    with on_threads(1):
        ready.warm_up()
        print(0, file=answers, flush=True)
        for _ in sys.stdin:
            print(ready.run(FIRST_SPAN).node_steps_per_s, file=answers, flush=True)
