"""A sheet, its tool and the rig → one recording, and the account of every frame that did not make it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.datasets.iri_alignment import capture_times, clock_offset
from clothbench.datasets.iri_files import read_tool
from clothbench.datasets.iri_rest import first_rest, settled
from clothbench.datasets.iri_rig import SLOW, Rig, Take, miss_of
from clothbench.datasets.iri_sheets import SIDE, SIZE_SLACK, Sheet
from clothbench.datasets.report import ImportReport
from clothbench.recordings.nodes import Recording

HANGER_SLACK = 0.025  # m; the hanger is rigid, so an upper edge seen further from it belongs to another time or shape
GRIP_STEP = 0.01  # s; fine enough that linear interpolation between grip samples adds no kicks
FEWEST_FRAMES = 20
UPPERMOST = 0.09  # m below the hanger, over which the sheet is taken for straight
SENSOR = "RGB-D camera, cloth outline meshed to n × n nodes, ~10 Hz; tool pose by joint encoders, ~20 Hz"


@dataclass(frozen=True)
class Origin:
    """What the data set says of a recording: source text, licence, split, and remarks for the report."""

    source: str
    licence: str
    split: str
    remarks: tuple[str, ...] = ()


def take_of(sheet: Sheet) -> Take:
    """What the alignment needs of one sheet; times count from its first stamp."""
    if len(sheet.stamp) < FEWEST_FRAMES:
        found = f"{len(sheet.stamp)} of {sheet.frames_in} frames usable"
        raise ClothbenchError(f"only {found}, expected at least {FEWEST_FRAMES}")
    n, zero = sheet.source.n, int(sheet.stamp[0])
    grid = sheet.position.reshape(-1, n, n, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a frame may have no two nodes below one another
        column = np.nanmean(grid[:, 1:] - grid[:, :-1], axis=(1, 2))
        hang = np.nanmean(grid[:, max(1, round(UPPERMOST / SIDE * (n - 1)))] - grid[:, 0], axis=1)
    column, hang = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (column, hang))
    time = (sheet.stamp - zero) * 1e-9
    return Take(time, sheet.gap, grid[:, 0], column, hang, read_tool(sheet.source, zero), np.linspace(0.0, SIDE, n))


@dataclass(frozen=True, eq=False)
class Matched:
    """A take on the tool's clock: capture `time` (T,) s, how far down the sheet its outline begins `further` (T,) m,
    the upper row's `miss` (T, n) m from the hanger beside that, `good` (T,) frames, `dropped` reasons, `own`
    lateness (T,) s taken off each frame, the clock offset and what is known of it.
    """

    time: np.ndarray
    further: np.ndarray
    miss: np.ndarray
    good: np.ndarray
    dropped: dict[str, int]
    own: np.ndarray
    offset: float
    sigma: float
    determined: bool


def match(sheet: Sheet, take: Take, rig: Rig) -> Matched:
    """Bring a take to the tool's clock and sort out the frames that do not belong there."""
    offset, sigma, determined = clock_offset(rig, take)
    time = capture_times(rig, take, offset)
    row = miss_of(rig, take, time)
    further, miss = np.nan_to_num(row.along), np.linalg.norm(row.points, axis=-1)
    dropped = dict(sheet.dropped)
    away = (_middle(miss) > HANGER_SLACK) | (np.abs(further) > SIZE_SLACK * SIDE)
    good = _agreeing(sheet, take, time, away, dropped)
    if good.sum() < FEWEST_FRAMES:
        raise ClothbenchError(f"only {good.sum()} of {sheet.frames_in} frames usable ({_listed(dropped)})")
    own = take.time - rig.age(take, offset) - time
    return Matched(time, further, miss, good, dropped, own, offset, sigma, determined)


def build(sheet: Sheet, take: Take, rig: Rig, noise: float, origin: Origin) -> tuple[Recording, ImportReport]:
    """The recording of one sheet and its report (without the paths, which are not known here)."""
    matched = match(sheet, take, rig)
    sheet = sheet.of(matched.good)
    position, masked = sheet.labelled(matched.further[matched.good])
    report = _report(sheet, matched, masked, noise, origin)
    time = matched.time[matched.good]
    grip_time = _grip_clock(float(time[0]), float(time[-1]))
    recording = Recording(
        name=sheet.source.name,
        time=time - time[0],
        material=sheet.material,
        position=rig.corrected(position),
        grip_time=grip_time - time[0],
        grip_material=np.stack([take.u, np.zeros_like(take.u)], axis=-1),
        grip_position=take.tool.carried(grip_time, rig.held(take.u)),
        cloth_width=SIDE,
        cloth_height=SIDE,
        noise_sigma=noise,
        fabric=f"iri-{sheet.source.session}-n{sheet.source.n}",
        sensor=SENSOR,
        source=origin.source,
        licence=origin.licence,
        motion=sheet.source.motion,
        split=origin.split,
        notes=_notes(rig, report, matched, _moving(take, matched)),
    )
    return recording, report


def _report(sheet: Sheet, matched: Matched, masked: Mapping[str, int], noise: float, origin: Origin) -> ImportReport:
    remarks = list(origin.remarks)
    if not matched.determined:
        remarks.append("the motion does not determine the clock offset; the median of its session is used")
    return ImportReport(
        source="",
        frames_in=sheet.frames_in,
        frames_kept=int(matched.good.sum()),
        dropped=matched.dropped,
        nodes_masked=dict(masked),
        reordered=sheet.reordered,
        clock_offset_s=matched.offset,
        clock_offset_sigma_s=matched.sigma,
        grip_residual_m=float(np.sqrt(np.nanmean(matched.miss[matched.good] ** 2))),
        noise_sigma_m=noise,
        notes=tuple(remarks),
    )


def _agreeing(sheet: Sheet, take: Take, time: np.ndarray, away: np.ndarray, dropped: dict[str, int]) -> np.ndarray:
    """Frames (T,) that agree with the tool's clock and place, from the first rest on; counts the others by
    reason.
    """
    good = np.ones(len(time), dtype=bool)

    def drop(bad: np.ndarray, why: str) -> None:
        if count := int((bad & good).sum()):
            dropped[why] = dropped.get(why, 0) + count
        good[bad] = False

    drop((time < take.tool.time[0]) | (time > take.tool.time[-1]), "outside the tool's clock")
    drop(away, "upper edge away from the hanger")
    newest = np.maximum.accumulate(np.where(good, time, -np.inf))
    drop(np.concatenate([[False], time[1:] < newest[:-1] + 1e-3]), "image not newer than the one before")
    rest = first_rest(take, time) & good
    if not rest.any():
        raise ClothbenchError("the tool is never at rest, so the cloth's state at the start is not known")
    drop(np.arange(len(time)) < settled(sheet.position, rest), "before tool and cloth first rest")
    return good


def _middle(miss: np.ndarray) -> np.ndarray:
    """Median (T,) over the seen points of an edge (T, n); 0 where none was seen."""
    ranked = np.sort(miss, axis=1)  # NaN last
    seen = np.isfinite(miss).sum(axis=1)
    at = np.maximum(seen - 1, 0) // 2
    return np.where(seen > 0, ranked[np.arange(len(miss)), at], 0.0)


def _grip_clock(start: float, end: float) -> np.ndarray:
    """Stamps (K,) s for the grips, from the first kept frame to the last one exactly."""
    clock = np.arange(start, end, GRIP_STEP)
    return np.append(clock[end - clock > 1e-3], end)


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {why}" for why, count in counts.items()) or "none dropped"


def _moving(take: Take, matched: Matched) -> float:
    """Root mean square in m per coordinate by which the upper row misses the moving hanger."""
    fast = matched.good & (np.linalg.norm(take.tool.velocity(matched.time), axis=1) > SLOW)
    squares = matched.miss[fast] ** 2
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean() / 3)) if len(squares) else float("nan")


def _notes(rig: Rig, report: ImportReport, matched: Matched, moving: float) -> dict[str, str]:
    """What was changed, with numbers, as attributes of the recording."""
    own = matched.own[matched.good]
    return {
        "clock_offset_removed_s": f"{report.clock_offset_s:.4f}",
        "clock_offset_sigma_s": f"{report.clock_offset_sigma_s:.4f}",
        "clock_offset_per_gap": f"{rig.per_gap:.3f}",
        "frame_lateness_removed_rms_s": f"{np.sqrt(np.mean(own**2)):.4f}",
        "outline_begins_rms_m": f"{np.sqrt(np.mean(matched.further[matched.good] ** 2)):.4f}",
        "camera_turn_corrected_deg": " ".join(f"{angle:.3f}" for angle in np.rad2deg(rig.turn)),
        "grip_residual_m": f"{report.grip_residual_m:.4f}",
        "noise_sigma_moving_m": f"{moving:.4f}",
        "frames_in": str(report.frames_in),
        "frames_dropped": _listed(dict(report.dropped)),
        "nodes_masked": _listed(dict(report.nodes_masked)),
        "relabelled": "positions are the measured surface at fixed material points: unrolled, from the hanger down",
        "fabric_note": "name and mass of the fabric are not stated by the source",
        "remarks": "; ".join(report.notes),
    }


def with_paths(report: ImportReport, source: str, output: str | None) -> ImportReport:
    """The report with the files it is about."""
    return replace(report, source=source, output=output)
