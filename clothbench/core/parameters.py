"""Parameters with unit, bounds, scale, meaning and source, and the box they span together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError

SCALES = ("linear", "log")


@dataclass(frozen=True)
class Parameter:
    """One number that a model or an effect can be given.

    name: identifier, unique in its space; symbol: as the papers write it; unit: SI, "1" if none;
    bounds: (low, high) in that unit; scale: how a search should walk, "linear" or "log";
    default: value used when nothing is calibrated; meaning: one line; source: paper and equation;
    null: of an effect's parameter, a value at which the effect vanishes exactly, where all that have one are at it; of
    a model's, the value at which a part of its physics that it could do without is switched off (`improve` begins
    without it).
    """

    name: str
    symbol: str
    unit: str
    bounds: tuple[float, float]
    scale: str
    default: float
    meaning: str
    source: str
    null: float | None = None

    def __post_init__(self) -> None:
        low, high = self.bounds
        where = f"parameter {self.name!r}"
        if not self.name.replace(".", "_").isidentifier():
            raise ClothbenchError(f"{where}: the name must be an identifier")
        if not self.unit:
            raise ClothbenchError(f"{where}: found no unit, expected an SI unit ('1' if it has none)")
        if self.scale not in SCALES:
            raise ClothbenchError(f"{where}: scale is {self.scale!r}, expected one of {', '.join(SCALES)}")
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ClothbenchError(f"{where}: bounds are ({low}, {high}), expected finite and increasing")
        if self.scale == "log" and low <= 0:
            raise ClothbenchError(f"{where}: a log scale needs a lower bound above 0, found {low}")
        if not low <= self.default <= high:
            raise ClothbenchError(f"{where}: default {self.default} lies outside its bounds ({low}, {high})")


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered, frozen set of parameters. `to_unit` and `from_unit` map between values and the unit cube."""

    parameters: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        names = self.names
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ClothbenchError(f"parameters named twice in one space: {', '.join(twice)}")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def defaults(self) -> np.ndarray:
        """Default values, shape (P,), each in its parameter's unit."""
        return np.array([p.default for p in self.parameters], dtype=float)

    @property
    def low(self) -> np.ndarray:
        return np.array([p.bounds[0] for p in self.parameters], dtype=float)

    @property
    def high(self) -> np.ndarray:
        return np.array([p.bounds[1] for p in self.parameters], dtype=float)

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise ClothbenchError(f"no parameter {name!r}; there are: {', '.join(self.names) or 'none'}")

    def _is_log(self) -> np.ndarray:
        return np.array([p.scale == "log" for p in self.parameters], dtype=bool)

    def to_unit(self, theta: np.ndarray) -> np.ndarray:
        """Values (..., P) → unit cube (..., P), logarithmic where the scale is."""
        theta, log = np.asarray(theta, dtype=float), self._is_log()
        low, high = self.low, self.high
        out = (theta - low) / (high - low)
        if log.any():
            span = np.log(high[log] / low[log])
            out[..., log] = np.log(np.maximum(theta[..., log], np.finfo(float).tiny) / low[log]) / span
        return out

    def from_unit(self, unit: np.ndarray) -> np.ndarray:
        """Unit cube (..., P) → values (..., P); what lies outside the cube is put on its face."""
        unit, log = np.clip(np.asarray(unit, dtype=float), 0.0, 1.0), self._is_log()
        low, high = self.low, self.high
        out = low + unit * (high - low)
        if log.any():
            out[..., log] = low[log] * (high[log] / low[log]) ** unit[..., log]
        return np.clip(out, low, high)

    def at_bound(self, theta: np.ndarray, tolerance: float = 1e-3) -> np.ndarray:
        """Which values (..., P) lie on a bound, within `tolerance` of the scaled range."""
        unit = self.to_unit(theta)
        return (unit <= tolerance) | (unit >= 1.0 - tolerance)

    def check(self, theta: np.ndarray) -> np.ndarray:
        """`theta` as a float array (B, P); refuses a wrong shape or a value that is not finite."""
        out = np.atleast_2d(np.asarray(theta, dtype=float))
        if out.ndim != 2 or out.shape[1] != len(self):
            raise ClothbenchError(
                f"parameter sets: found shape {np.shape(theta)}, expected (B, {len(self)}) for {', '.join(self.names)}"
            )
        if not np.isfinite(out).all():
            raise ClothbenchError("parameter sets: found a value that is not finite")
        return out

    def prefixed(self, prefix: str) -> ParameterSpace:
        """The same space with every name as `prefix.name`."""
        return ParameterSpace(tuple(dataclasses.replace(p, name=f"{prefix}.{p.name}") for p in self))

    def joined(self, *others: ParameterSpace) -> ParameterSpace:
        return ParameterSpace(sum((o.parameters for o in others), self.parameters))

    def bounded(self, bounds: Mapping[str, tuple[float, float]]) -> ParameterSpace:
        """A copy with other bounds for some parameters; defaults move inside them. Bounds below 0 are refused where the
        scale is logarithmic; from 0 on, which may switch something off, it becomes linear.
        """
        for name in bounds:
            self[name]
        changed = []
        for p in self:
            low, high = (float(b) for b in bounds.get(p.name, p.bounds))
            if p.scale == "log" and low < 0:
                raise ClothbenchError(f"bounds of {p.name!r} are [{low:g}, {high:g}] {p.unit}, expected 0 or above")
            default = min(max(p.default, low), high)
            scale = "linear" if low <= 0 else p.scale
            changed.append(dataclasses.replace(p, bounds=(low, high), default=default, scale=scale))
        return ParameterSpace(tuple(changed))
