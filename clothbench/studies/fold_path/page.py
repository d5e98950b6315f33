"""The page's section on folding paths: the answer, the table, the paths, the friction they take, the shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np

from clothbench.display.answer import Card, answer
from clothbench.display.html import group, pill, table, text
from clothbench.display.names import differing
from clothbench.display.plotly import COLOURS, GREY, log_axis, rounded
from clothbench.display.section import Section, drawing
from clothbench.engine.study import Results
from clothbench.studies.fold_path.tables import lines, told_by, values

Rows = Sequence[dict[str, Any]]
INTRO = """<p class="soft">One edge is led over so that it comes to lie on the other. Landing error: how far beside it
lands, because what lies on the desk slips. Friction needed: the coefficient that keeps it in place all the way; where
the desk has less, it slips until that suffices. The computed path has three phases: lifted, carried over, laid
down.</p>"""


def sections(results: Results) -> list[Section]:
    suites = sorted({r["suite"] for r in results.rows})
    told = {suite: lines(results, suite) for suite in suites}
    body = "".join(
        answer_of(suite, [x for x in found if x["status"] != "skipped"])
        + f"<h2>{text(suite)}: paths</h2>{INTRO}{listed(found)}"
        for suite, found in told.items()
    )
    shown = figures(results.table("fold_path"), results.table("fold_shapes"), differing(results.rows))
    drawn = "".join(
        f'<figure><figcaption>{text(words)}</figcaption><div id="fold-path-{n}"></div></figure>'
        for n, (_, words) in enumerate(shown)
    )
    return [Section(body + drawn, {"fold-paths": [f for f, _ in shown]}, drawing("fold-paths", "fold-path-"))]


def answer_of(suite: str, asked: Rows) -> str:
    """Which path lands best in the middle of all fabrics, and what it takes; asked: one record for each cell, those
    that failed among them. What failed somewhere comes behind what did not. Other settings are another path.
    """
    done = [x for x in asked if x["status"] == "ok"]
    if not done:
        return ""
    counts = {way: len(mine) for way, mine in group(asked, _way).items()}
    ways = group(done, _way)
    off = {way: float(np.median([abs(x["landing_error"]) for x in mine])) for way, mine in ways.items()}
    ranked = sorted(counts, key=lambda way: (counts[way] - len(ways.get(way, ())), off.get(way, np.inf)))
    sentences = [
        f"<b>{text(way[0])}</b> path, {text(_listed(way[1:]))}: "
        + (f"lands {off[way]:.3g} mm beside, median of " if way in ways else "lands in ")
        + f"{len(ways.get(way, ()))} of {counts[way]} fabric{'s' * (counts[way] > 1)}."
        for way in ranked
    ]
    cards = []
    told = [x for x in done if x.get("friction") is not None]
    for (way, settings), mine in group(told, lambda x: (x["way"], x["settings"])).items():
        slips = sum(x["friction"] > x["desk"] for x in mine)
        most = max(x["friction"] for x in mine)
        below = f"the most for a fabric; {slips} of {len(mine)} slip on a desk of {mine[0]['desk']:g}"
        cards.append(Card(_listed((f"Friction, {way} path", settings)), f"{most:.2f}", below, good=not slips))
    return answer(f"{suite}: the answer", " ".join(sentences), cards)


def _way(line: dict[str, Any]) -> tuple[str, str, str]:
    return line["way"], line["model"], line["settings"]


def _listed(words: Sequence[str]) -> str:
    return ", ".join(filter(None, words))


def listed(found: Rows) -> str:
    about = told_by(found)
    head = [*about, "landing error", "slip", "friction needed", "status"]
    body = [
        [*(text(x[n]) for n in about.values()), *(text(v) for v in values(x)),
         pill(x) + (f"<br><small>{text(x['reason'])}</small>" if x["reason"] else "")]
        for x in found
    ]  # fmt: skip
    return table(head, body, numeric=set(range(len(about), len(about) + 3)))


def figures(steps: Rows, shapes: Rows, settings: Mapping[str, str]) -> list[tuple[dict[str, Any], str]]:
    """Paths and frictions of all cells, and the shapes of the first fabric on each path, with what they show; settings:
    by the cells' keys, where they differ.
    """
    if not steps:
        return []
    out = [
        (
            path_figure(steps, settings),
            "Where the hand goes: paths of every fabric; dots are where phases 2 and 3 begin.",
        )
    ]
    if any(s["needed"] is not None for s in steps):
        out.append((friction_figure(steps, settings), "The friction that each step takes, along the way."))
    first = steps[0]["fabric"]
    for (way, model, told), mine in group(
        [s for s in shapes if s["fabric"] == first], lambda s: (s["way"], s["model"], settings[s["key"]])
    ).items():
        about = _listed((f"{first} on the {way} path", model, told))
        out.append((shape_figure(mine), f"{about}: the middle line from flat to folded."))
    return out


def path_figure(steps: Rows, settings: Mapping[str, str]) -> dict[str, Any]:
    data = []
    strips = group(steps, lambda s: (s["fabric"], s["way"], settings[s["key"]]))
    geometric = {(way, told) for _, way, told in strips if way != "computed"}
    for n, ((fabric, way, told), mine) in enumerate(strips.items()):
        if way != "computed":
            continue
        one = [s for s in mine if s["key"] == mine[0]["key"]]
        data.append(_line([s["x"] for s in one], [s["z"] for s in one], n, _listed((fabric, told))))
        starts = [b for a, b in pairwise(one) if b["phase"] != a["phase"]]
        data.append({"type": "scatter", "mode": "markers", "x": rounded(np.array([s["x"] for s in starts])),
                     "y": rounded(np.array([s["z"] for s in starts])), "showlegend": False, "hoverinfo": "skip",
                     "marker": {"color": COLOURS[n % len(COLOURS)], "size": 7}})  # fmt: skip
    for way, told in sorted(geometric):
        mine = next(m for (_, *of), m in strips.items() if of == [way, told])
        one = [s for s in mine if s["key"] == mine[0]["key"]]
        dash = "dash" if way == "triangular" else "dot"
        line = _line([s["x"] for s in one], [s["z"] for s in one], 0, _listed((way, told)))
        data.append(line | {"line": {"color": GREY, "width": 2, "dash": dash}})
    return _figure(data, 460, "x [m]", {"title": {"text": "z [m]"}, "scaleanchor": "x", "zeroline": False})


def friction_figure(steps: Rows, settings: Mapping[str, str]) -> dict[str, Any]:
    data = []
    told = group([s for s in steps if s["needed"] is not None], lambda s: s["key"])
    for n, (key, mine) in enumerate(told.items()):
        name = _listed((mine[0]["fabric"], mine[0]["way"], settings[key]))
        share = np.arange(1, len(mine) + 1) / len(mine)
        data.append(_line(share, [max(s["needed"], 1e-4) for s in mine], n, name))
    ticks = log_axis(value for line in data for value in line["y"])
    return _figure(data, 380, "share of the way", {"title": {"text": "friction needed"}, **ticks})


def shape_figure(points: Rows) -> dict[str, Any]:
    data = []
    for frame, mine in group(points, lambda s: s["frame"]).items():
        data.append(_line([s["x"] for s in mine], [s["z"] for s in mine], 0, f"{frame}") | {"showlegend": False})
    return _figure(data, 320, "x [m]", {"title": {"text": "z [m]"}, "scaleanchor": "x", "zeroline": False})


def _line(x: Any, y: Any, number: int, name: str) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines", "x": rounded(np.array(x)), "y": rounded(np.array(y)), "name": escape(name),
        "line": {"color": COLOURS[number % len(COLOURS)], "width": 1.5},
        "hovertemplate": f"{escape(name)}<extra></extra>",
    }  # fmt: skip


def _figure(data: list[dict[str, Any]], height: int, x: str, y: dict[str, Any]) -> dict[str, Any]:
    axis = {"title": {"text": x}, "zeroline": False}
    layout = {"height": height, "xaxis": axis, "yaxis": y, "showlegend": any("name" in d for d in data)}
    return {"data": data, "layout": {**layout, "margin": {"l": 64, "r": 16, "t": 28, "b": 48}}}
