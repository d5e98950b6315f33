"""The permutation test on residuals of known make: how often it cries wolf, and how often it sees one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.observation import Observation
from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.studies.improve.attribution import Probe, explained_share
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.permutation import permutation_test
from clothbench.studies.improve.rounds import at_any_shape, rescreened
from clothbench.studies.improve.settings import LOOP, SearchSettings
from clothbench.studies.improve.sheets import SheetCase, mirror

FRAMES, SIDE, RECORDINGS, CANDIDATES, SIGMA = 50, 3, 5, 25, 1e-3
MATERIAL = np.stack(np.meshgrid(np.linspace(0, 0.3, SIDE), np.linspace(0, 0.3, SIDE)), axis=-1).reshape(-1, 2)
SPACE = ParameterSpace(
    tuple(Parameter(n, n, "1", (0.0, 1.0), "linear", 0.5, "of the base", "a test") for n in ("a", "b", "c"))
)


def smooth(random: np.random.Generator, count: int = 1) -> np.ndarray:
    """Fields (count, T, N, 3) that hang together in time for a third of a second and over the whole sheet."""
    time = np.arange(FRAMES)
    kernel = np.exp(-0.5 * ((time[:, None] - time[None]) / 5.0) ** 2)
    waves = random.normal(size=(count, 4, FRAMES, 3))
    waves = np.einsum("ts,kmsc->kmtc", kernel, waves)
    u, v = (MATERIAL / 0.3).T
    shapes = np.stack([v, v * (2 * u - 1), v**2, v * np.sin(np.pi * u)])
    out = np.einsum("mn,kmtc->ktnc", shapes, waves)
    return out / np.sqrt(np.mean(out**2, axis=(1, 2, 3), keepdims=True))


@pytest.fixture(scope="module")
def cases():
    seen = np.ones((FRAMES, len(MATERIAL)), bool)
    still = np.zeros((FRAMES, len(MATERIAL), 3))
    observation = Observation(np.arange(FRAMES) / 30, still, seen, SIGMA, MATERIAL)
    return [SheetCase(f"r{k}", "fit", None, observation, None) for k in range(RECORDINGS)]


@pytest.fixture(scope="module")
def candidates(cases):
    """Each has one amount, and changes every recording in its own smooth way."""
    random = np.random.default_rng(3)
    fields = [smooth(random, RECORDINGS).reshape(RECORDINGS, -1, 1) for _ in range(CANDIDATES)]
    return [
        Probe(f"e{k}", np.zeros(1), (0,), np.ones(1), np.zeros((1, 0)), list(1e-3 * f)) for k, f in enumerate(fields)
    ]


def fitted(residual: np.ndarray, random: np.random.Generator) -> Fitted:
    """A fit of three parameters that leaves these residuals (R, M) m."""
    jacobian = [smooth(random, len(SPACE)).reshape(len(SPACE), -1).T for _ in range(RECORDINGS)]
    theta = SPACE.defaults
    return Fitted((), SPACE, theta, list(residual), jacobian, theta, theta, 0)


def left(random: np.random.Generator, structure: float = 2e-3) -> np.ndarray:
    """Residuals (R, M) m without any effect: what a slightly wrong model leaves, and noise."""
    wrong = structure * smooth(random, RECORDINGS).reshape(RECORDINGS, -1)
    return wrong + random.normal(0, SIGMA, wrong.shape)


def test_it_seldom_names_an_effect_where_there_is_none(cases, candidates):
    """At most 5 % of a hundred residuals; of as many, 5 % of chance's own alarms lie below 9 (95 %)."""
    alarms = 0
    for seed in range(100):
        random = np.random.default_rng(seed)
        seen = permutation_test(cases, fitted(left(random), random), candidates, seed)
        alarms += min(seen.p_value(k) for k in range(CANDIDATES)) < 0.05
    assert alarms <= 9


def test_of_one_effect_asked_about_beforehand_chance_is_its_own(cases, candidates):
    """As often below 0.05 as it says, of residuals without an effect, and sooner than the best of all candidates."""
    alone, of_all = [], []
    for seed in range(100):
        random = np.random.default_rng(seed)
        seen = permutation_test(cases, fitted(left(random), random), candidates[:8], seed)
        alone.append(seen.p_alone([2]))
        of_all.append(seen.p_value(2))
    assert (np.array(alone) < 0.05).sum() <= 9
    assert all(a <= b for a, b in zip(alone, of_all, strict=True))
    assert 0.3 < np.mean(alone) < 0.7


def test_nor_where_all_moves_in_one_direction():
    """A sheet that swings in one plane: turned out of it, no surrogate would look like a candidate."""
    plane, alarms = np.array([0.3, 1.0, 0.1]), 0
    observation = Observation(
        np.arange(FRAMES) / 30, np.zeros((FRAMES, len(MATERIAL), 3)), np.ones((FRAMES, len(MATERIAL)), bool), SIGMA,
        MATERIAL,
    )  # fmt: skip
    cases = [SheetCase(f"r{k}", "fit", None, observation, None) for k in range(RECORDINGS)]

    def in_plane(random: np.random.Generator) -> np.ndarray:
        """(R, M) what swings as a whole, further out the further down."""
        swing = smooth(random, RECORDINGS).mean(axis=(2, 3), keepdims=True)
        field = swing * (MATERIAL[:, 1] / 0.3)[:, None] * plane
        return field.reshape(RECORDINGS, -1)

    for seed in range(100):
        random = np.random.default_rng(seed)
        probes = [
            Probe(f"e{k}", np.zeros(1), (0,), np.ones(1), np.zeros((1, 0)), [f[:, None] for f in in_plane(random)])
            for k in range(5)
        ]
        residual = in_plane(random)
        residual = 2e-3 * residual / residual.std() + random.normal(0, 1e-4, residual.shape)
        test = permutation_test(cases, fitted(residual, random), probes, seed)
        alarms += min(test.p_value(k) for k in range(len(probes))) < 0.05
    assert alarms <= 9


@pytest.mark.parametrize(("size", "least"), [(1e-3, 0.8), (0.6e-3, 0.3)])
def test_it_sees_an_effect_half_as_large_as_what_the_model_leaves(cases, candidates, size, least):
    """size: rms [m] of what the effect changes, beside 2 mm of structure that no effect explains."""
    hits = 0
    for seed in range(20):
        random = np.random.default_rng(1000 + seed)
        truth = seed % CANDIDATES
        residual = left(random) + size / 1e-3 * np.array([c[:, 0] for c in candidates[truth].columns])
        seen = permutation_test(cases, fitted(residual, random), candidates, seed)
        best = int(np.argmax(seen.explained))
        hits += best == truth and seen.p_value(best) < 0.05
    assert hits >= 20 * least


def test_without_candidates_there_is_nothing_to_see(cases):
    random = np.random.default_rng(7)
    seen = permutation_test(cases, fitted(left(random), random), [], 0)
    assert len(seen.explained) == 0
    assert (seen.null_maxima == 0).all()


def test_what_the_base_explains_counts_for_no_candidate(cases, candidates):
    random = np.random.default_rng(7)
    fit = fitted(left(random), random)
    same = Probe("copy", np.zeros(1), (0,), np.ones(1), np.zeros((1, 0)), [j[:, :1] for j in fit.jacobian])
    assert permutation_test(cases, fit, [same, *candidates], 0).explained[0] < 1e-9


@pytest.mark.parametrize(("least_own", "told"), [(0.0, True), (0.02, False)])
def test_what_is_hardly_its_own_counts_where_more_is_asked_for(cases, candidates, least_own, told):
    """A twentieth of what it changes is not the base's: 0.25 % of its squares."""
    random = np.random.default_rng(7)
    fit = fitted(left(random), random)
    columns = [j[:, :1] / np.abs(j[:, 0]).mean() for j in fit.jacobian]
    columns = [c + 0.05 * r[:, None] / np.abs(r).mean() for c, r in zip(columns, fit.residual, strict=True)]
    probe = Probe("nearly a copy", np.zeros(1), (0,), np.ones(1), np.zeros((1, 0)), columns)
    assert (permutation_test(cases, fit, [probe, *candidates], 0, least_own).explained[0] > 0.5) == told


def test_surrogates_keep_what_a_residual_is_made_of(cases):
    random = np.random.default_rng(1)
    residual = left(random)[0]
    moved = cases[0].surrogates(residual)(random)
    assert moved.shape == residual.shape
    assert np.sum(moved**2) == pytest.approx(np.sum(residual**2), rel=0.6)  # some frames twice, some never
    assert abs(np.corrcoef(moved, residual)[0, 1]) < 0.5
    assert (mirror(MATERIAL)[mirror(MATERIAL)] == np.arange(len(MATERIAL))).all()


def test_of_amounts_by_recording_chance_does_not_keep_what_stays_in_its_place(cases):
    """A sheet that hangs off by the same everywhere is, turned, one that hangs off another way: what stays has to be
    shared out anew for chance to be anything else.
    """
    case, random = cases[0], np.random.default_rng(3)
    seen = case.observation.visible
    off = np.broadcast_to([3e-3, -4e-3, 2e-3], (*seen.shape, 3))[seen].ravel()
    way = np.stack([np.broadcast_to(axis, (*seen.shape, 3))[seen].ravel() for axis in np.eye(3)])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    for spread, least, most in ((False, 0.999, 1.001), (True, 0.0, 0.6)):
        draw = case.surrogates(off, spread=spread)
        drawn = np.array([draw(random) for _ in range(60)])
        share = np.square(drawn @ way.T).sum(axis=1) / np.square(drawn).sum(axis=1)
        assert least <= np.quantile(share, 0.95) <= most
        assert np.square(drawn).sum(axis=1) == pytest.approx(np.sum(off**2), rel=0.2)


def test_later_rounds_try_those_anew_that_may_explain_what_is_left_now(candidates):
    random, names = np.random.default_rng(17), [probe.effect for probe in candidates]
    residual = left(random)
    for r in range(RECORDINGS):
        residual[r] -= 4.0 * candidates[20].columns[r][:, 0]
    fit = fitted(residual, random)
    assert rescreened(fit, names, (), 1.0) == names
    rest = [name for name in names if name != "e3"]  # the one that was named
    anew = rescreened(fit, rest, candidates, 0.0)
    assert len(anew) == LOOP.rescreened
    assert "e20" in anew
    assert "e3" not in anew
    assert anew == [name for name in rest if name in anew]
    assert rescreened(fit, rest, candidates, 0.5) == ["e20"]


def test_chance_may_choose_the_shape_as_the_search_does(cases, monkeypatch):
    """An effect of nine shapes, of which the one that explains most was kept: held against surrogates at that shape
    alone it would beat chance two to three times as often as it should.
    """
    cries, random = {"kept alone": 0, "any shape": 0}, np.random.default_rng(8)
    monkeypatch.setattr("clothbench.studies.improve.rounds.shapes_looked_at", lambda problem, name: settings)
    problem = SimpleNamespace(
        evidence=SimpleNamespace(search=SearchSettings()), of_split=lambda split: cases, seed=0
    )  # fmt: skip
    count = 60
    for _ in range(count):
        shapes = [1e-3 * smooth(random, RECORDINGS).reshape(RECORDINGS, -1, 1) for _ in range(9)]
        settings = [(np.zeros(1), (0,), np.ones(1))] * len(shapes)
        changes = [[c.T for c in shape] for shape in shapes]
        monkeypatch.setattr("clothbench.studies.improve.rounds.tangents", lambda *_, found=changes: found)
        before = fitted(SIGMA * smooth(random, RECORDINGS).reshape(RECORDINGS, -1), random)
        best = max(changes, key=lambda change: explained_share(before, change))
        kept = [Probe("shaped", np.zeros(1), (0,), np.ones(1), np.zeros((1, 3)), [c.T for c in best])]
        cries["kept alone"] += permutation_test(cases, before, kept, 0).p_alone([0]) < LOOP.significance
        cries["any shape"] += at_any_shape(problem, before, "shaped", kept) < LOOP.significance
    assert cries["kept alone"] > 0.12 * count
    assert cries["any shape"] < 0.12 * count
