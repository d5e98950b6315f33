"""`clothbench export`: a calibrated cloth as a file of another simulator."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from clothbench.cli.view import find_cell
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_name, whole_file
from clothbench.core.protocols import Material
from clothbench.plugins.discovery import catalogue
from clothbench.reference.presets import presets
from clothbench.studies.calibration.moved import hashes
from clothbench.twins.of_cell import FittedCell, brought, twin_of_cell
from clothbench.twins.of_preset import twin_of_preset

PRESET = "preset:"  # before the name of a class of fabrics, where a cell is called so, too


def fitted(name: str, results: Path, recordings: Sequence[str] = ()) -> FittedCell | None:
    """The cell that is meant; None for a preset that no cell, case or recording is called like, or that is asked for as
    preset:NAME. Says which it is where both are there. recordings: where those of the cell lie now.
    """
    if name.startswith(PRESET):
        return None
    is_preset = name.strip().lower() in presets()
    try:
        key = find_cell(results, name).name
    except ClothbenchError as fault:
        if is_preset:
            return None
        raise ClothbenchError(f"{fault}; a class of fabrics can be exported, too: {', '.join(presets())}") from None
    if is_preset:
        print(
            f"clothbench: {name}: taken for the cell {key} of {results}; the class of fabrics is {PRESET}{name}",
            file=sys.stderr,
        )
    return FittedCell.of(results, key, hashes(recordings))


def export(name: str, target: str, results: Path, out: Path | None, recordings: Sequence[str] = ()) -> int:
    """Write the twin of what `name` means in `results` for `target`; says where, and what the target cannot hold."""
    exporter = catalogue().load("exporters", target)
    if reason := exporter.skip_reason():
        raise ClothbenchError(f"--to {target}: {reason}")
    if out is not None and str(out) == "-":
        raise ClothbenchError("--out -: an export is a file, which others name; give one, as --out cloth.xml")
    fit, named = fitted(name, results, recordings), name.removeprefix(PRESET)
    if fit is None and recordings:
        raise ClothbenchError(f"found --recordings beside the class of fabrics {named!r}, which has none; leave it out")
    path = out or Path(f"{file_name(named)}{exporter.suffix}")
    if path.is_dir():
        raise ClothbenchError(f"--out {path} is a folder; give a file, for example {path / 'cloth'}{exporter.suffix}")
    twin = twin_of_preset(named) if fit is None else twin_of_cell(fit)
    written = exporter.export(twin)
    cannot = list(written.cannot)
    if cannot and fit is not None:
        cannot.append(altogether(fit, written.material or twin.isotropic(target)[0]))
    with whole_file(path, asked=True) as part:
        part.write_text(written.text, encoding="utf-8")
    print(f"{path}: {twin.name}, for {target}")
    for line in cannot:
        print(f"not held: {line}", file=sys.stderr)
    return 0


def altogether(fit: FittedCell, material: Material) -> str:
    """A line on how far the fitted model's own sheet goes astray with no more than the material that a file holds, or
    why that is not known.
    """
    scene, own = fit.scene, f"{fit.cell.model}'s own sheet"
    try:
        away = f"altogether this moves {own} by {1e3 * brought(fit, material):.3g} mm"
    except ClothbenchError as fault:
        return f"how far all of this moves {own} is not reckoned: {fault}"
    around = {
        "obstacles": scene.obstacles, "thickness": scene.thickness, "outline": scene.outline is not None,
        "velocity": scene.velocity is not None,
    }  # fmt: skip
    there = [name for name, is_there in around.items() if is_there]
    kept = f"; {' and '.join(there)} as recorded" if there else ""
    return f"{away} (mean, {fit.bench.recordings[0].name}{kept})"
