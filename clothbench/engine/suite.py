"""The suite: which recordings × models × optimizers × metrics; here it becomes a list of cells."""

from __future__ import annotations

import dataclasses
import fnmatch
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import Source, plugin_versions, resplit
from clothbench.engine.rows import AnyCell
from clothbench.engine.settings import PRODUCT, checked, words
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.studies.calibration.cell import Cell, rehearse, uses
from clothbench.studies.folding.cell import plan_folds
from clothbench.studies.mechanics.cell import plan_validation

Told = Callable[[int, int, str], None]


def suites_folder() -> Path:
    """Where the built-in suites lie: inside the installed package, or beside it in a checkout."""
    inside = Path(__file__).parents[1] / "suites"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "suites"


def plan(config: Mapping[str, Any], plugins: Catalogue, progress: Told | None = None) -> list[AnyCell]:
    """Every cell of a resolved configuration. Reads and checks all recordings first: nothing is begun on bad input.

    `progress(done, planned, file)` is told while a public data set is fetched or converted.
    """
    config = checked(config, plugins)
    suite = config["suite"]
    if suite["tests"]:
        return list(plan_validation(config, plugins))
    if suite["fold"]:
        return list(plan_folds(config, plugins))
    recordings = read_all(where(config, progress))
    by, each = suite.get("case") or "fabric", suite["each"]
    cases = group(recordings, by, suite["select"], config["seed"], fitted=not each)
    if each:
        cases = one_by_one(cases, each)
    cells: dict[str, Cell] = {}
    searched: list[set[str] | None] = []
    for case, sources in cases.items():
        analysis = {n: _told(a) for n, a in config["analysis"].items() if _matches(case, a["cases"])}
        for model, optimizer, metric in itertools.product(*(config[key] for key in PRODUCT)):
            cell = Cell(
                suite=suite.get("name") or "single",
                case=case,
                recordings=tuple(sources),
                model=model,
                optimizer=optimizer,
                metric=metric,
                effects=tuple(dict.fromkeys([*config["effects"], *suite["effects"].get(model, [])])),
                fixed={n: v for p, values in suite["fixed"].items() if _matches(case, [p]) for n, v in values.items()},
                analysis=analysis,
                rivals=tuple(rivals(sources, cases)) if "confusion" in analysis else (),
                report=tuple(config["report"]),
                tracker=str(config["tracker"]),
                **{key: config[key] for key in ("options", "bounds", "scene", "budget", "seed", "timeout")},
            )
            cell = dataclasses.replace(cell, versions=plugin_versions(uses(cell), plugins))
            searched.append(rehearse(cell, plugins, {r.path: r for r in recordings}))
            cells[cell.key] = cell
    refuse_strays(config["bounds"], searched)
    return list(cells.values())


def refuse_strays(bounds: Mapping[str, Any], searched: Sequence[set[str] | None]) -> None:
    """Bounds of what no cell searches for, by the names of each cell's parameters (None: not known)."""
    known = {name for names in searched for name in names or ()}
    strays = [name for name in bounds if name not in known]
    if strays and None not in searched:
        raise ClothbenchError(f"setting 'bounds': no parameter {strays[0]!r}; there are: {', '.join(sorted(known))}")


def _matches(case: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch.fnmatch(case, p) for p in patterns)


def _told(options: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in options.items() if key != "cases"}


def one_by_one(cases: Mapping[str, Sequence[Source]], patterns: Sequence[str]) -> dict[str, list[Source]]:
    """A case of its own for each recording whose name matches, called by that name: it is fitted, the others of its
    case are held out, whatever split the files state.
    """
    out = {}
    for sources in cases.values():
        for fitted in (s for s in sources if _matches(s.name, patterns)):
            split = [dataclasses.replace(s, split="fit" if s is fitted else "held_out") for s in sources]
            out[fitted.name] = sorted(split, key=lambda s: s.split)
    if not out:
        raise ClothbenchError(f"setting 'suite.each' {list(patterns)} matches none of the recordings")
    return out


def rivals(sources: Sequence[Source], cases: Mapping[str, Sequence[Source]]) -> list[Source]:
    """The recordings of other fabrics ("FABRIC/TRIAL") whose trial is one that this case could have fitted."""
    known = {s.name: s for mine in cases.values() for s in mine}
    fitted = {s.name for mine in cases.values() for s in mine if s.split == "fit"}
    trials = {s.name.partition("/")[2] for s in sources if s.name in fitted}
    mine = {s.name for s in sources}
    return [s for name, s in sorted(known.items()) if name.partition("/")[2] in trials and name in fitted - mine]


def where(config: Mapping[str, Any], progress: Told | None = None) -> list[Path]:
    """The recording files a configuration means: `recording`, `recordings`, or those of the suite."""
    paths = config["recording"] or config["recordings"] or words("suite.recordings", config["suite"].get("recordings"))
    if not paths:
        raise ClothbenchError("no recordings named; choose +suite=NAME, or give recording=FILE or recordings=FOLDER")
    return find_recordings(itertools.chain.from_iterable(resolve(p, config, progress) for p in paths))


def resolve(path: str, config: Mapping[str, Any], progress: Told | None = None) -> list[Path]:
    """ "builtin:NAME", "dataset:NAME" and "pkg://package/folder" become folders; everything else is a path."""
    if path.startswith("builtin:"):
        return [suites_folder() / "embedded" / path.removeprefix("builtin:")]
    if path.startswith("pkg://"):
        package, _, folder = path.removeprefix("pkg://").partition("/")
        try:
            return [Path(str(files(package).joinpath(folder)))]
        except ModuleNotFoundError as fault:
            raise ClothbenchError(f"recordings {path!r}: {fault}; install the package that has them") from fault
    if path.startswith("dataset:"):
        from clothbench.datasets.convert import converted

        return [converted(path.removeprefix("dataset:"), data_dir=config.get("data_dir"), progress=progress)]
    return [Path(path)]


def read_all(paths: Iterable[Path]) -> list[Recording]:
    return [read_recording(path) for path in paths]


def _case_of(r: Recording, by: str) -> str:
    if by == "experiment":  # of one fabric, as the recording's header says
        return "/".join(filter(None, (r.fabric, r.notes.get("experiment", "")))) or r.name
    return getattr(r, by) or r.name


def group(
    recordings: Sequence[Recording], by: str, patterns: Sequence[str], seed: int, fitted: bool = True
) -> dict[str, list[Source]]:
    """Recordings by case, each with a fit split if `fitted`; a recording's name must match one of `patterns`."""
    chosen = [r for r in recordings if any(fnmatch.fnmatch(r.name, p) for p in patterns)]
    if not chosen:
        raise ClothbenchError(f"setting 'suite.select' {list(patterns)} matches none of {len(recordings)} recordings")
    cases: dict[str, list[Source]] = {}
    for r in chosen:
        case = "all" if by == "all" else r.name if by == "recording" else _case_of(r, by)
        cases.setdefault(case, []).append(Source(r.path, r.name, r.hash, r.split))
    out = {case: resplit(sources, seed) for case, sources in sorted(cases.items())}
    for case, sources in out.items():
        if fitted and not any(s.split == "fit" for s in sources):
            raise ClothbenchError(
                f"case {case!r}: found only held-out recordings, expected at least one to fit; see suite.select"
            )
        names = [s.name for s in sources]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise ClothbenchError(
                f"case {case!r}: two recordings are named {twice[0]!r}; names must differ within a case"
            )
    return out
