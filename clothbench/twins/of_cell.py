"""The twin of a calibration's cell: its best parameters as a textbook material, in the scene of what was fitted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import SaysMaterials
from clothbench.core.protocols import Material, Simulation
from clothbench.core.scene import Scene
from clothbench.core.twin import Twin
from clothbench.engine.run import TRACKED
from clothbench.engine.store import Store
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.scenes import scenes_of
from clothbench.studies.calibration.cell import Bench, CalibrationCell, asked_and_fitted, set_up
from clothbench.studies.calibration.estimates import FAR, WIDE, Estimate, estimates
from clothbench.studies.calibration.moved import found_again


@dataclass(frozen=True, eq=False)
class FittedCell:
    """A finished cell with its model made and its first fitted recording read. values: of all parameters, by name."""

    store: Store
    cell: CalibrationCell
    model: Any
    fitted: list[dict[str, Any]]
    bench: Bench
    scene: Scene

    @classmethod
    def of(cls, out: Path, key: str, named: Mapping[str, str] = MappingProxyType({})) -> FittedCell:
        """Raises a ClothbenchError, one line, where there is no fit, or its recording has gone, or the model does not
        say which material its parameters make. named: where recordings lie that have moved, by hash.
        """
        store, plugins = Store(out), catalogue()
        cell, fitted = asked_and_fitted(store, key)
        model = plugins.make("models", cell.model, **cell.option(cell.model))
        if not isinstance(model, SaysMaterials):
            raise ClothbenchError(
                f"cell {key}: model {cell.model!r} does not say which material its parameters make (no material_of), "
                "so that no other simulator can be told; fit a model that does"
            )
        first = next(s for s in cell.recordings if s.split == "fit")
        here = found_again([first], key, out, named, "--recordings PATH")
        bench = set_up(dataclasses.replace(cell, recordings=here, rivals=()), plugins, out / TRACKED)
        return cls(store, cell, model, fitted, bench, scenes_of(bench.recordings[0], **cell.judged)[0])

    @property
    def values(self) -> dict[str, float]:
        return {**self.cell.fixed, **{row["name"]: row["value"] for row in self.fitted}}


def twin_of_cell(fit: FittedCell) -> Twin:
    """Material, grips and intervals of a fit."""
    model, values, scene = fit.model, fit.values, fit.scene
    best = _theta(model, values)
    material = model.material_of(best, scene)
    used = {name for name in model.parameters.names if _matters(model, best, name, scene)}
    effects = [catalogue().make("effects", name) for name in fit.cell.effects]
    spaces = (model.parameters, *(effect.parameters.prefixed(effect.name) for effect in effects))
    # What was held has no row of its own.
    units = {p.name: p.unit for space in spaces for p in space} | {row["name"]: row["unit"] for row in fit.fitted}
    others = {
        name: (float(value), units.get(name, "unit not known"))
        for name, value in values.items()
        if name not in used and (name in model.parameters.names or name.partition(".")[0] in fit.cell.effects)
    }
    found = estimates(fit.fitted)
    inside = _moved(fit, material, found, [(e.low, e.high) for e in found])
    spread = {name: _together(getattr(material, name), *ends) for name, ends in _by_quantity(inside).items()}
    for e in found:
        if e.name in others and e.low is not None and e.high is not None:
            spread[e.name] = (e.low, e.high)
    determined = {e.name: e.determined for e in found if e.name in others} | _determined(fit, material, found)
    name = f"{fit.cell.case}, fitted by {fit.cell.model}"
    origin, (nulls, places) = _origin(fit), _nulls(fit)
    return Twin(
        name, scene, material, spread, "95 % interval of the fit", others, origin, determined, nulls, places
    )  # fmt: skip


def _nulls(fit: FittedCell) -> tuple[dict[str, float], dict[str, str]]:
    """Of the parameters that are no material, by name, the values at which they do nothing, and of effects' the place.
    One that has no such value of its own does nothing where its effect's others do: then it is as it is.
    """
    nulls = {p.name: p.null for p in fit.model.parameters if p.null is not None}
    places = {}
    for effect in (catalogue().make("effects", name) for name in fit.cell.effects):
        own = {f"{effect.name}.{p.name}": p.null for p in effect.parameters}
        places.update(dict.fromkeys(own, effect.place))
        amounts = {name: null for name, null in own.items() if null is not None}
        off = amounts and all(fit.values.get(name) == null for name, null in amounts.items())
        nulls |= amounts | ({name: fit.values[name] for name in own if name in fit.values} if off else {})
    return nulls, places


def brought(fit: FittedCell, material: Material) -> float:
    """How far the model's own sheet goes astray [m], as a mean over points and times of the first fitted recording, if
    it has no more than this material: what leaving out the rest brings. Sensor, grips and what is around stay as
    fitted. Raises a ClothbenchError, one line, where the model cannot be told the material or not simulate it.
    """
    simulation, values = fit.bench.trials[0].simulation, fit.values
    best = _free(simulation, values)
    try:
        own = fit.model.of_material(material, fit.scene)
    except ClothbenchError:  # that has no bending of its own
        own = fit.model.of_material(dataclasses.replace(material, bending=0.0), fit.scene)
    less = {**values, **dict(zip(fit.model.parameters.names, own.tolist(), strict=True))}
    for name in fit.cell.effects:
        effect = catalogue().make("effects", name)
        if effect.place == "dynamics":
            less |= {f"{name}.{p.name}": p.null for p in effect.parameters if p.null is not None}
    held = {**dict(fit.cell.fixed), **less}
    whole = getattr(simulation, "simulation", simulation)  # with nothing held
    runs = {"the fit": simulation.run(best[None]), "the cloth of the file": whole.run(_free(whole, held)[None])}
    for what, rollout in runs.items():
        if rollout.status[0] != "ok":
            why = rollout.reasons[0] if rollout.reasons else rollout.status[0]
            raise ClothbenchError(f"{what} could not be simulated ({why})")
    one, other = (rollout.position[0] for rollout in runs.values())
    return float(np.nanmean(np.linalg.norm(one - other, axis=-1)))


def _free(simulation: Simulation, values: Mapping[str, float]) -> np.ndarray:
    return np.array([values.get(p.name, p.default) for p in simulation.parameters])


def _theta(model: Any, values: Mapping[str, float]) -> np.ndarray:
    """The model's parameters (P,); one that only a changed table can have is refused."""
    theta = np.array([values.get(p.name, p.default) for p in model.parameters])
    for parameter, value in zip(model.parameters, theta, strict=True):
        if parameter.scale == "log" and not value > 0:
            raise ClothbenchError(
                f"parameter {parameter.name}: found {value:g}, expected more than 0 {parameter.unit}, as a material "
                "has it; this fit holds it there, or its bounds begin there: run it with others"
            )
    return theta


def _matters(model: Any, theta: np.ndarray, name: str, scene: Scene) -> bool:
    """Whether the material depends on a parameter."""
    changed = theta.copy()
    k = model.parameters.names.index(name)
    changed[k] = 1.01 * theta[k] if theta[k] else 1e-6
    return model.material_of(changed, scene) != model.material_of(theta, scene)


Ends = tuple[float, float]


def _moved(
    fit: FittedCell, best: Material, found: Sequence[Estimate], ends: Sequence[tuple[float | None, float | None]]
) -> list[dict[str, Ends]]:
    """Least and most of each quantity that a parameter moves, as each of those found goes to its two ends alone."""
    out: list[dict[str, Ends]] = []
    for one, (low, high) in zip(found, ends, strict=True):
        out.append({})
        if low is None or high is None or one.name not in fit.model.parameters.names:
            continue
        there = [
            fit.model.material_of(_theta(fit.model, {**fit.values, one.name: end}), fit.scene) for end in (low, high)
        ]
        for name, value in dataclasses.asdict(best).items():
            reached = (value, *(getattr(m, name) for m in there))
            if min(reached) < max(reached):
                out[-1][name] = (min(reached), max(reached))
    return out


def _by_quantity(moved: Sequence[Mapping[str, Ends]]) -> dict[str, tuple[list[float], list[float]]]:
    """Lows and highs of each quantity, of one parameter after another."""
    out: dict[str, tuple[list[float], list[float]]] = {}
    for one in moved:
        for name, (low, high) in one.items():
            lows, highs = out.setdefault(name, ([], []))
            lows.append(low)
            highs.append(high)
    return out


def _together(value: float, lows: Sequence[float], highs: Sequence[float]) -> Ends:
    """Low and high of a quantity that several parameters move, each to its own two ends: as if these erred by
    themselves, the root of the sum of squares to either side, of logarithms where all are above 0.
    """
    by_factors = min(value, *lows) > 0
    at, below, above = (np.log(x) if by_factors else np.array(x) for x in (value, lows, highs))
    low, high = float(at - np.linalg.norm(at - below)), float(at + np.linalg.norm(above - at))
    return (math.exp(low), math.exp(high)) if by_factors else (low, high)


def _determined(fit: FittedCell, best: Material, found: Sequence[Estimate]) -> dict[str, bool]:
    """Whether the recordings say what a quantity is: not where a parameter that they do not determine moves it, within
    the range that was searched, over half of what all of them do.
    """
    ranges = _moved(fit, best, found, [(e.lower, e.upper) for e in found])
    out = {}
    for name, (lows, highs) in _by_quantity(ranges).items():
        low, high = min(lows), max(highs)
        size = math.log if low > 0 and high > FAR * low else float
        most = max(
            (size(r[name][1]) - size(r[name][0]) for e, r in zip(found, ranges, strict=True)
             if name in r and not e.determined), default=0.0,
        )  # fmt: skip
        out[name] = most < WIDE * (size(high) - size(low))
    return out


def _origin(fit: FittedCell) -> dict[str, Any]:
    """Where the numbers come from: plain data."""
    cell, every = fit.cell, fit.store.rows([fit.cell.key])
    if not every:
        raise ClothbenchError(
            f"{fit.store.cell(cell.key)}/rows.parquet: found no rows of this cell, expected those of a fit; delete the "
            "cell and run it again"
        )
    rows = [r for r in every if r["metric"] == cell.metric and r["value"] is not None]
    return {
        "cell": cell.key,
        "suite": cell.suite,
        "recordings": {s.name: s.hash for s in cell.recordings if s.split == "fit"},
        "model": f"{cell.model} ({cell.versions.get(f'models/{cell.model}', 'version not known')})",
        "effects": list(cell.effects),
        "optimizer": cell.optimizer,
        "seed": cell.seed,
        "budget": cell.budget,
        **({"held": sorted(cell.fixed)} if cell.fixed else {}),
        "errors": {f"{r['recording'] or 'mean'} ({r['split']})": f"{r['value']:.4g} {r['unit']}" for r in rows},
        "clothbench": every[0]["clothbench"],
    }
