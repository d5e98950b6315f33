"""Compiled code that makes no arrays does not count who refers to them, and is held to it."""

from __future__ import annotations

import os
import resource
import subprocess
import sys

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from clothbench import ClothbenchError, effect_kernel
from clothbench.modelling import bear_inertia, bear_inverted, invert_inertia, kernel, lean_kernel, ready
from clothbench.plugins.discovery import catalogue


@lean_kernel(inline="always")
def halves(x):
    n = x.shape[0] // 2
    return x[:n], x[n:]


@lean_kernel
def difference(x):
    low, high = halves(x)
    total = 0.0
    for e in range(low.shape[0]):
        total += high[e] - low[e]
    return total


@kernel
def fresh(x):
    return x + 1.0


@kernel
def fresher(x):
    return x + 2.0


@kernel
def pieces(x):
    for e in range(x.shape[0]):
        yield x[e:]


@kernel
def asked_of_a_new_one(times):
    total = 0.0
    for _ in range(times):
        x = np.arange(1000.0)
        total += difference(x)
        total += x[-1]  # it is still there
    return total


def test_views_of_an_array_leave_it_alone():
    """It is there until it is no longer used, and gone then: 100 000 of them would be 800 MB."""
    assert asked_of_a_new_one(100) == 100 * (500.0 * 500.0 + 999.0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    asked_of_a_new_one(100_000)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def leaks(x):
    return fresh(x)[0]


def leaks_by_turns(x):
    f = fresh if x[0] > 0.0 else fresher
    return f(x)[0]


def leaks_bit_by_bit(x):
    total = 0.0
    for piece in pieces(x):
        total += piece[0]
    return total


def returns_views(x):
    return x[0], x[1:]


def returns_one_perhaps(x):
    return x[1:] if x[0] > 0.0 else None


def yields(x):
    for e in range(x.shape[0]):
        yield x[e]


def returns_first(x):
    return x[0]


@pytest.mark.filterwarnings("ignore:First-class function type")
@pytest.mark.parametrize(
    ("function", "why"),
    [
        (leaks, "takes arrays from .*fresh"),
        (leaks_by_turns, "takes arrays from "),
        (leaks_bit_by_bit, "is, or goes through, a generator"),
        (returns_views, "returns arrays"),
        (returns_one_perhaps, "returns arrays"),
        (yields, "is, or goes through, a generator"),
    ],
)
def test_who_does_not_count_keeps_no_array_and_gives_none(function, why):
    with pytest.raises(NumbaError, match=rf"{function.__name__}: {why}.*allocates"):
        lean_kernel(function)(np.zeros(3))


def test_functions_that_do_not_say_so_are_not_called():
    other = numba.core.decorators.jit(nopython=True)(returns_first)

    @lean_kernel
    def trusting(x):
        return other(x)

    with pytest.raises(NumbaError, match=r"trusting: calls .*clothbench's decorators have not made"):
        trusting(np.zeros(3))


TWICE = """
import numpy as np
from clothbench.modelling import kernel, lean_kernel

def both(x):
    return np.zeros(int(x[0])).size

counting, lean = kernel(both), lean_kernel(both)
try:
    lean(np.ones(3))
    print("compiled")
except Exception:
    print("refused")
print(counting(np.ones(3)))
"""


def test_what_lies_on_disk_is_not_taken_for_the_other(tmp_path):
    (tmp_path / "twice.py").write_text(TWICE)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": os.pathsep.join(sys.path)}
    for _ in range(2):
        command = [sys.executable, "-c", "import twice"]
        out = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=True)
        assert out.stdout.split() == ["refused", "1"]


def test_what_numba_builds_in_is_not_shared_with_those_that_count():
    def flat(x):
        return x.T.ravel()[0]

    assert kernel(flat)(np.ones((2, 3))) == 1.0
    with pytest.raises(NumbaError):
        lean_kernel(flat)(np.ones((2, 3)))


def empty(t, dt, x, v, f, sheet, p, state):
    f[0, 0] += np.zeros(3).size


def summed(t, dt, x, v, f, sheet, p, state):
    f[0, 0] += v.sum(axis=0).size


def chosen(t, dt, x, v, f, sheet, p, state):
    f[0, 0] += np.where(v > 0.0, v, 0.0).size


def copied(t, dt, x, v, f, sheet, p, state):
    f[0] = v[0]


@pytest.mark.parametrize("push", [empty, summed, chosen, copied])
def test_an_effect_that_makes_arrays_after_all_is_told_so(push):
    with pytest.raises(ClothbenchError, match=r"effect 'mine' cannot be compiled by numba: .*allocates"):
        ready(effect_kernel(push, allocates=False), "effect 'mine'")
    assert ready(effect_kernel(push), "effect 'mine'")


def test_the_effects_that_models_run_with_most_count_nothing():
    plugins = catalogue()
    for name in ("linear_drag", "quadratic_drag", "steady_wind", "heavy_hem", "added_mass"):
        effect = plugins.make("effects", name)
        for stage in ("force", "inertia"):
            if (compiled := getattr(effect, stage, None)) is not None:
                assert compiled.targetoptions["_nrt"] is False


def test_inertia_that_was_inverted_does_the_same_to_the_bit():
    rng = np.random.default_rng(0)
    mass, extra, force = rng.uniform(1e-4, 2e-4, 200), np.zeros((6, 200)), rng.normal(size=(3, 200))
    extra[:3, 50:] = rng.uniform(0, 1e-3, 150)
    extra[:, 120:] += rng.uniform(-2e-5, 2e-5, (6, 80))
    extra[0, -3:] = np.inf, np.nan, 1e300
    force[0, :3] = -0.0, np.inf, np.nan
    once, again, inverse = force.copy(), force.copy(), np.empty((8, 200))
    bear_inertia(once, mass, extra)
    invert_inertia(mass, extra, inverse)
    bear_inverted(again, inverse)
    assert once.tobytes() == again.tobytes()
    assert once[:, :50].tobytes() == force[:, :50].tobytes()
    assert np.isnan(once[:, -2]).any()
