"""The suite: which recordings × models × optimizers × metrics; here it becomes a list of cells."""

from __future__ import annotations

import dataclasses
import fnmatch
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from clothbench.errors import ClothbenchError
from clothbench.experiment.cell import Cell, Source, plugin_versions, resplit
from clothbench.plugins import Catalogue
from clothbench.recording import Recording, find_recordings, read_recording

CASES = ("fabric", "motion", "recording", "all")
PRODUCT = ("model", "optimizer", "metric")
KNOWN = {
    *PRODUCT, "effects", "report", "tracker", "recordings", "recording", "scene", "options", "bounds", "budget",
    "seed", "jobs", "timeout", "out", "data_dir", "suite", "rerun",
}  # fmt: skip
Told = Callable[[int, int, str], None]
SUITE_KEYS = {"name", "version", "title", "recordings", "select", "case"}


def suites_folder() -> Path:
    """Where the built-in suites lie: inside the installed package, or beside it in a checkout."""
    inside = Path(__file__).parents[1] / "suites"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "suites"


def plan(config: Mapping[str, Any], plugins: Catalogue, progress: Told | None = None) -> list[Cell]:
    """Every cell of a resolved configuration. Reads and checks all recordings first: nothing is begun on bad input.

    `progress(done, planned, file)` is told while a public data set is fetched or converted.
    """
    check_keys(config)
    suite = config.get("suite") or {}
    name = suite.get("name") or "single"
    cases = group(
        read_all(where(config, progress)),
        suite.get("case") or "fabric",
        suite.get("select") or "*",
        int(config["seed"]),
    )
    cells = []
    for case, sources in cases.items():
        for model, optimizer, metric in itertools.product(*(as_list(config, key) for key in PRODUCT)):
            cell = Cell(
                suite=name, case=case, recordings=tuple(sources), model=model, optimizer=optimizer, metric=metric,
                effects=tuple(as_list(config, "effects")), report=tuple(as_list(config, "report")),
                tracker=str(config["tracker"]), options=config.get("options") or {},
                bounds={k: (float(v[0]), float(v[1])) for k, v in (config.get("bounds") or {}).items()},
                scene=scene_settings(config.get("scene") or {}), budget=int(config["budget"]),
                seed=int(config["seed"]), timeout=config.get("timeout"),
            )  # fmt: skip
            cells.append(dataclasses.replace(cell, versions=plugin_versions(cell, plugins)))
    return cells


def check_keys(config: Mapping[str, Any]) -> None:
    """Refuse words that mean nothing here; a misspelt setting must not pass in silence."""
    if unknown := sorted(set(config) - KNOWN):
        raise ClothbenchError(f"setting {unknown[0]!r} is not known; there are: {', '.join(sorted(KNOWN))}")
    suite = config.get("suite") or {}
    if not isinstance(suite, Mapping):
        raise ClothbenchError(f"setting 'suite' is {suite!r}; choose a suite with +suite=NAME")
    if unknown := sorted(set(suite) - SUITE_KEYS):
        raise ClothbenchError(f"setting 'suite.{unknown[0]}' is not known; there are: {', '.join(sorted(SUITE_KEYS))}")
    if suite.get("case", "fabric") not in CASES:
        raise ClothbenchError(f"setting 'suite.case' is {suite['case']!r}, expected one of {', '.join(CASES)}")
    effects = as_list(config, "effects")
    if twice := sorted({e for e in effects if effects.count(e) > 1}):
        raise ClothbenchError(f"setting 'effects': {twice[0]!r} is given twice; name every effect once")
    if int(config["budget"]) < 1:
        raise ClothbenchError(f"setting 'budget' is {config['budget']}, expected at least 1 evaluation")


def as_list(config: Mapping[str, Any], key: str) -> list[str]:
    value = config.get(key)
    values = [value] if isinstance(value, str) else list(value or [])
    if not values and key in PRODUCT:
        raise ClothbenchError(f"setting '{key}' is empty; name a plugin (see `clothbench plugins`)")
    return [str(v) for v in values]


def scene_settings(scene: Mapping[str, Any]) -> dict[str, Any]:
    allowed = ("areal_density", "air_density", "resolution")
    if unknown := sorted(set(scene) - set(allowed)):
        raise ClothbenchError(f"setting 'scene.{unknown[0]}' is not known; there are: {', '.join(allowed)}")
    out = {k: v for k, v in scene.items() if v is not None}
    if "resolution" in out:
        out["resolution"] = tuple(int(n) for n in out["resolution"])
    return out


def where(config: Mapping[str, Any], progress: Told | None = None) -> list[Path]:
    """The recording files a configuration means: `recording`, `recordings`, or those of the suite."""
    named = config.get("recording") or config.get("recordings") or (config.get("suite") or {}).get("recordings")
    if not named:
        raise ClothbenchError("no recordings named; choose +suite=NAME, or give recording=FILE or recordings=FOLDER")
    paths = [named] if isinstance(named, str) else list(named)
    return find_recordings(itertools.chain.from_iterable(resolve(p, config, progress) for p in paths))


def resolve(path: str, config: Mapping[str, Any], progress: Told | None = None) -> list[Path]:
    """ "builtin:NAME", "dataset:NAME" and "pkg://package/folder" become folders; everything else is a path."""
    if path.startswith("builtin:"):
        return [suites_folder() / "embedded" / path.removeprefix("builtin:")]
    if path.startswith("pkg://"):
        package, _, folder = path.removeprefix("pkg://").partition("/")
        return [Path(str(files(package).joinpath(folder)))]
    if path.startswith("dataset:"):
        from clothbench.datasets.convert import converted

        return [converted(path.removeprefix("dataset:"), data_dir=config.get("data_dir"), progress=progress)]
    return [Path(path)]


def read_all(paths: Iterable[Path]) -> list[Recording]:
    return [read_recording(path) for path in paths]


def group(recordings: Sequence[Recording], by: str, select: str | Sequence[str], seed: int) -> dict[str, list[Source]]:
    """Recordings by case, each with a fit split; `select` is a pattern, or several, that names must match."""
    patterns = [select] if isinstance(select, str) else list(select)
    chosen = [r for r in recordings if any(fnmatch.fnmatch(r.name, p) for p in patterns)]
    if not chosen:
        raise ClothbenchError(f"setting 'suite.select' {patterns} matches none of {len(recordings)} recordings")
    cases: dict[str, list[Source]] = {}
    for r in chosen:
        case = "all" if by == "all" else r.name if by == "recording" else getattr(r, by) or r.name
        cases.setdefault(case, []).append(Source(r.path, r.name, r.hash, r.split))
    out = {case: resplit(sources, seed) for case, sources in sorted(cases.items())}
    for case, sources in out.items():
        if not any(s.split == "fit" for s in sources):
            raise ClothbenchError(
                f"case {case!r}: found only held-out recordings, expected at least one to fit; see suite.select"
            )
        names = [s.name for s in sources]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise ClothbenchError(
                f"case {case!r}: two recordings are named {twice[0]!r}; names must differ within a case"
            )
    return out
