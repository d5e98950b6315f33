"""The IRI cloth-swing importer against a made-up lab whose truth is known, hazard by hazard, and on the real
data.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clothbench.core.errors import ClothbenchError
from clothbench.datasets import lattice, registry
from clothbench.datasets.iri_files import find_sources
from clothbench.datasets.iri_wam_cloth_swing import NO_TOOL, convert, split_by_repeat
from clothbench.datasets.lattice_faults import jumped
from clothbench.datasets.node_order import put_in_order, symmetries
from clothbench.datasets.rigid import pose_path
from clothbench.recordings.nodes import read_recording

# The made-up session bears a date that the real data do not have: the registry knows none of its files.
NAME = "iri_wam_cloth_swing"
SIDE, OFFSET, ZERO = 0.30, 0.32, 1_625_480_000_000_000_000
CAMERA = Rotation.from_quat([-0.7163, 0.0076, 0.0175, 0.6983]), np.array([-0.015, -1.542, 0.092])
HANGER = np.array([0.0, -0.03, 0.09])


@dataclass
class Lab:
    """A cloth that hangs flat and stiff from a hanger, swung along y and z; its truth by capture time."""

    n: int = 8
    seconds: float = 10.0
    still: float = 2.0  # s of rest before the motion
    swing: float = 0.12  # m
    lean: float = 0.0  # rad, error of the stated camera about y
    seed: int = 0

    def tool(self, t: np.ndarray) -> np.ndarray:
        """Tool position (T, 3) in m; the tool's z points down, its y along world x."""
        phase = 2.2 * np.clip(t - self.still, 0.0, None)
        away = self.swing * (1 - np.cos(phase))
        return np.stack([0.02 * np.sin(phase) * (self.swing > 0), -0.4 - away, 0.35 + 0.3 * away], axis=-1)

    def cloth(self, t: np.ndarray) -> np.ndarray:
        """Nodes (T, n, n, 3) in m, rows from the top."""
        grid = lattice.nominal(self.n, SIDE).reshape(self.n, self.n, 2)
        flat = np.stack([grid[..., 0] - SIDE / 2, 0 * grid[..., 0], -grid[..., 1]], axis=-1)
        turn = Rotation.from_quat([0.7071, 0.7071, 0.0, 0.0]).as_matrix()
        return flat + (self.tool(t) + turn @ HANGER)[:, None, None]

    def capture(self) -> tuple[np.ndarray, np.ndarray]:
        """Stamps and capture times (T,) in s: the longer the gap before a stamp, the older its image."""
        gaps = 0.1 + 0.03 * np.random.default_rng(self.seed).standard_normal(int(self.seconds / 0.1)).clip(-1, 2)
        stamp = 0.5 + np.cumsum(gaps)
        return stamp, stamp - OFFSET - (gaps - np.median(gaps))

    def frames(self) -> np.ndarray:
        """What the mesher makes of it, (T, n, n, 3) in m in the robot's base, with 1 mm noise."""
        _, captured = self.capture()
        noise = np.random.default_rng(self.seed + 1).standard_normal((len(captured), self.n, self.n, 3))
        return self.cloth(captured) + 0.001 * noise

    def write(self, folder: Path, stem: str, frames: np.ndarray | None = None, stamp: np.ndarray | None = None) -> Path:
        """One recording's files in the form of the data set; the calibration beside it."""
        folder.mkdir(parents=True, exist_ok=True)
        frames = self.frames() if frames is None else frames
        stamp = self.capture()[0] if stamp is None else stamp
        rotation, origin = CAMERA
        stated = Rotation.from_euler("y", self.lean) * rotation
        seen = (frames - origin) @ rotation.as_matrix()
        write_mesh(folder / f"{stem}_mesh.csv", stamp, seen)
        clock = np.arange(0.0, stamp.max() + 0.3, 0.05)
        write_tool(folder / f"{stem}_tcp.csv", clock, self.tool(clock))
        rows = [np.zeros(8), np.concatenate([[0.0], origin, stated.as_quat()])]
        (folder / f"n{self.n}_calibration_campose.csv").write_text(
            "%time,x,y,z,qx,qy,qz,qw\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n"
        )
        return folder / f"{stem}_mesh.csv"


def nanoseconds(seconds: np.ndarray) -> list[int]:
    return [ZERO + round(1e9 * s) for s in seconds]


def write_mesh(path: Path, stamp: np.ndarray, frames: np.ndarray) -> None:
    lines = ["%time,field.header.seq,field.header.stamp,field.header.frame_id,field.size,nodes"]
    for i, (ns, frame) in enumerate(zip(nanoseconds(stamp), frames, strict=True)):
        values = ",".join(f"{v:.9f}" for v in frame.transpose(2, 0, 1).ravel())
        lines.append(f"{ns},{i},{ns},camera_rgb_optical_frame,{frame.shape[0]},{values}")
    path.write_text("\n".join(lines) + "\n")


def write_tool(path: Path, clock: np.ndarray, position: np.ndarray) -> None:
    """Every stamp twice and every other quaternion negated, as robots do."""
    lines = ["%time,field.header.seq,field.header.stamp,field.header.frame_id,x,y,z,qx,qy,qz,qw"]
    for i, (ns, p) in enumerate(zip(nanoseconds(clock), position, strict=True)):
        sign = -1 if i % 2 else 1
        pose = ",".join(f"{v:.9f}" for v in (*p, 0.7071 * sign, 0.7071 * sign, 0.0, 0.0))
        lines += [f"{ns},{i},{ns},iri_wam_link_base,{pose}"] * 2
    path.write_text("\n".join(lines) + "\n")


def session(root: Path) -> Path:
    return root / "iri-wam-cloth-swing" / "Session_2021_07_06"


def run(root: Path) -> dict:
    """Convert everything under `root`; reports by stem."""
    source = registry.local_copy(NAME, root)
    assert source is not None
    return {Path(r.source).name.removesuffix("_mesh.csv"): r for r in convert(source, root / "out")}


def truth_error(report, lab: Lab) -> np.ndarray:
    """Distance (T, n·n) in m between a recording's nodes and the lab's cloth at the recording's own times."""
    recording = read_recording(report.output)
    # The recording counts from its first frame; the grips tell when that was on the lab's clock.
    candidates = np.arange(-0.2, 4.0, 0.002)
    held = recording.grip_position.mean(axis=1)
    turn = Rotation.from_quat([0.7071, 0.7071, 0.0, 0.0]).as_matrix()
    cost = [np.abs(lab.tool(recording.grip_time + c) + turn @ HANGER - held).mean() for c in candidates]
    start = candidates[int(np.argmin(cost))]
    true = lab.cloth(recording.time + start).reshape(len(recording.time), -1, 3)
    return np.linalg.norm(recording.position - true, axis=-1)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Two undisturbed recordings and a still one of the same session, converted once."""
    root = tmp_path_factory.mktemp("lab")
    labs = {"range60_rep1": Lab(), "range60_rep7": Lab(seed=5), "range30_rep2": Lab(swing=0.0, seed=9)}
    for stem, lab in labs.items():
        lab.write(session(root), stem)
    return run(root), labs, root


def test_positions_grips_and_clock_come_out_as_they_were(clean):
    reports, labs, _ = clean
    report = reports["range60_rep1"]
    assert report.clock_offset_s == pytest.approx(OFFSET, abs=0.01)
    assert report.clock_offset_sigma_s < 0.01
    assert report.frames_kept > 0.9 * report.frames_in
    assert report.grip_residual_m < 0.004
    error = truth_error(report, labs["range60_rep1"])
    assert np.nanmedian(error) < 0.003
    assert np.nanpercentile(error, 99) < 0.010


def test_recording_says_what_it_is(clean):
    reports, _, root = clean
    recording = read_recording(reports["range60_rep1"].output)
    assert (recording.motion, recording.split, recording.licence) == ("range60", "fit", "none stated")
    assert (recording.cloth_width, recording.cloth_height) == (0.30, 0.30)
    assert np.isnan(recording.areal_density)
    assert recording.time[0] == 0.0
    assert recording.grip_material.tolist() == [[u, 0.0] for u in np.linspace(0, SIDE, 8)]
    assert 0.0002 < recording.noise_sigma < 0.0015  # 1 mm went in; reading the surface averages
    assert float(recording.notes["clock_offset_removed_s"]) == pytest.approx(OFFSET, abs=0.01)
    assert "not verified" in recording.notes["remarks"]
    assert read_recording(reports["range60_rep7"].output).split == "held_out"
    assert not list((root / "out").glob(".*"))


def test_report_file_is_json_without_nan(clean):
    reports, _, root = clean
    stated = json.loads((root / "out" / "import-report.json").read_text(), parse_constant=pytest.fail)
    assert stated["dataset"] == NAME
    assert len(stated["recordings"]) == len(reports)
    outputs = [r["output"] for r in stated["recordings"] if r["output"]]
    assert outputs
    assert all((root / "out" / output).is_file() and not output.startswith("/") for output in outputs)


def test_the_next_command_names_the_folder(clean, tmp_path, capsys):
    import shutil

    from clothbench.cli.listings import print_import

    print_import(Path(shutil.copytree(clean[2] / "out", tmp_path / "iri out")))
    told = " ".join(capsys.readouterr().out.split())
    assert f"next: clothbench run +suite=iri_swing recordings='{tmp_path}/iri out'" in told


def test_still_recording_takes_the_clock_of_its_session(clean):
    reports, _, _ = clean
    report = reports["range30_rep2"]
    assert report.clock_offset_s == pytest.approx(OFFSET, abs=0.01)
    assert any("does not determine the clock offset" in note for note in report.notes)


def test_same_input_gives_the_same_recording(clean, tmp_path):
    reports, _, root = clean
    again = convert(root / "iri-wam-cloth-swing", tmp_path)
    for report in again:
        stem = Path(report.source).name.removesuffix("_mesh.csv")
        assert report.output is not None
        assert read_recording(report.output).hash == read_recording(reports[stem].output).hash


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory):
    """One recording with every hazard of the node frames in it, beside a clean one."""
    root = tmp_path_factory.mktemp("hazards")
    lab = Lab(seed=3)
    frames, (stamp, _) = lab.frames(), lab.capture()
    for i, way in enumerate((1, 2, 4, 5, 6, 7)):
        frames[30 + i] = symmetries(frames[30 + i])[way]
    frames[40, 3, 3] = np.nan
    frames[41, 0, 2, 2] = np.nan
    frames[42, 2, 5, 1] += 0.05
    frames[43, 7, 3, 2] -= 0.05
    frames[45] = frames[45].mean(axis=(0, 1)) + 0.3 * (frames[45] - frames[45].mean(axis=(0, 1)))
    frames[46, 4:] += np.array([0.1, 0.0, 0.0])
    frames[47, :, :5] = np.nan
    frames[48] += np.array([0.0, 0.0, 0.08])
    frames[50] = slipped(frames[50], 0.05)
    stamp[60] = stamp[59]
    stamp[62] = stamp[58]
    lab.write(session(root), "range60_rep1", frames, stamp)
    Lab().write(session(root), "range60_rep2")
    return run(root)["range60_rep1"], lab


def slipped(frame: np.ndarray, by: float) -> np.ndarray:
    """The same flat sheet, meshed as if its upper left corner lay `by` m further along the hem.

    Outline nodes stay evenly spaced along the hem between corners, inner ones follow as a Coons patch.
    """
    n = len(frame)
    s = np.linspace(0.0, 1.0, n)
    zero, full = np.zeros(n), np.full(n, SIDE)
    top = np.stack([by + s * (SIDE - by), zero], axis=-1)
    bottom, right = np.stack([s * SIDE, full], axis=-1), np.stack([full, s * SIDE], axis=-1)
    along = s * (SIDE + by)
    left = np.stack([np.clip(by - along, 0.0, None), np.clip(along - by, 0.0, None)], axis=-1)
    a, b = s[None, :, None], s[:, None, None]
    patch = (1 - a) * left[:, None] + a * right[:, None] + (1 - b) * top[None] + b * bottom[None]
    corners = (1 - a) * (1 - b) * top[0] + a * (1 - b) * top[-1] + (1 - a) * b * bottom[0] + a * b * bottom[-1]
    u, v = np.moveaxis(patch - corners, -1, 0)
    across, down = (frame[0, -1] - frame[0, 0]) / SIDE, (frame[-1, 0] - frame[0, 0]) / SIDE
    return frame[0, 0] + u[..., None] * across + v[..., None] * down


def test_every_dropped_frame_has_its_reason(disturbed):
    report, _ = disturbed
    assert report.dropped["duplicate or backward stamp"] == 2
    assert report.dropped["fewer than half of the nodes seen"] == 1
    assert report.dropped["upper edge away from the hanger"] == 1
    wrong = [count for why, count in report.dropped.items() if why.startswith(("wrong size", "torn"))]
    assert sum(wrong) == 2
    assert report.frames_kept + sum(report.dropped.values()) == report.frames_in


def test_numbering_and_slipped_labels_are_put_right(disturbed):
    report, lab = disturbed
    assert report.reordered == 6
    error = truth_error(report, lab)
    assert np.nanpercentile(error, 99) < 0.012


def test_unseen_nodes_stay_unseen():
    frames = Lab().cloth(np.zeros(2))
    frames[0, 3, 4] = np.nan
    flat = lattice.place(lattice.unroll(lattice.filled(frames), SIDE)[0], SIDE)
    position, unseen, outside = lattice.resample(frames, flat, SIDE)
    assert np.flatnonzero(unseen).tolist() == [3 * 8 + 4]
    assert np.flatnonzero(np.isnan(position).any(axis=-1)).tolist() == [3 * 8 + 4]
    assert not outside.any()


def test_jumped_nodes_are_masked_alone():
    frames = Lab().cloth(np.zeros(3))
    frames[0, 0, 0] += [0.0, 0.06, 0.0]
    frames[1, 4, 4] += [0.0, 0.04, 0.0]
    frames[2, 0, 3] += [0.0, 0.0, 0.04]
    found = np.argwhere(jumped(frames)).tolist()
    assert found == [[0, 0, 0], [1, 4, 4], [2, 0, 3]]


def test_rest_of_a_jumped_frame_is_kept(disturbed):
    report, _ = disturbed
    # Two were moved; the slipped frame's corner may pass for a third.
    assert report.nodes_masked["jumped away from its neighbours"] in (2, 3)


def test_clean_nodes_are_not_masked(clean):
    reports, _, _ = clean
    recording = read_recording(reports["range60_rep1"].output)
    assert recording.visible.mean() > 0.99


def test_slipped_corner_is_relabelled_not_moved():
    lab = Lab()
    frame = lab.cloth(np.zeros(1))
    bad = slipped(frame[0], 0.05)[None]
    flat = lattice.place(lattice.unroll(bad, SIDE)[0], SIDE)
    position, unseen, outside = lattice.resample(bad, flat, SIDE)
    assert (unseen | outside).sum() <= 7  # what the slipped outline cuts off
    error = np.linalg.norm(position - frame.reshape(1, -1, 3), axis=-1)
    assert np.nanmax(error) < 0.006
    raw = np.linalg.norm(bad - frame, axis=-1)
    assert raw.max() > 0.045


def test_bent_cloth_unrolls_to_its_own_size():
    grid = lattice.nominal(9, SIDE).reshape(9, 9, 2)
    angle = grid[..., 1] / 0.2
    bent = np.stack([grid[..., 0], 0.2 * np.cos(angle), -0.2 * np.sin(angle)], axis=-1)[None]
    flat, left = lattice.unroll(bent, SIDE)
    placed = lattice.place(flat, SIDE)
    assert left[0] < 1e-4
    assert np.abs(placed[0] - grid.reshape(-1, 2)).max() < 0.002


def test_rolled_cloth_keeps_its_numbering():
    frame = Lab().cloth(np.zeros(1))[0]
    middle = frame.mean(axis=(0, 1))
    rolled = [Rotation.from_euler("y", a, degrees=True).apply((frame - middle).reshape(-1, 3)) for a in range(0, 70, 7)]
    frames = np.stack(rolled).reshape(-1, 8, 8, 3) + middle
    mixed = np.stack([symmetries(f)[(3 * i) % 8] for i, f in enumerate(frames)])
    ordered, _ = put_in_order(mixed, np.array([1.0, 0.0, 0.0]))
    assert np.array_equal(ordered, frames)


def test_camera_error_is_found_and_put_right(tmp_path):
    lab = Lab(lean=np.deg2rad(2.0))
    lab.write(session(tmp_path), "range60_rep1")
    report = run(tmp_path)["range60_rep1"]
    recording = read_recording(report.output)
    turn = [float(a) for a in recording.notes["camera_turn_corrected_deg"].split()]
    assert np.allclose(turn, [0, -2, 0], atol=0.5)
    assert report.grip_residual_m < 0.004


def test_sheet_whose_upper_edge_is_not_seen_is_labelled_from_the_hanger(tmp_path):
    lab = Lab()
    moving = lab.capture()[1] > lab.still
    frames = lab.frames()
    down = np.where(moving, 0.02, 0.0)[:, None] * (1 - np.linspace(0, 1, lab.n))  # m, the lattice spans what is seen
    frames[..., 2] -= down[:, :, None]
    lab.write(session(tmp_path), "range60_rep1", frames)
    report = run(tmp_path)["range60_rep1"]
    error = truth_error(report, lab)
    # What is seen lies in the middle of the cloth's own outline, 10 mm higher than it is.
    assert float(read_recording(report.output).notes["outline_begins_rms_m"]) == pytest.approx(0.010, abs=0.003)
    assert np.nanmedian(error) < 0.003
    assert np.nanpercentile(error, 95) < 0.006


def test_start_in_motion_is_cut_to_the_first_rest(tmp_path):
    lab = Lab()
    lab.write(session(tmp_path), "range60_rep2")
    frames, (stamp, captured) = lab.frames(), lab.capture()
    early = captured < 0.9
    frames[early] += np.array([0.0, 0.03, 0.0]) * np.linspace(0, 1, 8)[:, None, None]
    lab.write(session(tmp_path), "range60_rep1", frames, stamp)
    report = run(tmp_path)["range60_rep1"]
    assert report.dropped["before tool and cloth first rest"] >= early.sum() - 2


def test_what_cannot_be_used_is_skipped_with_its_reason(tmp_path):
    folder = session(tmp_path)
    lab = Lab()
    lab.write(folder, "range60_rep1")
    for stem in (
        "range60_rep2",
        "range60_rep3",
        "range60_rep4",
        "range60_rep5",
        "n8_blooper_traj9_1",
        "n8_calibration",
    ):
        shutil.copy(folder / "range60_rep1_mesh.csv", folder / f"{stem}_mesh.csv")
        shutil.copy(folder / "range60_rep1_tcp.csv", folder / f"{stem}_tcp.csv")
    (folder / "range60_rep2_tcp.csv").unlink()
    text = (folder / "range60_rep3_mesh.csv").read_text().splitlines()
    (folder / "range60_rep3_mesh.csv").write_text("\n".join([*text[:50], text[50][:200]]))
    (folder / "range60_rep4_mesh.csv").write_text(text[0] + "\n")
    (folder / "range60_rep5_mesh.csv").write_text("\n".join(text[:9]) + "\n")
    reports = run(tmp_path)
    assert reports["range60_rep1"].skipped is None
    assert reports["range60_rep2"].skipped == NO_TOOL
    assert "range60_rep3_mesh.csv is not a readable table" in reports["range60_rep3"].skipped
    assert "holds no rows" in reports["range60_rep4"].skipped
    assert reports["range60_rep5"].skipped.startswith("only 8 of 8 frames usable")
    assert "blooper" in reports["n8_blooper_traj9_1"].skipped
    assert "calibration, no motion" in reports["n8_calibration"].skipped


def test_folder_without_the_data_is_one_clear_line(tmp_path):
    with pytest.raises(ClothbenchError, match="found no Session_"):
        convert(tmp_path, tmp_path / "out")


def test_split_depends_on_the_repeat_alone(tmp_path):
    folder = session(tmp_path)
    folder.mkdir(parents=True)
    for stem in ("range30_rep5", "range30_rep6", "range30_rep10", "n8_traj9_1", "n8_traj9_2", "n8_traj8_1"):
        (folder / f"{stem}_mesh.csv").touch()
    sources = find_sources(folder.parent)
    split = {path.name.removesuffix("_mesh.csv"): what for path, what in split_by_repeat(sources).items()}
    assert split == {
        "range30_rep5": "fit",
        "range30_rep6": "held_out",
        "range30_rep10": "held_out",
        "n8_traj9_1": "fit",
        "n8_traj9_2": "held_out",
        "n8_traj8_1": "fit",
    }
    assert [s.name for s in sources if s.repeat == 10] == ["iri-2021_07_06-n8-range30-10"]


def test_tool_path_survives_repeats_and_signs():
    stamp = np.array([0.0, 0.0, 0.05, 0.04, 0.1, 0.15, 0.2])
    position = np.stack([stamp, 0 * stamp, 0 * stamp], axis=-1)
    quaternion = np.array(
        [[0, 0, 0, 1.0], [0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 0, 1], [0, 0, 0, 1], [0] * 4, [0, 0, 0, -1]]
    )
    path = pose_path(stamp, position, quaternion)
    assert path.time.tolist() == [0.0, 0.05, 0.1, 0.2]
    where, rotation = path.at(np.array([0.075, 9.0]))
    assert np.allclose(where[:, 0], [0.075, 0.2], atol=1e-9)
    assert np.allclose(rotation.magnitude(), 0.0)


def test_file_with_changed_bytes_is_skipped(tmp_path, monkeypatch):
    Lab().write(session(tmp_path), "range60_rep1")
    Lab(seed=4).write(session(tmp_path), "range60_rep2")
    files = {"Session_2021_07_06/range60_rep2_tcp.csv": ("x", "0" * 64)}
    monkeypatch.setattr(registry, "DATASETS", {NAME: replace(registry.DATASETS[NAME], files=files)})
    reports = run(tmp_path)
    assert reports["range60_rep1"].skipped is None
    assert "range60_rep2_tcp.csv: SHA-256 differs" in reports["range60_rep2"].skipped


# --- the real data
# ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """The whole data set, converted once."""
    beside = Path(__file__).parents[3] / "shared" / "data"
    stated = os.environ.get(registry.ENVIRONMENT) or (beside if beside.is_dir() else None)
    if stated is None:
        pytest.skip("the measured data are not here; set CLOTHBENCH_DATA to their folder")
    source = registry.local_copy(NAME, stated)
    assert source is not None
    return convert(source, tmp_path_factory.mktemp("real"))


@pytest.mark.data
@pytest.mark.slow
def test_real_recordings_are_read_back_and_mostly_kept(real):
    done = [r for r in real if r.output]
    assert len(done) >= 40
    for report in done:
        recording = read_recording(report.output)
        assert recording.visible.mean() > 0.6
        assert report.frames_kept + sum(report.dropped.values()) == report.frames_in
    kept = [r.frames_kept / r.frames_in for r in done]
    assert np.median(kept) > 0.85
    assert min(kept) > 0.6


@pytest.mark.data
@pytest.mark.slow
def test_real_clocks_and_hanger_agree(real):
    done = [r for r in real if r.output]
    assert all(0.25 < r.clock_offset_s < 0.36 and r.clock_offset_sigma_s < 0.01 for r in done)
    assert np.median([r.grip_residual_m for r in done]) < 0.008
    assert all(0.0005 < r.noise_sigma_m < 0.003 for r in done)


@pytest.mark.data
@pytest.mark.slow
def test_real_files_that_are_no_recording_say_why(real):
    reasons = {Path(r.source).name: r.skipped for r in real if r.skipped}
    assert reasons["n4_blooper_traj9_1_mesh.csv"].startswith("marked as a blooper")
    assert reasons["n8_calibration_mesh.csv"] == "calibration, no motion"
    assert all(reason for reason in reasons.values())
