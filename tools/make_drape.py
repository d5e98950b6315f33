"""Makes the stand-in drapes of the suites `drape` and `drape_improve`: `python tools/make_drape.py [FABRIC…]`.

Discs of 30 cm on a plate of 18 cm, as in a Cusick drapemeter, from the reference simulation (`clothbench.reference`): a
ring of triangles beyond the plate's rim, clamped there, that comes to rest under its weight. Its bending is known, and
its discretisation is none of the models'. Twelve specimens of each fabric, whose rigidity differs by 8 %, are draped
face up and face down, each time laid on anew:

limp, medium, stiff   fabrics that bend alike in all directions
curled                as `medium`, but it curls by itself: face up it droops more than face down
ribbed                as `medium`, but the weft is 1.8 times as stiff in bending as the warp

What the last two hide nobody declares. `--check` says what a mesh with half the edges changes.
"""

from __future__ import annotations

import argparse
import time
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from clothbench import Silhouettes, write_silhouettes
from clothbench.core.drape import drape_coefficient
from clothbench.reference.mesh import ring
from clothbench.reference.simulation import Fabric, clamped, discretise, settle, stable_step
from clothbench.vision.drape import drape_quantities, outline_in

FOLDER = Path(__file__).resolve().parent.parent / "suites" / "embedded" / "drape"
PLATE, DISC, PIXEL, PIXELS = 0.09, 0.15, 1.4e-3, 256
EDGE = 6e-3  # m, of the triangles
SPECIMENS, FITTED = 12, 8
SCATTER, TURNED = 0.08, 2.0  # relative, of the rigidity from specimen to specimen; degrees, by which they lie askew
WAVES, ROUGH = range(2, 15), 2e-3  # around the rim, of a first shape; m rms there
BLUR, NOISE, FINER = 0.7, 1.5, 8  # px; of 255; points along a pixel's side
DECLARED = "gravity,elasticity,bending"
SOFT = {"warp_stiffness": 60.0, "weft_stiffness": 50.0, "coupling": 5.0, "shear_stiffness": 10.0}
FABRICS = {
    fabric.name: fabric
    for fabric in (
        Fabric("limp", 0.20, **SOFT, bending_rigidity=4e-6),
        Fabric("medium", 0.15, **SOFT, bending_rigidity=1.2e-5),
        Fabric("stiff", 0.25, **SOFT, bending_rigidity=6e-5),
        Fabric("curled", 0.15, **SOFT, bending_rigidity=1.2e-5, rest_curvature=-20.0),
        Fabric("ribbed", 0.15, **SOFT, bending_rigidity=9e-6, weft_bending=1.8),
    )
}


def draped(fabric: Fabric, face: int, random: np.random.Generator, edge: float = EDGE) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 3) m of a disc at rest on its plate, by its threads (u, v, out of its face), and triangles (T, 3).

    face: 1 with its face up, 2 face down.
    """
    mesh, held = ring(PLATE, DISC, edge)
    up = 1.0 if face == 1 else -1.0
    sheet = clamped(discretise(fabric, mesh, (0.0, 0.0, -9.81 * up)), held)
    away, turn = np.hypot(*mesh.material.T), np.arctan2(mesh.material[:, 1], mesh.material[:, 0])
    waves = [random.standard_normal(2) @ [np.cos(m * turn), np.sin(m * turn)] for m in WAVES]
    out = np.clip((away - PLATE) / (DISC - PLATE), 0.0, 1.0)
    height = ROUGH * out * np.sum(waves, axis=0) / np.sqrt(len(WAVES))
    start = np.column_stack([mesh.material, height])
    start[held, 2] = 0.0
    still = lambda t: np.broadcast_to(start[held], (len(t), len(held), 3)).copy()  # noqa: E731
    place = settle(sheet, start, held, still, stable_step(fabric, mesh), at_rest=2e-3)
    return place, mesh.triangle


def shadow(place: np.ndarray, triangle: np.ndarray, face: int, random: np.random.Generator) -> np.ndarray:
    """A picture (PIXELS, PIXELS) from above of cloth and plate, the specimen turned over about its warp for face 2."""
    import cv2

    askew = np.radians(TURNED * random.standard_normal())
    x, y = place[:, 0], place[:, 1] * (1.0 if face == 1 else -1.0)
    x, y = np.cos(askew) * x - np.sin(askew) * y, np.sin(askew) * x + np.cos(askew) * y
    middle = PIXELS / 2 + random.uniform(-1.0, 1.0, 2)
    at = np.stack([middle[0] + x / PIXEL, middle[1] - y / PIXEL], axis=1) * FINER
    image = np.zeros((PIXELS * FINER, PIXELS * FINER), np.uint8)
    corners = np.round(at[triangle] * 16).astype(np.int32)
    for one in corners:
        cv2.fillConvexPoly(image, one, 255, shift=4)
    centre, radius = np.round(middle * FINER * 16).astype(int), round(PLATE / PIXEL * FINER * 16)
    cv2.circle(image, tuple(int(c) for c in centre), radius, 255, -1, shift=4)
    small = cv2.GaussianBlur(image.reshape(PIXELS, FINER, PIXELS, FINER).mean(axis=(1, 3)), (0, 0), BLUR)
    return np.clip(np.round(255.0 - small + NOISE * random.standard_normal(small.shape)), 0, 255).astype(np.uint8)


def record(fabric: Fabric, split: str) -> Silhouettes:
    """The captures of one fabric's specimens of a split."""
    images, samples, sides = [], [], []
    for sample in range(1, SPECIMENS + 1):
        if (sample <= FITTED) != (split == "fit"):
            continue
        random = np.random.default_rng(zlib.crc32(f"{fabric.name}/{sample}".encode()))
        mine = replace(fabric, bending_rigidity=fabric.bending_rigidity * np.exp(SCATTER * random.standard_normal()))
        for face in (1, 2):
            images.append(shadow(*draped(mine, face, random), face, random))
            samples.append(sample)
            sides.append(face)
    return Silhouettes(
        name=f"{fabric.name}/{split}", fabric=fabric.name, split=split, image=np.stack(images),
        sample=np.array(samples), side=np.array(sides), pixel_size=PIXEL, disc_radius=DISC, plate_radius=PLATE,
        areal_density=fabric.areal_density, sensor="simulated camera above a drapemeter", motion="drape",
        source="clothbench reference simulation (tools/make_drape.py)", licence="CC0-1.0", declared_effects=DECLARED,
        notes={"truth_bend": f"{fabric.bending_rigidity:g}"} if fabric.name in ("limp", "medium", "stiff") else {},
    )  # fmt: skip


def check() -> None:
    """What triangles of half the edge change of drape coefficient and folds, over four drapes."""
    for fabric in FABRICS.values():
        found = []
        for edge in (EDGE, EDGE / 2):
            random = np.random.default_rng(5)
            drapes = [shadow(*draped(fabric, 1, random, edge), 1, random) for _ in range(4)]
            radius = np.stack([outline_in(image, PIXEL) for image in drapes])
            found.append((100 * drape_coefficient(radius, PLATE, DISC).mean(),
                          drape_quantities(radius, PLATE, DISC)[:, 1].mean()))  # fmt: skip
        (dc, folds), (finer_dc, finer_folds) = found
        print(f"{fabric.name}: DC {dc:.1f} → {finer_dc:.1f} %, folds {folds:.1f} → {finer_folds:.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fabrics", nargs="*", metavar="FABRIC", help=", ".join(FABRICS))
    parser.add_argument("--check", action="store_true", help="what a finer mesh changes")
    given = parser.parse_args()
    if given.check:
        return check()
    for name in given.fabrics or FABRICS:
        for split in ("fit", "held_out"):
            began = time.perf_counter()
            drapes = record(FABRICS[name], split)
            path = write_silhouettes(drapes, FOLDER / f"{name}-{split}.nc")
            radius = np.stack([outline_in(image, PIXEL) for image in drapes.image])
            found = drape_quantities(radius, PLATE, DISC)
            for face in (1, 2):
                mean, spread = found[drapes.side == face].mean(axis=0), found[drapes.side == face].std(axis=0)
                print(f"{path.stem} side {face}: DC {100 * mean[0]:.1f} ± {100 * spread[0]:.1f} %, "
                      f"folds {mean[1]:.1f} ± {spread[1]:.1f}, depth {1e3 * mean[2]:.1f} mm", flush=True)  # fmt: skip
            print(
                f"{path.stem:<18}{path.stat().st_size / 1e3:>7.0f} kB{time.perf_counter() - began:>6.0f} s", flush=True
            )
    return None


if __name__ == "__main__":
    main()
