"""The page of `clothbench improve`: the verdict on top, then what it rests on. One self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from clothbench.display.html import below, group, interval, table, text, unit
from clothbench.display.names import duration
from clothbench.display.page import whole_page
from clothbench.display.parameters import condition_said, fitted_value
from clothbench.display.section import Section
from clothbench.display.templates import rendered
from clothbench.engine.study import Results
from clothbench.engine.system import system_info
from clothbench.studies.improve import figures as draw
from clothbench.studies.improve.document import document_in
from clothbench.studies.improve.drape_quantities import PERMUTATIONS
from clothbench.studies.improve.drawings import drawing
from clothbench.studies.improve.missing_page import balance_section, block, description_section, whereabouts_section
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.style import BLOCKS, STYLE
from clothbench.studies.improve.words import (
    beyond,
    chance,
    drawn,
    errors_of,
    left_on,
    limits,
    mesh_is_capped,
    mesh_size,
    noise_told,
    p_is,
    remains,
    sentence,
    sham,
    size,
)

Rows = Sequence[dict[str, Any]]
Tables = Mapping[str, Rows]
HERE = Path(__file__).parent
SURE = {"complete": "ok", "attributed": "ok"}
OVER = {"mm": "visible node coordinates", "N": "steps of stretch", "sd": "sides and quantities"}
LEGEND = '<div class="menu top"><div id="legend"></div></div>'
FOOTER = "The same as data: <code>verdict.json</code> and the Parquet files in <code>tables</code>."
VIEWED = """ See a recording beside the model before and after:
<code>clothbench view RECORDING --out FOLDER</code>."""

CANDIDATES = f"""<p class="soft">Share: how much of what the calibrated model leaves only this effect could explain, to
first order. p: how often chance does as well with the best of all candidates; {LOOP.permutations} draws can tell no p
below 1/{1 + LOOP.permutations}. Of those that beat chance the most promising were fitted in earnest; the gain is by how
much the mean square fell. Best in: of as many rounds with one recording left out.</p>"""
OWN = (
    "Amounts in a recording are its own: one that holds for all would not do. Those of a recording held out are fitted "
    "to it, while everything that is shared stays as the others have it; the interval is from parts of its time."
)
DRAPES = """<p class="soft">A cloth whose faces and threads are alike drapes alike on either side, and is as long one
way as the other. First what the drapes say without any model, then what the model has. Elongation: second harmonic of
the outline, along the line of the picture along which, or across which, this fabric's drapes are long.</p>"""
CAPTURES = """<p class="soft">Drapes that are laid on anew fold anew. Where captures of one side of a specimen look
alike beyond chance (p), folds are remembered or the cloth was not laid on anew, which pictures cannot tell apart: then
there are fewer drapes than captures.</p>"""
DRIFT = """The calibrated model fitted to each recording alone. Line and band: all together, 95 % interval,
about which single recordings scatter more widely. Diamonds stand out of the spread of all whose search moved (Grubbs'
test, 5 % over all recordings and parameters)."""
COARSE = """the mesh may be wrong by more than the noise, which moves parameters from recording to recording, too:
this is no sign of missing physics"""


def page_html(found: Mapping[str, Any], tables: Tables) -> str:
    """The whole page as text. found: what `verdict.json` holds; tables: the rows of each table by name."""
    blocks: list[dict[str, Any]] = []
    sections = [
        heading(found, system_info()),
        verdict_box(found),
        tiles(found),
        effect_section(found),
        LEGEND,
        error_section(found, tables["errors"], blocks),
        description_section(found.get("description")),
        balance_section(found.get("balance"), tables["kernel"], blocks),
        candidate_section(tables["candidates"]),
        curve_section(tables["curves"], bool(found["effects"]), blocks),
        drape_section(tables, bool(found["effects"])),
        frame_section(found, tables["frames"], blocks),
        map_section(found, tables["nodes"], blocks),
        whereabouts_section(tables["whereabouts"]),
        direction_section(found, tables["portrait"], blocks),
        against_section(found, tables["against"], blocks),
        parameter_section(tables["parameters"], bool(found["effects"]), found.get("condition")),
        drift_section(found, tables["drift"], blocks),
        stage_section(found, tables["stages"], blocks),
        remains_section(found, tables),
    ]
    # What moves has Rerun files, curves and drapes have none.
    footer = f"<footer>{FOOTER}{VIEWED if tables['frames'] else ''}</footer>"
    drawn = Section(footer, {"found": {"legend": legend(found), "blocks": blocks}}, BLOCKS, STYLE)
    return whole_page(f"improve {text(found['model'])}", [*map(Section, sections), drawn])


def common_html(found: Mapping[str, Any]) -> str:
    """The page of several models: the verdict on what they lack in common, and of each what it lacks, with a link to
    its own page. found: as `common.common_document` makes it.
    """
    models = " and ".join(one["name"] for one in found["models"])
    rows = []
    for one in found["models"]:
        error = errors_of({**found, **one})
        split = "fit" if error["held_out"]["before"] is None else "held_out"
        own = f" ({', '.join(one['own'])}: a fault of its own)" if one["own"] else ""
        rows.append(
            [f'<a href="cells/{one["key"]}/index.html">{text(one["name"])}</a>', text(one["verdict"]),
             text(", ".join(entry["name"] for entry in one["effects"]) + own),
             " → ".join(size(error[split][fit], error["unit"]) for fit in ("before", "after")) + f" {error['unit']}",
             size(error["noise"], error["unit"]), mesh_size(error)]
        )  # fmt: skip
    heads = ["model", "verdict", "lacks", "error before → after", "noise", "mesh"]
    parts = [
        f"<h1>What do {text(models)} lack in common?</h1>", verdict_box(found), table(heads, rows, numeric={3, 4, 5}),
        "<p class='soft'>What all lack that have something to say is physics or the sensor; what one lacks and no "
        "other does is its own fault. Error: on the recordings held out.</p>",
        effect_section(found),
    ]  # fmt: skip
    return whole_page(f"improve {text(models)}", [Section("".join(parts), style=STYLE)])


def sections(results: Results) -> list[Section]:
    """Of each verdict what it says and rests on, without figures, which are on its own page."""
    out, computed = [], {row["key"]: row for row in results.rows}
    for key in results.keys:
        if (found := document_in(results.store.cell(key))) is None:
            continue
        parts = [
            heading(found, computed.get(key, {}), "h2"), verdict_box(found), tiles(found), effect_section(found, "h3"),
            f'<p><a href="cells/{key}/index.html">All of it, with figures</a></p>',
        ]  # fmt: skip
        out.append(Section("".join(parts), style=STYLE))
    return out


def heading(found: Mapping[str, Any], about: Mapping[str, Any], level: str = "h1") -> str:
    """about: the version and the machine that it was computed with, as far as that is known (`system_info`)."""
    count = {k: len(v) for k, v in found["recordings"].items()}
    base = "".join(f" + {name}" for name in found.get("base", ()))
    facts = [
        f"{count['fit']} recordings fitted, {count['held_out']} held out",
        f"{found['evaluations']} evaluations in {duration(found['wall_s'])}",
        f"seed {found['seed']}",
    ]
    if about:
        facts += [f"clothbench {about['clothbench']}", f"{about['cpu']}, {about['cores']} cores"]
    return (
        f"<{level}>What does {text(found['model'] + base)} lack?</{level}><p class='soft'>{text(' · '.join(facts))}</p>"
    )


def verdict_box(found: Mapping[str, Any]) -> str:
    pill = f'<span class="pill {SURE.get(found["verdict"], "note")}">{text(found["verdict"])}</span>'
    hint = f'<p class="soft">Hint: {text(found["hint"])}.</p>' if found["hint"] else ""
    control = f'<p class="soft">{said}</p>' if (said := sham(errors_of(found))) else ""
    split = f'<p class="soft">{said}</p>' if (said := drawn(found)) else ""
    noise = f'<p class="soft">{said}</p>' if (said := noise_told(errors_of(found))) else ""
    return f'<div class="verdict">{pill}<p>{sentence(found)}</p>{control}{hint}{split}{noise}</div>'


def tiles(found: Mapping[str, Any]) -> str:
    error, changed = errors_of(found), bool(found["effects"])
    unit, shown = error["unit"], []
    for split, word in (("held_out", "held out"), ("fit", "fit")):
        if error[split]["before"] is not None:
            value = size(error[split]["before"], unit)
            value += f" → {size(error[split]['after'], unit)}" if changed else ""
            shown.append((value, f"{unit}, {word}" + (", before → after" if changed else "")))
    (noise, alone), *_ = limits(error)
    shown.append((size(alone, unit), f"{unit}, {noise} alone"))
    if error.get("mesh"):
        shown.append((mesh_size(error), f"{unit} that the mesh may be wrong by"))
    left, _, words = beyond(error).partition(" ")
    split = f", {left_on(error).replace('_', ' ')}" if error["held_out"]["before"] is not None else ""
    shown.append((left, f"{words} remain{split}"))
    inside = "".join(f'<div class="tile"><b>{text(value)}</b>{text(word)}</div>' for value, word in shown)
    return f'<div class="tiles">{inside}</div>'


def error_section(found: Mapping[str, Any], errors: Rows, blocks: list[dict[str, Any]]) -> str:
    if not errors:
        return ""
    error = errors_of(found)
    over = OVER[error["unit"]]
    caption = f"Root-mean-square over {over}. Dots: recordings that were fitted; diamonds: held out, never fitted, "
    known = [name for name, _ in limits(error)]
    caption += f"which decide only whether the verdict stands. Grey line: {known[0]} alone"
    much = " (no more of the mesh than the fit leaves)" if mesh_is_capped(error) else ""
    caption += f"; dotted: {known[1]}{much}, below which this mesh tells nothing." if len(known) > 1 else "."
    fall = error["held_out"]["ci95"]
    if found["effects"] and fall[0] is not None:
        low, high = (size(v, error["unit"]) for v in fall)
        caption += f" The error on what is held out falls by {low} … {high} {error['unit']} (95 %, paired over "
        caption += "recordings)."
    if any(effect.get("by_recording") for effect in found["effects"]):
        caption += " Amounts of each recording's own were fitted to those held out, too, which lowers the error there "
        caption += "whatever they stand for: the verdict makes each of these numbers pay, as on the fitted ones."
    if said := sham(error):
        caption += f" Cross: {said}"
    views = {"": [draw.error_figure(errors, error, limits(error), bool(found["effects"]))]}
    return "<h2>Error</h2>" + block("errors", caption, views, blocks)


def effect_section(found: Mapping[str, Any], level: str = "h2") -> str:
    """What was named: each effect in words with its picture, then its amounts with intervals and units."""
    if not found["effects"]:
        return ""
    own = f"<p class='soft'>{OWN}</p>" if any(effect.get("by_recording") for effect in found["effects"]) else ""
    return f"<{level}>Named</{level}>" + "".join(map(effect_card, found["effects"])) + own


def effect_card(effect: Mapping[str, Any]) -> str:
    amounts = [amount_row(name, p) for name, p in effect["parameters"].items()]
    for one in effect.get("by_recording") or ():
        held = ", held out" if one["split"] == "held_out" else ""
        where = f" <small>in {text(one['recording'])}{held}</small>"
        amounts += [amount_row(name, p, where) for name, p in one["parameters"].items()]
    picture = Markup(drawing(effect.get("family", ""), text(effect["summary"])))
    sure = p_is(effect["p_value"])
    return rendered(HERE, "effect.html", effect=effect, picture=picture, sure=sure, amounts=amounts)


def amount_row(name: str, p: Mapping[str, Any], where: str = "") -> list[str]:
    """One amount, with what it means below its name."""
    shown = text(name) + where + below(text(p.get("meaning")))
    return [shown, f"{p['value']:.4g}", interval(dict(p), ".4g") or "–", text(unit(dict(p)))]


def candidate_section(candidates: Rows) -> str:
    """One table per round; its bars are the share of the residual that only that effect could explain."""
    if not candidates:
        return ""
    rounds = group(candidates, lambda r: r["round"])
    out = [f'<div class="candidates"><h2>Candidates</h2>{CANDIDATES}']
    for number, rows in rounds.items():
        gain = f"gain [{rows[0]['unit']}]"
        head = ["candidate", "place", "share of the residual", "p", gain, "best in", "why not"]
        shown = table(head, [candidate_row(r) for r in rows], numeric={3, 4, 5})
        out.append((f"<h3>Round {number}</h3>" if len(rounds) > 1 else "") + shown)
    return "".join([*out, "</div>"])


def candidate_row(row: dict[str, Any]) -> list[str]:
    kind = "named" if row["named"] else "tried" if row["gain"] is not None else ""
    width = f"{100 * min(max(row['share'], 0.0), 1.0):.1f}"
    bar = f'<div class="bar {kind}"><i style="width:{width}%"></i><span>{100 * row["share"]:.1f} %</span></div>'
    name = f'<span title="{text(row["summary"])}">{text(row["name"])}</span>'
    gain = "–" if row["gain"] is None else f"{round(row['gain'], 9):.3g}"
    best = "–" if row["gain"] is None else f"{row['selected']}/{row['of']}"
    why = '<span class="pill ok">named</span>' if row["named"] else text(row["why_not"])
    return [name, text(row["place"]), bar, chance(row["p_value"]), gain, best, why]


def curve_section(curves: Rows, changed: bool, blocks: list[dict[str, Any]]) -> str:
    if not curves:
        return ""
    caption = "Dots: measured, medians over steps of stretch. Lines: the model."
    return "<h2>Force over stretch</h2>" + block("curves", caption, draw.curve_figures(curves, changed), blocks)


def drape_section(tables: Tables, changed: bool) -> str:
    """Mean over the specimens of each split of what was measured, beside the model; how much captures look alike."""
    if not (drapes := tables["drapes"]):
        return ""
    said = [
        [text(r["contrast"]), text(r["split"].replace("_", " ")), str(r["number"]), signed(r["mean"]),
         f"{r['low']:.2f} … {r['high']:.2f}", text(r["unit"]), f"{r['p_value']:.2g}"]
        for r in tables["asymmetries"]
    ]  # fmt: skip
    first = ["what symmetry forbids", "specimens", "number", "mean", "95 % interval", "unit", "p"]
    body = []
    for (side, quantity, split), rows in group(drapes, lambda r: (r["side"], r["quantity"], r["split"])).items():
        known = [[r[name] for r in rows if r[name] is not None] for name in ("measured", "before", "after")]
        mean, before, after = (sum(each) / len(each) if each else None for each in known)
        model = f"{signed(before)} → {signed(after)}" if changed else signed(before)
        name = text(quantity.replace("_", " "))
        body.append([name, text(side), text(split.replace("_", " ")), str(len(rows)), signed(mean),
                     f"{rows[0]['spread']:.2f}", model, text(rows[0]["unit"])])  # fmt: skip
    head = ["quantity", "side", "specimens", "number", "measured", "spread between specimens", "model", "unit"]
    pairs = [
        [text(r["pairs"]), str(r["number"]), signed(r["correlation"]), chance(r["p_value"], PERMUTATIONS)]
        for r in tables["captures"]
    ]
    seen = table(["pairs of captures", "number", "correlation of outlines", "p"], pairs, numeric={1, 2, 3})
    alone = table(first, said, numeric={2, 3, 4, 6}) if said else ""
    return f"<h2>Drapes, side by side</h2>{DRAPES}{alone}{table(head, body, numeric={3, 4, 5, 6})}{CAPTURES}{seen}"


def signed(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def frame_section(found: Mapping[str, Any], frames: Rows, blocks: list[dict[str, Any]]) -> str:
    if not frames:
        return ""
    views = draw.frame_figures(frames, limits(errors_of(found)), bool(found["effects"]))
    return "<h2>Over time</h2>" + block("frames", "Error of each frame.", views, blocks)


def map_section(found: Mapping[str, Any], nodes: Rows, blocks: list[dict[str, Any]]) -> str:
    if not nodes:
        return ""
    views = draw.map_figures(nodes, bool(found["effects"]))
    caption = "Error of each node on the cloth laid flat, over all frames; one scale for both."
    return "<h2>Over the cloth</h2>" + block("map", caption, views, blocks)


def direction_section(found: Mapping[str, Any], portrait: Rows, blocks: list[dict[str, Any]]) -> str:
    if not portrait:
        return ""
    views = draw.direction_figures(portrait, bool(found["effects"]))
    caption = "The residual split along the sheet's normal, along warp, and in the sheet across warp (weft), of nodes "
    caption += "whose neighbours were seen: distances, whose squares add up to that of the whole distance."
    body = []
    for name, rows in draw.by_recording(portrait).items():
        at = {r["fit"]: r for r in rows}
        shown = [at["before"], at["after"]] if found["effects"] else [at["before"]]
        body.append([name, *(" → ".join(format_number(r[n]) for r in shown) for n in ("rms", "next_frame"))])
    head = ["recording", f"rms [{portrait[0]['unit']}]", "correlation of a frame with the next (noise: 0)"]
    listed = table(head, body, numeric={1, 2})
    collapsed = f"<details><summary>Is it noise? Correlation in time</summary>{listed}</details>"
    return "<h2>By direction</h2>" + block("directions", caption, views, blocks) + collapsed


def against_section(found: Mapping[str, Any], bins: Rows, blocks: list[dict[str, Any]]) -> str:
    figures = draw.against_figures(bins, limits(errors_of(found)), bool(found["effects"]))
    if not figures:
        return ""
    caption = "Error in eight classes of equal size of how fast a node moves, how hard it is accelerated, and how high "
    caption += "it is above the lowest point reached; all recordings together."
    return "<h2>Against the motion</h2>" + block("against", caption, {"": figures}, blocks)


def parameter_section(rows: Rows, changed: bool, condition: float | None) -> str:
    """Every parameter before and after, with intervals; on its bound, the bound chose it and not the data."""
    names = group(rows, lambda r: r["name"])
    fits = ("before", "after") if changed else ("before",)
    body = []
    for name, mine in names.items():
        at = {r["fit"]: r for r in mine}
        cells = [fitted_value(at[fit]) if fit in at else "–" for fit in fits]
        p = mine[-1]
        body.append([f"{text(p['symbol'])} <small>{text(name)}</small>", *cells, text(unit(p)), text(p["meaning"])])
    head = ["parameter", *(("before", "after") if changed else ("value",)), "unit", "meaning"]
    note = "Below the values, 95 % intervals: a jackknife over recordings, and what mesh and model may be wrong by."
    note += f" {condition_said([condition])}" if condition is not None else ""
    return f'<h2>Parameters</h2><p class="soft">{note}</p>' + table(head, body, numeric=set(range(1, len(head) - 2)))


def drift_section(found: Mapping[str, Any], drift: Rows, blocks: list[dict[str, Any]]) -> str:
    if not drift:
        return ""
    caption, views = f"{DRIFT} {still_said(drift)}{drift_said(found, drift)}", draw.drift_figures(drift)
    return f"<h2>Drift from recording to recording</h2>{block('drift', caption, views, blocks, 'Parameter')}"


def still_said(drift: Rows) -> str:
    """How many values have no say, as their searches did not move; "" where all did."""
    still = sum(int(draw.not_moved(rows).sum()) for rows in group(drift, lambda r: r["name"]).values())
    said = f"Of {len(drift)} values {still} lie where their search began, or at a bound (hollow), and have no say. "
    return said if still else ""


def drift_said(found: Mapping[str, Any], drift: Rows) -> str:
    """Which parameters stand out, and what that is a sign of."""
    outside = sorted({r["name"] for r in drift if r["outside"]})
    if not outside:
        return "None stands out."
    error = errors_of(found)
    coarse = error.get("mesh", 0.0) > error.get("noise", 0.0)
    sign = f"; {COARSE}" if coarse else ", which may be a sign of physics that the calibrated model lacks"
    return f"Standing out: {text(', '.join(outside))}{sign}."


def stage_section(found: Mapping[str, Any], stages: Rows, blocks: list[dict[str, Any]]) -> str:
    if not stages:
        return ""
    caption = f"{duration(found['wall_s'])} and {found['evaluations']} evaluations in all; "
    caption += "beside each bar its seconds and evaluations."
    return "<h2>Budget by stage</h2>" + block("stages", caption, {"": [draw.stage_figure(stages)]}, blocks)


def remains_section(found: Mapping[str, Any], tables: Tables) -> str:
    lines = "".join(f"<li>{line}</li>" for line in remains(found, tables))
    return f"<h2>What remains</h2><ul>{lines}</ul>"


def legend(found: Mapping[str, Any]) -> list[list[str]]:
    """[name, colour, dash] of what the figures draw."""
    looks = [look for _, look in draw.series(bool(found["effects"]))]
    looks += [look for _, look in draw.limit_looks(limits(errors_of(found)))]
    looks += [draw.PLACEBO] if errors_of(found)["held_out"].get("placebo") else []
    looks += [draw.MEASURED] if found.get("kind") == "curve" else []
    return [[look["name"], look["colour"], look.get("dash", "solid")] for look in looks]


def format_number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
