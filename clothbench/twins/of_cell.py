"""The twin of a calibration's cell: its best parameters as a textbook material, in the scene of what was fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
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
from clothbench.studies.calibration.cell import Bench, CalibrationCell, asked_and_fitted, set_up, with_recordings


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
    def of(cls, out: Path, key: str) -> FittedCell:
        """Raises a ClothbenchError, one line, where there is no fit, or its recording has gone, or the model does not
        say which material its parameters make.
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
        bench = set_up(with_recordings(cell, key, [first]), plugins, out / TRACKED)
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
    units = {row["name"]: row["unit"] for row in fit.fitted}
    others = {
        name: (float(value), units.get(name, "(held)"))
        for name, value in values.items()
        if name not in used and (name in model.parameters.names or name.partition(".")[0] in fit.cell.effects)
    }
    name = f"{fit.cell.case}, fitted by {fit.cell.model}"
    return Twin(name, scene, material, _spread(fit, material), "95 % interval of the fit", others, _origin(fit))


def brought(fit: FittedCell, material: Material) -> float:
    """How far the model's own sheet goes astray [m], as a mean over points and times of the first fitted recording, if
    it has no more than this material: what leaving out the rest brings. Sensor and grips stay as fitted.
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
    one = simulation.run(best[None]).position[0]
    other = whole.run(_free(whole, held)[None]).position[0]
    return float(np.nanmean(np.linalg.norm(one - other, axis=-1)))


def _free(simulation: Simulation, values: Mapping[str, float]) -> np.ndarray:
    return np.array([values.get(p.name, p.default) for p in simulation.parameters])


def _theta(model: Any, values: Mapping[str, float]) -> np.ndarray:
    return np.array([values.get(p.name, p.default) for p in model.parameters])


def _matters(model: Any, theta: np.ndarray, name: str, scene: Scene) -> bool:
    """Whether the material depends on a parameter."""
    changed = theta.copy()
    k = model.parameters.names.index(name)
    changed[k] = 1.01 * theta[k] if theta[k] else 1e-6
    return model.material_of(changed, scene) != model.material_of(theta, scene)


def _spread(fit: FittedCell, best: Material) -> dict[str, tuple[float, float]]:
    """Least and most of each quantity as one parameter after another goes to the ends of its interval."""
    ends: dict[str, list[float]] = {}
    for row in fit.fitted:
        for end in (row["low"], row["high"]):
            if end is None or row["name"] not in fit.model.parameters.names:
                continue
            there = fit.model.material_of(_theta(fit.model, {**fit.values, row["name"]: end}), fit.scene)
            for name, value in dataclasses.asdict(there).items():
                if value != getattr(best, name):
                    ends.setdefault(name, [getattr(best, name)]).append(value)
    return {name: (min(found), max(found)) for name, found in ends.items()}


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
        "errors": {f"{r['recording'] or 'mean'} ({r['split']})": f"{r['value']:.4g} {r['unit']}" for r in rows},
        "clothbench": every[0]["clothbench"],
    }
