"""Sections of the page on what is missing: told without a model, described without a name, and where and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.display.html import interval, table, text, unit
from clothbench.studies.improve import figures as draw
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.words import MORE, chance, more_is_left, p_is, size

Rows = Sequence[dict[str, Any]]
DESCRIBED = """A description, not a name: a force per area that acts on the cloth from outside, from the balance of
torques about the grips, an identity of mechanics that needs no model. n: normal, v: velocity, a: acceleration, s: from
the upper edge down to H, g: gravity."""
BALANCE = """Weight and inertia of the cloth as it was seen, about the line of its grips, have to balance what acts
from outside, whatever the cloth is made of and whatever a model makes of it."""
WHEREABOUTS = f"""Rms of what is left, and how many times that of the whole: recording by recording, of which the mean
is told (of parts of the cloth the geometric mean, of phases that of the mean squares), which need not be the ratio of
two numbers of this page. p, of a part of the cloth: how often it would be above the rest in recording after recording
by chance; of a phase: how often as much would be left in it of the same residual moved round in time, the best of all
phases. More than elsewhere: p below {LOOP.significance}, and {MORE} times the whole or more."""


def description_section(found: Mapping[str, Any] | None) -> str:
    """The law of a force that has no name."""
    if found is None:
        return ""
    body = [[text(t["term"]), f"{t['value']:.4g}", interval(t, ".4g") or "–", text(unit(t))] for t in found["terms"]]
    error, torque = found["error_mm"]["held_out"], found["torque"]
    said = (
        f"{DESCRIBED} The torque that is left on recordings left out falls from {1e3 * torque['before']:.3g} to "
        f"{1e3 * torque['after']:.3g} mN·m (noise {1e3 * torque['noise']:.2g}), {p_is(found['p_value'])}; with this "
        f"form of force in the model, its amounts fitted anew, the error falls from {size(error['before'], 'mm')} to "
        f"{size(error['after'], 'mm')} mm."
    )
    heads = ["goes with", "coefficient", "95 % interval", "unit"]
    shown = table(heads, body, numeric={1, 2})
    return f"<h2>Described</h2><p><b>{text(found['formula'])}</b></p>{shown}<p class='soft'>{said}</p>"


def balance_section(found: Mapping[str, Any] | None, kernel: Rows, blocks: list[dict[str, Any]]) -> str:
    """What the torque about the grips goes with, and its kernel over lag."""
    if found is None:
        return ""
    body = [[text(what), f"{100 * share:.0f} %"] for what, share in found["shares"].items()]
    shown = table(["goes with", "predicted on recordings left out"], body, numeric={1})
    law = f" The sparsest law: {text(found['formula'])} ({p_is(found['p_value'])})." if found["formula"] else ""
    if rests := found.get("recordings"):
        law += f" From {rests['used']} of {rests['of']} recordings that were fitted."
    caption = (
        "How long the past counts: force per area against a change of the normal velocity, by the time that has passed "
        "since. Band: spread between recordings (95 %), without what smoothing does to all alike; what the kernel is "
        "at the last lag cannot be told from drag, and is taken to be 0. Zero everywhere: no memory; all of it at 0: "
        "air that is carried along."
    )
    figure = block("kernel", caption, {"": [draw.kernel_figure(kernel)]}, blocks) if kernel else ""
    return f"<h2>Without any model</h2><p class='soft'>{BALANCE}{law}</p>{shown}{figure}"


def whereabouts_section(rows: Rows) -> str:
    """Parts of the cloth and phases of the motion, the most telling first."""
    if not rows:
        return ""
    body = []
    for r in sorted(rows, key=lambda r: (r["kind"] != "where", r["p_value"], -r["ratio"])):
        mark = ' <span class="pill note">more than elsewhere</span>' if more_is_left(r) else ""
        p_value = chance(r["p_value"]) if r["kind"] == "when" else f"{r['p_value']:.2g}"
        body.append([text(r["part"]) + mark, f"{size(r['rms'], r['unit'])}", f"{r['ratio']:.2f}", p_value])
    head = ["part or phase", f"left, rms [{rows[0]['unit']}]", "times the whole", "p"]
    return f"<h2>Where and when</h2><p class='soft'>{WHEREABOUTS}</p>{table(head, body, numeric={1, 2, 3})}"


def block(
    name: str, caption: str, views: Mapping[str, list[Any]], blocks: list[dict[str, Any]], menu: str = "Recording"
) -> str:
    """Figures with a caption; a menu above them where there are several views. Adds itself to `blocks`.

    `caption` and the names of views are HTML.
    """
    blocks.append({"id": name, "views": dict(views)})
    most = max(len(figures) for figures in views.values())
    places = "".join(f'<div id="{name}-{n}"></div>' for n in range(most))
    choice = ""
    if len(views) > 1:
        options = "".join(f'<option value="{key}">{key}</option>' for key in views)
        choice = f'<div class="menu"><label for="{name}-view">{menu}</label>'
        choice += f'<select id="{name}-view">{options}</select></div>'
    return f'{choice}<figure><figcaption>{caption}</figcaption><div class="beside">{places}</div></figure>'
