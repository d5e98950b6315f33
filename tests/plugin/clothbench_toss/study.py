"""How many of some coins fall heads up, model by model: cells, a run, a table, the terminal and the page."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import pyarrow as pa

from clothbench.display.html import table
from clothbench.display.section import Section
from clothbench.engine.cells import digest, plugin_versions
from clothbench.engine.rows import about_cell, no_value
from clothbench.engine.settings import require_plugins, whole
from clothbench.engine.study import Result

name = "toss"
against = "chance"
suite_words = frozenset({"coins"})
tables = {"tosses": {"model": pa.string(), "coin": pa.int64(), "heads": pa.bool_(), "key": pa.string()}}


@dataclass(frozen=True)
class Toss:
    """So many coins tossed for one model."""

    model: str
    coins: int
    seed: int
    versions: dict

    study, suite, case, cases = "toss", "toss", "coins", ("coins",)
    effects, optimizer, metric, row_columns = (), None, "heads", {}
    counts, value_word = "coins", "heads"

    @property
    def key(self) -> str:
        return digest(asdict(self))

    @property
    def label(self) -> str:
        return f"{self.coins} coins for {self.model}"

    @property
    def budget(self) -> int:
        return self.coins


def plan(settings, plugins, progress=None):
    require_plugins(settings, ("model",))
    coins = whole("suite.coins", settings["suite"].get("coins", 10), 1)
    return [Toss(m, coins, settings["seed"], plugin_versions([("models", m)], plugins)) for m in settings["model"]]


def run(cell, context):
    heads = np.random.default_rng(cell.seed).random(cell.coins) < 0.5
    context.progress(cell.coins, float(heads.mean()))
    row = {**about_cell(cell), **no_value(), "value": float(heads.mean()), "unit": "1", "status": "ok", "reason": ""}
    found = [{"model": cell.model, "coin": n, "heads": bool(h), "key": cell.key} for n, h in enumerate(heads)]
    return Result("ok", {"rows": [row | {"evaluations": cell.coins, "wall_s": 0.0}], "tosses": found})


def show(results):
    return [f"{row['model']}: {row['value']:.0%} of the coins fell heads up" for row in results.rows]


def sections(results):
    heads = [[r["model"], str(sum(t["heads"] for t in results.table("tosses") if t["key"] == r["key"]))]
             for r in results.rows]  # fmt: skip
    figure = {"data": [], "layout": {"height": 100, "xaxis": {}, "yaxis": {}}}
    html = f'<h2>Coins</h2>{table(["model", "heads"], heads, {1})}<div id="coins-figure"></div>'
    return [Section(html, {"coins": figure}, 'draw("coins-figure", JSON.parse(byId("coins").textContent));')]


def claims(row, tables):
    return False
