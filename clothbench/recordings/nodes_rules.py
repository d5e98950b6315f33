"""The rules of the arrays of kind "nodes": what a reader checks before anything is simulated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from clothbench.core.errors import ClothbenchError, misspelled
from clothbench.core.scene import HEAVIEST
from clothbench.core.scene_rules import off_sheet
from clothbench.recordings.layout import Arrays, Layout, Part

FEW, MILLI = 9, 100  # stamps, and times the frames' step and span, from which on grips are stamped in milliseconds
JUMP = 8.0  # times the usual time between stamps beyond which they have jumped
DROPPED = 1.9  # times the usual time between frames beyond which some in between are missing: one alone makes it 2
NEIGHBOURS, LEAST = 6, 1  # steps before and after one, of which the next after the least is what is usual there
COVERED = 0.9  # of the frames, while which somebody has to know where the grips are
SIZES = {"uv": 2, "space": 3}
LONGEST = 0.5  # s, for which a grip that a camera lost may be taken to go straight on: a hand swings at 1 Hz
SIDES = 0.005, 20.0  # m: between a swatch and a sail
SLOWEST, STAMPS = 2.0, 5  # s between frames, of so many and more: what moves so slowly is at rest
STRONGEST = 50.0  # m/s², of gravity: five times the earth's
UPWARDS = 0.9  # of gravity, as which its part along z is no lean
APART, SHRUNK = 50.0, 0.01  # of its own size, as which a cloth may at most and must at least be seen in space
STILL = 1e-3  # m, as which a grip may be away from where it was and have been held still: what its place is known to
STRAYED = 10.0  # of its size, as which a node may be from the middle of the others; in recordings it is up to 0.5
TREMBLING = 0.25  # of the cloth's longer side, up to which positions may be wrong
STRETCHED = 1.5  # times as far from a grip as on the cloth as a node may be in space
ASIDE = 0.15  # of its size, as which it may be farther still: cameras and grips may be known in frames that differ
FARTHEST = 1e6  # m from the origin that cloth and grips may be; sums and squares of what is farther may overflow


def check_shapes(arrays: Arrays, layout: Layout | Part, where: str, may_be_empty: str = "") -> None:
    """Every array has its dimensions, none empty but one that may be, each as long in one array as in another."""
    sizes: dict[str, tuple[str, int]] = {}
    for name, of in layout.variables.items():
        dims, shape = of.dims, arrays[name].shape
        if len(shape) != len(dims):
            raise ClothbenchError(f"{where}: variable '{name}': found shape {shape}, expected ({', '.join(dims)})")
        for dim, size in zip(dims, shape, strict=True):
            if dim in SIZES and size != SIZES[dim]:
                raise ClothbenchError(f"{where}: variable '{name}': found {size} along '{dim}', expected {SIZES[dim]}")
            if size == 0 and dim != may_be_empty:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found no entries along '{dim}', expected at least one"
                )
            first, known = sizes.setdefault(dim, (name, size))
            if known != size:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found {size} along '{dim}', expected {known} as in '{first}'"
                )


def check_clock(time: np.ndarray, name: str, where: str) -> None:
    """Stamps (T,) s are two or more, finite and strictly increasing."""
    if time.size < 2:
        raise ClothbenchError(f"{where}: variable '{name}': found {time.size} stamp, expected at least 2")
    if not np.isfinite(time).all():
        raise ClothbenchError(f"{where}: variable '{name}': found a stamp that is not finite, expected seconds")
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        i = int(back[0])
        raise ClothbenchError(
            f"{where}: variable '{name}': found {time[i + 1]:g} s after {time[i]:g} s at index {i + 1}, "
            "expected strictly increasing; sort or drop these frames"
        )


def check_values(arrays: Arrays, where: str) -> None:
    """Only the tracked positions may be NaN (not seen), and at least one of them is whole."""
    position = arrays["position"]
    infinite = np.argwhere(np.isinf(position))
    if infinite.size:
        t, n, _ = infinite[0]
        raise ClothbenchError(
            f"{where}: variable 'position': found {len(infinite)} infinite values, the first at frame {t}, node {n}, "
            "expected metres or NaN (not seen)"
        )
    for name in ("grip_position", "material", "grip_material"):
        check_finite(arrays[name], name, where)
    for name in ("grip_position", "position"):
        check_near(arrays[name], name, where)
    if not np.isfinite(position).any():
        raise ClothbenchError(f"{where}: variable 'position': found only NaN, expected at least one node seen")
    if not np.isfinite(position).all(axis=-1).any():
        raise ClothbenchError(f"{where}: variable 'position': found no node with all of x, y and z")


def check_length(name: str, length: float, where: str) -> None:
    if not 0 < length <= FARTHEST:
        raise ClothbenchError(f"{where}: attribute '{name}': found {length}, expected metres above 0")


def check_sides(width: float, height: float, where: str) -> None:
    """The sides of the cloth are as long as sides of cloths are."""
    for name, length in (("cloth_width", width), ("cloth_height", height)):
        check_length(name, length, where)
        if not SIDES[0] <= length <= SIDES[1]:
            raise ClothbenchError(
                f"{where}: attribute '{name}': found {length:g} m, expected {SIDES[0]:g} to {SIDES[1]:g} m; is it in "
                "another unit?"
            )


def check_pace(time: np.ndarray, where: str) -> None:
    """Frames follow each other as those of something that moves."""
    step = float(np.median(np.diff(time)))
    if len(time) >= STAMPS and step > SLOWEST:
        raise ClothbenchError(
            f"{where}: variable 'time': found frames {step:g} s apart, expected {SLOWEST:g} s at most; are these "
            "milliseconds?"
        )


def check_scale(arrays: Arrays, size: np.ndarray, where: str, read: bool) -> None:
    """Nodes and grips are about as far apart in space as on the cloth of `size` (2,) m, in the middle of all frames,
    and no single node is where none of the cloth can be. read: from a file, in which nodes cannot all
    be in one place; a recording that is made in a program may be filled in later.
    """
    grips, across = arrays["grip_position"], float(np.hypot(*size))
    seen = [
        (places[there], arrays["material"][there])
        for places in arrays["position"]
        if (there := np.isfinite(places).all(axis=1)).any()
    ]
    spread, flat = np.array([[np.linalg.norm(np.ptp(each, axis=0)) for each in both] for both in seen]).T
    check_spread(spread, across, where)
    if flat.max() > 0 and spread.max() <= SHRUNK * flat.max() and (read or spread.max() > 0):
        raise ClothbenchError(
            f"{where}: variable 'position': found nodes {spread.max():g} m apart in space at most and {flat.max():.2g} "
            "m on the cloth, expected metres; is it scaled twice?"
        )
    check_strays(arrays["position"], across, where)
    check_grips_near(grips, [places for places, _ in seen], across, where)


def check_spread(spread: np.ndarray, across: float, where: str, what: str = "nodes", name: str = "position") -> None:
    """What was seen of a cloth `across` m from corner to corner is not far larger, by how far it goes in each frame,
    (T,) m, in the middle of all frames. what: that was seen; name: of its variable.
    """
    if (middle := float(np.median(spread))) > APART * across:
        raise ClothbenchError(
            f"{where}: variable '{name}': found {what} {middle:g} m apart in the middle of all frames, "
            f"{at_most(across)}"
        )


def check_grips_near(
    grips: np.ndarray, seen: Sequence[np.ndarray], across: float, where: str, what: str = "nodes"
) -> None:
    """Grips (K, G, 3) m are near each other and what was seen, (N, 3) m of each frame, of a cloth `across` m from
    corner to corner, in the middle of all frames. what: that was seen.
    """
    if not grips.shape[1]:
        return
    centre = np.median([places.mean(axis=0) for places in seen], axis=0)
    away = float(np.linalg.norm(np.median(grips, axis=(0, 1)) - centre))
    apart = float(np.median(spreads(grips)))
    if max(away, apart) > APART * across:
        raise ClothbenchError(
            f"{where}: variable 'grip_position': found grips {apart:g} m apart, and {away:g} m from the {what}, in the "
            f"middle of all frames, {at_most(across)}"
        )


def check_grip_order(arrays: Arrays, across: float, where: str) -> None:
    """Each grip comes at some time as near to the node beside it as cloth, `across` m from corner to corner, allows.

    Grips in another order than their places on the cloth, or nodes counted from another corner, hold a sheet that is
    turned over or twisted, which no model could follow. Positions that are all one are yet to be filled in.
    """
    time, position, material = arrays["time"], arrays["position"], arrays["material"]
    held = while_held(time, arrays["grip_time"], arrays["grip_position"])
    grips = between_stamps(time[held], arrays["grip_time"], arrays["grip_position"])
    there = np.isfinite(position[held]).all(axis=2)
    seen = np.flatnonzero(there.any(axis=0))
    if not seen.size or not np.ptp(position[held][there], axis=0).any():
        return
    for grip, place in enumerate(arrays["grip_material"]):
        apart = np.linalg.norm(material[seen] - place, axis=1)
        node, beside = seen[np.argmin(apart)], float(apart.min())
        away = float(np.nanmin(np.linalg.norm(position[held][:, node] - grips[:, grip], axis=1)))
        if away > STRETCHED * beside + ASIDE * across:
            raise ClothbenchError(
                f"{where}: variable 'grip_position': found grip {grip} at no time nearer to node {node} than "
                f"{away:.2g} m, expected {STRETCHED * beside + ASIDE * across:.2g} m at most, as it is {beside:.2g} m "
                "from it on the cloth; are grips, or nodes, in another order than their places on the cloth, or are "
                "both known in frames that differ?"
            )


def between_stamps(time: np.ndarray, grip_time: np.ndarray, grip_position: np.ndarray) -> np.ndarray:
    """Grip positions (T, G, 3) m at times (T,) s, on straight lines between the stamps (K,) s at which they are known,
    (K, G, 3) m.
    """
    columns = grip_position.reshape(len(grip_time), -1).T
    return np.array([np.interp(time, grip_time, column) for column in columns]).T.reshape(len(time), -1, 3)


def spreads(places: np.ndarray) -> np.ndarray:
    """How far places (T, N, 3) m go in each frame, from corner to corner of a box around them, (T,) m."""
    return np.linalg.norm(np.ptp(places, axis=1), axis=-1)


def at_most(across: float) -> str:
    """What is expected of distances, of a cloth `across` m from corner to corner."""
    return f"expected {APART * across:.2g} m at most of a cloth {across:.2g} m across; are these millimetres?"


def check_strays(position: np.ndarray, across: float, where: str, what: str = "node") -> None:
    """No node, or what else they are called, is far out of a frame's others (T, N, 3) m, seen of a cloth `across` m
    from corner to corner: a number like -999 that stands for "not seen" is one.
    """
    for t, places in enumerate(position):
        there = np.flatnonzero(np.isfinite(places).all(axis=1))
        if not there.size:
            continue
        away = np.linalg.norm(places[there] - np.median(places[there], axis=0), axis=1)
        if away.max() > STRAYED * across:
            node = int(there[np.argmax(away)])
            at = ", ".join(f"{x:g}" for x in places[node])
            raise ClothbenchError(
                f"{where}: variable 'position': found {what} {node} at frame {t} at ({at}) m, {away.max():.3g} m from "
                f"the middle of those seen with it, expected {STRAYED * across:.2g} m at most of a cloth "
                f"{across:.2g} m across, and NaN where it was not seen"
            )


def check_notes(notes: Iterable[str], own: Layout, tracked: Layout, where: str) -> None:
    """No note of a kind of images has a name, or nearly one, under which the recording of nodes that a tracker makes of
    them would state something: with the file it would turn into that.
    """
    taken = (tracked.known | tracked.arrays) - own.known - own.arrays
    parts = {name for part in tracked.parts.values() for name in part.attributes}
    found = [*sorted(taken.intersection(notes)), *(misspelled(notes, parts) or ())[:1]]
    if found:
        raise ClothbenchError(
            f"{where}: {found[0]!r}: found a note that nodes tracked in recordings of kind {own.kind!r} would have for "
            "something else, expected another name; outlines and obstacles are settings of a run (scene.outline, "
            "scene.obstacles)"
        )


def check_noise(sigma: float, size: np.ndarray, where: str) -> None:
    """Positions are wrong by metres, and not by as much as the cloth is long; NaN where nobody knows."""
    if sigma < 0 or math.isinf(sigma):
        raise ClothbenchError(f"{where}: attribute 'noise_sigma': found {sigma}, expected metres, 0 or above")
    if sigma > TREMBLING * size.max():
        raise ClothbenchError(
            f"{where}: attribute 'noise_sigma': found {sigma:g} m on a cloth of {size[0]:g} m by {size[1]:g} m, "
            f"expected {TREMBLING * size.max():.2g} m at most; are these millimetres?"
        )


def check_density(areal_density: float, where: str) -> None:
    if areal_density <= 0 or areal_density > HEAVIEST:
        raise ClothbenchError(
            f"{where}: attribute 'areal_density': found {areal_density}, expected kg/m² above 0, {HEAVIEST:g} at "
            "most, or NaN"
        )


def check_gravity(gravity: Sequence[float], where: str) -> None:
    """Gravity is three finite numbers [m/s²], and does not pull up: it may lean as the table does, or go along another
    axis, but the format has z up.
    """
    if len(gravity) != 3 or not all(map(math.isfinite, gravity)):
        raise ClothbenchError(f"{where}: attribute 'gravity': found {gravity}, expected three finite numbers [m/s²]")
    if math.hypot(*gravity) > STRONGEST:
        raise ClothbenchError(
            f"{where}: attribute 'gravity': found {gravity}, expected m/s², {STRONGEST:g} at most; 9.81 on earth"
        )
    if gravity[2] > UPWARDS * math.hypot(*gravity):
        found = " ".join(f"{each:g}" for each in gravity)
        raise ClothbenchError(
            f"{where}: attribute 'gravity': found {found} m/s², which pulls up, expected z up, as in 0 0 -9.81; is the "
            "sign wrong?"
        )


def check_finite(values: np.ndarray, name: str, where: str) -> None:
    """Every value is a number."""
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        at = tuple(map(int, bad[0]))
        raise ClothbenchError(f"{where}: variable '{name}': found a value that is not finite at {at}, expected metres")


def check_near(places: np.ndarray, name: str, where: str) -> None:
    """No place, of those that are known, is farther away than anything that is measured."""
    far = np.argwhere(np.abs(places) > FARTHEST)
    if far.size:
        at = tuple(map(int, far[0]))
        raise ClothbenchError(
            f"{where}: variable '{name}': found {places[at]:g} m at {at}, expected metres within {FARTHEST:g} of 0"
        )


def check_points(points: np.ndarray, name: str, size: np.ndarray, where: str) -> None:
    """Material points (N, 2) m lie on a cloth of `size` (2,) m, each of them once."""
    outside = off_sheet(points, size)  # markers, too, may stand a little over the hem
    if outside.size:
        u, v = points[outside[0]]
        raise ClothbenchError(
            f"{where}: variable '{name}': found ({u:g}, {v:g}) m at row {outside[0]}, "
            f"expected inside the {size[0]:g} m × {size[1]:g} m cloth"
        )
    _, first, counts = np.unique(points.round(9), axis=0, return_index=True, return_counts=True)
    if (counts > 1).any():
        row = int(first[counts > 1].min())
        raise ClothbenchError(
            f"{where}: variable '{name}': found row {row} {int(counts[counts > 1].max())} times "
            f"(the same material point), expected every point once; drop the repeats"
        )


def longest_gap(time: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """The longest time [s] without a sample, of those numbered `seen` (K,) among stamps (T,) s, and when it begins [s];
    0 where no sample is missing between the first and the last, nor a frame that was dropped before it got a number.
    """
    apart = np.diff(time[seen])
    gaps = np.where((np.diff(seen) > 1) | (apart > DROPPED * usual_steps(time)[seen[:-1]]), apart, 0.0)
    worst = int(np.argmax(gaps)) if gaps.size else 0
    return (float(gaps[worst]), float(time[seen[worst]])) if gaps.size else (0.0, float("nan"))


def usual_steps(time: np.ndarray) -> np.ndarray:
    """How far apart frames at stamps (T,) s usually are where each of them is followed by the next, (T-1,) s: before or
    after it, whichever is longer, as a clock may change its pace. Up to two of three steps there may lack a frame.
    """
    steps = np.diff(time)
    if not steps.size:
        return steps
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(steps, NEIGHBOURS, mode="symmetric"), NEIGHBOURS)
    low = np.partition(windows, LEAST, axis=1)[:, LEAST]
    return np.maximum(low[: len(steps)], low[-len(steps) :])


def check_grip_gap(time: np.ndarray, seen: np.ndarray, what: str, where: str) -> None:
    """Refuse a grip that no frame between showed for too long: nobody knows how it moved. what: which grip it is."""
    gap, begin = longest_gap(time, seen)
    if gap > LONGEST:
        raise ClothbenchError(
            f"{where}: found {what} in no frame for {gap:.3g} s after {begin:.10g} s, expected gaps of {LONGEST:g} s "
            "at most; cut the recording there, or state the grips"
        )


def stamp_rounding(time: np.ndarray) -> float:
    """By how much stamps (T,) s that are equal may differ [s]: sums of decimal stamps are not exact, and those that are
    counted from 1970 on are known to a quarter of a microsecond.
    """
    return max(1e-9, 4 * float(np.spacing(np.abs(time).max(initial=0.0))))


def while_held(time: np.ndarray, grip_time: np.ndarray, grip_position: np.ndarray) -> np.ndarray:
    """Which frames (T,) s lie within the grips' stamps (K,) s, and in no hole of theirs, (T,) bool. grip_position:
    (K, G, 3) m.
    """
    rounding, holes = stamp_rounding(grip_time), holes_in(grip_time, grip_position)
    after = np.minimum(np.searchsorted(grip_time, time - rounding), len(grip_time) - 1)
    lost = holes[np.maximum(after - 1, 0)] & (time < grip_time[after] - rounding)
    return (time >= grip_time[0] - rounding) & (time <= grip_time[-1] + rounding) & ~lost


def holes_in(grip_time: np.ndarray, grip_position: np.ndarray) -> np.ndarray:
    """After which of the grips' stamps (K,) s nobody knows where they were until the next, (K-1,) bool: for far longer
    than usual, and than they may be taken to go straight on. A few stamps are no log but a path that somebody states;
    grips (K, G, 3) m that are where they had been were held still, as a log says that has stamps while they move.
    """
    steps, moved = np.diff(grip_time), np.linalg.norm(np.diff(grip_position, axis=0), axis=-1).max(axis=1, initial=0.0)
    return (steps > max(JUMP * float(np.median(steps)), LONGEST)) & (len(grip_time) > FEW) & (moved > STILL)


def frames_held(time: np.ndarray, grip_time: np.ndarray, grip_position: np.ndarray) -> np.ndarray:
    """Which frames (T,) s may count, (T,) bool: those in which it is known where the grips were, if there are grips."""
    return while_held(time, grip_time, grip_position) if grip_position.size else np.ones(len(time), bool)


def check_overlap(time: np.ndarray, grip_time: np.ndarray, grip_position: np.ndarray, where: str) -> None:
    """The grips were tracked while nine tenths of the frames were taken, and by the same clock."""
    frames, grips = (float(np.median(np.diff(stamps))) if len(stamps) > FEW else 0.0 for stamps in (time, grip_time))
    if frames > 0 and grips > MILLI * frames and np.ptp(grip_time) > MILLI * np.ptp(time):
        raise ClothbenchError(
            f"{where}: variable 'grip_time': found {grip_time[0]:.10g}..{grip_time[-1]:.10g} s beside frames from "
            f"{time[0]:.10g} to {time[-1]:.10g} s, expected both in seconds; are the grips' milliseconds?"
        )
    covered = np.mean(while_held(time, grip_time, grip_position))
    if covered < COVERED and (holes := np.flatnonzero(holes_in(grip_time, grip_position))).size:
        first = holes[0]
        raise ClothbenchError(
            f"{where}: variable 'grip_time': found none from {grip_time[first]:.10g} to {grip_time[first + 1]:.10g} s, "
            f"where {np.median(np.diff(grip_time)):.3g} s between stamps are usual, and {covered:.0%} of the frames "
            f"covered, expected {COVERED:.0%}; cut the recording there, or write stamps also while it is held still"
        )
    if covered < COVERED:
        raise ClothbenchError(
            f"{where}: variable 'grip_time': found {grip_time[0]:.10g}..{grip_time[-1]:.10g} s, "
            f"which covers {covered:.0%} of the "
            f"frames, expected to cover 'time' {time[0]:.10g}..{time[-1]:.10g} s; "
            "put both on one clock or cut the recording"
        )
