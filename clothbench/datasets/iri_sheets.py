"""One mesh file of the IRI data → one sheet: node positions at fixed material points, and what had to be
left out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from clothbench.datasets import lattice
from clothbench.datasets.iri_files import Source, read_camera, read_mesh
from clothbench.datasets.lattice_faults import jumped as jumped_nodes
from clothbench.datasets.lattice_faults import torn
from clothbench.datasets.node_order import put_in_order

SIDE = 0.30  # m; the data's paper says 30 × 30 cm, middle rows and columns measure 0.298 × 0.300 m
ENOUGH_NODES = 0.5  # of a frame's nodes
SIZE_SLACK = 0.15  # of the side; a frame that lost more of its width or height shows another outline, not this cloth
FLAT_SLACK = 0.10  # of the node spacing; a lattice that misses flatness by more is torn or folded over itself

BY_FRAME = ("stamp", "gap", "surface", "jumped", "flat", "position")


@dataclass(eq=False)
class Sheet:
    """What became of one mesh file.

    stamp: (T,) ns; gap: (T,) s to the stamp before;
    surface: (T, n, n, 3) m in the robot's base, the measured lattices in order, NaN = not seen;
    jumped: (T, n·n), nodes that were taken out of it;
    flat: (T, n·n, 2) m, where these nodes lie when the sheet is unrolled onto its outline;
    position: (T, n·n, 3) m, the surface at the nominal material points, labelled by the outline;
    frames_in, reordered: counts; dropped: counts by reason.
    """

    source: Source
    stamp: np.ndarray
    gap: np.ndarray
    surface: np.ndarray
    jumped: np.ndarray
    flat: np.ndarray
    position: np.ndarray
    frames_in: int
    reordered: int
    dropped: Counter[str] = field(default_factory=Counter)

    @property
    def material(self) -> np.ndarray:
        """Material coordinates (n·n, 2) in m."""
        return lattice.nominal(self.source.n, SIDE)

    def keep(self, good: np.ndarray, why: str) -> None:
        """Drop the frames that are not `good` (T,) and count them under `why`."""
        if not good.all():
            self.dropped[why] += int((~good).sum())
            self.__dict__.update(vars(self.of(good)))

    def of(self, good: np.ndarray) -> Sheet:
        """The same with the frames that are `good` (T,) only."""
        return replace(self, **{name: getattr(self, name)[good] for name in BY_FRAME})

    def labelled(self, further: np.ndarray) -> tuple[np.ndarray, Counter[str]]:
        """The surface at the nominal material points (T, n·n, 3), each frame's nodes `further` (T,) m down the sheet
        than its outline says; and how many are masked, by reason.
        """
        moved = self.flat + np.stack([np.zeros_like(further), further], axis=-1)[:, None]
        position, unseen, outside = lattice.resample(self.surface, moved, SIDE)
        faults = {
            "jumped away from its neighbours": self.jumped,
            "not seen near by": unseen & ~self.jumped,
            "outside the seen outline": outside,
        }
        return position, Counter({why: int(bad.sum()) for why, bad in faults.items() if bad.any()})


def read_sheet(source: Source) -> Sheet:
    """Read, order, turn upright and relabel one mesh file; drops what is not a picture of this cloth."""
    stamp, frames = read_mesh(source)
    rotation, origin = read_camera(source.camera)
    frames = np.einsum("ij,tabj->tabi", rotation.as_matrix(), frames) + origin
    count = len(frames)
    later = np.concatenate([[True], stamp[1:] > np.maximum.accumulate(stamp)[:-1]])
    seen = np.isfinite(frames).all(axis=-1).mean(axis=(1, 2))
    gap = np.diff(stamp[later], prepend=np.nan) * 1e-9
    gap[0] = np.median(gap[1:]) if len(gap) > 1 else 0.1
    frames = frames[later]
    empty = np.empty((len(frames), source.n**2, 3))
    none = np.zeros(empty.shape[:2], dtype=bool)
    sheet = Sheet(source, stamp[later], gap, frames, none, empty[..., :2], empty, count, 0)
    sheet.dropped.update({"duplicate or backward stamp": int((~later).sum())} if not later.all() else {})
    whole = seen[later] >= ENOUGH_NODES
    sheet.keep(whole, "fewer than half of the nodes seen")
    if whole.any():
        _relabel(sheet, rotation.as_matrix()[:, 0])
    return sheet


def _relabel(sheet: Sheet, right: np.ndarray) -> None:
    """Unroll the surface, label it by its outline; drop frames that do not unroll to a square of the cloth's size."""
    ordered, sheet.reordered = put_in_order(sheet.surface, right)
    jumped = jumped_nodes(ordered)
    ordered[jumped] = np.nan
    flat, stress = lattice.unroll(lattice.filled(ordered), SIDE)
    n = sheet.source.n
    flat_enough = (stress <= FLAT_SLACK * SIDE / (n - 1)) & ~torn(ordered, SIDE)
    width, height = _extent(flat.reshape(len(flat), n, n, 2))
    right_size = (np.abs(width / SIDE - 1) <= SIZE_SLACK) & (np.abs(height / SIDE - 1) <= SIZE_SLACK)
    sheet.surface, sheet.jumped, sheet.flat = ordered, jumped.reshape(len(flat), -1), lattice.place(flat, SIDE)
    sheet.position, _ = sheet.labelled(np.zeros(len(flat)))
    sheet.keep(flat_enough, "torn or folded: does not unroll")
    sheet.keep(right_size[flat_enough], "wrong size: more than 15 % of width or height lost or gained")
    enough = np.isfinite(sheet.position).all(axis=-1).mean(axis=1) >= ENOUGH_NODES
    sheet.keep(enough, "fewer than half of the nodes seen")


def _extent(grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unrolled width and height (T,) m of lattices (T, n, n, 2): between opposite sides' medians."""
    width = np.linalg.norm(np.median(grid[:, :, -1], axis=1) - np.median(grid[:, :, 0], axis=1), axis=-1)
    height = np.linalg.norm(np.median(grid[:, -1], axis=1) - np.median(grid[:, 0], axis=1), axis=-1)
    return width, height
