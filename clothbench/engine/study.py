"""What a kind of study is, and what the engine has to know of a cell: settings → plan → cells → run → store → sections.

A study is a module with the members of `Study`, registered by the hook `clothbench_studies`. Rows carry the name of
their study, and whatever shows them asks that study.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from clothbench.core.errors import ClothbenchError
from clothbench.core.progress import FileProgress, Progress, StageProgress
from clothbench.display.section import Section
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.leaderboard import FINISHED
from clothbench.engine.store import KEY, Store, superseded
from clothbench.engine.tables import Columns
from clothbench.plugins.discovery import Catalogue, PluginBroken

Rows = list[dict[str, Any]]
Settings = Mapping[str, Any]
SHOWN = ("suite", "case", "model", "effects", "key", "finished", "clothbench")  # what no row is without


class Cell(Protocol):
    """One point of a plan: frozen plain data that travels to worker processes.

    study: name of the study that runs it; cases: of its rows; key: 16 hexadecimal digits of all that its result depends
    on; budget: how many steps there are at most, of what `counts` says, None if that is not known before; value_word:
    what the value that it reports on the way is called; versions: "kind/name" → version of every plugin that it uses.
    What does not apply is None.
    """

    @property
    def study(self) -> str: ...
    @property
    def suite(self) -> str: ...
    @property
    def case(self) -> str: ...
    @property
    def cases(self) -> tuple[str, ...]: ...
    @property
    def model(self) -> str: ...
    @property
    def effects(self) -> tuple[str, ...]: ...
    @property
    def optimizer(self) -> str | None: ...
    @property
    def metric(self) -> str | None: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def versions(self) -> Mapping[str, str]: ...
    @property
    def row_columns(self) -> Mapping[str, Any]: ...
    @property
    def key(self) -> str: ...
    @property
    def label(self) -> str: ...
    @property
    def budget(self) -> int | None: ...
    @property
    def counts(self) -> str: ...
    @property
    def value_word(self) -> str: ...


# Lets workers do pieces of work (`Work` in clothbench/engine/executors/work.py): number of each and what came of it, as
# they end; None for one that no worker could do.
Elsewhere = Callable[[Sequence[Any]], Iterable[tuple[int, Any]]]


@dataclass(frozen=True)
class Context:
    """What a cell is run with. unfinished: folder for what has been computed of it; progress: told after every step;
    stage: told where work of several stages stands; rerun: whether files for Rerun are wanted; kept: folder for what
    the cells of a store share, None: nothing is kept; elsewhere: workers that a study may give pieces of the cell to,
    None: there are none.
    """

    plugins: Catalogue
    unfinished: Path
    progress: Progress = lambda steps, value: None
    stage: StageProgress = lambda name, done, planned: None
    rerun: bool = False
    kept: Path | None = None
    elsewhere: Elsewhere | None = None

    @cached_property
    def checkpoint(self) -> Checkpoint:
        """What an earlier run that was stopped has left of the cell; its clock starts when it is first asked for."""
        return Checkpoint(self.unfinished)


@dataclass(frozen=True)
class Result:
    """What came of a cell. tables: rows by the table's name, among them "rows", those of the leaderboard; attach adds
    further files to the cell's folder.
    """

    status: str
    tables: Mapping[str, Any]
    attach: Callable[[Path], None] | None = None


@dataclass(frozen=True)
class Results:
    """All that a store holds of one study, or of some of its cells. rows: of the leaderboard, in their order; tables:
    the columns of its other tables.
    """

    store: Store
    rows: Rows
    keys: tuple[str, ...] = field(default=())
    tables: Mapping[str, Columns] = field(default_factory=dict)

    def table(self, name: str) -> Rows:
        """A table by its name, over all cells that have it; what is said of no cell of these rows is left out, which
        only a damaged table says (`clothbench store check` names it).
        """
        of = {row["key"] for row in self.rows}
        found = self.store.table(name, self.keys, self.tables.get(name))
        return [row for row in found if "key" not in row or row["key"] in of]


class Study(Protocol):
    """A kind of study; a module with these members is one.

    name: as settings and rows have it; against: what its models are held against, in a word for the page's heading;
    suite_words: what it knows under `suite` beside the words that all know; tables: columns of every table that it
    fills, but for "rows".
    """

    name: str
    against: str
    suite_words: frozenset[str]
    tables: Mapping[str, Mapping[str, Any]]

    def plan(
        self, settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None
    ) -> Sequence[Cell]:
        """Every cell of the settings; what means nothing to this study is refused here, before anything is begun. What
        `RefusesSettings` refuses has been refused before.
        """
        ...

    def run(self, cell: Any, context: Context) -> Result:
        """Do what a cell asks for. Whatever is raised becomes the cell's row, with the reason."""
        ...

    def show(self, results: Results) -> Iterable[Any]:
        """What the terminal prints of its results: things that rich can print."""
        ...

    def sections(self, results: Results) -> Sequence[Section]:
        """What the page shows of them."""
        ...

    def claims(self, row: Mapping[str, Any], tables: frozenset[str]) -> bool:
        """Whether a row is its own that was written before rows carried their study; tables: those of its cell."""
        ...


@runtime_checkable
class RefusesSettings(Protocol):
    """A study that refuses settings before it reads recordings. Without it: its `plan` refuses them, job by job."""

    def refuse_settings(self, settings: Settings) -> None:
        """Refuse what can be no setting of it, whatever it is run on. Asked before every `plan`, and by a sweep of the
        settings of all jobs before the first begins.
        """
        ...


def refuse_unsound(study: Study, settings: Settings) -> None:
    """Have a study refuse what it can of checked settings without its recordings."""
    if isinstance(study, RefusesSettings):
        study.refuse_settings(settings)


def studies(plugins: Catalogue) -> dict[str, Study]:
    """Every registered study that can be loaded by name, in the order of registration; a broken one stands in the way
    of its own rows only.
    """
    found = {}
    for name in plugins.names("studies"):
        with contextlib.suppress(PluginBroken):
            found[name] = plugins.load("studies", name)
    return found


def results_by_study(
    store: Store, plugins: Catalogue, keys: Iterable[str] | None = None
) -> tuple[list[tuple[Study, Results]], list[str]]:
    """What the store holds, or of some cells of it, by study; studies without any are left out. And a line for each
    study of others' cells that is not there or is broken; a ClothbenchError where there are no cells but its own.
    """
    known, found, left_out = studies(plugins), store.rows(keys, every=True), []
    if keys is None and (old := superseded(found)):
        found = [row for row in found if row["key"] not in old]
        left_out.append(
            f"cells left out, since the same was asked later with plugins of other versions: {len(old)}; "
            f"`clothbench store prune {store.folder} --other-versions` removes such"
        )
    by_name: dict[str, Rows] = {}
    for row in found:
        _require_shown(row, store)
        if not row["study"]:
            tables = store.tables_of(row["key"])
            row["study"] = next(name for name, study in known.items() if study.claims(row, tables))
        by_name.setdefault(row["study"], []).append(row)
    for name in sorted(by_name.keys() - known.keys()):
        try:
            plugins.load("studies", name)
        except ClothbenchError as fault:
            if not by_name.keys() & known.keys():
                raise
            cells = {row["key"] for row in by_name.pop(name)}
            left_out.append(f"cells left out, since what they are of cannot be shown: {len(cells)}; {fault}")
    found_here = [
        (known[name], Results(store, rows, tuple(dict.fromkeys(r["key"] for r in rows)), known[name].tables))
        for name, rows in sorted(by_name.items(), key=lambda item: list(known).index(item[0]))
    ]
    return found_here, left_out


def _require_shown(row: Mapping[str, Any], store: Store) -> None:
    """Refuse a row that lacks what tables and pages rest on, or names a cell that cannot be: no run wrote it."""
    missing = next((name for name in SHOWN if row[name] is None), None)
    if missing or not KEY.fullmatch(row["key"]) or row["status"] not in (*FINISHED, "error"):
        what = f"no {missing}" if missing else f"key {row['key']!r} and status {row['status']!r}"
        raise ClothbenchError(
            f"{store.folder}: found a row of {row['case']!r} with {what}, expected it as a run writes it; "
            f"`clothbench store check {store.folder}` names the file"
        )
