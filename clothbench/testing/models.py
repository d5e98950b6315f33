"""What every model must keep: the contract of `clothbench.Model`. What its sheet must do is in `motion`,
`weight` and `contact`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.folding import FoldState
from clothbench.core.optional import (
    EFFECT_FAMILIES,
    MODEL_KINDS,
    DocumentsUnits,
    FoldsStrips,
    KnowsMaterials,
    KnowsTextiles,
    Refinable,
    SaysMaterials,
    absent,
    bench_options_of,
    equal_error_options_of,
    kind_of_model,
    lacks_of,
    libraries,
    repeatability_of,
    runs_in_threads,
    takes_option,
    textile_of,
    why_skipped,
    work_of,
)
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect, Material, Model, Stated
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene
from clothbench.modelling.curves import answers_curves, answers_sheets
from clothbench.testing import contact, curves, motion, probe, weight
from clothbench.testing.model_case import ModelCase, finished, same_bits
from clothbench.testing.rollouts import require_independent, require_whole
from clothbench.testing.rules import (
    Outcome,
    choose,
    made,
    require,
    require_members,
    require_refusal,
    rule_name,
    run_rules,
)

CAPABILITIES = frozenset(
    {
        *("dynamic", "static", "effects", "contact", "self_contact", "curve", "fold", "moving_start", "outline"),
        "carried_contact",
    }
)
WORK = {"operations", "roots", "numbers"}
CLOTH = Material(bending=1e-6, stretch=100.0, shear=50.0)
SAME_MATERIAL = 0.1  # of a quantity of `CLOTH`, there and back
STEPS_TO_TRY = 1e-3 * 2.0 ** np.arange(9)  # s, from fine to hopeless


def check_model(
    make: Callable[..., Model],
    *,
    scenes: Mapping[str, Scene] | None = None,
    effects: Sequence[Effect] | None = None,
    only: Iterable[str] | None = None,
) -> tuple[Outcome, ...]:
    """Check the model that `make()` gives.

    scenes: by name, instead of the kit's own (for a model that can do none of those); effects: instead of
    all installed ones. A scene that the model cannot do it refuses in `prepare` with a ClothbenchError; it is
    left out then. By these options a model shows more: `step_scale` (multiplies its time step) or a method
    `refined(factor)`, and `dt` (a time step in s). A model in single precision, or with a solver that
    ends at a tolerance, says in `repeatability` [m] how far that alone may carry a sheet; two motions are the same
    within it.
    """
    if reason := absent(make):
        return tuple(Outcome(rule_name(rule), reason) for rule in choose(RULES, only))
    model = made(make, "model")
    case = ModelCase(make, model, scenes, effects)
    return run_rules(f"model {getattr(model, 'name', make)!r}", choose(RULES, only), case)


def has_all_members(case: ModelCase) -> None:
    model = case.model
    require_members(model, Model, ("name", "version", "parameters", "capabilities", "prepare"))
    require(isinstance(model.parameters, ParameterSpace), f"parameters {model.parameters!r}", "a ParameterSpace")
    require(len(model.parameters) > 0, "no parameter", "at least one to calibrate")
    unknown = sorted(set(model.capabilities) - CAPABILITIES)
    require(not unknown, f"capabilities {unknown}", f"some of {sorted(CAPABILITIES)}")
    able = {"dynamic", "static", "curve"} & set(model.capabilities)
    require(able, f"capabilities {sorted(model.capabilities)}", "'dynamic', 'static' or 'curve'")
    if answers_curves(model):
        require_members(model, Model, ("curve",))
    if not answers_sheets(model):
        return
    simulation = model.prepare(next(iter(case.scenes.values())))
    names = simulation.parameters.names
    require(names == model.parameters.names, f"a simulation with parameters {names}", model.parameters.names)


def keeps_what_it_offers(case: ModelCase) -> None:
    """The optional parts of `clothbench.core.optional` that it has are what they should be."""
    model, make = case.model, case.make
    require(
        kind_of_model(model) in MODEL_KINDS, f"kind {kind_of_model(model)!r}", f"one of {', '.join(MODEL_KINDS[:-1])}"
    )
    far = repeatability_of(model)
    length = isinstance(far, int | float) and not isinstance(far, bool) and 0 <= far < np.inf
    require(length, f"repeatability {far!r}", "metres, 0 or above")
    named = all(isinstance(name, str) and name for name in libraries(make))
    require(named and not isinstance(getattr(make, "built_on", ()), str), f"built_on {libraries(make)}", "names")
    families = [family for family in lacks_of(model) if family not in EFFECT_FAMILIES]
    require(not families, f"lacks with {', '.join(map(repr, families))}", f"one of {', '.join(EFFECT_FAMILIES)}")
    work = work_of(model)
    stated = work is None or (set(work) == WORK and all(np.isfinite(w) and w >= 0 for w in work.values()))
    require(stated, f"work_per_node_step {work!r}", f"finite numbers of {', '.join(sorted(WORK))}")
    for options in (*bench_options_of(make), *equal_error_options_of(make)):
        found = f"options {options} to be measured with, which make no model"
        require(_can_be_made(make, options), found, "some that do")
    for name, scene in case.scenes.items() if answers_sheets(model) else ():
        reason = why_skipped(model, scene)
        said = reason is None or (isinstance(reason, str) and reason.strip() and "\n" not in reason)
        require(said, f"skip(scene {name}) → {reason!r}", "None, or why not, in one line")
        _require_material(model, name, scene)
        threads = runs_in_threads(model.prepare(scene))
        require(isinstance(threads, bool), f"a simulation with threads {threads!r}", "True or False")
    if isinstance(model, Refinable):
        finer = model.refined(2.0)
        require(finer.parameters.names == model.parameters.names, "other parameters of refined(2)", "the model's own")
    for textile, told in model.textiles.items() if isinstance(model, KnowsTextiles) else ():
        strangers = sorted(set(told) - set(model.parameters.names))
        require(not strangers, f"textile {textile!r} with parameters {strangers}", "the model's own")
        free, held = textile_of(model, textile)
        sound = all(low < high for low, high in free.values()) and np.isfinite([*held.values()]).all()
        require(sound, f"textile {textile!r} with {dict(told)}", "bounds (low, high) or finite values")
    if "fold" in model.capabilities:
        require(isinstance(model, FoldsStrips), "capability 'fold' and no strip(length)", "one")
        _require_strip(model)
    if isinstance(model, DocumentsUnits):
        _require_documented(model)


def _can_be_made(make: Callable[..., Model], options: Mapping[str, object]) -> bool:
    try:
        make(**options)
    except Exception:
        return False
    return True


def _require_material(model: Any, name: str, scene: Scene) -> None:
    if isinstance(model, SaysMaterials):
        defaults = model.parameters.defaults  # type: ignore[attr-defined]
        _material_of(model, defaults, scene, f"the defaults in scene {name}")
    for bending in (CLOTH.bending, 0.0) if isinstance(model, KnowsMaterials) else ():
        cloth = dataclasses.replace(CLOTH, bending=bending)
        try:
            theta = np.asarray(model.of_material(cloth, scene), dtype=float)
        except ClothbenchError:  # it says what it has no parameter for
            continue
        fine = theta.shape == (len(model.parameters),) and bool(np.isfinite(theta).all())
        found = f"of_material in scene {name} → {theta.tolist()}"
        require(fine, found, f"{len(model.parameters)} finite numbers")
        if isinstance(model, SaysMaterials):
            back = _material_of(model, theta, scene, f"of_material in scene {name}")
            same = np.isclose(back.bending, bending, rtol=SAME_MATERIAL)
            same &= np.isclose(back.stretch, cloth.stretch, rtol=SAME_MATERIAL) or np.isinf(back.stretch)
            require(
                same, f"{back} of the parameters of {cloth}", "its bending and stretch, or one that does not stretch"
            )
        return


def _material_of(model: SaysMaterials, theta: np.ndarray, scene: Scene, what: str) -> Material:
    """A material whose numbers are numbers; its stiffnesses may be infinite."""
    material = model.material_of(theta, scene)
    fine = isinstance(material, Material) and all(value >= 0 for value in dataclasses.astuple(material))
    require(fine, f"material_of({what}) → {material!r}", "a clothbench Material, nothing in it below 0 or NaN")
    return material


def _require_documented(model: Any) -> None:
    stated = model.documented
    whole = isinstance(stated, Sequence) and all(isinstance(one, Stated) for one in stated)
    require(whole, f"documented {stated!r}", "a sequence of clothbench Stated")
    quantities = {field.name for field in dataclasses.fields(Material)}
    for one in stated:
        require(one.quantity in quantities, f"documented quantity {one.quantity!r}", f"one of {sorted(quantities)}")
        worth = one.worth(model.parameters.defaults)
        require(not np.isnan(float(worth)), f"documented {one.quantity} worth {worth!r}", "a number")


def _require_strip(model: Any) -> None:
    """It can be lifted, and held near where it was then; how it may end is for the study to say."""
    theta, height = model.parameters.defaults[None], 0.05
    strip = model.strip(0.6)
    lifted = strip.lift(height, theta)
    _require_held(lifted, "lift()")
    if lifted.status == ("ok",):
        require(abs(lifted.pose[0, 1] - height) < 1e-6, f"lift to {lifted.pose[0, 1]:.6g} m", f"{height} m")
        pose = lifted.pose + np.array([0.0, 1e-3, 0.0])
        held = strip.hold(pose, theta, lifted)
        _require_held(held, "hold()")
        away = np.abs(held.pose - pose).max() if held.status == ("ok",) else 0.0
        require(away < 1e-6, f"hold at {held.pose[0].tolist()}", f"the pose {pose[0].tolist()} that it was told")


def _require_held(state: object, what: str) -> None:
    whole = isinstance(state, FoldState) and state.pose.shape == (1, 3) and state.profile.shape[::2] == (1, 2)
    require(whole and len(state.status) == 1, f"{what} → {type(state).__name__}", "a FoldState of one member")  # type: ignore[attr-defined]


def gives_whole_rollouts(case: ModelCase) -> None:
    ended = False
    for name, scene in case.scenes.items():
        theta = case.theta(0.3, 0.7)
        rollout = case.run(scene, theta)
        require_whole(rollout, scene, len(theta), f"scene {name}")
        ended |= rollout.status[0] == "ok"
    require(ended, "no scene that is simulated to its end with default parameters", "at least one")


def gives_the_same_bits_twice(case: ModelCase) -> None:
    for name, scene in case.scenes.items():
        theta = case.theta(0.3, 0.7)
        simulation = case.model.prepare(scene)
        first, again, anew = simulation.run(theta), simulation.run(theta), case.run(scene, theta)
        require(
            same_bits(first, again),
            f"another result of the same simulation run again in scene {name}",
            "equal bits",
        )
        require(same_bits(first, anew), f"another result of the same scene prepared again ({name})", "equal bits")


def gives_a_batch_as_one_by_one(case: ModelCase) -> None:
    for name, scene in case.scenes.items():
        simulation = case.model.prepare(scene)
        require_independent(simulation.run, case.batch, f"scene {name}")


def refuses_wrong_parameters(case: ModelCase) -> None:
    simulation, theta = case.model.prepare(case.liveliest), case.theta()
    require_refusal(lambda: simulation.run(theta[:, :-1]), "one parameter too few")
    require_refusal(lambda: simulation.run(np.hstack([theta, theta[:, :1]])), "one parameter too many")
    require_refusal(lambda: simulation.run(np.full_like(theta, np.nan)), "a parameter that is not a number")


def leaves_its_input_alone(case: ModelCase) -> None:
    theta = case.theta(0.3, 0.7)
    before = theta.copy()
    first = case.run(case.liveliest, theta)
    require(np.array_equal(theta, before), "parameter sets that the run has changed", "the input as it was")
    position = first.position.copy()
    case.run(case.liveliest, theta[::-1].copy())
    kept = np.array_equal(first.position, position, equal_nan=True)
    require(kept, "an earlier rollout that a later run has changed", "arrays of its own for every rollout")


def is_untouched_by_null_effects(case: ModelCase) -> str | None:
    """Many effects at once, which takes less time; only where the bits differ one by one, to name which it was."""
    if not case.effects:
        return "takes no effects"
    theta, groups = case.theta(0.4), None
    for name, scene in case.scenes.items():
        bare = case.run(scene, theta)
        groups = groups or list(_fitting(case, scene, case.effects))
        for group in groups:
            if _untouched(case, scene, theta, bare, group):
                continue
            alone = [e for e in group if not _untouched(case, scene, theta, bare, [e])]
            culprits = ", ".join(repr(e.name) for e in alone or group)
            found = f"another result with effect {culprits} at its null values in scene {name}"
            require(False, found, "the bits of the bare model")
    return None


def _fitting(case: ModelCase, scene: Scene, effects: Sequence[Effect]) -> Iterator[Sequence[Effect]]:
    """The effects in groups that the model has room for: halved until it takes them."""
    try:
        case.model.prepare(scene, tuple(effects)).run(_beside_nulls(case.theta(), effects))
    except ClothbenchError:
        if len(effects) == 1:
            raise
        half = len(effects) // 2
        yield from _fitting(case, scene, effects[:half])
        yield from _fitting(case, scene, effects[half:])
    else:
        yield effects


def _untouched(case: ModelCase, scene: Scene, theta: np.ndarray, bare: Rollout, effects: Sequence[Effect]) -> bool:
    return same_bits(bare, case.run(scene, _beside_nulls(theta, effects), effects))


def _beside_nulls(theta: np.ndarray, effects: Sequence[Effect]) -> np.ndarray:
    """Parameter sets (B, P) of a model with the effects' null values behind them."""
    return np.hstack([theta, *(np.tile(probe.null_values(e), (len(theta), 1)) for e in effects)])


def lets_effects_act(case: ModelCase) -> str | None:
    """In one scene at least, tried from the liveliest on, at one of several values."""
    if not case.effects:
        return "takes no effects"
    theta = case.theta()
    order = sorted(case.scenes.values(), key=lambda scene: scene is not case.liveliest)
    bare = [case.run(scene, theta) for scene in order]
    for effect in case.effects:
        acts = any(
            not same_bits(alone, case.run_with(scene, theta, (effect, values)))
            for values in probe.acting_values(effect)
            for scene, alone in zip(order, bare, strict=True)
        )
        require(acts, f"nothing changed by effect {effect.name!r}, whatever its values", "a different motion")
    return None


def reports_divergence(case: ModelCase) -> str | None:
    """Steps far too long end single members, by status; nothing is raised and no other member is touched."""
    if not takes_option(case.make, "dt"):
        return "has no option 'dt' to make it diverge with"
    theta, some_lost = case.theta(0.1, 0.3, 0.7, 0.9), False
    for dt in STEPS_TO_TRY:
        try:
            simulation = case.make(dt=float(dt)).prepare(case.liveliest)
        except ClothbenchError:  # it refuses such a step: just as good
            break
        rollout = simulation.run(theta)
        require_whole(rollout, case.liveliest, len(theta), f"a run with dt = {dt:g} s")
        ended = finished(rollout)
        if ended.any() and not ended.all():
            require_independent(simulation.run, theta, f"dt = {dt:g} s, where some members diverge")
        some_lost |= not ended.all()
    return None if some_lost else "no step up to 0.26 s makes it diverge"


def answers_curves_if_it_says_so(case: ModelCase) -> str | None:
    if not answers_curves(case.model):
        return "answers no force-extension curves"
    curves.answers(case.model)
    return None


RULES = (
    has_all_members,
    keeps_what_it_offers,
    gives_whole_rollouts,
    gives_the_same_bits_twice,
    gives_a_batch_as_one_by_one,
    refuses_wrong_parameters,
    leaves_its_input_alone,
    is_untouched_by_null_effects,
    lets_effects_act,
    reports_divergence,
    answers_curves_if_it_says_so,
    *motion.RULES,
    *weight.RULES,
    *contact.RULES,
)
