"""`spectrum` beside swings whose frequency and decay are known."""

import dataclasses

import numpy as np
import pytest

from clothbench import Camera, ClothbenchError, Observation, Rollout
from clothbench.plugins.discovery import catalogue

TIME = np.arange(120) / 30.0  # s
GRID = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 4), np.linspace(0, 0.3, 4))], axis=1)


def made(**options):
    return catalogue().make("metrics", "spectrum", **options)


def hanging(frequency, decay, time=TIME, amplitude=0.04, phase=0.0, aside=0.0):
    """A sheet (T, N, 3) m that swings as a whole about where it hangs: Hz, 1/s."""
    q = amplitude * np.exp(-decay * time) * np.cos(2 * np.pi * frequency * time + phase)
    y = aside + q[:, None] * GRID[:, 1] / 0.3
    return np.stack([0 * y + GRID[:, 0], y, 1 - GRID[:, 1] + 0 * y], axis=-1)


def observed(position, time=TIME, visible=None, sigma=1e-3):
    visible = np.ones(position.shape[:2], bool) if visible is None else visible
    return Observation(time, np.where(visible[..., None], position, np.nan), visible, sigma, GRID)


def rollout(*position, time=TIME):
    members = len(position)
    return Rollout(time, np.stack(position), ("ok",) * members, np.zeros(members, int), len(GRID))


def pole(frequency, decay):
    return complex(-decay, 2 * np.pi * frequency)


def apart(frequency, decay, truth):
    """The value as it is defined, in percent."""
    return 100 * abs(pole(frequency, decay) - pole(*truth)) / abs(pole(*truth))


@pytest.mark.parametrize("truth", [(1.3, 0.4), (0.6, 0.0), (2.9, 1.5)])
def test_the_value_is_the_distance_of_the_poles(truth):
    others = [(truth[0], truth[1] + 0.3), (1.1 * truth[0], truth[1]), (0.7 * truth[0], truth[1] + 1.0)]
    metric, seen = made(since=0.0), observed(hanging(*truth))
    score = metric(seen, rollout(hanging(*truth), *(hanging(*other) for other in others)))
    assert score.value[0] < 1e-6
    assert score.value[1:] == pytest.approx([apart(*other, truth) for other in others], rel=0.01)
    trace = 100 * np.abs(np.exp(pole(*others[1]) * TIME) - np.exp(pole(*truth) * TIME))
    np.testing.assert_allclose(score.per_frame[2], trace, rtol=0.01, atol=0.01)


@pytest.mark.parametrize("more", [-1, 0, 1])
def test_there_may_be_as_many_frames_as_coordinates_of_all_nodes(more):
    time, truth, other = np.arange(3 * len(GRID) + more) / 30.0, (1.3, 0.4), (1.43, 0.4)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (len(time), len(GRID), 3))
    metric, seen = made(since=0.0), observed(hanging(*truth, time=time) + noise, time=time)
    score = metric(seen, rollout(hanging(*other, time=time), time=time))
    assert score.value[0] == pytest.approx(apart(*other, truth), rel=0.1)
    assert 0 < metric.floor(seen) < 1


def test_amplitude_phase_and_place_count_nothing():
    seen = observed(hanging(1.3, 0.4))
    same = hanging(1.3, 0.4, amplitude=0.01, phase=2.0, aside=0.05)
    assert made()(seen, rollout(same)).value[0] < 1e-6


def test_stamps_may_be_uneven_and_nodes_hidden_now_and_then():
    random = np.random.default_rng(3)
    time = np.sort(random.uniform(0.0, 4.0, 120))
    visible = random.random((120, len(GRID))) < 0.7
    visible[17], visible[:, 5] = False, False
    visible[30:, 9] = False  # too seldom to have a part in the pattern
    seen = observed(hanging(1.3, 0.4, time), time, visible)
    wrong = hanging(1.6, 0.9, time)
    wrong[:, 9] += np.sin(time)[:, None]
    score = made(since=0.0)(seen, rollout(hanging(1.3, 0.4, time), wrong, time=time))
    assert score.value[0] < 1e-6
    assert score.value[1] == pytest.approx(apart(1.6, 0.9, (1.3, 0.4)), rel=0.01)
    unknown = np.isnan(score.per_frame[1])
    assert unknown[17]
    assert unknown.mean() < 0.2  # where more than half of what moves was hidden


def test_the_floor_is_what_noise_gives():
    random, metric, truth = np.random.default_rng(4), made(), hanging(1.3, 0.4)
    noisy = [observed(truth + random.normal(0.0, 2e-3, truth.shape), sigma=2e-3) for _ in range(80)]
    drawn = np.mean([metric(seen, rollout(truth)).value[0] for seen in noisy])
    floors = [metric.floor(seen) for seen in noisy[:20]]
    assert np.mean(floors) == pytest.approx(drawn, rel=0.15)
    assert np.isnan(metric.floor(dataclasses.replace(noisy[0], sigma=np.nan)))
    other = metric(noisy[0], rollout(hanging(1.5, 0.4))).value[0]
    assert other == pytest.approx(apart(1.5, 0.4, (1.3, 0.4)), abs=4 * drawn)


def test_the_floor_is_higher_where_less_of_the_pattern_was_seen():
    """Three columns of four in each frame: q has the noise of three quarters of the nodes."""
    truth = hanging(1.3, 0.4)
    visible = np.arange(len(TIME))[:, None] % 4 != np.arange(len(GRID)) % 4
    whole, part = (made().floor(observed(truth, visible=seen, sigma=2e-3)) for seen in (None, visible))
    assert part == pytest.approx(whole / 0.75**0.5, rel=0.02)


def test_hands_that_move_first_are_left_out():
    """Driven at 0.9 Hz for 2 s, then free at 1.7 Hz."""
    time = np.arange(240) / 30.0
    driven, free = hanging(0.9, 0.0, time), hanging(1.7, 0.5, time - 2.0)
    seen, other = (np.where((time < 2)[:, None, None], driven, one) for one in (free, hanging(1.4, 0.5, time - 2.0)))
    told = made(since=2.0)(observed(seen, time), rollout(seen, other, time=time))
    assert told.value[0] < 1e-6
    assert told.value[1] == pytest.approx(apart(1.4, 0.5, (1.7, 0.5)), rel=0.01)
    assert np.isnan(told.per_frame[:, time < 2]).all()
    assert np.isfinite(told.per_frame[:, time >= 2]).all()


def test_unless_told_the_window_begins_with_the_largest_excursion():
    """Drawn aside in 1 s and let go."""
    time = np.arange(180) / 30.0
    free, pulled = hanging(1.3, 0.4, time - 1.0), hanging(0.0, 0.0, time) * [1, 0, 1]
    pulled[..., 1] = 0.04 * time[:, None] ** 2 * GRID[:, 1] / 0.3
    seen = np.where((time < 1)[:, None, None], pulled, free)
    score = made()(observed(seen, time), rollout(hanging(1.6, 0.4, time - 1.0), time=time))
    assert score.value[0] == pytest.approx(apart(1.6, 0.4, (1.3, 0.4)), rel=0.01)
    assert np.isnan(score.per_frame[0]).tolist() == (time < 1).tolist()


def test_a_swing_seen_in_a_picture_has_a_frequency_too():
    matrix = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    camera = Camera((640, 480), matrix, np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]), np.array([0.0, 0.8, 3.0]))
    truth, other = hanging(1.3, 0.4), hanging(1.6, 0.4)
    eye = -camera.rotation.T @ camera.translation
    nearer = eye + 0.5 * (truth - eye)  # any place on the lines of sight
    score = made()(dataclasses.replace(observed(nearer), sight=camera), rollout(truth, other))
    assert score.value[0] < 1e-6
    assert score.value[1] == pytest.approx(apart(1.6, 0.4, (1.3, 0.4)), rel=0.01)


def jitter():
    return hanging(0.0, 0.0) + np.random.default_rng(9).normal(0.0, 0.01, (len(TIME), len(GRID), 3))


@pytest.mark.parametrize(
    ("seen", "options"),
    [
        (observed(hanging(1.3, 0.4)), {"since": 3.8}),  # 6 frames
        (observed(hanging(1.3, 0.4)), {"since": 9.0}),
        (observed(hanging(0.2, 0.4)), {}),  # 0.8 of a period
        (observed(hanging(1.3, 0.4, amplitude=5e-4)), {}),  # below the noise
        (observed(jitter(), sigma=np.nan), {}),
        (observed(hanging(1.3, 0.4), visible=np.zeros((len(TIME), len(GRID)), bool)), {}),
    ],
    ids=["few frames", "no frames", "less than a period", "below noise", "no swing", "unseen"],
)
def test_there_is_no_value_where_the_seen_motion_tells_no_frequency(seen, options):
    metric = made(**options)
    score = metric(seen, rollout(hanging(1.3, 0.4)))
    assert np.isnan(score.value).all()
    assert np.isnan(score.per_frame).all()
    assert np.isnan(metric.floor(seen))


def test_rollouts_that_do_not_swing_or_are_lost_have_no_value_and_a_creeping_one_has():
    lost, gone = hanging(1.3, 0.4), hanging(1.3, 0.4)
    lost[60:], gone[60:] = np.nan, np.inf
    still, creeping = hanging(0.0, 0.0, amplitude=0.0), hanging(0.0, 3.0)
    score = made(since=0.0)(observed(hanging(1.3, 0.4)), rollout(lost, gone, still, jitter(), creeping))
    assert np.isnan(score.value).tolist() == [True, True, True, True, False]
    assert score.value[4] > 50
    nobody = Rollout(TIME, np.zeros((0, len(TIME), len(GRID), 3)), (), np.zeros(0, int), len(GRID))
    assert made()(observed(hanging(1.3, 0.4)), nobody).value.shape == (0,)


@pytest.mark.parametrize("since", ["late", True, float("nan"), [1.0]])
def test_a_since_that_is_no_time_is_refused(since):
    with pytest.raises(ClothbenchError, match=r"spectrum: since is .*, expected seconds"):
        made(since=since)
