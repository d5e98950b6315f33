"""`clothbench view`: the Rerun viewer on a fit, on a recording or case of a run, or on a recording of `improve`."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from clothbench.cli.arguments import DEFAULT_OUT
from clothbench.core.errors import ClothbenchError

HERE = "127.0.0.1"


def open_viewer(out: Path, name: str, web: bool = False) -> int:
    """Open the viewer on what `name` means in `out` (a cell's key or its beginning, a recording, a case); returns the
    viewer's exit code. web: in a browser, served on the loopback address; so it is where there is no display, too.
    """
    with tempfile.TemporaryDirectory(prefix="clothbench-") as made:
        file = improved(out, name) if (out / "verdict.json").is_file() else fitted(out, name, Path(made))
        command = [sys.executable, "-m", "rerun", str(file)]
        if not web and has_display():
            return subprocess.run(command, check=False).returncode
        return served(command)


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def served(command: list[str]) -> int:
    """Serve the web viewer until it is stopped; the link is printed first."""
    data, page = free_ports(2)
    print(
        f"view:   http://{HERE}:{page}?url=rerun%2Bhttp%3A%2F%2F{HERE}%3A{data}%2Fproxy   (Ctrl+C ends it)", flush=True
    )
    more = ["--serve-web", "--bind", HERE, "--port", str(data), "--web-viewer-port", str(page)]
    quiet = {**os.environ, "RUST_LOG": os.environ.get("RUST_LOG", "error")}
    # A group of its own: the viewer is a child of a child, and must not stay behind when this one ends.
    child = subprocess.Popen([*command, *more], env=quiet, start_new_session=True)
    hear_interrupts()
    try:
        return child.wait()
    except KeyboardInterrupt:
        return 0
    finally:
        end_group(child)


def hear_interrupts() -> None:
    """Let Ctrl+C and SIGTERM end what waits; a shell's background job would not hear the first by itself."""
    for asked in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asked, signal.default_int_handler)


def end_group(child: subprocess.Popen[bytes]) -> None:
    """End a process with all that it has started."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)  # it has nothing to lose: it only shows a file
    elif child.poll() is None:
        child.kill()
    child.wait()


def free_ports(count: int) -> list[int]:
    """Ports of the loopback address that nobody listens on."""
    doors = [socket.socket() for _ in range(count)]
    try:
        for door in doors:
            door.bind((HERE, 0))
        return [door.getsockname()[1] for door in doors]
    finally:
        for door in doors:
            door.close()


def fitted(out: Path, name: str, made: Path) -> Path:
    """The Rerun file of a cell, or of the best fit of a case; where its run wrote none, one of its films, below the
    folder `made`.
    """
    from clothbench.engine.store import Store
    from clothbench.studies.calibration.film_rerun import BEST, write_film_rerun

    folder = find_cell(out, name)
    if (file := folder / "fit.rrd").is_file():
        return file
    for best in (out / BEST).glob(f"*-{folder.name[:8]}.rrd"):
        return best
    if films := sorted((folder / "films").glob("*.npz")):
        return write_film_rerun(made / "films.rrd", Store(out), folder.name, films)
    raise ClothbenchError(
        f"cell {folder.name} has neither fit.rrd nor films: it failed, or an older version ran it; see the leaderboard"
    )


def improved(out: Path, name: str) -> Path:
    """The Rerun file of one recording in a folder of `clothbench improve`."""
    from clothbench.core.files import file_name

    names = sorted(p.stem for p in (out / "rerun").glob("*.rrd"))
    if file_name(name) not in names:
        raise ClothbenchError(f"{out}: found no recording {name!r}; there are: {', '.join(names) or 'none'}")
    return out / "rerun" / f"{file_name(name)}.rrd"


def find_cell(out: Path, name: str) -> Path:
    """The cell folder of `out` with that key, else the best cell of a case or recording of that name, else the one cell
    whose key begins so: a recording that is called 6 must not lose its name to a key that happens to begin with 6.
    """
    cells = sorted(p for p in (out / "cells").glob("[0-9a-f]*") if p.is_dir())
    if not cells:
        there = "" if str(out) == DEFAULT_OUT else f" out={out}"
        raise ClothbenchError(f"{out}: found no cells; make some with: clothbench run +suite=static_dynamic{there}")
    found = [p for p in cells if p.name.startswith(name)]
    if (whole := out / "cells" / name) in found:
        return whole
    if key := best_cell_of(out, name):
        return out / "cells" / key
    if len(found) == 1:
        return found[0]
    if found:
        raise ClothbenchError(
            f"{out}: found several cells whose key begins with {name!r}; there are: {_listed([p.name for p in found])}"
        )
    known = names_in(out) or [p.name for p in cells]
    raise ClothbenchError(
        f"{out}: found no case, no recording and no cell whose key begins with {name!r}; there are: {_listed(known)}"
    )


def names_in(out: Path) -> list[str]:
    """Cases of a run, then its recordings, as `find_cell` takes them; those that were fitted come first."""
    from clothbench.engine.store import Store

    rows = [r for r in Store(out).rows() if r["value"] is not None and r["metric"] == r["objective"]]
    recordings = sorted((r["split"] != "fit", r["recording"]) for r in rows if r["recording"])
    return list(dict.fromkeys([*sorted({r["case"] for r in rows}), *(name for _, name in recordings)]))


def _listed(names: list[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def best_cell_of(out: Path, name: str) -> str | None:
    """Key of the cell that comes nearest to what it was fitted to, of those whose case or recording is called so; those
    that were fitted to it come first. Only cells that minimised the same metric are compared: the one that most of them
    have, of several the first by name. Of a recording "CASE/NAME" that is the only one the last part will do, as tables
    call it. Says which it is where there are several.
    """
    from clothbench.engine.store import Store

    rows = [r for r in Store(out).rows() if r["value"] is not None and r["metric"] == r["objective"]]
    mine = [r for r in rows if name in (r["case"], f"{r['suite']} · {r['case']}", r["recording"])]
    if not mine:  # as the table of a run calls a recording below its case
        mine = [r for r in rows if (r["recording"] or "").rpartition("/")[2] == name]
        if len({r["recording"] for r in mine}) != 1:
            return None
    cells = {metric: len({r["key"] for r in mine if r["metric"] == metric}) for metric in {r["metric"] for r in mine}}
    metrics = sorted(cells, key=lambda metric: (-cells[metric], metric))
    order = sorted(mine, key=lambda r: (metrics.index(r["metric"]), r["split"] != "fit", r["value"], r["key"]))
    keys = list(dict.fromkeys(r["key"] for r in order))
    if len(keys) > 1:
        print(f"view:   cell {keys[0][:8]} ({_about(order[0])}); further: {', '.join(k[:8] for k in keys[1:9])}")
    return keys[0]


def _about(row: dict[str, Any]) -> str:
    from clothbench.display.names import cell_name

    return cell_name(row)
