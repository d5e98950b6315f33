"""Where the recordings of a finished cell lie now: its key knows them by content, its paths may be of another day."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import Source
from clothbench.engine.suite import resolve, suites_folder
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.nodes import find_recordings


def lasting(sources: Sequence[Source]) -> tuple[Source, ...]:
    """The sources by paths that hold in every working directory."""
    return tuple(dataclasses.replace(s, path=str(Path(s.path).absolute())) for s in sources)


def hashes(names: Sequence[str]) -> dict[str, str]:
    """Where each recording lies that is named, or lies in a folder that is, by its hash; one that cannot be read is a
    ClothbenchError.
    """
    paths = [path for name in names for path in find_recordings(resolve(name, {}))]
    return {read_sheet(path).hash: str(path) for path in paths}


def found_again(
    sources: Sequence[Source], key: str, results: Path, named: Mapping[str, str], option: str
) -> tuple[Source, ...]:
    """The sources of a cell by the paths at which they lie now: where the user says, else where they lay, else where
    they lie beside the results folder as they did (a project that was moved), below the working directory, or among
    those that are shipped. Only the same content counts.

    named: where recordings lie that the user named, by hash; option: the word for that, for the message. Raises a
    ClothbenchError, one line, of the first that is nowhere.
    """
    return tuple(dataclasses.replace(s, path=_place_of(s, key, results, named, option)) for s in sources)


def _place_of(source: Source, key: str, results: Path, named: Mapping[str, str], option: str) -> str:
    if source.hash in named:
        return named[source.hash]
    for path in _candidates(Path(source.path), results.absolute()):
        if path.is_file() and _hash_of(path) == source.hash:
            return str(path)
    there = "another recording lies there now" if Path(source.path).is_file() else "it is not there any more"
    among = f", and is none of the {len(named)} named" if named else ""
    raise ClothbenchError(
        f"{source.path}: cell {key} was fitted to {source.name!r} here, and {there}{among}; say where it lies with "
        f"{option}"
    )


def _candidates(path: Path, results: Path) -> Iterator[Path]:
    """The path itself, then as much of its end as possible below each place, the nearest place first."""
    yield path
    parts = path.parts[1:] if path.is_absolute() else path.parts
    for place in (*results.parents, Path.cwd(), suites_folder()):
        for k in range(len(parts)):
            yield place.joinpath(*parts[k:])


def _hash_of(path: Path) -> str:
    """Of a file's content; "" of one that is no recording."""
    try:
        return str(read_sheet(path).hash)
    except (ClothbenchError, OSError):
        return ""
