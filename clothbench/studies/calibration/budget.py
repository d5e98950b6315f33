"""Whether more evaluations would have helped: what the last quarter of every search still brought."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.display.html import group
from clothbench.engine.store import Store
from clothbench.engine.tables import read_table
from clothbench.studies.calibration.schema import HISTORY
from clothbench.studies.calibration.words import counted, listed

Rows = Sequence[dict[str, Any]]
Histories = Mapping[str, np.ndarray]  # value (E,) of every evaluation of a cell on its last mesh, by its key
FEW = 3  # cases that are named one by one
TELLS = 10  # evaluations of the last quarter below which it says nothing of what more of them would bring
LATE, MUCH = 0.75, 0.02  # of a search, behind which a fall of the error by this share says that it was not done


def histories_of(store: Store, keys: Sequence[str]) -> dict[str, np.ndarray]:
    """The errors of every evaluation, of the cells that have them."""
    out = {}
    for key in keys:
        if (path := store.cell(key) / "history.parquet").is_file():
            values = read_table(path, HISTORY)["value"].to_numpy().astype(float)
            if np.isfinite(values).any():
                out[key] = np.where(np.isfinite(values), values, np.inf)
    return out


def least(values: np.ndarray, share: float = 1.0) -> float:
    """The least error in the first part of a search."""
    return float(values[: _part(values, share)].min())


def _part(values: np.ndarray, share: float) -> int:
    """How many evaluations the first part of a search has."""
    return max(1, round(share * len(values)))


def late_fall(values: np.ndarray) -> float:
    """By what share the least error fell in the last quarter."""
    before, end = least(values, LATE), least(values)
    return 1.0 if not np.isfinite(before) else 0.0 if before == 0 else 1 - end / before


def too_few(histories: Histories, free: Mapping[str, int]) -> list[int]:
    """How many evaluations the last quarter has, of each search where these are too few to tell whether more would
    help: less than one more than it has free parameters, as one step may take, or than `TELLS`.
    """
    late = {key: len(values) - _part(values, LATE) for key, values in histories.items()}
    return [count for key, count in late.items() if count < max(TELLS, free.get(key, 0) + 1)]


def settled(
    rows: Rows, way: Callable[[dict[str, Any]], str], histories: Histories, free: Mapping[str, int] | None = None
) -> tuple[str, str]:  # fmt: skip
    """The budget in words, and whether more of it would lower errors or change the order of ways. free: how many
    parameters each cell has, by its key.
    """
    about = {r["key"]: r for r in rows if r["key"] in histories}
    if not about:
        return "not known", "no search was kept"
    counts = sorted({about[k]["evaluations"] or len(histories[k]) for k in about})  # those on coarser meshes, too
    value = counted(counts[-1], "evaluation") if len(counts) == 1 else f"{counts[0]} … {counts[-1]} evaluations"
    falling = sorted({about[k]["case"] for k in about if late_fall(histories[k]) > MUCH})
    fits = sum(late_fall(histories[k]) > MUCH for k in about)
    finer = any((about[k]["evaluations"] or 0) > len(histories[k]) for k in about)
    late = f"a fit; in the last quarter{' of those on the finer mesh' if finer else ''}"
    few = too_few({k: histories[k] for k in about}, free or {})
    if not fits and few:
        some = f" of {len(few)} of {len(about)}" if len(few) < len(about) else ""
        most = f"{'at most ' if len(set(few)) > 1 else ''}{counted(max(few), 'evaluation')}"
        return value, f"a fit; too few to tell whether more would lower the error: the last quarter{some} has {most}"
    if not fits:
        said = f"{late} no error fell by more than 2\u00a0%: more would change little"
    else:
        which = f" ({listed(falling)})" if len(falling) <= FEW else ""
        said = (
            f"{late} the error still fell by more than 2\u00a0% in {fits} of {len(about)}{which}: more would lower it"
        )
    return value, "; ".join(filter(None, (said, order_said(about, way, histories))))


def order_said(
    about: Mapping[str, dict[str, Any]], way: Callable[[dict[str, Any]], str], histories: Histories
) -> str:  # fmt: skip
    """Whether the order of ways by what they were fitted to was the same before the last quarter, over the cases, and
    the seeds of each, that all ways have: one case is harder than another.
    """

    def of(row: dict[str, Any]) -> tuple[Any, Any]:
        return row["case"], row["seed"]

    ways = group(list(about.values()), way)
    shared = set.intersection(*({of(r) for r in some} for some in ways.values()))
    if len(ways) < 2 or len({r["objective"] for r in about.values()}) > 1 or not shared:
        return ""

    def order(share: float) -> list[str]:
        logs = {
            w: np.mean([np.log(max(least(histories[r["key"]], share), 1e-300)) for r in some if of(r) in shared])
            for w, some in ways.items()
        }
        return sorted(logs, key=lambda w: logs[w])

    same = order(LATE) == order(1.0)
    return f"the order of ways was {'the same' if same else 'another'} at three quarters of it"
