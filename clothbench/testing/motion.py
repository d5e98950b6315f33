"""What every sheet must do, whatever the model: stay in the grips, ignore the compass, converge, rest."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from clothbench.core.optional import Refinable, repeatability_of, takes_option
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene, initial_velocity
from clothbench.testing import scenes
from clothbench.testing.model_case import ModelCase, apart, finished, millimetres
from clothbench.testing.rules import require

ON_THE_GRIP = 1e-9  # m
INVARIANCE = 1e-6  # m; rounding grows this far in no short run that is not chaotic
MATTERS = 1e-6  # m
SAME_MOMENT = 1e-4  # m: an adaptive step may land elsewhere, a stamp that was ignored costs millimetres
RESTS = 5e-4  # m within half a second: less than a good tracker tells from noise
SHRINKS = 0.8  # of the difference that the step before made; first order would be 0.5
CONVERGED = 1e-6  # m
THROWN, SOON = (0.6, -0.4, 1.2), 5e-3  # m/s, s: so soon that air hardly matters
SAME_CUT = 5e-4  # m between the same sheet described in two ways
HANGS = 2e-3  # m: what a rim 5 cm off its plate sags by at least
THROWN_NEAR = 3e-3  # m: a smooth sheet is put through the points


def follows_the_grips(case: ModelCase) -> str | None:
    if not case.held:
        return "simulates no scene with grips"
    looked_at = {name: scene for name, scene in case.held.items() if len(_shared(scene)[0])}
    if not looked_at:
        return f"no point that is looked at is held in {', '.join(case.held)}"
    ended = 0
    for name, scene in looked_at.items():
        points, grips = _shared(scene)
        rollout = case.run(scene, case.theta(0.3, 0.7))
        ended += finished(rollout).sum()
        seen = rollout.position[finished(rollout)][:, :, points]
        away = np.abs(seen - scene.grips_at(scene.times)[:, grips]).max(initial=0.0)
        found = f"held points {millimetres(away)} from their grips in scene {name}"
        require(away <= ON_THE_GRIP, found, "where Scene.grips_at puts them, within 1e-9 m")
    _require_one_that_ended(ended, looked_at)
    return None


def _require_one_that_ended(ended: int, tried: Iterable[str]) -> None:
    """Where no run came to its end, nothing was compared."""
    require(ended > 0, f"no run that came to its end in {', '.join(tried)}", "one at least")


def moves_along_with_the_room(case: ModelCase) -> None:
    """A room shifted, and turned about the vertical, changes nothing but the coordinates."""
    _require_same_in(case, scenes.turn_about((0.0, 0.0, 1.0), 0.7), with_gravity=False)


def turns_along_with_gravity(case: ModelCase) -> None:
    """A world turned as a whole, gravity included, changes nothing but the coordinates."""
    _require_same_in(case, scenes.turn_about((1.0, 2.0, 3.0), 1.1), with_gravity=True)


def _require_same_in(case: ModelCase, turn: np.ndarray, *, with_gravity: bool) -> None:
    shift = np.array([0.3, -2.0, 0.7])
    for name, scene in case.scenes.items():
        if name == "stretched":  # pure shear may wrinkle, and on which side is for rounding errors to say
            continue
        here = case.run(scene, case.theta(0.4))
        there = case.run(scenes.moved(scene, turn, shift, with_gravity=with_gravity), case.theta(0.4))
        require(here.status == there.status, f"status {there.status} in the turned scene {name}", here.status)
        ended = finished(here)
        away = apart(here.position[ended] @ turn.T + shift, there.position[ended]).max(initial=0.0)
        found = f"a motion {millimetres(away)} off after turning and shifting scene {name}"
        near = _tolerance(case, INVARIANCE)
        require(away <= near, found, f"the same motion, turned and shifted, within {near:g} m")


def _tolerance(case: ModelCase, usual: float) -> float:
    """What counts as the same motion [m]: the usual, or what the model says that it cannot tell apart."""
    return max(usual, repeatability_of(case.model))


def is_pulled_down(case: ModelCase) -> None:
    """Held, the sheet hangs where gravity points; let go, its middle falls by ½ g t², less the air's drag, beside what
    it moved by already. What lies on something does neither, and what is held may have been thrown up.
    """
    for name, scene in case.scenes.items():
        if scene.obstacles or (scene.velocity is not None and len(scene.grip_material)):
            continue
        rollout = case.run(scene, case.theta())
        if rollout.status[0] != "ok":
            continue
        height = _middle(rollout, scene.gravity)
        if len(scene.grip_material):
            below = height - (scene.grips_at(scene.times) @ _down(scene.gravity)).min(axis=1)
            require(
                (below > 0).all(),
                f"a sheet {millimetres(-below.min())} above its highest grip in scene {name}",
                "below",
            )
        else:
            seconds = scene.times[-1] - scene.start_time
            thrown = initial_velocity(scene, scene.points).mean(axis=0) @ _down(scene.gravity) * seconds
            fallen = (height[-1] - height[0] - thrown) / (np.linalg.norm(scene.gravity) / 2 * seconds**2)
            require(
                0.5 < fallen < 1.02,
                f"a fall of {fallen:.3g} × ½ g t² in scene {name}",
                "1, or less by the air's drag",
            )


def lets_every_parameter_matter(case: ModelCase) -> None:
    names = case.model.parameters.names
    largest = np.zeros(len(names))
    for scene in case.scenes.values():
        low, high = (case.run(scene, _one_at_a_time(case, unit)) for unit in (0.3, 0.7))
        ended = finished(low) & finished(high)
        largest[ended] = np.maximum(largest[ended], apart(low.position[ended], high.position[ended]))
    for name, change in zip(names, largest, strict=True):
        found = f"a change of {millimetres(change)} when {name!r} goes from low to high"
        require(change > MATTERS, found, f"more than 1e-3 mm in one of {', '.join(case.scenes)}")


def converges_with_smaller_steps(case: ModelCase) -> str | None:
    if not case.is_dynamic:
        return "takes no time steps"
    if not (takes_option(case.make, "step_scale") or isinstance(case.model, Refinable)):
        return "has neither an option 'step_scale' nor a method 'refined'"
    for name, scene in case.scenes.items():
        whole, half, quarter = (_refined(case, scene, scale) for scale in (1.0, 0.5, 0.25))
        ended = finished(whole) & finished(half) & finished(quarter)
        first = apart(whole.position[ended], half.position[ended])
        second = apart(half.position[ended], quarter.position[ended])
        still_large = second > np.maximum(SHRINKS * first, _tolerance(case, CONVERGED))
        shown = ", ".join(f"{millimetres(a)} → {millimetres(b)}" for a, b in zip(first, second, strict=True))
        require(
            not still_large.any(),
            f"differences {shown} on halving the step twice in scene {name}",
            "shrinking ones",
        )
        more = (np.asarray(quarter.steps) > np.asarray(whole.steps))[ended].all()
        require(
            more,
            f"no more steps with a quarter of the step in scene {name}",
            "about four times as many",
        )
    return None


def respects_uneven_time_stamps(case: ModelCase) -> None:
    for name, scene in case.scenes.items():
        between = scene.times[0] + np.ptp(scene.times) * np.sqrt(np.linspace(0.0123, 0.9234, 9))
        finer = np.union1d(scene.times, between)
        few = case.run(scene, case.theta(0.4))
        many = case.run(scenes.with_times(scene, finer), case.theta(0.4))
        ended = finished(few) & finished(many)
        common = many.position[ended][:, np.isin(finer, scene.times)]
        away = apart(few.position[ended], common).max(initial=0.0)
        found = f"positions {millimetres(away)} apart at the same moment of scene {name}, looked at more often"
        require(away <= SAME_MOMENT, found, "the same within 0.1 mm")


def rests_when_held_still(case: ModelCase) -> str | None:
    """A run begins with the cloth settled in the grips' first pose; where they stay, it stays."""
    if "static" not in case.model.capabilities:
        return "does not claim to find the state of rest"
    if not case.held:
        return "simulates no scene with grips"
    count = 0
    for name, scene in case.held.items():
        rollout = case.run(scenes.still(scene), case.theta(0.3, 0.7))
        ended = rollout.position[finished(rollout)]
        count += len(ended)
        moves = np.abs(ended - ended[:, :1]).max(initial=0.0)
        lasts = f"{np.ptp(scene.times):g} s with the grips left where scene {name} begins"
        found = f"a sheet that moves by {millimetres(moves)} in {lasts}"
        require(moves <= RESTS, found, "at most 0.5 mm")
    _require_one_that_ended(count, case.held)
    return None


def goes_on_from_a_motion(case: ModelCase) -> str | None:
    """A scene that states a velocity begins where its points were seen, moving as they were seen to."""
    if "moving_start" not in case.model.capabilities:
        return "does not claim to start from a motion"
    fall = scenes.free_fall()
    assert fall.start is not None
    velocity = np.broadcast_to(THROWN, fall.start.shape)
    thrown = dataclasses.replace(scenes.with_times(fall, np.array([0.0, SOON])), velocity=velocity)
    rollout = case.run(thrown, case.model.parameters.defaults[None])
    at, later = rollout.position[0]
    away = float(np.abs(at - fall.start).max())
    require(away <= THROWN_NEAR, f"a sheet {millimetres(away)} from where scene free_fall says it is", "at most 3 mm")
    expected = (np.array(THROWN) + 0.5 * SOON * np.array(fall.gravity)) * SOON
    miss = np.linalg.norm((later - at).mean(axis=0) - expected) / np.linalg.norm(expected)
    require(miss <= 0.1, f"a sheet thrown at 1.4 m/s that is {miss:.0%} off after 5 ms", "at most 10 %")
    return None


def cuts_along_the_outline(case: ModelCase) -> str | None:
    """What is cut off neither weighs nor stiffens, and what a disc clamps stays on it while the rest hangs."""
    if "outline" not in case.model.capabilities:
        return "does not claim to cut its mesh along an outline"
    cut, short = (case.run(scene, case.theta(0.5)).position[0, 0] for scene in scenes.cut_and_short())
    away = float(np.linalg.norm(cut - short, axis=1).max())
    require(away <= SAME_CUT, f"a sheet cut to 60 % {millimetres(away)} from one as short", "at most 0.5 mm")
    scene = scenes.draped()
    place = case.run(scene, case.theta(0.5)).position[0, 0] - np.array(scene.obstacles[0].centre)
    on, rim = np.split(place, 2)
    laid = np.column_stack([(scene.points[:24] - 0.12) * [1, -1], np.zeros(24)])
    slid = float(np.linalg.norm(on - laid, axis=1).max())
    require(slid <= RESTS, f"clamped cloth {millimetres(slid)} from where it was laid", "at most 0.5 mm")
    fall = float(-rim[:, 2].mean())
    require(fall > HANGS, f"a rim {millimetres(fall)} below its plate", "one that hangs, by 2 mm at least")
    return None


def is_carried_along(case: ModelCase) -> str | None:
    """Cloth that lies on a rough table goes where the grips carry the table."""
    if "carried_contact" not in case.model.capabilities:
        return "does not claim to know obstacles that the grips carry"
    scene = scenes.carried()
    place = case.run(scene, case.theta(0.5)).position[0]
    table = scene.grips_at(scene.times) - scene.grips_at(scene.times[:1])
    away = float(np.linalg.norm(place - scene.start - table, axis=2).max())
    require(away <= RESTS, f"cloth {millimetres(away)} from where the table carries it", "at most 0.5 mm")
    return None


def _shared(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the points looked at that are grips, and of the grips that they are."""
    shared = np.abs(scene.points[:, None] - scene.grip_material[None]).max(axis=2) < 1e-9
    points, grips = np.nonzero(shared)
    return points, grips


def _down(gravity: tuple[float, float, float]) -> np.ndarray:
    return np.array(gravity) / np.linalg.norm(gravity)


def _middle(rollout: Rollout, gravity: tuple[float, float, float]) -> np.ndarray:
    """How far down the mean of the points is, per frame (T,) m, of the first member."""
    return rollout.position[0].mean(axis=1) @ _down(gravity)


def _one_at_a_time(case: ModelCase, unit: float) -> np.ndarray:
    """Parameter sets (P, P): row p at the defaults but for parameter p, at a share of its scaled range."""
    space = case.model.parameters
    theta = np.tile(space.defaults, (len(space), 1))
    np.fill_diagonal(theta, space.from_unit(np.full(len(space), unit)))
    return theta


def _refined(case: ModelCase, scene: Scene, scale: float) -> Rollout:
    theta = case.theta(0.4)
    if takes_option(case.make, "step_scale"):
        return case.run(scene, theta, step_scale=scale)
    assert isinstance(case.model, Refinable)  # the rule has asked
    return case.model.refined(1 / scale).prepare(scene).run(theta)


RULES = (
    follows_the_grips,
    moves_along_with_the_room,
    turns_along_with_gravity,
    is_pulled_down,
    lets_every_parameter_matter,
    converges_with_smaller_steps,
    respects_uneven_time_stamps,
    rests_when_held_still,
    goes_on_from_a_motion,
    cuts_along_the_outline,
    is_carried_along,
)
