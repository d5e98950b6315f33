"""Marker files: labelled positions over time from CSV, TRC and C3D, in metres; nothing guessed or half read.

CSV: lines `# unit: mm` and `# rate: 100` (or the settings of these names), then the header
`frame,time,LABEL_x,LABEL_y,LABEL_z,…` and one line per frame. `frame` and `time` [s] may be left out where
a rate is known; semicolons may part the cells, and then commas be decimal. Not seen: an empty cell or NaN; in TRC and
C3D, whose writers put zeros there, also exactly 0 0 0; in C3D also a negative residual. A marker of a CSV file that
jumps to 0 0 0 is refused.
"""

from __future__ import annotations

import csv
import difflib
import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothbench import ClothbenchError

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
CLOCKS = {"frame": "frame", "time": "time", "time [s]": "time"}
OF_PROGRAMS = {"Format Version": "Motive", "Trajectories": "Vicon Nexus", "Model Outputs": "Vicon Nexus"}  # first cells
JUMP = 3.0  # times the longest step of a marker beyond which it has not moved to 0 0 0
C3D_MARK = b"\x50"  # the second byte of every C3D file


def refusal(where: object, what: str, found: object, expected: str, remedy: str = "") -> ClothbenchError:
    """The one line in which this package refuses an input."""
    line = f"{where}: {what}: found {found}, expected {expected}"
    return ClothbenchError(f"{line}; {remedy}" if remedy else line)


@dataclass(frozen=True, eq=False)
class MarkerFile:
    """What a marker file holds.

    labels: N different ones; time: (T,) s, strictly increasing; position: (T, N, 3) m in the file's own axes,
    NaN where not seen.
    """

    path: Path
    labels: tuple[str, ...]
    time: np.ndarray
    position: np.ndarray

    def pick(self, labels: Iterable[str], setting: str) -> np.ndarray:
        """The positions (T, n, 3) m of the named markers; `setting` is where the user named them."""
        labels = [str(label) for label in labels]
        for label in labels:
            if label not in self.labels:
                close = difflib.get_close_matches(label, self.labels, n=1)
                hint = f"did you mean {close[0]!r}?" if close else f"it has {shortened(self.labels)}"
                raise refusal(self.path, f"setting '{setting}'", f"label {label!r}", "a label of this file", hint)
        return self.position[:, [self.labels.index(label) for label in labels]]


@dataclass(frozen=True, eq=False)
class _Raw:
    """A file as it stands: position (T, N, 3) in `unit`; frame and time (T,) or None; rate 1/s or None."""

    labels: Sequence[str]
    position: np.ndarray
    unit: str
    rate: float | None
    frame: np.ndarray | None = None
    time: np.ndarray | None = None


def read_markers(path: Path, *, unit: str | None = None, rate: float | None = None) -> MarkerFile:
    """Read and check one marker file. `unit` (mm, cm, m) and `rate` [1/s] say what the file leaves unsaid."""
    reader = {".csv": _read_csv, ".trc": _read_trc, ".c3d": _read_c3d}.get(path.suffix.lower())
    if reader is None:
        raise refusal(path, "file", f"the ending {path.suffix!r}", ".csv, .trc, .c3d, or .nc (a recording)")
    if not path.is_file():
        raise ClothbenchError(f"{path}: no such file; give a marker file (.csv, .trc, .c3d)")
    raw = reader(path)
    _check_labels(raw.labels, path)
    _check_positions(raw, path)
    scale = _scale(raw.unit, unit, path)
    return MarkerFile(path, tuple(raw.labels), _clock(raw, rate, path), raw.position * scale)


def read_material(material: Any, path: Path) -> dict[str, tuple[float, float]]:
    """Marker label → (u, v) m, from a mapping or a CSV file label,u,v; `path` is the marker file."""
    if isinstance(material, Mapping):
        where, pairs = f"{path}: setting 'material'", list(material.items())
    elif isinstance(material, str | Path):
        where, pairs = str(material), _material_rows(Path(material))
    else:
        found = "none" if material is None else type(material).__name__
        expected = "{label: [u, v]} [m], or a CSV file with the header label,u,v"
        raise refusal(path, "setting 'material'", found, expected, "say where on the cloth each marker sits")
    points: dict[str, tuple[float, float]] = {}
    for label, uv in pairs:
        point = _point(label, uv, where)
        if str(label) in points or point in points.values():
            raise refusal(where, f"label {label!r}", f"it, or its point {point} m, twice", "each once", "drop one")
        points[str(label)] = point
    if not points:
        raise refusal(where, "labels", "none", "at least one with its u, v [m]")
    return points


def shortened(labels: Sequence[str], most: int = 8) -> str:
    """A list of labels that fits into a line."""
    return ", ".join(labels[:most]) + (f" and {len(labels) - most} more" if len(labels) > most else "")


def _read_csv(path: Path) -> _Raw:
    stated, lines = _csv_lines(path)
    names = [cell.strip() for cell in lines[0][1]] if lines else []
    if names and names[0] in OF_PROGRAMS:
        program = OF_PROGRAMS[names[0]]
        expected = "LABEL_x, LABEL_y, LABEL_z after frame and time"
        raise refusal(path, "header", f"{program}'s own layout", expected, f"export C3D from {program}, or rewrite it")
    lead = [CLOCKS[name.lower()] for name in names[:2] if name.lower() in CLOCKS]
    labels = _csv_labels(names[len(lead) :], path)
    # Without a clock frames are counted, also those in which no marker was seen.
    frames = [(n, cells) for n, cells in lines[1:] if (any(cell.strip() for cell in cells) if lead else cells)]
    between = [n for n, cells in lines[1:] if not cells and frames and frames[0][0] < n < frames[-1][0]]
    if between and not lead:
        expected = "frames without a gap: where there is neither frame nor time, rows are counted"
        raise refusal(path, f"line {between[0]}", "nothing at all", expected, "write its commas, or take it out")
    table = _table(frames, len(names), path)
    position = _triples(table[:, len(lead) :])
    _check_zeros(position, labels, path)
    clock = dict(zip(lead, table.T, strict=False))
    rate = _number(stated["rate"], "line '# rate:'", path) if "rate" in stated else None
    unit = stated.get("unit", "")
    return _Raw(labels, position, unit, rate, clock.get("frame"), clock.get("time"))


def _csv_lines(path: Path) -> tuple[dict[str, str], list[tuple[int, list[str]]]]:
    """The `# key: value` lines, and the others from the header on as (line number, cells), without any cell where
    nothing stands there. Where the header has semicolons and no comma, they part the cells and commas are decimal, in
    the rate, too.
    """
    stated: dict[str, str] = {}
    lines: list[tuple[int, list[str]]] = []
    semicolons = False
    for number, text in enumerate(_text(path), 1):
        if text.startswith("#"):
            key, _, value = text[1:].rstrip(",; ").partition(":")
            key, value = key.strip().lower(), value.strip()
            if key in ("unit", "rate") and stated.get(key, value) != value:
                raise refusal(
                    path, f"line '# {key}:'", f"{stated[key]!r} and {value!r}", "one of them", "drop the other"
                )
            stated[key] = value
        elif lines or text.strip(",; "):
            semicolons = semicolons or (not lines and ";" in text and "," not in text)
            text = text.replace(",", ".").replace(";", ",") if semicolons else text
            lines.append((number, next(csv.reader([text])) if text.strip() else []))
    if semicolons and "rate" in stated:
        stated["rate"] = stated["rate"].replace(",", ".")
    return stated, lines


def _csv_labels(names: Sequence[str], path: Path) -> list[str]:
    """The markers of the columns LABEL_x, LABEL_y, LABEL_z; a point, colon or space may stand for the bar."""
    labels = []
    for i in range(0, max(len(names), 1), 3):
        found = [re.fullmatch(r"(.+)[ _.:]([xyz])", name, re.IGNORECASE) for name in names[i : i + 3]]
        if [m and m[2].lower() for m in found] != ["x", "y", "z"] or len({m and m[1] for m in found}) != 1:
            columns = shortened(names[i : i + 3]) or "no columns"
            raise refusal(path, "header", columns, "LABEL_x, LABEL_y, LABEL_z after frame and time", "rename them")
        labels.append(str(found[0] and found[0][1]))
    return labels


def _read_trc(path: Path) -> _Raw:
    lines = [text.split("\t") for text in _text(path)]
    if len(lines) < 5 or lines[0][0].strip() != "PathFileType":
        expected = "TRC: five header lines from 'PathFileType' on, parted by tabs"
        raise refusal(path, "header", f"{len(lines)} lines from {lines[0][0][:20]!r} on" if lines else "none", expected)
    stated = {key.strip(): value.strip() for key, value in zip(lines[1], lines[2], strict=False)}
    labels = _trc_labels(lines[3], lines[4], stated.get("NumMarkers", ""), path)
    rows = [(i, cells) for i, cells in enumerate(lines[5:], 6) if "".join(cells).strip()]
    table = _table(rows, 2 + 3 * len(labels), path)
    if str(len(table)) != stated.get("NumFrames"):
        raise refusal(path, "NumFrames", f"{len(table)} frames", f"{stated.get('NumFrames')}", "export it again")
    position = _without_zeros(_triples(table[:, 2:]))
    rate = _number(stated["DataRate"], "DataRate", path) if stated.get("DataRate") else None
    return _Raw(labels, position, stated.get("Units", ""), rate, table[:, 0], table[:, 1])


def _trc_labels(names: Sequence[str], axes: Sequence[str], count: str, path: Path) -> list[str]:
    """The labels of header line 4, each over its three columns, of which line 5 names the axes."""
    labels = [cell.strip() for cell in names[2::3] if cell.strip()]
    if names[0].strip() != "Frame#" or [cell.strip() for cell in axes[2:3]] != ["X1"]:
        raise refusal(path, "header lines 4 and 5", f"{names[0]!r}, {axes[2:3]}", "Frame#, Time, labels over X1 Y1 Z1")
    if str(len(labels)) != count:
        raise refusal(path, "NumMarkers", f"{len(labels)} labels", count or "a number", "export it again")
    return labels


def _read_c3d(path: Path) -> _Raw:
    try:
        import c3d
    except ImportError:
        raise ClothbenchError(f"{path}: C3D is read with the package c3d; pip install clothbench[c3d]") from None
    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of what a marker file need not have; a cut end is caught below
        if (start := stream.read(2))[1:] != C3D_MARK:
            raise refusal(path, "header", repr(start), "C3D, second byte 0x50", "export it again")
        try:
            return _c3d_content(c3d.Reader(stream), path)
        except ClothbenchError:
            raise
        except Exception as fault:  # whatever the library trips over in a broken file
            what = (str(fault).splitlines() or [type(fault).__name__])[0]
            raise refusal(path, "data", f"an unreadable file ({what})", "whole C3D", "copy it again") from fault


def _c3d_content(reader: Any, path: Path) -> _Raw:
    """The labelled points of an open C3D file; a point without a label has no identity to lose."""
    if reader.point_used < 1:  # the library would count frames of nothing without end
        raise refusal(path, "data", "no points", "at least one marker")
    points = np.array([frame[:, :4] for _, frame, _ in reader.read_frames()], dtype=float)
    first, last = int(reader.first_frame), int(reader.last_frame)
    if len(points) != last - first + 1:
        found, expected = f"{len(points)} frames", f"{last - first + 1} by the header"
        raise refusal(path, "data", found, expected, "it is cut, copy it again")
    labels = _c3d_labels(reader.get("POINT"))[: points.shape[1]]
    known = [i for i, label in enumerate(labels) if label]
    position = _without_zeros(np.where(points[..., 3:] < 0, np.nan, points[..., :3]))[:, known]
    unit, frame = reader.get("POINT:UNITS"), np.arange(first - 1, last)
    stated = unit.string_value.strip("\0 ") if unit else ""
    return _Raw([labels[i] for i in known], position, stated, float(reader.point_rate), frame)


def _c3d_labels(group: Any) -> list[str]:
    """POINT:LABELS holds 255 at most; what does not fit is in LABELS2 and so on."""
    keys = sorted((k for k in group.param_keys() if re.fullmatch(r"LABELS\d*", k)), key=lambda k: (len(k), k))
    return [str(label).strip("\0 ") for key in keys for label in np.ravel(group.get(key).string_array)]


def _text(path: Path) -> list[str]:
    """The lines of a text file. What is not UTF-8 (older exporters) is replaced: it can only be in a name."""
    return path.read_text(encoding="utf-8-sig", errors="replace").splitlines()


def _table(lines: Iterable[tuple[int, list[str]]], width: int, path: Path) -> np.ndarray:
    """Numbered lines of cells → (T, width); an empty cell is NaN, beyond the last column it is nothing."""
    rows = []
    for number, cells in lines:
        cells = cells[:width] + [cell for cell in cells[width:] if cell.strip()]
        if len(cells) != width:
            raise refusal(path, f"line {number}", f"{len(cells)} columns", f"{width}", "export the file again")
        rows.append([_number(cell, f"line {number}, column {i}", path) for i, cell in enumerate(cells, 1)])
    if not rows:
        raise refusal(path, "data", "no frames below the header", "at least one", "export the file again")
    return np.array(rows)


def _number(text: str, what: str, path: Path) -> float:
    try:
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise refusal(path, what, repr(text), "a number") from None


def _triples(table: np.ndarray) -> np.ndarray:
    return table.reshape(len(table), -1, 3)


def _without_zeros(position: np.ndarray) -> np.ndarray:
    """Positions with NaN for exactly 0 0 0: how a writer without a blank says "not seen"."""
    return np.where((position == 0).all(axis=-1, keepdims=True), np.nan, position)


def _check_zeros(position: np.ndarray, labels: Sequence[str], path: Path) -> None:
    """Refuse a marker that is at 0 0 0 in some frames and comes there, or leaves, by a jump: so some writers say that
    it was not seen, and it would count as seen. position: (T, N, 3) in any unit.
    """
    known = np.where(np.isinf(position), np.nan, position)  # what is infinite is refused in words of its own
    step = np.linalg.norm(np.diff(known, axis=0), axis=-1)
    at_zero = (position == 0).all(axis=-1)
    one = at_zero[1:] != at_zero[:-1]
    most = np.nan_to_num(np.where(one, 0.0, step)).max(axis=0, initial=0.0)
    for n in map(int, np.flatnonzero((one & (step > JUMP * most)).any(axis=0))):
        t = int(np.flatnonzero(at_zero[:, n])[0])
        found, expected = "0 0 0, into or out of which it jumps", "nothing where it was not seen"
        raise refusal(
            path, f"marker {labels[n]!r}, frame {t + 1} of the file", found, expected, "leave its cells empty"
        )


def _check_labels(labels: Sequence[str], path: Path) -> None:
    twice = [label for i, label in enumerate(labels) if label in labels[:i]]
    if twice:
        raise refusal(path, "labels", f"{twice[0]!r} twice", "each label once", "rename one")
    if not labels:
        raise refusal(path, "labels", "none", "at least one", "label the markers before the export")


def _check_positions(raw: _Raw, path: Path) -> None:
    known = np.isfinite(raw.position).sum(axis=-1)
    for bad, found, expected in (
        (np.isinf(raw.position).any(axis=-1), "an infinite value", "a length, or nothing (not seen)"),
        ((known == 1) | (known == 2), "a part of the coordinates", "all three or none"),
    ):
        if bad.any():
            t, n = np.argwhere(bad)[0]
            raise refusal(path, f"marker {raw.labels[n]!r}, frame {t + 1} of the file", found, expected)


def _agreed(stated: Any, setting: Any, what: str, path: Path) -> Any:
    """What the file states, else the setting; both only if they say the same."""
    if setting is None or not stated:
        return stated or setting
    if stated != setting:
        raise refusal(path, what, f"{stated} in the file", f"{setting} by the setting '{what}'", "drop one of them")
    return stated


def _scale(stated: str, setting: str | None, path: Path) -> float:
    """Metres in the file's unit of length."""
    unit = _agreed(stated.strip().lower(), setting, "unit", path)
    if unit not in UNITS:
        remedy = "" if stated else "state it in the file or with the setting 'unit'"
        raise refusal(path, "unit", repr(unit) if unit else "none", ", ".join(UNITS), remedy)
    return UNITS[unit]


def _clock(raw: _Raw, setting: float | None, path: Path) -> np.ndarray:
    """The frames' stamps (T,) s: the file's own, which must agree with its rate, or frame over rate."""
    rate = _agreed(raw.rate, setting, "rate", path)
    if rate is None and raw.time is None:
        raise refusal(path, "rate", "neither a time column nor a frame rate", "one of them", "set 'rate' [1/s]")
    if rate is not None and not (math.isfinite(rate) and rate > 0):
        raise refusal(path, "rate", rate, "frames per second above 0")
    frame = np.arange(len(raw.position)) if raw.frame is None else raw.frame
    with np.errstate(over="ignore", invalid="ignore"):
        time = np.asarray(frame / rate if raw.time is None else raw.time)
    wrong = np.flatnonzero(~np.isfinite(time) | ~(np.diff(time, prepend=-np.inf) > 0))
    if wrong.size:
        i = wrong[0]
        raise refusal(path, "time", f"{time[i]:g} s in frame {i + 1} of the file", "strictly increasing seconds")
    if rate is not None:
        _check_rate(time, frame, rate, path)
    return time


def _check_rate(time: np.ndarray, frame: np.ndarray, rate: float, path: Path) -> None:
    """Stamps and rate tell one duration, to 1 % and a frame: stamps are rounded, frames may be left out."""
    with np.errstate(over="ignore", invalid="ignore"):
        lasts, told = time[-1] - time[0], (frame[-1] - frame[0]) / rate
    if not (math.isfinite(told) and abs(lasts - told) <= 0.01 * told + 1 / rate):
        found, expected = f"stamps over {lasts:g} s", f"{told:g} s by the frames and the rate of {rate:g}/s"
        raise refusal(path, "time", found, expected, "correct one of them")


def _material_rows(path: Path) -> list[tuple[str, Any]]:
    """The pairs of label and (u, v) in a small CSV file."""
    if not path.is_file():
        raise ClothbenchError(f"{path}: no such file; give the markers' places on the cloth as label,u,v [m]")
    rows = [[cell.strip() for cell in row] for row in csv.reader(_text(path)) if row]
    if not rows or rows[0] != ["label", "u", "v"]:
        raise refusal(
            path, "header", repr(",".join(rows[0])) if rows else "none", "'label,u,v', then a line per marker"
        )
    return [(row[0], row[1:]) for row in rows[1:]]


def _point(label: Any, uv: Any, where: str) -> tuple[float, float]:
    try:
        u, v = (float(value) for value in uv)
    except (TypeError, ValueError):
        u = v = math.nan
    if not (math.isfinite(u) and math.isfinite(v)):
        raise refusal(where, f"label {label!r}", uv, "two numbers u, v [m]")
    return u, v
