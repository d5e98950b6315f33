"""`chamfer` and `hausdorff` beside distances that are known, of points whose identity they are not told."""

import dataclasses

import numpy as np
import pytest

from clothbench import Camera, ClothbenchError, Observation, Rollout
from clothbench.plugins.discovery import catalogue

SPACING = 0.02  # m
GRID = SPACING * np.stack([[x, 0.0, z] for z in range(6) for x in range(7)])
TRUTH = np.stack([GRID, GRID + np.array([0.0, 0.1, 0.0])])  # two frames
NODES = len(GRID)


def made(name, **options):
    return catalogue().make("metrics", name, **options)


def seen_of(position, visible=None, sigma=1e-3):
    visible = np.ones(position.shape[:2], bool) if visible is None else visible
    return Observation(np.arange(float(len(position))), position, visible, sigma, np.zeros((position.shape[1], 2)))


def rollout(*position):
    members = len(position)
    return Rollout(np.arange(2.0), np.stack(position), ("ok",) * members, np.zeros(members, int), position[0].shape[1])


def test_of_a_shift_below_half_the_spacing_all_say_its_length():
    shift = np.array([0.004, 0.005, -0.006])
    moved = rollout(TRUTH + shift)
    length = 1e3 * np.linalg.norm(shift)
    for name in ("chamfer", "hausdorff", "node_error"):
        score = made(name)(seen_of(TRUTH), moved)
        np.testing.assert_allclose(score.value, length)
        np.testing.assert_allclose(score.per_node, length)
    residual = made("chamfer")(seen_of(TRUTH), moved).residual
    np.testing.assert_allclose(residual, np.tile(shift, 2 * 2 * NODES)[None])
    assert made("chamfer", unit="cm")(seen_of(TRUTH), moved).value[0] == pytest.approx(length / 10)


@pytest.mark.parametrize("name", ["chamfer", "hausdorff"])
def test_which_point_is_which_does_not_matter(name):
    random = np.random.default_rng(2)
    wrong = TRUTH + random.normal(0.0, 0.004, TRUTH.shape)
    score = made(name)(seen_of(TRUTH), rollout(wrong, wrong[:, random.permutation(NODES)], TRUTH[:, ::-1]))
    assert score.value[0] == pytest.approx(score.value[1], rel=1e-12)
    assert score.value[2] == 0.0
    assert made("node_error")(seen_of(TRUTH), rollout(TRUTH[:, ::-1])).value[0] > 10


def test_one_stray_point_is_the_hausdorff_distance_and_a_share_of_the_points_passes_over_it():
    stray = TRUTH + np.array([0.001, 0.0, 0.0])
    stray[0, 0] = [-0.03, 0.0, 0.0]
    whole, most = (made("hausdorff", share=s)(seen_of(TRUTH), rollout(stray)) for s in (1.0, 0.95))
    np.testing.assert_allclose(whole.per_frame, [[30.0, 1.0]])
    np.testing.assert_allclose(most.per_frame, [[1.0, 1.0]])
    assert whole.residual is None
    # Of the stray point's node the nearest is a neighbour, 21 mm away, or in the other frame itself.
    assert whole.per_node[0, 0] == pytest.approx((np.hypot(0, 20) + 1) / 2, abs=0.1)


def test_the_share_is_the_rank_of_a_distance():
    """Of 42 distances the 40th is the 95th percentile, the 21st the median (Huttenlocher et al., section 4)."""
    random = np.random.default_rng(4)
    away = np.sort(random.uniform(0.0, 0.009, NODES))
    moved = TRUTH + np.stack([0 * away, away, 0 * away], axis=1)[random.permutation(NODES)]
    for share, rank in ((0.95, 40), (0.5, 21), (1.0, 42), (1e-9, 1)):
        found = made("hausdorff", share=share)(seen_of(TRUTH), rollout(moved)).value[0]
        assert found == pytest.approx(1e3 * away[rank - 1])


@pytest.mark.parametrize("name", ["chamfer", "hausdorff"])
def test_hidden_points_count_in_neither_cloud_and_all_do_where_numbers_differ(name):
    visible = np.ones((2, NODES), bool)
    visible[:, :7], visible[1] = False, False
    seen = seen_of(np.where(visible[..., None], TRUTH, np.nan), visible)
    wild = TRUTH.copy()
    wild[:, :7] += 3.0
    alike = made(name)(seen, rollout(wild))
    assert alike.value[0] == 0.0
    assert np.isnan(alike.per_frame[0]).tolist() == [False, True]
    assert np.isnan(alike.per_node[0]).tolist() == [True] * 7 + [False] * (NODES - 7)
    more = made(name)(seen, rollout(np.concatenate([TRUTH, TRUTH[:, :1] - np.array([0.0, 0.0, 1.0])], axis=1)))
    # The hidden row is one spacing from the nearest that was seen; the point added lies 1 m and a spacing away.
    expected = (7 * 20 + 1020) / (NODES + 1) / 2 if name == "chamfer" else 1020
    assert more.value[0] == pytest.approx(expected)


@pytest.mark.parametrize("name", ["chamfer", "hausdorff"])
def test_the_floor_is_what_noise_gives_also_where_it_is_as_large_as_the_spacing(name):
    random = np.random.default_rng(5)
    for sigma, share in ((1e-3, 0.1), (0.3 * SPACING, 0.15)):
        drawn = [made(name)(seen_of(TRUTH + random.normal(0, sigma, TRUTH.shape)), rollout(TRUTH)) for _ in range(80)]
        floor = made(name).floor(seen_of(TRUTH + random.normal(0, sigma, TRUTH.shape), sigma=sigma))
        assert floor == pytest.approx(np.mean([score.value[0] for score in drawn]), rel=share)
    assert np.isnan(made(name).floor(seen_of(TRUTH, sigma=np.nan)))
    blind = seen_of(np.full(TRUTH.shape, np.nan), np.zeros((2, NODES), bool))
    assert np.isnan(made(name).floor(blind))


@pytest.mark.parametrize("name", ["chamfer", "hausdorff"])
def test_what_cannot_be_compared_is_refused_in_one_line_and_nothing_gives_no_value(name):
    metric = made(name)
    with pytest.raises(ClothbenchError, match=f"{name}: found a rollout of 1 frames and 42 points, expected 2 frames"):
        metric(seen_of(TRUTH), rollout(TRUTH[:1]))
    camera = Camera((100, 100), np.eye(3), np.eye(3), np.zeros(3))
    with pytest.raises(ClothbenchError, match=f"{name}: the points were seen in a picture"):
        metric(dataclasses.replace(seen_of(TRUTH), sight=camera), rollout(TRUTH))
    nobody = Rollout(np.arange(2.0), np.zeros((0, 2, NODES, 3)), (), np.zeros(0, int), NODES)
    assert metric(seen_of(TRUTH), nobody).value.shape == (0,)
    lost = TRUTH.copy()
    lost[1, 3] = np.nan
    score = metric(seen_of(TRUTH), rollout(lost, TRUTH))
    assert np.isnan(score.value).tolist() == [True, False]
    if score.residual is not None:
        assert np.isnan(score.residual).any(axis=1).tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "options", "found"),
    [
        ("chamfer", {"unit": "px"}, "chamfer: unit is 'px', expected one of mm, cm, m"),
        ("hausdorff", {"share": 0}, "share is 0, expected above 0"),
        ("hausdorff", {"share": True}, "share is True"),
        ("hausdorff", {"share": float("nan")}, "share is nan"),
    ],
)
def test_options_that_mean_nothing_are_refused(name, options, found):
    with pytest.raises(ClothbenchError, match=found):
        made(name, **options)
