"""Fit the rig of a session: where the hanger sits on the tool, how the camera was turned, what time it was.

The cloth hangs from a straight rigid bar on the robot's tool. At rest and in motion its upper row stays on a
straight line within the noise (2-3 mm at 0.4 m/s), so the whole upper edge is held, not just two corners. The
outline slides on the sheet in motion (up to 20 mm below the hanger are not seen), so the time is read across the
sheet only, and how far down it begins is told from the hanger.
The bar's place on the tool is the same in all recordings of a session and lattice size; so is the camera's
pose, whose stated orientation is off by 1-3° (a hand-eye calibration by a hand-held board). Both are
estimated together.

The mesher stamps a frame when it is done, about a third of a second after the camera saw it, and it takes
the next image when it is done with the last: the longer it worked (the gap to the stamp before), the older
the image.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from clothbench.core.errors import ClothbenchError
from clothbench.datasets.iri_rig import SLOW, Rig, Take, lateness, resting

POSITION_SIGMA = 0.004  # m, how well the mean of an upper row is seen while it moves
GRAVITY_SIGMA = 0.001  # rad, how far from plumb the mean column of a resting cloth may hang: only weight pulls
SEARCH = np.arange(-0.5, 1.0, 0.02)  # s, offsets tried before anything is known
LEAST_JITTER = 0.005  # s, the shutter and a 30 Hz camera allow no less
UNDETERMINED = 0.02  # s; with a larger uncertainty a motion says nothing of its clock
CLOCK_HOLDS = 0.06  # s, within which all offsets of a session are taken for one


def fit_rig(takes: list[Take]) -> Rig:
    """The rig that several takes share: places, clock offsets and latency by turns, until they settle."""
    edges = np.concatenate([take.edge.reshape(-1, 3) for take in takes])
    pivot = np.nanmedian(edges, axis=0)
    if not np.isfinite(edges).any():
        raise ClothbenchError("the upper edge is never seen, so the hanger cannot be found")
    usual = float(np.median(np.concatenate([take.gap for take in takes])))
    centre, offsets = _first_guess(takes)
    # The hanger was mounted along the tool's y axis; how nearly is part of the fit.
    rig = Rig(np.zeros(3), pivot, centre, np.array([0.0, 1.0, 0.0]), usual)
    for _ in range(5):
        rig = _fit_places(rig, takes, offsets)
        offsets = [_refine(rig, take, offset)[0] for take, offset in zip(takes, offsets, strict=True)]
        rig = _fit_latency(rig, takes, offsets)
    return rig


def _first_guess(takes: list[Take]) -> tuple[np.ndarray, list[float]]:
    """Hanger centre (3,) and one offset for all, by trying offsets with the camera as stated."""
    cost, centres = [], []
    for offset in SEARCH:
        local = []
        for take in takes:
            position, rotation = take.tool.at(take.time - offset)
            local.append(rotation.inv().apply(take.edge[:, 1:-1].mean(axis=1) - position))
        points = np.concatenate(local)
        centre = np.nanmedian(points, axis=0)
        cost.append(np.nanmean(np.minimum(np.linalg.norm(points - centre, axis=1), 0.05)))
        centres.append(centre)
    best = int(np.argmin(cost))
    return centres[best], [float(SEARCH[best])] * len(takes)


def _fit_places(rig: Rig, takes: list[Take], offsets: list[float]) -> Rig:
    """Hanger and camera for given clock offsets: upper rows on the hanger, resting columns plumb; robust. How far down
    the sheet a row lies counts at rest only: in motion the outline slides.
    """
    parts = [_placed(take, take.time - rig.age(take, offset)) for take, offset in zip(takes, offsets, strict=True)]
    matrix, place, edge, hang, still, column = (np.concatenate(each) for each in zip(*parts, strict=True))
    seen = np.isfinite(edge).all(axis=-1)
    plumb = np.nanmedian(column[still], axis=0) if still.any() else np.array([0.0, 0.0, -1.0])
    slides = np.where(still[:, None], 0.0, np.nan_to_num(hang))
    u = takes[0].u

    def misses(p: np.ndarray) -> np.ndarray:
        trial = _with(rig, p)
        expected = place[:, None] + np.einsum("tij,nj->tni", matrix, trial.held(u))
        miss, down = trial.corrected(edge) - expected, trial.turned(slides)[:, None]
        miss = (miss - (miss * down).sum(axis=-1, keepdims=True) * down)[seen] / (2 * POSITION_SIGMA)
        lean = Rotation.from_rotvec(trial.turn).apply(plumb)[:2] / GRAVITY_SIGMA * np.sqrt(len(miss) / 100)
        return np.concatenate([miss.ravel(), lean])

    start = np.concatenate([rig.turn, rig.centre, rig.direction[[0, 2]] / rig.direction[1]])
    found = least_squares(misses, start, loss="soft_l1", x_scale=[0.02, 0.02, 0.02, 0.01, 0.01, 0.01, 0.02, 0.02])
    return _with(rig, found.x)


def _placed(take: Take, when: np.ndarray) -> tuple[np.ndarray, ...]:
    """Of one take at `when` (T,) s: the tool's rotation (T, 3, 3) and place (T, 3) m, the upper row, its direction down
    the sheet, whether the tool rests (T,), and the mean column.
    """
    position, rotation = take.tool.at(when)
    return rotation.as_matrix(), position, take.edge, take.hang, resting(take.tool, when), take.column


def _with(rig: Rig, p: np.ndarray) -> Rig:
    direction = np.array([p[6], 1.0, p[7]])
    unit = direction / np.linalg.norm(direction)
    return replace(rig, turn=p[:3], centre=p[3:6], direction=unit)


def _refine(rig: Rig, take: Take, offset: float) -> tuple[float, float]:
    """One take's clock offset and its standard uncertainty, both in s, from `offset` on, which is
    returned with an infinite uncertainty if the tool never moves.

    A weighted mean of every frame's lateness, its variance from position noise over speed and from stamp
    jitter, with Cauchy weights against slipped frames, and the scatter actually found in the uncertainty.
    """
    sigma = np.inf
    for _ in range(8):
        late, speed = lateness(rig, take, offset)
        use = np.isfinite(late) & (speed > SLOW)
        if use.sum() < 5:
            return offset, np.inf
        variance = (POSITION_SIGMA / speed[use]) ** 2 + rig.jitter**2
        pull = late[use] ** 2 / variance
        weight = 1.0 / variance / (1.0 + pull / 4)
        offset += float((weight * late[use]).sum() / weight.sum())
        sigma = float(np.sqrt((weight**2 * late[use] ** 2).sum()) / weight.sum())
    return offset, sigma


def _fit_latency(rig: Rig, takes: list[Take], offsets: list[float]) -> Rig:
    """How an image's age grows with the gap before its stamp, and how much its stamp still scatters."""
    rows = []
    for take, offset in zip(takes, offsets, strict=True):
        late, speed = lateness(rig, take, offset)
        use = np.isfinite(late) & (speed > 3 * SLOW)
        rows.append(np.stack([late, take.gap - rig.usual_gap, speed], axis=-1)[use])
    late, gap, speed = np.concatenate(rows).T
    slope = 0.0
    for _ in range(20):
        left = late - slope * gap
        weight = 1.0 / (1.0 + (left / 0.03) ** 2)
        slope = float((weight * gap * late).sum() / max((weight * gap * gap).sum(), 1e-9))
    if not len(late):
        return replace(rig, offset=float(np.median(offsets)))
    scatter = 1.48 * float(np.median(np.abs(late - slope * gap)))
    jitter = float(np.sqrt(max(scatter**2 - (POSITION_SIGMA / np.median(speed)) ** 2, LEAST_JITTER**2)))
    # An image cannot be older per second of work than that second, nor younger for it.
    per_gap = float(np.clip(rig.per_gap + slope, 0.0, 1.0))
    return replace(rig, offset=float(np.median(offsets)), per_gap=per_gap, jitter=jitter)


def clock_offset(rig: Rig, take: Take) -> tuple[float, float, bool]:
    """One take's clock offset and uncertainty in s, and whether its own motion determined it.

    Two clocks stay together over a session, while what one motion tells of them is also the way in which its cloth
    bends away from the hanger: the session's median serves, but for a take that differs from it plainly.
    """
    offset, sigma = _refine(rig, take, rig.offset)
    determined = sigma <= UNDETERMINED
    if determined and abs(offset - rig.offset) > CLOCK_HOLDS:
        return offset, sigma, True
    return rig.offset, sigma if determined else float(rig.jitter), determined


def capture_times(rig: Rig, take: Take, offset: float) -> np.ndarray:
    """When each image was taken (T,), on the tool's clock in s.

    The stamp less the offset, less the age that the gap explains, less each frame's own lateness as far as
    it is known: its estimate is shrunk by jitter² / (jitter² + (position sigma / speed)²), so at rest
    nothing is moved.
    """
    late, speed = lateness(rig, take, offset)
    trust = rig.jitter**2 / (rig.jitter**2 + (POSITION_SIGMA / np.maximum(speed, 1e-6)) ** 2)
    own = np.where(np.isfinite(late) & (speed > SLOW), trust * late, 0.0)
    own = np.where(np.abs(own) <= 3 * rig.jitter, own, 0.0)
    return take.time - rig.age(take, offset) - own
