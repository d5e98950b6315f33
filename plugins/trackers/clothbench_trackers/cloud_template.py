"""`cloud_template`: frames of a depth camera → a template of the sheet that is bent, frame by frame, onto the cloud.

Non-rigid registration: every point of the cloud pulls at the place of the template next to it, while the template keeps
its lengths; places and lengths are met by turns (Li et al. 2008, Global Correspondence Optimization for Non-Rigid
Registration of Depth Scans, with the local and global steps of Bouaziz et al. 2014, Projective Dynamics). A frame
begins where the last one ended, so that a node keeps its identity where `depth_mesh` has to see the outline anew;
what is hidden goes on as its neighbours do, and counts as not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothbench import ClothbenchError, DepthImages, Observation, takes_option
from clothbench_trackers.depth_mesh import BEYOND, DepthMesh, held_at, images_of, lattice, observation
from clothbench_trackers.options import check_metres, check_number, check_switch, check_whole

DATA, BEND, GRIP = 0.1, 0.05, 20.0  # weights per node, a length's being 1
SPLIT = 4  # places on each side of a template's cell that a point of the cloud may pull at
REACH = 0.05  # m, from a point of the cloud to the template, beyond which it pulls at nothing
WHOLE = 0.9  # share of the nodes that a frame has to show for the template to start there
NEAR = BEYOND + 2.0  # pixels, from a node to the cloud, that it counts as seen within
GOES_ON = 0.8  # share of the last frame's motion that the next begins with


@dataclass(frozen=True, eq=False)
class Template:
    """A lattice of nodes (N, 2) m; pairs (E, 2) that keep their length (E,) m; triples (K, 3) that resist bending; and
    the places between nodes (S, 4), with weights (S, 4), that the cloud may pull at.
    """

    material: np.ndarray
    pairs: np.ndarray
    length: np.ndarray
    triples: np.ndarray
    corner: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, material: np.ndarray, shape: tuple[int, int]) -> Template:
        """Of a lattice (N, 2) m with shape (nu, nv), row by row."""
        n = np.arange(len(material)).reshape(shape[::-1])
        pairs = [(n[:, :-1], n[:, 1:]), (n[:-1], n[1:]), (n[:-1, :-1], n[1:, 1:]), (n[:-1, 1:], n[1:, :-1])]
        both = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
        lines = [(n[:, :-2], n[:, 1:-1], n[:, 2:]), (n[:-2], n[1:-1], n[2:])]
        triples = np.concatenate([np.stack([a.ravel() for a in line], axis=1) for line in lines])
        corner = np.stack([a.ravel() for a in (n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:])], axis=1)
        s, t = (a.ravel() for a in np.meshgrid(*[np.linspace(0.0, 1.0, SPLIT + 1)] * 2))
        within = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
        return cls(
            material, both, np.linalg.norm(material[both[:, 1]] - material[both[:, 0]], axis=1), triples,
            np.repeat(corner, len(within), axis=0), np.tile(within, (len(corner), 1)),
        )  # fmt: skip

    def rows(self, number: np.ndarray, weight: np.ndarray) -> Any:
        """A sparse matrix (R, N) with `weight` (R, K) at the nodes `number` (R, K)."""
        from scipy.sparse import csr_matrix

        row = np.repeat(np.arange(len(number)), number.shape[1])
        return csr_matrix((weight.ravel(), (row, number.ravel())), shape=(len(number), len(self.material)))


class CloudTemplate:
    """mesh: nodes along (u, v); refine: cells of the template along a side of a mesh's cell; rounds: of pulling and
    keeping lengths, each frame; reach: m, from the cloud to the template; the others are those of `depth_mesh`, which
    cleans the frames and finds the sheet in the first.
    """

    name = "cloud_template"
    version = 3
    kinds = frozenset({"depth"})

    def __init__(
        self, mesh: Any = (9, 9), refine: int = 2, rounds: int = 20, reach: float = REACH, even: bool = True,
        sigma: float | None = None, **cleaning: Any,
    ):  # fmt: skip
        check_whole(self.name, "refine", refine, 1)
        check_whole(self.name, "rounds", rounds, 1)
        check_number(self.name, "reach", reach)
        check_switch(self.name, "even", even)
        check_metres(self.name, "sigma", sigma)
        for option in cleaning:
            if not takes_option(DepthMesh, option):
                raise ClothbenchError(f"cloud_template: {option!r} is no option of it, nor of depth_mesh; leave it out")
        self.cleaner = DepthMesh(mesh=mesh, **cleaning)
        self.mesh, self.refine, self.rounds, self.reach = self.cleaner.mesh, refine, rounds, reach
        self.even, self.sigma = even, sigma

    def track(self, source: DepthImages | Path) -> Observation:
        """The nodes of a recording of kind "depth", or of its file."""
        images = images_of(source, self.name)
        nodes = self.nodes(images)
        return observation(images, nodes, lattice(images, self.mesh), self.even, self.sigma, self.name)

    def pictures(self, source: DepthImages, frame: int, seen: Observation) -> dict[str, np.ndarray]:
        """What each step makes of a frame, to be looked at."""
        return self.cleaner.pictures(source, frame, seen)

    def nodes(self, images: DepthImages) -> np.ndarray:
        """Places (T, N, 3) m of the mesh's nodes, NaN where the cloud does not reach."""
        nu, nv = ((n - 1) * self.refine + 1 for n in self.mesh)
        template = Template.of(lattice(images, (nu, nv)), (nu, nv))
        of_mesh = np.arange(nu * nv).reshape(nv, nu)[:: self.refine, :: self.refine].ravel()
        hue = self.cleaner.hue_of(images)
        first, x = self._first(images, template, (nu, nv), hue)
        out = np.full((len(images.time), len(of_mesh), 3), np.nan)
        for frames in (range(first, len(images.time)), range(first - 1, -1, -1)):
            place, motion = x, np.zeros_like(x)
            for frame in frames:
                cloud, pixel = self._cloud(images, frame, hue)
                if not len(cloud):
                    continue
                before = place
                place = self._fit(images, template, place + GOES_ON * motion, cloud, frame)
                motion = place - before if frame != first else motion
                out[frame] = self._seen(place[of_mesh], cloud, pixel)
        return out

    def _first(
        self, images: DepthImages, template: Template, shape: tuple[int, int], hue: np.ndarray | None
    ) -> tuple[int, np.ndarray]:
        """The first frame that shows most of the sheet, and the template (N, 3) m in it as `depth_mesh` has it."""
        from scipy.interpolate import RBFInterpolator

        whole = DepthMesh(**{**self.cleaner.options, "mesh": shape})
        for frame in range(len(images.time)):
            nodes = whole.nodes(images, frame, hue)
            seen = np.isfinite(nodes).all(axis=1)
            if seen.mean() > WHOLE:
                at = template.material
                try:
                    filled = RBFInterpolator(at[seen], nodes[seen], neighbors=min(40, int(seen.sum())))(at)
                except np.linalg.LinAlgError:  # the nearest of a narrow lattice may all lie on one line
                    filled = RBFInterpolator(at[seen], nodes[seen])(at)
                return frame, np.where(seen[:, None], nodes, filled)
        raise ClothbenchError(
            f"{images.path or images.name}: {self.name} found no frame that shows {WHOLE:.0%} of the sheet, from which "
            "its template could start; look at the steps of depth_mesh: near, far, colour"
        )

    def _cloud(self, images: DepthImages, frame: int, hue: np.ndarray | None) -> tuple[np.ndarray, float]:
        """Points (M, 3) m of the sheet in a frame, and how far apart its pixels are [m]."""
        patch, pixel = self.cleaner.patch(images, frame, hue)
        return patch.point, pixel

    def _fit(
        self, images: DepthImages, template: Template, place: np.ndarray, cloud: np.ndarray, frame: int
    ) -> np.ndarray:
        """The template (N, 3) m bent onto a cloud (M, 3) m from where it is."""
        from scipy.sparse import diags
        from scipy.sparse.linalg import splu
        from scipy.spatial import cKDTree

        length = template.rows(template.pairs, np.tile([-1.0, 1.0], (len(template.pairs), 1)))
        bend = template.rows(template.triples, np.tile([1.0, -2.0, 1.0], (len(template.triples), 1)))
        keep = length.T @ length + BEND * (bend.T @ bend)
        held, there = self._held(images, template, frame)
        anchor = np.full(len(place), 1e-6)
        anchor[held] = GRIP
        goal = place.copy()
        goal[held] = there
        for _ in range(self.rounds):
            at = (template.weight[..., None] * place[template.corner]).sum(axis=1)
            away, which = cKDTree(at).query(cloud, distance_upper_bound=self.reach)
            near = np.isfinite(away)
            if not near.any():
                break
            pull = template.rows(template.corner[which[near]], template.weight[which[near]])
            share = DATA * len(place) / near.sum()
            solve = splu((keep + share * (pull.T @ pull) + diags(anchor)).tocsc()).solve
            along = length @ place
            along *= (template.length / np.maximum(np.linalg.norm(along, axis=1), 1e-12))[:, None]
            place = solve(length.T @ along + share * (pull.T @ cloud[near]) + anchor[:, None] * goal)
        return place

    def _held(self, images: DepthImages, template: Template, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (G,) of the template that are held, and where (G, 3) m."""
        if images.grips is None:
            return np.zeros(0, int), np.zeros((0, 3))
        grip = images.grips.material
        held = np.array([int(np.argmin(((template.material - g) ** 2).sum(axis=1))) for g in grip])
        return held, held_at(images, images.time[frame : frame + 1])[0]

    def _seen(self, nodes: np.ndarray, cloud: np.ndarray, pixel: float) -> np.ndarray:
        """Nodes (N, 3) m, NaN where the cloud does not come near."""
        from scipy.spatial import cKDTree

        away = cKDTree(cloud).query(nodes)[0]
        return np.where((away < NEAR * pixel)[:, None], nodes, np.nan)
