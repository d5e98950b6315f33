"""Recordings that were never published: whether they are, and which of them models are fitted to and scored on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import Source, resplit
from clothbench.recordings.nodes import Recording

GRID = 1e-6  # m: what a file that is written anew may change; far below any tracker's noise
SHARE = 0.5  # of the points, from which on a recording is a copy; runs without noise may begin alike
MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)  # odd: no place is lost


@dataclass(frozen=True)
class Fabric:
    """The recordings of one fabric. sources: of all of them; shown: to fit, by hash; wanted: to score on."""

    sources: tuple[Source, ...]
    shown: dict[str, Recording]
    wanted: tuple[Recording, ...]


def require_unpublished(secret: Sequence[Recording], published: Sequence[Recording]) -> None:
    """Refuse recordings whose points were where those of a published one were, whatever they are called and whichever
    points and frames are left. Copies that were moved or smoothed are not found.
    """
    known = [(recording, _places(recording)) for recording in published]
    for recording in secret:
        mine = _places(recording)
        for other, theirs in known:
            if np.isin(mine, theirs).mean() >= SHARE:
                raise ClothbenchError(
                    f"{recording.path}: is published ({other.name!r}); expected recordings that are not"
                )


def _places(recording: Recording) -> np.ndarray:
    """A number for each place at which a point was seen, the same for the same place."""
    cells = np.round(recording.position[recording.visible] / GRID).astype(np.int64)
    return (cells.view(np.uint64) * MIXED).sum(axis=1, dtype=np.uint64)


def by_fabric(secret: Sequence[Recording]) -> dict[str, Fabric]:
    """What of each fabric is to fit, and what to score on; a ClothbenchError where there is not one of each."""
    fabrics: dict[str, list[Recording]] = {}
    for recording in secret:
        fabrics.setdefault(recording.fabric, []).append(recording)
    out = {}
    for fabric, mine in fabrics.items():
        sources = resplit([Source(r.path, r.name, r.hash, r.split) for r in mine], seed=0)
        shown = {s.hash: r for s, r in zip(sources, mine, strict=True) if s.split == "fit"}
        wanted = [r for r in mine if r.hash not in shown]
        if not shown or not wanted:
            raise ClothbenchError(
                f"--held-out: found {len(shown)} recordings to fit and {len(wanted)} to score on of fabric "
                f"{fabric!r}, expected one of each at least"
            )
        out[fabric] = Fabric(tuple(sources), shown, tuple(wanted))
    return out
