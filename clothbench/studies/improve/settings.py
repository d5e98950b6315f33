"""The constants of the loop, in one record: what each of them is, and in which unit.

"Share" is a fraction of one; "scaled range" is the unit cube of a parameter space; a "round" of a search is one
Jacobian and one batch of damped steps; mean squares are of residuals, over recordings with the same say each.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LoopSettings:
    """Every threshold, count and step of the loop that holds for all kinds of evidence."""

    # Searches.
    sets_per_round: int = 4  # parameter sets that a round tries beside one for each parameter's difference
    calibration_rounds: int = 34  # rounds of the first fit, of all its walks together
    calibration_points: int = 32  # places of the model's range that are looked at anew before a further name
    calibration_fits: int = 3  # of which so many are fitted from
    refit_rounds: int = 8  # rounds of a fit that begins where another ended
    single_rounds: int = 3  # rounds of a fit to one recording
    final_rounds: int = 17  # rounds by which the fit with a named effect is continued
    polish_rounds: int = 5  # rounds of a search that makes sure that another has not ended early
    polish_limit: int = 4  # such searches in a row at most
    polish_points: int = 7  # starts looked at for one of them
    polish_reach: float = 1.25  # times the goal: a fit that leaves more will not come to it so (seen: a tenth at most)
    polish_radius: float = 0.1  # standard deviation of those starts about the fit, of the scaled range
    least_gain: float = 0.005  # share of the sum of squares; cloth that wrinkles gives as much by chance
    trend_rounds: int = 2  # rounds by whose fall it is judged whether a search can still reach its goal
    multistart_shapes: int = 2  # shape parameters from which on an effect is taken to have several valleys
    multistart_points: int = 16  # places of its range that are then looked at
    multistart_fits: int = 2  # of which so many are fitted from

    # Intervals.
    least_recordings: int = 3  # recordings that an interval takes: each is left out once
    model_discrepancy: float = 0.2  # share (amplitude) of the residual above the noise that may look like a parameter

    # Discretisation.
    halvings: int = 2  # of the cells, at most, until what the mesh may be wrong by lies below the noise
    richardson: float = 4 / 3  # times the change by halved cells: the whole error, where it is of second order
    refinement_offset: float = 0.05  # how far from a fit the mesh's error is looked at, of the scaled range

    stages: int = 20  # version of what the stages do and write: a cell of another one is asked anew

    # Attribution.
    shape_settings: int = 4  # settings of an effect's shape parameter that are looked at; twice as many of several
    scouts: int = 2  # recordings, those that leave most, on which the best of these settings is looked for
    default_step: float = 0.1  # of the range: the step of an amount that has no default of its own
    large_step: float = 5.0  # times the default step: wrinkling hides the answer to anything small
    exchanged_settings: int = (
        2  # best settings of an effect with several shapes that are tried in exchange with the base
    )
    exchange_factor: float = 10.0  # by which factor the exchanged amount may differ from the one tried, or its inverse
    exchange_shift: float = 0.2  # of the scaled range: how far the base moves to make up for a candidate
    ridge: float = 1e-6  # of the squares of all columns, added to the diagonal

    # Screening: the permutation test with the max-statistic.
    significance: float = 0.05  # a candidate's p-value has to lie below
    permutations: int = 199  # surrogate residuals that are drawn
    permutation_batch: int = 20  # of them held in memory at once
    rank_tolerance: float = 1e-6  # share of a candidate's squares; less is rounding and the error of differences
    rescreened: int = 10  # candidates that a later round simulates anew
    refitted: int = 4  # candidates that are fitted in earnest in each round
    refit_share: float = 0.3  # of the best explained variance, from which on a candidate is fitted
    first_order_optimism: float = 3.0  # times that first order may promise less than a refit gains (seen: up to twice)

    # Selection.
    floor_factor: float = 1.15  # times the floor: a residual this small is not worth a name
    least_explained: float = 0.25  # share of the mean square above the floor that an effect has to explain
    least_explained_otherwise: float = 0.5  # in drapes, from first shapes that nothing was fitted with
    least_explained_at_floor: float = 0.45  # the same above the noise, where the mesh alone may stand for the residual
    tie_margin: float = 0.1  # share of what two candidates leave (mean square) by which they cannot be told apart
    alike_correlation: float = 0.8  # of what two candidates correct, from which on they may be the same
    rival_correlation: float = 0.5  # of the same, from which on the error of the mesh may decide between them
    parameter_penalty: float = 0.05  # share of the mean square that every further parameter has to pay
    away_from_null: float = 1e-3  # of its range: an amount this near to its null value is none
    tied: int = 3  # effects that are named together at most, where they cannot be told apart
    limit_steps: int = 2  # Gauss-Newton steps of the others beside an effect at its limit
    finalists: int = 3  # candidates whose fits are made sure of before they are compared

    # Amounts by recording.
    fitted_by_recording: int = 4  # effects that are fitted so
    turns_by_recording: int = 3  # times what is shared and what is each recording's own are fitted in turn, at most
    parts_of_recording: int = 8  # parts of its time, each left out once for an interval

    # Profile likelihood.
    profile_start: float = 1.5  # half-widths to be reported at which a parameter is held first
    profile_end: float = 12.0  # and at last
    profile_overshoot: float = 2.0  # times too high a rise, beyond which a nearer point is asked for
    profile_steps: int = 5  # Gauss-Newton steps of the others at each: too few, and a valley is taken for its wall
    jump_factor: float = 2.0  # by which an amount is changed at once to get out of a local minimum
    jump_steps: int = 2  # Gauss-Newton steps of the others there
    jump_limit: int = 4  # jumps in a row at most
    jump_rounds: int = 1  # rounds of the search after a jump, where only a comparison of candidates is at stake
    final_jumps: int = 1  # jumps of the fit with a named effect, each followed by whole searches
    final_jump_margin: float = 0.5  # share of the mean square by which such a jump may at first be worse

    # Another valley than the one that a calibration went down.
    valley_moves: tuple[float, ...] = (-0.4, -0.2, 0.2, 0.4)  # of the scaled range, of each parameter of the model
    least_valley: float = 0.05  # share of the mean square that a better valley takes off
    valley_margin: float = 1.0  # share of the mean square by which such a move may at first be worse
    valley_fits: int = 4  # parameters from whose best move a search goes on
    valley_turns: int = 3  # times that one is looked for so, at most, each from the best so far

    # Repeated motions.
    repeat_distance: float = 0.05  # of a grip's own motion, within which another repeats it, but for their noise
    repeat_distance_floor: float = 1e-3  # m, the same for grips that hardly move
    repeat_overlap: float = 0.8  # share of the shorter recording over which it has to
    repeat_samples: int = 200  # of a grip's path, to compare it by
    repeat_frame_distance: float = 0.1  # of a frame's time, within which frames of two recordings are compared

    @property
    def least_explained_in_all(self) -> float:
        """Share that all names together have to explain: what is left must not be worth another."""
        return 1 - self.least_explained


@dataclass(frozen=True)
class SearchSettings:
    """How searches go about one kind of evidence: rollouts may be dear and rippled, or cheap and smooth."""

    difference: float = (
        0.1  # step of finite differences, of the scaled range; a shorter one sees the ripples of wrinkles
    )
    tolerance: float = 0.005  # relative gain in the sum of squares below which rounds in a row end a search
    contest_tolerance: float = (
        0.02  # the same of a search between candidates, if that is more: far below the tie margin
    )
    patience: int = 2  # rounds in a row that gain less, after which a search ends
    starts: int = 31  # points of a first search that are looked at beside the defaults
    walks: int = 4  # from how many of the best of them it sets out
    restart_starts: int = 0  # the same of a search that begins at a known point
    restart_walks: int = 1
    budget_factor: int = 1  # times the parameter sets that the rounds of a search take
    rounds: int = 3  # effects that can be named one after the other
    contention: float = 1.5  # times the least mean square that any leaves: a candidate that leaves more is given up
    # Share of the squares of what a candidate changes that has to be its own, beside the base's sensitivities. Of a few
    # quantities all that is left has one direction, and the error of differences would explain as much as any effect.
    least_own: float = 0.0
    chance_recordings: int = 1  # to fit, of which chance is told
    together: bool = (
        False  # several amounts of one effect may do the same: it is enough that they together are something
    )
    steps: bool = False  # a name stands for what it adds, whatever else is missing, if it holds on what was held out
    generalisation: float = 1.5  # times the floor: a model that leaves more on held-out recordings lacks something


LOOP = LoopSettings()
