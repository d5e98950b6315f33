"""Drapes from above: recordings of kind "silhouette", the tracker and the metric `drape`, and the importer."""

import dataclasses
import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from clothbench_metrics.drape import Drape as DrapeMetric
from clothbench_metrics.drape import curve_distances, transported
from clothbench_trackers.drape import Drape as DrapeTracker

from clothbench import ClothbenchError, Outlines, Rollout, Silhouettes, outline_in, outlines_of_points, read_silhouettes
from clothbench import write_silhouettes as write
from clothbench.core.drape import RINGS, SPOKES, drape_coefficient, drape_points
from clothbench.core.optional import textile_of
from clothbench.datasets.cusick_drape_bdp import SHOT, Shot, convert, side_of, split_of
from clothbench.engine.settings import scene_settings
from clothbench.estimation.placements import joined
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.scenes import scene_of, scenes_of
from clothbench.studies.calibration.settings import suite_settings
from clothbench.testing import check_metric, rule_names
from clothbench.vision.drape import centroid, darkness, drape_quantities, folds_of, smoothed

PIXEL, PLATE, DISC = 1.4e-3, 0.09, 0.15
TURN = 2 * np.pi * np.arange(360) / 360


def petals(folds, depth=0.012, mean=0.125, phase=0.3):
    """r(φ) [m] of an outline with so many even folds."""
    return mean + depth * np.cos(folds * TURN + phase)


def rendered(radius, pixels=256, middle=(126.4, 125.7)):
    """A soft picture of an outline r(φ) (360,) m: each pixel as dark as its share of cloth, by 4 × 4 points."""
    at = (np.arange(4 * pixels) + 0.5) / 4 - 0.5
    x, y = np.meshgrid(at - middle[0], middle[1] - at)
    bound = np.interp(np.arctan2(y, x) % (2 * np.pi), np.append(TURN, 2 * np.pi), np.append(radius, radius[0]))
    cloth = (np.hypot(x, y) * PIXEL <= bound).reshape(pixels, 4, pixels, 4).mean(axis=(1, 3))
    return np.round(255 * (1 - cloth)).astype(np.uint8)


def captures_of(outlines, **changes):
    count = len(outlines)
    fields = {
        "name": "petals/fit", "fabric": "petals", "image": np.stack([rendered(r) for r in outlines]),
        "sample": np.arange(count) // 2, "side": np.zeros(count), "pixel_size": PIXEL, "disc_radius": DISC,
        "plate_radius": PLATE, "areal_density": 0.2, "split": "fit",
    }  # fmt: skip
    return Silhouettes(**fields | changes)


def drape_with(radius):
    """Positions (N, 3) m of `drape_points` whose rim lies at r(φ), rings evenly between."""
    rim = radius[:: 360 // SPOKES]
    turn = TURN[:: 360 // SPOKES]
    rings = PLATE + np.linspace(0, 1, RINGS)[:, None] * (rim - PLATE)
    flat = np.stack([rings * np.cos(turn), rings * np.sin(turn), 0 * rings], axis=-1)
    return flat.reshape(-1, 3)


# --- outlines and folds -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("folds", [4, 7, 12])
def test_an_outline_is_found_to_a_third_of_a_pixel(folds):
    radius = petals(folds)
    found = outline_in(rendered(radius), PIXEL, centre=(126.4, 125.7))
    assert np.sqrt(np.mean((found - radius) ** 2)) < 0.35 * PIXEL
    assert np.abs(found - radius).max() < 1.2 * PIXEL
    about = outline_in(rendered(radius), PIXEL)  # about its centroid
    assert np.sqrt(np.mean((about - radius) ** 2)) < 0.4 * PIXEL


def noisy(picture, dark, ground, noise):
    """A picture whose shape and ground have these greys, with noise."""
    grey = ground - (ground - dark) * (1 - picture / 255.0)
    return np.clip(np.round(grey + np.random.default_rng(0).normal(0, noise, grey.shape)), 0, 255).astype(np.uint8)


def test_noise_moves_neither_the_middle_nor_the_edge():
    radius, middle = petals(6, mean=0.115), (160.0, 127.5)
    picture = cv2.GaussianBlur(rendered(radius, middle=middle), (0, 0), 2.0)
    true = drape_coefficient(radius, PLATE, DISC)
    found = noisy(picture, 100, 200, 12.0)
    assert centroid(darkness(found)) == pytest.approx(middle, abs=0.15)
    assert drape_coefficient(outline_in(found, PIXEL, centre=middle), PLATE, DISC) == pytest.approx(true, abs=5e-3)


def test_a_shadow_may_be_darker_than_its_ground_by_little():
    grey = noisy(rendered(petals(6)), 20, 120, 2.0)
    seen = DrapeTracker().track(captures_of([petals(6)], image=grey[None]))
    expected = drape_coefficient(petals(6), PLATE, DISC)
    assert seen.outlines.coefficient()[0] == pytest.approx(expected, abs=0.01)


def test_a_centre_beside_the_shadow_is_refused():
    drapes = captures_of([petals(6)])
    with pytest.raises(ClothbenchError, match=r"capture 0: found no shadow at centre=\[10\.0, 10\.0\]"):
        DrapeTracker(centre=(10.0, 10.0)).track(drapes)
    with pytest.raises(ClothbenchError, match=r"found no shadow at centre=\[1000\.0, 1000\.0\]"):
        DrapeTracker(centre=(1000.0, 1000.0)).track(drapes)
    for centre in (5, "ab", True, (1.0, np.nan)):
        with pytest.raises(ClothbenchError, match=r"drape: centre is .*, expected \[x,y\] in pixels"):
            DrapeTracker(centre=centre)


def test_the_ground_need_not_be_white():
    radius, white = petals(7), rendered(petals(7), middle=(110.3, 139.8))
    grey = np.round(white * (200 / 255)).astype(np.uint8)
    assert centroid(darkness(grey)) == pytest.approx(centroid(darkness(white)), abs=0.05)
    assert np.sqrt(np.mean((outline_in(grey, PIXEL) - radius) ** 2)) < 0.4 * PIXEL


def test_dust_beside_the_cloth_is_no_cloth():
    picture = rendered(np.full(360, 0.09))
    clean = outline_in(picture, PIXEL)
    picture[8:11, 8:11] = 0
    assert np.array_equal(outline_in(picture, PIXEL), clean)


def test_pictures_of_a_large_camera_are_read():
    y, x = np.ogrid[:40, :9000]
    picture = np.where((x - 4500) ** 2 + (y - 20) ** 2 < 15**2, 0, 255).astype(np.uint8)
    assert outline_in(picture, 1.0) == pytest.approx(np.full(360, 15.0), abs=1.0)


def test_the_drape_coefficient_is_cusicks():
    assert drape_coefficient(np.full(360, PLATE), PLATE, DISC) == pytest.approx(0.0)
    assert drape_coefficient(np.full(360, DISC), PLATE, DISC) == pytest.approx(1.0)
    radius = petals(6)
    area = np.pi * (0.125**2 + 0.012**2 / 2)
    expected = (area - np.pi * PLATE**2) / (np.pi * (DISC**2 - PLATE**2))
    assert drape_coefficient(radius, PLATE, DISC) == pytest.approx(expected)
    found = outline_in(rendered(radius), PIXEL)
    assert drape_coefficient(found, PLATE, DISC) == pytest.approx(expected, abs=4e-3)


@pytest.mark.parametrize("folds", [2, 5, 11])
def test_even_folds_are_counted_and_measured(folds):
    coefficient, count, depth, unevenness = drape_quantities(petals(folds), PLATE, DISC)
    assert count == folds
    assert depth == pytest.approx(0.024, rel=0.01)  # what finds the folds takes 4 % of eleven
    assert unevenness < 0.02
    assert 0 < coefficient < 1


@pytest.mark.parametrize("noise", [0.0, 12.0, 24.0])
def test_noise_of_a_picture_makes_folds_neither_deeper_nor_flatter(noise):
    picture = noisy(cv2.GaussianBlur(rendered(petals(10, depth=0.008)), (0, 0), 0.7), 20, 240, noise)
    _, count, depth, _ = drape_quantities(outline_in(picture, PIXEL), PLATE, DISC)
    assert count == 10
    assert depth == pytest.approx(0.016, abs=0.3e-3)


def test_a_single_fold_is_as_deep_as_the_outline_goes():
    one = 0.125 + 0.02 * np.exp(-((TURN - 1.0) ** 2) / 0.05)
    assert drape_quantities(one, PLATE, DISC)[1:] == pytest.approx([1, 0.02, 0], abs=1e-4)


def test_uneven_folds_are_said_to_be():
    warped = 0.125 + 0.012 * np.cos(6 * (TURN + 0.25 * np.sin(TURN)))
    assert drape_quantities(warped, PLATE, DISC)[3] == pytest.approx(0.18, abs=0.05)


def test_what_is_no_deeper_than_a_tremble_is_no_fold():
    assert drape_quantities(petals(7, depth=0.0005), PLATE, DISC)[1:].tolist() == [0, 0, 0]
    peaks, prominence = folds_of(smoothed(petals(5, depth=0.004)))
    assert len(peaks) == 5
    assert prominence == pytest.approx(np.full(5, 0.008), rel=0.05)


def test_simulated_drapes_have_the_outline_of_their_rim():
    radius = petals(6)
    drapes = np.stack([drape_with(radius), drape_with(petals(9))])[None]
    found = outlines_of_points(drapes, (0.0, 0.0, 0.0), PLATE)
    assert found.shape == (1, 2, 360)
    assert found[0, 0] == pytest.approx(radius, abs=2e-4)
    lost = drapes.copy()
    lost[0, 1, 5] = np.nan
    assert np.isnan(outlines_of_points(lost, (0, 0, 0), PLATE)[0, 1]).all()
    under = drape_with(np.full(360, 0.05))  # a rim under the plate leaves the plate's shadow
    assert outlines_of_points(under, (0, 0, 0), PLATE) == pytest.approx(PLATE)


def test_the_tracker_shows_its_steps():
    drapes = captures_of([petals(6), petals(7)])
    tracker = DrapeTracker()
    shown = tracker.pictures(drapes, 1, tracker.track(drapes))
    assert list(shown) == ["shadow", "outline and plate", "folds"]
    assert all(p.dtype == np.uint8 and p.shape == (512, 512, 3) for p in shown.values())


# --- the metric -------------------------------------------------------------------------------------------------------


def rollout(*outlines):
    position = np.stack([np.stack([drape_with(r) for r in member]) for member in outlines])
    count = len(outlines)
    return Rollout(np.arange(float(position.shape[1])), position, ("ok",) * count, np.ones(count), 100)


def test_the_metric_compares_distributions_not_single_drapes():
    captured = [petals(n, phase=k) for k, n in enumerate([6, 7, 7, 8, 7, 7])]
    seen, metric = DrapeTracker().track(captures_of(captured)), DrapeMetric()
    same = [petals(n, phase=2.0 * k) for k, n in enumerate([7, 6, 8, 7])]  # other captures of the same cloth
    five = [petals(5)] * 4
    limp = [petals(7, mean=0.11)] * 4
    score = metric(seen, rollout(same, five, limp))
    assert score.value.argmin() == 0
    assert score.value[0] < 0.3
    names = [o.name for o in metric.objectives]
    assert names == ["drape_coefficient", "folds", "depth", "unevenness"]
    assert score.objectives[1, 1] == pytest.approx(2.0, abs=0.1)  # Wasserstein's distance from 5 to about 7
    assert score.objectives[2, 0] == pytest.approx(100 * (0.125**2 - 0.11**2) / (DISC**2 - PLATE**2), abs=0.6)
    assert score.value == pytest.approx(np.sqrt(np.mean((score.objectives / score.spread) ** 2, axis=1)))
    low, high = metric.interval(seen, rollout(five), 1)
    assert low < score.value[1] < high
    alike = rollout(captured)  # chance puts nearly every draw above it
    low, high = metric.interval(seen, alike, 1)
    assert 0.0 <= low < 0.8 * metric(seen, alike).value[0] < high


def test_an_interval_needs_two_specimens_and_two_first_shapes():
    outlines, metric = [petals(n, phase=k) for k, n in enumerate([6, 7, 7, 8])], DrapeMetric()
    several = DrapeTracker().track(captures_of(outlines))
    single = DrapeTracker().track(captures_of(outlines, sample=np.zeros(4)))
    low, high = metric.interval(several, rollout([petals(7), petals(6)]), 0)
    assert 0 <= low < high  # of two only: Student's t of 12.7
    assert high - metric(several, rollout([petals(7), petals(6)])).value[0] > 1.0
    assert np.isnan(metric.interval(several, rollout([petals(7)]), 0)).all()
    assert np.isnan(metric.interval(single, rollout([petals(7), petals(6)]), 0)).all()
    assert np.isnan(metric.floor(single))


def drawn_captures(random, specimens, each):
    """Outlines of captures of specimens that differ in size by 4 mm, as do the captures of each by 3 mm."""
    size = np.repeat(random.normal(0.122, 4e-3, specimens), each) + random.normal(0.0, 3e-3, specimens * each)
    radius = np.stack([petals(7, mean=m, phase=p) for m, p in zip(size, random.uniform(0, 6, len(size)), strict=True)])
    return Outlines(radius, PLATE, DISC, np.repeat(np.arange(specimens), each), 1e-4, PIXEL)


@pytest.mark.parametrize(("quantity", "times"), [("drape_coefficient", 40), ("curve_distance", 12)])
def test_the_floor_is_what_the_fabrics_own_drapes_score(quantity, times):
    random, metric = np.random.default_rng(0), DrapeMetric([quantity])
    scored, floors = [], []
    for _ in range(times):
        seen, own = drawn_captures(random, 5, 3), drawn_captures(random, 4, 1)
        of = DrapeTracker().track(captures_of([petals(7)]))
        there = dataclasses.replace(
            of, outlines=seen, time=np.arange(15.0), position=np.repeat(of.position, 15, axis=0),
            visible=np.repeat(of.visible, 15, axis=0),
        )  # fmt: skip
        scored.append(metric(there, rollout(own.radius)).value[0])
        floors.append(metric.floor(there))
    assert np.mean(floors) == pytest.approx(np.mean(scored), rel=0.2)


def test_spreads_are_those_between_captures_and_between_outlines_of_different_specimens():
    """Rings of two specimens, 4 mm apart in each: 10, 14, 6 and 10 mm from those of the other."""
    rings = np.array([0.12, 0.124, 0.13, 0.134])
    seen = Outlines(np.repeat(rings[:, None], 360, axis=1), PLATE, DISC, np.array([0, 0, 1, 1]), 1e-4, PIXEL)
    of = DrapeTracker().track(captures_of([petals(7)]))
    there = dataclasses.replace(
        of, outlines=seen, time=np.arange(4.0), position=np.repeat(of.position, 4, axis=0),
        visible=np.repeat(of.visible, 4, axis=0),
    )  # fmt: skip
    score = DrapeMetric(["drape_coefficient", "curve_distance"])(there, rollout([np.full(360, 0.12)]))
    covers = 100 * (rings**2 - PLATE**2) / (DISC**2 - PLATE**2)
    assert score.spread == pytest.approx([np.std(covers, ddof=1), 10.0])
    less = (covers[0] - covers.mean()) / np.std(covers, ddof=1)  # simulated minus captured
    assert score.residual[0, 0] == pytest.approx(less / 2**0.5, rel=0.02)


def test_outlines_are_compared_after_the_best_rotation():
    """Beside every rotation tried in turn; an outline that is not known is far from none and near to none."""
    some, others = (
        np.stack([petals(n, depth=d, phase=p) for n, d, p in which])
        for which in ([(6, 0.01, 0.3), (7, 0.012, 2.0)], [(7, 0.01, 1.0), (6, 0.01, 1.7), (5, 0.004, 0.0)])
    )
    tried = [np.sqrt(np.mean((np.roll(some, k, axis=1)[:, None] - others) ** 2, axis=-1)) for k in range(360)]
    found = curve_distances(some, others)
    np.testing.assert_allclose(found, np.min(tried, axis=0), rtol=1e-9)
    assert found[0, 1] < 4e-4 < found[0, 0]  # the same petals, turned by half an angle more than can be
    np.testing.assert_allclose(curve_distances(some, others[:, ::2]), found, atol=1e-4)
    assert np.isnan(curve_distances(np.full((1, 360), np.nan), others)).all()
    assert transported(np.array([[0.0, 4.0, 1.0], [4.0, 0.0, 2.0]])) == pytest.approx((1.0 + 2.0) / 6)


def test_the_metric_compares_whole_outlines_if_asked():
    """Of as many folds, as deep, over as much of the ring: what is left is where they lie, from one to the next."""
    seen = DrapeTracker().track(captures_of([petals(7, phase=p) for p in (0.0, 1.0, 2.0, 3.0)]))
    metric = DrapeMetric(quantities=["curve_distance"])
    assert [(o.name, o.unit) for o in metric.objectives] == [("curve_distance", "mm")]
    score = metric(seen, rollout([petals(7, phase=0.6)] * 2, [petals(7, mean=0.12, phase=0.6)] * 2, [petals(5)] * 2))
    assert score.objectives[0, 0] < 0.3
    assert score.objectives[1, 0] == pytest.approx(5.0, abs=0.3)  # mm, by which it is smaller all around
    assert score.objectives[2, 0] > 1.0
    assert score.value == pytest.approx(score.objectives[:, 0] / score.spread[0])
    assert (score.residual[:, 0] == score.value).all()
    assert score.per_frame is None
    both = DrapeMetric(quantities=["curve_distance", "folds"])(seen, rollout([petals(5)] * 2))
    assert both.objectives[0] == pytest.approx([2.0, score.objectives[2, 0]])
    low, high = metric.interval(seen, rollout([petals(7), petals(5)]), 0)
    assert 0 <= low < high
    lost = rollout([petals(7)] * 2, [petals(7), np.full(360, np.nan)])
    assert np.isfinite(metric(seen, lost).value).tolist() == [True, False]


def test_the_metric_of_whole_outlines_keeps_the_rules_of_the_kit():
    assert {o.rule for o in check_metric(partial(DrapeMetric, ["curve_distance"]))} == set(rule_names("metrics"))


def test_the_metric_takes_some_quantities_only():
    seen = DrapeTracker().track(captures_of([petals(6), petals(7), petals(7), petals(6)]))
    metric = DrapeMetric(quantities=["drape_coefficient"])
    assert metric(seen, rollout([petals(12)])).objectives.shape == (1, 1)
    with pytest.raises(ClothbenchError, match="quantities is"):
        DrapeMetric(quantities=["colour"])
    with pytest.raises(ClothbenchError, match="quantities is 5, expected some of"):
        DrapeMetric(quantities=5)
    with pytest.raises(ClothbenchError, match="shows no drapes"):
        metric(dataclasses.replace(seen, outlines=None), rollout([petals(6)]))


# --- files ------------------------------------------------------------------------------------------------------------


def test_a_recording_is_read_as_it_was_written(tmp_path):
    drapes = captures_of([petals(6), petals(7)], notes={"who": "the kit"})
    path = write(drapes, tmp_path / "petals.nc")
    again = read_sheet(path)
    assert again.hash == drapes.hash
    assert again.notes == {"who": "the kit"}
    assert np.array_equal(read_silhouettes(path).image, drapes.image)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"pixel_size": 2.8e-3}, "found a shadow of"),
        ({"pixel_size": 0.01}, "20 pixels across the plate's radius"),
        ({"disc_radius": 0.08}, "expected more than plate_radius"),
        ({"plate_radius": np.nan}, "attribute 'plate_radius'"),
        ({"side": np.array([0, 3])}, "variable 'side': found 3"),
        ({"areal_density": -1.0}, "attribute 'areal_density'"),
        ({"areal_density": 220.0}, "expected kg/m² above 0, 5 at most"),
        ({"disc_radius": 1e200}, "attribute 'disc_radius'"),
        (
            {"pixel_size": 1.4, "disc_radius": 150.0, "plate_radius": 90.0},
            "'disc_radius': found 150 m, expected 2 m at m",
        ),
        ({"pixel_size": 0.14, "disc_radius": 15.0, "plate_radius": 9.0}, "found 15 m, expected 2 m .* centimetres"),
        ({"thickness": 0.5}, "'thickness': found 0.5 m, expected 0.03 m at most of a cloth 0.3 m across"),
        ({"pixel_size": "x"}, "attribute 'pixel_size': found 'x', expected a number"),
        ({"sample": np.array([0.5, 1.0])}, "variable 'sample': found other values than whole numbers"),
        ({"split": "test"}, "attribute 'split'"),
        ({"sample": np.array([1])}, "found 1 along 'capture', expected 2"),
        ({"name": ""}, "attribute 'name'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(changes, says):
    with pytest.raises(ClothbenchError, match=says) as fault:
        captures_of([petals(6), petals(7)], **changes)
    assert "\n" not in str(fault.value)


def test_a_bright_cloth_and_one_cut_off_are_refused():
    image = np.stack([rendered(petals(6))])
    with pytest.raises(ClothbenchError, match="that the cloth is dark"):
        captures_of([petals(6)], image=255 - image)
    with pytest.raises(ClothbenchError, match="reaches the picture's border"):
        captures_of([petals(6)], image=np.roll(image, 50, axis=2))


def test_two_shadows_are_refused():
    """Each of them smaller than the plate, both together larger; and one cloth with half of another beside it."""
    y, x = np.mgrid[:256, :256]

    def shadows(*discs):
        dark = np.any([np.hypot(x - at, y - 128) < radius / PIXEL for at, radius in discs], axis=0)
        return np.where(dark, 0, 255).astype(np.uint8)[None]

    with pytest.raises(ClothbenchError, match=r"found a shadow of 17\d cm² in capture 0"):
        captures_of([petals(6)], image=shadows((68, 0.075), (188, 0.075)))
    with pytest.raises(ClothbenchError, match=r"found several shadows in capture 0, 8\d% of all"):
        captures_of([petals(6)], image=shadows((90, 0.1), (215, 0.045)))


# --- scenes -----------------------------------------------------------------------------------------------------------


def test_a_drapemeter_is_simulated_from_several_first_shapes():
    scenes = scenes_of(captures_of([petals(6)]), starts=3, thickness=5e-4, spacing=0.02)
    assert len(scenes) == 3
    first, second, _ = scenes
    assert first.width == first.height == 2 * DISC
    assert first.resolution == (16, 16)
    assert first.thickness == 5e-4
    assert first.obstacles[0].clamps
    assert first.obstacles[0].radius == PLATE
    assert np.array_equal(first.points, drape_points(PLATE, DISC))
    assert not np.array_equal(first.start, second.start)
    rim = np.concatenate([s.start[-SPOKES:, 2] for s in scenes_of(captures_of([petals(6)]), starts=40)])
    assert np.sqrt(np.mean(rim**2)) == pytest.approx(2e-3, rel=0.15)
    assert np.array_equal(second.start, scenes_of(captures_of([petals(6)]))[1].start)


def test_settings_of_the_other_kind_are_refused():
    with pytest.raises(ClothbenchError, match="says nothing to recordings of kind 'silhouette'"):
        scenes_of(captures_of([petals(6)]), start="measured")
    with pytest.raises(ClothbenchError, match="'areal_density' is not known"):
        scenes_of(captures_of([petals(6)], areal_density=np.nan))


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        ({"outline": [[0, 0], [1, 1]]}, "three corners"),
        ({"outline": [[0, 0], [1, 1], [1]]}, "a corner that is not"),
        ({"obstacles": {"shape": "plane"}}, "expected a list"),
        ({"obstacles": [{"radius": 1}]}, "states no shape"),
        ({"obstacles": [{"shape": "cone"}]}, "shape is 'cone'"),
        ({"obstacles": [{"shape": "plane", "centre": [0, 0]}]}, r"centre is \(0, 0\), expected three finite numbers"),
        ({"obstacles": [{"shape": "plane", "centre": ["a", 0, 0]}]}, "centre is .* expected three finite numbers"),
        ({"obstacles": [{"shape": "plane", "centre": [0, 0, float("nan")]}]}, "centre is .*nan.*three finite numbers"),
        ({"obstacles": [{"shape": "plane", "normal": [0, 1]}]}, "normal is .* expected three finite numbers"),
        ({"obstacles": [{"shape": "disc", "radius": 0.1, "clamps": "no"}]}, "clamps is 'no', expected true or false"),
        ({"obstacles": [{"shape": "plane", "height": 1}]}, "'height' is not known"),
        ({"thickness": -1}, "setting 'scene.thickness' is -1, expected a number, at least 0$"),
        ({"starts": 0}, "scene.starts"),
    ],
)
def test_supports_in_settings_are_checked(scene, says):
    with pytest.raises(ClothbenchError, match=says):
        scene_settings(scene)


def test_supports_in_settings_reach_the_scene(recording):
    told = scene_settings({"obstacles": [{"shape": "sphere", "centre": [0, 0, -1], "radius": 0.2}], "thickness": 1e-3})
    scene = scene_of(recording, **told)
    assert scene.obstacles[0].centre == (0, 0, -1)
    assert scene.thickness == 1e-3


def test_placements_are_frames_of_one_rollout():
    from clothbench_models.mass_spring import MassSpring

    model = MassSpring()
    simulation = joined([model.prepare(s) for s in scenes_of(captures_of([petals(6)]), starts=2, spacing=0.03)])
    theta = model.parameters.defaults[None].repeat(2, axis=0)
    run = simulation.run(theta)
    assert run.position.shape == (2, 2, RINGS * SPOKES, 3)
    assert run.status == ("ok", "ok")
    assert run.time.tolist() == [0.0, 1.0]
    assert np.array_equal(run.position[0], run.position[1])


def test_a_member_is_as_well_as_the_worst_of_its_placements():
    def of(position, status, steps, reasons):
        run = Rollout(np.zeros(1), np.full((2, 1, 1, 3), position), status, np.array(steps), 4, reasons)
        return SimpleNamespace(run=lambda theta: run)

    placed = joined([of(1.0, ("ok", "ok"), [3, 4], ("", "")), of(2.0, ("timeout", "ok"), [5, 7], ("slow", ""))])
    run = placed.run(np.zeros((2, 1)))
    assert (run.status, run.reasons, run.nodes) == (("timeout", "ok"), ("slow", ""), 4)
    assert run.steps.tolist() == [8, 11]  # of all placements: that is the work that was done
    assert run.position[:, :, 0, 0].tolist() == [[1.0, 2.0]] * 2


# --- the importer -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cusick(data_dir, tmp_path_factory):
    source = data_dir / "cusick-drape-bdp"
    if not source.is_dir():
        pytest.skip(f"{source} is not there")
    out = tmp_path_factory.mktemp("cusick")
    convert(source, out)
    return out


@pytest.mark.parametrize(
    ("name", "fabric", "side"),
    [("sample_7_upward_drape_1_Obs_5", "cotton_white", 1), ("Wool_Red_Sample_1_Downward_Drape_1", "wool_red", 2),
     ("Fabric_2_Sample_1_Capture_3", "cotton_blue", 2), ("Fabric_9_Sample_1_Capture_1", "fabric_09", 0)],
)  # fmt: skip
def test_a_side_is_what_the_name_says_or_the_place_among_named_captures(name, fabric, side):
    number = int(SHOT.search(name)["number"])
    assert side_of(Shot(Path(f"{name}.jpg"), fabric, 1, number, "")) == side


@pytest.mark.parametrize(("specimens", "held_out"), [(2, None), (3, {3}), (4, {4}), (6, {5, 6}), (8, {6, 7, 8})])
def test_the_last_third_of_the_specimens_is_held_out_with_all_its_captures(specimens, held_out):
    shots = [Shot(Path("x.jpg"), "wool_red", s, n, "") for s in range(1, specimens + 1) for n in (1, 2, 3)]
    found = {split: [s.sample for s in some] for split, some in split_of(shots).items()}
    if held_out is None:
        assert found == {"": [s.sample for s in shots]}
    else:
        assert found["held_out"] == sorted([*held_out] * 3)
        assert found["fit"] == [s.sample for s in shots if s.sample not in held_out]


def test_every_picture_is_imported_once(cusick):
    report = json.loads((cusick / "import-report.json").read_text())
    assert sum(r["frames_kept"] for r in report["recordings"]) == 669
    copies = [line for r in report["recordings"] for line in r["notes"] if "the same bytes as" in line]
    assert len(copies) == 47
    fit, held = (read_silhouettes(cusick / "wool_red" / f"{split}.nc") for split in ("fit", "held_out"))
    assert (len(fit.image), len(held.image)) == (32, 16)
    assert not set(fit.sample) & set(held.sample)
    assert fit.areal_density == 0.274
    assert set(read_silhouettes(cusick / "cotton_white" / "fit.nc").side) == {1}


@pytest.mark.parametrize(
    ("fabric", "captures", "coefficient", "sd"),
    [("cotton_blue", 49, 0.707, 0.070), ("viscose_white", 48, 0.138, 0.014), ("cotton_pink", 48, 0.613, 0.045),
     ("wool_red", 48, 0.774, 0.018)],
)  # fmt: skip
def test_drape_coefficients_are_the_stated_ones(cusick, fabric, captures, coefficient, sd):
    """Within what the pixel's size leaves open: 0.4 % of it are 0.006 to 0.010 of the coefficient."""
    found = np.concatenate(
        [
            DrapeTracker().track(read_silhouettes(cusick / fabric / f"{split}.nc")).outlines.coefficient()
            for split in ("fit", "held_out")
        ]
    )
    assert len(found) == captures
    assert found.mean() == pytest.approx(coefficient, abs=0.010)
    assert found.std(ddof=1) == pytest.approx(sd, abs=0.002)


# --- what is searched for in a type of textile ------------------------------------------------------------------------


def test_a_model_says_what_is_free_in_a_soft_textile():
    from clothbench_models.baraff_witkin import BaraffWitkin
    from clothbench_models.inextensible import Inextensible
    from clothbench_models.mass_spring import MassSpring
    from clothbench_models.mass_spring_verlet import MassSpringVerlet

    for model in (MassSpringVerlet(), MassSpring(), BaraffWitkin()):
        for textile in ("soft", "medium", "stiff"):
            free, held = textile_of(model, textile)
            assert set(free) | set(held) <= set(model.parameters.names)
            assert not set(free) & set(held)
            assert all(0 < low < high for low, high in free.values())
    assert len(textile_of(MassSpringVerlet(), "soft")[0]) < len(textile_of(MassSpringVerlet(), "stiff")[0])
    assert textile_of(MassSpringVerlet(), None) == textile_of(Inextensible(), "soft") == ({}, {})


def test_a_suite_names_the_type_of_its_textiles():
    assert suite_settings({"textile": {"wool*": "stiff"}})["textile"] == {"wool*": "stiff"}
    with pytest.raises(ClothbenchError, match="expected one of soft, medium, stiff"):
        suite_settings({"textile": {"wool*": "woolly"}})
