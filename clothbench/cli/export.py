"""`clothbench export`: a calibrated cloth as a file of another simulator."""

from __future__ import annotations

import sys
from pathlib import Path

from clothbench.cli.view import find_cell
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_name, whole_file
from clothbench.plugins.discovery import catalogue
from clothbench.reference.presets import presets
from clothbench.twins.of_cell import FittedCell, brought, twin_of_cell
from clothbench.twins.of_preset import twin_of_preset


def fitted(name: str, results: Path) -> FittedCell | None:
    """The cell that is meant; None for a preset that no cell, case or recording is called like."""
    try:
        return FittedCell.of(results, find_cell(results, name).name)
    except ClothbenchError as fault:
        if name.strip().lower() in presets():
            return None
        raise ClothbenchError(f"{fault}; a class of fabrics can be exported, too: {', '.join(presets())}") from None


def export(name: str, target: str, results: Path, out: Path | None) -> int:
    """Write the twin of what `name` means in `results` for `target`; says where, and what the target cannot hold."""
    exporter = catalogue().load("exporters", target)
    if reason := exporter.skip_reason():
        raise ClothbenchError(f"--to {target}: {reason}")
    path = out or Path(f"{file_name(name)}{exporter.suffix}")
    if path.is_dir():
        raise ClothbenchError(f"--out {path} is a folder; give a file, for example {path / 'cloth'}{exporter.suffix}")
    fit = fitted(name, results)
    twin = twin_of_preset(name) if fit is None else twin_of_cell(fit)
    written = exporter.export(twin)
    with whole_file(path) as part:
        part.write_text(written.text, encoding="utf-8")
    print(f"{path}: {twin.name}, for {target}")
    for line in written.cannot:
        print(f"not held: {line}", file=sys.stderr)
    if written.cannot and fit is not None:
        away = 1e3 * brought(fit, written.material or twin.isotropic(target)[0])
        where = f"mean, {fit.bench.recordings[0].name}"
        print(
            f"not held: altogether this moves {fit.cell.model}'s own sheet by {away:.3g} mm ({where})", file=sys.stderr
        )
    return 0
