"""Tracker `stripes` and the metrics on its views: rendered sheets whose shape is known."""

import dataclasses

import numpy as np
import pytest
from clothbench_metrics.marked_edges import neighbours
from conftest import swinging_recording

from clothbench import (
    Camera,
    ClothbenchError,
    Observation,
    Projector,
    Recording,
    Rollout,
    Video,
    read_recording,
    write_recording,
)
from clothbench.plugins.discovery import catalogue
from clothbench.testing import check_tracker
from clothbench.vision.render import expose, silhouettes, striped
from clothbench.vision.surface import surface_of

CAMERA = Camera.looking_at((0, -1.2, 0.86), (0, 0, 0.86), (100, 104), 0.40)
PROJECTOR = Projector(Camera.looking_at((0, -1.2, 1.7), (0, 0, 0.86), (800, 800), 0.8), 20.0)
U, V = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 9), np.linspace(0, 0.3, 9)))
LATTICE, TIME = np.stack([U, V], axis=1), np.arange(6) / 30


def draped(depth, waves=2.0, sag=0.0):
    """A sheet (6, 81, 3) m with soft folds `depth` m deep, growing downwards and breathing with time."""
    breath = np.cos(4 * TIME)[:, None]
    y = depth * breath * np.sin(2 * np.pi * waves * U / 0.3) * V / 0.3
    return np.stack([np.broadcast_to(U - 0.15, y.shape), y, np.broadcast_to(1 - V * (1 + sag), y.shape)], axis=-1)


def recording(depth=0.02, **changes) -> Recording:
    fine = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 33), np.linspace(0, 0.3, 33))], axis=1)
    y = depth * np.cos(4 * TIME)[:, None] * np.sin(4 * np.pi * fine[:, 0] / 0.3) * fine[:, 1] / 0.3
    truth = np.stack(np.broadcast_arrays(fine[:, 0] - 0.15, y, 1 - fine[:, 1]), axis=-1)
    image, _ = striped(CAMERA, PROJECTOR, surface_of(fine), truth)
    video = Video(expose(image, np.random.default_rng(0), 4.0), CAMERA, PROJECTOR)
    held = np.array([[0.0, 0.0], [0.3, 0.0]])
    return swinging_recording(
        time=TIME, material=LATTICE, position=draped(depth), grip_time=TIME[[0, -1]], grip_material=held,
        grip_position=np.broadcast_to([[-0.15, 0, 1], [0.15, 0, 1.0]], (2, 2, 3)), cloth_width=0.3, cloth_height=0.3,
        **{"video": video, **changes},
    )  # fmt: skip


@pytest.fixture(scope="module")
def observation() -> Observation:
    return catalogue().make("trackers", "stripes").track(recording())


def rollout(*positions) -> Rollout:
    return Rollout(TIME, np.stack(positions), ("ok",) * len(positions), np.ones(len(positions), int), 81)


def test_a_recording_keeps_its_video(tmp_path):
    made = recording()
    path = write_recording(made, tmp_path / "a.nc")
    back = read_recording(path)
    np.testing.assert_array_equal(back.video.frame, made.video.frame)
    np.testing.assert_array_equal(back.video.camera.rotation, CAMERA.rotation)
    assert back.video.projector.period == 20.0
    assert back.hash == made.hash
    other = Video(255 - made.video.frame, CAMERA, PROJECTOR)
    assert dataclasses.replace(made, video=other).hash != made.hash
    assert "camera_matrix" not in back.notes


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        (lambda d: d.attrs.pop("camera_matrix"), "attribute 'camera_matrix' is missing"),
        (lambda d: d.attrs.update(camera_matrix="1 2 3"), "'camera_matrix': found '1 2 3', expected 9 finite numbers"),
        (lambda d: d.attrs.update(camera_rotation="2 0 0 0 1 0 0 0 1"), "camera: rotation is no proper rotation"),
        (lambda d: d.attrs.update(stripe_period=-1.0), "projector: period is -1"),
        (lambda d: d["frame"].attrs.update(units="grey"), "variable 'frame': found units 'grey', expected '1'"),
        (lambda d: d.update({"frame": d["frame"].astype("float32")}), "variable 'frame': found float64"),
    ],
)
def test_a_broken_video_is_one_line(tmp_path, damage, found):
    import xarray

    path = write_recording(recording(), tmp_path / "a.nc")
    with xarray.open_dataset(path, engine="h5netcdf", decode_times=False, mask_and_scale=False) as stored:
        dataset = stored.load()
    damage(dataset)
    dataset.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with pytest.raises(ClothbenchError, match=found) as caught:
        read_recording(tmp_path / "b.nc")
    assert "b.nc" in str(caught.value)


def test_frames_and_stamps_must_be_as_many():
    video = recording().video
    with pytest.raises(ClothbenchError, match="found 5 frames, expected 6, one for each 'time'"):
        recording(video=Video(video.frame[:5], CAMERA, PROJECTOR))


def test_the_tracker_keeps_the_rules():
    check_tracker(catalogue().load("trackers", "stripes"), source=recording())


def test_nodes_do_not_count_while_nobody_knows_where_the_grips_are():
    many, frames = np.arange(20) / 30, np.arange(20) % 6
    whole = recording()
    cut = dataclasses.replace(
        whole, time=many, position=whole.position[frames], grip_time=many[[0, -2]],
        video=dataclasses.replace(whole.video, frame=whole.video.frame[frames]),
    )  # fmt: skip
    seen = catalogue().make("trackers", "stripes").track(cut)
    assert seen.visible[:-1].all()
    assert not seen.visible[-1].any()
    assert np.allclose(seen.eye, CAMERA.place)


def test_the_silhouette_is_found_to_the_pixel(observation):
    truth = silhouettes(CAMERA, surface_of(LATTICE, 4), draped(0.02))
    wrong = np.count_nonzero(observation.view.silhouette != truth, axis=(1, 2))
    outline = 4 * np.sqrt(truth[0].sum())
    assert wrong.max() < 0.25 * outline  # a median rounds corners, and an edge falls between pixels


def test_folds_are_found_on_folds_only(observation):
    flat = catalogue().make("trackers", "stripes").track(recording(0.0))
    assert observation.view.fold.mean() > 0.05
    assert flat.view.fold.mean() < 0.01


def test_what_the_tracker_cannot_do_is_one_line():
    make = catalogue().make
    with pytest.raises(ClothbenchError, match="no video, which the tracker 'stripes' needs"):
        make("trackers", "stripes").track(swinging_recording())
    with pytest.raises(ClothbenchError, match="projector's calibration"):
        make("trackers", "stripes").track(recording(video=Video(recording().video.frame, CAMERA)))
    with pytest.raises(ClothbenchError, match="blur is 0, expected a number above 0"):
        make("trackers", "stripes", blur=0)


def test_the_right_shape_is_the_nearest(observation):
    """Depth of the folds is found through the video alone: the error is least at the truth, and grows on both sides."""
    metric, depths = catalogue().make("metrics", "fold"), np.array([0.0, 0.01, 0.02, 0.03, 0.04])
    score = metric(observation, rollout(*(draped(d) for d in depths)))
    assert np.argmin(score.value) == 2
    assert (np.diff(score.value) * [-1, -1, 1, 1] > 0).all()
    assert score.value[2] < 0.15 * score.value[0]
    np.testing.assert_allclose(score.value, score.per_frame.mean(axis=1))
    squares = (score.residual**2).sum(axis=1)
    assert np.argmin(squares) == 2


def test_angles_are_compared_modulo_pi(observation):
    """Level stripes stand at ±90°: were differences not wrapped, a flat sheet would be far from itself."""
    flat = catalogue().make("trackers", "stripes").track(recording(0.0))
    everywhere = dataclasses.replace(flat.view, fold=flat.view.silhouette)
    metric = catalogue().make("metrics", "fold", alpha=1e-9)
    score = metric(dataclasses.replace(flat, view=everywhere), rollout(draped(0.0)))
    assert score.value[0] / flat.view.silhouette[0].sum() < 0.05


def test_the_silhouette_has_its_weight(observation):
    """A sheet of the right folds that sags by 3 %: the outline's share of the error is α pixels each."""
    sagging = rollout(draped(0.02, sag=0.03))
    value = {a: catalogue().make("metrics", "fold", alpha=a)(observation, sagging).value[0] for a in (1e-9, 0.1, 1.0)}
    mismatch = catalogue().make("metrics", "silhouette")(observation, sagging).value[0]
    assert value[0.1] - value[1e-9] == pytest.approx(0.1 * mismatch)
    assert value[1.0] - value[1e-9] == pytest.approx(mismatch)
    share = catalogue().make("metrics", "silhouette", quantity="iou")(observation, sagging).value[0]
    assert 100 * mismatch / observation.view.silhouette[0].sum() == pytest.approx(share, rel=0.1)


def test_a_diverged_member_has_no_number_and_spoils_no_other(observation):
    lost = draped(0.03)
    lost[3:] = np.nan
    metric = catalogue().make("metrics", "fold")
    together = metric(observation, rollout(lost, draped(0.03)))
    assert np.isnan(together.value[0])
    assert together.value[1] == metric(observation, rollout(draped(0.03))).value[0]


def test_cloth_out_of_the_picture_has_no_count_of_folds(observation):
    """As many as a flat sheet: none; not even where it is out in one frame only."""
    gone, once = draped(0.02) + 5.0, draped(0.02)
    once[2] += 5.0
    score = catalogue().make("metrics", "fold_count")(observation, rollout(draped(0.02), gone, once))
    assert np.isfinite(score.value).tolist() == [True, False, False]
    assert np.isnan(score.per_frame[2]).tolist() == [False, False, True, False, False, False]


@pytest.mark.parametrize("name", ["node_error", "relative_error", "fold", "fold_count", "silhouette", "profile"])
def test_of_no_member_there_are_no_values(observation, name):
    empty = Rollout(TIME, np.zeros((0, len(TIME), 81, 3)), (), np.ones(0, int), 81)
    assert catalogue().make("metrics", name)(observation, empty).value.shape == (0,)


@pytest.mark.parametrize("name", ["node_error", "fold", "profile"])
def test_a_rollout_of_other_frames_is_refused(observation, name):
    short = Rollout(TIME[:2], draped(0.02)[None, :2], ("ok",), np.ones(1, int), 81)
    with pytest.raises(ClothbenchError, match="found a rollout of"):
        catalogue().make("metrics", name)(observation, short)


def test_the_map_of_relative_error_is_of_its_own_quantity():
    """Of one frame its root mean square is e_i; where all nodes are equally far off, each has the value."""
    random, truth = np.random.default_rng(4), draped(0.02)
    visible = random.random(truth.shape[:2]) < 0.8
    visible[3], visible[:, 7] = False, False
    seen = Observation(TIME, np.where(visible[..., None], truth, np.nan), visible, 1e-3, LATTICE)
    metric, wrong = catalogue().make("metrics", "relative_error"), truth + random.normal(0.0, 3e-3, truth.shape)
    score = metric(seen, rollout(wrong, np.where(np.arange(len(TIME))[:, None, None] == 4, np.nan, wrong)))
    assert np.isnan(score.per_node[0]).tolist() == (np.arange(81) == 7).tolist()
    assert np.isnan(score.per_node[1]).sum() > 1
    for t in np.flatnonzero(visible.any(axis=1)):
        once = dataclasses.replace(seen, visible=visible & (np.arange(len(TIME)) == t)[:, None])
        alone = metric(once, rollout(wrong))
        assert np.sqrt(np.nanmean(alone.per_node[0] ** 2)) == pytest.approx(alone.value[0])
    whole = dataclasses.replace(seen, position=truth, visible=np.ones_like(visible))
    equal = metric(whole, rollout(truth + np.array([0.0, 0.004, 0.003])))
    np.testing.assert_allclose(equal.per_node[0], equal.value[0])


@pytest.mark.parametrize(
    ("name", "told"), [("relative_error", {"quantity": "squares"}), ("relative_error_squares", {})]
)
def test_squares_are_what_the_paper_minimises(name, told):
    """L = Σ ‖φ − ϕ‖² over its frames (equation 2), whatever the origin; what was not seen has no part."""
    random, truth = np.random.default_rng(4), draped(0.02)
    visible = random.random(truth.shape[:2]) < 0.8
    visible[3], visible[:, 7] = False, False
    seen = Observation(TIME, np.where(visible[..., None], truth, np.nan), visible, 1e-3, LATTICE)
    metric, wrong = catalogue().make("metrics", name, **told), truth + random.normal(0.0, 3e-3, truth.shape)
    score = metric(seen, rollout(truth, wrong))
    assert (metric.unit, score.unit) == ("m^2", "m^2")
    assert score.value[0] == 0.0
    total = np.square(wrong - truth)[visible].sum()
    assert np.nansum(score.per_frame[1]) == pytest.approx(total)
    assert score.value[1] == pytest.approx(total / visible.any(axis=1).sum())
    assert (score.residual[1] ** 2).sum() == pytest.approx(total)
    assert np.isnan(score.per_frame[1]).tolist() == (np.arange(len(TIME)) == 3).tolist()
    assert np.isnan(score.per_node[1]).tolist() == (np.arange(81) == 7).tolist()
    assert metric.floor(seen) == pytest.approx(3 * 1e-6 * visible.sum() / visible.any(axis=1).sum())
    blind = dataclasses.replace(seen, visible=np.zeros_like(visible))
    assert np.isnan([*metric(blind, rollout(wrong)).value, metric.floor(blind)]).all()


def test_nodes_without_a_video_are_drawn_as_a_camera_would_see_them():
    o = catalogue().make("trackers", "markers").track(recording())
    score = catalogue().make("metrics", "fold")(o, rollout(*(draped(d) for d in (0.0, 0.02, 0.04))))
    assert score.value[1] == 0.0
    assert score.value[0] > 0
    assert score.value[2] > 0


def test_least_squares_can_follow_the_folds(observation):
    """The pooled residual is smooth enough to be descended: its slope at 0.03 m points back to the truth."""
    metric = catalogue().make("metrics", "fold")
    r = metric(observation, rollout(draped(0.029), draped(0.030), draped(0.031))).residual
    slope = (r[2] - r[0]) / 0.002
    step = -(slope @ r[1]) / (slope @ slope)
    assert 0.03 + step == pytest.approx(0.02, abs=0.006)


def test_edges_of_silhouettes_lie_as_far_apart_as_the_sheet_sags(observation):
    """Of an outline only the lower edge moves, and what is below it of the sides is new."""
    metric = catalogue().make("metrics", "silhouette", quantity="edge_distance")
    at_truth, sagging, further = metric(observation, rollout(*(draped(0.02, sag=s) for s in (0.0, 0.05, 0.1)))).value
    assert at_truth < 0.3  # px: the mesh is coarser than the truth's
    assert 0.5 < sagging < further
    # Pixels are 0.40 m / 100 wide; the lower edge, a quarter of the outline, sinks by 15 and 30 mm.
    assert further - at_truth == pytest.approx(30 / 4 / 4, rel=0.5)


def test_marked_lines_are_found_again_where_they_are(observation):
    metric = catalogue().make("metrics", "marked_edges")
    at_truth, shifted = metric(observation, rollout(draped(0.02), draped(0.02) + np.array([0.008, 0.0, 0.0]))).value
    assert at_truth == 0.0
    # Moved by 2 px to the right: upright lines lie that far from themselves, level ones on each other.
    assert 0.5 < shifted < 2.0
    unseen = dataclasses.replace(observation, visible=np.zeros_like(observation.visible))
    assert np.isnan(metric(unseen, rollout(draped(0.02))).value[0])


def test_a_rollout_that_left_the_picture_is_a_diagonal_away(observation):
    gone = draped(0.02) + np.array([5.0, 0.0, 0.0])
    for name, options in (("silhouette", {"quantity": "edge_distance"}), ("marked_edges", {})):
        value = catalogue().make("metrics", name, **options)(observation, rollout(draped(0.02), gone)).value
        assert value[1] == pytest.approx(np.hypot(100, 104))
        assert value[0] < 1.0


@pytest.mark.parametrize("name", ["fold", "fold_count", "silhouette", "marked_edges"])
def test_of_one_visible_place_no_picture_can_be_drawn(observation, name):
    once = np.zeros_like(observation.visible)
    once[2, 40] = True
    seen = dataclasses.replace(observation, view=None, visible=once)
    assert np.isnan(catalogue().make("metrics", name)(seen, rollout(draped(0.02))).value).all()


def test_only_neighbours_of_a_lattice_are_joined():
    """Rows may differ by less than is said of them; across a missing point there is no line."""
    lattice = np.stack([a.ravel() for a in np.meshgrid(np.arange(5) * 0.1, np.arange(4) * 0.1)], axis=1)
    rough = lattice + np.where(np.arange(20)[:, None] % 2, 4e-7, -4e-7) + 5e-7  # on both sides of a rounded number
    whole = {tuple(sorted(pair)) for pair in neighbours(lattice).tolist()}
    assert len(whole) == 4 * 4 + 5 * 3
    assert {tuple(sorted(pair)) for pair in neighbours(rough).tolist()} == whole
    holed = np.delete(lattice, 7, axis=0)  # an inner point, with four lines
    assert len(neighbours(holed)) == len(whole) - 4


def test_a_sheet_is_drawn_to_its_hems_where_its_nodes_do_not_reach():
    """Nodes 15 mm inside the hem: the silhouette fits best where the sheet is as long as it is."""
    inner = 0.015 + LATTICE * 0.9

    def at_inner(stretch):
        place = np.stack([inner[:, 0] - 0.15, 0 * inner[:, 0], 1 - stretch * inner[:, 1]], axis=-1)
        return np.broadcast_to(place, (6, *place.shape))

    marked = dataclasses.replace(recording(0.0), material=inner, position=at_inner(1.0))
    seen = catalogue().make("trackers", "stripes").track(marked)
    value = catalogue().make("metrics", "silhouette")(seen, rollout(*map(at_inner, (0.97, 1.0, 1.03, 1.06)))).value
    assert value.argmin() == 1
    assert value[1] < 60  # of 5600 px


def test_the_film_and_the_model_are_looked_at_with_one_threshold():
    seen = catalogue().make("trackers", "stripes", threshold=0.02).track(recording())
    usual, other = (
        catalogue().make("metrics", "fold_count", **options)(seen, rollout(draped(0.02))).value[0]
        for options in ({}, {"threshold": 0.02})
    )
    assert usual == other
    assert seen.view.threshold == 0.02


def test_folds_are_counted_wherever_they_are():
    """A sheet with as many folds elsewhere has the count of the one that was filmed, and half of them has not."""
    deep, fewer = draped(0.02, waves=3.0), draped(0.02, waves=1.0)
    aside = deep.copy()
    aside[..., 1] *= -1  # hills where there were valleys
    observed = dataclasses.replace(catalogue().make("trackers", "markers").track(recording()), position=deep)
    metrics = (catalogue().make("metrics", name) for name in ("fold_count", "fold"))
    scores = [metric(observed, rollout(deep, aside, fewer)) for metric in metrics]
    count, fold = (score.value for score in scores)
    np.testing.assert_allclose(np.abs(scores[0].per_frame.mean(axis=1)), count)
    assert scores[0].per_frame[2].mean() < 0
    assert count[0] == 0.0
    assert count[1] < 1.0 < count[2]
    assert fold[1] > 0.2 * fold[2]  # which `fold` takes for another sheet


def test_folds_are_counted_whenever_they_come():
    changing = np.concatenate([draped(0.02, waves=3.0)[:3], draped(0.02, waves=1.0)[3:]])
    observed = dataclasses.replace(catalogue().make("trackers", "markers").track(recording()), position=changing)
    score = catalogue().make("metrics", "fold_count")(observed, rollout(changing[::-1]))
    assert score.value[0] == 0.0
    assert score.per_frame[0, 0] < 0 < score.per_frame[0, -1]


@pytest.mark.parametrize(
    ("name", "options", "found"),
    [
        ("fold_count", {"least": 2}, "least is 2"),
        ("fold", {"alpha": -1}, "alpha is -1"),
        ("fold", {"alpha": 0.0}, "alpha is 0, expected a number above 0"),
        ("fold", {"alpha": float("inf")}, "alpha is inf"),
        ("fold", {"pixels": 3}, "pixels is 3"),
        ("fold", {"blur": "abc"}, "blur is 'abc'"),
        ("fold", {"threshold": -1}, "threshold is -1"),
        ("silhouette", {"pixels": "x"}, "silhouette: pixels is 'x'"),
        ("silhouette", {"quantity": "area"}, "quantity is 'area'"),
    ],
)
def test_wrong_options_are_one_line(name, options, found):
    with pytest.raises(ClothbenchError, match=found):
        catalogue().make("metrics", name, **options)
