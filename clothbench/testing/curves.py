"""What plugins that have to do with force-extension curves must keep; the rules of models and effects call these."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Effect
from clothbench.modelling.curves import CURVE_HOOKS, CurveRollout, curve_of
from clothbench.testing import probe
from clothbench.testing.rules import require, require_refusal

STRETCH = np.concatenate([np.linspace(0.98, 1.1, 13), np.linspace(1.15, 3.0, 20)])


class Spring:
    """A linear model, for effects to act beside."""

    name, version, capabilities = "conformance_spring", 1, frozenset({"curve"})
    parameters = ParameterSpace(
        (Parameter("k", "k", "N/m", (1.0, 100.0), "log", 10.0, "tension per width over strain", "Hooke's law"),)
    )

    def curve(self, stretch: np.ndarray, theta: np.ndarray) -> np.ndarray:
        return theta[0] * (stretch - 1)


class Lift:
    """An effect that certainly acts, to be put beside another one."""

    name, version, place, summary = "conformance_lift", 1, "dynamics", "a constant tension, for the kit only"
    parameters = ParameterSpace((Parameter("t", "t", "N/m", (0.0, 5.0), "linear", 1.0, "tension", "none", null=0.0),))

    def curve(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return phi[0] + 0 * stretch


def pulled(model: Any, *pairs: tuple[Any, np.ndarray], units: tuple[float, ...] = (0.5, 0.4)) -> CurveRollout:
    """A sample 5 cm wide at model parameters at these shares of their ranges, with effects at given values."""
    own = np.array([model.parameters.from_unit(np.full(len(model.parameters), u)) for u in units])
    columns = [own, *(np.tile(values, (len(own), 1)) for _, values in pairs)]
    return curve_of(model, [effect for effect, _ in pairs], STRETCH, 0.05).run(np.hstack(columns))


def vanishes(effect: Effect) -> None:
    elsewhere = effect.parameters.from_unit(np.full(len(effect.parameters), 0.3))
    free = np.array([p.null is None for p in effect.parameters])
    null, lift = probe.null_values(effect), (Lift(), np.array([2.0]))
    for values in [null, np.where(free, elsewhere, null)]:
        for beside in [(), (lift,)]:
            bare, seen = pulled(Spring(), *beside), pulled(Spring(), *beside, (effect, values))
            found = f"another curve at the null values {values.tolist()}"
            require(np.array_equal(bare.force, seen.force), found, "the bits of the bare model")


def acts(effect: Effect) -> None:
    bare, changed = pulled(Spring()).force, False
    for values in probe.acting_values(effect):
        seen = pulled(Spring(), (effect, values)).force
        require(np.isfinite(seen).all(), f"forces that are not finite at {values.tolist()}", "finite ones")
        changed |= not np.array_equal(bare, seen)
    require(changed, "no change of any curve, whatever the values", "one at least")


def leaves_inputs_alone(effect: Any) -> None:
    phi, stretch = next(probe.acting_values(effect)), STRETCH.copy()
    given = (stretch, 10 * (stretch - 1)) if effect.place == "sensor" else (stretch,)
    before, hook = [array.copy() for array in (*given, phi)], getattr(effect, CURVE_HOOKS[effect.place])
    first, again = (np.asarray(hook(*given, phi)) for _ in range(2))
    require(first.shape == stretch.shape, f"{CURVE_HOOKS[effect.place]!r} that gives {first.shape}", stretch.shape)
    require(np.array_equal(first, again), f"another result of {CURVE_HOOKS[effect.place]!r} called again", "equal bits")
    kept = all(map(np.array_equal, (*given, phi), before))
    require(kept, f"arrays given to {CURVE_HOOKS[effect.place]!r} that it has changed", "a new array")


def answers(model: Any) -> None:
    """Finite forces, the same twice and one by one, wrong parameters refused, each parameter counting."""
    units = (0.3, 0.5, 0.7)
    rollout, again = pulled(model, units=units), pulled(model, units=units)
    require(rollout.force.shape == (3, len(STRETCH)), f"forces of shape {rollout.force.shape}", (3, len(STRETCH)))
    require(np.isfinite(rollout.force).all(), "forces that are not finite", "finite ones")
    require(np.array_equal(rollout.force, again.force), "another curve when asked again", "equal bits")
    alone = np.vstack([pulled(model, units=(u,)).force for u in units])
    require(np.array_equal(rollout.force, alone), "another curve in a batch than alone", "equal bits")
    simulation, space = curve_of(model, (), STRETCH), model.parameters
    require_refusal(lambda: simulation.run(np.full((1, len(space) + 1), 1.0)), "one parameter too many")
    for i, parameter in enumerate(space):
        unit = np.full((2, len(space)), 0.5)
        unit[:, i] = 0.3, 0.7
        low, high = simulation.run(space.from_unit(unit)).force
        require(not np.array_equal(low, high), f"nothing changed by {parameter.name!r}", "another curve")
