"""`clothbench bench`: the speed of every dynamic model beside the installed peers, measured in one run.

A speed means little away from the machine it was measured on; a ratio to a peer in the same run means more.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from clothbench.errors import ClothbenchError
from clothbench.parallel import thread_count
from clothbench.plugins import Plugin, absent, catalogue, one_line
from clothbench.timing import STEP, FailedRun, Speed, share_of_processes, time_model, time_peer

KEYS = (
    "model", "kind", "nodes", "threads", "batch", "node_steps_per_s", "realtime_factor", "peer", "ratio",
    "precision", "version", "note",
)  # fmt: skip
SIDES = (9, 21, 41, 65)  # nodes along each side of the square sheet
BATCH = 64
PEER_STEP = f"step {1e3 * STEP:g} ms"
PROCESSES = "separate processes"

Row = dict[str, Any]
Say = Callable[[str], None]


def run_bench(sides: Sequence[int] = SIDES, progress: Say | None = None) -> list[Row]:
    """Measure all dynamic models beside all installed peers; rows have the keys `KEYS`, null if unknown.

    A model's row stands once for each peer measured at its number of nodes, with `ratio` = its speed per
    thread over the peer's, or once with no peer. A peer has rows of its own; one row a model compares threads
    with separate processes. What cannot be measured is left out, with a line on standard error. `progress` is
    told in one line what is measured next.
    """
    say = progress or (lambda _: None)
    variants, peers, rows = _variants(), _peers(), []
    for side in sides:
        beside = [row for peer in peers for row in _peer_rows(peer, side, say)]
        rows += beside
        rows += [row for variant in variants for row in _model_rows(variant, side, beside, say)]
    middle = min(sides, key=lambda side: abs(side - 21))
    for name in dict.fromkeys(v.name for v in variants):
        say(f"{name}: threads against {PROCESSES}")
        with _or_skipped(name):
            rows += two_cores(name, middle)
    return rows


def two_cores(name: str, side: int = 21) -> list[Row]:
    """One row: a batch on all cores, as a share of what as many separate one-thread processes reach together.

    No row where there is only one core.
    """
    cores = thread_count()
    if cores < 2:
        return []
    variant = _variants_of(catalogue().find("models", name))[0]
    speed, share = share_of_processes(variant.plugin.target, variant.options, side, BATCH, cores)
    count = {2: "two", 3: "three", 4: "four"}.get(cores, cores)
    row = variant.row(variant.make(), speed, cores, BATCH, f"share of {count} {PROCESSES}")
    return [row | {"peer": PROCESSES, "ratio": share}]


@dataclass(frozen=True)
class _Variant:
    """A model with one set of the options that it wants to be measured with."""

    plugin: Plugin
    options: dict[str, Any]
    takes_step: bool

    @property
    def name(self) -> str:
        return self.plugin.name

    def make(self, **more: Any) -> Any:
        return catalogue().make("models", self.name, **self.options, **more)

    def row(self, model: Any, speed: Speed, threads: int, batch: int, note: str | None) -> Row:
        about = {
            "kind": getattr(model, "kind", None),
            "precision": getattr(model, "precision", None),
            "version": getattr(model, "version", None),
        }
        return _row(self.name, speed, threads, batch) | about | {"note": note}


def _variants() -> list[_Variant]:
    found = []
    for plugin in catalogue().plugins:
        if plugin.kind in ("models", "module") and plugin.reason is not None:
            _skipped(plugin.name, plugin.reason)
        elif plugin.kind == "models":
            with _or_skipped(plugin.name):
                reason = absent(catalogue().load("models", plugin.name))
                found += [] if reason else _variants_of(plugin)
                if reason is not None:
                    _skipped(plugin.name, reason)
    return found


def _variants_of(plugin: Plugin) -> list[_Variant]:
    factory = catalogue().load("models", plugin.name)
    try:
        takes_step = "dt" in inspect.signature(factory).parameters
    except (TypeError, ValueError):  # some compiled callables have none
        takes_step = False
    matrix: Sequence[dict[str, Any]] = getattr(factory, "bench_options", ({},))
    variants = [_Variant(plugin, dict(options), takes_step) for options in matrix]
    return [v for v in variants if "dynamic" in v.make().capabilities]


def _model_rows(variant: _Variant, side: int, beside: list[Row], say: Say) -> list[Row]:
    """One sheet on one thread, a batch on one thread, the batch on all threads; each beside every peer."""
    rows, cores = [], thread_count()
    for threads, batch in dict.fromkeys([(1, 1), (1, BATCH), (cores, BATCH)]):
        options = "".join(f" {k}={v}" for k, v in variant.options.items())
        say(f"{variant.name}{options}: {side} × {side} nodes, {batch} at once, {threads} thread(s)")
        with _or_skipped(variant.name):
            rows += _with_ratios(_measure(variant, side, threads, batch), beside)
    return rows


def _measure(variant: _Variant, side: int, threads: int, batch: int) -> Row:
    """At the peers' step if the model takes one and is stable there; else at its own."""
    if variant.takes_step:
        try:
            model = variant.make(dt=STEP)
            speed = time_model(model, side, batch, threads)
            return variant.row(model, speed, threads, batch, PEER_STEP)
        except FailedRun:
            pass
    model = variant.make()
    return variant.row(model, time_model(model, side, batch, threads), threads, batch, "own step")


def _with_ratios(row: Row, beside: list[Row]) -> list[Row]:
    """The row once for each peer with as many nodes; as it is where there is none."""
    rate = row["node_steps_per_s"] / row["threads"]
    same = [p for p in beside if p["nodes"] == row["nodes"]]
    return [row | {"peer": p["model"], "ratio": rate / p["node_steps_per_s"]} for p in same] or [row]


def _peers() -> list[Plugin]:
    """The peers that are installed; a line on standard error for each that is not."""
    found = []
    for plugin in (p for p in catalogue().plugins if p.kind == "peers"):
        with _or_skipped(plugin.name):
            reason = plugin.reason or catalogue().load("peers", plugin.name).skip_reason()
            found += [plugin] if reason is None else []
            if reason is not None:
                _skipped(plugin.name, reason)
    return found


def _peer_rows(plugin: Plugin, side: int, say: Say) -> list[Row]:
    """One row, or none if it could not be measured."""
    say(f"{plugin.name}: {side} × {side} nodes")
    with _or_skipped(plugin.name):
        speed, version = time_peer(catalogue().load("peers", plugin.name), side)
        about = {"kind": "explicit", "version": version, "note": plugin.summary}
        return [_row(plugin.name, speed, 1, 1) | about]
    return []


def _row(name: str, speed: Speed, threads: int, batch: int) -> Row:
    measured = {
        "model": name, "nodes": speed.nodes, "threads": threads, "batch": batch,
        "node_steps_per_s": speed.node_steps_per_s, "realtime_factor": speed.realtime_factor,
    }  # fmt: skip
    return dict.fromkeys(KEYS) | measured


@contextmanager
def _or_skipped(name: str) -> Iterator[None]:
    """Turn a plugin's fault into a line on standard error: one that is broken must not stop the others."""
    try:
        yield
    except ClothbenchError as fault:
        _skipped(name, str(fault))
    except Exception as fault:
        _skipped(name, one_line(fault))


def _skipped(name: str, reason: str) -> None:
    print(f"{name}: skipped: {reason}", file=sys.stderr)


# --- the table ----------------------------------------------------------------------------------------------


def print_table(rows: Sequence[Row]) -> None:
    """A line for each measurement, with its ratio to each peer; then the share of separate processes."""
    from rich.markup import escape
    from rich.table import Table

    from clothbench.report.tables import console

    peers = list(dict.fromkeys(r["peer"] for r in rows if r["peer"] not in (None, PROCESSES)))
    table = Table(title="speed; × a peer: per core", title_justify="left", title_style="bold")
    for name in ("model", "kind", "precision", "step"):
        table.add_column(name, no_wrap=True)
    beside = [f"× {p}" for p in peers]
    for name in ("nodes", "threads", "batch", "million node-steps/s", "× real time", *beside):
        table.add_column(name, justify="right")
    for cells in _lines([r for r in rows if r["peer"] != PROCESSES], peers):
        table.add_row(*map(escape, cells))
    out = console()
    out.print(table)
    for row in (r for r in rows if r["peer"] == PROCESSES):
        what = f"{row['model']}, {row['nodes']} nodes, {row['threads']} threads"
        out.print(f"{escape(what)}: {row['ratio']:.2f}, {escape(row['note'])}")


def _lines(rows: Sequence[Row], peers: Sequence[str]) -> Iterator[list[str]]:
    """The cells of the table: rows that differ in their peer alone share a line."""
    together: dict[tuple, dict[str, str]] = {}
    about: dict[tuple, Row] = {}
    for row in rows:
        key = tuple(v for k, v in row.items() if k not in ("peer", "ratio"))
        about[key] = row
        together.setdefault(key, {})[row["peer"]] = f"{row['ratio']:.1f}" if row["ratio"] is not None else ""
    for key, row in about.items():
        step = PEER_STEP if row["model"] in peers else row["note"]
        texts = (row["model"], row["kind"], row["precision"], step)
        counts = (row["nodes"], row["threads"], row["batch"])
        speed = (f"{row['node_steps_per_s'] / 1e6:.1f}", f"{row['realtime_factor']:.3g}")
        yield [*(str(t or "") for t in (*texts, *counts)), *speed, *(together[key].get(p, "") for p in peers)]
