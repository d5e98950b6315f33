"""The whole folding path: its three phases against the finished fold, a mirror and a balance of work; and slip."""

import dataclasses
import math

import numpy as np
import pytest
from clothbench_models import strip_kernels, strip_path, strip_trials
from clothbench_models.kirchhoff_love import KirchhoffLove
from clothbench_models.strip import Ends, State, Strip
from scipy.optimize import brentq

from clothbench import ClothbenchError
from clothbench.core.folding import FoldsOver, geometric_places
from clothbench.reference import lifted_strip
from clothbench.reference.mechanics import G, fold_loop

ETA = 3e3
STRIP = Strip()
SIZE = STRIP.size(ETA)


@pytest.fixture(scope="module")
def whole() -> strip_path.Path:
    return strip_path.path(STRIP, ETA)


def of_phase(path: strip_path.Path, phase: int) -> list[State]:
    return [s for p, s in zip(path.phases, path.states, strict=True) if p == phase]


def energy(state: State) -> float:
    """Π/ρ per width [m³/s²]."""
    _, d1, d2 = state.spline.tables
    pull = np.stack([0 * state.spline.shares, -G * state.spline.shares], axis=1)
    weight = state.spline.quadrature[1]
    return float(strip_kernels.energy(state.control, d1, d2, weight, pull, STRIP.eta_m, state.eta_b))


def test_each_phase_has_the_coordinate_that_is_known(whole):
    assert list(whole.phases) == sorted(whole.phases)
    assert set(whole.phases) == {1, 2, 3}
    z1, x2, z3 = ([getattr(s.ends, n) for s in of_phase(whole, p)] for p, n in ((1, "z1"), (2, "x1"), (3, "z1")))
    assert (np.diff(z1) > 0).all()
    assert (np.diff(x2) < 0).all()
    assert (np.diff(z3) < 0).all()
    assert (whole.states[-1].ends.x1, whole.states[-1].ends.z1) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_finished_fold_leaves_the_desk_where_the_elastica_does():
    """Two flat parts, one over the other, and the loop: 2a + (length + reach of the loop) (D/ρg)^⅓ = L."""
    loop = fold_loop()
    expected = (1 - (loop.s[-1] + loop.x[-1]) * SIZE) / 2
    assert strip_path.lift_off(strip_trials.free_fold(STRIP, ETA), G) == pytest.approx(expected, abs=2e-5)


def test_phase_one_pulls_at_nothing_and_ends_with_the_fold_s_lower_layer(whole):
    lifted = of_phase(whole, 1)
    assert max(abs(s.pull) for s in lifted) < 1e-6
    left = strip_path.lift_off(whole.states[-1], G)
    assert strip_path.lift_off(lifted[-1], G) == pytest.approx(left, abs=2e-6)
    assert strip_path.lift_off(lifted[-2], G) > left + 0.01


def test_phase_two_leaves_the_lower_layer_as_it_is(whole):
    left = strip_path.lift_off(whole.states[-1], G)
    for state in of_phase(whole, 2):
        assert strip_path.lift_off(state, G) == pytest.approx(left, abs=2e-6)
        assert strip_path.carried(state) == 0


def test_the_upper_layer_lands_where_it_is_expected(whole):
    """Every point that touches the lower layer lies at x = L − u, from the first contact on."""
    u = np.linspace(0, 1, 2001)
    for state in whole.states[-whole.laid :]:
        assert strip_path.carried(state) > 0
        assert abs(strip_path.landing(state, 0.0)) < 2e-3 * SIZE
        line = state.at(u)
        lies = (line[:, 1] < 1e-7) & (u > 0.5)
        if lies.sum() > 20:  # a layer, and not an edge
            assert np.abs(line[lies, 0] + u[lies] - 1).max() < 2e-3 * SIZE


def test_laying_down_is_lifting_in_a_mirror(whole):
    """As long as something lies flat between loop and hand, nothing tells the upper layer from a strip on a desk."""
    free, mirrored = None, 0
    for state in whole.states[-whole.laid : -1][::-2]:
        if state.ends.z1 < 0.34:
            free = lifted_strip.lift(1.0, lambda u: ETA + 0 * u, state.ends.z1, free, tolerance=1e-5)
            x, _, slope = free.pose
            assert state.ends.x1 == pytest.approx(1 - x, abs=5e-3 * SIZE)
            assert state.ends.angle1 == pytest.approx(math.pi - slope, abs=2e-3)
            mirrored += 1
    assert mirrored > 2


def test_the_hand_s_work_is_the_strip_s_energy(whole):
    """Phases 1 and 2 are one way without a leap, and the hand neither turns nor is turned by the strip."""
    states = of_phase(whole, 1) + of_phase(whole, 2)
    place = np.array([[s.ends.x1, s.ends.z1] for s in states])
    force = np.array([s.reaction[-2:].sum(axis=0) for s in states])
    work = ((force[1:] + force[:-1]) / 2 * np.diff(place, axis=0)).sum()
    gained = energy(states[-1]) - energy(states[0])
    assert gained > 0.5
    assert work == pytest.approx(gained, rel=2e-3)


def test_the_strip_falls_between_the_phases(whole):
    """Static instability: the last state that hangs free and the first that is laid are no neighbours."""
    falling = of_phase(whole, 3)[: -whole.laid]
    assert len(falling) == strip_path.FALLS
    hangs, lies = of_phase(whole, 2)[-1], whole.states[-whole.laid]
    straight = np.hypot(hangs.ends.x1 - lies.ends.x1, hangs.ends.z1 - lies.ends.z1)
    assert straight < 5 * SIZE
    assert energy(lies) < energy(hangs)


def test_limp_paths_are_alike_in_bending_lengths():
    """Where phase 1 ends, beside the triangle's corner, in (D/ρg)^⅓: the strip's length takes no part."""
    corners = []
    for eta in (1e3, 3e4):
        strip = Strip(elements=240)
        left = strip_path.lift_off(strip_trials.free_fold(strip, eta), G)
        top = strip_path.lifts(strip, eta, left)[-1].ends
        corners.append(np.array([top.x1 - 0.5, top.z1 - 0.5]) / strip.size(eta))
    assert corners[0] == pytest.approx(corners[1], abs=5e-3)


def test_cloth_too_stiff_for_its_length_is_refused():
    with pytest.raises(ClothbenchError, match=r"strip of 1 m (is too stiff to lie folded|has its end)"):
        strip_path.path(STRIP, 10.0)


def test_the_plugin_hands_the_path_out(whole):
    strip = KirchhoffLove().strip(1.0)
    assert isinstance(strip, FoldsOver)
    found = strip.fold(np.array([ETA, 1e-5, 0.3]))
    assert found.laid == whole.laid
    assert found.places == pytest.approx(np.array([[s.ends.x1, s.ends.z1] for s in whole.states]), abs=1e-9)
    assert found.state.friction.max() < 0.1
    assert not found.origin.any()


def test_a_path_that_friction_bears_moves_nothing(whole):
    places = np.array([[s.ends.x1, s.ends.z1] for s in of_phase(whole, 1)])[::4]
    found, _ = strip_path.followed(STRIP, ETA, places, 0.05)
    assert [s.ends.x0 for s in found] == [0.0] * len(places)
    assert found[-1].at(np.linspace(0, 1, 50)) == pytest.approx(
        of_phase(whole, 1)[20].at(np.linspace(0, 1, 50)), abs=5e-4
    )


def test_a_limp_strip_slips_as_a_catenary_does():
    """By hand: S off the desk, c = μ (L − S) the catenary's parameter at Coulomb's limit, z = √(c² + S²) − c."""
    friction, x, z = 0.3, 0.87, 0.3
    off = brentq(lambda s: math.hypot(friction * (1 - s), s) - friction * (1 - s) - z, 0.0, 1.0)
    c = friction * (1 - off)
    expected = x - (1 - off) - c * math.asinh(off / c)
    slips = []
    for eta in (1e3, 1e4):
        found = strip_path.followed(Strip(elements=300), eta, np.array([[x, z]]), friction)[0][0]
        assert found.pull == pytest.approx(friction * found.press, rel=1e-3)
        slips.append(found.ends.x0)
    away = np.abs(np.array(slips) - expected)
    assert away.max() < 2e-3
    assert away[1] < away[0] / 3  # what bending makes of it fades with the stiffness


def test_a_strip_slips_as_the_elastica_does():
    """The force that is left after slipping is that of the boundary-value problem, at friction times its weight."""
    friction = 0.2
    found = strip_path.followed(STRIP, ETA, np.array([[0.87, 0.3]]), friction)[0][0]
    end, origin = found.ends, found.ends.x0
    assert origin > 0.01
    free = lifted_strip.lift(1.0, lambda u: ETA + 0 * u, 0.3)
    held = lifted_strip.hold(1.0, lambda u: ETA + 0 * u, (end.x1 - origin, end.z1, end.angle1), free)
    assert held.pull / held.press == pytest.approx(friction, rel=2e-3)


def test_a_strip_slips_either_way_and_stays_there():
    there, back = np.array([0.9, 0.25]), np.array([0.72, 0.25])
    (out, home), needed = strip_path.followed(STRIP, ETA, np.array([there, back]), 0.02)
    assert min(needed) > 0.02
    assert out.ends.x0 > 0.01
    assert home.pull < 0
    assert home.ends.x0 < 0
    (first, second), _ = strip_path.followed(STRIP, ETA, np.array([there, there]), 0.02)
    assert second.ends.x0 == pytest.approx(first.ends.x0, abs=1e-5)


def test_geometric_paths_have_equal_steps_and_end_at_the_other_edge():
    for name in ("triangular", "circular"):
        places = geometric_places(name, 1.0, 40)
        assert places[-1] == pytest.approx([0.0, 0.0], abs=1e-12)
        assert places[19] == pytest.approx([0.5, 0.5])
        steps = np.linalg.norm(np.diff(np.vstack([[1.0, 0.0], places]), axis=0), axis=1)
        assert steps == pytest.approx(np.full(40, steps[0]))
    with pytest.raises(ValueError, match="there is no path 'straight'"):
        geometric_places("straight", 1.0, 4)


def test_onwards_is_the_state_that_is_found_from_the_flat_strip():
    near = strip_trials.lift(STRIP, ETA, 0.2)
    found = STRIP.onwards(near, ETA, dataclasses.replace(Ends(), z1=0.25))
    assert found.at(np.linspace(0, 1, 60)) == pytest.approx(
        strip_trials.lift(STRIP, ETA, 0.25).at(np.linspace(0, 1, 60)), abs=2e-5
    )
