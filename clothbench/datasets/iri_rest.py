"""The rest before the motion: where it is, whether the cloth has settled, and how noisy its nodes are."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.datasets.iri_rig import Rig, Take, resting
from clothbench.datasets.iri_sheets import Sheet

SETTLED = 0.006  # m, for the median node; a swing of a centimetre stands out, the noise of one node does not


def first_rest(take: Take, when: np.ndarray) -> np.ndarray:
    """Frames (T,) of the unbroken rest of the tool that comes first."""
    rest = resting(take.tool, when)
    breaks = np.cumsum(~rest)
    return rest & (breaks == breaks[int(np.argmax(rest))])


def noise_at_rest(rig: Rig, pairs: Sequence[tuple[Sheet, Take]]) -> float:
    """Standard deviation per coordinate in m of the nodes while the cloth first hangs still, pooled; NaN if
    never.

    Against each node's own median, so that a lasting bias is not counted; the hundredth of the sightings
    that lie furthest out are faults rather than noise and are left out.
    """
    squares = []
    for sheet, take in pairs:
        x = sheet.position[first_rest(take, take.time - rig.age(take, rig.offset))]
        often = np.isfinite(x).all(axis=-1).sum(axis=0) >= 5
        if often.any():
            off = x[:, often] - np.nanmedian(x[:, often], axis=0)
            squares.append(off[np.isfinite(off)] ** 2)
    if not squares:
        return float("nan")
    pooled = np.sort(np.concatenate(squares))
    return float(np.sqrt(pooled[: max(int(0.99 * len(pooled)), 1)].mean()))


def settled(position: np.ndarray, rest: np.ndarray) -> int:
    """The first frame of a rest (T,) bool at which the cloth hangs where it hangs in the rest's later half.

    Models start from the settled state, so a cloth that still swings under a resting tool has to be waited
    for.
    """
    held = np.flatnonzero(rest)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a node may be unseen throughout
        later = np.nanmedian(position[held[len(held) // 2 :]], axis=0)
        off = np.nanmedian(np.linalg.norm(position[held] - later, axis=-1), axis=1)
    calm = off <= SETTLED
    for i in range(len(held)):
        if calm[i : i + 3].all():
            return int(held[i])
    raise ClothbenchError("the cloth still swings when the tool first rests, so its state at the start is not known")
