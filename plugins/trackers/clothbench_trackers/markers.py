"""`markers`: tracked nodes and motion-capture files as an observation, or as a recording of one's own."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from clothbench import ClothbenchError, Observation, Recording, longest_gap, read_recording, stamp_rounding
from clothbench_trackers.marker_files import UNITS, MarkerFile, read_markers, read_material, refusal
from clothbench_trackers.options import is_number

# Proper rotations that turn the file's up axis into z.
UP = {
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "z": np.eye(3),
}
OF_RECORDINGS = {"fill_gaps_up_to", "sigma"}
RIGID = 1e-4  # a transform typed to four decimals still passes: 0.1 mm in a metre
ASIDE = 0.2  # of the cloth's longer side: the least that its middle is off its grips, where it may hang sideways
ALONG, DOWN, MOSTLY = 0.9, 0.2, 0.95  # of the way there, along an axis and along gravity; of the frames
FLAT = 0.01  # width over length below which references lie on a line and leave a rotation open


@dataclass(frozen=True, eq=False)
class Markers:
    """Labelled markers: each is one material point for the whole run, so there is nothing to search for.

    material         {label: (u, v)} m, or a CSV file label,u,v. Its labels become the nodes, others stay out.
    unit, rate       "mm", "cm" or "m"; frames per second. Only where the file states none.
    up               the file's axis that points up; applied first.
    frame            then: a 3×4 or 4×4 rigid transform into the world, or {label: (x, y, z)} m of at least
                     three markers that rest there, fitted by least squares.
    frame_tolerance  m; how far one of these may be off, as root mean square over the frames (so one that
                     moves is refused too).
    fill_gaps_up_to  s between the samples around a gap, up to which a straight line bridges it. A filled node
                     stays "not visible": it helps a drawing, but it was not measured and must not count.
    sigma            standard deviation of one coordinate [m], NaN unless stated. It is not estimated: what a
                     marker at rest scatters hides the errors of a moving one.
    """

    material: Any = None
    unit: str | None = None
    rate: float | None = None
    up: str = "z"
    frame: Any = None
    frame_tolerance: float = 0.005
    fill_gaps_up_to: float = 0.0
    sigma: float | None = None

    name: ClassVar[str] = "markers"
    version: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if self.up not in list(UP):
            raise refusal(self.name, "setting 'up'", repr(self.up), "x, y or z, the file's axis that points up")
        if self.unit not in [None, *UNITS]:
            raise refusal(self.name, "setting 'unit'", repr(self.unit), ", ".join(UNITS))
        for name in ("rate", "frame_tolerance", "fill_gaps_up_to", "sigma"):
            value = getattr(self, name)
            open_too = name in ("rate", "sigma")  # null: the file says it, or nobody knows it
            if not (value is None and open_too) and not (is_number(value) and value >= 0):
                raise refusal(self.name, f"setting '{name}'", repr(value), "a number, 0 or above")

    def track(self, source: Recording | Path) -> Observation:
        """The nodes of a recording (object or .nc file), to which only fill_gaps_up_to and sigma apply, or of a marker
        file. Those of frames before the first or after the last stamp of a recording's grips do not count.
        """
        if isinstance(source, str | Path) and Path(source).suffix.lower() != ".nc":
            path = Path(source)
            material = read_material(self.material, path)
            markers = _in_world(path, self)
            uv, position = np.array(list(material.values())), markers.pick(material, "material")
            sigma = math.nan if self.sigma is None else self.sigma
            return _observation(markers.time, position, np.isfinite(position).all(axis=-1), uv, sigma, self, path)
        if not isinstance(source, str | Path | Recording):
            raise refusal(self.name, "source", type(source).__name__, "nodes, or a marker file", "take another tracker")
        recording = source if isinstance(source, Recording) else read_recording(source)
        where = recording.path or recording.name
        for one in fields(self):
            value = getattr(self, one.name)
            stated = value is not None if one.default is None else value != one.default
            if one.name not in OF_RECORDINGS and stated:
                expected = f"some of {', '.join(sorted(OF_RECORDINGS))}, as a recording is in the world already"
                raise refusal(where, "settings", repr(one.name), expected, "drop it")
        sigma = recording.noise_sigma if self.sigma is None else self.sigma
        r = recording
        seen = _observation(r.time, r.position, r.counts, r.material, sigma, self, where)
        return replace(seen, eye=recording.eye, sight=recording.sight, confidence=recording.confidence)


def recording_from_markers(
    path: str | Path,
    *,
    material: Any,
    grips: Sequence[str],
    cloth_width: float,
    cloth_height: float,
    about: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Recording:
    """A recording from a marker file: the markers named in `grips` hold the cloth, the others are its nodes.

    material, settings: as of `Markers`; cloth_width, cloth_height: m; about: further fields of
    `Recording` (name, fabric, areal_density [kg/m²], motion, licence, split, …). Nodes keep their gaps. The
    grips' clock leaves out frames in which a grip was not seen; no two of its stamps may be more than
    fill_gaps_up_to [s] apart beyond one frame, whether frames in between show nothing of it or are missing
    from the file. Frames before its first and after its last stamp are dropped: what drove the cloth then is
    not known. Without a `frame`, cloth that is beside its grips all the time, along one of the file's axes, is
    refused: it hangs, and another axis is up. Of cloth that is held level, blown or dragged, state one (np.eye(4)).
    """
    path = Path(path)
    told = _told({**settings, "material": material}, path)
    points = read_material(material, path)
    nodes = _nodes_beside(grips, points, path)
    markers = _in_world(path, told)
    held, free = markers.pick(grips, "grips"), markers.pick(nodes, "material")
    seen = np.flatnonzero(np.isfinite(held).all(axis=(1, 2)))
    _check_grip_gaps(markers.time, seen, told.fill_gaps_up_to, path)
    driven = slice(seen[0], seen[-1] + 1)
    header = {
        "name": path.stem,
        "source": path.name,
        "noise_sigma": math.nan if told.sigma is None else told.sigma,
    }
    for what, size in (("cloth_width", cloth_width), ("cloth_height", cloth_height)):
        if not is_number(size):
            raise refusal(path, f"setting '{what}'", repr(size), "metres above 0")
    made = Recording(
        time=markers.time[driven],
        material=np.array([points[label] for label in nodes]),
        position=free[driven],
        grip_time=markers.time[seen],
        grip_material=np.array([points[label] for label in grips]),
        grip_position=held[seen],
        cloth_width=cloth_width,
        cloth_height=cloth_height,
        path=str(path),
        **{**header, **_about(about or {}, path)},
    )
    if told.frame is None and not made.obstacles:
        _check_up(made, np.isfinite(held).all(axis=(1, 2))[driven], held[driven], told.up, path)
    return made


def _check_up(made: Recording, known: np.ndarray, held: np.ndarray, up: str, path: Path) -> None:
    """Refuse cloth that is beside its grips all the time, along one of the file's axes: it hangs, and the axis that is
    up was taken for another. held: (T, G, 3) m; known: (T,), in which frames that is known.
    """
    rows, gravity = known & made.visible.any(axis=1), np.array(made.gravity)
    if not rows.any() or not gravity.any():
        return
    seen = np.where(made.visible[rows][..., None], made.position[rows], np.nan)
    away = np.nanmean(seen, axis=1) - held[rows].mean(axis=1)
    far = np.linalg.norm(away, axis=1)
    aside = np.abs(away @ gravity) < DOWN * np.linalg.norm(gravity) * far
    aside &= far > ASIDE * max(made.cloth_width, made.cloth_height)
    for axis, along in zip(UP, (away @ UP[up]).T, strict=True):
        for sign, remedy in ((-1, f"set up={axis!r}"), (1, "turn it by 'frame'")):
            if (aside & (sign * along > ALONG * far)).mean() >= MOSTLY:
                found = f"{up!r}, and the cloth beside its grips, along {axis}"
                level = "where it is held level, blown or dragged, say so by frame=np.eye(4)"
                raise refusal(path, "setting 'up'", found, "cloth below its grips", f"{level}; else {remedy}")


def fill_gaps(time: np.ndarray, position: np.ndarray, up_to: float) -> np.ndarray:
    """Positions (T, N, 3) m with straight lines across gaps whose edges are no more than `up_to` s apart."""
    filled = position.copy()
    for n in range(position.shape[1]):
        seen = np.flatnonzero(np.isfinite(position[:, n]).all(axis=1))
        wide = (np.diff(seen) > 1) & (np.diff(time[seen]) <= up_to + stamp_rounding(time))
        for a, b in zip(seen[:-1][wide], seen[1:][wide], strict=True):
            share = ((time[a + 1 : b] - time[a]) / (time[b] - time[a]))[:, None]
            filled[a + 1 : b, n] = (1 - share) * position[a, n] + share * position[b, n]
    return filled


def fit_rigid(measured: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The rotation and translation (3, 4) that take points (R, 3) m closest to `wanted` (R, 3) m; no scale.

    Kabsch, Acta Cryst. A 32 (1976) 922; the sign that rules out a mirror image after Umeyama, PAMI 13
    (1991) 376.
    """
    centre, target = measured.mean(axis=0), wanted.mean(axis=0)
    left, _, right = np.linalg.svd((wanted - target).T @ (measured - centre))
    sign = np.sign(np.linalg.det(left @ right))
    rotation = left @ np.diag([1.0, 1.0, sign]) @ right
    return np.column_stack([rotation, target - rotation @ centre])


def _observation(
    time: np.ndarray,
    position: np.ndarray,
    counts: np.ndarray,
    material: np.ndarray,
    sigma: float,
    told: Markers,
    where: object,
) -> Observation:
    """Positions (T, N, 3) m as seen, of which those count that `counts` (T, N) says."""
    if not counts.any():
        raise refusal(where, "position", "no sample of any node", "at least one, while the grips are known")
    position = np.where(np.isfinite(position).all(axis=-1)[..., None], position, np.nan)
    if told.fill_gaps_up_to > 0:
        position = fill_gaps(time, position, told.fill_gaps_up_to)
    return Observation(time, position, counts, sigma, material)


def _told(given: Mapping[str, Any], path: Path) -> Markers:
    """The settings as given for a file, checked."""
    known = {f.name for f in fields(Markers)}
    for name in given:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            remedy = f"did you mean {close[0]!r}?" if close else "drop it"
            raise refusal(path, "settings", repr(name), f"one of {', '.join(sorted(known))}", remedy)
    try:
        return Markers(**given)
    except ClothbenchError as fault:
        raise ClothbenchError(str(fault).replace(Markers.name, str(path), 1)) from fault


def _in_world(path: Path, told: Markers) -> MarkerFile:
    """The file's markers in the world frame, z up."""
    raw = read_markers(path, unit=told.unit, rate=told.rate)
    upright = MarkerFile(path, raw.labels, raw.time, raw.position @ UP[told.up].T)
    if told.frame is None:
        return upright
    if isinstance(told.frame, Mapping):
        transform = _fitted(upright, told.frame, told.frame_tolerance)
    else:
        transform = _stated(told.frame, path)
    return MarkerFile(path, raw.labels, raw.time, upright.position @ transform[:, :3].T + transform[:, 3])


def _stated(frame: Any, path: Path) -> np.ndarray:
    """A transform as the user wrote it → (3, 4), checked to be rigid."""
    what, expected = "setting 'frame'", "a 3×4 or 4×4 rigid transform, or {label: [x, y, z]} [m]"
    try:
        matrix = np.array(frame, dtype=float)
    except (TypeError, ValueError):
        raise refusal(path, what, repr(frame), expected) from None
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise refusal(path, what, f"shape {matrix.shape}, or a value that is not finite", expected)
    if matrix.shape == (4, 4) and not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise refusal(path, what, f"the last row {matrix[3].tolist()}", "0 0 0 1", "is it transposed?")
    rotation = matrix[:3, :3]
    if not np.allclose(rotation.T @ rotation, np.eye(3), atol=RIGID) or np.linalg.det(rotation) < 0:
        raise refusal(path, what, "a matrix that scales, shears or mirrors", "a rotation", "give its unit axes")
    return matrix[:3]


def _fitted(markers: MarkerFile, references: Mapping[str, Any], tolerance: float) -> np.ndarray:
    """The transform (3, 4) that puts resting reference markers where they are known to be."""
    what = "setting 'frame'"
    samples, wanted = markers.pick(references, "frame"), _stated_places(references, markers.path)
    seen = np.isfinite(samples).all(axis=-1)
    if not seen.any(axis=0).all():
        unseen = list(references)[int(np.argmin(seen.any(axis=0)))]
        raise refusal(markers.path, what, f"{unseen!r}, which is never seen", "references that are", "choose others")
    measured = np.nanmean(samples, axis=0)
    for points in (measured, wanted):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spread[1] <= FLAT * spread[0]:
            raise refusal(markers.path, what, "references on one line", "three that span a triangle", "add one")
    transform = fit_rigid(measured, wanted)
    away = np.linalg.norm(samples @ transform[:, :3].T + transform[:, 3] - wanted, axis=-1)
    off = np.sqrt(np.nanmean(away**2, axis=0))
    worst = int(np.argmax(off))
    if off[worst] > tolerance:
        found = f"{list(references)[worst]!r} off by {off[worst]:.4g} m"
        remedy = "correct its place or unit, or use markers that rest"
        raise refusal(markers.path, what, found, f"at most {tolerance:g} m ('frame_tolerance')", remedy)
    return transform


def _stated_places(references: Mapping[str, Any], path: Path) -> np.ndarray:
    """World coordinates (R, 3) m of the references, R ≥ 3."""
    try:
        places = np.array([list(place) for place in references.values()], dtype=float)
    except (TypeError, ValueError):
        places = np.zeros((0, 0))
    if len(references) < 3 or places.shape[1:] != (3,) or not np.isfinite(places).all():
        expected = "at least three labels, each with three numbers x, y, z [m]"
        raise refusal(path, "setting 'frame'", dict(references), expected)
    return places


def _nodes_beside(grips: Sequence[str], points: Mapping[str, Any], path: Path) -> list[str]:
    """The labels that are not grips: at least one, beside at least one grip."""
    what = "setting 'grips'"
    if isinstance(grips, str) or not grips or len(set(grips)) != len(grips):
        raise refusal(path, what, repr(grips), "a list of different marker labels")
    for label in grips:
        if label not in points:
            raise refusal(path, what, repr(label), "a label with its (u, v) in 'material'", "add it there")
    nodes = [label for label in points if label not in grips]
    if not nodes:
        raise refusal(path, what, "every marker held", "at least one free one", "name fewer grips")
    return nodes


def _check_grip_gaps(time: np.ndarray, seen: np.ndarray, up_to: float, path: Path) -> None:
    """Refuse grips that nobody saw for longer than `up_to` s while the cloth was moved."""
    if seen.size < 2:
        raise refusal(path, "setting 'grips'", f"{seen.size} frames with all of them seen", "at least 2")
    gap, begin = longest_gap(time, seen)
    if gap > up_to + stamp_rounding(time):
        found = f"none for {gap:g} s after {begin:.10g} s"
        expected = f"all seen, or gaps of at most {up_to:g} s"
        raise refusal(path, "setting 'grips'", found, expected, "set 'fill_gaps_up_to' [s] if that is harmless")


def _about(about: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    """Fields of the recording that the markers do not give, by name."""
    own = {"time", "material", "position", "cloth_width", "cloth_height", "noise_sigma", "path"}
    known = {f.name for f in fields(Recording) if f.name not in own and not f.name.startswith("grip_")}
    for name in about:
        if name not in known:
            raise refusal(path, "setting 'about'", repr(name), f"some of {', '.join(sorted(known))}", "drop it")
    return about
