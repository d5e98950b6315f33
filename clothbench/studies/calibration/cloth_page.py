"""The page's player: films of every case, as far as the page has room for them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clothbench.display.film import Film, read_film, recording_data, take_data
from clothbench.display.html import group
from clothbench.display.section import Section, json_text
from clothbench.display.templates import asset, rendered
from clothbench.engine.study import Results
from clothbench.studies.calibration.ranking import fitted_totals, way_of
from clothbench.studies.calibration.schema import FILMS
from clothbench.studies.calibration.words import case_name

Rows = Sequence[dict[str, Any]]
ROOM = 8_000_000  # characters of all films together, before they are packed: with the rest the page stays below 15 MB
FULL = 0.95  # of it


@dataclass
class Clips:
    """What the page holds: data by the id of their element, and who shows what by (suite, case), then by recording and
    metric: takes of fits by another metric have errors in its unit.
    """

    data: dict[str, Any] = field(default_factory=dict)
    known: dict[str, str] = field(default_factory=dict)
    cases: dict[tuple[str, str], dict[tuple[str, str], dict[str, Any]]] = field(default_factory=dict)
    size: int = 0
    left_out: int = 0


def clips_of(results: Results) -> Clips:
    """Films of all cells, as many as there is room for."""
    clips = Clips()
    for rows, word, path in in_turn(results):
        if clips.size > FULL * ROOM:  # hardly any film would find room: none of the others is read
            clips.left_out += 1
            continue
        film = read_film(path)
        takes = [take_data(take) for take in film.takes.values()]
        more = 0 if film.identity in clips.known else len(json_text(recording_data(film)))
        size = more + len(json_text(takes))
        if clips.size + size > ROOM:
            clips.left_out += 1
            continue
        clips.size += size
        _add(clips, rows, word, film, takes)
    return clips


def in_turn(results: Results) -> Iterator[tuple[Rows, str, Path]]:
    """(rows of a cell, what tells it from others of its case, its film): all films of the best cell of every case and
    metric that was minimised, the first ones before the second ones, then those of the second best.
    """
    cells = group(results.rows, lambda r: r["key"])
    cases = group(results.rows, lambda r: (r["suite"], r["case"], r["objective"]))
    rank = {key: n for mine in cases.values() for n, key in enumerate(
        sorted({r["key"] for r in mine}, key=lambda k: fitted_error(cells[k])))}  # fmt: skip
    files = {key: sorted((results.store.cell(key) / FILMS).glob("*.npz"), key=lambda p: int(p.stem)) for key in cells}
    order = [(n, rank[key], key) for key, mine in files.items() for n in range(len(mine))]
    names = {suite: way_of(mine) for suite, mine in group(results.rows, lambda r: r["suite"]).items()}
    for n, _, key in sorted(order, key=lambda one: (one[1], one[0], cells[one[2]][0]["case"])):
        first = cells[key][0]
        seed = f" · seed {first['seed']}" if first["seed"] else ""
        yield cells[key], names[first["suite"]](first) + seed, files[key][n]


def fitted_error(rows: Rows) -> float:
    """The error of a cell on what it was fitted to; cells without one come last."""
    totals = fitted_totals(rows)
    return float(totals[0]["value"]) if totals else float("inf")


def _add(clips: Clips, rows: Rows, word: str, film: Film, takes: list[dict[str, Any]]) -> None:
    """One cell's takes of one recording, beside those of other cells of its case by the same metric."""
    if film.identity not in clips.known:
        clips.known[film.identity] = f"film-{len(clips.known)}"
        clips.data[clips.known[film.identity]] = recording_data(film)
    case = clips.cases.setdefault((rows[0]["suite"], rows[0]["case"]), {})
    if (film.name, film.metric) not in case:
        name = f"takes-{sum(map(len, clips.cases.values()))}"
        case[film.name, film.metric] = {
            "name": film.name, "split": film.split, "recording": clips.known[film.identity], "takes": name,
            "metric": film.metric, "unit": film.unit, "floor": film.floor, "frames": len(film.time), "words": [],
        }  # fmt: skip
        clips.data[name] = []
    clip = case[film.name, film.metric]
    clip["words"] += [(take, word) for take in film.takes]
    clips.data[clip["takes"]] += takes


def told(words: Sequence[tuple[str, str]]) -> list[str]:
    """What takes are called: "fitted", and with their way where there are several ("fitted, mass_spring")."""
    several = len({way for _, way in words}) > 1
    return [f"{take}, {way}" if several else take for take, way in words]


def _clips_told(some: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Clips of one case as the player has them: named with their metric where a recording has those of several."""
    names = [clip["name"] for clip in some]
    return [
        {**clip, "name": f"{n} · {clip['metric']}" if names.count(n) > 1 else n, "words": told(clip["words"])}
        for clip, n in zip(some, names, strict=True)
    ]


def cloth_section(clips: Clips, rows: Rows) -> Section | None:
    """The player; None where nothing was filmed."""
    called = case_name(rows)
    if not clips.cases:
        return None
    index = [
        {"case": called(suite, case), "recordings": _clips_told(list(some.values()))}
        for (suite, case), some in sorted(clips.cases.items())
    ]
    html = rendered(Path(__file__).parent, "cloth.html", left_out=clips.left_out)
    scripts = "".join(asset(name) for name in ("sheet.js", "panes.js", "player.js"))
    return Section(html, {"films": index}, style=asset("player.css"), early=scripts, later=clips.data)
