"""What a suite that fits trial by trial says beyond single errors: how trials transfer, and which fit is chosen.

Bhat et al. 2003, table 3 (start, optimised and cross-trial error; the parameters with the least E1 + E2) and figure 14.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clothbench.display.names import model_name
from clothbench.studies.calibration.ranking import set_otherwise

Rows = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Transfer:
    """One fit of a single trial. errors: by recording, None where there is none; total: over the trials fitted in turn
    (E1 + E2), None if one has no number; chosen: whether it is the lowest of its group.
    """

    key: str
    case: str
    group: str
    way: str
    unit: str
    start: float | None
    errors: dict[str, float | None]
    total: float | None
    chosen: bool


def transfers(rows: Rows, starts: Rows, told: Collection[str] = ()) -> list[Transfer]:
    """Every cell that fitted one trial of a group in which others fitted the rest, one of each trial; nothing of other
    suites. told: keys of cells that count before others of their trial; else the one that ended last does.
    """
    cells: dict[str, list[dict[str, Any]]] = {}
    for r in rows:
        if r["recording"] and r["metric"] == r["objective"]:
            cells.setdefault(r["key"], []).append(r)
    begun = {s["key"]: s["start"] for s in starts}
    single = {k: mine for k, mine in cells.items() if fitted_alone(mine)}
    ways = way_names({k: mine[0] for k, mine in single.items()})
    groups: dict[tuple[str, ...], list[str]] = {}
    for key, mine in single.items():
        groups.setdefault((ways[key], *sorted(r["recording"] for r in mine)), []).append(key)
    out = []
    for several in groups.values():
        # Of one case one cell counts, as in `once`: a further `report` makes another cell of the same fit.
        cell_of = {single[k][0]["case"]: k for k in sorted(several, key=lambda k: (k in told, *recency(single[k])))}
        keys, trials = [cell_of[case] for case in sorted(cell_of)], sorted(cell_of)
        if len(trials) < 2:
            continue
        totals = {k: total({r["recording"]: r["value"] for r in single[k]}, trials) for k in keys}
        known = {k: t for k, t in totals.items() if t is not None}
        best = min(known, key=lambda k: known[k]) if known else None
        for key in keys:
            first = single[key][0]
            errors = {r["recording"]: r["value"] for r in single[key]}
            out.append(Transfer(key, first["case"], group_name(trials), ways[key], first["unit"], begun.get(key),
                                errors, totals[key], key == best))  # fmt: skip
    return sorted(out, key=lambda t: (t.way, t.case))


def recency(cell: Rows) -> tuple[bool, str]:
    """Sort key by which the last of several cells is the one that counts: with all its numbers, and ended last."""
    return all(r["value"] is not None for r in cell), max(r.get("finished") or "" for r in cell)


def fitted_alone(rows: Rows) -> bool:
    """One recording was fitted, and the case is called after it."""
    fitted = [r["recording"] for r in rows if r["split"] == "fit"]
    return len(fitted) == 1 and rows[0]["case"] == fitted[0]


def total(errors: dict[str, float | None], trials: Sequence[str]) -> float | None:
    values = [errors.get(t) for t in trials]
    return sum(v for v in values if v is not None) if all(v is not None for v in values) else None


def group_name(trials: Sequence[str]) -> str:
    """What the names of some trials begin with: "satin/waving" of "satin/waving-1" and "satin/waving-2"."""
    letters = []
    for column in zip(*trials, strict=False):
        if len(set(column)) > 1:
            break
        letters.append(column[0])
    return "".join(letters).rstrip("-_/ ") or trials[0]


def way_names(about: Mapping[str, dict[str, Any]]) -> dict[str, str]:
    """How each cell was fitted, by key; with budget or settings where one folder holds several of them: of settings, in
    one case, since a fabric may have bounds or fixed values of its own.
    """
    names = {}
    for key, row in about.items():
        seed = f" · seed {row['seed']}" if row["seed"] else ""
        names[key] = f"{model_name(row)} · {row['optimizer']} · {row['objective']}{seed}"
    for mark, word in (("budget", lambda r: f"{r.get('budget')} evaluations"), ("settings", set_otherwise)):
        rivals: dict[tuple[str, str], set[Any]] = {}
        for key, row in about.items():
            rivals.setdefault((names[key], row["case"] if mark == "settings" else ""), set()).add(row.get(mark))
        several = {name for (name, _), found in rivals.items() if len(found) > 1}
        names = {k: f"{n} · {word(about[k])}".removesuffix(" · ") if n in several else n for k, n in names.items()}
    return names


@dataclass(frozen=True)
class Confusion:
    """error[simulated][recorded]: fabric by fabric, mean over the trials of the recorded one that all simulated ones
    were held against; which simulation is nearest to each.
    """

    way: str
    unit: str
    fabrics: tuple[str, ...]
    error: dict[str, dict[str, float | None]]

    def nearest(self, recorded: str) -> str | None:
        """The simulated fabric with the least error on a recorded one."""
        column = {s: self.error[s].get(recorded) for s in self.fabrics if s in self.error}
        known = {s: v for s, v in column.items() if v is not None}
        return min(known, key=lambda s: known[s]) if known else None

    @property
    def right(self) -> int:
        return sum(self.nearest(f) == f for f in self.fabrics)


def confusions(found: Rows, rows: Rows, starts: Rows) -> list[Confusion]:
    """Per way to fit: the chosen parameters of each fabric on every fabric's trials, mean over those that all have."""
    chosen = {t.key: t for t in transfers(rows, starts, {r["key"] for r in found}) if t.chosen}
    out = []
    for way in sorted({t.way for t in chosen.values()}):
        mine = [r for r in found if r["key"] in chosen and chosen[r["key"]].way == way and not r.get("reason")]
        fabrics = tuple(sorted({r["fabric"] for r in mine}))
        if len(fabrics) < 2:
            continue
        error: dict[str, dict[str, float | None]] = {f: {} for f in fabrics}
        for recorded in fabrics:
            tried = {f: [r for r in mine if (r["fabric"], r["recorded_fabric"]) == (f, recorded)] for f in fabrics}
            # One fabric may have more trials than another, and sums over more of them would be larger for that alone.
            common = set.intersection(*([{r["trial"] for r in some} for some in tried.values() if some] or [set()]))
            for f, some in tried.items():
                if values := [r["value"] for r in some if r["trial"] in common]:
                    error[f][recorded] = None if None in values else sum(values) / len(values)
        out.append(Confusion(way, mine[0]["unit"], fabrics, error))
    return out
