"""What there is: plugins, data sets, and what an import made."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import absent, defaults_of
from clothbench.datasets.convert import REPORT
from clothbench.display.terminal import console
from clothbench.plugins.discovery import Plugin, catalogue, faulty_class, reason_of, singular


def plugin_rows() -> list[dict[str, Any]]:
    """Every plugin, loaded and asked for its parameters; what fails on the way is its `reason`."""
    return [_plugin_row(p) for p in catalogue().plugins]


def _plugin_row(plugin: Plugin) -> dict[str, Any]:
    row: dict[str, Any] = {
        "kind": plugin.kind if plugin.kind == "module" else singular(plugin.kind),
        "name": plugin.name,
        "version": None,
        "distribution": f"{plugin.distribution} {plugin.version}",
        "target": plugin.target,
        "summary": plugin.summary,
        "broken": plugin.reason,
        "missing": None,
        "parameters": [],
        "options": {},
    }
    if plugin.reason is None:
        try:
            loaded = catalogue().load(plugin.kind, plugin.name)
            row["missing"] = None if (missing := absent(loaded)) is None else str(missing)
            row["version"] = _plain(getattr(loaded, "version", None))
            row["parameters"] = [_parameter(p) for p in getattr(loaded, "parameters", ())]
            row["options"] = {name: _plain(value) for name, value in defaults_of(loaded).items()}
            row["broken"] = faulty_class(plugin.kind, loaded) or None
        except Exception as fault:  # a stranger's class may do anything when it is looked at
            row["broken"] = reason_of(fault.__cause__ or fault)  # that of what was raised for it, which names it again
    return row


def _parameter(p: Any) -> dict[str, Any]:
    words = {n: str(getattr(p, n)) for n in ("name", "symbol", "unit", "scale", "meaning", "source")}
    numbers = {"default": p.default, "null": p.null, "low": p.bounds[0], "high": p.bounds[1]}
    return {**words, **{n: None if number is None else float(number) for n, number in numbers.items()}}


def _plain(value: Any) -> Any:
    """A value as JSON has it; in words, where it has none for it."""
    if isinstance(value, np.generic):
        value = value.item()
    try:
        return json.loads(json.dumps(value, allow_nan=False))
    except (TypeError, ValueError):
        return str(value)


def print_plugins(rows: list[dict[str, Any]]) -> None:
    table = Table(title="plugins", title_justify="left", title_style="bold")
    for name in ("kind", "name", "what it is", "distribution", "parameters"):
        table.add_column(name, overflow="fold")
    for row in (r for r in rows if r["broken"] is None):
        parameters = ", ".join(f"{p['name']} [{p['unit']}] {p['low']:g}…{p['high']:g}" for p in row["parameters"])
        table.add_row(
            *(escape(str(t)) for t in (row["kind"], row["name"], row["summary"], row["distribution"], parameters))
        )
    out = console()
    out.print(table)
    for row in (r for r in rows if r["missing"] is not None):
        out.print(
            f"[yellow]not installed[/]: {escape(row['kind'])} {escape(row['name'])}: {escape(row['missing'])}",
            soft_wrap=True,
        )
    for row in (r for r in rows if r["broken"] is not None):
        what, reason = f"{row['kind']} {row['name']} ({row['distribution']})", row["broken"]
        out.print(f"[red]broken[/]: {escape(what)}: {escape(reason)}", soft_wrap=True)  # a line each, also in files


def dataset_rows() -> list[dict[str, Any]]:
    from clothbench.datasets.registry import DATASETS, fetched, local_copy

    rows = []
    for name, d in DATASETS.items():
        try:
            local = local_copy(name, None)
        except ClothbenchError:  # CLOTHBENCH_DATA names a folder that has others, or nothing
            local = None
        local = local or fetched(name)
        rows.append(
            {
                "name": name,
                "title": d.title,
                "use": d.use or "recordings",
                "licence": d.licence,
                "citation": d.citation,
                "files": len(d.files),
                "address": f"{d.repository}@{d.commit}",
                "local_copy": str(local) if local else None,
            }
        )
    return rows


def print_datasets(rows: list[dict[str, Any]]) -> None:
    table = Table(title="public data sets", title_justify="left", title_style="bold")
    table.add_column("name", no_wrap=True)  # `import` is given it
    for name in ("what it is", "what for", "licence", "files", "where", "at hand"):
        table.add_column(name, overflow="fold")
    for r in rows:
        at_hand = r["local_copy"] or "no: give data_dir=, set CLOTHBENCH_DATA, or let it be fetched"
        table.add_row(
            *(
                escape(str(t))
                for t in (r["name"], r["title"], r["use"], r["licence"], r["files"], r["address"], at_hand)
            )
        )
    console().print(table)


def print_import(folder: Path) -> None:
    """What came of each source file: frames in, kept, dropped and why."""
    report = json.loads((folder / REPORT).read_text())
    recordings = report["recordings"]
    sources = Counter(r["source"] for r in recordings)
    table = Table(title="import", title_justify="left", title_style="bold")
    table.add_column("source", overflow="fold")
    for name in ("frames in", "kept", "clock offset"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("dropped, masked, or why it was skipped", overflow="fold")
    for r in recordings:
        offset = f"{r['clock_offset_s']:+.3f} s" if r["clock_offset_s"] is not None else ""
        dropped = ", ".join(f"{n} {why}" for why, n in {**r["dropped"], **r["nodes_masked"]}.items())
        why = f"skipped: {r['skipped']}" if r["skipped"] else dropped
        source = r["source"] if sources[r["source"]] == 1 else f"{r['source']}: {r['output'] or 'nothing'}"
        table.add_row(escape(str(source)), str(r["frames_in"]), str(r["frames_kept"]), offset, escape(why))
    console().print(table)
    kept, came = (sum(r[n] for r in recordings) for n in ("frames_kept", "frames_in"))
    made = sum(not r["skipped"] for r in recordings)
    after = report.get("next", "clothbench validate {folder}")
    after = after.format(folder=shlex.quote(str(folder / report.get("next_folder", ""))))
    print(f"{made} recordings with {kept} of {came} frames in {folder}; next: {after}")
