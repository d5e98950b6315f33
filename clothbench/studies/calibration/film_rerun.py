"""A Rerun file of a cell's films: what was recorded beside what parameter sets make of it, without a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from clothbench.display.film import ACROSS, Film, read_film
from clothbench.display.rerun import NOISE, log_curve, log_seen, log_sheet, typical_distance


def write_film_rerun(path: Path, key: str, files: Sequence[Path]) -> Path:
    """Write all films of a cell, each below SPLIT/NAME, on the timeline `time` [s] of its own clock."""
    films = [read_film(file) for file in files]
    roots = [rr.new_entity_path([film.split, film.name]) for film in films]
    stream = rr.RecordingStream(f"clothbench-{key}", recording_id=key, send_properties=False)
    stream.save(path, default_blueprint=blueprint(roots, films))
    try:
        for root, film in zip(roots, films, strict=True):
            log_film(stream, root, film)
    finally:
        stream.disconnect()
    return path


def blueprint(roots: Sequence[str], films: Sequence[Film]) -> Any:
    """A tab for each film: the first parameter set in space beside the pictures, errors below."""
    tabs = []
    for root, film in zip(roots, films, strict=True):
        name, shown = f"{film.name} ({film.split.replace('_', ' ')})", next(iter(film.takes))
        views: list[Any] = [rrb.Spatial3DView(origin=root, contents=["$origin/seen/**", f"$origin/{entity(shown)}/**"],
                                              name=shown)]  # fmt: skip
        if film.picture:
            views.append(rrb.Spatial2DView(origin=f"{root}/picture", name="filmed"))
        curves = rrb.TimeSeriesView(origin=f"{root}/error", name=f"{film.metric} [{film.unit}]")
        tabs.append(rrb.Vertical(rrb.Horizontal(*views), curves, row_shares=[3, 1], name=name))
    return rrb.Blueprint(rrb.Tabs(*tabs), rrb.TimePanel(state="collapsed"), collapse_panels=True)


def entity(word: str) -> str:
    return word.replace(" ", "_")


def log_film(stream: Any, root: str, film: Film) -> None:
    """Points as seen, the sheet of every parameter set, its error, and the pictures."""
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    visible = np.isfinite(film.seen).all(axis=-1)
    log_seen(stream, f"{root}/seen", film.time, film.seen, visible, 0.12 * typical_distance(film.material))
    for word, take in film.takes.items():
        there = np.isfinite(take.position).all(axis=(1, 2))
        log_sheet(stream, f"{root}/{entity(word)}", film.time[there], take.position[there], film.material)
        known = np.isfinite(take.error)
        log_curve(stream, f"{root}/error/{entity(word)}", film.time[known], take.error[known], word)
    if film.floor:
        log_curve(stream, f"{root}/error/floor", film.time[[0, -1]], np.full(2, film.floor), "noise floor", NOISE)
    for time, picture in zip(film.time, pictures(film), strict=False):
        stream.set_time("time", duration=float(time))
        stream.log(f"{root}/picture", rr.Image(picture).compress())


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
