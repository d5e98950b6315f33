"""What every optimizer must keep: seeded, in bounds and budget, unmoved by lost runs, better than chance."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from clothbench.core.optional import HasStart, HasTemperature, Renewable, takes_option
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Optimizer
from clothbench.testing.rules import Outcome, choose, require, require_members, run_rules
from clothbench.testing.toys import Problem, bowl, cornered, partly_lost, plain, valley, wholly_lost

BUDGET = 150
SEEDS = range(6)
RANDOM_SEARCHES = 200
BETTER_THAN_CHANCE = 0.65  # share of comparisons with random search that are won; random search itself wins half


@dataclass(frozen=True, eq=False)
class Search:
    """One whole search: what was asked (E, P), the values told (E,), and why it stopped."""

    theta: np.ndarray
    value: np.ndarray
    stopped: str

    @property
    def best(self) -> float:
        """The lowest value found, infinite if none could be computed."""
        return float(np.min(np.where(np.isnan(self.value), np.inf, self.value)))


@dataclass(frozen=True, eq=False)
class OptimizerCase:
    make: Callable[..., Optimizer]

    def search(self, problem: Problem, seed: int = 0, budget: int = BUDGET) -> Search:
        """A whole search by an optimizer of its own."""
        return played(self.make(problem.space, seed=seed, budget=budget), problem, budget)


def played(optimizer: Optimizer, problem: Problem, budget: int) -> Search:
    """Play the caller's part: ask, evaluate, tell, until it is done; bounds and budget are watched, so that one that
    never ends is stopped. One that says that it needs no residual gets none, as of a metric that has none.
    """
    asked, told = [], []
    while not optimizer.done:
        theta = optimizer.ask()
        require_in_bounds(theta, problem.space)
        asked.append(np.array(theta))
        evaluation = problem.evaluate(theta)
        if optimizer.needs_residual is False:
            evaluation = dataclasses.replace(evaluation, residual=None)
        told.append(np.array(evaluation.value))
        spent = sum(map(len, asked))
        require(
            spent <= budget,
            f"{spent} evaluations asked on {problem.name}",
            f"at most the budget of {budget}",
        )
        optimizer.tell(asked[-1].copy(), evaluation)
        kept = np.array_equal(evaluation.value, told[-1], equal_nan=True)
        require(kept, "values that `tell` has changed", "those that it was told")
    require(len(asked) > 0, "a search that is done before it began", "at least one evaluation")
    return Search(np.vstack(asked), np.concatenate(told), optimizer.stopped)


def check_optimizer(make: Callable[..., Optimizer], *, only: Iterable[str] | None = None) -> tuple[Outcome, ...]:
    """Check the optimizer that `make(space, seed=…, budget=…)` gives, on toy fits of 1, 3 and 6 parameters."""
    name = getattr(make, "name", getattr(make, "__name__", make))
    return run_rules(f"optimizer {name!r}", choose(RULES, only), OptimizerCase(make))


def require_in_bounds(theta: np.ndarray, space: ParameterSpace) -> None:
    whole = isinstance(theta, np.ndarray) and theta.ndim == 2 and theta.shape[1] == len(space) and len(theta) > 0
    kind = "" if isinstance(theta, np.ndarray) else f"{type(theta).__name__}, "
    require(whole, f"a batch, {kind}of shape {np.shape(theta)}", f"(B, {len(space)}) with B at least 1")
    require(np.isfinite(theta).all(), "parameter sets that are not finite", "finite ones")
    outside = (theta < space.low) | (theta > space.high)
    if outside.any():
        b, p = np.argwhere(outside)[0]
        parameter = space.parameters[p]
        require(False, f"{parameter.name} = {theta[b, p]:.6g} asked", f"within its bounds {parameter.bounds}")


def has_all_members(case: OptimizerCase) -> None:
    optimizer = case.make(bowl().space, seed=0, budget=10)
    members = ("name", "version", "needs_residual", "done", "stopped", "ask", "tell")
    require_members(optimizer, Optimizer, members)
    require(
        isinstance(optimizer.needs_residual, bool),
        f"needs_residual {optimizer.needs_residual!r}",
        "True or False",
    )
    require(optimizer.done is False, f"done = {optimizer.done!r} at the start", "False")


def keeps_what_it_offers(case: OptimizerCase) -> None:
    """The optional parts of `clothbench.core.optional` that it has are what they should be."""
    problem = bowl()
    space = problem.space
    optimizer = case.make(space, seed=0, budget=BUDGET)
    played(optimizer, problem, BUDGET)
    if isinstance(optimizer, HasTemperature):
        hot = optimizer.temperature_now
        fine = isinstance(hot, int | float | np.number) and not isinstance(hot, bool) and not hot < 0
        require(fine, f"temperature_now {hot!r}", "a number, 0 or above, or NaN before it cools")
    if isinstance(optimizer, HasStart) and optimizer.start is not None:
        require_in_bounds(np.atleast_2d(optimizer.start), space)
    if takes_option(case.make, "start"):
        first = case.make(space, seed=0, budget=BUDGET, start="defaults").ask()
        near = np.abs(space.to_unit(first) - space.to_unit(space.defaults)).max(axis=1)
        require(near.min() < 1e-9, "a search with start='defaults' that asks for other points", "the defaults first")
    if isinstance(optimizer, Renewable):
        optimizer.renew()
        require(not optimizer.done, "done = True after renew()", "a search that goes on")
        require_in_bounds(optimizer.ask(), space)


def gives_the_same_search_for_the_same_seed(case: OptimizerCase) -> None:
    np.random.seed(1)  # noqa: NPY002 (whoever draws from the global generator shall see it differ)
    first = case.search(bowl(), seed=3)
    np.random.seed(2)  # noqa: NPY002
    again = case.search(bowl(), seed=3)
    require(np.array_equal(first.theta, again.theta), "other points asked with the same seed", "equal bits")


def stays_within_bounds_and_budget(case: OptimizerCase) -> None:
    """Also where the optimum lies in a corner of the box, which tempts a search to step out of it, where there is none,
    and with a single parameter.
    """
    for problem in (bowl(), valley(), cornered(), plain(), bowl(1), plain(1)):
        for budget in (BUDGET, 37):
            case.search(problem, budget=budget)


def manages_with_a_budget_of_one(case: OptimizerCase) -> None:
    search = case.search(bowl(), budget=1)
    require(len(search.value) == 1, f"{len(search.value)} evaluations", "1")


def says_why_it_stopped(case: OptimizerCase) -> None:
    stopped = case.search(bowl()).stopped
    require(isinstance(stopped, str) and bool(stopped.strip()), f"stopped = {stopped!r} when done", "a reason")


def copes_with_lost_runs(case: OptimizerCase) -> None:
    """A third of the space cannot be simulated; then nothing at all can."""
    for seed in SEEDS:
        search = case.search(partly_lost(), seed=seed)
        where = "where a third of the space cannot be simulated"
        require(np.isfinite(search.best), f"no value at all {where}", "a search of the rest")
        typical = np.nanmedian(random_best(partly_lost(), 1))
        require(
            search.best < typical,
            f"a best value of {search.best:.3g} {where}",
            f"below a random guess, {typical:.3g}",
        )
    case.search(wholly_lost())


def beats_random_search(case: OptimizerCase) -> None:
    """Equal budgets, two toy fits, several seeds: the best value found against those of many random searches.

    With six parameters: over two or three, random search is hard to beat and the comparison would say little.
    """
    shares = []
    for problem in (bowl(6), valley(6)):
        chance = random_best(problem, BUDGET)
        shares += [np.mean(chance > case.search(problem, seed=seed).best) for seed in SEEDS]
    share = float(np.mean(shares))
    found = f"better than random search in {100 * share:.0f} % of comparisons with {BUDGET} evaluations"
    require(share >= BETTER_THAN_CHANCE, found, f"at least {100 * BETTER_THAN_CHANCE:.0f} %")


def random_best(problem: Problem, budget: int) -> np.ndarray:
    """The best values (RANDOM_SEARCHES,) of random searches in the scaled space; NaN if all was lost."""
    shape = (RANDOM_SEARCHES, budget, len(problem.space))
    unit = np.random.default_rng(99).random(shape).reshape(-1, shape[-1])
    value = problem.evaluate(problem.space.from_unit(unit)).value.reshape(shape[:2])
    best = np.where(np.isnan(value), np.inf, value).min(axis=1)
    return np.where(np.isinf(best), np.nan, best)


RULES = (
    has_all_members,
    keeps_what_it_offers,
    gives_the_same_search_for_the_same_seed,
    stays_within_bounds_and_budget,
    manages_with_a_budget_of_one,
    says_why_it_stopped,
    copes_with_lost_runs,
    beats_random_search,
)
