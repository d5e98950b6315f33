"""Closing the loop: from the residual of a calibrated model to the effect that it lacks, and back to the error.

Settings become a cell (`plan`, `candidates`, `cell`), the cell a problem (`prepare`: evidence beside a model), and the
loop (`loop`, `state`) goes through its stages, a file for each, to a frozen `finding`:

1. calibrate: `fitting` (searches), `fitted` (a fit with its intervals);
2. residual: `refinement` (what the mesh has to do with it), `repeats` (what no model can undercut);
3. attribution: what only a candidate could explain, to first order;
4. screening: `permutation`, a test with the max-statistic over all candidates;
5. `rounds`: the best are fitted in earnest (`refits`, with `jumps` along valleys and fits of `constrained` parameters),
   `selection` names one, or several that are tied, `profile` gives their amounts intervals by profile likelihood;
   `by_recording` tries effects whose amounts differ from recording to recording beside them; what the torques tell
   without any model (7) has to explain no more than pays for its parameters;
6. `held_out`: the one look at the recordings held out, and the placebo; `verdict`: a word and a hint, with the
   `experiment` that would part what is tied;
7. beside it, without any model: the torque about the grips (`motion`, `balance`), what it goes with and how long the
   past counts (`torque`), the sparsest law that predicts it (`law`); and where nothing has a name, that law as an
   effect (`described`), fitted and judged like one (`description`). `whereabouts`: where and when something is left.

Recordings come in as evidence with a unit (`evidence`), of three kinds: `sheets` (with `sheet_tables`), `curves` (with
`curve_steps`) and `drapes` (with `drape_quantities`); the stages know none of them. What is written is made from the
finding alone: `document` (verdict.json), `tables` (`schema`), `page` (with `missing_page`, `words`, `figures`,
`style`), `rerun_file`, and `files`, which puts them in a folder; `common` joins the verdicts of several models.
`settings` holds every constant, `account` what each stage took.
"""
