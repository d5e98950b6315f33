"""Where and when something is left: found where it was put, and not in noise that is everywhere alike."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from clothbench import Observation, Scene
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.whereabouts import grip_phases, longer_than, when, where, whereabouts

SIDE, RECORDINGS = 0.3, 5


def recordings(seed: int, more=lambda time, place: 1.0, way=0.1, blank=0.0):
    """Noise of 1 mm on sheets whose grips move for two of four seconds, times `more` by time and place (0 to 1); no
    more is left by the fit, which has the motion right. blank: share of frames in which nothing was seen.
    """
    random = np.random.default_rng(seed)
    time, clock = np.arange(0.0, 4.0, 1 / 30), np.linspace(0.0, 4.0, 401)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, SIDE, 9), np.linspace(0, SIDE, 9)))
    material, out = np.stack([u, v], axis=1), []
    for number in range(RECORDINGS):
        away = (
            way * np.sin(np.pi * np.clip(clock - 1.0, 0.0, 2.0) * (1 + 0.1 * number)) ** 2 * (clock > 1) * (clock < 3)
        )
        held = np.array([[0.0, 0.0, 0.0], [SIDE, 0.0, 0.0]])
        path = held + np.stack([0 * away, away, 0 * away], axis=1)[:, None]
        scene = Scene(SIDE, SIDE, 0.2, clock, held[:, [0, 2]], path, time, material)
        swing = np.interp(time, clock, away)[:, None, None] * [0.0, 1.0, 0.0]
        position = np.stack([u, 0 * u, -v], axis=1) + swing
        visible = random.random((len(time), len(u))) > 0.02
        if blank:
            visible &= random.random((len(time), 1)) > blank
        size = np.array([[more(t, place) for place in material / SIDE] for t in time])
        field = 1e-3 * random.standard_normal((len(time), len(u), 3)) * size[..., None] * visible[..., None]
        seen = Observation(time, np.where(visible[..., None], position - field, np.nan), visible, 1e-3, material)
        out.append((seen, scene, field))
    return out


def telling(rows):
    return {row["part"] for row in rows if row["p_value"] < 0.05}


def test_noise_has_no_whereabouts():
    found = [telling(whereabouts(recordings(seed), 1e3, "mm", seed)) for seed in range(6)]
    assert sum(map(bool, found)) <= 1


@pytest.mark.parametrize("way", [0.0, 2e-3, 0.1])
def test_noise_of_what_was_measured_is_no_phase(way):
    """Where it makes positions jump, the cloth only seems to be fast, and just there much of it is left."""
    told = [when(recordings(seed, way=way), 1e3, "mm", seed) for seed in range(10)]
    assert sum(bool(telling(rows)) for rows in told) <= 1


def test_frames_in_which_nothing_was_seen_are_no_frames_without_an_error():
    told = [when(recordings(seed, blank=0.2), 1e3, "mm", seed) for seed in range(10)]
    assert sum(bool(telling(rows)) for rows in told) <= 1
    found = when(recordings(2, lambda t, place: 2.0 if t > 3.0 else 1.0, blank=0.2), 1e3, "mm", 0)
    assert "after the grips stopped" in telling(found)


def test_the_cloth_is_fast_where_the_fit_is():
    found = when(recordings(4, lambda t, place: 2.0 if 1.0 < t < 3.0 else 1.0), 1e3, "mm", 0)
    assert "the cloth is fast" in telling(found)
    assert "the cloth is slow" not in telling(found)


def test_a_part_of_the_cloth_is_told():
    rows = whereabouts(recordings(1, lambda t, place: 2.0 if place[0] > 0.7 and place[1] > 0.7 else 1.0), 1e3, "mm")
    assert telling(rows) == {"lower right"}
    one = next(row for row in rows if row["part"] == "lower right")
    assert one["rms"] == pytest.approx(2.0, rel=0.1)
    assert one["ratio"] == pytest.approx(2.0 / np.sqrt((72 + 9 * 4) / 81), rel=0.1)


def test_across_is_not_down():
    rows = where(recordings(1, lambda t, place: 2.0 if place[0] > 0.7 and place[1] < 0.3 else 1.0), 1e3, "mm")
    assert telling(rows) == {"upper right"}


def test_a_part_s_p_value_is_student_s_times_the_number_of_parts():
    """Of the logarithm of its mean square over that of all of the cloth, recording by recording."""
    seen = recordings(5, lambda t, place: 1.03 if place[0] > 0.7 and place[1] < 0.3 else 1.0)
    rows = {row["part"]: row for row in where(seen, 1e3, "mm")}
    down, across = (a.ravel() // 3 for a in np.indices((9, 9)))
    mine, ratio = (down == 0) & (across == 2), []
    for observation, _, field in seen:
        square, count = np.square(field).sum(axis=2), 3 * observation.visible
        ratio.append(square[:, mine].sum() / count[:, mine].sum() / (square.sum() / count.sum()))
    expected = 9 * ttest_1samp(np.log(ratio), 0.0, alternative="greater").pvalue
    assert 1e-6 < expected < 1
    assert rows["upper right"]["p_value"] == pytest.approx(expected)
    assert rows["upper right"]["ratio"] == pytest.approx(np.exp(np.mean(np.log(ratio)) / 2))


def test_a_phase_of_the_motion_is_told():
    rows = whereabouts(recordings(2, lambda t, place: 2.0 if t > 3.0 else 1.0), 1e3, "mm")
    assert "after the grips stopped" in telling(rows)
    assert "before the grips move" not in telling(rows)
    after = next(row for row in rows if row["part"] == "after the grips stopped")
    assert after["p_value"] == 1 / (1 + LOOP.permutations)  # as much as chance never does


def test_no_frame_is_in_two_phases_of_the_grips():
    seen, scene, _ = recordings(3)[0]
    phases = grip_phases(seen.time, scene)
    assert (np.sum(list(phases.values()), axis=0) <= 1).all()  # in none while they move evenly
    assert phases["before the grips move"][:25].all()
    assert phases["after the grips stopped"][-25:].all()


def test_of_grips_that_never_move_there_are_no_phases():
    seen, scene, _ = recordings(3)[0]
    still = dataclasses.replace(scene, grip_position=np.tile(scene.grip_position[:1], (len(scene.grip_time), 1, 1)))
    assert grip_phases(seen.time, still) == {}


def phases_of_way(way, blur=0.0, rate=100, seed=0):
    """How many frames are in each phase, of two grips that go a way (2, 3) m over time. blur: m, noise of their log;
    rate: Hz, of it.
    """
    clock, time = np.linspace(0.0, 6.0, 6 * rate + 1), np.arange(0.0, 6.0, 1 / 30)
    held = np.array([[0.0, 0.0, 0.0], [SIDE, 0.0, 0.0]])
    path = held + np.stack([way(t) for t in clock])
    path = path + blur * np.random.default_rng(seed).normal(size=path.shape)
    scene = Scene(SIDE, SIDE, 0.2, clock, held[:, [0, 2]], path, time, recordings(0)[0][1].points)
    return {name: int(frames.sum()) for name, frames in grip_phases(time, scene).items()}


def test_hands_that_part_and_meet_move():
    apart = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    found = phases_of_way(lambda t: 0.05 * np.sin(5 * t) * apart)
    assert min(found["the grips speed up"], found["the grips slow down"]) > 40


def test_grips_that_stand_still_for_long_pause_and_do_not_turn():
    found = phases_of_way(lambda t: np.interp(t, [0.5, 1.5, 4.5, 5.5], [0.0, 0.2, 0.2, 0.4]) * np.eye(3)[[1, 1]])
    assert found["the grips pause"] > 80
    assert found["the grips turn"] == 0


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_grips_log_is_no_motion(seed):
    """It came before the first motion and after the last, and these phases vanished."""

    def way(t):
        return 0.6 * np.interp(t, [1.0, 4.0], [0.0, 1.0]) * np.eye(3)[[1, 1]]

    exact, blurred = phases_of_way(way), phases_of_way(way, 1e-3, 30, seed)
    assert blurred["the grips turn"] + blurred["the grips pause"] <= 5
    for name in ("before the grips move", "after the grips stopped"):
        assert blurred[name] == pytest.approx(exact[name], abs=4)
    assert phases_of_way(lambda t: np.zeros((2, 3)), 1e-3, 30, seed) == {}


def test_a_stretch_of_frames_lasts_as_long_as_its_stamps_say():
    time = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.8, 1.2, 1.6])
    frames = np.array([True, True, True, False, True, True, False, True])
    assert longer_than(0.3, time, frames).tolist() == [False, False, False, False, True, True, False, False]


def test_grips_that_move_evenly_neither_speed_up_nor_slow_down():
    found = phases_of_way(lambda t: 0.1 * np.array([[np.cos(6 * t), np.sin(6 * t), 0.0]] * 2))
    assert found["the grips speed up"] + found["the grips slow down"] < 10


def test_grips_that_stand_still_in_some_recordings_have_their_phases_in_the_others():
    seen = recordings(2, lambda t, place: 2.0 if t > 3.0 else 1.0)
    observation, scene, field = seen[0]
    still = np.tile(scene.grip_position[:1], (len(scene.grip_time), 1, 1))
    seen[0] = (observation, dataclasses.replace(scene, grip_position=still), field)
    assert "after the grips stopped" in telling(whereabouts(seen, 1e3, "mm"))
