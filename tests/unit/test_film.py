"""Films of a cell: what is kept of a recording, how it is packed, and what a fit is shown beside."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from conftest import swinging_recording
from test_rerun_file import small_cell

from clothbench import read_recording, write_recording
from clothbench.core.camera import Camera, Projector
from clothbench.core.observation import Observation
from clothbench.display.film import (
    FRAMES,
    Film,
    Take,
    chosen_frames,
    contact_sheet,
    places,
    read_film,
    scaled,
    surface_data,
    take_data,
    write_film,
)
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.engine.study import results_by_study
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration import cloth_page
from clothbench.studies.calibration.cell import set_up
from clothbench.studies.calibration.cloth import filmed, picture_of


def film(**more) -> Film:
    random = np.random.default_rng(3)
    seen = random.normal(0, 0.3, (4, 6, 3))
    seen[1, 2] = np.nan
    u, v = (a.ravel() for a in np.meshgrid([0.0, 0.1, 0.2], [0.0, 0.1]))
    known = {
        "identity": "abc", "name": "swing", "split": "fit", "time": np.arange(4.0), "seen": seen,
        "material": np.stack([u, v], axis=1), "metric": "fold", "unit": "px",
        "takes": {"fitted": Take(seen + 0.01, np.array([1, 2, np.nan, 3]))},
    }  # fmt: skip
    return Film(**{**known, **more})


def test_a_film_comes_back_as_it_was_written(tmp_path):
    camera = Camera.looking_at(np.array([0.0, -2.0, 0.0]), np.zeros(3), (8, 6), 1.0)
    picture, size = contact_sheet(np.zeros((4, 6, 8), np.uint8))
    one = film(picture=picture, size=size, camera=camera, projector=Projector(camera, 5.0), floor=0.5)
    write_film(tmp_path / "0.npz", one)
    back = read_film(tmp_path / "0.npz")
    assert (back.name, back.split, back.size, back.floor, back.picture) == ("swing", "fit", (8, 6), 0.5, picture)
    np.testing.assert_allclose(back.seen, one.seen, atol=5e-5)
    np.testing.assert_allclose(back.takes["fitted"].position, one.takes["fitted"].position, atol=5e-5)
    np.testing.assert_allclose(back.takes["fitted"].error, [1, 2, np.nan, 3])
    assert back.camera is not None
    assert back.projector is not None
    np.testing.assert_array_equal(back.camera.matrix, camera.matrix)
    assert back.projector.period == 5.0


def test_places_are_told_in_small_steps_and_gaps_stay_gaps():
    one = film()
    told = places(one.seen)
    frames, nodes, _ = told["shape"]
    low, high = np.frombuffer(base64.b64decode(told["steps"]), np.uint8).reshape(2, 3, nodes, frames).astype(int)
    moved = (low | high << 8).astype(np.uint16).view(np.int16)
    steps = np.cumsum(moved, axis=-1, dtype=np.int16).transpose(2, 1, 0)
    assert (steps[1, 2] == -32_768).all()
    known = np.isfinite(one.seen)
    expected = (steps * told["step"] + told["origin"])[known]
    np.testing.assert_allclose(expected, one.seen[known], atol=told["step"])


def test_frames_are_spread_and_pictures_are_small():
    assert chosen_frames(3).tolist() == [0, 1, 2]
    assert len(chosen_frames(500)) == FRAMES
    assert chosen_frames(500)[[0, -1]].tolist() == [0, 499]
    picture, size = contact_sheet(np.full((7, 400, 960, 3), 128, np.uint8))
    assert size == (240, 100)
    assert len(picture) < 20_000


def test_a_camera_of_a_smaller_picture_sees_the_same():
    camera = Camera.looking_at(np.array([0.0, -2.0, 0.3]), np.zeros(3), (960, 400), 1.0)
    half = scaled(camera, (240, 100))
    (there,), _ = camera.project(np.array([[0.1, 0.0, 0.05]]))
    (here,), _ = half.project(np.array([[0.1, 0.0, 0.05]]))
    np.testing.assert_allclose((here + 0.5) * 4, there + 0.5)


def test_points_on_a_lattice_are_refined_and_others_joined():
    assert surface_data(film().material)["u"] == [0.0, 0.1, 0.2]
    scattered = np.random.default_rng(0).uniform(0, 1, (9, 2))
    assert len(surface_data(scattered)["triangle"]) > 6
    assert surface_data(np.stack([np.arange(4.0), np.zeros(4)], axis=1)) == {"triangle": []}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    assert run_cell(small_cell(tmp_path_factory.mktemp("recordings")), folder) == "ok"
    ((_, found),), _ = results_by_study(Store(folder), catalogue())
    return found


def test_a_cell_keeps_films_of_what_was_fitted_and_what_was_not(results):
    clips = cloth_page.clips_of(results)
    ((_, recordings),) = clips.cases.items()
    assert {(c["name"], c["split"]) for c in recordings.values()} == {("swing-1", "fit"), ("swing-22", "held_out")}
    assert [take for take, _ in recordings["swing-1", "node_error"]["words"]] == ["fitted"]
    one = read_film(next((results.store.folder / "cells").glob("*/films/0.npz")))
    assert np.isnan(one.seen[3, 7:9]).all()
    assert np.isfinite(one.takes["fitted"].error).all()
    assert one.floor


def test_films_that_find_no_room_are_counted(results, monkeypatch):
    monkeypatch.setattr(cloth_page, "ROOM", 10)
    clips = cloth_page.clips_of(results)
    assert clips.left_out == 2
    assert cloth_page.cloth_section(clips, results.rows) is None


def test_fits_by_several_metrics_have_clips_with_units_of_their_own():
    clips, one = cloth_page.Clips(), {"suite": "s", "case": "linen"}
    for metric, unit in (("node_error", "mm"), ("fold_count", "1"), ("node_error", "mm")):
        other = film(metric=metric, unit=unit)
        cloth_page._add(clips, [one], f"by {metric}", other, [take_data(take) for take in other.takes.values()])
    ((_, found),) = clips.cases.items()
    assert [(c["metric"], c["unit"], len(c["words"])) for c in found.values()] == [
        ("node_error", "mm", 2),
        ("fold_count", "1", 1),
    ]
    shown = cloth_page.cloth_section(clips, [one]).data["films"][0]["recordings"]
    assert [c["name"].partition(" · ")[2] for c in shown] == ["node_error", "fold_count"]


def test_takes_are_told_apart_where_several_models_made_them():
    assert cloth_page.told([("fitted", "a"), ("truth", "a")]) == ["fitted", "truth"]
    assert cloth_page.told([("fitted", "a"), ("fitted", "b")]) == ["fitted, a", "fitted, b"]


def test_a_recording_of_another_case_can_be_simulated_too(tmp_path):
    """The analysis `confusion` holds a fit against recordings that the cell did not track when it was set up."""
    cell = small_cell(tmp_path)
    alone = set_up(type(cell)(**{**vars(cell), "recordings": cell.recordings[:1]}), catalogue())
    other = set_up(cell, catalogue()).recordings[1]
    assert alone.remake(other, None).name == "swing-22"
    assert filmed(alone) == [0]


def test_nodes_seen_across_a_line_of_sight_have_no_picture(tmp_path):
    path = tmp_path / "nodes.nc"
    recording = read_recording(write_recording(swinging_recording(), path))
    camera = Camera.looking_at(np.array([0.0, -2.0, 0.0]), np.zeros(3), (8, 6), 1.0)
    known = np.isfinite(recording.position).all(axis=-1)
    seen = Observation(recording.time, recording.position, known, 1e-3, recording.material, sight=camera)
    picture, size, lens, projector = picture_of(recording, str(path), seen, np.arange(3))
    one = film(picture=picture, size=size, camera=lens, projector=projector, flat=True)
    write_film(tmp_path / "0.npz", one)
    back = read_film(tmp_path / "0.npz")
    assert (back.picture, back.size, back.camera, back.flat) == (b"", (0, 0), None, True)
