"""Results beside what a paper says of the same metric: the error and the largest one of each recording."""

from __future__ import annotations

import numpy as np

from clothbench.display.html import group, table, text
from clothbench.display.names import model_name
from clothbench.display.section import Section
from clothbench.engine.study import Results

NOTE = """<p class="soft">The error of each recording, a mean as the metric has it, and its largest over the frames,
of the best fit; below them what the paper says. Its recordings are not these: read it as the size to be
expected.</p>"""


def published_section(results: Results) -> Section | None:
    """A table per metric that a paper has figures of; None if there is none."""
    about = {r["key"]: r for r in results.rows}
    errors = {(r["key"], r["metric"], r["recording"]): r["value"] for r in results.rows}
    published = results.table("published")
    traces = {key: results.store.table("trace", [key]) for key in {p["key"] for p in published}}
    parts = []
    for metric, said in group(published, lambda p: p["metric"]).items():
        body = []
        for key in sorted({p["key"] for p in said} & set(about), key=lambda k: (about[k]["case"], k)):
            mine = [t for t in traces[key] if t["metric"] == metric]
            for name, frames in group(mine, lambda t: t["recording"]).items():
                values = [f["value"] for f in frames if f["value"] is not None]
                row, split = about[key], frames[0]["split"].replace("_", " ")
                # The metric's own: the mean of the frames is another number where nodes are missing.
                mean, largest = errors.get((key, metric, name)), np.max(values) if values else None
                numbers = ["" if number is None else f"{number:.2f}" for number in (mean, largest)]
                cell = f"{model_name(row)} · {row['optimizer']}"
                body.append([text(row["case"]), text(cell), text(f"{name} ({split})"), *numbers, ""])
        for label, value, unit in sorted({(p["name"], p["value"], p["unit"]) for p in said}):
            body.append([text(label), "", "", "", "", text(f"{value:g} {unit}")])
        unit = next((t["unit"] for own in traces.values() for t in own if t["metric"] == metric), said[0]["unit"])
        head = ["case", "cell", "recording", f"mean [{unit}]", f"largest [{unit}]", "paper"]
        parts.append(f"<h3>{text(metric)}</h3>" + table(head, body, numeric={3, 4, 5}))
    if not parts:
        return None
    return Section(f"<h2>Beside the paper</h2>{NOTE}{''.join(parts)}")
