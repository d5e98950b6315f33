"""The suite: settings that become the cells of a study; and where suites and recordings lie."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError, known_names
from clothbench.core.progress import FileProgress
from clothbench.engine.settings import checked, words
from clothbench.engine.study import Cell, Study, refuse_unsound
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import find_recordings


def suites_folder() -> Path:
    """Where the built-in suites lie: inside the installed package, or beside it in a checkout."""
    inside = Path(__file__).parents[1] / "suites"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "suites"


def plan(config: Mapping[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[Cell]:
    """Every cell of a resolved configuration. Reads and checks all recordings first: nothing is begun on bad input.

    `progress(done, planned, file)` is told while a public data set is fetched or converted.
    """
    name = config.get("study")
    if not isinstance(name, str):
        raise ClothbenchError(f"setting 'study' is {name!r}, expected one of {', '.join(plugins.names('studies'))}")
    study: Study = plugins.load("studies", name)
    settings = checked(config, plugins, study.suite_words)
    refuse_unsound(study, settings)
    planned = study.plan(settings, plugins, progress)
    return list({cell.key: cell for cell in planned}.values())  # what is asked for twice is run once


def where(config: Mapping[str, Any], progress: FileProgress | None = None) -> list[Path]:
    """The recording files a configuration means: `recording`, `recordings`, or those of the suite."""
    paths = config["recording"] or config["recordings"] or words("suite.recordings", config["suite"].get("recordings"))
    if not paths:
        raise ClothbenchError("no recordings named; choose +suite=NAME, or give recording=FILE or recordings=FOLDER")
    return find_recordings(itertools.chain.from_iterable(resolve(p, config, progress) for p in paths))


def resolve(path: str, config: Mapping[str, Any], progress: FileProgress | None = None) -> list[Path]:
    """ "builtin:NAME", "dataset:NAME" and "pkg://package/folder" become folders; everything else is a path."""
    if path.startswith("builtin:"):
        embedded, name = suites_folder() / "embedded", path.removeprefix("builtin:")
        there = sorted(folder.name for folder in embedded.iterdir())
        if name.partition("/")[0] not in there:
            raise ClothbenchError(f"recordings {path!r}: found nothing of that name; {known_names(name, there)}")
        return [embedded / name]
    if path.startswith("pkg://"):
        return [_in_package(path)]
    if path.startswith("dataset:"):
        from clothbench.datasets.convert import converted

        return [converted(path.removeprefix("dataset:"), data_dir=config.get("data_dir"), progress=progress)]
    return [Path(path)]


def _in_package(path: str) -> Path:
    """The folder of "pkg://package/folder", found without importing the package: a suite of a stranger's may name any,
    and a suite runs no code.
    """
    package, _, folder = path.removeprefix("pkg://").partition("/")
    top, *inside = package.split(".")
    try:
        spec = find_spec(top)
    except (ImportError, ValueError) as fault:  # of what can be no name of a package
        raise ClothbenchError(f"recordings {path!r}: {fault}; install the package that has them") from fault
    places = [Path(place, *inside) for place in (spec and spec.submodule_search_locations) or ()]
    if not (there := [place for place in places if place.is_dir()]):
        raise ClothbenchError(f"recordings {path!r}: found no package {package!r}; install the package that has them")
    return next((place / folder for place in there if (place / folder).exists()), there[0] / folder)
