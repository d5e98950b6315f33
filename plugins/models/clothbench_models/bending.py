"""Bending that is quadratic in the positions: E = ½ D xᵀK x, shared by the models that do not stretch much.

The energy density ½ D (|x_uu|² + |x_vv|² + 2 |x_uv|²) of a sheet whose second derivatives are vectors along its normal
wherever it does not stretch (isometric bending: Bergou et al. 2006, A quadratic bending model for inextensible
surfaces). The second derivatives come from the four-triangle patches of the sheet (`curvature`). Single
hinges with 3 l²/(A₁ + A₂) are three to nine times too stiff on these grids, depending on the direction; Bergou's
Laplacian on edges is the same formula, and one on nodes is blind to twist and saddle (`tests/physics/test_bending.py`
holds all of them against cylinder, twist and saddle).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothbench import Sheet


@dataclass(frozen=True, eq=False)
class Diagonals:
    """A symmetric matrix (n, n) by its diagonals on and above the main one.

    offsets: (S,), increasing from 0; values: (S, n), values[s, i] couples node i with node i + offsets[s].
    """

    offsets: np.ndarray
    values: np.ndarray


def bending_matrix(sheet: Sheet, shares: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Diagonals:
    """K of E = ½ D Σ xᵀK x over the three coordinates, in 1/m² (D in N·m).

    shares: of D that curvature along u, curvature along v and twist meet.
    """
    from scipy.sparse import coo_matrix

    weights = (np.array([1.0, 1.0, 2.0]) * shares)[:, None] * sheet.face_area
    blocks = np.einsum("fik,if,fil->fkl", sheet.curvature, weights, sheet.curvature)
    rows = np.repeat(sheet.patch[:, :, None], 6, axis=2)
    full = coo_matrix((blocks.ravel(), (rows.ravel(), rows.transpose(0, 2, 1).ravel()))).tocsr()
    full.sum_duplicates()
    entries = full.tocoo()
    keep = (entries.col >= entries.row) & (np.abs(entries.data) > 1e-12 * np.abs(entries.data).max())
    row, offset, value = entries.row[keep], (entries.col - entries.row)[keep], entries.data[keep]
    offsets = np.unique(offset)
    values = np.zeros((len(offsets), len(sheet.uv)))
    values[np.searchsorted(offsets, offset), row] = value
    return Diagonals(offsets.astype(np.int64), values)


@dataclass(frozen=True, eq=False)
class ThreadBending:
    """`bending_matrix` of a sheet that bends differently along warp and weft, by what each of the three takes part in.

    offsets: (S,); values: (3, S, n) of warp, weft and twist, whose sum is the matrix of a sheet that bends alike.
    """

    offsets: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, sheet: Sheet) -> ThreadBending:
        parts = [bending_matrix(sheet, shares) for shares in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
        offsets = np.unique(np.concatenate([part.offsets for part in parts]))
        values = np.zeros((3, len(offsets), len(sheet.uv)))
        for whole, part in zip(values, parts, strict=True):
            whole[np.searchsorted(offsets, part.offsets)] = part.values
        return cls(offsets, values)

    def matrix(self, ratio: float) -> Diagonals:
        """For D_warp/D_weft = ratio, in units of D = √(D_warp D_weft), which is also what resists twist (Huber's
        orthotropic plate: Timoshenko and Woinowsky-Krieger 1959, Theory of plates and shells, section 86).
        """
        root = np.sqrt(ratio)
        return Diagonals(self.offsets, root * self.values[0] + self.values[1] / root + self.values[2])
