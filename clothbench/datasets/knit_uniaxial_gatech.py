"""Importer for `knit_uniaxial_gatech`: hand-knitted swatches pulled between two clamps, filmed, with a load cell.

Each HDF5 file is one stitch pulled in one direction, with up to five videos; each video becomes one recording of kind
"curve", in a folder for each stitch and direction. In a file, per frame: `/videoK/forces` [N], `/videoK/traj` pixel
positions of tracked points, `/videoK/frames`; `/clampSize` and `/fabricSize` in pixels.

What the originals leave open, and what is made of it:

- No length in the data is in millimetres: the clamp is the scale of the picture, and its own length, 35.5 mm, stands in
  the originals' notebook `template.nb` alone. The stretch is a ratio, so it needs none; stiffnesses are the sample's.
- The stretch is the distance of the clamps over that in the first frames. The distance of the two pins inside says
  less: swatches curl before they are pulled, and the pins' unloaded distances differ by up to 6 % between runs of one
  swatch, the clamps' by up to 3 %.
- The files hold seven points, their description lists six: the fifth is a pin in the middle.
- The sample is pulled step by step and never let back: loading only. At every step the force rises and then sinks
  while nothing moves, which a curve over stretch cannot show; how fast the frames came is not stated.
- Single readings that stand alone against their neighbours (18.38 read as 10.38) are dropped.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.progress import FileProgress
from clothbench.datasets import registry
from clothbench.datasets.report import ImportReport, write_report
from clothbench.recordings.codec import write
from clothbench.recordings.curve import LAYOUT, Curve

NAME = "knit_uniaxial_gatech"
REPORT = "import-report.json"
FILE = re.compile(r"outputData_(?P<yarn>.+) (?P<stitch>\w+) (?P<axis>[XYxy])\.h5")
DIRECTIONS = {"x": "course", "y": "wale"}  # x runs along the rows
BOTTOM_PIN, TOP_PIN, BOTTOM_CLAMP, TOP_CLAMP, POINTS = 2, 3, 5, 6, 7
FIRST = 5  # frames that the unloaded distance is the median of
WINDOW, STRAY = 41, (1.5, 0.25)  # frames; N, and share of the median, beyond which a reading is no reading
NEXT = "clothbench improve recordings={folder} model=linear_stretch"


@dataclass(frozen=True)
class Swatch:
    """One HDF5 file: a stitch of a yarn, pulled along courses or wales."""

    path: Path
    yarn: str
    stitch: str
    direction: str

    @property
    def fabric(self) -> str:
        return f"{self.yarn} {self.stitch}"

    @property
    def folder(self) -> str:
        return f"{self.yarn}-{self.stitch}-{self.direction}".replace(" ", "-")


def convert(source: Path, out: Path, progress: FileProgress | None = None) -> list[ImportReport]:
    """Write one recording per video under `source` into `out`, with import-report.json; returns all reports.

    `progress(done, planned, name)` is called after every file. A file or video that cannot be used is reported with the
    reason and does not stop the others; a folder without such files is an error.
    """
    source, out = Path(source), Path(out)
    swatches, check = find_swatches(source), registry.verify(NAME, source)
    reports: list[ImportReport] = []
    for done, swatch in enumerate(swatches, 1):
        reports += _convert_file(swatch, out, check)
        if progress:
            progress(done, len(swatches), swatch.path.name)
    dataset = registry.DATASETS[NAME]
    header = {"dataset": NAME, "source": f"{dataset.repository}@{dataset.commit}", "licence": dataset.licence}
    first = next((Path(r.output).parent.name for r in reports if r.output), "")
    write_report(reports, out / REPORT, **header, next=NEXT, next_folder=first)
    return reports


def find_swatches(folder: Path) -> list[Swatch]:
    """Every swatch's file in `folder`, in a fixed order; none is an error."""
    found = []
    for path in sorted(folder.glob(registry.DATASETS[NAME].pattern)):
        if match := FILE.fullmatch(path.name):
            yarn = match["yarn"].lower().removesuffix(" yarn")
            found.append(Swatch(path, yarn, match["stitch"].lower(), DIRECTIONS[match["axis"].lower()]))
    if not found:
        raise ClothbenchError(
            f"{folder}: found no outputData_YARN STITCH X.h5, expected the knits' HDF5 files; check data_dir"
        )
    return found


def _convert_file(swatch: Swatch, out: Path, check: registry.Check) -> Iterator[ImportReport]:
    """All videos of one file. Only one whose bytes the registry vouches for, or that it does not know, is read."""
    name = swatch.path.name
    if name in check.wrong:
        yield ImportReport(name, skipped=f"{name}: SHA-256 differs from the registry's; fetch it again")
        return
    try:
        videos = read_videos(swatch.path)
    except ClothbenchError as fault:
        yield ImportReport(name, skipped=str(fault))
        return
    remarks = (f"{name} is not in the registry: not verified",) if name in check.unknown else ()
    for number, video in videos.items():
        source = f"{name}/video{number}"
        try:
            curve, dropped = curve_of(swatch, number, video, f"{name}: /video{number}")
            path = write(curve, out / swatch.folder / f"run{number}.nc", LAYOUT)
        except ClothbenchError as fault:
            yield ImportReport(source, frames_in=len(video["forces"]), notes=remarks, skipped=str(fault))
            continue
        why = {"reading apart from its neighbours": dropped} if dropped else {}
        written = path.relative_to(out).as_posix()
        yield ImportReport(source, written, len(video["forces"]), len(curve.stretch), why, notes=remarks)


def read_videos(path: Path) -> dict[int, dict[str, Any]]:
    """Arrays of each video by its number: forces (M,) N, traj (7, 2, M) px; and the file's clamp and fabric in px."""
    import h5py

    try:
        with h5py.File(path, "r") as stream:
            sizes = {key: float(np.ravel(stream[key][()])[0]) for key in ("clampSize", "fabricSize")}
            groups = {int(key.removeprefix("video")): stream[key] for key in stream if key.startswith("video")}
            read = ("forces", "traj")
            return {k: sizes | {name: np.asarray(g[name][()]) for name in read} for k, g in sorted(groups.items())}
    except (OSError, KeyError, ValueError, TypeError) as fault:
        what = str(fault).splitlines()[0].strip("'\"")
        raise ClothbenchError(f"{path.name}: cannot be read ({what}); fetch it again") from fault


def curve_of(swatch: Swatch, number: int, video: dict[str, Any], where: str) -> tuple[Curve, int]:
    """One video as a recording, and how many readings were dropped."""
    force, track = video["forces"], video["traj"]
    if track.shape != (POINTS, 2, len(force)):
        raise ClothbenchError(f"{where}/traj: found shape {track.shape}, expected ({POINTS}, 2, {len(force)})")
    _check_points(track, f"{where}/traj")
    distance = np.linalg.norm(track[BOTTOM_CLAMP] - track[TOP_CLAMP], axis=0)
    unloaded = float(np.median(distance[:FIRST]))
    kept = ~apart(force)
    dataset, direction = registry.DATASETS[NAME], swatch.direction
    notes = {
        "unloaded_distance_px": f"{unloaded:.2f}", "fabric_width_px": f"{video['fabricSize']:.2f}",
        "clamp_px": f"{video['clampSize']:.2f}", "width_over_length": f"{video['fabricSize'] / unloaded:.4f}",
        "first_force_N": f"{force[0]:.2f}", "force_resolution_N": "0.01", "stretch_between": "clamps",
    }  # fmt: skip
    upstream, _ = dataset.files.get(swatch.path.name, (swatch.path.name, ""))
    curve = Curve(
        f"knit-{swatch.folder}-{number}", distance[kept] / unloaded, force[kept], swatch.fabric, direction,
        noise_sigma=stray(force[kept]), sensor="load cell; pins and clamps tracked in a video",
        source=f"github.com/{dataset.repository}@{dataset.commit}: {upstream} /video{number}",
        licence=dataset.licence, motion="loading", notes=notes,
    )  # fmt: skip
    return curve, int((~kept).sum())


def _check_points(track: np.ndarray, where: str) -> None:
    """The order of the points is known from where they lie: the clamps beyond the pins, one below, one above."""
    heights = track[:, 1, 0]
    order = [heights[i] for i in (TOP_CLAMP, TOP_PIN, BOTTOM_PIN, BOTTOM_CLAMP)]
    if not (np.isfinite(track).all() and (np.diff(order) > 0).all()):
        raise ClothbenchError(
            f"{where}: found points 6, 3, 2, 5 at heights {', '.join(f'{h:.0f}' for h in order)} px, expected the top "
            "clamp, the top pin, the bottom pin and the bottom clamp from the top down"
        )


def apart(force: np.ndarray) -> np.ndarray:
    """Which readings (M,) stand alone: far from the median of the forty around them."""
    from scipy.ndimage import median_filter

    usual = median_filter(force, size=WINDOW, mode="nearest")
    return np.abs(force - usual) > np.maximum(STRAY[0], STRAY[1] * usual)


def stray(force: np.ndarray) -> float:
    """How far single readings are from the median of five, root-mean-square [N]."""
    from scipy.ndimage import median_filter

    return float(np.sqrt(np.mean((force - median_filter(force, size=5, mode="nearest")) ** 2)))
