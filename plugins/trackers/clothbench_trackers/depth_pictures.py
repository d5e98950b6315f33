"""What each step of a depth tracker makes of a frame, as pictures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clothbench import DepthImages, Observation

DIMMED = 0.25  # brightness of what a step leaves out
MESH = (255, 214, 10)
LARGE = 3  # times as large as the camera's pixels, so that the mesh can be told from them


def of_steps(
    images: DepthImages, frame: int, masks: Mapping[str, np.ndarray], seen: Observation, mesh: tuple[int, int]
) -> dict[str, np.ndarray]:
    """Pictures (H, W, 3) uint8 by the step's name: what the camera saw, what each mask leaves of it, and the mesh."""
    depth = coloured(images.metres(frame), next(iter(masks.values())))
    picture = images.picture(frame)
    camera = depth if picture is None else picture
    out = {"depth": depth} if picture is None else {"colour": picture, "depth": depth}
    for name, mask in masks.items():
        out[f"after {name}"] = np.where(mask[..., None], camera, (DIMMED * camera).astype(np.uint8))
    out = {name: np.repeat(np.repeat(picture, LARGE, axis=0), LARGE, axis=1) for name, picture in out.items()}
    now = int(np.argmin(np.abs(seen.time - images.time[frame])))
    pixel = images.camera.project(np.nan_to_num(seen.position[now]))[0] * LARGE + (LARGE - 1) / 2
    return {**out, "mesh": with_mesh(next(iter(out.values())), mesh, pixel, seen.visible[now], MESH)}


def with_mesh(
    picture: np.ndarray, mesh: tuple[int, int], pixel: np.ndarray, seen: np.ndarray, colour: tuple[int, int, int]
) -> np.ndarray:
    """A picture (H, W, 3) with lines between neighbours of a mesh (along u, along v) of nodes (N, 2) px, both seen."""
    import cv2

    out, node = np.ascontiguousarray(picture).copy(), np.arange(len(pixel)).reshape(mesh[::-1])
    for first, last in ((node[:, :-1], node[:, 1:]), (node[:-1], node[1:])):
        both = seen[first] & seen[last]
        lines = np.stack([pixel[first[both]], pixel[last[both]]], axis=1)
        cv2.polylines(out, list(np.round(lines).astype(np.int32)), False, colour, 1, cv2.LINE_AA)
    return out


def coloured(depth: np.ndarray, sheet: np.ndarray) -> np.ndarray:
    """Depth (H, W) m as colours, over the range that the sheet's mask has; black where nothing is known."""
    import cv2

    known = np.isfinite(depth) & (depth > 0)
    within = depth[sheet & known] if (sheet & known).any() else depth[known]
    low, high = (float(np.quantile(within, q)) for q in (0.01, 0.99)) if within.size else (0.0, 1.0)
    share = np.clip((np.nan_to_num(depth) - low) / max(high - low, 1e-6), 0.0, 1.0)
    picture = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.where(known[..., None], cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), 0).astype(np.uint8)
