"""What `clothbench improve` found, in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.display.html import group, text, unit
from clothbench.studies.improve.common import LEAST, leaves_nothing, speaking
from clothbench.studies.improve.figures import pooled
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.verdict import AT_LIMIT, listed

Rows = Sequence[dict[str, Any]]
MESHED = "noise and mesh"
SAME = 0.02  # share of an error that is no change of it
MORE = 1.1  # times as much as is left of the whole, from which on a part or a phase is said to have more
WHITE = 0.3  # correlation of one frame with the next below which a residual looks like noise


def errors_of(found: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict's errors with their `unit`, mm of nodes, N of curves, sd of drapes; `unexplained` beyond what noise
    and mesh account for; `alone` where there is one fit recording, beside which nothing can be spread.
    """
    if "kind" in found:
        alone = len(found["recordings"]["fit"]) == 1
        return {**found["error"], "unexplained": found["unexplained"], "alone": alone}
    return {"unit": "mm", **found["error_mm"], "unexplained": found["unexplained_mm"]}


def size(value: float | None, unit: str) -> str:
    """A number of millimetres to two places, of others to three digits; a dash where a run was stopped."""
    if value is None:
        return "–"
    return f"{value:.2f}" if unit == "mm" else f"{value:.3g}"


def limits(error: Mapping[str, Any]) -> list[tuple[str, float]]:
    """What an error cannot be told from, each in words with its size: noise, which a perfect model would leave; and of
    a model on a mesh, as much as noise and the mesh's own error leave together, which is no floor of the cloth's.
    """
    if error.get("mesh"):
        return [("noise", error["noise"]), (MESHED, error["noise_floor"])]
    return [(noise_word(error), error["noise_floor"])]


def noise_word(error: Mapping[str, Any]) -> str:
    """What noise is here; where it was not told from the mesh's error, the two."""
    runs = "noise of the only run" if error.get("alone") else "spread between runs"
    spread = {"sd": "spread between specimens", "N": runs}
    return spread.get(error["unit"], "noise" if "mesh" in error else MESHED)


def limit_line(error: Mapping[str, Any]) -> str:
    """The noise; of a model on a mesh, what the mesh may be wrong by apart from it."""
    unit = error["unit"]
    if error.get("mesh"):
        noise, mesh = (size(error[name], unit) for name in ("noise", "mesh"))
        least = f"at least as much as the fit leaves above that ({mesh} {unit})"
        wrong_by = least if mesh_is_capped(error) else f"{mesh} {unit}"
        return f"noise alone would give {noise} {unit}, and the mesh may be wrong by {wrong_by}"
    return f"the {noise_word(error)} alone would give {size(error['noise_floor'], unit)} {unit}"


def mesh_is_capped(error: Mapping[str, Any]) -> bool:
    """Whether the mesh may be wrong by more than is left above the noise, which is all of it that verdicts count."""
    after = error["fit"]["after"]
    return bool(error.get("mesh")) and after is not None and math.isclose(after, error["noise_floor"], rel_tol=1e-9)


def mesh_size(error: Mapping[str, Any]) -> str:
    """What the mesh may be wrong by: "0.74", "≥ 10.67" """
    return ("≥ " if mesh_is_capped(error) else "") + size(error["mesh"], error["unit"])


def beyond(error: Mapping[str, Any]) -> str:
    """How much is left that noise and mesh do not account for: "0.5 mm beyond noise and mesh"."""
    return f"{size(error['unexplained'], error['unit'])} {error['unit']} beyond {limits(error)[-1][0]}"


def left_on(error: Mapping[str, Any]) -> str:
    """Of which recordings `unexplained` is: of those that were fitted, unless only what was held out stands out."""
    if not error["unexplained"] or error["held_out"]["after"] is None or error["fit"]["after"] is None:
        return "fit"
    total = math.hypot(error["unexplained"], error["noise_floor"])
    return min(("fit", "held_out"), key=lambda split: abs(error[split]["after"] - total))


def left_where(error: Mapping[str, Any]) -> str:
    """ " on the recordings fitted (8.93 mm)", where others were held out."""
    after = error[split := left_on(error)]["after"]
    if error["held_out"]["before"] is None or after is None:
        return ""
    word = "fitted" if split == "fit" else "held out"
    return f" on the recordings {word} ({size(after, error['unit'])} {error['unit']})"


def chance(p_value: float, draws: int = LOOP.permutations) -> str:
    """A p-value in a permutation test of so many draws, of which it can tell no less than one in 1 + `draws`."""
    least = 1 / (1 + draws)
    return f"≤ 1/{1 + draws}" if p_value <= least * (1 + 1e-9) else f"{p_value:.2g}"


def p_is(p_value: float, draws: int = LOOP.permutations) -> str:
    """ "p = 0.03", "p ≤ 1/200" """
    said = chance(p_value, draws)
    return f"p {said}" if said.startswith("≤") else f"p = {said}"


def more_is_left(row: Mapping[str, Any]) -> bool:
    """Whether a row of `whereabouts` is beyond chance, and enough for it to be said."""
    return bool(row["p_value"] < LOOP.significance and row["ratio"] >= MORE)


def sham(error: Mapping[str, Any]) -> str:
    """What an effect that nothing speaks for does where it is added on top; "" where none was."""
    held = error["held_out"]
    if not (placebo := held.get("placebo")) or None in (placebo["after"], held["after"]):
        return ""
    unit, change = error["unit"], placebo["after"] / max(held["after"], 1e-300) - 1
    does = "changes nothing" if abs(change) <= SAME else "makes it worse" if change > 0 else "lowers it still further"
    fall = f"{size(held['after'], unit)} → {size(placebo['after'], unit)} {unit} on the held-out recordings"
    doubt = ": more freedom alone helps here, so take what was named with care" if change < -SAME else ""
    return f"A sham effect ({text(placebo['name'])}) added on top {does}: {fall}{doubt}."


def drawn(found: Mapping[str, Any]) -> str:
    """That no recording states a split; "" where one does, or where an older verdict has no word on it."""
    if not found.get("settings", {}).get("split_by_seed"):
        return ""
    held = found["recordings"]["held_out"]
    rest = f"which of them are held out was drawn with seed {found['seed']}" if held else "nothing is held out"
    return f"No recording states a split; {rest}."


def noise_told(error: Mapping[str, Any]) -> str:
    """That the noise is an estimate; "" where recordings state it, or where an older verdict has no word on it."""
    if error.get("noise_stated") is not False:
        return ""
    return "Not all recordings state their noise; it was told from how much neighbouring frames jump."


def sentence(found: Mapping[str, Any]) -> str:
    """The verdict as HTML."""
    error, model = errors_of(found), f"<b>{text(found['model'])}</b>"
    several = found.get("models") or ()
    if several:
        model = f"each of <b>{text(', '.join(one['name'] for one in several))}</b>"
    unit = error["unit"]
    split = "held_out" if error["held_out"]["before"] is not None else "fit"
    where = "held-out" if split == "held_out" else "fit"
    floor = limit_line(error)
    before, after = (size(error[split][fit], unit) for fit in ("before", "after"))
    if found["verdict"] == "complete" and several:
        return f"No physics is missing in {model}: {before} {unit} on the {where} recordings; {floor}."
    if found["verdict"] == "complete":
        return f"{model} lacks nothing above the noise: {before} {unit} on the {where} recordings; {floor}."
    if not found["effects"]:
        rest = f"{before} {unit} on the {where} recordings; {floor}."
        heard = speaking(several)
        if heard and len(heard) < LEAST:
            return (
                f"Of {text(' and '.join(one['name'] for one in several))} only <b>{text(heard[0]['name'])}</b> has "
                f"something to say, so that nothing is known to be in common: {rest}"
            )
        if heard:
            return f"What {model} lacks is nothing that they have in common: {rest}"
        if found["hint"].startswith(AT_LIMIT) and split == "fit" and error["held_out"]["per_recording"]:
            return f"What {model} leaves is nothing above noise and mesh, but not all of it could be judged: {rest}"
        if several and not all(map(leaves_nothing, several)):
            return f"None of {text(listed([one['name'] for one in several]))} has a name for what it leaves: {rest}"
        if not error["unexplained"]:
            on = "" if several else left_where(error)
            accounts = "noise and its mesh account" if error.get("mesh") else f"the {noise_word(error)} accounts"
            account = f"no more than {accounts} for"
            return f"What {model} leaves{on} is {account}, so that nothing is named: {rest}"
        if left_on(error) != split:
            return f"{model} leaves {beyond(error)}{left_where(error)} for which no effect can be named; {rest}"
        return f"{model} leaves {beyond(error)} for which no effect can be named: {rest}"
    lacks = " and ".join(named(effect) for effect in found["effects"])
    return f"{model} lacks {lacks}. The error on the {where} recordings falls from {before} to {after} {unit}; {floor}."


def named(effect: Mapping[str, Any]) -> str:
    """ "clock_offset: positions are stamped late (delay = 0.05 s); or …, which these recordings cannot tell apart" """
    amounts = ", ".join(
        f"{text(name)} = {p['value']:.3g}{'' if p['unit'] == '1' else ' ' + text(unit(p))}"
        for name, p in effect["parameters"].items()
    )
    if effect.get("by_recording"):
        amounts = ", ".join(filter(None, (amounts, "its amounts each recording's own")))
    others = "".join(f" or <b>{text(n)}</b>" for n in effect["tied_with"])
    means = f": {text(effect['summary'])}" if effect.get("summary") else ""
    amounts = f" ({amounts})" if amounts else ""
    return f"<b>{text(effect['name'])}</b>{means}{amounts}{others}" + (
        ", which these recordings cannot tell apart" if others else ""
    )


def remains(found: Mapping[str, Any], tables: Mapping[str, Rows]) -> list[str]:
    """How large what is left is, where, when and in which direction: one HTML sentence each."""
    error = errors_of(found)
    lines = [f"{beyond(error)}{left_where(error)}."]
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
    held = " (held out)" if worst["split"] == "held_out" else ""
    return f"Largest in time at {worst['time']:.2f} s of {text(worst['recording'])}{held}: {worst['after']:.2f} mm."
