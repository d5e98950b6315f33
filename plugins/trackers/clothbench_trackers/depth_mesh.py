"""`depth_mesh`: frames of a depth camera → a quadrilateral mesh of the sheet, by arclength along warp and weft.

The steps are those of Coltraro, Experimental Validation of an Inextensible Cloth Model, section 3: a depth plane,
outliers by distance, a colour filter, a quadrilateral mesh, equal time steps. Each is an option, and `steps` tells what
each leaves of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothbench import (
    ClothbenchError,
    DepthImages,
    Observation,
    check_choice,
    for_each,
    read_depth,
    seen_points,
    to_world,
)
from clothbench_trackers import depth_patch as patches
from clothbench_trackers import flattening as flats
from clothbench_trackers.depth_pictures import of_steps
from clothbench_trackers.options import (
    check_colour,
    check_mesh,
    check_metres,
    check_number,
    check_switch,
    check_whole,
)

METHODS = ("isometric", "harmonic")
STRIDE_FOR = 3500  # vertices that a frame's patch has at most
TALL = 0.75  # cloth heights, before and behind the grips, in which the sheet is looked for
HEM = 0.03  # share of the cloth's size: border vertices that come so near a hem are taken to lie on it
LOST = 3.0  # pixels that are lost along a hem at most
BEYOND = 2.5  # pixels that a node may lie outside the patch, and a vertex more
LEAST = 30  # vertices of a patch, below which a frame shows no sheet
ALIGN_ROUNDS = 3  # of telling what is a hem, and turning the map towards it
HUE_FRAMES = 5  # that are asked for the cloth's own hue
HUES = 12  # of the a and b of Lab, of 255, that a pixel may differ by
GAP = 1.5  # usual steps between two frames, beyond which frames were dropped and nothing is known in between
AT_FRAME = 0.02  # of the step between two frames, within which a wanted time is that of one of them
LARGER = 1.3  # times the cloth's sides, as which what is taken for it is something else
LEVEL = 0.3  # of v along gravity, below which a sheet lies too level for gravity to say which way v goes


@dataclass(frozen=True, eq=False)
class Step:
    """A frame after each step: depth (H, W) m; masks (H, W) bool by name; nodes (N, 3) m, world; extent (2,) m of what
    was found, laid flat, along the cloth's sides, NaN where grips say where it is.
    """

    depth: np.ndarray
    masks: dict[str, np.ndarray]
    nodes: np.ndarray
    extent: np.ndarray


class DepthMesh:
    """mesh: nodes along (u, v); near, far: m, the depth planes, None: around the grips; jump: m between neighbouring
    pixels of one surface; support: of eight neighbours that a pixel must have within it (0: outliers stay);
    colour: [red, green, blue] of the cloth, None: as most of it is seen, if it has one hue, False: no filter; hue: how
    far from it a pixel may be; smooth: px, of depth, σ of a Gaussian; method: "isometric" or "harmonic"; even: equal
    time steps; sigma: m, of a node's coordinate, None: as the recording states it, else judged from how nodes
    tremble.
    """

    name = "depth_mesh"
    version = 3
    kinds = frozenset({"depth"})

    def __init__(
        self, mesh: Sequence[int] = (9, 9), near: float | None = None, far: float | None = None, jump: float = 0.02,
        support: int = 5, colour: Any = None, hue: float = HUES, smooth: float = 3.0, method: str = "isometric",
        even: bool = True, sigma: float | None = None,
    ):  # fmt: skip
        self.mesh = check_mesh(self.name, mesh, 3)
        for word, metres in (("near", near), ("far", far), ("sigma", sigma)):
            check_metres(self.name, word, metres)
        if near is not None and far is not None and near >= far:
            raise ClothbenchError(f"depth_mesh: near is {near!r} and far is {far!r}, expected near below far")
        check_number(self.name, "jump", jump)
        check_number(self.name, "hue", hue)
        check_number(self.name, "smooth", smooth, nothing=True)
        check_choice(self.name, "method", method, METHODS)
        check_whole(self.name, "support", support, 0, 8)
        check_colour(self.name, colour)
        check_switch(self.name, "even", even)
        self.near, self.far, self.jump = near, far, jump
        self.support, self.colour, self.hue, self.smooth = support, colour, hue, smooth
        self.method, self.even, self.sigma = method, even, sigma
        self.options = {"near": near, "far": far, "jump": jump, "support": support, "colour": colour, "hue": hue,
                        "smooth": smooth, "method": method}  # fmt: skip

    def track(self, source: DepthImages | Path) -> Observation:
        """The nodes of a recording of kind "depth", or of its file."""
        images = images_of(source, self.name)
        hue, material = self.hue_of(images), lattice(images, self.mesh)
        nodes, extent = np.empty((len(images.time), len(material), 3)), np.empty((len(images.time), 2))

        def one(frame: int) -> None:
            step = self._step(images, frame, hue)
            nodes[frame], extent[frame] = step.nodes, step.extent  # what else a step leaves is megabytes a frame

        for_each(one, range(len(nodes)))
        check_extent(images, extent)
        return observation(images, nodes, material, self.even, self.sigma, self.name)

    def steps(self, source: DepthImages | Path, frames: Sequence[int]) -> list[Step]:
        """What each step leaves of some frames."""
        images = images_of(source, self.name)
        hue = self.hue_of(images)
        out: list[Any] = [None] * len(frames)

        def one(k: int) -> None:
            out[k] = self._step(images, frames[k], hue)

        for_each(one, range(len(frames)))
        return out

    def pictures(self, source: DepthImages, frame: int, seen: Observation) -> dict[str, np.ndarray]:
        """What each step makes of a frame, to be looked at."""
        masks = self.masks(source, frame, source.metres(frame), self.hue_of(source))
        return of_steps(source, frame, masks, seen, self.mesh)

    def nodes(self, images: DepthImages, frame: int, hue: np.ndarray | None) -> np.ndarray:
        """Where the mesh's nodes are in one frame (N, 3) m, NaN where they are not seen; hue: as `hue_of` says."""
        return self._step(images, frame, hue).nodes

    def patch(self, images: DepthImages, frame: int, hue: np.ndarray | None) -> tuple[patches.Patch, float]:
        """The cleaned surface of one frame as triangles, and how far apart its pixels are [m]; hue: as `hue_of` says,
        which looks at several frames and is the same for all of them.
        """
        _, _, patch, _, pixel = self._patch(images, frame, hue)
        return patch, pixel

    def _patch(
        self, images: DepthImages, frame: int, hue: np.ndarray | None
    ) -> tuple[np.ndarray, dict[str, np.ndarray], patches.Patch, int, float]:
        depth = images.metres(frame)
        masks = self.masks(images, frame, depth, hue)
        mask = masks["colour"]
        smooth = patches.smoothed(depth, mask, self.smooth)
        point = to_world(seen_points(smooth, images.camera), images.camera)
        pixel = float(np.nanmedian(depth[mask])) / images.camera.matrix[0, 0] if mask.any() else 0.0
        stride = max(1, int(np.ceil(np.sqrt(mask.sum() / STRIDE_FOR))))
        return depth, masks, patches.patch_of(point, mask, stride, 3.5 * stride * pixel + self.jump), stride, pixel

    def _step(self, images: DepthImages, frame: int, hue: np.ndarray | None) -> Step:
        depth, masks, patch, stride, pixel = self._patch(images, frame, hue)
        material = lattice(images, self.mesh)
        if len(patch.point) < LEAST:
            return Step(depth, masks, np.full((len(material), 3), np.nan), np.full(2, np.nan))
        inside = pixel * patches.from_border(patch, masks["colour"])
        cut = np.any((patch.pixel < stride) | (patch.pixel >= np.array(depth.shape) - stride), axis=1)
        flat, uv, extent = self._flattened(images, frame, patch, inside, cut, pixel)
        nodes = flats.looked_up(flat, uv, patch.point, material, (BEYOND + stride) * pixel)
        place = images.camera.project(nodes)[0]
        outside = ((place < -0.5) | (place > np.array(images.camera.size) - 0.5)).any(axis=1)
        return Step(depth, masks, np.where(outside[:, None], np.nan, nodes), extent)

    def masks(
        self, images: DepthImages, frame: int, depth: np.ndarray, hue: np.ndarray | None
    ) -> dict[str, np.ndarray]:
        """What each step of the cleaning leaves, (H, W) bool by the step's name."""
        near, far = self._planes(images, frame)
        plane = patches.within(depth, near, far)
        outliers = patches.without_outliers(depth, plane, self.jump, self.support)
        picture = images.picture(frame)
        if hue is None or picture is None:
            return {"plane": plane, "outliers": outliers, "colour": outliers}
        seen = patches.of_colour(patches.hues(picture), outliers, hue, self.hue)
        return {"plane": plane, "outliers": outliers, "colour": patches.without_outliers(depth, seen, self.jump, 3)}

    def _planes(self, images: DepthImages, frame: int) -> tuple[float, float]:
        near, far = self.near, self.far
        if (near is None or far is None) and images.grips is not None:
            grips = held_at(images, images.time[frame : frame + 1])[0]
            away = images.camera.in_view(grips)[:, 2]
            reach = TALL * images.cloth_height
            near = float(away.min()) - reach if near is None else near
            far = float(away.max()) + reach if far is None else far
        return near if near is not None else 0.0, far if far is not None else np.inf

    def hue_of(self, images: DepthImages) -> np.ndarray | None:
        """The cloth's own hue (2,): as stated, or that of most pixels that the first two steps leave, and the middle of
        what some frames say: one alone may show something else there. None where most of them say that it has none.
        """
        if self.colour is False or (self.colour is None and images.colour is None):
            return None
        if images.colour is None:
            raise ClothbenchError(
                f"{images.path or images.name}: found no variable 'colour', expected one: {self.name} was given the "
                f"cloth's, colour={list(self.colour)}; leave that out, or record pictures registered to the depth"
            )
        if self.colour is not None:
            return patches.hues(np.array([[self.colour]], dtype=np.uint8))[0, 0]
        said, asked = [], np.unique(np.linspace(0, len(images.time) - 1, HUE_FRAMES).round().astype(int))
        for frame in asked:
            if (picture := images.picture(frame)) is not None:
                depth = images.metres(frame)
                plane = patches.within(depth, *self._planes(images, frame))
                outliers = patches.without_outliers(depth, plane, self.jump, self.support)
                said.append(patches.own_hue(patches.hues(picture), outliers))
        known = [hue for hue in said if hue is not None]
        return np.median(known, axis=0) if 2 * len(known) > len(said) else None

    def _flattened(
        self, images: DepthImages, frame: int, patch: patches.Patch, inside: np.ndarray, cut: np.ndarray, pixel: float
    ) -> tuple[flats.Flat, np.ndarray, np.ndarray]:
        """A patch laid flat, the material coordinates (M, 2) m of its vertices, and its extent as `Step` has it. cut:
        (M,) bool, along the picture's border, where the picture may end and the sheet go on: that is no hem.
        """
        size = np.array([images.cloth_width, images.cloth_height])
        guess, held, there = first_guess(images, frame, patch.point, self.jump + LOST * pixel)
        flat = flats.Flat.of(patch.point, flats.upright(patch.triangle, guess))
        uv = flats.isometric(flat, guess)
        if held is None or there is None:
            uv = boxed(uv, size)
            extent = np.ptp(uv, axis=0)
        else:
            uv, extent = flats.placed(uv, uv[held], there), np.full(2, np.nan)
        edge = flats.border(flat.triangle)
        edge = edge[~cut[edge]]
        for _ in range(ALIGN_ROUNDS):  # a turn of the whole is what the isometric steps find most slowly
            wanted = on_hems(uv, edge, inside, size, pixel)
            uv = flats.turned_to(uv, wanted)
        if self.method == "harmonic":
            return flat, flats.harmonic(flat, patch.point, uv, size), extent
        return flat, flats.isometric(flat, uv, wanted), extent


def images_of(source: Any, who: str) -> DepthImages:
    """Depth images, read if they are a file's name."""
    if isinstance(source, DepthImages):
        return source
    if isinstance(source, str | Path):
        return read_depth(source)
    raise ClothbenchError(f"{who}: found {type(source).__name__}, expected depth images (a recording of kind 'depth')")


def lattice(images: DepthImages, mesh: tuple[int, int]) -> np.ndarray:
    """Material points (N, 2) m of the mesh, row by row from the top."""
    u, v = (np.linspace(0.0, size, n) for size, n in zip((images.cloth_width, images.cloth_height), mesh, strict=True))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def held_at(images: DepthImages, time: np.ndarray) -> np.ndarray:
    """Where the grips are at `time` (T,) s → (T, G, 3) m."""
    grips = images.grips
    assert grips is not None
    return np.stack(
        [
            np.stack([np.interp(time, grips.time, grips.position[:, g, c]) for c in range(3)], axis=-1)
            for g in range(len(grips.material))
        ],
        axis=1,
    )


def first_guess(
    images: DepthImages, frame: int, point: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """The patch as a plane has it, v down and u along grips that differ in u, else to the right of somebody who stands
    upright where the camera is: (M, 2) m; and the vertices nearest to the grips with their material points, where there
    are grips within `reach` m of a vertex. Of a sheet that lies level, v goes away from the grips, else down in the
    picture, and u to the camera's right.
    """
    gravity = np.array(images.gravity)
    down = gravity / max(np.linalg.norm(gravity), 1e-12)
    centre = point.mean(axis=0)
    _, _, axes = np.linalg.svd(point - centre, full_matrices=False)
    normal, held, there = axes[2], None, None
    right, aside, forwards = images.camera.rotation
    level = float(np.linalg.norm(down - down @ normal * normal)) <= LEVEL
    if not level:  # the camera may be rolled; gravity is not
        right = np.cross(down, normal if normal @ forwards > 0 else -normal)
    if images.grips is not None and len(images.grips.material) >= 2:
        at, material = held_at(images, images.time[frame : frame + 1])[0], images.grips.material
        first, last = np.argmin(material[:, 0]), np.argmax(material[:, 0])
        if material[last, 0] > material[first, 0]:
            right = at[last] - at[first]
        farther = images.cloth_height / 2 - material[:, 1].mean()
        aside = np.sign(farther) * (centre - at.mean(axis=0)) if farther else aside
        from scipy.spatial import cKDTree

        away, nearest = cKDTree(point).query(at)
        seen = away < reach
        if seen.any():
            held, there = nearest[seen], material[seen]
    right = right - right @ normal * normal
    right /= max(float(np.linalg.norm(right)), 1e-12)
    below = np.cross(normal, right)
    down = aside if level or abs(below @ down) <= LEVEL else down
    below = below if below @ down > 0 else -below
    return np.stack([(point - centre) @ right, (point - centre) @ below], axis=1), held, there


def on_hems(uv: np.ndarray, edge: np.ndarray, inside: np.ndarray, size: np.ndarray, pixel: float) -> np.ndarray:
    """Coordinates (M, 2) m that vertices of the border are known to have, NaN elsewhere: where the border comes near a
    hem it is that hem, while what hides a part of it lies farther inside. The outermost pixels are lost at a hem, as
    many on either side: what is missing of the cloth's size says how many, also for a hem whose opposite is hidden.
    inside: (M,) m, of each vertex from where the sheet's pixels end.
    """
    wanted = np.full_like(uv, np.nan)
    near = HEM * size.max() + LOST * pixel
    hems = [
        (c, sign, edge[np.abs(uv[edge, c] - end) < near]) for c in (0, 1) for sign, end in ((1, 0.0), (-1, size[c]))
    ]
    hems = [hem for hem in hems if len(hem[2]) >= 5]
    place = {(c, sign): float(np.median(uv[hem, c] - sign * inside[hem])) for c, sign, hem in hems}
    both = {c: (size[c] - place[c, -1] + place[c, 1]) / 2 for c in (0, 1) if (c, 1) in place and (c, -1) in place}
    usual = float(np.mean(list(both.values()))) if both else pixel
    for c, sign, hem in hems:
        lost = float(np.clip(both.get(c, usual), 0.0, LOST * pixel)) + inside[hem]
        wanted[hem, c] = lost if sign > 0 else size[c] - lost
    return wanted


def boxed(uv: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The map turned so that its smallest box is upright, in the rectangle's middle: for what nobody holds."""
    import cv2

    (_, _), (_wide, _tall), angle = cv2.minAreaRect(uv.astype(np.float32))
    angle = np.deg2rad(angle)
    angle -= np.pi / 2 * np.round(angle / (np.pi / 2))  # the least turn: the guess was upright
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = uv @ turn
    low, high = turned.min(axis=0), turned.max(axis=0)
    return turned - (low + high) / 2 + size / 2


def check_extent(images: DepthImages, extent: np.ndarray) -> None:
    """What nobody holds is about as large as the cloth in most frames, of extents (T, 2) m, NaN where grips say where
    it is: else some of what was found is not the cloth, or metres are none. A few frames before or after the grips are
    known refuse no recording that has them in the others.
    """
    size = np.array([images.cloth_width, images.cloth_height])
    found = extent[np.isfinite(extent).all(axis=1)]
    large = (np.sort(found, axis=1) >= LARGER * np.sort(size)).any(axis=1)  # on its side it is as large
    if 2 * large.sum() > len(found if images.grips is None else extent):
        wide, tall = np.median(found[large], axis=0)
        raise ClothbenchError(
            f"{images.path or images.name}: found a sheet of {wide:.3g} × {tall:.3g} m in {large.sum()} of "
            f"{len(found)} frames without grips, expected {size[0]:g} × {size[1]:g} m; is depth_step right, and is "
            "nothing else taken for cloth (near, far, colour)?"
        )


def observation(
    images: DepthImages, nodes: np.ndarray, material: np.ndarray, even: bool, sigma: float | None, who: str
) -> Observation:
    """Nodes (T, N, 3) m at the frames' stamps as an observation, at equal time steps if they are wanted. sigma: m, or
    None: as the recording states it, else judged.
    """
    where, time = images.path or images.name, images.time
    if not np.isfinite(nodes).any():
        raise ClothbenchError(f"{where}: {who} found no sheet in any frame; look at its steps: near, far, colour")
    if sigma is None:
        sigma = trembling(time, nodes) if np.isnan(images.noise_sigma) else images.noise_sigma
    if even and np.ptp(np.diff(time)) > 1e-6 * np.diff(time).mean():
        steps = np.linspace(time[0], time[-1], len(time))
        nodes, time = at_times(time, nodes, steps), steps
    return Observation(time, nodes, np.isfinite(nodes).all(axis=-1), sigma, material)


def at_times(time: np.ndarray, nodes: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Nodes (T, N, 3) at other times (K,) s, on straight lines between frames; NaN where frames were dropped or a
    node was not seen beside. A frame that is as near as a fiftieth of a step needs no other.
    """
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    step = np.diff(time)
    dropped = (step > GAP * np.median(step))[after - 1]
    share = ((wanted - time[after - 1]) / (time[after] - time[after - 1]))[:, None, None]
    between = np.where(dropped[:, None, None], np.nan, (1 - share) * nodes[after - 1] + share * nodes[after])
    for edge, k in ((0.0, after - 1), (1.0, after)):
        between = np.where(np.isnan(between) & (np.abs(share - edge) < AT_FRAME), nodes[k], between)
    return between


def trembling(time: np.ndarray, nodes: np.ndarray) -> float:
    """The noise of a coordinate [m] of nodes (T, N, 3) at `time` (T,) s, from third differences in time.

    Divided differences of the real stamps, in which a parabola leaves nothing, scaled so that their variance is 20 σ²
    as at even steps. The quieter half of the nodes speaks, since motion adds to it; that half is quieter by chance,
    too, and errors that go on from frame to frame leave no trace, so that this is a lower bound.
    """
    if len(nodes) < 5:
        return float("nan")
    four = np.arange(len(time) - 3)[:, None] + np.arange(4)
    apart = time[four][:, :, None] - time[four][:, None] + np.eye(4)
    weight = 1 / apart.prod(axis=2)
    weight *= np.sqrt(20.0) / np.linalg.norm(weight, axis=1, keepdims=True)
    third = np.abs((weight[:, :, None, None] * nodes[four]).sum(axis=1))
    third = third[:, np.isfinite(third).any(axis=(0, 2))]  # nodes that were seen in four frames on end
    if not third.size:
        return float("nan")
    spread = np.sort(np.nanmedian(third, axis=0).ravel() / 0.6745 / np.sqrt(20.0))
    return float(np.sqrt(np.mean(spread[: max(1, len(spread) // 2)] ** 2)))
