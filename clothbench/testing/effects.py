"""What every effect must keep: it vanishes at its null values, acts elsewhere, and goes along with others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import (
    EFFECT_FAMILIES,
    FORCE_LAWS,
    FollowsLaw,
    HasFamily,
    Lightens,
    Remembers,
    Restrains,
    SaysNormals,
    Stiffens,
    acts_at_rest,
    limits_of,
    varying_of,
)
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect, Model
from clothbench.modelling.bound_effects import PLACES
from clothbench.modelling.curves import CURVE_HOOKS, SHEET_HOOKS, acts_on_curves, acts_on_sheets
from clothbench.modelling.kernels import ready
from clothbench.testing import curves, probe
from clothbench.testing.effect_case import EffectCase, first_that_takes_effects, smooth_velocity, waving_sheet
from clothbench.testing.model_case import ModelCase, finished, same_bits
from clothbench.testing.rules import Outcome, choose, made, require, require_members, run_rules
from clothbench.testing.scenes import CAMERA

MESHES = (9, 17)  # nodes along either side; a force for every node, or every node of a border, doubles at least
MESH_TELLS = 0.4  # of the larger sum; integrals over the cloth differ by a fiftieth


def check_effect(
    make: Callable[[], Effect],
    *,
    models: Sequence[Callable[..., Model]] | None = None,
    only: Iterable[str] | None = None,
) -> tuple[Outcome, ...]:
    """Check the effect that `make()` gives on `models`, or on the first installed one that takes effects.

    (The check of a model tries every installed effect on that model.)
    """
    effect = made(make, "effect")
    makes = first_that_takes_effects() if models is None else models
    case = EffectCase(effect, tuple(ModelCase(make, make()) for make in makes))
    return run_rules(f"effect {getattr(effect, 'name', make)!r}", choose(RULES, only), case)


def keeps_what_it_offers(case: EffectCase) -> None:
    """The optional parts of `clothbench.core.optional` that it has are what they should be."""
    effect, (sheet, _, _) = case.effect, waving_sheet()
    if isinstance(effect, Remembers):
        size = effect.state_size(sheet)
        whole = isinstance(size, int | np.integer) and not isinstance(size, bool) and size >= 0
        require(whole, f"a state_size of {size!r}", "a whole number, 0 or above")
    if isinstance(effect, Stiffens):
        for phi in (probe.null_values(effect), *probe.acting_values(effect)):
            added = np.asarray(effect.stiffness(phi), dtype=float)
            fine = added.shape == (2,) and bool(np.isfinite(added).all()) and bool((added >= 0).all())
            require(fine, f"a stiffness of {added.tolist()}", "two numbers, N/m and N·m, 0 or above")
    if isinstance(effect, Lightens):
        for phi in (probe.null_values(effect), *probe.acting_values(effect)):
            left = effect.lightest(phi)
            require(0 < left <= 1, f"lightest that gives {left!r}", "a share above 0, at most 1")
    if isinstance(effect, Restrains):
        for phi in (probe.null_values(effect), *probe.acting_values(effect)):
            added = np.asarray(effect.restraint(phi), dtype=float)
            fine = added.shape == (2,) and bool(np.isfinite(added).all()) and bool((added >= 0).all())
            require(fine, f"a restraint of {added.tolist()}", "two numbers, 1/s² and 1/s, 0 or above")
    if isinstance(effect, SaysNormals):
        require(isinstance(effect.normals, bool), f"normals {effect.normals!r}", "True or False")
    if isinstance(effect, HasFamily):
        require(effect.family in EFFECT_FAMILIES, f"family {effect.family!r}", f"one of {', '.join(EFFECT_FAMILIES)}")
    if isinstance(effect, FollowsLaw):
        require(effect.law in FORCE_LAWS, f"law {effect.law!r}", f"one of {', '.join(FORCE_LAWS)}")
    for phi in probe.acting_values(effect):
        for what, there in limits_of(effect, phi).items():
            fine = np.shape(there) == np.shape(phi) and bool(np.isfinite(there).all())
            require(fine, f"limits with {what!r}: {there!r}", "a finite number for each of its parameters")
    unknown = [name for name in varying_of(effect) if name not in effect.parameters.names]
    require(not unknown, f"by_recording with {', '.join(map(repr, unknown))}", "names of its own parameters")


def has_all_members(case: EffectCase) -> None:
    effect = case.effect
    require_members(effect, Effect, ("name", "version", "place", "summary", "parameters"))
    require(effect.place in PLACES, f"place {effect.place!r}", f"one of {', '.join(PLACES)}")
    hooks = (*SHEET_HOOKS[effect.place], CURVE_HOOKS[effect.place])
    acts = any(callable(getattr(effect, hook, None)) for hook in hooks)
    require(acts, f"none of {', '.join(hooks)}", f"at least one of them, since its place is {effect.place!r}")
    one_line = isinstance(effect.summary, str) and effect.summary.strip() and "\n" not in effect.summary
    require(one_line, f"summary {effect.summary!r}", "one line for a report")
    for stage in SHEET_HOOKS["dynamics"]:
        function = getattr(effect, stage, None)
        if function is not None and effect.place == "dynamics":
            require(
                hasattr(function, "py_func"),
                f"{stage!r} that is not compiled",
                "one decorated with clothbench.effect_kernel",
            )
            try:
                ready(function, repr(stage))
            except ClothbenchError as error:
                require(False, str(error), "a kernel as clothbench.effect_kernel describes it")


def has_null_values_within_its_bounds(case: EffectCase) -> None:
    space = case.effect.parameters
    require(isinstance(space, ParameterSpace), f"parameters {space!r}", "a ParameterSpace")
    require(len(space) > 0, "no parameter", "at least one, with a null value")
    nulls = [p for p in space if p.null is not None]
    require(nulls, "no parameter with a null value", "one at which the effect vanishes")
    for p in nulls:
        inside = p.null is not None and p.bounds[0] <= p.null <= p.bounds[1]
        require(inside, f"null value {p.null} of {p.name!r} outside its bounds {p.bounds}", "inside")


def vanishes_at_its_null_values(case: EffectCase) -> str | None:
    """Also with those parameters elsewhere that have no null value of their own."""
    if acts_on_curves(case.effect):
        curves.vanishes(case.effect)
    if not acts_on_sheets(case.effect):
        return None
    if not case.models:
        return "no model that takes effects is installed"
    elsewhere = case.effect.parameters.from_unit(np.full(len(case.effect.parameters), 0.3))
    free = np.array([p.null is None for p in case.effect.parameters])
    for values in [case.null, *([np.where(free, elsewhere, case.null)] if free.any() else [])]:
        for (model, scene), bare in case.bare.items():
            seen = case.run(model, scene, (case.effect, values))
            found = f"another motion at the null values {values.tolist()} in scene {scene}"
            require(same_bits(bare, seen), found, "the bits of the bare model")
    return None


def acts_elsewhere(case: EffectCase) -> str | None:
    """At one of several values at least; and wherever the model runs to its end, what is seen is finite.

    All values in the liveliest scene, and in the other scenes as long as it has not acted.
    """
    if acts_on_curves(case.effect):
        curves.acts(case.effect)
    if not acts_on_sheets(case.effect):
        return None
    if not case.models:
        return "no model that takes effects is installed"
    for number, model in enumerate(case.models):
        changed = False
        for scene in sorted(model.scenes, key=lambda name: model.scenes[name] is not model.liveliest):
            for values in probe.acting_values(case.effect):
                seen = case.run(number, scene, (case.effect, values))
                finite = np.isfinite(seen.position[finished(seen)]).all()
                found = f"positions that are not finite at {values.tolist()} in scene {scene}"
                require(finite, found, "finite ones")
                changed |= bool(finished(seen).all()) and not same_bits(case.bare[number, scene], seen)
            if changed:
                break
        require(changed, "no change of any motion, whatever the values", "one that runs to its end")
    return None


def lets_hang_what_hangs(case: EffectCase) -> str | None:
    """An effect that says it has no part in where a sheet comes to rest exerts no force on one that does not move."""
    if acts_at_rest(case.effect) or case.effect.place != "dynamics" or getattr(case.effect, "force", None) is None:
        return "may act on a sheet at rest, or exerts no force at all"
    effect, (sheet, x, v) = case.effect, waving_sheet()
    for values in probe.acting_values(effect):
        state = np.zeros(effect.state_size(sheet) if isinstance(effect, Remembers) else 0)
        for t in np.linspace(0.0, 2.0, 5):  # it may come later, or with what it remembers
            force = np.zeros_like(x)
            effect.force.py_func(t, 1e-3, x, 0 * v, force, sheet, values, state)  # type: ignore[attr-defined]
            found = f"a force of {np.abs(force).max():.3g} N at {values.tolist()} on a sheet that does not move"
            require(not force.any(), found, "none, since at_rest is False")
    return None


def goes_along_with_another_effect(case: EffectCase) -> str | None:
    """Beside a throw-away push: in either order, and with either of the two at its null value."""
    if not acts_on_sheets(case.effect):
        return "acts on curves only, where effects do not know of each other"
    if not case.models:
        return "no model that takes effects is installed"
    push: Any = probe.SidewaysPush()
    own, other = next(probe.acting_values(case.effect)), push.parameters.defaults
    for model, tried in enumerate(case.models):
        scene = "swinging" if "swinging" in tried.scenes else next(iter(tried.scenes))
        only_push = case.run(model, scene, (push, other))
        for pairs in ([(case.effect, case.null), (push, other)], [(push, other), (case.effect, case.null)]):
            kept = same_bits(only_push, case.run(model, scene, *pairs))
            require(kept, "another effect's motion changed by this one at its null values", "equal bits")
        alone = case.run(model, scene, (case.effect, own))
        beside = case.run(model, scene, (case.effect, own), (push, push.parameters.low))
        require(same_bits(alone, beside), "another motion beside an effect at its null value", "equal bits")
    return None


def keeps_to_its_own_memory(case: EffectCase) -> str | None:
    """A kernel changes the forces and its declared state, nothing else, and reads only the parameters it has.

    It is run uncompiled, where reaching past the end of an array is an error and not a silent overwrite; and once more
    with a longer state, as it has beside an effect that remembers more.
    """
    if case.effect.place != "dynamics" or not acts_on_sheets(case.effect):
        return "has no kernel"
    effect, (sheet, x, v) = case.effect, waving_sheet()
    size = effect.state_size(sheet) if isinstance(effect, Remembers) else 0
    for stage in SHEET_HOOKS["dynamics"]:
        if getattr(effect, stage, None) is None:
            continue
        for values in probe.acting_values(effect):
            given = [x, v, *(part for part in sheet if isinstance(part, np.ndarray)), values]
            before = [array.copy() for array in given]
            filled, longer = np.zeros((2, 3 if stage == "force" else 6, x.shape[1]))
            for added, state in ((filled, np.zeros(size)), (longer, np.zeros(size + 7))):
                for step in range(3):
                    getattr(effect, stage).py_func(1e-3 * step, 1e-3, x, v, added, sheet, values, state)
            kept = all(np.array_equal(a, b) for a, b in zip(given, before, strict=True))
            require(kept, f"an input of {stage!r} that it has changed", "changes to f and state only")
            require(np.isfinite(filled).all(), f"what {stage!r} adds, which is not finite", "finite numbers")
            found = f"{stage!r} that adds something else with a longer state"
            require(np.array_equal(filled, longer), found, "the same: others may remember more")
    return None


def means_the_same_on_every_mesh(case: EffectCase) -> str | None:
    """All that a kernel adds, summed over a sheet, is what it adds on a finer mesh: its parameters are the cloth's.

    What acts between parts of the cloth sums up to nothing, and says nothing here.
    """
    if case.effect.place != "dynamics" or not acts_on_sheets(case.effect):
        return "has no kernel"
    told = False
    for stage in SHEET_HOOKS["dynamics"]:
        for values in probe.acting_values(case.effect) if getattr(case.effect, stage, None) is not None else ():
            (coarse, some), (fine, most) = (_summed(case.effect, stage, values, nodes) for nodes in MESHES)
            size = max(np.linalg.norm(coarse), np.linalg.norm(fine))
            if size <= 0.05 * max(some, most):
                continue
            told, away = True, float(np.linalg.norm(coarse - fine) / size)
            found = f"{stage!r} that adds {np.linalg.norm(coarse):.3g} on {MESHES[0]} × {MESHES[0]} nodes and "
            found += f"{np.linalg.norm(fine):.3g} on {MESHES[1]} × {MESHES[1]} at {values.tolist()}"
            require(away <= MESH_TELLS, found, "the same, as of an area, a length or a mass of the cloth")
    return None if told else "adds nothing, summed over a sheet that nothing holds"


def _summed(effect: Any, stage: str, values: np.ndarray, nodes: int) -> tuple[np.ndarray, float]:
    """The sum over all nodes after three steps (3,) N or (6,) kg, and that of the sizes of all its terms."""
    sheet, x, _ = waving_sheet(nodes)
    added, v = np.zeros((3 if stage == "force" else 6, x.shape[1])), smooth_velocity(x)
    state = np.zeros(effect.state_size(sheet) + 7 if isinstance(effect, Remembers) else 7)
    for step in range(3):
        added[:] = 0.0
        getattr(effect, stage)(0.3 + 1e-3 * step, 1e-3, x, v, added, sheet, values, state)
    return added.sum(axis=1), float(np.abs(added).sum())


def leaves_positions_it_is_given_alone(case: EffectCase) -> str | None:
    effect, phi = case.effect, next(probe.acting_values(case.effect))
    if acts_on_curves(effect):
        curves.leaves_inputs_alone(effect)
    if effect.place == "dynamics":
        return "is given no positions to change"
    time, position = np.linspace(0.0, 0.5, 6), np.random.default_rng(4).normal(size=(6, 4, 3))
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.1]])
    before = time.copy(), position.copy(), points.copy()
    arguments = {"grips": (time, position), "times": (time,), "positions": (time, position, points),
                 "sights": (time, position, CAMERA)}  # fmt: skip
    for hook in SHEET_HOOKS[effect.place]:
        if not hasattr(effect, hook):
            continue
        wanted = time.shape if hook == "times" else position.shape
        result, again = (np.asarray(getattr(effect, hook)(*arguments[hook], phi)) for _ in range(2))
        require(result.shape == wanted, f"{hook!r} that gives {result.shape}", wanted)
        require(
            np.array_equal(result, again),
            f"{hook!r} that gives another result when called again",
            "equal bits",
        )
        kept = all(map(np.array_equal, (time, position, points), before))
        require(kept, f"arrays given to {hook!r} that it has changed", "a new array")
    return None


RULES = (
    has_all_members,
    keeps_what_it_offers,
    has_null_values_within_its_bounds,
    vanishes_at_its_null_values,
    acts_elsewhere,
    lets_hang_what_hangs,
    goes_along_with_another_effect,
    keeps_to_its_own_memory,
    means_the_same_on_every_mesh,
    leaves_positions_it_is_given_alone,
)
