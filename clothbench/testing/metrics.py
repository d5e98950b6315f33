"""What every metric must keep: zero where nothing is wrong, more where more is, never a made-up number."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable

import numpy as np

from clothbench.core.optional import HasInterval, kinds_read, objectives_of
from clothbench.core.protocols import Metric
from clothbench.testing.metric_case import SIGMA, MetricCase, draped, rollout_of, waving
from clothbench.testing.rules import NotApplicable, Outcome, choose, made, require, require_members, run_rules

NOTHING = 1e-9  # of what an error of 4 mm gives
DRAWS = 60  # noisy observations of which the mean is taken
HONEST = 0.10  # relative, between a floor as stated and as drawn
MOVED = {"per_frame": (3, 15), "per_node": (7, 22)}  # frames, nodes, each wrong on its own; backwards they are others
BESIDE = {"per_frame": 2.5, "per_node": 0.13}  # frames, m: so far reach differences between neighbours, and smoothing
LARGER = (4.0, 8.0, 16.0, 32.0)  # mm: until a metric that counts, or that has a threshold, sees it
SAME_UNIT = 2.0  # a middle value, of whatever kind, is not farther beyond what it is of


def check_metric(make: Callable[..., Metric], *, only: Iterable[str] | None = None) -> tuple[Outcome, ...]:
    """Check the metric that `make()` gives, on a waving sheet made by formula of which a part is not seen, or
    on drapes if those are what it compares; on both, one after the other, if it compares both.
    """
    metric = made(make, "metric")
    kinds, rules = kinds_read(metric), choose(RULES, only)
    cases = {"drapes": draped} if "silhouette" in kinds else {}
    if kinds != {"silhouette"}:
        cases["a waving sheet"] = waving
    name = f"metric {getattr(metric, 'name', make)!r}"
    out: list[Outcome] = []
    for what, case in cases.items():
        out += run_rules(f"{name} on {what}" if len(cases) > 1 else name, rules, case(metric))
    return tuple(out)


def has_all_members(case: MetricCase) -> None:
    require_members(case.metric, Metric, ("name", "version", "unit", "__call__", "floor"))
    unit = case.metric.unit
    require(isinstance(unit, str) and bool(unit.strip()), f"unit {unit!r}", "a unit ('1' if it has none)")
    stated = case.score(case.truth).unit
    require(stated == unit, f"a score in {stated!r}", f"the metric's own unit {unit!r}")


def gives_whole_scores(case: MetricCase) -> None:
    """Shapes as in clothbench.Score; what is never seen is not a number in the trace and on the map."""
    score, members = case.score(case.truth, case.truth + case.error), 2
    frames, nodes = case.observation.visible.shape
    for name, shape in {
        "value": (members,),
        "per_frame": (members, frames),
        "per_node": (members, nodes),
    }.items():
        array = getattr(score, name)
        if array is not None:
            require(array.shape == shape, f"{name} of shape {array.shape}", shape)
    if score.residual is not None:
        shape = np.shape(score.residual)
        require(len(shape) == 2 and shape[0] == members, f"residual of shape {shape}", f"({members}, R)")
    for name, axis in {"per_frame": 1, "per_node": 0}.items():
        array, unseen = getattr(score, name), ~case.observation.visible.any(axis=axis)
        if array is not None:
            require(np.isnan(array[:, unseen]).all(), f"a number in {name} where nothing was seen", "NaN")


def traces_what_it_scores(case: MetricCase) -> str | None:
    """Trace and map are in the unit of the value, and where one frame or one node alone is wrong they say so there.

    Intervals of errors come from the trace. It may reach further than the frame itself, as that of speeds does; that of
    a metric that makes intervals of its own (`HasInterval`) may show what is found of all frames together.
    """
    _require_points(case)
    perfect, wrong = case.score(case.truth), case.score(case.truth + LARGER[0] * case.error)
    given = [name for name in MOVED if getattr(wrong, name) is not None]
    for name in given:
        right, trace = getattr(perfect, name)[0], getattr(wrong, name)[0]
        _require_same_unit(case, name, trace, float(wrong.value[0]))
        same = np.array_equal(right, trace, equal_nan=True)
        require(not same, f"the {name} of a perfect rollout for one that is 4 mm off", "another one")
        if name == "per_frame" and isinstance(case.metric, HasInterval):
            continue
        for at in MOVED[name]:
            _require_trace_of(case, name, at, right)
    return None if given else "has neither trace nor map"


def _require_same_unit(case: MetricCase, name: str, trace: np.ndarray, value: float) -> None:
    """The value lies among the numbers of the trace or map; their signs may differ, and a map's may be added up."""
    known = trace[np.isfinite(trace)]
    require(len(known) > 0, f"{name} without a number, beside a value of {value:.3g} {case.metric.unit}", "some")
    low = 0.0 if known.min() < 0 < known.max() else float(np.abs(known).min())
    high = float(np.abs(known).sum() if name == "per_node" else np.abs(known).max())
    found = f"{name} from {known.min():.3g} to {known.max():.3g}, beside a value of {value:.3g} {case.metric.unit}"
    expected = "numbers in the value's unit, of which it is the mean or the like"
    require(low / SAME_UNIT <= value <= SAME_UNIT * high, found, expected)


def _require_trace_of(case: MetricCase, name: str, at: int, perfect: np.ndarray) -> None:
    """With one frame or node wrong, nothing changes more than it and its neighbours."""
    material, frames = case.observation.material, np.arange(len(case.observation.time))
    away = np.abs(frames - at) if name == "per_frame" else np.linalg.norm(material - material[at], axis=1)
    here = (at,) if name == "per_frame" else (slice(None), at)
    if not np.isfinite(perfect[at]):  # it looks at some only
        return
    for size in LARGER:
        position = case.truth.copy()
        position[here] += size * case.error[here]
        change = np.nan_to_num(np.abs(getattr(case.score(position), name)[0] - perfect))
        if change.any():  # of a metric that takes it for a slip, it never does
            break
    near, far = (change[some].max(initial=0.0) for some in (away < BESIDE[name], away >= BESIDE[name]))
    what = name.removeprefix("per_")
    found = f"{name} that changes by {near:.3g} in the one {what} that is wrong and by {far:.3g} elsewhere"
    require(near >= (1 - 1e-6) * far, found, f"most in that {what}")


def is_zero_for_a_perfect_rollout(case: MetricCase) -> None:
    score = case.score(case.truth)
    value = float(score.value[0])
    require(abs(value) <= NOTHING * case.scale, f"{value:.3g} {case.metric.unit} for a perfect rollout", "0")
    if score.residual is not None:
        largest = np.abs(score.residual).max(initial=0.0)
        require(largest <= 1e-12, f"a residual of {largest:.3g} for a perfect rollout", "0")


def grows_with_the_error(case: MetricCase) -> None:
    scores = case.score(*(case.truth + factor * case.error for factor in (0.5, 1.0, 2.0, 4.0)))
    shown = ", ".join(f"{v:.3g}" for v in scores.value)
    require((np.diff(scores.value) > 0).all(), f"values {shown} for an error doubled thrice", "growing ones")
    if scores.residual is not None:
        squares = (scores.residual**2).sum(axis=1)
        require(
            (np.diff(squares) > 0).all(),
            "squared residuals that do not grow with the error",
            "growing ones",
        )


def says_its_objectives(case: MetricCase) -> str | None:
    """As many objectives in a score as it states, each 0 for a perfect rollout; an interval that is one."""
    objectives, score = objectives_of(case.metric), case.score(case.truth, case.truth + case.error)
    if not objectives and score.objectives is None:
        return "has one value only"
    shape = (2, len(objectives))
    found, spread = (np.zeros(0) if a is None else np.asarray(a) for a in (score.objectives, score.spread))
    require(found.shape == shape, f"objectives of shape {found.shape}", shape)
    require(spread.shape == shape[1:], f"a spread of shape {spread.shape}", shape[1:])
    require(bool((spread > 0).all()), f"spreads {spread}", "numbers above 0")
    largest = float(np.abs(found[0] / spread).max())
    require(largest <= NOTHING, f"an objective of {largest:.3g} spreads for a perfect rollout", "0")
    if isinstance(case.metric, HasInterval):
        rollout = rollout_of(case.observation.time, np.stack([case.truth + 4 * case.error]))
        low, high = case.metric.interval(case.observation, rollout, 0)
        unknown = bool(np.isnan([low, high]).all())
        require(
            unknown or 0 <= low <= high,
            f"an interval from {low:.3g} to {high:.3g}",
            "low up to high, 0 or above, or twice NaN where nothing tells",
        )
    return None


def _require_points(case: MetricCase) -> None:
    if not case.observation.visible.any():
        raise NotApplicable("compares drapes, of which no single point is seen")


def ignores_what_was_not_seen(case: MetricCase) -> None:
    _require_points(case)
    wrong = np.where(case.observation.visible[..., None], case.truth + case.error, 7.0)
    right = case.score(case.truth + case.error).value[0]
    found = case.score(wrong).value[0]
    require(_close(found, right), f"{found:.6g} when only unseen nodes move, {right:.6g} before", "no change")


def gives_no_number_for_a_lost_rollout(case: MetricCase) -> None:
    lost = case.truth + case.error
    late = lost.copy()
    late[len(late) // 2 :] = np.nan
    score = case.score(lost, late, np.full_like(lost, np.nan))
    require(np.isnan(score.value[1:]).all(), f"values {score.value[1:]} for rollouts that were lost", "NaN")
    if score.residual is not None:  # least squares looks at nothing else
        finite = np.isfinite(score.residual[1:]).all(axis=1).any()
        require(not finite, "a finite residual for a rollout that was lost", "NaN in it")
    alone = case.score(lost).value[0]
    require(
        _close(score.value[0], alone),
        f"{score.value[0]:.6g} beside lost rollouts, {alone:.6g} alone",
        "no change",
    )


def gives_no_number_where_nothing_was_seen(case: MetricCase) -> None:
    _require_points(case)
    o = case.observation
    blind = dataclasses.replace(o, position=np.full_like(o.position, np.nan), visible=np.zeros_like(o.visible))
    value = case.score(case.truth, observation=blind).value
    require(np.isnan(value).all(), f"{value[0]:.3g} where no node was seen in any frame", "NaN")


def does_not_care_for_the_order_of_nodes(case: MetricCase) -> None:
    _require_points(case)
    o, order = case.observation, np.random.default_rng(3).permutation(len(case.observation.material))
    shuffled = dataclasses.replace(
        o, position=o.position[:, order], visible=o.visible[:, order], material=o.material[order]
    )
    wrong = case.truth + case.error
    here, there = case.score(wrong).value[0], case.score(wrong[:, order], observation=shuffled).value[0]
    require(_close(here, there), f"{there:.9g} with the nodes in another order, {here:.9g} before", "no change")


def scores_a_batch_as_one_by_one(case: MetricCase) -> None:
    wrong = [case.truth + factor * case.error for factor in (3.0, 0.0, 1.0, -2.0)]
    together = case.score(*wrong)
    for b, position in enumerate(wrong):
        alone = case.score(position)
        for name in ("value", "per_frame", "per_node", "residual"):
            one, many = getattr(alone, name), getattr(together, name)
            equal = (one is None) == (many is None) and (one is None or _close(one[0], many[b]))
            require(equal, f"another {name} of member {b} in a batch than alone", "the same but for rounding")


def states_an_honest_floor(case: MetricCase) -> str | None:
    """The mean value of perfect rollouts against noisy observations is what `floor` says, within a tenth."""
    _require_points(case)
    random, values, floors = np.random.default_rng(8), [], []
    for _ in range(DRAWS):
        noisy = case.observation.position + random.normal(0.0, SIGMA, case.truth.shape)
        observation = dataclasses.replace(case.observation, position=noisy)
        values.append(case.score(case.truth, observation=observation).value[0])
        floors.append(case.metric.floor(observation))
    unknown = case.metric.floor(dataclasses.replace(case.observation, sigma=math.nan))
    require(math.isnan(unknown), f"a floor of {unknown:.3g} for noise that is not known", "NaN")
    drawn, stated = float(np.mean(values)), float(np.mean(floors))
    if math.isnan(stated):
        return "does not know its floor"
    found = f"a floor of {stated:.4g} {case.metric.unit}, where noise alone gives {drawn:.4g}"
    require(abs(stated - drawn) <= HONEST * drawn, found, "the same within 10 %")
    return None


def leaves_its_input_alone(case: MetricCase) -> None:
    position = np.stack([case.truth + case.error])
    before = position.copy()
    first, again = (case.metric(case.observation, rollout_of(case.observation.time, position)) for _ in range(2))
    require(np.array_equal(position, before), "a rollout that scoring has changed", "the input as it was")
    require(
        np.array_equal(first.value, again.value),
        "another value of the same rollout scored again",
        "equal bits",
    )


def _close(one: np.ndarray, other: np.ndarray) -> bool:
    return np.allclose(one, other, rtol=1e-9, atol=1e-15, equal_nan=True)


RULES = (
    has_all_members,
    gives_whole_scores,
    traces_what_it_scores,
    is_zero_for_a_perfect_rollout,
    grows_with_the_error,
    says_its_objectives,
    ignores_what_was_not_seen,
    gives_no_number_for_a_lost_rollout,
    gives_no_number_where_nothing_was_seen,
    does_not_care_for_the_order_of_nodes,
    scores_a_batch_as_one_by_one,
    states_an_honest_floor,
    leaves_its_input_alone,
)
