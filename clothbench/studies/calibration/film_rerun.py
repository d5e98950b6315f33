"""Rerun files of a cell's films: what was recorded beside what parameter sets make of it, without a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from clothbench.core.files import file_name, whole_file
from clothbench.display.film import ACROSS, Film, Take, read_film
from clothbench.display.names import cell_name
from clothbench.display.plotly import COLOURS, GREY, VIRIDIS
from clothbench.display.rerun import log_curve, log_seen, log_sheet, nearest, typical_distance
from clothbench.engine.store import Store
from clothbench.studies.calibration.cloth import FITTED, START, TRUTH
from clothbench.studies.calibration.ranking import fitted_totals
from clothbench.studies.calibration.schema import FILMS

BEST = "rerun"  # folder of a store with a file for the best fit of each case
TAKE_COLOURS = {FITTED: COLOURS[0], START: COLOURS[1], TRUTH: COLOURS[2]}  # of sheets and of their curves
Rows = Sequence[dict[str, Any]]


def write_best(store: Store, keys: Sequence[str]) -> list[Path]:
    """Write RUNS/rerun/CASE-KEY.rrd for the best fit of each case of these cells; those it has already are kept.

    Best is the least mean error on what was fitted, by the metric that was minimised; a case that was fitted by several
    has a file for each of them. Returns the files.
    """
    rows, out = store.rows(), []
    known = {(row["key"][:8], (row["suite"], row["case"], row["objective"])) for row in rows}
    for (suite, case, metric), row in best_rows(rows, keys).items():
        films = sorted((store.cell(row["key"]) / FILMS).glob("*.npz"))
        if not films:
            continue
        name = f"{file_name(f'{suite} {case}')}-{row['key'][:8]}.rrd"
        path = store.folder / BEST / name
        if not path.is_file():
            with whole_file(path) as part:
                write_film_rerun(part, store, row["key"], films)
            for old in path.parent.glob(f"{name[:-12]}????????.rrd"):  # of another fit, which was the best until now
                fits = {what for key, what in known if key == old.stem[-8:]}  # other cases may have the same file name
                if old != path and (not fits or (suite, case, metric) in fits):
                    old.unlink()
        out.append(path)
    return out


def best_rows(rows: Rows, keys: Sequence[str]) -> dict[tuple[str, str, str], dict[str, Any]]:
    """The best row of each (suite, case, metric that was minimised) among those of some cells, over all recordings that
    were fitted together: errors by several metrics cannot be compared.
    """
    out: dict[tuple[str, str, str], dict[str, Any]] = {}
    known = set(keys)
    for row in fitted_totals([r for r in rows if r["key"] in known]):
        out.setdefault((row["suite"], row["case"], row["objective"]), row)
    return out


def write_film_rerun(path: Path, store: Store, key: str, files: Sequence[Path]) -> Path:
    """Write all films of a cell, each below SPLIT/NAME, on the timeline `time` [s] of its own clock, which plays at
    once and over and over; below `about` what the cell came to, in words.
    """
    films = [read_film(file) for file in files]
    roots = [rr.new_entity_path([film.split, film.name]) for film in films]
    rows = store.rows((key,))
    # The viewer remembers layouts by application: one of its own keeps the tabs of other cells out.
    stream = rr.RecordingStream(f"clothbench-{key}", recording_id=key, send_properties=False)
    stream.save(path, default_blueprint=blueprint(roots, films))
    try:
        stream.send_recording_name(cell_name(rows[0]) if rows else key)
        told = rr.TextDocument(about(rows, store.table("parameters", (key,))), media_type=rr.MediaType.MARKDOWN)
        stream.log("about", told, static=True)
        for root, film in zip(roots, films, strict=True):
            log_film(stream, root, film)
    finally:
        stream.disconnect()
    return path


def blueprint(roots: Sequence[str], films: Sequence[Film]) -> Any:
    """A tab for each film: the pictures, all sheets in the colours of their curves, and the fit coloured by its error;
    below them the curves beside what the cell came to.
    """
    tabs = []
    for root, film in zip(roots, films, strict=True):
        name = f"{film.name} ({film.split.replace('_', ' ')})"
        views: list[Any] = [rrb.Spatial2DView(origin=f"{root}/picture", name="filmed")] if film.picture else []
        sheets = ["$origin/seen/**", *(f"$origin/{entity(word)}/**" for word in film.takes)]
        views.append(rrb.Spatial3DView(origin=root, contents=sheets, name=", ".join(film.takes)))
        if not film.flat:
            said = f"off by, to {1e3 * most_off(film):.3g} mm (yellow)"
            views.append(rrb.Spatial3DView(origin=root, contents=["$origin/off/**"], name=said))
        curves = rrb.TimeSeriesView(origin=f"{root}/error", name=f"{film.metric} [{film.unit}]")
        below = rrb.Horizontal(curves, rrb.TextDocumentView(origin="/about", name="verdict"), column_shares=[3, 2])
        tabs.append(rrb.Vertical(rrb.Horizontal(*views), below, row_shares=[3, 2], name=name))
    playing = rrb.TimePanel(state="collapsed", timeline="time", play_state="playing", loop_mode="all")
    return rrb.Blueprint(rrb.Tabs(*tabs), playing, collapse_panels=True)


def about(rows: Rows, parameters: Rows) -> str:
    """What a cell came to, in Markdown: errors with intervals beside the noise, and its parameters."""
    if not rows:
        return ""
    out = [f"# {cell_name(dict(rows[0]))}", "| recordings | error | 95 % | noise alone |", "|---|---|---|---|"]
    for row in rows:
        if row["value"] is not None and row["metric"] == row["objective"]:
            what = row["recording"] or f"all {'fitted' if row['split'] == 'fit' else 'held out'}"
            noise = "" if row["floor"] is None else f"{row['floor']:.3g}"
            out.append(f"| {what} | {row['value']:.3g} {row['unit']} | {between(row)} | {noise} |")
    out += ["", "| parameter | value | 95 % | true |", "|---|---|---|---|"]
    for p in parameters:
        if p["value"] is not None:
            true = "" if p["truth"] is None else f"{p['truth']:.3g}"
            unit = "" if p["unit"] == "1" else f" {p['unit']}"
            out.append(f"| {p['symbol']} ({p['name']}) | {p['value']:.3g}{unit} | {between(p)} | {true} |")
    return "\n".join(out)


def between(row: Mapping[str, Any]) -> str:
    return "" if row["low"] is None or row["high"] is None else f"{row['low']:.3g} … {row['high']:.3g}"


def entity(word: str) -> str:
    return word.replace(" ", "_")


def log_film(stream: Any, root: str, film: Film) -> None:
    """Points as seen, the sheet of every parameter set, how far the first is off, errors, and the pictures."""
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    visible = np.isfinite(film.seen).all(axis=-1)
    log_seen(stream, f"{root}/seen", film.time, film.seen, visible, 0.08 * typical_distance(film.material))
    for word, take in film.takes.items():
        colour, there = colour_of(word), np.isfinite(take.position).all(axis=(1, 2))
        log_sheet(stream, f"{root}/{entity(word)}", film.time[there], take.position[there], film.material, colour)
        known = np.isfinite(take.error)
        log_curve(stream, f"{root}/error/{entity(word)}", film.time[known], take.error[known], word, colour)
    if film.floor:
        noise = np.full(2, film.floor)
        log_curve(stream, f"{root}/error/noise", film.time[[0, -1]], noise, "noise alone", rgb(GREY))
    if not film.flat:
        log_off(stream, f"{root}/off", film)
    for time, picture in zip(film.time, pictures(film), strict=False):
        stream.set_time("time", duration=float(time))
        stream.log(f"{root}/picture", rr.Image(picture).compress())


def log_off(stream: Any, path: str, film: Film) -> None:
    """The sheet of the first parameter set, each point in the colour of how far it is from where it was seen."""
    take = first_take(film)
    there = np.isfinite(take.position).all(axis=(1, 2))
    share = np.nan_to_num(off(film) / max(most_off(film), 1e-12))
    at = np.linspace(0, 1, len(VIRIDIS))
    colours = np.stack([np.interp(share, at, channel) for channel in np.array([rgb(c) for c in VIRIDIS]).T], axis=-1)
    log_sheet(stream, path, film.time[there], take.position[there], film.material, colours[there].astype(np.uint8))


def off(film: Film) -> np.ndarray:
    """(F, N) m from where points were seen to where the first parameter set has them, or in a cloud to the nearest that
    was seen; NaN where nothing tells.
    """
    if film.cloud:
        return nearest(first_take(film).position, film.seen)
    return np.asarray(np.linalg.norm(first_take(film).position - film.seen, axis=-1))


def most_off(film: Film) -> float:
    """m, which all but one in fifty points stay within."""
    far = off(film)
    known = far[np.isfinite(far)]
    return float(np.quantile(known, 0.98)) if known.size else 0.0


def first_take(film: Film) -> Take:
    return next(iter(film.takes.values()))


def colour_of(word: str) -> tuple[int, ...]:
    return rgb(TAKE_COLOURS.get(word, COLOURS[3]))


def rgb(colour: str) -> tuple[int, ...]:
    """ "#0077bb" → (0, 119, 187)"""
    return tuple(bytes.fromhex(colour.removeprefix("#")))


def pictures(film: Film) -> list[np.ndarray]:
    """Frames (H, W, 3) of a film, red first; none where nothing was filmed."""
    import cv2

    if not film.picture:
        return []
    read = cv2.imdecode(np.frombuffer(film.picture, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    sheet = cv2.cvtColor(read, cv2.COLOR_BGR2RGB)
    (width, height), across = film.size, min(ACROSS, len(film.time))
    corners = [(height * (n // across), width * (n % across)) for n in range(len(film.time))]
    return [sheet[y : y + height, x : x + width] for y, x in corners]
