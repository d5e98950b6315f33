"""Recordings of kind "curve": round trip, hash, and one line for every fault."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5netcdf.legacyapi
import numpy as np
import pytest

from clothbench import ClothbenchError, Curve, read_curve, read_recording, write_curve
from clothbench.datasets.knit_uniaxial_gatech import Swatch, apart, curve_of, stray
from clothbench.recordings.curve import last_rise
from clothbench.recordings.kinds import read_any


def pulled(name: str = "pull", **changes) -> Curve:
    """Forty samples of a linear sample with 10 N at twice its length."""
    stretch = np.linspace(1.0, 1.5, 40)
    content = {"name": name, "stretch": stretch, "force": 10 * (stretch - 1), "fabric": "rib", "direction": "course",
               "noise_sigma": 0.05, "notes": {"yarn": "acrylic"}}  # fmt: skip
    return Curve(**{**content, **changes})


def test_round_trip_keeps_everything(tmp_path):
    again = read_curve(write_curve(pulled(), tmp_path / "a.nc"))
    assert again.hash == pulled().hash
    assert (again.fabric, again.direction, again.notes) == ("rib", "course", {"yarn": "acrylic"})
    assert np.isnan(again.sample_width)
    np.testing.assert_array_equal(again.force, pulled().force)
    assert replace(again, split="held_out").hash != again.hash


def test_both_kinds_are_told_apart(recording, tmp_path):
    from clothbench import write_recording

    nodes, curve = write_recording(recording, tmp_path / "n.nc"), write_curve(pulled(), tmp_path / "c.nc")
    assert read_any(nodes).hash == recording.hash
    assert read_any(curve).hash == pulled().hash
    with pytest.raises(ClothbenchError, match="found 'curve', expected 'nodes'; curves go to `clothbench improve`"):
        read_recording(curve)
    with pytest.raises(ClothbenchError, match="found 'nodes', expected 'curve'"):
        read_curve(nodes)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda f: setattr(f["force"], "units", "kN"), "variable 'force': found units 'kN', expected 'N'"),
        (lambda f: setattr(f, "format_version", 2), "attribute 'format_version': found 2, expected the number 1"),
        (lambda f: setattr(f, "direction", "X"), "attribute 'direction': found 'X', expected one of 'warp'"),
        (lambda f: setattr(f, "noise_sigma", -1.0), "attribute 'noise_sigma': found -1.0"),
        (lambda f: setattr(f, "sample_width", 0.0), "attribute 'sample_width': found 0.0, expected metres above 0"),
        (
            lambda f: setattr(f, "sample_width", 50.0),
            "'sample_width': found 50 m, expected 2 m at most, or NaN; are these",
        ),
        (lambda f: setattr(f, "sample_length", 20.0), "attribute 'sample_length': found 20 m, expected 2 m at most"),
        (lambda f: setattr(f, "noise_sigma", 1e6), "'noise_sigma': found 1e+06 N where forces differ by 5 N in all"),
        (
            lambda f: f["force"].__setitem__(slice(None), 2e8 * np.linspace(0, 1, 40)),
            "'force': found 2e+08 N, expected",
        ),
        (
            lambda f: (f["force"].__setitem__(3, 4e5), setattr(f, "sample_width", 0.05)),
            "found 8e+06 N for each metre of",
        ),
        (lambda f: setattr(f, "sample_length", "long"), "attribute 'sample_length': found 'long', expected a number"),
        (lambda f: setattr(f, "name", ""), "attribute 'name': found nothing"),
        (lambda f: setattr(f, "split", "train"), "attribute 'split': found 'train'"),
        (lambda f: f["force"].__setitem__(3, np.nan), "1 values that are not finite, the first at sample 3"),
        (lambda f: f["stretch"].__setitem__(5, np.inf), "variable 'stretch': found 1 values that are not finite"),
        (lambda f: f["force"].__setitem__(slice(None), 2.0), "found 2 N in every sample, expected a curve"),
        (lambda f: f["stretch"].__setitem__(slice(None), np.linspace(0, 50, 40)), "add 1 to a strain"),
        (lambda f: f["stretch"].__setitem__(slice(None), np.linspace(1, 1.0001, 40)), "to change by 0.001 at least"),
        (lambda f: f._h5file.attrs.__delitem__("direction"), "attribute 'direction' is missing"),
    ],
)
def test_every_fault_is_one_line_with_file_and_field(tmp_path, change, found):
    path = write_curve(pulled(), tmp_path / "bad.nc")
    with h5netcdf.legacyapi.Dataset(path, "a") as stream:
        change(stream)
    with pytest.raises(ClothbenchError) as caught:
        read_curve(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_number_is_refused():
    with pytest.raises(ClothbenchError, match="attribute 'noise_sigma': found 'x', expected a number"):
        pulled(noise_sigma="x")


def test_arrays_that_do_not_belong_together_are_refused():
    with pytest.raises(ClothbenchError, match="'force': found 39 along 'sample', expected 40"):
        pulled(force=np.arange(39.0))
    with pytest.raises(ClothbenchError, match="found 5 samples, expected at least 8"):
        pulled(stretch=np.linspace(1, 1.2, 5), force=np.arange(5.0))
    with pytest.raises(ClothbenchError, match=r"found shape \(40, 1\), expected \(sample\)"):
        pulled(stretch=np.linspace(1, 1.5, 40)[:, None])


def test_cycles_of_which_nothing_is_said_are_read_and_the_last_rise_counts(tmp_path):
    """Written before anything was made of it, they had all been said to be loading, and were refused."""
    up = np.linspace(1.0, 1.5, 200)
    twice = np.r_[up, up[::-1], 1 + 1.001 * (up - 1)]
    made = pulled(stretch=twice, force=np.r_[10 * (up - 1), 4 * (up[::-1] - 1), 10 * (up - 1)])
    read = read_curve(write_curve(made, tmp_path / "twice.nc"))
    assert read.motion == "loading"
    assert last_rise(read.stretch) == slice(399, 600)


def test_noise_and_single_samples_are_no_way_back():
    up, random = np.linspace(1.0, 1.5, 200), np.random.default_rng(0)
    assert last_rise(np.r_[up, up[::-1]]) == slice(0, 200)  # what comes after the largest stretch is passed over
    for noise in (0.001, 0.02):  # of what a camera sees: no way back
        seen = np.linspace(1.0, 1.5, 6000) + random.normal(0, noise, 6000)
        assert last_rise(seen) == slice(0, int(np.argmax(seen)) + 1)
    stray = up.copy()
    stray[90] = 1.0
    assert last_rise(stray) == slice(0, 200)


@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-3])
def test_of_cycles_that_go_equally_far_the_last_counts(noise):
    up = np.linspace(1.0, 1.2, 200)
    cycles = np.tile(np.r_[up, up[::-1]], 3)
    for seed in range(10):
        rise = last_rise(cycles + np.random.default_rng(seed).normal(0, noise, len(cycles)))
        assert rise.start == pytest.approx(800, abs=20)
        assert rise.stop == pytest.approx(1000, abs=20)
    farther = np.r_[up, up[::-1], 1 + 0.9 * (up - 1)]  # less far is no rise to the largest
    assert last_rise(farther) == slice(0, 200)


@pytest.mark.parametrize("ramp", [2, 3, 4, 5, 8])
def test_cycles_of_few_samples_a_ramp_are_cycles(ramp):
    """Tops of 1.200, 1.201 and 1.202; no sample of the way back is kept."""
    turns = np.array([1.0, 1.2, 1.0, 1.201, 1.0, 1.202])
    stretch = np.interp(np.arange(5 * ramp + 1) / ramp, np.arange(6), turns)
    assert last_rise(stretch) == slice(4 * ramp, 5 * ramp + 1)
    assert pulled(stretch=stretch, force=np.arange(float(len(stretch)))).motion == "loading"  # which is not refused


@pytest.mark.parametrize("noise", [0.002, 0.01, 0.04])
@pytest.mark.parametrize("samples", [200, 20000])
def test_noise_is_no_way_back_however_many_samples_there_are(samples, noise):
    up, random = np.linspace(1.0, 1.5, samples), np.random.default_rng(0)
    for stretch in (up, np.r_[up, up[::-1]], np.r_[up, np.full(samples // 2, 1.5)]):
        assert last_rise(stretch + random.normal(0, noise, len(stretch))).start == 0


def film(distance: np.ndarray, force: np.ndarray) -> dict:
    """A video of a swatch whose lower clamp is so many pixels (M,) below the upper one."""
    track = np.zeros((7, 2, len(force)))
    for point, share in zip((6, 3, 2, 5), (0.0, 0.3, 0.6, 1.0), strict=True):
        track[point, 1] = 10 + share * distance
    return {"forces": force, "traj": track, "clampSize": 160.0, "fabricSize": 400.0}


def test_a_swatch_s_length_is_the_median_of_its_first_frames():
    distance = np.concatenate([[190.0, 200.0, 200.0, 200.0, 230.0], np.linspace(200, 300, 60)])
    swatch = Swatch(Path("lab/outputData_Acrylic Yarn Rib X.h5"), "acrylic", "rib", "course")
    curve, dropped = curve_of(swatch, 1, film(distance, np.linspace(0, 9, 65)), "file")
    assert dropped == 0
    np.testing.assert_allclose(curve.stretch, distance / 200)
    assert curve.notes["width_over_length"] == "2.0000"


def test_a_reading_stands_alone_that_is_far_from_its_neighbours_beside_their_size():
    """From 1.5 N on, and from a quarter of what is usual where that is more."""
    for usual, off, alone in ((2.0, 1.4, False), (2.0, 1.6, True), (20.0, 4.9, False), (20.0, -5.1, True)):
        force = np.full(100, usual)
        force[50] += off
        assert np.flatnonzero(apart(force)).tolist() == ([50] if alone else [])


def test_the_noise_of_readings_is_told_about_the_median_of_five():
    force = np.full(50, 2.0)
    force[[10, 20, 30, 40]] += 0.5 * np.array([1, -1, 1, -1])
    assert stray(force) == pytest.approx((4 * 0.5**2 / 50) ** 0.5)
