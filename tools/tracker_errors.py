"""How far the depth trackers are off, by noise, by how the camera looks and by what is hidden: `python
tools/tracker_errors.py` prints the tables of docs/shake.md. The truth is that of tools/make_shake.py.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import make_shake as shake
import numpy as np
from scipy.interpolate import LinearNDInterpolator

from clothbench import Camera, DepthImages
from clothbench.core.observation import GripPath
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.depth import Colour
from clothbench.vision.depth_camera import sensed

TIMES = np.arange(20) / 20.0 + 0.5  # s, of the fastest motion
MOTION = shake.MOTIONS[2]
TRACKERS = (("depth_mesh", {}), ("depth_mesh", {"method": "harmonic"}), ("cloud_template", {}))


def view_from(degrees: float) -> Camera:
    """The stand-in's camera, walked around the sheet by so many degrees."""
    target, angle = np.array([0.0, 0.0, shake.RAIL - 0.20]), np.deg2rad(degrees)
    place = target + np.array([1.1 * np.sin(angle), -1.1 * np.cos(angle), 0.1])
    return Camera.looking_at(place, target, (176, 168), 0.56)


def filmed(truth: shake.Truth, places: np.ndarray, noise: float, degrees: float, hidden: float) -> DepthImages:
    """Places (T, N, 3) m as a camera sees them; hidden: share of the sheet behind a board, from the second frame on."""
    view, random = view_from(degrees), np.random.default_rng(5)
    sensor, surface = replace(shake.SENSOR, noise=noise), shake.sheet_surface(truth.mesh)
    edge = shake.WIDTH * (0.5 - hidden) * 0.75 / 1.1  # a third of the way to the camera
    board = (*shake.box((edge, -0.35, 0.5), (0.35, -0.34, 1.02)), shake.PERSON)
    depth, colour = [], []
    for frame, nodes in enumerate(places):
        parts = [*shake.background(), (*surface(nodes), shake.BLUE), *([board] if hidden and frame else [])]
        far, seen = shake.drawn(view, parts)
        depth.append(sensed(far, view, sensor, random))
        colour.append(np.clip(seen, 0, 255).astype(np.uint8))
    corners = np.array([[0.0, 0.0], [shake.WIDTH, 0.0]])
    return DepthImages(
        name="errors", time=TIMES, depth=np.stack(depth), depth_step=1e-3, camera=view, cloth_width=shake.WIDTH,
        cloth_height=shake.HEIGHT, colour=Colour(TIMES, np.stack(colour)),
        grips=GripPath(TIMES, corners, shake.grips(MOTION, TIMES)),
    )  # fmt: skip


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    truth = shake.Truth("damped")
    places = truth.run(MOTION, TIMES)
    whole = LinearNDInterpolator(truth.mesh.material, places.swapaxes(0, 1))
    cases = [("noise at 1 m [mm]", f"{1e3 * n:g}", (n, 0.0, 0.0)) for n in (0.0, 1.2e-3, 2.5e-3, 5e-3)]
    cases += [("camera aside [°]", f"{d:g}", (shake.SENSOR.noise, d, 0.0)) for d in (0.0, 20.0, 40.0, 60.0)]
    cases += [("hidden [%]", f"{100 * h:g}", (shake.SENSOR.noise, 0.0, h)) for h in (0.0, 0.1, 0.2, 0.4)]
    for what, value, (noise, degrees, hidden) in cases:
        images = filmed(truth, places, noise, degrees, hidden)
        for name, options in TRACKERS:
            began = time.perf_counter()
            seen = catalogue().make("trackers", name, **options).track(images)
            rate = len(TIMES) / (time.perf_counter() - began)
            away = 1e3 * np.linalg.norm(seen.position - whole(seen.material).swapaxes(0, 1), axis=-1)
            middle, most, seen_share = np.nanmedian(away), np.nanpercentile(away, 95), np.isfinite(away).mean()
            told = f"{middle:6.1f} mm, 95 % {most:5.1f} mm, seen {seen_share:4.0%}"
            label = " ".join([name, *options.values()])
            print(f"{what:<18}{value:>5}  {label:<22}{told}, {rate:4.1f} frames/s", flush=True)


if __name__ == "__main__":
    main()
