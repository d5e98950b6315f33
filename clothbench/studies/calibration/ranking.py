"""Which way to calibrate is better: errors recording by recording, paired, with all seeds; ties where noise decides.

A way is a model with its effects, an optimizer and the metric that was minimised, fitted to the same recordings with
the same settings; seeds are repetitions of it, and of one seed one cell counts, however often it was run.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clothbench.core.statistics import student, t_interval
from clothbench.display.html import group
from clothbench.display.names import cell_name, model_name
from clothbench.engine.cells import digest
from clothbench.estimation.intervals import half_width

Rows = Sequence[dict[str, Any]]
NOTHING_HELD_OUT = "nothing held out"
FEW = 3  # recordings (or seeds) from which on a spread says something


@dataclass(frozen=True)
class Standing:
    """What one way comes to in one case by one metric.

    key: of its best cell; value: mean over the recordings of a split, over all seeds; errors: by recording, the values
    of all seeds, with half the width of their intervals where they are known; floor: of noise alone, or None; whole:
    "1 of 3 seeds" where not all of them came to a number: there is no value then, which the others alone would flatter;
    unjudged: why nothing failed where there is no number: "nothing held out", or "not judged by fold".
    """

    way: str
    case: str
    key: str
    split: str
    value: float | None
    errors: Mapping[str, tuple[float, ...]]
    halves: Mapping[str, float] = field(default_factory=dict)
    floor: float | None = None
    status: str = "ok"
    reason: str = ""
    whole: str = ""
    unjudged: str = ""

    @property
    def seeds(self) -> int:
        return max(map(len, self.errors.values()), default=0)

    @property
    def means(self) -> dict[str, float]:
        """The mean over seeds of each recording."""
        return {name: float(np.mean(values)) for name, values in self.errors.items()}


def way_of(rows: Rows) -> Callable[[dict[str, Any]], str]:
    """What to call a row's way: its model, with its effects where others are tried too, and whatever else differs."""
    told = [(name, word) for name, word in (("optimizer", "{}"), ("objective", "by {}")) if differ(rows, name)]
    marks, effects = marks_of(rows), group(rows, lambda r: r["model"])
    plain = {model for model, some in effects.items() if len({r["effects"] or "" for r in some}) == 1}

    def name(row: dict[str, Any]) -> str:
        model = row["model"] if row["model"] in plain else model_name(row)
        return " · ".join([model, *(word.format(row.get(n)) for n, word in told), *marks(row)])

    return name


def marks_of(rows: Rows) -> Callable[[dict[str, Any]], list[str]]:
    """What else tells a row's way from others of its model, optimizer and objective, in words: its budget, settings and
    what it was fitted to, each where it differs.
    """
    budgets, settings = differ(rows, "budget"), differ(rows, "settings")
    fitted: dict[str, set[str]] = {}
    for row in rows:
        if row["split"] == "fit" and row["recording"]:
            fitted.setdefault(row["key"], set()).add(row["recording"].removeprefix(f"{row['case']}/"))
    cases = group([r for r in rows if r["key"] in fitted], lambda r: r["case"])
    several = {case for case, some in cases.items() if len({frozenset(fitted[r["key"]]) for r in some}) > 1}

    def marks(row: dict[str, Any]) -> list[str]:
        names = sorted(fitted.get(row["key"], ())) if row["case"] in several else []
        words = [f"{row.get('budget')} evaluations" if budgets else "", set_otherwise(row) if settings else ""]
        return [word for word in (*words, f"fitted to {_told(names)}" if names else "") if word]

    return marks


def set_otherwise(row: Mapping[str, Any]) -> str:
    """How its cell is set otherwise than its rivals (`with_settings`), "" where it is not; else by a digest."""
    known = row.get("told")
    return f"settings {row.get('settings')}" if known is None else str(known)


def cell_names(rows: Rows) -> dict[str, str]:
    """What each cell is called in a heading, by key: with what tells it from the others of these rows; by the beginning
    of its key, which `view` and `export` take, where that is only what it reports or what is asked of the fit.
    """
    marks = marks_of(rows)
    names = {key: " · ".join([cell_name(r), *marks(r)]) for key, r in {r["key"]: r for r in rows}.items()}
    times = Counter(names.values())
    return {key: name if times[name] == 1 else f"{name} · {key[:8]}" for key, name in names.items()}


def _told(names: Sequence[str]) -> str:
    """A few names as they are; many by their number, with a digest that tells them from as many others."""
    return ", ".join(names) if len(names) <= FEW else f"{len(names)} recordings ({digest(list(names), 6)})"


def differ(rows: Rows, name: str) -> bool:
    """Whether rows differ in this; of settings, rows of one model, optimizer and objective in one case: a fabric may
    have bounds of its own.
    """
    same = ("case", "optimizer", "objective")
    known = group(rows, lambda r: (model_name(r), *map(r.get, same)) if name == "settings" else "all")
    return any(len({r.get(name) for r in some}) > 1 for some in known.values())


def once(rows: Rows) -> list[dict[str, Any]]:
    """Rows of one way, by seed, of which one cell counts of each seed, case, recording and metric: the last with a
    number. The same search with another `report` or `analysis` is another cell, and repeats a number that is known.
    """
    about = ("case", "recording", "split", "metric", "seed")
    by_age = sorted(rows, key=lambda r: (r["value"] is not None, r.get("finished") or ""))
    last = {tuple(map(r.get, about)): r for r in by_age}
    return sorted(last.values(), key=lambda r: r["seed"] or 0)


def standings(rows: Rows, metric: str) -> dict[str, dict[str, Standing]]:
    """Case → way → standing by this metric: on held-out recordings, or on fitted ones where there are none at all."""
    name, out = way_of(rows), {}
    split = "held_out" if any(r["split"] == "held_out" for r in rows) else "fit"
    for case, mine in group(rows, lambda r: r["case"]).items():
        ways = group(mine, name)
        out[case] = {way: _standing(way, case, split, metric, some) for way, some in ways.items()}
    return out


def _standing(way: str, case: str, split: str, metric: str, rows: Rows) -> Standing:
    mine = once([r for r in rows if r["split"] == split and r["metric"] == metric and r["recording"]])
    known = group([r for r in mine if r["value"] is not None], lambda r: r["recording"])
    bad = next((r for r in rows if r["status"] != "ok"), None)
    status, reason = (str(bad["status"]), str(bad["reason"] or "")) if bad else ("ok", "")
    told = seeds_told(rows, metric, split)
    whole = bool(mine) and not told and len(known) == len({r["recording"] for r in mine})
    errors = {n: tuple(r["value"] for r in some) for n, some in known.items()}
    halves = {n: float(np.mean([half_width(r) for r in some])) for n, some in known.items()}
    floors = [r["floor"] for r in mine]
    return Standing(
        way, case, best_cell(rows), split, float(np.mean([np.mean(e) for e in errors.values()])) if whole else None,
        errors, halves, float(np.mean(floors)) if floors and None not in floors else None,
        status, reason, told, "" if mine else _unjudged(split, metric, rows),
    )  # fmt: skip


def _unjudged(split: str, metric: str, rows: Rows) -> str:
    """Why a way has no row of a split by a metric although it was fitted; nothing where it was not."""
    fitted = [r for r in rows if r["recording"]]
    if not fitted:
        return ""
    return f"not judged by {metric}" if any(r["split"] == split for r in fitted) else NOTHING_HELD_OUT


def ranked_cases(found: Mapping[str, Mapping[str, Standing]]) -> dict[str, Mapping[str, Standing]]:
    """The cases that ways are ranked over: those in which every way has a recording of the split that counts; where
    there are none, as of single runs on other recordings each, those in which some way has.
    """
    held = {n: [s.unjudged != NOTHING_HELD_OUT for s in case.values()] for n, case in found.items()}
    whole = {n: case for n, case in found.items() if all(held[n])}
    return whole or {n: case for n, case in found.items() if any(held[n])}


def seeds_told(rows: Rows, metric: str, split: str | None = None) -> str:
    """Of how many fits of one way in one case every recording has a number by a metric: "1 of 3 seeds"; nothing where
    all have, or none. split: of the recordings, None: all of them.
    """
    seeds: dict[Any, bool] = {}  # whether some cell of it came to a number
    for fit in group(rows, lambda r: r["key"]).values():
        judged = [r for r in fit if r["recording"] and split in (None, r["split"])]
        values = [r["value"] for r in judged if r["metric"] == metric]
        if values or not any(r["recording"] for r in fit):  # else it was not judged by this metric, or in this split
            seeds[fit[0]["seed"]] = seeds.get(fit[0]["seed"], False) or (bool(values) and None not in values)
    done, asked = sum(seeds.values()), len(seeds)
    return f"{done} of {asked} seeds" if 0 < done < asked else ""


def best_cell(rows: Rows) -> str:
    """Key of the cell with the least error on what it was fitted to, by what it was fitted by: of several seeds, the
    one that somebody would take.
    """
    return str((fitted_totals(rows) or rows)[0]["key"])


def fitted_totals(rows: Rows) -> list[dict[str, Any]]:
    """Rows over all that was fitted together, by what it was fitted by, that came to a number; the best first."""
    found = [
        r for r in rows
        if r["split"] == "fit" and not r["recording"] and r["metric"] == r["objective"] and r["value"] is not None
    ]  # fmt: skip
    return sorted(found, key=lambda r: (r["value"], r["key"]))


def best_of(standing: Mapping[str, Standing]) -> list[str]:
    """The way with the least error in a case, and all that are tied with it; nothing where no way has a number."""
    known = alike(standing)
    if not known:
        return []
    first = min(known, key=lambda w: known[w].value or 0.0)
    return [first, *(w for w in known if w != first and tied(known[first], known[w], pairs_of(known)))]


def pairs_of(ways: Collection[str]) -> int:
    """How many pairs of ways may be compared, 1 at least: which of them is compared with the best, chance decides."""
    return max(1, math.comb(len(ways), 2))


def alike(standing: Mapping[str, Standing]) -> dict[str, Standing]:
    """The ways with a number in a case, over the recordings that all of them have, of which alone their means say which
    is better; over their own ones where they have none in common.
    """
    known = {way: s for way, s in standing.items() if s.value is not None}
    shared = set.intersection(*(set(s.errors) for s in known.values())) if known else set()
    if not shared:
        return known
    kept = {way: {n: e for n, e in s.errors.items() if n in shared} for way, s in known.items()}
    mean = {way: float(np.mean([np.mean(e) for e in errors.values()])) for way, errors in kept.items()}
    return {way: replace(s, errors=kept[way], value=mean[way]) for way, s in known.items()}


def left_out(standing: Mapping[str, Standing]) -> set[str]:
    """Recordings of a case that only some of its ways with a number have, over which they are not compared."""
    compared = alike(standing)
    return {n for way in compared for n in standing[way].errors.keys() - compared[way].errors.keys()}


def tied(a: Standing, b: Standing, of: int = 1) -> bool:
    """Whether the 95 % interval of the mean difference, recording by recording, includes 0; of: so many pairs that are
    compared, of equally good ways of which 5 % at most have any two told apart (Bonferroni).

    Student's t over recordings, each with the mean of its seeds. Of fewer recordings the intervals of the single errors
    decide together, and of three seeds or more these as well: that all of them end in one place says nothing of the
    recordings. Where an interval is not known, seeds that differ decide alone, and nothing is told without.
    """
    shared = sorted(set(a.errors) & set(b.errors))
    if not shared:
        return True
    difference = np.array([a.means[n] - b.means[n] for n in shared])
    if len(shared) >= FEW:
        return includes_zero(difference, of)
    seeds, spread = min(len(x.errors[n]) for x in (a, b) for n in shared), False
    if seeds >= FEW:
        by_seed = [[s.errors[n][k] for n in shared] for s in (a, b) for k in range(seeds)]
        means = np.mean(by_seed, axis=1)
        if unpaired_includes_zero(means[:seeds], means[seeds:], of):
            return True
        spread = bool(np.ptp(means[:seeds]) or np.ptp(means[seeds:]))
    halves = [x.halves.get(n, math.nan) for x in (a, b) for n in shared]
    if np.isnan(halves).any():
        return not spread
    joint = float(np.sqrt(np.sum(np.square(halves)))) / len(shared)
    return bool(abs(difference.mean()) <= joint * student(math.inf, of) / student(math.inf))


def includes_zero(values: np.ndarray, of: int = 1) -> bool:
    """Whether the 95 % interval of the mean of some values (n,), one of so many, includes 0 (Student's t)."""
    low, high = t_interval(values, of)
    return low <= 0 <= high


def unpaired_includes_zero(a: np.ndarray, b: np.ndarray, of: int = 1) -> bool:
    """The same of the difference of two means, (n,) and (m,), with variances of their own (Welch 1947)."""
    va, vb = a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)
    if va + vb == 0:
        return bool(a.mean() == b.mean())
    freedom = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return bool(abs(a.mean() - b.mean()) <= student(freedom, of) * math.sqrt(va + vb))


@dataclass(frozen=True)
class Overall:
    """One way over all cases: ratio: geometric mean of its errors over the best way's, recording by recording, with its
    95 % interval, of all pairs of ways at once (None for the best itself, or of fewer than three recordings); tied:
    whether that includes 1, and of fewer recordings whether it is tied with the best way in any case.
    """

    way: str
    ratio: float
    low: float | None
    high: float | None
    tied: bool
    recordings: int


def overall(found: Mapping[str, Mapping[str, Standing]]) -> list[Overall]:
    """All ways that have a number in every case that has the split, the best first, over the recordings that all of
    them have: cases differ in size, so ratios are compared.
    """
    cases = list(ranked_cases(found).values())
    ways = {way for case in cases for way in case}
    whole = [w for w in sorted(ways) if all(w in case and case[w].value is not None for case in cases)]
    cases = [alike({way: case[way] for way in whole}) for case in cases]
    errors = {way: errors_of(case[way] for case in cases) for way in whole}
    if not errors or not all(errors.values()):
        return []
    if any(min(mine.values()) <= 0 for mine in errors.values()):
        return _of_zeros(errors, cases)
    logs = {way: {n: float(np.log(e)) for n, e in mine.items()} for way, mine in errors.items()}
    mean = {way: float(np.mean(list(values.values()))) for way, values in logs.items()}
    order = sorted(whole, key=lambda w: mean[w])
    pairs = {way: [(case[order[0]], case[way]) for case in cases] for way in order}
    return [_overall(way, logs[way], logs[order[0]], pairs[way], pairs_of(whole)) for way in order]


def _of_zeros(errors: Mapping[str, Mapping[str, float]], cases: Sequence[Mapping[str, Standing]]) -> list[Overall]:
    """The same where some error is 0, as counts often are: it has no ratio to any other, and to leave its recording out
    would keep from a way what it did best. So errors are taken in shares of the largest of any way, recording by
    recording, and their means are compared; infinite where the best way errs by nothing at all.
    """
    top = {n: max(abs(mine.get(n, 0.0)) for mine in errors.values()) for mine in errors.values() for n in mine}
    share = {w: float(np.mean([e / top[n] if top[n] else 0.0 for n, e in mine.items()])) for w, mine in errors.items()}
    first, *others = sorted(share, key=lambda w: (share[w], w))
    out = [Overall(first, 1.0, None, None, False, len(errors[first]))]
    for way in others:
        ratio = share[way] / share[first] if share[first] else (math.inf if share[way] else 1.0)
        pairs, mine = [(case[first], case[way]) for case in cases], errors[way].keys() & errors[first].keys()
        out.append(Overall(way, ratio, None, None, not _apart(pairs, pairs_of(errors)), len(mine)))
    return out


def _apart(cases: Sequence[tuple[Standing, Standing]], of: int) -> bool:
    """Whether the first of two ways is better in each of several cases, by more than noise decides; of: see `tied`."""
    return all((a.value or 0.0) < (b.value or 0.0) and not tied(a, b, of) for a, b in cases)


def _overall(
    way: str, mine: dict[str, float], best: dict[str, float], cases: Sequence[tuple[Standing, Standing]], of: int
) -> Overall:  # fmt: skip
    """cases: the best way's standing and its own, case by case; of: as in `tied`."""
    first = all(a is b for a, b in cases)
    difference = np.array([mine[n] - best[n] for n in mine if n in best])
    ratio = float(np.exp(difference.mean())) if len(difference) else math.nan
    if first or len(difference) < FEW:
        return Overall(way, ratio, None, None, not (first or _apart(cases, of)), len(difference))
    low, high = t_interval(difference, of)
    return Overall(way, ratio, math.exp(low), math.exp(high), low <= 0 <= high, len(difference))


def errors_of(standing: Iterable[Standing]) -> dict[str, float]:
    """The mean error of each recording; one that was held out in several cases counts once, with their geometric mean
    where none is 0.
    """
    values: dict[str, list[float]] = {}
    for one in standing:
        for name, mean in one.means.items():
            values.setdefault(name, []).append(mean)
    return {name: _middle(np.array(some)) for name, some in values.items()}


def _middle(values: np.ndarray) -> float:
    """The geometric mean of some values (n,), or their mean where one is not above 0."""
    if len(values) == 1:
        return float(values[0])
    return float(np.exp(np.log(values).mean()) if (values > 0).all() else values.mean())
