"""`submission.json` as it is read: it comes from strangers, so every fault in it is one line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError, seen
from clothbench.core.files import read_json
from clothbench.engine.settings import LARGEST, is_number
from clothbench.studies.calibration.cell import CalibrationCell, asked_again
from clothbench.submissions.submission import FILE, SCHEMA, WHEEL, Asked, Entry, Submission, Wheel

KEY = re.compile(r"[0-9a-f]{16}")  # of a cell
TEXTS = ("suite", "case", "model", "optimizer", "metric", "tracker", "choice")  # of a question
WHOLE = {"seed": 0, "budget": 1}  # numbers of a question, with the least that each may be
MAPPINGS = ("options", "bounds", "scene", "versions", "fixed", "analysis", "published", "start", "finer")


def require_submission(folder: Path) -> Path:
    """A folder's `submission.json`; refuse a folder that has none."""
    path = folder / FILE
    if not path.is_file():
        raise ClothbenchError(f"{folder}: found no {FILE}; make one with `clothbench submit {folder} --name NAME`")
    return path


def read_submission(folder: Path) -> Submission:
    """What a folder's `submission.json` says; faults are one line."""
    path = require_submission(folder)
    stated = read_json(path, f"what `clothbench submit {folder}` writes")
    if not isinstance(stated, dict) or stated.get("schema") != SCHEMA:
        found = stated.get("schema") if isinstance(stated, dict) else type(stated).__name__
        raise ClothbenchError(f"{path}: schema is {found!r}, expected {SCHEMA}")
    texts: dict[str, Any] = {key: stated.get(key) for key in ("name", "by", "about", "suite", "clothbench")}
    for key, value in texts.items():
        if not isinstance(value, str) or (key in ("name", "suite") and not value.strip()):
            raise ClothbenchError(f"{path}: {key} is {value!r}, expected text")
        texts[key] = seen(value)
    entries = stated.get("entries")
    if not isinstance(entries, list) or not entries:
        raise ClothbenchError(f"{path}: entries is {entries!r}, expected a list of simulated recordings")
    return Submission(
        entries=tuple(_entry(path, k, one) for k, one in enumerate(entries)),
        cells=tuple(Asked(**one) for one in _listed(path, stated, "cells", ("key", "question"))),
        wheels=tuple(_wheel(path, one) for one in _listed(path, stated, "wheels", ("file", "sha256"))),
        **texts,
    )


def _listed(path: Path, stated: dict[str, Any], name: str, keys: tuple[str, ...]) -> list[dict[str, str]]:
    """The mappings in a list that a submission may lack, each with a text for every key."""
    found = stated.get(name, [])
    if not isinstance(found, list):
        raise ClothbenchError(f"{path}: {name} is {found!r}, expected a list")
    for number, one in enumerate(found):
        for key in keys:
            value = one.get(key) if isinstance(one, dict) else None
            if not isinstance(value, str) or not value:
                raise ClothbenchError(f"{path}: {name}[{number}].{key} is {value!r}, expected text")
    return [{key: one[key] for key in keys} for one in found]


def _wheel(path: Path, stated: dict[str, str]) -> Wheel:
    require_inside(path, "wheels.file", stated["file"])
    if not WHEEL.fullmatch(Path(stated["file"]).name):
        raise ClothbenchError(
            f"{path}: wheels.file is {stated['file']!r}, expected the name of a wheel (.whl) with no signs but _.+!-"
        )
    return Wheel(**stated)


def require_inside(where: object, name: str, file: str) -> None:
    """Refuse a path that leads out of the submission's folder."""
    if Path(file).is_absolute() or ".." in Path(file).parts:
        raise ClothbenchError(f"{where}: {name} is {file!r}, expected a path inside the submission's folder")


def _entry(path: Path, number: int, stated: Any) -> Entry:
    where = f"{path}: entries[{number}]"
    if not isinstance(stated, dict):
        raise ClothbenchError(f"{where} is {stated!r}, expected a mapping")
    texts: dict[str, Any] = {key: stated.get(key) for key in ("recording", "recording_hash", "file", "sha256")}
    for key, value in texts.items():
        if not isinstance(value, str) or not value:
            raise ClothbenchError(f"{where}.{key} is {value!r}, expected text")
    require_inside(where, "file", texts["file"])
    scores = stated.get("scores")
    if not isinstance(scores, dict) or not scores or not all(is_number(value) for value in scores.values()):
        raise ClothbenchError(f"{where}.scores is {scores!r}, expected numbers by metric")
    cell = stated.get("cell", "")
    if not isinstance(cell, str):
        raise ClothbenchError(f"{where}.cell is {cell!r}, expected the key of one of the cells, or none")
    return Entry(cell=cell, scores={str(metric): float(value) for metric, value in scores.items()}, **texts)


def questions_of(folder: Path, submission: Submission) -> tuple[dict[str, CalibrationCell], list[str]]:
    """The fits that are handed in, by key, and a fault for each that is no question of a calibration."""
    found, faults = dict[str, CalibrationCell](), list[str]()
    for told in submission.cells:
        # Nothing else: a verdict keeps what else can fail than a fit under words, which no fit is to be called.
        if not KEY.fullmatch(told.key):
            faults.append(f"{folder / FILE}: cells: key is {told.key!r}, expected 16 hexadecimal digits")
            continue
        where = f"{folder / FILE}: cell {told.key}"
        if told.key in found:
            faults.append(f"{where} is there twice, expected every fit once")
            continue
        try:
            found[told.key] = asked_again(told.question)
            _require_plain(found[told.key])
        except (ClothbenchError, OverflowError) as fault:
            faults.append(f"{where}: {fault}")
    return found, faults


def _require_plain(cell: CalibrationCell) -> None:
    """Refuse what has another type than a calibration's: data classes take whatever they are given."""

    def require(name: str, value: object, kept: bool, expected: str) -> None:
        if not kept:
            raise ClothbenchError(f"the question's {name} is {value!r}, expected {expected}")

    for name in TEXTS:
        require(name, getattr(cell, name), _is_text(getattr(cell, name)), "text")
    for name in ("effects", "report"):
        require(name, getattr(cell, name), all(map(_is_text, getattr(cell, name))), "a list of names")
    for name, least in WHOLE.items():
        value = getattr(cell, name)
        require(name, value, type(value) is int and least <= value <= LARGEST, f"a whole number from {least} on")
    require("timeout", cell.timeout, cell.timeout is None or is_number(cell.timeout), "seconds or null")
    for name in MAPPINGS:
        require(name, getattr(cell, name), isinstance(getattr(cell, name), Mapping), "a mapping")
    for name in ("fixed", "start", "finer"):
        require(name, getattr(cell, name), all(map(is_number, getattr(cell, name).values())), "numbers by name")
    pairs = [end for pair in cell.bounds.values() for end in pair]
    require("bounds", cell.bounds, all(map(is_number, pairs)), "pairs of numbers by name")
    require("versions", cell.versions, all(map(_is_text, cell.versions.values())), "texts by name")
    for name in ("options", "analysis", "published"):
        inner = getattr(cell, name).values()
        require(name, getattr(cell, name), all(isinstance(one, Mapping) for one in inner), "mappings by name")
    for source in (*cell.recordings, *cell.rivals):
        texts = (source.path, source.name, source.hash, source.split)
        require("recordings", source, all(map(_is_text, texts)), "texts")


def _is_text(value: object) -> bool:
    return isinstance(value, str) and seen(value) == value
