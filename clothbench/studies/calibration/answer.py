"""What the page begins with: which model, how far off, which parameters, and whether more budget would help."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.statistics import t_interval
from clothbench.display.answer import Card, answer
from clothbench.display.html import group
from clothbench.display.names import recording_of
from clothbench.display.section import Section
from clothbench.display.templates import rendered
from clothbench.engine.study import Results
from clothbench.studies.calibration.budget import Histories, settled
from clothbench.studies.calibration.estimates import Estimate, estimates
from clothbench.studies.calibration.ranking import (
    NOTHING_HELD_OUT,
    Overall,
    Standing,
    alike,
    best_cell,
    left_out,
    once,
    overall,
    ranked_cases,
    standings,
    way_of,
)
from clothbench.studies.calibration.transfer import confusions
from clothbench.studies.calibration.words import headed, listed, size, times

Rows = Sequence[dict[str, Any]]
HERE = Path(__file__).parent
ENOUGH = 5  # recordings from which on a mean gets an interval; below, the page says from where to where they go


def answer_section(results: Results, histories: Histories) -> Section:
    """The answer of each suite."""
    parts = []
    for suite, rows in sorted(group(results.rows, lambda r: r["suite"]).items()):
        metric = leading_metric(rows)
        found = standings(rows, metric)
        ranked = overall(found)
        told = cards(rows, results, metric, ranked, histories)
        by_title = {card.title: card for card in told}
        said = rendered(HERE, "lead.html", lead=lead(ranked, found, metric), cards=by_title, failed=not ranked)
        parts.append(answer(headed(results.rows)(suite, "the answer"), said, told))
    return Section("".join(parts))


def leading_metric(rows: Rows) -> str:
    """What ways are ranked by: what all minimised, else what has a noise floor, else the first that gave a number."""
    objectives = sorted({r["objective"] for r in rows if r["objective"]})
    if len(objectives) == 1:
        return objectives[0]
    judged = {r["metric"] for r in rows if r["value"] is not None}
    return metric_with_floor(rows) or next((o for o in objectives if o in judged), next(iter(objectives), ""))


def metric_with_floor(rows: Rows) -> str | None:
    """The first metric that says what noise alone would give, on every recording that was judged by it."""
    judged = group([r for r in rows if r["recording"] and r["value"] is not None], lambda r: r["metric"])
    return next((m for m, some in judged.items() if all(r["floor"] for r in some)), None)


def lead(
    ranked: Sequence[Overall], found: Mapping[str, Mapping[str, Standing]], metric: str = ""
) -> dict[str, Any]:  # fmt: skip
    """What the first sentence is made of. metric: what ways are ranked by."""
    ties, cases = [one.way for one in ranked[1:] if one.tied], ranked_cases(found)
    wins = {w: sum(case_best(case) == w for case in cases.values()) for w in (o.way for o in ranked)}
    compared = [{one.way: case[one.way] for one in ranked} for case in cases.values()] if ranked else []
    out = {way for case in cases.values() for way in case} - {one.way for one in ranked}
    lacks = {way: [case[way] for case in cases.values() if way in case and case[way].value is None] for way in out}
    unjudged = {way for way, some in lacks.items() if some and all(s.unjudged for s in some)}
    unseen = {way for way in unjudged if any(s.unjudged == NOTHING_HELD_OUT for s in lacks[way])}
    missing = {way for way in out if any(way not in case for case in cases.values())}
    unrun = {way for way in missing - unseen if not lacks[way] or way in unjudged}  # nothing failed where it has fits
    return {
        "ways": [one.way for one in ranked], "ties": ties, "cases": len(cases), "wins": wins, "metric": metric,
        "behind": [(one.way, times(one)) for one in ranked[1:] if not one.tied],
        "left": sorted(out - unjudged - unrun), "unrun": sorted(unrun),
        "unjudged": sorted(unjudged - unseen - unrun), "unseen": sorted(unseen),
        "alone": listed(sorted({name for case in compared for name in left_out(case)})),
        "unheld": sorted(found.keys() - cases.keys()),
        "reasons": any(s.status != "ok" for case in found.values() for s in case.values()),
        "near": [(one.way, times(one)) for one in ranked[1:] if one.tied],
        "only_fitted": any(s.split == "fit" for case in found.values() for s in case.values()),
    }  # fmt: skip


def case_best(case: Mapping[str, Standing]) -> str | None:
    known = {way: s.value or 0.0 for way, s in alike(case).items()}
    return min(known, key=lambda w: known[w]) if known else None


def cards(
    rows: Rows, results: Results, metric: str, ranked: Sequence[Overall], histories: Histories
) -> list[Card]:  # fmt: skip
    """The parts of the answer, of the way that came out best."""
    if not ranked:
        return []
    way = way_of(rows)
    mine = [r for r in rows if way(r) == ranked[0].way]
    keys = {best_cell(some) for some in group(mine, lambda r: r["case"]).values()}
    found = [error_card(mine, metric), fabric_card(results, keys), *parameter_cards(results, keys)]
    free = Counter(p["key"] for p in results.table("parameters"))
    return [*(card for card in found if card), Card("Budget", *settled(rows, way, histories, free))]


def error_card(rows: Rows, metric: str) -> Card:
    """How far off the model is where it was not fitted, beside what noise alone would give."""
    shown = metric_with_floor(rows) or metric
    split = "held_out" if any(r["split"] == "held_out" for r in rows) else "fit"
    value, detail, floor = mean_of(rows, shown, split)
    times_noise = ""
    if floor:
        times_noise = f"{value_of(rows, shown, split) / floor:.2g} times what noise alone gives"
        detail += f"; {times_noise} ({size(floor)})"
    if shown != metric:
        other, _, _ = mean_of(rows, metric, split)
        detail += f". By {metric}, which was minimised: {other}"
    title = "Held-out error" if split == "held_out" else "Error on what it was fitted to"
    return Card(title, value, f"{shown}, {detail}", said=f"{value}{', ' if floor else ''}{times_noise}")


def recordings_of(rows: Rows, metric: str, split: str) -> dict[Hashable, list[dict[str, Any]]]:
    mine = once([r for r in rows if r["metric"] == metric and r["split"] == split and r["recording"]])
    return group([r for r in mine if r["value"] is not None], recording_of(rows))


def value_of(rows: Rows, metric: str, split: str) -> float:
    return float(np.mean([np.mean([r["value"] for r in some]) for some in recordings_of(rows, metric, split).values()]))


def mean_of(rows: Rows, metric: str, split: str) -> tuple[str, str, float | None]:
    """Mean over recordings (one judged by several fits counts once), in words how sure, and the floor if known."""
    known = recordings_of(rows, metric, split)
    if not known:
        return "–", "no recording could be judged", None
    values = np.array([np.mean([r["value"] for r in some]) for some in known.values()])
    unit, floors = next(iter(known.values()))[0]["unit"], [r["floor"] for some in known.values() for r in some]
    if len(values) >= ENOUGH:
        low, high = t_interval(values)
        sure = f"95 % interval {size(max(low, 0.0))} … {size(high)} over {len(values)} recordings"
    else:
        ends = f"{size(values.min())} … {size(values.max())}"
        sure = "one recording" if len(values) == 1 else f"{ends}: {len(values)} recordings, too few for an interval"
    floor = float(np.mean(floors)) if floors and None not in floors else None
    return f"{size(values.mean())} {unit}", sure, floor


def fabric_card(results: Results, keys: set[str]) -> Card | None:
    """How many fabrics are nearest to their own parameters."""
    tables = [[r for r in some if r["key"] in keys] for some in (results.table("confusion"), results.rows)]
    matrices = confusions(tables[0], tables[1], results.table("starts"))
    if not matrices:
        return None
    shown = matrices[0]
    wrong = [f"{f} is taken for {shown.nearest(f)}" for f in shown.fabrics if shown.nearest(f) != f]
    said = "; ".join(wrong) or "each fabric's own parameters come nearest to its recordings"
    value = f"{shown.right} of {len(shown.fabrics)}"
    return Card("Fabrics recognised", value, said, good=not wrong, said=value)


def parameter_cards(results: Results, keys: set[str]) -> list[Card]:
    """How many parameters the data determine, which, and whether the truth is found where it is known."""
    found = [e for e in estimates(results.table("parameters")) if e.key in keys]
    if not found:
        return []
    sure, by_name = [e for e in found if e.determined], group_estimates(found)
    counts = {name: sum(e.determined for e in mine) for name, mine in by_name}
    some = [f"{name} in {counts[name]} of {len(mine)}" for name, mine in by_name if counts[name]]
    never = [name for name, count in counts.items() if not count]
    detail = "; ".join(filter(None, (", ".join(some), f"never: {', '.join(never)}" if never else "")))
    best = [name for name, mine in by_name if counts[name] * 2 >= len(mine)]
    said = f"{listed(best)} in at least half of the fits" if best else ""
    said += ", its other parameters in fewer or in none" if 0 < len(best) < len(by_name) else ""
    out = [Card("Parameters determined", f"{len(sure)} of {len(found)}", detail, said=said)]
    if judged := [e for e in sure if e.found is not None]:
        right = sum(bool(e.found) for e in judged)
        detail = "of the determined ones, the 95 % interval holds the true value"
        out.append(Card("Truth found", f"{right} of {len(judged)}", detail, good=right >= 0.9 * len(judged)))
    return out


def group_estimates(found: Sequence[Estimate]) -> list[tuple[str, list[Estimate]]]:
    """Estimates by the name of their parameter, those that are determined most often first."""
    by_name: dict[str, list[Estimate]] = {}
    for e in found:
        by_name.setdefault(e.name, []).append(e)
    return sorted(by_name.items(), key=lambda item: -sum(e.determined for e in item[1]) / len(item[1]))
