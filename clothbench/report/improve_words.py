"""What `clothbench improve` found, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.report.improve_figures import pooled
from clothbench.report.page_tables import group, text, unit

Rows = Sequence[dict[str, Any]]
WHITE = 0.3  # correlation of one frame with the next below which a residual looks like noise


def sentence(found: Mapping[str, Any]) -> str:
    """The verdict as HTML."""
    error, model = found["error_mm"], f"<b>{text(found['model'])}</b>"
    split = "held_out" if error["held_out"]["before"] is not None else "fit"
    where = "held-out" if split == "held_out" else "fit"
    before, after, floor = error[split]["before"], error[split]["after"], error["noise_floor"]
    if found["verdict"] == "complete":
        return (
            f"{model} lacks nothing above the noise: {before:.2f} mm on the {where} recordings, of which noise and "
            f"mesh account for {floor:.2f} mm."
        )
    if not found["effects"]:
        return (
            f"{model} leaves {found['unexplained_mm']:.2f} mm above noise and mesh that no candidate explains "
            f"({before:.2f} mm on the {where} recordings)."
        )
    lacks = " and ".join(named(effect) for effect in found["effects"])
    return (
        f"{model} lacks {lacks}. The error on the {where} recordings "
        f"falls from {before:.2f} to {after:.2f} mm; noise and mesh account for {floor:.2f} mm."
    )


def named(effect: Mapping[str, Any]) -> str:
    """ "clock_offset or x (delay = 0.05 s)" """
    names = " or ".join(f"<b>{text(n)}</b>" for n in (effect["name"], *effect["tied_with"]))
    amounts = ", ".join(
        f"{text(name)} = {p['value']:.3g}{'' if p['unit'] == '1' else ' ' + text(unit(p))}"
        for name, p in effect["parameters"].items()
    )
    return f"{names} ({amounts})" + (", which these recordings cannot tell apart" if effect["tied_with"] else "")


def remains(found: Mapping[str, Any], tables: Mapping[str, Rows]) -> list[str]:
    """How large what is left is, where, when and in which direction: one HTML sentence each."""
    lines = [f"{found['unexplained_mm']:.2f} mm above noise and mesh on the fit recordings."]
    if found["hint"]:
        lines.append(f"Hint: {text(found['hint'])}.")
    left = [r for r in tables["portrait"] if r["fit"] == "after"]
    if not left or found["unexplained_mm"] <= 0:
        return lines
    return [*lines, direction(left), whiteness(left), place(tables["nodes"]), moment(tables["frames"])]


def direction(left: Rows) -> str:
    names = ("normal", "warp", "weft")
    square = {n: sum(r[n] ** 2 for r in left) for n in names}
    total = sum(square.values()) or 1.0
    shares = ", ".join(f"{n} {100 * square[n] / total:.0f} %" for n in sorted(names, key=lambda n: -square[n]))
    return f"By direction (share of the mean square): {shares}."


def whiteness(left: Rows) -> str:
    known = [r["next_frame"] for r in left if r["next_frame"] is not None]
    mean = sum(known) / max(len(known), 1)
    what = "it looks like noise" if mean < WHITE else "it is no noise, something moves along"
    return f"Correlation of one frame with the next: {mean:.2f}; {what}."


def place(nodes: Rows) -> str:
    spots = group([r for r in nodes if r["after"] is not None], lambda r: (r["u"], r["v"]))
    (u, v), worst = max(((at, pooled(rows)["after"]) for at, rows in spots.items()), key=lambda item: item[1])
    return f"Largest on the cloth at u = {1e3 * u:.0f} mm, v = {1e3 * v:.0f} mm: {worst:.2f} mm."


def moment(frames: Rows) -> str:
    worst = max((r for r in frames if r["after"] is not None), key=lambda r: r["after"])
    return f"Largest in time at {worst['time']:.2f} s of {text(worst['recording'])}: {worst['after']:.2f} mm."
