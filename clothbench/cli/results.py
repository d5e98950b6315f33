"""What the terminal shows of results: every study's own tables, then what failed."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from rich.markup import escape

from clothbench.display.failures import failures, places
from clothbench.display.terminal import console
from clothbench.engine.store import Store
from clothbench.engine.study import results_by_study
from clothbench.plugins.discovery import catalogue


def print_results(store: Store, keys: Iterable[str] | None = None) -> list[dict[str, Any]]:
    """Print what the store holds, or some cells of it; returns the rows."""
    out, rows = console(), []
    found, left_out = results_by_study(store, catalogue(), keys)
    for line in left_out:
        print(f"clothbench: {store.folder}: {line}", file=sys.stderr)
    for study, results in found:
        rows += results.rows
        for shown in study.show(results):
            out.print(shown, soft_wrap=isinstance(shown, str))
    bad = failures(rows)
    for row, place in zip(bad, places(bad), strict=True):
        out.print(f"[red]{row['status']}[/]: {escape(place)}: {escape(row['reason'] or '')}", soft_wrap=True)
    return rows
