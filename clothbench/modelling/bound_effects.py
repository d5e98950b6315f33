"""Effects put to work: what a model needs in order to run with any set of them, wherever each one acts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import (
    Lightens,
    Remembers,
    Restrains,
    ShiftsPositions,
    ShiftsSight,
    ShiftsTimes,
    Stiffens,
    acts_at_rest,
    family_of,
    reads_normals,
)
from clothbench.core.protocols import Effect
from clothbench.core.scene import Scene
from clothbench.modelling.curves import acts_on_sheets
from clothbench.modelling.joined import JoinedParameters

if TYPE_CHECKING:
    from clothbench.modelling.sheet import Sheet

PLACES = ("dynamics", "boundary", "sensor")
FORCE, INERTIA = 0, 1
DEAD_LOADS = ("mass", "gravity")  # families of effects
LEAST_MASS = 1e-3  # share of a node's stated mass, so that a step remains where effects take more than there is


@dataclass(frozen=True, eq=False)
class BoundEffects(JoinedParameters):
    """A model's parameters joined with those of its effects, and the effects sorted by where they act."""

    def __post_init__(self) -> None:
        for effect in self.effects:
            if effect.place not in PLACES:
                raise ClothbenchError(
                    f"effect {effect.name!r}: place is {effect.place!r}, expected one of {', '.join(PLACES)}"
                )
            if not acts_on_sheets(effect):
                raise ClothbenchError(f"effect {effect.name!r} acts on force-extension curves only, not on a sheet")
        super().__post_init__()

    def at(self, place: str) -> tuple[Effect, ...]:
        return tuple(e for e in self.effects if e.place == place)

    # --- dynamics -----------------------------------------------------------------------------------------------

    def kernels(
        self, slots: int, filler: Callable, settling: bool = False
    ) -> tuple[tuple[Callable, ...], np.ndarray, int]:
        """Compiled functions for a time loop with `slots` places, their stages (slots,), and how many are used.

        settling: those for a sheet that comes to rest, with the filler in place of what acts in motion only.
        """
        from clothbench.modelling.kernels import ready  # numba is asked for by those who simulate

        found = self._stages()
        if len(found) > slots:
            raise ClothbenchError(
                f"{len(found)} dynamics terms at once, this model has room for {slots}; name fewer effects"
            )
        empty = ready(filler, "the filler of a slot")
        functions = [
            empty if settling and not acts_at_rest(e) else ready(getattr(e, stage), f"effect {e.name!r}: {stage!r}")
            for e, stage in found
        ]
        functions += [empty] * (slots - len(found))
        stages = [FORCE if stage == "force" else INERTIA for _, stage in found] + [FORCE] * (slots - len(found))
        return tuple(functions), np.array(stages, dtype=np.int64), len(found)

    def kernel_parameters(self, theta: np.ndarray, slots: int) -> np.ndarray:
        """Each slot's parameters (B, slots, width)."""
        width = max([1, *(len(e.parameters) for e in self.at("dynamics"))])
        out = np.zeros((len(theta), slots, width))
        for k, (effect, _) in enumerate(self._stages()):
            out[:, k, : len(effect.parameters)] = self.of_effect(effect, theta)
        return out

    def kernel_state(self, members: int, slots: int, sheet: Sheet) -> np.ndarray:
        """Zeroed memory (members, slots, S) for effects that carry something from step to step."""
        sizes = [e.state_size(sheet) for e, _ in self._stages() if isinstance(e, Remembers)]
        return np.zeros((members, slots, max([1, *sizes])))

    def resting(self, theta: np.ndarray) -> np.ndarray:
        """theta (B, P) with what acts in motion only at its null values: it has no say in where a sheet rests."""
        out = theta.copy()
        for effect in self.at("dynamics"):
            if not acts_at_rest(effect):
                own = self.of_effect(effect, out)
                for k, parameter in enumerate(effect.parameters):
                    if parameter.null is not None:
                        own[:, k] = parameter.null
        return out

    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        """What all effects together add at most to in-plane stiffness N/m and bending rigidity N·m, (B, 2)."""
        out = np.zeros((len(theta), 2))
        for effect in self.at("dynamics"):
            if isinstance(effect, Stiffens):
                out += [effect.stiffness(phi) for phi in self.of_effect(effect, theta)]
        return out

    def lightest(self, theta: np.ndarray) -> np.ndarray:
        """Least share of a node's stated mass that all effects together leave, (B,), at most 1."""
        taken = np.zeros(len(theta))
        for effect in self.at("dynamics"):
            if isinstance(effect, Lightens):
                taken += [max(0.0, 1.0 - effect.lightest(phi)) for phi in self.of_effect(effect, theta)]
        return np.maximum(1.0 - taken, LEAST_MASS)

    def restraint(self, theta: np.ndarray) -> np.ndarray:
        """What all effects together add at most to a node's squared frequency 1/s² and rate of damping 1/s, (B, 2)."""
        out = np.zeros((len(theta), 2))
        for effect in self.at("dynamics"):
            if isinstance(effect, Restrains):
                out += [effect.restraint(phi) for phi in self.of_effect(effect, theta)]
        return out

    @property
    def normals(self) -> bool:
        """Whether any kernel may read `sheet.normal`."""
        return any(reads_normals(e) for e in self.at("dynamics"))

    @property
    def only_weighs(self) -> bool:
        """Whether whatever dynamics effect has a say in where a sheet comes to rest is a dead load, which keeps nothing
        moving: more mass, or gravity that leans.
        """
        return all(family_of(e) in DEAD_LOADS for e in self.at("dynamics") if acts_at_rest(e))

    @property
    def at_rest(self) -> bool:
        """Whether any dynamics effect has a say in where a sheet comes to rest."""
        return any(acts_at_rest(e) for e in self.at("dynamics"))

    def _stages(self) -> list[tuple[Effect, str]]:
        """Every force and inertia term, in the order of the effects; an effect that has both appears twice."""
        found = []
        for effect in self.at("dynamics"):
            stages = [s for s in ("force", "inertia") if getattr(effect, s, None) is not None]
            if not stages:
                raise ClothbenchError(
                    f"effect {effect.name!r}: place 'dynamics' needs a 'force' or an 'inertia' kernel"
                )
            for stage in stages:
                if not hasattr(getattr(effect, stage), "py_func"):
                    raise ClothbenchError(
                        f"effect {effect.name!r}: '{stage}' is not compiled; decorate it with clothbench.effect_kernel"
                    )
                found.append((effect, stage))
        return found

    # --- boundary and sensor ------------------------------------------------------------------------------------

    def grip_curves(self, scene: Scene, theta: np.ndarray) -> np.ndarray:
        """Piecewise cubics of the grips: (1, 4, K−1, G, 3) where all members share them, else (B, …)."""
        if not scene.grip_material.size:
            return np.zeros((1, 4, 1, 0, 3))
        if not self.at("boundary"):
            return scene.grip_curve()[None]
        return np.stack([scene.grip_curve(self._held(scene, theta[b : b + 1])) for b in range(len(theta))])

    def _held(self, scene: Scene, theta: np.ndarray) -> np.ndarray:
        position = np.array(scene.grip_position)
        for effect in self.at("boundary"):
            moved = effect.grips(scene.grip_time, position, self.of_effect(effect, theta)[0])  # type: ignore[attr-defined]
            position = _finite(moved, scene.grip_position.shape, effect, "grips")
        return position

    def times(self, scene: Scene, theta: np.ndarray) -> np.ndarray:
        """When each member is looked at for each stamp of the scene: (B, T) s. What acts on pictures shifts their times
        only.
        """
        out = np.repeat(scene.times[None], len(theta), axis=0)
        for effect in self.at("sensor"):
            in_pictures = isinstance(effect, ShiftsSight)
            if isinstance(effect, ShiftsTimes) and not (in_pictures and scene.camera is None):
                for b, phi in enumerate(self.of_effect(effect, theta)):
                    out[b] = _finite(effect.times(out[b], phi), scene.times.shape, effect, "times")
                    if (np.diff(out[b]) < 0).any():  # loops take frames in turn
                        t = int(np.argmax(np.diff(out[b]) < 0))
                        raise ClothbenchError(
                            f"effect {effect.name!r}: 'times' gave {out[b, t]:g} s and then {out[b, t + 1]:g} s, "
                            "expected times in the order of the stamps"
                        )
        return out

    def distinct(self, theta: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of members that only the sensor tells apart, looked at at the same `times` (B, T), the first (K,); and for
        each of all members (B,) the one that moves as it does.
        """
        if not self.at("sensor"):
            return np.arange(len(theta)), np.arange(len(theta))
        moving = theta.copy()
        for effect in self.at("sensor"):
            self.of_effect(effect, moving)[:] = 0.0
        _, first, alike = np.unique(np.hstack([moving, times]), axis=0, return_index=True, return_inverse=True)
        return np.sort(first), first[alike.ravel()]

    def seen(self, scene: Scene, theta: np.ndarray, position: np.ndarray) -> np.ndarray:
        """What the sensor makes of the true positions (B, T, N, 3) m."""
        with np.errstate(over="ignore", invalid="ignore"):  # a member that diverged may hold anything
            for effect in self.at("sensor"):
                if isinstance(effect, ShiftsPositions):
                    phis, points = self.of_effect(effect, theta), scene.points
                    shown = [
                        effect.positions(scene.times, p, points, phi) for p, phi in zip(position, phis, strict=True)
                    ]
                    position = _shown(shown, position, effect, "positions")
                if isinstance(effect, ShiftsSight) and (camera := scene.camera) is not None:
                    of_each = zip(position, self.of_effect(effect, theta), strict=True)
                    shown = [effect.sights(scene.times, p, camera, phi) for p, phi in of_each]
                    position = _shown(shown, position, effect, "sights")
        return position


def _shown(found: Sequence[Any], position: np.ndarray, effect: Effect, what: str) -> np.ndarray:
    """What a sensor made of positions (B, T, N, 3) m, made sure: what it lost would pass for a sheet that diverged."""
    of_each = zip(found, position, strict=True)
    return np.stack([_finite(one, p.shape, effect, what, lost=not np.isfinite(p).all()) for one, p in of_each])


def _finite(found: Any, shape: tuple[int, ...], effect: Effect, what: str, lost: bool = False) -> np.ndarray:
    """What an effect gave, made sure: compiled loops index it unchecked, and wait for a time that is not a number.
    lost: whether it was shown a member that diverged, and may give anything of the right shape.
    """
    try:
        array = np.asarray(found, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not (lost or np.isfinite(array).all()):
        raise ClothbenchError(
            f"effect {effect.name!r}: '{what}' gave {type(found).__name__} of shape {np.shape(array)}, expected finite "
            f"numbers of shape {shape}"
        )
    return array
