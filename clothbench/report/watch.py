"""The page of a run that is under way: written anew whenever a cell has finished, and loaded anew by itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from clothbench.core.files import whole_file
from clothbench.display.section import Section
from clothbench.display.templates import asset_of
from clothbench.engine.cells import digest
from clothbench.report.page import PAGE, write_page

EVERY = 1.0  # s between two looks at the store
BESIDE = "report.state.js"  # beside the page: which state of it is the newest


def watch(
    folder: Path, told: Callable[[Path, int], None], bring: Callable[[], None] = lambda: None, every: float = EVERY
) -> None:
    """Write FOLDER/report.html now and after every change of the store in that folder, until interrupted; `told(page,
    cells)` after each. The page that is left does not watch any more.

    bring: what is called before each further look, to bring what others have published; every: s between two looks.
    """
    shown = None
    try:
        while True:
            # A run that ends writes a page of its own, which does not watch.
            if (now := (state_of(folder), changed(folder / PAGE))) != shown:
                page = write_page(folder, [watching(now[0])])
                shown = now[0], changed(page)
                with whole_file(folder / BESIDE) as part:
                    part.write_text(f'self.clothbenchState = "{shown[0]}";\n', encoding="utf-8")
                told(page, len(finished(folder)))
            time.sleep(every)
            bring()
    finally:
        write_page(folder)
        (folder / BESIDE).unlink(missing_ok=True)


def changed(page: Path) -> int:
    """When a file was last written [ns]; 0 where there is none."""
    return page.stat().st_mtime_ns if page.is_file() else 0


def finished(folder: Path) -> list[Path]:
    """The rows of every finished cell; a cell takes its place whole."""
    return sorted(folder.glob("cells/[0-9a-f]*/rows.parquet"))


def state_of(folder: Path) -> str:
    """A word that is another one as soon as a cell has come, gone or been made anew."""
    return digest([(path.parent.name, path.stat().st_mtime_ns) for path in finished(folder) if path.exists()])


def watching(state: str) -> Section:
    """The line that says so, with the script that loads the page anew."""
    when = f"{datetime.now():%H:%M:%S}"
    said = f"Live: this page follows the run while cells finish. State of {when}."
    html = f'<p class="soft" data-watched="{state}" data-beside="{BESIDE}">{said}</p>'
    return Section(html, early=asset_of(Path(__file__).parent, "watch.js"))
