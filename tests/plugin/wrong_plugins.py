"""Effects, metrics, optimizers, trackers that are wrong in one way each, and the honest ones they spoil."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from clothbench import (
    ClothbenchError,
    Observation,
    Parameter,
    ParameterSpace,
    Recording,
    Score,
    effect_kernel,
)


def space(null=0.0, bounds=(0.0, 0.1)):
    return ParameterSpace((Parameter("late", "τ", "s", bounds, "linear", 0.05, "lateness", "none", null=null),))


# --- effects ---


class HonestEffect:
    name = "honest"
    version = 1
    place = "sensor"
    summary = "frames are stamped late"
    parameters = space()

    def times(self, time, phi):
        return time - phi[0]


class Placeless(HonestEffect):
    place = "kitchen"


class NullOutside(HonestEffect):
    parameters = space(null=-1.0)


class NullNowhere(HonestEffect):
    parameters = space(null=None)


class NeverNull(HonestEffect):
    def times(self, time, phi):
        return time - phi[0] - 1e-6


class Idle(HonestEffect):
    def times(self, time, phi):
        return time + 0.0


class Overwriting(HonestEffect):
    def times(self, time, phi):
        time -= phi[0]
        return time


@effect_kernel
def greedy_force(t, dt, x, v, f, sheet, p, state):
    """Counts in a memory that was never declared."""
    state[0] += 1.0
    f[0, 0] += p[0] * 1e-3


@effect_kernel
def braking_force(t, dt, x, v, f, sheet, p, state):
    """Changes the velocity itself instead of pushing."""
    for i in range(x.shape[1]):
        v[0, i] *= 1.0 - p[0]


@effect_kernel
def mistyped_force(t, dt, x, v, f, sheet, p, state):
    f[0] += sheet.weight


class Greedy(HonestEffect):
    place = "dynamics"
    force = staticmethod(greedy_force)


class Braking(Greedy):
    force = staticmethod(braking_force)


@effect_kernel
def pushing_force(t, dt, x, v, f, sheet, p, state):
    f[1] += p[0] * 1e-3


class Pushing(Greedy):
    force = staticmethod(pushing_force)
    at_rest = False


@effect_kernel
def tiring_force(t, dt, x, v, f, sheet, p, state):
    state[0] += 1.0
    if state[0] > 2.0:
        f[1] += p[0] * 1e-3


class Tiring(Greedy):
    """Pushes from its third step on, where nothing moves either."""

    force = staticmethod(tiring_force)
    at_rest = False

    def state_size(self, sheet):
        return 1


@effect_kernel
def late_greedy_force(t, dt, x, v, f, sheet, p, state):
    f[0, 0] += p[0] * 1e-3
    if p[0] > 0.06:
        state[0] += 1.0


class GreedyOnceStrong(Greedy):
    """Counts in a memory that was never declared, but not at its defaults."""

    force = staticmethod(late_greedy_force)


@effect_kernel
def nodal_force(t, dt, x, v, f, sheet, p, state):
    """Pushes every node alike, so that a finer mesh is pushed more."""
    for i in range(x.shape[1]):
        f[1, i] += 1e-3 * p[0]


class Nodal(Greedy):
    force = staticmethod(nodal_force)


class Uncompiled(Greedy):
    force = staticmethod(greedy_force.py_func)


class Mistyped(Greedy):
    force = staticmethod(mistyped_force)


class Jealous(HonestEffect):
    """Remembers over all runs how often it was asked, and from the third time on is late on its own."""

    asked = itertools.count()

    def times(self, time, phi):
        return time - phi[0] - 1e-3 * (next(self.asked) > 2)


class Forgetful(HonestEffect):
    def state_size(self, sheet):
        return 1.5


class Softening(HonestEffect):
    def stiffness(self, phi):
        return -1.0, 0.0


class Weightless(HonestEffect):
    def lightest(self, phi):
        return 0.0


class Aslant(HonestEffect):
    normals = "perhaps"


@effect_kernel
def spreading_force(t, dt, x, v, f, sheet, p, state):
    state[:] += 1.0
    f[1] += p[0] * state.sum()


class Spreading(HonestEffect):
    place = "dynamics"
    force = staticmethod(spreading_force)

    def state_size(self, sheet):
        return 1


EFFECTS = [
    (Forgetful, "keeps what it offers", "a state_size of 1.5"),
    (Softening, "keeps what it offers", "a stiffness of [-1.0, 0.0]"),
    (Weightless, "keeps what it offers", "lightest that gives 0.0"),
    (Aslant, "keeps what it offers", "normals 'perhaps'"),
    (Placeless, "has all members", "place 'kitchen'"),
    (Uncompiled, "has all members", "'force' that is not compiled"),
    (Mistyped, "has all members", "'force' cannot be compiled by numba: Unknown attribute 'weight'"),
    (NullOutside, "has null values within its bounds", "outside its bounds"),
    (NullNowhere, "has null values within its bounds", "no parameter with a null value"),
    (NeverNull, "vanishes at its null values", "another motion at the null values"),
    (Idle, "acts elsewhere", "no change of any motion"),
    (Pushing, "lets hang what hangs", "on a sheet that does not move"),
    (Tiring, "lets hang what hangs", "on a sheet that does not move"),
    (Jealous, "goes along with another effect", "at its null values"),
    (Greedy, "keeps to its own memory", "IndexError"),
    (GreedyOnceStrong, "keeps to its own memory", "IndexError"),
    (Braking, "keeps to its own memory", "an input of 'force'"),
    (Spreading, "keeps to its own memory", "with a longer state"),
    (Nodal, "means the same on every mesh", "'force' that adds 0.00405 on 9 × 9 nodes"),
    (Overwriting, "leaves positions it is given alone", "arrays given to 'times'"),
]


# --- metrics ---


class HonestMetric:
    """Root mean square distance of what was seen [m]."""

    name = "honest"
    version = 1
    unit = "m"

    def __call__(self, observation, rollout):
        seen = observation.visible
        residual = (rollout.position - np.nan_to_num(observation.position))[:, seen].reshape(len(rollout), -1)
        count = int(seen.sum())
        square = (residual**2).sum(axis=1)
        value = np.sqrt(square / count) if count else np.full(len(rollout), np.nan)
        return self.spoil(observation, Score(value, self.unit, residual=residual))

    def spoil(self, observation, score):
        return score

    def floor(self, observation):
        return math.sqrt(3.0) * observation.sigma


class Unitless(HonestMetric):
    unit = ""


class Flat(HonestMetric):
    def spoil(self, observation, score):
        return dataclasses.replace(score, per_frame=score.value)


class Tracing(HonestMetric):
    """With the trace and the map of what it scores; sound."""

    def __call__(self, observation, rollout):
        square = np.square(rollout.position - observation.position).sum(axis=-1)
        square[:, ~observation.visible] = np.nan
        return dataclasses.replace(
            super().__call__(observation, rollout),
            per_frame=self.trace(np.sqrt(mean_of_seen(square, 2))), per_node=self.map(np.sqrt(mean_of_seen(square, 1))),
        )  # fmt: skip

    def trace(self, per_frame):
        return per_frame

    def map(self, per_node):
        return per_node


def mean_of_seen(values, axis):
    """The mean over an axis of what is a number, not a number where nothing is."""
    count = np.isfinite(values).sum(axis=axis)
    return np.where(count, np.nansum(values, axis=axis) / np.maximum(count, 1), np.nan)


class Millimetric(Tracing):
    def trace(self, per_frame):
        return 1e3 * per_frame


class Kilometric(Tracing):
    def map(self, per_node):
        return 1e-3 * per_node


class Unmoved(Tracing):
    """Its trace is the same, whatever the rollout."""

    def trace(self, per_frame):
        return np.where(np.isnan(per_frame), np.nan, 5e-3)


class Backwards(Tracing):
    def trace(self, per_frame):
        return per_frame[:, ::-1]


class Mirrored(Tracing):
    def map(self, per_node):
        return per_node[:, ::-1]


class Smoothed(Tracing):
    """Shows running means over seven frames, and errors with a sign and a map that sum up; sound."""

    def trace(self, per_frame):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(per_frame, ((0, 0), (3, 3)), mode="edge"), 7, axis=1)
        return np.where(np.isnan(per_frame), np.nan, -mean_of_seen(windows, 2))

    def map(self, per_node):
        return per_node / np.isfinite(per_node).sum(axis=1, keepdims=True)


class Speeds(HonestMetric):
    """How wrong velocities are, as central differences have them, from the frames beside each [m/s]; sound."""

    unit = "m/s"

    def __call__(self, observation, rollout):
        time, away = observation.time, rollout.position - observation.position
        speed = np.full(away.shape[:3], np.nan)
        speed[:, 1:-1] = np.linalg.norm(away[:, 2:] - away[:, :-2], axis=-1) / (time[2:] - time[:-2])[:, None]
        speed[:, ~observation.visible] = np.nan
        some = np.isfinite(speed).any() and np.isfinite(rollout.position).all(axis=(1, 2, 3))
        value = np.where(some, mean_of_seen(speed.reshape(len(speed), -1), 1), np.nan)
        return Score(value, self.unit, mean_of_seen(speed, 2), mean_of_seen(speed, 1))

    def floor(self, observation):
        return math.nan


class Offset(HonestMetric):
    def spoil(self, observation, score):
        return dataclasses.replace(score, value=score.value + 1e-3)


class Saturated(HonestMetric):
    def spoil(self, observation, score):
        return dataclasses.replace(score, value=np.minimum(score.value, 3e-3))


class SeeingTheUnseen(HonestMetric):
    def __call__(self, observation, rollout):
        seen = np.nan_to_num(observation.position)
        return Score(np.sqrt(((rollout.position - seen) ** 2).mean(axis=(1, 2, 3))), self.unit)


class Inventive(HonestMetric):
    def spoil(self, observation, score):
        return dataclasses.replace(score, value=np.nan_to_num(score.value, nan=99.0))


class Filling(HonestMetric):
    """Has a residual for what it has no value for."""

    def spoil(self, observation, score):
        return dataclasses.replace(score, residual=np.nan_to_num(score.residual))


class InventiveWithoutView(HonestMetric):
    def spoil(self, observation, score):
        return score if observation.visible.any() else dataclasses.replace(score, value=np.zeros(len(score.value)))


class Ordered(HonestMetric):
    def spoil(self, observation, score):
        weight = np.linspace(1.0, 2.0, score.residual.shape[1])
        value = np.sqrt((score.residual**2 * weight).mean(axis=1))
        return dataclasses.replace(score, value=value)


class Competitive(HonestMetric):
    """Grades the members of a batch against each other."""

    def spoil(self, observation, score):
        return dataclasses.replace(score, value=score.value * len(score.value))


class Boastful(HonestMetric):
    def floor(self, observation):
        return observation.sigma


class Destructive(HonestMetric):
    def __call__(self, observation, rollout):
        rollout.position[:] = np.round(rollout.position, 4)
        return super().__call__(observation, rollout)


class Aimless(HonestMetric):
    def __call__(self, observation, rollout):
        score = super().__call__(observation, rollout)
        return dataclasses.replace(score, objectives=score.value[:, None], spread=np.ones(1))


METRICS = [
    (Unitless, "has all members", "unit ''"),
    (Flat, "gives whole scores", "per_frame of shape (2,)"),
    (Millimetric, "traces what it scores", "per_frame from"),
    (Kilometric, "traces what it scores", "per_node from"),
    (Unmoved, "traces what it scores", "the per_frame of a perfect rollout"),
    (Backwards, "traces what it scores", "per_frame that changes by 0 in the one frame"),
    (Mirrored, "traces what it scores", "per_node that changes by 0 in the one node"),
    (Offset, "is zero for a perfect rollout", "for a perfect rollout"),
    (Saturated, "grows with the error", "for an error doubled thrice"),
    (Aimless, "says its objectives", "objectives of shape (2, 1)"),
    (SeeingTheUnseen, "ignores what was not seen", "when only unseen nodes move"),
    (Inventive, "gives no number for a lost rollout", "for rollouts that were lost"),
    (Filling, "gives no number for a lost rollout", "a finite residual"),
    (InventiveWithoutView, "gives no number where nothing was seen", "where no node was seen"),
    (Ordered, "does not care for the order of nodes", "in another order"),
    (Competitive, "scores a batch as one by one", "another value of member 0"),
    (Boastful, "states an honest floor", "where noise alone gives"),
    (Destructive, "leaves its input alone", "a rollout that scoring has changed"),
]


# --- optimizers ---


class RandomSearch:
    """Uniform random points in batches of ten: keeps every rule but the one that it defines."""

    name = "random_search"
    version = 1
    needs_residual = False

    def __init__(self, space, *, seed, budget):
        self.space, self.left, self.random = space, budget, np.random.default_rng(seed)
        self.done, self.stopped = False, ""
        self.best, self.value = None, np.inf

    def draw(self, count):
        return self.random.random((count, len(self.space)))

    def ask(self):
        return self.space.from_unit(self.draw(min(10, self.left)))

    def tell(self, theta, evaluation):
        lowest = np.where(np.isnan(evaluation.value), np.inf, evaluation.value)
        if lowest.min() < self.value:
            self.best, self.value = self.space.to_unit(theta[lowest.argmin()]), lowest.min()
        self.left -= len(theta)
        if self.left <= 0:
            self.done, self.stopped = True, "budget spent"


class HonestOptimizer(RandomSearch):
    """Walks from the best point so far, in steps that shrink as the budget does."""

    def __init__(self, space, *, seed, budget):
        super().__init__(space, seed=seed, budget=budget)
        self.budget = budget

    def draw(self, count):
        if self.best is None:
            return super().draw(count)
        step = 0.3 * (self.left / self.budget) ** 2
        return np.clip(self.best + step * self.random.normal(size=(count, len(self.space))), 0.0, 1.0)


class Changeable(RandomSearch):
    needs_residual = "sometimes"


class Dependent(HonestOptimizer):
    """Says that it needs no residual, and takes one."""

    def tell(self, theta, evaluation):
        squares = np.square(evaluation.residual).sum(axis=1)
        value = np.where(np.isnan(evaluation.value), np.nan, squares)
        super().tell(theta, dataclasses.replace(evaluation, value=value))


class Unseeded(RandomSearch):
    def draw(self, count):
        return np.random.random((count, len(self.space)))  # noqa: NPY002


class Trespassing(HonestOptimizer):
    def ask(self):
        return super().ask() * 1.01


class Spendthrift(RandomSearch):
    def ask(self):
        return self.space.from_unit(self.draw(10))


class Silent(RandomSearch):
    def tell(self, theta, evaluation):
        super().tell(theta, evaluation)
        self.stopped = ""


class Fragile(RandomSearch):
    def tell(self, theta, evaluation):
        if np.isnan(evaluation.value).any():
            raise ValueError("not a number")
        super().tell(theta, evaluation)


class Lost(HonestOptimizer):
    @property
    def start(self):
        return self.space.high + 1.0


class Feverish(HonestOptimizer):
    temperature_now = "hot"


class Headstrong(HonestOptimizer):
    def __init__(self, space, *, seed, budget, start=None):
        super().__init__(space, seed=seed, budget=budget)


class Finished(HonestOptimizer):
    def renew(self):
        pass


OPTIMIZERS = [
    (Lost, "keeps what it offers", "within its bounds"),
    (Feverish, "keeps what it offers", "temperature_now 'hot'"),
    (Headstrong, "keeps what it offers", "the defaults first"),
    (Finished, "keeps what it offers", "done = True after renew()"),
    (Dependent, "keeps what it offers", "TypeError"),
    (Changeable, "has all members", "needs_residual 'sometimes'"),
    (Unseeded, "gives the same search for the same seed", "other points asked with the same seed"),
    (Trespassing, "stays within bounds and budget", "asked, expected within its bounds"),
    (Spendthrift, "stays within bounds and budget", "40 evaluations asked"),
    (Spendthrift, "manages with a budget of one", "10 evaluations asked"),
    (Silent, "says why it stopped", "stopped = ''"),
    (Fragile, "copes with lost runs", "ValueError: not a number"),
    (RandomSearch, "beats random search", "better than random search in"),
]


# --- trackers ---


class HonestTracker:
    name = "honest"
    version = 1

    def track(self, source):
        if not isinstance(source, Recording):
            raise ClothbenchError("tracks recordings only")
        return Observation(source.time, source.position, source.visible, source.noise_sigma, source.material)


class Versionless(HonestTracker):
    version = "latest"


class Sleeping(HonestTracker):
    def track(self, source):
        seen = super().track(source)
        return dataclasses.replace(seen, visible=np.zeros_like(seen.visible))


class Imagining(HonestTracker):
    def track(self, source):
        seen = super().track(source)
        filled = np.where(seen.visible[..., None], seen.position, 0.0)
        return dataclasses.replace(seen, position=filled, visible=np.ones_like(seen.visible))


class Squinting(HonestTracker):
    def track(self, source):
        seen = super().track(source)
        return dataclasses.replace(seen, position=seen.position + 0.01)


class Glancing(HonestTracker):
    """It keeps one frame, of which no motion can be made."""

    def track(self, source):
        o = super().track(source)
        return dataclasses.replace(o, time=o.time[:1], position=o.position[:1], visible=o.visible[:1])


class Trembling(HonestTracker):
    count = itertools.count()

    def track(self, source):
        seen = super().track(source)
        return dataclasses.replace(seen, position=seen.position + 1e-9 * next(self.count))


class Defacing(HonestTracker):
    def track(self, source):
        source.position.flags.writeable = True
        source.position[0, 0] += 1e-3
        return super().track(source)


class Sketching(HonestTracker):
    def pictures(self, source, frame, seen):
        return {"nodes": seen.position[frame]}


class Boasting(HonestTracker):
    kinds = frozenset({"nodes", "dreams"})


TRACKERS = [
    (Boasting, "keeps what it offers", "kinds ['dreams', 'nodes']"),
    (Sketching, "keeps what it offers", "step 'nodes' as float64"),
    (Versionless, "has all members", "version 'latest'"),
    (Sleeping, "gives a whole observation", "no node seen in any frame"),
    (Imagining, "sees what was recorded", "nodes seen in frames where the recording has none"),
    (Squinting, "sees what was recorded", "mm from where it was recorded"),
    (Glancing, "serves a cell", "an observation that no scene can be made of"),
    (Trembling, "gives the same bits twice", "another position when tracking again"),
    (Defacing, "leaves the recording alone", "a recording that tracking has changed"),
]
