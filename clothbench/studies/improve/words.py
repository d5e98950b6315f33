"""What `clothbench improve` found, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.display.html import group, text, unit
from clothbench.studies.improve.figures import pooled

Rows = Sequence[dict[str, Any]]
WHITE = 0.3  # correlation of one frame with the next below which a residual looks like noise


def errors_of(found: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict's errors with their `unit`, mm of nodes, N of curves, sd of drapes; `unexplained` above the floor."""
    if "kind" in found:
        return {**found["error"], "unexplained": found["unexplained"]}
    return {"unit": "mm", **found["error_mm"], "unexplained": found["unexplained_mm"]}


def size(value: float | None, unit: str) -> str:
    """A number of millimetres to two places, of others to three digits; a dash where a run was stopped."""
    if value is None:
        return "–"
    return f"{value:.2f}" if unit == "mm" else f"{value:.3g}"


def floor_word(unit: str) -> str:
    """What the floor is made of."""
    return {"mm": "noise and mesh", "sd": "spread between specimens"}.get(unit, "spread between runs")


def floor_line(error: Mapping[str, Any]) -> str:
    """The floor; of a model on a mesh, noise and mesh apart."""
    unit = error["unit"]
    if error.get("mesh"):
        noise, mesh = (size(error[name], unit) for name in ("noise", "mesh"))
        return f"noise {noise} {unit}, and the mesh may be wrong by {mesh} {unit}"
    return f"the floor ({floor_word(unit)}) is {size(error['noise_floor'], unit)} {unit}"


def sentence(found: Mapping[str, Any]) -> str:
    """The verdict as HTML."""
    error, model = errors_of(found), f"<b>{text(found['model'])}</b>"
    if several := found.get("models"):
        model = f"each of <b>{text(', '.join(one['name'] for one in several))}</b>"
    unit = error["unit"]
    split = "held_out" if error["held_out"]["before"] is not None else "fit"
    where = "held-out" if split == "held_out" else "fit"
    floor = floor_line(error)
    before, after = (size(error[split][fit], unit) for fit in ("before", "after"))
    if found["verdict"] == "complete" and several:
        return f"No physics is missing in {model}: {before} {unit} on the {where} recordings; {floor}."
    if found["verdict"] == "complete":
        return f"{model} lacks nothing above the noise: {before} {unit} on the {where} recordings; {floor}."
    if not found["effects"]:
        rest = f"{size(error['unexplained'], unit)} {unit} above the floor"
        return f"{model} leaves {rest} that no candidate explains: {before} {unit} on the {where} recordings; {floor}."
    lacks = " and ".join(named(effect) for effect in found["effects"])
    return f"{model} lacks {lacks}. The error on the {where} recordings falls from {before} to {after} {unit}; {floor}."


def named(effect: Mapping[str, Any]) -> str:
    """ "clock_offset (delay = 0.05 s) or …, which these recordings cannot tell apart" """
    amounts = ", ".join(
        f"{text(name)} = {p['value']:.3g}{'' if p['unit'] == '1' else ' ' + text(unit(p))}"
        for name, p in effect["parameters"].items()
    )
    if effect.get("by_recording"):
        amounts = ", ".join(filter(None, (amounts, "its amounts each recording's own")))
    others = "".join(f" or <b>{text(n)}</b>" for n in effect["tied_with"])
    return f"<b>{text(effect['name'])}</b> ({amounts}){others}" + (
        ", which these recordings cannot tell apart" if others else ""
    )


def remains(found: Mapping[str, Any], tables: Mapping[str, Rows]) -> list[str]:
    """How large what is left is, where, when and in which direction: one HTML sentence each."""
    error = errors_of(found)
    lines = [f"{size(error['unexplained'], error['unit'])} {error['unit']} above the floor."]
    if found["hint"]:
        lines.append(f"Hint: {text(found['hint'])}.")
    after = [r for r in tables["portrait"] if r["fit"] == "after"]
    if not after or error["unexplained"] <= 0:
        return lines
    lines += [direction(after), whiteness(after), place(tables["nodes"]), moment(tables["frames"])]
    return [line for line in lines if line]


def direction(after: Rows) -> str:
    names = ("normal", "warp", "weft")
    square = {n: sum(r[n] ** 2 for r in after if r[n] is not None) for n in names}
    total = sum(square.values()) or 1.0
    shares = ", ".join(f"{n} {100 * square[n] / total:.0f} %" for n in sorted(names, key=lambda n: -square[n]))
    return f"By direction (share of the mean square): {shares}."


def whiteness(after: Rows) -> str:
    known = [r["next_frame"] for r in after if r["next_frame"] is not None]
    if not known:
        return ""
    mean = sum(known) / len(known)
    what = "it looks like noise" if mean < WHITE else "it is no noise, something moves along"
    return f"Correlation of one frame with the next: {mean:.2f}; {what}."


def place(nodes: Rows) -> str:
    spots = group([r for r in nodes if r["after"] is not None], lambda r: (r["u"], r["v"]))
    if not spots:
        return ""
    (u, v), worst = max(((at, pooled(rows)["after"]) for at, rows in spots.items()), key=lambda item: item[1])
    return f"Largest on the cloth at u = {1e3 * u:.0f} mm, v = {1e3 * v:.0f} mm: {worst:.2f} mm."


def moment(frames: Rows) -> str:
    worst = max((r for r in frames if r["after"] is not None), key=lambda r: r["after"], default=None)
    if worst is None:
        return ""
    return f"Largest in time at {worst['time']:.2f} s of {text(worst['recording'])}: {worst['after']:.2f} mm."
