"""What every optimizer must keep: seeded, within bounds and budget, not thrown by a lost run, and better than chance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from clothbench.parameters import Parameter, ParameterSpace
from clothbench.protocols import Evaluation, Optimizer
from clothbench.testing.rules import Outcome, choose, require, require_members, run_rules

BUDGET = 150
SEEDS = range(6)
RANDOM_SEARCHES = 200
BETTER_THAN_CHANCE = (
    0.65  # share of comparisons with random search that are won; random search itself wins half
)


@dataclass(frozen=True)
class Problem:
    """A toy fit: `residuals` maps the unit cube (B, P) to (B, R); its squares vanish at one point inside."""

    name: str
    space: ParameterSpace
    residuals: Callable[[np.ndarray], np.ndarray]
    lost: Callable[[np.ndarray], np.ndarray] = field(default=lambda unit: np.zeros(len(unit), dtype=bool))

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Value √Σr² (B,) and residual (B, R) of theta (B, P); not a number where the run is lost."""
        unit = self.space.to_unit(theta)
        residual = np.where(self.lost(unit)[:, None], np.nan, self.residuals(unit))
        return Evaluation(np.sqrt((residual**2).sum(axis=1)), residual)


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
        """Play the caller's part: ask, evaluate, tell, until it is done. Bounds, shapes and budget are watched."""
        optimizer, asked, told = self.make(problem.space, seed=seed, budget=budget), [], []
        while not optimizer.done:
            theta = optimizer.ask()
            require_in_bounds(theta, problem.space)
            asked.append(np.array(theta))
            evaluation = problem.evaluate(theta)
            told.append(evaluation.value)
            spent = sum(map(len, asked))
            require(
                spent <= budget,
                f"{spent} evaluations asked on {problem.name}",
                f"at most the budget of {budget}",
            )
            optimizer.tell(theta, evaluation)
        require(len(asked) > 0, "a search that is done before it began", "at least one evaluation")
        return Search(np.vstack(asked), np.concatenate(told), optimizer.stopped)


def check_optimizer(
    make: Callable[..., Optimizer], *, only: Iterable[str] | None = None
) -> tuple[Outcome, ...]:
    """Check the optimizer that `make(space, seed=…, budget=…)` gives, on toy fits with three and six parameters."""
    name = getattr(make, "name", getattr(make, "__name__", make))
    return run_rules(f"optimizer {name!r}", choose(RULES, only), OptimizerCase(make))


def require_in_bounds(theta: np.ndarray, space: ParameterSpace) -> None:
    whole = (
        isinstance(theta, np.ndarray) and theta.ndim == 2 and theta.shape[1] == len(space) and len(theta) > 0
    )
    require(whole, f"a batch of shape {np.shape(theta)}", f"(B, {len(space)}) with B at least 1")
    require(bool(np.isfinite(theta).all()), "parameter sets that are not finite", "finite ones")
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


def gives_the_same_search_for_the_same_seed(case: OptimizerCase) -> None:
    np.random.seed(1)  # noqa: NPY002 (whoever draws from the global generator shall see it differ)
    first = case.search(bowl(), seed=3)
    np.random.seed(2)  # noqa: NPY002
    again = case.search(bowl(), seed=3)
    require(np.array_equal(first.theta, again.theta), "other points asked with the same seed", "equal bits")


def stays_within_bounds_and_budget(case: OptimizerCase) -> None:
    """The optimum lies in a corner of the box, which tempts a search to step out of it."""
    for problem in (bowl(), valley(), cornered()):
        for budget in (BUDGET, 37):
            case.search(problem, budget=budget)


def manages_with_a_budget_of_one(case: OptimizerCase) -> None:
    search = case.search(bowl(), budget=1)
    require(len(search.value) == 1, f"{len(search.value)} evaluations", "1")


def says_why_it_stopped(case: OptimizerCase) -> None:
    stopped = case.search(bowl()).stopped
    require(
        isinstance(stopped, str) and bool(stopped.strip()), f"stopped = {stopped!r} when done", "a reason"
    )


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

    With six parameters, since over two or three a random search is hard to beat and the comparison would say little.
    """
    shares = []
    for problem in (bowl(6), valley(6)):
        chance = random_best(problem, BUDGET)
        shares += [np.mean(chance > case.search(problem, seed=seed).best) for seed in SEEDS]
    share = float(np.mean(shares))
    found = (
        f"a better value than random search in {100 * share:.0f} % of comparisons with {BUDGET} evaluations"
    )
    require(share >= BETTER_THAN_CHANCE, found, f"at least {100 * BETTER_THAN_CHANCE:.0f} %")


def random_best(problem: Problem, budget: int) -> np.ndarray:
    """The best values (RANDOM_SEARCHES,) of uniform random searches in the scaled space; NaN if all was lost."""
    shape = (RANDOM_SEARCHES, budget, len(problem.space))
    unit = np.random.default_rng(99).random(shape).reshape(-1, shape[-1])
    value = problem.evaluate(problem.space.from_unit(unit)).value.reshape(shape[:2])
    best = np.where(np.isnan(value), np.inf, value).min(axis=1)
    return np.where(np.isinf(best), np.nan, best)


# --- toy fits --------------------------------------------------------------------------------------------------------

BOTTOM = np.array([0.62, 0.31, 0.73, 0.44, 0.17, 0.81])  # of the bowl, in the unit cube; nowhere special


def bowl(count: int = 3) -> Problem:
    """A tilted bowl over parameters of different scale: r = A (u − u*), condition number about 10."""
    return Problem("a bowl", _space(count), _linear(BOTTOM[:count]))


def cornered() -> Problem:
    return Problem("a bowl with its bottom in a corner", _space(3), _linear(np.array([1.0, 0.0, 1.0])))


def valley(count: int = 3) -> Problem:
    """The curved valley of Rosenbrock (1960), chained: r = (3 (x_{i+1} − x_i²), 1 − x_i), its bottom at x = 1."""

    def residuals(unit: np.ndarray) -> np.ndarray:
        x = 2 * unit - 0.5
        return np.hstack([3 * (x[:, 1:] - x[:, :-1] ** 2), 1 - x[:, :-1]])

    return Problem("a curved valley", _space(count), residuals)


def partly_lost() -> Problem:
    return Problem(
        "a bowl a third of which is lost", bowl().space, bowl().residuals, lambda unit: unit[:, 0] < 1 / 3
    )


def wholly_lost() -> Problem:
    return Problem(
        "a bowl that is lost", bowl().space, bowl().residuals, lambda unit: np.ones(len(unit), dtype=bool)
    )


def _linear(bottom: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """u → A (u − bottom), every direction weighted differently and coupled to the next one."""
    identity = np.eye(len(bottom))
    shape = np.diag(np.geomspace(3.0, 1.0, len(bottom))) + 0.7 * np.roll(identity, 1, axis=1)
    return lambda unit: (unit - bottom) @ shape.T


def _space(count: int) -> ParameterSpace:
    """Linear and logarithmic parameters by turns, over ranges such as stiffness and damping have."""
    kinds = (((1.0, 1e4), "log", 20.0), ((-0.5, 2.0), "linear", 0.1), ((1e-7, 1e-3), "log", 1e-6))
    return ParameterSpace(
        tuple(Parameter(f"p{i}", f"p{i}", "1", *kinds[i % 3], "of a toy fit", "none") for i in range(count))
    )


RULES = (
    has_all_members,
    gives_the_same_search_for_the_same_seed,
    stays_within_bounds_and_budget,
    manages_with_a_budget_of_one,
    says_why_it_stopped,
    copes_with_lost_runs,
    beats_random_search,
)
