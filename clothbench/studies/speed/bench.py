"""`clothbench bench`: the speed of every model of sheets beside the installed peers, measured in one run.

A speed means little away from the machine it was measured on; a ratio to a peer in the same run means more. Steps are
not worth the same either: models that know textbook materials are also timed at equal error, each with the longest
step that keeps it close to its own converged motion. Of a model that finds rest only, iterations are its steps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import (
    KnowsMaterials,
    absent,
    bench_options_of,
    equal_error_options_of,
    kind_of_model,
    takes_option,
    work_of,
)
from clothbench.core.parallel import thread_count
from clothbench.plugins.discovery import Catalogue, Plugin, catalogue, library_version, one_line
from clothbench.studies.speed.roofline import Work, measured_core, told
from clothbench.studies.speed.timing import (
    STEP,
    FailedRun,
    Speed,
    at_equal_error,
    on_threads,
    share_of_processes,
    swung,
    time_model,
    time_peer,
    time_settling,
)

KEYS = (
    "model", "kind", "nodes", "threads", "batch", "node_steps_per_s", "realtime_factor", "peer", "ratio",
    "precision", "options", "version", "note", "step_s", "error_m",
)  # fmt: skip
SIDES = (9, 21, 41, 65)  # nodes along each side of the square sheet
EQUAL_SIDES = (21, 41)  # at equal error, where a peer's converged simulation of a fine sheet takes many minutes
CONVERGED = {"explicit": 0.5}  # of a model's default step, whose motion stands for the exact one; else a quarter
BATCH = 64
PEER_STEP, OWN_STEP = f"step {1e3 * STEP:g} ms", "own step"  # notes of models
SETTLING = "iterations until rest"  # note of a model that finds rest only
PROCESSES = "separate processes"
ROOFLINE = "roofline of one core"
ASIDE = (PROCESSES, ROOFLINE)  # what rows that are no speeds of their own are held against
NO_PEERS = (None, *ASIDE)

Row = dict[str, Any]
Say = Callable[[str], None]


def run_bench(sides: Sequence[int] = SIDES, progress: Say | None = None, chosen: Sequence[str] = ()) -> list[Row]:
    """Measure all models of sheets, or those chosen, beside all installed peers; rows have the keys `KEYS`, null if
    unknown.

    A model's row stands once for each peer measured at its number of nodes, with `ratio` = its speed per
    thread over the peer's, or once with no peer. A peer has rows of its own; one row a model compares threads
    with separate processes. A model that finds rest only has one row for each number of nodes, beside no peer: one
    sheet on one thread, `node_steps_per_s` counts its iterations, `realtime_factor` is None. What cannot be measured
    is left out, with a line on standard error. `progress` is told in one line what is measured next. Rows with an
    `error_m` are those of `equal_error`.
    """
    say = progress or (lambda _: None)
    models, peers, rows = [m for m in _models() if not chosen or m.name in chosen], _peers(), []
    everyone = [v for plugin in models for v in _guarded_variants(plugin)]
    variants, resting = ([v for v in everyone if v.moves == moves] for moves in (True, False))
    for side in sides:
        beside = [row for peer in peers for row in _peer_rows(peer, side, say)]
        rows += beside
        rows += [row for variant in variants for row in _model_rows(variant, side, beside, say)]
        rows += [row for variant in resting for row in _resting_rows(variant, side, say)]
    for variant in variants:
        with _or_skipped(f"roofline of {variant.name}"):
            rows += _roofline_rows(variant, rows, say)
    middle = min(sides, key=lambda side: abs(side - 21))
    for name in dict.fromkeys(v.name for v in variants):
        say(f"{name}: threads against {PROCESSES}")
        with _or_skipped(name):
            rows += two_cores(name, middle)
    for side in (s for s in sides if s in EQUAL_SIDES):
        rows += equal_error(models, side, say)
    return rows


def of_peer(row: Row) -> bool:
    """Whether a row is of a peer by itself: its note is what the peer is, a model's is its step. Names tell nothing: a
    model may be called as the peer that it is built on.
    """
    return row["peer"] is None and row["error_m"] is None and row.get("note") not in (PEER_STEP, OWN_STEP, SETTLING)


def of_rest(row: Row) -> bool:
    """Whether a row is of a model that finds rest only: its iterations are no steps of time."""
    return row.get("note") == SETTLING


def two_cores(name: str, side: int = 21) -> list[Row]:
    """One row: a batch on all cores, as a share of what as many separate one-thread processes reach together.

    No row where there is only one core.
    """
    cores = thread_count()
    if cores < 2:
        return []
    variant = next(v for v in _variants_of(catalogue().find("models", name)) if v.moves)
    speed, share = share_of_processes(variant.plugin.target, variant.options, side, BATCH, cores)
    count = {2: "two", 3: "three", 4: "four"}.get(cores, cores)
    row = variant.row(variant.make(), speed, cores, BATCH, f"share of {count} {PROCESSES}")
    return [row | {"peer": PROCESSES, "ratio": share}]


def equal_error(models: Sequence[Plugin], side: int, progress: Say | None = None) -> list[Row]:
    """Simulated seconds per second of one core, each model with the longest step that errs by 2 mm at most.

    The error is that of a swung sheet of textbook cloth (`timing.swung_sheet`), RMS over nodes and frames, to the same
    model with its default options and a far shorter step: equations may differ, only what the step spoils counts.
    A model takes part if it has `of_material` and options `dt` and `step_scale`; its class may list sets of options to
    try in `equal_error_options`. `ratio` is to the fastest setting of a peer, which is a model with `built_on`.
    """
    say, rows = progress or (lambda _: None), []
    for plugin in models:
        with _or_skipped(f"{plugin.name} at equal error"):
            rows += _equal_rows(plugin, side, say)
    built_on = {p.name for p in models if library_version(catalogue().load("models", p.name))}
    best = max((r for r in rows if r["model"] in built_on), key=lambda r: r["realtime_factor"], default=None)
    if best is None:
        return rows
    ratios = [{"peer": best["model"], "ratio": r["realtime_factor"] / best["realtime_factor"]} for r in rows]
    return [r | ratio if r["model"] not in built_on else r for r, ratio in zip(rows, ratios, strict=True)]


@dataclass(frozen=True)
class _Variant:
    """A model with one set of the options that it wants to be measured with; one that does not move finds rest only."""

    plugin: Plugin
    options: dict[str, Any]
    takes_step: bool
    moves: bool

    @property
    def name(self) -> str:
        return self.plugin.name

    def make(self, **more: Any) -> Any:
        return catalogue().make("models", self.name, **self.options, **more)

    def at_step(self, dt: float) -> Any:
        return self.make(dt=dt)

    def precision_of(self, model: Any) -> str | None:
        return getattr(model, "precision", None) or self.options.get("precision")

    def row(self, model: Any, speed: Speed, threads: int, batch: int, note: str | None) -> Row:
        about = {
            "kind": kind_of_model(model) or None,
            "precision": self.precision_of(model),
            "options": told_options(self.options, but="precision") or None,
            "version": getattr(model, "version", None),
        }
        return _row(self.name, speed, threads, batch) | about | {"note": note}


def told_options(options: Mapping[str, Any], but: str = "") -> str:
    """ "integrator=implicit_euler", without the one that is said elsewhere"""
    return ", ".join(f"{name}={value}" for name, value in options.items() if name != but)


def _models() -> list[Plugin]:
    """The models that are installed; a line on standard error for each that is not, or that is broken."""
    found = []
    for plugin in catalogue().plugins:
        if plugin.kind in ("models", "module") and plugin.reason is not None:
            _skipped(plugin.name, plugin.reason)
        elif plugin.kind == "models":
            with _or_skipped(plugin.name):
                reason = absent(catalogue().load("models", plugin.name))
                found += [] if reason else [plugin]
                if reason is not None:
                    _skipped(plugin.name, reason)
    return found


def _guarded_variants(plugin: Plugin) -> list[_Variant]:
    with _or_skipped(plugin.name):
        return _variants_of(plugin)
    return []


def _variants_of(plugin: Plugin, sets_of: Callable[[Any], list[dict[str, Any]]] = bench_options_of) -> list[_Variant]:
    """A model with every set of options that it names; none of one that neither moves a sheet nor finds its rest."""
    factory, found = catalogue().load("models", plugin.name), []
    for options in sets_of(factory):
        able = catalogue().make("models", plugin.name, **options).capabilities
        if able & {"dynamic", "static"}:
            found.append(_Variant(plugin, options, takes_option(factory, "dt"), "dynamic" in able))
    return found


def _model_rows(variant: _Variant, side: int, beside: list[Row], say: Say) -> list[Row]:
    """One sheet on one thread, a batch on one thread, the batch on all threads; each beside every peer."""
    rows, cores = [], thread_count()
    for threads, batch in dict.fromkeys([(1, 1), (1, BATCH), (cores, BATCH)]):
        options = "".join(f" {k}={v}" for k, v in variant.options.items())
        say(f"{variant.name}{options}: {side} × {side} nodes, {batch} at once, {threads} thread(s)")
        with _or_skipped(variant.name):
            rows += _with_ratios(_measure(variant, side, threads, batch), beside)
    return rows


def _resting_rows(variant: _Variant, side: int, say: Say) -> list[Row]:
    """One sheet on one thread, settled; beside no peer, since peers move."""
    say(f"{variant.name}: {side} × {side} nodes, settled")
    with _or_skipped(variant.name):
        model = variant.make()
        row = variant.row(model, time_settling(model, side), 1, 1, SETTLING)
        return [row | {"kind": "static", "realtime_factor": None}]
    return []


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
    return variant.row(model, time_model(model, side, batch, threads), threads, batch, OWN_STEP)


def _roofline_rows(variant: _Variant, rows: Sequence[Row], say: Say) -> list[Row]:
    """The fastest of a model's measurements on one thread as a share of what its core could do at most, if the model
    says what its steps take.
    """
    model = variant.make()
    options = told_options(variant.options, but="precision") or None
    stated, own = work_of(model), (variant.name, variant.precision_of(model), options, 1, None)
    mine = [r for r in rows if (r["model"], r["precision"], r["options"], r["threads"], r["error_m"]) == own]
    if stated is None or not mine:
        return []
    work, precision = Work(**stated), variant.precision_of(model) or "double"
    say(f"{variant.name}: {ROOFLINE}, {precision}")
    core, best = measured_core(precision), max(mine, key=lambda r: r["node_steps_per_s"])
    speed = best["node_steps_per_s"]
    share = speed / min(core.ceilings(work).values())
    return [best | {"peer": ROOFLINE, "ratio": share, "note": told(f"{variant.name}, {precision}", speed, core, work)}]


def _equal_rows(plugin: Plugin, side: int, say: Say) -> list[Row]:
    """A row for each set of options with which the model is accurate enough at some step."""
    variants = [v for v in _variants_of(plugin, equal_error_options_of) if v.takes_step and v.moves]
    if not variants or not isinstance(catalogue().load("models", plugin.name), KnowsMaterials):
        return []
    rows, scale = [], CONVERGED.get(kind_of_model(variants[0].make()), 0.25)
    say(f"{plugin.name}: {side} × {side} nodes, converged")
    with on_threads(1):
        truth = swung(catalogue().make("models", plugin.name, step_scale=scale), side)[0]
    for variant in variants:
        options = told_options(variant.options)
        say(f"{plugin.name} {options}: {side} × {side} nodes, at equal error")
        with _or_skipped(f"{plugin.name} {options} at equal error"):
            found = at_equal_error(variant.at_step, side, truth)
            row = variant.row(variant.make(), found.speed, 1, 1, options or None)
            rows.append(row | {"step_s": found.step, "error_m": found.error})
    return rows


def _with_ratios(row: Row, beside: list[Row]) -> list[Row]:
    """The row once for each peer with as many nodes; as it is where there is none."""
    rate = row["node_steps_per_s"] / row["threads"]
    same = [p for p in beside if p["nodes"] == row["nodes"]]
    return [row | {"peer": p["model"], "ratio": rate / p["node_steps_per_s"]} for p in same] or [row]


def _peers() -> list[Plugin]:
    """The peers that are installed; a line on standard error for each that is not."""
    found = []
    for plugin, reason in peers_in(catalogue()):
        if reason is None:
            found.append(plugin)
        else:
            _skipped(plugin.name, reason)
    return found


def peers_in(plugins: Catalogue) -> list[tuple[Plugin, str | None]]:
    """Every peer, with why it cannot run here; None where it can. Whatever a stranger's trips over is its reason."""
    return [(plugin, _why_absent(plugin, plugins)) for plugin in plugins.plugins if plugin.kind == "peers"]


def _why_absent(peer: Plugin, plugins: Catalogue) -> str | None:
    try:
        return peer.reason or plugins.load("peers", peer.name).skip_reason()
    except ClothbenchError as fault:
        return str(fault)
    except Exception as fault:
        return one_line(fault)


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
