"""The files of the IRI cloth-swing data: names, columns, units. Nothing here repairs what it reads."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from clothbench.core.errors import ClothbenchError
from clothbench.datasets.rigid import PosePath, pose_path

NAME = re.compile(r"(?:n(?P<n>\d+)_)?(?P<what>.+)_mesh\.csv")
RANGE = re.compile(r"(?P<motion>range\d+)_rep(?P<repeat>\d+)")
TRAJECTORY = re.compile(r"(?P<motion>traj\d+)_(?P<repeat>\d+)")
# Names of the 2021-07-05 session leave the lattice size out; it was 8 for all of them.
UNNAMED_SIZE = 8


@dataclass(frozen=True)
class Source:
    """One mesh file: session "2021_07_05", lattice size n, motion "range60", repeat 3; "" and 0 if it is
    none.
    """

    path: Path
    session: str
    n: int
    motion: str
    repeat: int

    @property
    def stem(self) -> str:
        return self.path.name.removesuffix("_mesh.csv")

    @property
    def name(self) -> str:
        return f"iri-{self.session}-n{self.n}-{self.motion}-{self.repeat:02d}"

    @property
    def tool(self) -> Path:
        return self.path.with_name(f"{self.stem}_tcp.csv")

    @property
    def camera(self) -> Path:
        return self.path.with_name(f"n{self.n}_calibration_campose.csv")


def find_sources(folder: Path) -> list[Source]:
    """Every mesh file under the sessions of `folder`, in a fixed order; none is an error."""
    found = [_source(path) for path in folder.glob("Session_*/*_mesh.csv")]
    if not found:
        raise ClothbenchError(
            f"{folder}: found no Session_*/*_mesh.csv, expected the IRI cloth-swing files; check data_dir"
        )
    return sorted(found, key=lambda s: (s.session, s.n, s.motion, s.repeat, s.path.name))


def _source(path: Path) -> Source:
    named = NAME.fullmatch(path.name)
    what = named["what"] if named else path.name
    motion = RANGE.fullmatch(what) or TRAJECTORY.fullmatch(what)
    size = int(named["n"]) if named and named["n"] else UNNAMED_SIZE
    session = path.parent.name.removeprefix("Session_")
    return Source(path, session, size, motion["motion"] if motion else "", int(motion["repeat"]) if motion else 0)


def _table(path: Path, columns: list[int] | None = None) -> np.ndarray:
    """Numbers of a CSV with one header line, shape (rows, columns), float64; refuses what is not such a
    table.
    """
    if not path.is_file():
        raise ClothbenchError(f"{path.name} is missing")
    try:
        with path.open(encoding="utf-8") as stream:
            rows = [line for line in stream.read().splitlines()[1:] if line.strip()]
        table = np.loadtxt(rows, delimiter=",", usecols=columns, ndmin=2) if rows else np.empty((0, 0))
    except (ValueError, UnicodeDecodeError, IndexError) as fault:
        raise ClothbenchError(f"{path.name} is not a readable table ({str(fault).splitlines()[0]})") from None
    if not len(table):
        raise ClothbenchError(f"{path.name} holds no rows")
    return table


def read_stamps(path: Path) -> np.ndarray:
    """Header stamps (T,) in ns as int64: float64 would round them to a quarter of a microsecond."""
    lines = path.read_text(encoding="utf-8").splitlines()[1:]
    try:
        return np.array([int(line.split(",", 3)[2]) for line in lines if line.strip()], dtype=np.int64)
    except (ValueError, IndexError):
        raise ClothbenchError(f"{path.name} has a stamp that is not a whole number of nanoseconds") from None


def read_mesh(source: Source) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (T,) in ns and nodes (T, n, n, 3) in m in the camera's optical frame, in the file's own node
    order.
    """
    path = source.path
    if not path.is_file():
        raise ClothbenchError(f"{path.name} is missing")
    nodes = source.n**2
    sizes = _table(path, [4])[:, 0]
    if (sizes != source.n).any():
        raise ClothbenchError(
            f"{path.name} states lattices of size {sizes.min():g}..{sizes.max():g}, expected {source.n}"
        )
    values = _table(path, list(range(5, 5 + 3 * nodes)))
    values = np.where(np.isfinite(values), values, np.nan)
    frames = values.reshape(len(values), 3, source.n, source.n).transpose(0, 2, 3, 1)
    return read_stamps(path), np.where(np.isfinite(frames).all(axis=-1, keepdims=True), frames, np.nan)


def read_tool(source: Source, zero: int) -> PosePath:
    """The tool's measured path in the robot's base frame, in s after the stamp `zero` in ns."""
    table = _table(source.tool, list(range(4, 11)))
    path = pose_path((read_stamps(source.tool) - zero) * 1e-9, table[:, :3], table[:, 3:])
    if len(path.time) < 4:
        raise ClothbenchError(f"{source.tool.name} holds {len(path.time)} usable poses, expected at least 4")
    return path


def read_camera(path: Path) -> tuple[Rotation, np.ndarray]:
    """Camera pose in the robot's base: the last row, when the running calibration had settled."""
    row = _table(path, list(range(1, 8)))[-1]
    if not np.isfinite(row).all() or np.linalg.norm(row[3:]) < 0.5:
        raise ClothbenchError(f"{path.name} ends in a row that is not a pose")
    return Rotation.from_quat(row[3:]), row[:3]
