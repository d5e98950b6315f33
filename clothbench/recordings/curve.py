"""Recordings of kind "curve": the force with which a piece of cloth resists being stretched, on disk as NetCDF-4.

Same header as kind "nodes" (`clothbench.recordings.nodes`); what differs:

| name | dims | units | meaning |
|---|---|---|---|
| `stretch` | sample | 1 | distance of two tracked pins, or of the clamps, over the unloaded distance |
| `force` | sample | N | what the load cell showed |

Samples stand in the order of the measurement. Attributes: `format`, `format_version`, `kind`, `name`, `fabric`,
`direction` ("warp", "weft", "course", "wale" or "": the one along which it was pulled), `noise_sigma` [N, of one
sample; NaN = not known], `sample_width`, `sample_length` [m, unloaded, across and along the pull; NaN = not known, as
where a video has no scale: the ratio `stretch` needs none], `sensor`, `source`, `licence`, `declared_effects`, `motion`
("loading", or what else was done: whatever it says, of several cycles the last rise counts), `split`.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.errors import ClothbenchError
from clothbench.core.statistics import NORMAL, third_differences
from clothbench.recordings.codec import freeze, hash_of, read, write
from clothbench.recordings.layout import SPLITS, Layout, Variable
from clothbench.recordings.rig import check_numbers

LAYOUT = Layout(
    kind="curve",
    variables={
        "stretch": Variable(("sample",), "1", level=4),
        "force": Variable(("sample",), "N", level=4),
    },
    texts=("name", "fabric", "direction", "sensor", "source", "licence", "declared_effects", "motion", "split"),
    numbers=("noise_sigma", "sample_width", "sample_length"),
    needed=("name", "direction", "noise_sigma"),
)
DIRECTIONS = ("warp", "weft", "course", "wale", "")
FEWEST = 8  # samples; fewer make no curve
BEGINS = (0.8, 1.5)  # where the smallest stretch lies: a ratio to the unloaded distance, no strain and no millimetres
LONGEST = 20.0  # the stretch that no cloth survives
LEAST = 1e-3  # of stretch, by which a curve changes
LARGEST = 2.0  # m, of what a testing machine pulls
STRONGEST = 1e6  # N, and N for each metre of width: several times what a fabric of carbon bears
FALL, SCATTER = 0.05, 12.0  # of the range of stretch, and standard deviations of noise in it, that are no way back
MOST = 0.75  # of the range of stretch, that is one whatever the noise
EQUAL, ALIKE = 0.01, 3.0  # of the range, and standard deviations, by which tops of cycles differ that go equally far
STRAY = 3.0  # steps beside a single sample, beyond which it stands out


@dataclass(frozen=True, eq=False)
class Curve:
    """Force over stretch of one run. Arrays are read-only.

    stretch: (M,), distance over the unloaded distance; force: (M,) N; noise_sigma: N, of one sample (NaN = not known);
    sample_width, sample_length: m, unloaded (NaN = not known). `path` is where it was read from, not part of its
    identity.
    """

    name: str
    stretch: np.ndarray
    force: np.ndarray
    fabric: str = ""
    direction: str = ""
    noise_sigma: float = math.nan
    sample_width: float = math.nan
    sample_length: float = math.nan
    sensor: str = ""
    source: str = ""
    licence: str = ""
    declared_effects: str = ""
    motion: str = "loading"
    split: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    path: str = field(default="", compare=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        freeze(self, LAYOUT)
        _check(self, self.path or self.name)

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        return hash_of(self, LAYOUT)


def read_curve(path: str | os.PathLike[str]) -> Curve:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, Curve)


def write_curve(curve: Curve, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(curve, path, LAYOUT, asked=True)


def _check(c: Curve, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it."""
    _check_shapes(c, where)
    _check_values(c, where)
    _check_stretch(c.stretch, where)
    _check_stated(c, where)


def _check_shapes(c: Curve, where: str) -> None:
    for name in LAYOUT.variables:
        shape = getattr(c, name).shape
        if len(shape) != 1:
            raise ClothbenchError(f"{where}: variable '{name}': found shape {shape}, expected (sample)")
    if len(c.force) != len(c.stretch):
        raise ClothbenchError(
            f"{where}: variable 'force': found {len(c.force)} along 'sample', expected {len(c.stretch)} as in 'stretch'"
        )
    if len(c.stretch) < FEWEST:
        raise ClothbenchError(
            f"{where}: variable 'stretch': found {len(c.stretch)} samples, expected at least {FEWEST}"
        )


def _check_values(c: Curve, where: str) -> None:
    for name, of in LAYOUT.variables.items():
        bad = np.flatnonzero(~np.isfinite(getattr(c, name)))
        if bad.size:
            what = "newtons" if of.unit == "N" else "the ratio of distances"
            raise ClothbenchError(
                f"{where}: variable '{name}': found {len(bad)} values that are not finite, "
                f"the first at sample {bad[0]}, expected {what}; drop these samples"
            )
    if not np.ptp(c.force) > 0:
        raise ClothbenchError(f"{where}: variable 'force': found {c.force[0]:g} N in every sample, expected a curve")
    if (most := float(np.abs(c.force).max())) > STRONGEST:
        raise ClothbenchError(
            f"{where}: variable 'force': found {most:g} N, expected newtons, {STRONGEST:g} at most; are these in "
            "another unit?"
        )


def _check_stretch(stretch: np.ndarray, where: str) -> None:
    least, most = float(stretch.min()), float(stretch.max())
    if not BEGINS[0] <= least <= BEGINS[1] or most > LONGEST:
        raise ClothbenchError(
            f"{where}: variable 'stretch': found {least:g} to {most:g}, expected the ratio to the unloaded distance, "
            f"about 1 at the start and below {LONGEST:g}; divide distances by the unloaded one, add 1 to a strain"
        )
    if most - least < LEAST:
        raise ClothbenchError(
            f"{where}: variable 'stretch': found {least:g} to {most:g}, expected it to change by {LEAST:g} at least"
        )


def _check_stated(c: Curve, where: str) -> None:
    check_numbers(c, LAYOUT.numbers, where)
    if not c.name:
        raise ClothbenchError(f"{where}: attribute 'name': found nothing, expected the recording's name")
    if c.direction not in DIRECTIONS:
        known = ", ".join(repr(d) for d in DIRECTIONS)
        raise ClothbenchError(f"{where}: attribute 'direction': found {c.direction!r}, expected one of {known}")
    if c.noise_sigma < 0 or math.isinf(c.noise_sigma):
        raise ClothbenchError(
            f"{where}: attribute 'noise_sigma': found {c.noise_sigma}, expected newtons, 0 or above, or NaN"
        )
    if c.noise_sigma > (whole := float(np.ptp(c.force))):
        raise ClothbenchError(
            f"{where}: attribute 'noise_sigma': found {c.noise_sigma:g} N where forces differ by {whole:g} N in all, "
            "expected less, as the noise of a sample is; is it in another unit?"
        )
    for name in ("sample_width", "sample_length"):
        value = getattr(c, name)
        if value <= 0 or math.isinf(value):
            raise ClothbenchError(f"{where}: attribute '{name}': found {value}, expected metres above 0, or NaN")
        if value > LARGEST:
            raise ClothbenchError(
                f"{where}: attribute '{name}': found {value:g} m, expected {LARGEST:g} m at most, or NaN; are these "
                "millimetres?"
            )
    if (tension := float(np.abs(c.force).max()) / c.sample_width) > STRONGEST:
        raise ClothbenchError(
            f"{where}: variable 'force': found {tension:g} N for each metre of the sample's width, {c.sample_width:g} "
            f"m, expected {STRONGEST:g} at most; is either in another unit?"
        )
    if c.split not in SPLITS:
        raise ClothbenchError(f"{where}: attribute 'split': found {c.split!r}, expected 'fit', 'held_out' or ''")


def last_rise(stretch: np.ndarray) -> slice:
    """The samples of the last rise to the largest of stretches (M,): of several cycles the one that goes farthest, and
    of those that go equally far, but for noise or a hundredth of the range, the last.

    It begins where the last fall ends that is no noise: a twentieth of the range, and twelve standard deviations of
    what scatters from sample to sample, as third differences show it. Of few samples a ramp these show the turns, hence
    three quarters of the range are always a fall. Single samples that stand out are none.
    """
    whole, way = float(np.ptp(stretch)), _without_strays(stretch)
    scatter = NORMAL * float(np.median(np.abs(third_differences(np.arange(len(stretch)), stretch))))
    fall = max(FALL * whole, min(SCATTER * scatter, MOST * whole))
    alike = max(EQUAL * whole, min(ALIKE * scatter, FALL * whole))
    end = int(np.flatnonzero(stretch >= stretch.max() - alike)[-1]) + 1
    below = np.flatnonzero(np.maximum.accumulate(way[:end]) - way[:end] > fall)
    first = int(below[-1]) if below.size else 0
    top = first + int(np.argmax(stretch[first:end])) + 1
    later = np.minimum.accumulate(way[:top][::-1])[::-1]
    above = np.flatnonzero(way[:top] - later > fall)
    begin = int(above[-1] + np.argmin(way[above[-1] : top])) if above.size else 0
    return slice(begin, top)


def _without_strays(stretch: np.ndarray) -> np.ndarray:
    """Stretches (M,) with the median of three for what lies off it by more than three of the lesser of the steps on
    either side: a turn lies off it by a step.
    """
    from scipy.ndimage import median_filter

    median, step = median_filter(stretch, size=3, mode="nearest"), np.abs(np.diff(stretch))
    beside = np.full(len(stretch), np.inf)  # the first two and the last two stay what they are
    beside[2:-2] = np.minimum(step[:-3], step[3:])
    return np.where(np.abs(stretch - median) > STRAY * beside, median, stretch)
