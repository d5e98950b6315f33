"""Lead cloth along a folding path: the path computed or drawn, a strip at rest at every place or a sheet in motion."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.folding import FoldPath, FoldsOver, geometric_path
from clothbench.core.optional import FoldsStrips, KnowsMaterials, RefusesScenes, absent
from clothbench.core.protocols import Model
from clothbench.engine.cells import Skipped
from clothbench.engine.rows import about_cell, failure, no_value
from clothbench.engine.study import Context, Result
from clothbench.studies.fold_path.cell import FoldPathCell
from clothbench.studies.fold_path.sheet import Landed, landed, material, scene

STEPS, GROWTH = 48, 1.1  # of a geometric path, equal ones; each of the shorter ones at its start over that before it
POINTS, SHAPES = 81, 12  # points of a shape that is kept, and how many shapes


def run(cell: FoldPathCell, context: Context) -> Result:
    """One path with one model; where nothing comes to rest on the way it is diverged, with the reason."""
    began, plugins = time.perf_counter(), context.plugins
    models: dict[str, Model] = {n: plugins.make("models", n, **cell.option(n)) for _, n in cell.uses}
    for name, made in models.items():
        if reason := absent(plugins.load("models", name)):
            raise Skipped(f"{made.name}: {reason}")
    planner, model = models[cell.path.planner], models[cell.model]
    if "fold" not in model.capabilities:
        require_sheet(cell, model)
    about = about_cell(cell) | no_value() | {"status": "ok", "reason": "", "evaluations": 1}
    try:
        path = strip_of(planner, cell).fold(parameters(planner, cell)) if cell.way == "computed" else None
        places = geometric(cell) if path is None else path.places
        if "fold" in model.capabilities:
            strip, theta = strip_of(model, cell), parameters(model, cell)
            followed = strip.follow(places, theta, cell.path.friction)
            slips = followed.needed.max() > cell.path.friction
            # Once it slips, each step begins where the desk just holds, and tells of little more than the desk has.
            held = strip.follow(places, theta, np.inf) if slips else followed
            tables = of_strip(cell, about, path, followed, held.needed)
        else:
            tables = of_sheet(cell, about, path, places, led_sheet(cell, model, places))
    except ClothbenchError as error:
        return failure(cell, "diverged", str(error), 1, time.perf_counter() - began)
    for row in tables["rows"]:
        row["wall_s"] = time.perf_counter() - began
    context.progress(1, tables["rows"][0]["value"])
    return Result("ok", tables)


def geometric(cell: FoldPathCell) -> np.ndarray:
    """Places (P, 2) m of a geometric path from the lift's height on.

    What a strip takes changes with the height over the flat cloth, so that the steps grow with it, until they are as
    long as all others. Twice as many change friction and landing by less than 1 %.
    """
    name, length, lift = cell.way, cell.path.length, cell.path.lift
    low = [np.arcsin(2 * lift / length) / np.pi if name == "circular" else lift / length]
    while low[-1] * (GROWTH - 1) < 1 / STEPS:
        low.append(GROWTH * low[-1])
    high = np.linspace(0.0, 1.0, STEPS + 1)
    return geometric_path(name, length, np.concatenate([low, high[high > low[-1]]]))


def strip_of(model: Model, cell: FoldPathCell) -> FoldsOver:
    strip: Any = model.strip(cell.path.length) if isinstance(model, FoldsStrips) else None
    if not isinstance(strip, FoldsOver):
        raise Skipped(f"model {model.name!r} folds no strip all the way over")
    return strip


def parameters(model: Model, cell: FoldPathCell) -> np.ndarray:
    """The model's defaults (P,), with the fabric's η_b."""
    names = model.parameters.names
    if "eta_b" not in names:
        raise Skipped(f"model {model.name!r} has no parameter eta_b")
    return np.where(np.array(names) == "eta_b", cell.eta_b, model.parameters.defaults)


def require_sheet(cell: FoldPathCell, model: Model) -> None:
    """A model of sheets has to keep off the desk, and to begin where the sheet lies."""
    for needed in ("contact", "moving_start", *(["self_contact"] if cell.path.thickness else [])):
        if needed not in model.capabilities:
            raise Skipped(f"the model does not say {needed!r}")
    if not isinstance(model, KnowsMaterials):
        raise Skipped("the model says no parameters for a material")


def led_sheet(cell: FoldPathCell, model: Any, places: np.ndarray) -> Landed:
    """What becomes of its sheet; a model that has no such material, or does not take the scene, is skipped."""
    world = scene(cell, places)
    if isinstance(model, RefusesScenes) and (reason := model.skip(world)):
        raise Skipped(reason)
    try:
        simulation, theta = model.prepare(world), model.of_material(material(cell), world)
    except ClothbenchError as fault:
        raise Skipped(str(fault)) from fault
    rollout = simulation.run(theta[None])
    if rollout.status[0] != "ok":
        raise ClothbenchError(f"{model.name}: {rollout.status[0]} on the way")
    return landed(cell, rollout)


def of_strip(
    cell: FoldPathCell, about: dict[str, Any], path: FoldPath | None, followed: FoldPath, takes: np.ndarray
) -> dict[str, Any]:
    """Tables of a strip; takes: (P,), the friction of each place on a desk that holds."""
    slip, needed = float(followed.origin[-1]), float(takes.max())
    error = float(followed.places[-1, 0]) - slip
    rows = [_row(about, "landing_error", "mm", 1e3 * error, 0.0), _row(about, "slip", "mm", 1e3 * slip, 0.0),
            _row(about, "friction", "1", needed, cell.path.friction)]  # fmt: skip
    moved = np.ptp(np.concatenate([[0.0], followed.origin]))
    rows[2]["reason"] = f"slips by up to {1e3 * moved:.3g} mm" if needed > cell.path.friction else ""
    phases = followed.phase if path is None else path.phase
    steps = [
        {**_about(cell), "phase": int(phases[n]), "step": n + 1, "x": float(pose[0]), "z": float(pose[1]),
         "slope": float(pose[2]), "needed": float(takes[n]), "slip": float(followed.origin[n])}
        for n, pose in enumerate(followed.state.pose)
    ]  # fmt: skip
    profiles = followed.state.profile
    chosen = np.unique(np.linspace(0, len(profiles) - 1, SHAPES).round().astype(int))
    points = np.linspace(0, profiles.shape[1] - 1, POINTS).round().astype(int)
    return {"rows": rows, "fold_path": steps, "fold_shapes": _shapes(cell, profiles[np.ix_(chosen, points)])}


def of_sheet(
    cell: FoldPathCell, about: dict[str, Any], path: FoldPath | None, places: np.ndarray, found: Landed
) -> dict[str, Any]:
    told = (("landing_error", found.error), ("slip", found.slip), ("edge_spread", found.spread))
    rows = [_row(about, name, "mm", 1e3 * value, 0.0) for name, value in told]
    phases = np.zeros(len(places), int) if path is None else path.phase
    steps = [
        {**_about(cell), "phase": int(phases[n]), "step": n + 1, "x": float(x), "z": float(z),
         "slope": None, "needed": None, "slip": None}
        for n, (x, z) in enumerate(places)
    ]  # fmt: skip
    return {"rows": rows, "fold_path": steps, "fold_shapes": _shapes(cell, found.lines)}


def _about(cell: FoldPathCell) -> dict[str, Any]:
    return {"case": cell.case, "fabric": cell.fabric, "way": cell.way, "model": cell.model, "key": cell.key}


def _row(about: dict[str, Any], metric: str, unit: str, value: float, reference: float) -> dict[str, Any]:
    return {**about, "metric": metric, "unit": unit, "value": value, "reference": reference}


def _shapes(cell: FoldPathCell, lines: np.ndarray) -> list[dict[str, Any]]:
    """Rows of the points of some shapes (S, M, 2) m."""
    return [{**_about(cell), "frame": n, "x": float(x), "z": float(z)} for n, line in enumerate(lines) for x, z in line]
