"""`clothbench view`: the Rerun viewer on a fit, or on a recording of `improve`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from clothbench.core.errors import ClothbenchError


def open_viewer(out: Path, name: str) -> int:
    """Open the viewer on the cell of `out` whose key begins with `name`, or, where `out` is of `clothbench improve`,
    on the recording of that name; returns the viewer's exit code.
    """
    file = improved(out, name) if (out / "verdict.json").is_file() else find_cell(out, name) / "fit.rrd"
    if not file.is_file():
        raise ClothbenchError(
            f"cell {file.parent.name} has no fit.rrd: it failed or ran with rerun=false; see the leaderboard"
        )
    return subprocess.run([sys.executable, "-m", "rerun", str(file)], check=False).returncode


def improved(out: Path, name: str) -> Path:
    """The Rerun file of one recording in a folder of `clothbench improve`."""
    from clothbench.core.files import file_name

    names = sorted(p.stem for p in (out / "rerun").glob("*.rrd"))
    if file_name(name) not in names:
        raise ClothbenchError(f"{out}: found no recording {name!r}; there are: {', '.join(names) or 'none'}")
    return out / "rerun" / f"{file_name(name)}.rrd"


def find_cell(out: Path, beginning: str) -> Path:
    """The one cell folder of `out` whose key begins so."""
    cells = sorted(p for p in (out / "cells").glob("[0-9a-f]*") if p.is_dir())
    found = [p for p in cells if p.name.startswith(beginning)]
    if len(found) == 1:
        return found[0]
    if not cells:
        raise ClothbenchError(f"{out}: found no cells; make some with: clothbench run +suite=static_dynamic")
    what = "several cells" if found else "no cell"
    names = [p.name for p in found or cells]
    listed = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
    raise ClothbenchError(f"{out}: found {what} whose key begins with {beginning!r}; there are: {listed}")
