"""`clothbench improve`: recordings and a model in, the verdict on what the model lacks out.

It runs the one cell of `+suite=improve` in the store OUT, and lays what was found on top: verdict, page, tables.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from clothbench.cli.idle import say_idle, say_split
from clothbench.cli.run import composed
from clothbench.cli.spelling import unexpected
from clothbench.core.create_only import require_create_only
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import json_text
from clothbench.core.output import takes_all_letters
from clothbench.engine.bucket import is_address
from clothbench.engine.executors.drive import elsewhere, opened
from clothbench.engine.executors.settings import LOCAL, executor_settings
from clothbench.engine.mirror import results_folder
from clothbench.engine.run import TRACEBACK, run_cell
from clothbench.engine.settings import KNOWN
from clothbench.engine.store import Store
from clothbench.engine.study import Elsewhere
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import Catalogue, catalogue
from clothbench.recordings.codec import stated_in
from clothbench.studies.improve.candidates import unusable
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.common import common_document
from clothbench.studies.improve.document import document_in
from clothbench.studies.improve.files import publish, require_own_page
from clothbench.studies.improve.plan import NOT_ASKED
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.terminal import verdict_lines

OUT = "improve"
NEEDED = ("recordings", "model")  # of the first, `recording` will do
# Words that are taken as they stand, commas and all, and where they belong; Hydra would see a sweep.
PLAIN = {
    "recordings": ("recordings",), "recording": ("recording",), "model": ("model",), "out": ("out",),
    "candidates": ("suite", "candidates"), "base": ("suite", "base"),
}  # fmt: skip
SHORT = {"resolution": "suite.resolution", "damping": "suite.damping", "areal_density": "scene.areal_density"}
NESTED = ("options", "bounds")  # told as KEY.NAME=VALUE
OF_RUN = {"study", "suite", "budget", "limits", "effects", "finer"}  # settings that mean nothing here
WORDS = (*PLAIN, *SHORT, *NESTED, *sorted(KNOWN - {*PLAIN, *NESTED} - OF_RUN))

SHOWN = tuple(word for word in WORDS if word not in NOT_ASKED)  # the rest is refused with the reason


def command(words: Sequence[str], as_json: bool = False) -> int:
    """Run the loop with settings as KEY=VALUE words gave them, and print the verdict: in words, or as the document."""
    plugins, settings = catalogue(), settings_of(words)
    if is_address(settings["out"]):  # the cell goes into the bucket; verdict, page and tables are laid into its mirror
        settings["out"] = str(results_folder(settings["out"]))
    executor = executor_settings(settings.get("executor"))
    if executor["name"] == LOCAL and settings["jobs"]:
        raise ClothbenchError("setting 'jobs' is for the workers of an executor: name one, or leave it out")
    cells: list[ImproveCell] = plan(settings, plugins)  # type: ignore[assignment]
    if len({(cell.optimizer, cell.case) for cell in cells}) > 1:
        raise ClothbenchError(
            "found several optimizers or fabrics, expected one; for more: clothbench run +suite=improve …"
        )
    out = Path(settings["out"])
    require_own_page(out)
    store = Store(out)
    say_idle(words, cells, settings)
    for remark in remarks(cells[0], plugins, all_tried=settings["suite"]["candidates"] is None):
        print(f"clothbench: {remark}", file=sys.stderr)
    say_split(cells)
    with workers_of(executor, settings["jobs"], out, [cell for cell in cells if not store.has(cell.key)]) as elsewhere:
        for cell in cells:
            judge(cell, store, out, settings["rerun"], cell.model if len(cells) > 1 else "", elsewhere)
    finished = [cell for cell in cells if store.has(cell.key)]
    if finished:
        document = published([store.cell(cell.key) for cell in finished], out, several=len(cells) > 1)
        print(json_text(document, plain=not takes_all_letters())) if as_json else say(document, out)
    missing = [cell for cell in cells if cell not in finished]
    return max((failed(store, cell.key) for cell in missing), default=0)


@contextmanager
def workers_of(
    executor: Mapping[str, Any], jobs: int, out: Path, cells: Sequence[ImproveCell]
) -> Iterator[Elsewhere | None]:
    """Workers of the executor for fits and probes of these cells; None where there is none, or nothing to do."""
    if executor["name"] == LOCAL or not cells:
        yield None
        return
    most = max(len(cell.candidates) + len(cell.recordings) for cell in cells)
    with opened(executor, jobs, most, out.absolute()) as workers:
        yield elsewhere(workers, {name: version for cell in cells for name, version in cell.versions.items()})


def judge(
    cell: ImproveCell, store: Store, out: Path, rerun: bool, named: str, elsewhere: Elsewhere | None = None
) -> None:
    """Run a cell, unless that was done before. named: what the stages of one among several are told under; elsewhere:
    workers that do fits and probes of it.
    """
    if store.has(cell.key):
        which = f" {named}:" if named else ""
        print(f"{out}:{which} kept, these recordings were judged with the same settings before", file=sys.stderr)
        return
    require_create_only(out)
    before = f"{named}: " if named else ""
    with StageBar() as bar:
        run_cell(
            cell, out, rerun=rerun, stage=lambda name, done, of: bar.stage(before + name, done, of),
            elsewhere=elsewhere,
        )  # fmt: skip


def settings_of(words: Sequence[str]) -> dict[str, Any]:
    """The settings of `+suite=improve`, with KEY=VALUE words over them; anything else is refused."""
    given, plain = ["+suite=improve", f"out={OUT}"], {}
    for word in words:
        key, sign, value = word.partition("=")
        first = key.partition(".")[0]
        if not sign or first not in WORDS:
            raise unexpected(word, first, SHOWN)
        if key in PLAIN:
            plain[key] = value
        elif first in NESTED:  # what a plugin or a model brings is not known to the settings before
            given.append(f"++{word}")
        else:
            given.append(f"{SHORT.get(key, key)}={value}")
    for key in NEEDED:
        if not (plain.get(key) or (key == "recordings" and plain.get("recording"))):
            raise ClothbenchError(f"found no {key}=…, expected clothbench improve recordings=DIR model=NAME [out=DIR]")
    settings = composed(given)
    for key, value in plain.items():
        *above, last = PLAIN[key]
        place = settings
        for name in above:
            place = place[name]
        place[last] = models_of(value) if key == "model" else value
    return settings


def models_of(value: str) -> list[str]:
    """The models that "mass_spring" or "[mass_spring,inextensible]" names."""
    if value.startswith("[") != value.endswith("]"):
        raise ClothbenchError(f"found model={value}, expected NAME or [NAME,NAME]; write both brackets, or none")
    return [name.strip() for name in value.removeprefix("[").removesuffix("]").split(",") if name.strip()]


def remarks(cell: ImproveCell, plugins: Catalogue, all_tried: bool) -> list[str]:
    """What the user may not have meant: effects that cannot be tried, too few recordings, several fabrics for one
    cloth.
    """
    out = [f"no candidate: {reason}" for reason in (unusable(plugins) if all_tried else ())]
    fitted, least = len(cell.of_split("fit")), LOOP.least_recordings
    if fitted < least and cell.kind != "silhouette":  # of which each holds several specimens
        out.append(f"{fitted} recordings to fit; an effect can be named from {least} on")
    if len(fabrics := sorted({stated_in(Path(source.file), "fabric") for source in cell.recordings} - {""})) > 1:
        out.append(f"{', '.join(fabrics)} are taken for one cloth; run +suite=improve suite.case=fabric asks of each")
    return out


def failed(store: Store, key: str) -> int:
    """Why there is no verdict; 2 if the user can mend it, 1 if a plugin or clothbench itself is at fault."""
    reason = store.rows([key])[0]["reason"]
    traceback = store.cell(key) / TRACEBACK
    if not traceback.is_file():
        raise ClothbenchError(reason)
    print(f"clothbench: {reason}; see {traceback}", file=sys.stderr)
    return 1


def published(cells: Sequence[Path], out: Path, several: bool = False) -> dict[str, Any]:
    """Lay what finished cells hold on top of `out`, unless it lies there already; returns the verdict. several: models
    were asked about, so that the verdict is on what they have in common.
    """
    documents = [verdict_in(cell) for cell in cells]
    document = common_document(documents) if several else documents[0]
    if (there := document_in(out)) is None or there.get("key") != document["key"]:
        nearest = next(c for c, d in zip(cells, documents, strict=True) if d["model"] == document["model"])
        publish(nearest, out, document if several else None)
    return document


def verdict_in(cell: Path) -> dict[str, Any]:
    if (document := document_in(cell)) is None:
        raise ClothbenchError(f"{cell}: found no verdict that can be read; delete the folder and run again")
    return document


class StageBar:
    """Which stage the loop is in and how far; without a terminal, one line for each stage."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        self.live, self.last = console.is_terminal, ""
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self.bar = Progress(*columns, console=console, disable=not self.live)
        self.task = self.bar.add_task("read", total=None)

    def __enter__(self) -> StageBar:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def stage(self, name: str, done: int, planned: int) -> None:
        self.bar.update(self.task, description=name, completed=done, total=planned)
        if not self.live and name != self.last:
            print(name, file=sys.stderr)
        self.last = name


def say(found: Mapping[str, Any], out: Path) -> None:
    """The verdict in a few lines, and where things lie."""
    for line in verdict_lines(found):
        print(line)
    print(f"page: {out / 'index.html'}")
    seen = (out / "rerun").is_dir() and any((out / "rerun").iterdir())
    rerun = f"; Rerun files: {out / 'rerun'}" if seen else ""
    print(f"verdict: {out / 'verdict.json'}; tables: {out / 'tables'}{rerun}")
    if seen:
        recordings = [*found["recordings"]["held_out"], *found["recordings"]["fit"]]
        print(f"look at one with: clothbench view {shlex.quote(recordings[0])} --out {shlex.quote(str(out))}")
