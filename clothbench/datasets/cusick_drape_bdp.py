"""Importer for `cusick_drape_bdp`: shadows of drapes in a Cusick drapemeter, 25 fabrics, five of them with a name.

One recording of kind "silhouette" for each fabric and split: two thirds of its specimens to fit, the others held out
(fabrics of one or two specimens are not split). What the originals leave open, and what is made of it:

- Nothing states how large a pixel is. The meshes that were made of the shadows say 1.385 mm; the innermost troughs of
  limp fabrics then lie on the plate's rim, 90.2 mm from the middle.
- Fabrics 2 to 5 have no name and no mass in their folders, but their pictures are those of named ones in another
  folder, byte by byte; so they get both. `cotton_white`, and one more capture of `cotton_blue`, are in that other
  folder only. The mass of all others is not known.
- Which side was up is stated in the names of named pictures only: where the same bytes lie in both folders, the first
  two captures of a specimen show its face up, the others face down. So it is read for fabrics 2 to 5; `cotton_white`
  says it of itself; of the others nobody knows.
- The meshes are no measurements (straight from plate to shadow) and are not read.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import sha256
from clothbench.core.pictures import picture_of
from clothbench.core.progress import FileProgress
from clothbench.datasets import registry
from clothbench.datasets.report import ImportReport, write_report
from clothbench.recordings.codec import write
from clothbench.recordings.silhouette import LAYOUT, Silhouettes

NAME, REPORT = "cusick_drape_bdp", "import-report.json"
PIXEL, DISC, PLATE = 1.385e-3, 0.15, 0.09  # m
NAMED = {2: "cotton_blue", 3: "viscose_white", 4: "cotton_pink", 5: "wool_red"}
AREAL_DENSITY = {  # kg/m², as the authors' code has them
    "cotton_blue": 0.192, "cotton_pink": 0.114, "cotton_white": 0.059, "viscose_white": 0.213, "wool_red": 0.274,
}  # fmt: skip
FABRIC = re.compile(r"Fabric_(?P<fabric>\d+)(?P<observed>_Observations)?")
FACE = re.compile(r"_(?P<turned>upward|downward)_", re.IGNORECASE)
SHOT = re.compile(r"sample_(?P<sample>\d+)(?:_.*?(?P<number>\d+))?$", re.IGNORECASE)
NEXT = "clothbench run model=mass_spring_verlet optimizer=cma_es metric=drape tracker=drape recordings={folder}"


@dataclass(frozen=True)
class Shot:
    """One picture. fabric: a name; sample: of the specimen; number: of the capture; digest: of its bytes."""

    path: Path
    fabric: str
    sample: int
    number: int
    digest: str


def convert(source: Path, out: Path, progress: FileProgress | None = None) -> list[ImportReport]:
    """Write the recordings of all fabrics under `source` into `out`, with import-report.json; returns all reports.

    Pictures that are the same bytes as another's are said and left out, as are those whose bytes are not the
    registry's. `progress(done, planned, name)` is called after every fabric.
    """
    source, out = Path(source), Path(out)
    shots, check = find_shots(source), registry.verify(NAME, source)
    kept, remarks = without_copies(shots, source, check)
    fabrics = sorted({s.fabric for s in kept}, key=lambda name: (name not in AREAL_DENSITY, len(name), name))
    reports: list[ImportReport] = []
    for done, fabric in enumerate(fabrics, 1):
        mine = sorted((s for s in kept if s.fabric == fabric), key=lambda s: (s.sample, s.number))
        for split, some in split_of(mine).items():
            drapes = drapes_of(fabric, split, some)
            path = write(drapes, out / fabric / f"{split or 'all'}.nc", LAYOUT)
            about = tuple(remarks.pop(fabric, ()))
            reports.append(ImportReport(fabric, path.relative_to(out).as_posix(), len(some), len(some), notes=about))
        if progress:
            progress(done, len(fabrics), fabric)
    reports += [ImportReport(name, skipped="; ".join(said)) for name, said in remarks.items()]
    dataset = registry.DATASETS[NAME]
    header = {"dataset": NAME, "source": f"{dataset.repository}@{dataset.commit}", "licence": dataset.licence}
    write_report(reports, out / REPORT, **header, next=NEXT, next_folder="viscose_white")
    return reports


def find_shots(source: Path) -> list[Shot]:
    """Every picture under `source`, in a fixed order; none is an error."""
    found = []
    for path in sorted(source.glob(registry.DATASETS[NAME].pattern)):
        folder, shot = path.relative_to(source).parts[0], SHOT.search(path.stem)
        if shot is None:
            continue
        if match := FABRIC.fullmatch(folder):
            number = int(match["fabric"])
            name = NAMED.get(number, f"fabric_{number:02d}")
            fabric = f"{name}_observations" if match["observed"] else name
        else:
            fabric = path.parent.name
        found.append(Shot(path, fabric, int(shot["sample"]), int(shot["number"] or 1), sha256(path)))
    if not found:
        raise ClothbenchError(
            f"{source}: found no FABRIC/silhouettes/…_Sample_N_Capture_M.jpg, expected the drapes' silhouettes; check "
            "data_dir"
        )
    return found


def without_copies(
    shots: Sequence[Shot], source: Path, check: registry.Check
) -> tuple[list[Shot], dict[str, list[str]]]:
    """The pictures whose bytes are the registry's, each of them once; and what is to be said of the others, by fabric.

    Of two copies the one in a fabric's own folder stays.
    """
    first: dict[str, Shot] = {}
    said: dict[str, list[str]] = {}
    for shot in sorted(shots, key=lambda s: (not s.path.relative_to(source).parts[0].startswith("Fabric_"), s.path)):
        local = shot.path.relative_to(source).as_posix()
        if local in check.wrong:
            said.setdefault(shot.fabric, []).append(f"{local}: SHA-256 differs from the registry's; fetch it again")
        elif shot.digest in first:
            other = first[shot.digest].path.relative_to(source).as_posix()
            said.setdefault(shot.fabric, []).append(f"{local}: the same bytes as {other}, counted once")
        else:
            first[shot.digest] = shot
    return list(first.values()), said


def split_of(shots: Sequence[Shot]) -> dict[str, list[Shot]]:
    """By whole specimens: the first two thirds to fit, the others held out; "" for all where there are fewer than 3."""
    samples = sorted({s.sample for s in shots})
    if len(samples) < 3:
        return {"": list(shots)}
    fitted = set(samples[: round(2 * len(samples) / 3)])
    return {
        "fit": [s for s in shots if s.sample in fitted],
        "held_out": [s for s in shots if s.sample not in fitted],
    }


def side_of(shot: Shot) -> int:
    """Which side of the specimen was up, of `recordings.silhouette.SIDES`."""
    if said := FACE.search(shot.path.stem):
        return 1 if said["turned"].lower() == "upward" else 2
    if shot.fabric in NAMED.values():
        return 1 if shot.number <= 2 else 2
    return 0


def drapes_of(fabric: str, split: str, shots: Sequence[Shot]) -> Silhouettes:
    """One recording of a fabric's pictures."""
    import cv2

    images = []
    for shot in shots:
        image = picture_of(shot.path, cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ClothbenchError(f"{shot.path}: found no picture that can be read, expected a JPEG of 256 × 256 px")
        images.append(image)
    dataset = registry.DATASETS[NAME]
    return Silhouettes(
        name=f"{fabric}/{split or 'all'}", fabric=fabric, split=split, image=np.stack(images),
        sample=np.array([s.sample for s in shots]), side=np.array([side_of(s) for s in shots]), pixel_size=PIXEL,
        disc_radius=DISC, plate_radius=PLATE, areal_density=AREAL_DENSITY.get(fabric, np.nan),
        sensor="Cusick drapemeter, camera above", source=f"{dataset.repository}@{dataset.commit}",
        licence=dataset.licence, motion="drape",
    )  # fmt: skip
