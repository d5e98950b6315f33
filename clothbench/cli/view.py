"""`clothbench view`: the Rerun viewer on a fit, on a recording or case of a run, or on a recording of `improve`."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from clothbench.cli.arguments import DEFAULT_OUT
from clothbench.core.errors import ClothbenchError, nearest
from clothbench.core.files import entries

HERE = "127.0.0.1"


def open_viewer(out: Path, name: str, web: bool = False) -> int:
    """Open the viewer on what `name` means in `out` (a cell's key or its beginning, a recording, a case); returns the
    viewer's exit code. web: in a browser, served on the loopback address; so it is where there is no display, too.
    """
    with tempfile.TemporaryDirectory(prefix="clothbench-") as made:
        file = file_of(out, name, Path(made))
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


@contextlib.contextmanager
def ended_in_order() -> Iterator[None]:
    """Let SIGTERM end what is under way as Ctrl+C does, so that what is half-written goes; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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


def file_of(out: Path, name: str, made: Path) -> Path:
    """The Rerun file that `name` means in `out`, where a run and a verdict of `improve` may both lie: then it is said
    which of them it is of. A name that both know is the verdict's; what the run left goes by the key of its cell.
    made: a folder for a file that has to be made.
    """
    from clothbench.core.files import file_name
    from clothbench.studies.improve.document import VERDICT
    from clothbench.studies.improve.files import rerun_files

    if not (out / VERDICT).is_file():
        return fitted(out, name, made)
    judged, run = rerun_files(out), fit_rows(out)
    file = judged.get(name) or next((f for f in judged.values() if f.stem == file_name(name)), None)
    if not run and file is None:
        raise ClothbenchError(f"{out}: found no recording {name!r}; there are: {', '.join(judged) or 'none'}")
    if file is None:
        try:
            file = fitted(out, name, made)
        except ClothbenchError as fault:
            raise ClothbenchError(f"{fault}; of improve: {', '.join(judged) or 'none'}") from None
        print(f"view:   a fit of clothbench run; the verdict of improve here is on: {', '.join(judged) or 'none'}")
    elif key := next(iter(cells_of(run, name)), None):
        other = f"clothbench view {key} --out {shlex.quote(str(out))}"
        print(f"view:   {name} as improve judged it; as clothbench run fitted it: {other}")
    return file


def fitted(out: Path, name: str, made: Path) -> Path:
    """The Rerun file of a cell, or of the best fit of a case; where its run wrote none, one of its films, below the
    folder `made`.
    """
    from clothbench.engine.store import Store
    from clothbench.studies.calibration.film_rerun import BEST, write_film_rerun
    from clothbench.studies.improve.document import VERDICT

    folder = find_cell(out, name, viewed=True)
    if (file := folder / "fit.rrd").is_file():
        return file
    for best in (out / BEST).glob(f"*-{folder.name[:8]}.rrd"):
        return best
    if films := sorted((folder / "films").glob("*.npz")):
        return write_film_rerun(made / "films.rrd", Store(out), folder.name, films)
    if (folder / VERDICT).is_file():
        raise ClothbenchError(f"cell {folder.name} is of improve: view one of its recordings with --out {folder}")
    raise ClothbenchError(
        f"cell {folder.name} has neither fit.rrd nor films: it failed, or an older version ran it; see the leaderboard"
    )


def find_cell(out: Path, name: str, viewed: bool = False) -> Path:
    """The cell folder of `out` with that key, else the best cell of a case or recording of that name, else the one cell
    whose key begins so: a recording that is called 6 must not lose its name to a key that happens to begin with 6.
    viewed: as for `best_cell_of`.
    """
    from clothbench.engine.store import KEY

    if not name.strip():
        raise ClothbenchError("found an empty name of a cell, expected a case, a recording or the beginning of a key")
    cells = [p for p in entries(out / "cells") if KEY.fullmatch(p.name) and p.is_dir()]
    if not cells:
        there = "" if str(out) == DEFAULT_OUT else f" out={out}"
        raise ClothbenchError(f"{out}: found no cells; make some with: clothbench run +suite=static_dynamic{there}")
    found = [p for p in cells if p.name.startswith(name)]
    if (whole := out / "cells" / name) in found:
        return whole
    if key := best_cell_of(out, name, viewed):
        return out / "cells" / key
    if len(found) == 1:
        return found[0]
    if found:
        raise ClothbenchError(
            f"{out}: found several cells whose key begins with {name!r}; there are: {_listed([p.name for p in found])}"
        )
    known = names_in(out) or [p.name for p in cells]
    raise ClothbenchError(
        f"{out}: found no case, no recording and no cell whose key begins with {name!r}; {nearest(name, known)}"
        f"there are: {_listed(known)}"
    )


def fit_rows(out: Path) -> list[dict[str, Any]]:
    """Rows with the error that a fit minimised; those of `improve` are of a verdict, which has files of its own."""
    from clothbench.engine.store import Store
    from clothbench.studies.improve.cell import ImproveCell

    rows = [r for r in Store(out).rows() if r["value"] is not None and r["metric"] == r["objective"]]
    return [r for r in rows if r["study"] != ImproveCell.study]


def names_in(out: Path) -> list[str]:
    """Cases of a run, then its recordings, as `find_cell` takes them; those that were fitted come first."""
    rows = fit_rows(out)
    recordings = sorted((r["split"] != "fit", r["recording"]) for r in rows if r["recording"])
    return list(dict.fromkeys([*sorted({r["case"] for r in rows}), *(name for _, name in recordings)]))


def _listed(names: list[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def best_cell_of(out: Path, name: str, viewed: bool = True) -> str | None:
    """Key of the best of `cells_of` the rows of a folder. Says which it is where there are several: beside what is
    viewed, or else as a remark, since standard output may be a document of another command's.
    """
    found = cells_of(fit_rows(out), name)
    if len(found) > 1:
        key, row = next(iter(found.items()))
        said = f"cell {key[:8]} ({_about(row)}); further: {_listed([k[:8] for k in list(found)[1:]], 8)}"
        print(f"view:   {said}" if viewed else f"clothbench: {name}: {said}", file=sys.stdout if viewed else sys.stderr)
    return next(iter(found), None)


def cells_of(rows: list[dict[str, Any]], name: str) -> dict[str, dict[str, Any]]:
    """Keys of the cells whose case or recording is called so, with a row of each: first the one that comes nearest to
    what it was fitted to, over all recordings of the case; those that were fitted to it come before others. Only cells
    that minimised the same metric in the same unit are compared: what most of them have comes first, of several the
    first by name. Of a recording "CASE/NAME" that is the only one the last part will do, as tables call it.
    """
    mine = [r for r in rows if name in (r["case"], f"{r['suite']} · {r['case']}", r["recording"])]
    if not mine:  # as the table of a run calls a recording below its case
        mine = [r for r in rows if r["recording"] and r["recording"].rpartition("/")[2] == name]
        if len({r["recording"] for r in mine}) != 1:
            return {}
    cells = {measure: len({r["key"] for r in mine if measure_of(r) == measure}) for measure in map(measure_of, mine)}
    measures = sorted(cells, key=lambda measure: (-cells[measure], measure))
    out: dict[str, dict[str, Any]] = {}

    def order(row: dict[str, Any]) -> tuple[Any, ...]:
        single = bool(row["recording"])  # one good recording does not make a fit of several a good one
        return measures.index(measure_of(row)), row["split"] != "fit", single, row["value"], row["key"]

    for row in sorted(mine, key=order):
        out.setdefault(row["key"], row)
    return out


def measure_of(row: dict[str, Any]) -> tuple[str, str]:
    """By what an error is measured, and in what unit: only such numbers can be compared."""
    return row["metric"], str(row["unit"])


def _about(row: dict[str, Any]) -> str:
    from clothbench.display.names import cell_name

    return cell_name(row)
