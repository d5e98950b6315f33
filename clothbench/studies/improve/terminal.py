"""What the terminal shows of verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from clothbench.engine.study import Results
from clothbench.studies.improve.document import document_in
from clothbench.studies.improve.words import errors_of, limit_line, more_is_left, noise_told, p_is, size


def show(results: Results) -> Iterator[str]:
    """Every verdict in a few lines, and where its page is."""
    for key in results.keys:
        folder = results.store.cell(key)
        if (found := document_in(folder)) is not None:
            yield "\n".join([what(found), *verdict_lines(found), f"page: {folder / 'index.html'}", ""])


def what(found: Mapping[str, Any]) -> str:
    return "What does " + " + ".join((found["model"], *found["base"])) + " lack?"


def verdict_lines(found: Mapping[str, Any]) -> Iterator[str]:
    """What `verdict.json` holds, in a few lines."""
    for one in found.get("models", ()):
        names = ", ".join(entry["name"] for entry in one["effects"])
        yield f"{one['name']}: {one['verdict']}{f' ({names})' if names else ''}; {error_line({**found, **one})}"
    yield f"verdict{' in common' if found.get('models') else ''}: {found['verdict']}"
    for effect in found["effects"]:
        tied = f", tied with {', '.join(effect['tied_with'])}" if effect["tied_with"] else ""
        place = f" ({effect['place']})" if effect["place"] else ""
        rounds = f", chosen in {effect['selected_in']} of the leave-one-out rounds" if effect["selected_in"] else ""
        yield f"  {effect['name']}{place}: {effect['summary']}{tied}"
        yield f"    {p_is(effect['p_value'])}{rounds}"
        for name, p in effect["parameters"].items():
            low, high = (("?" if p[k] is None else f"{p[k]:.4g}") for k in ("low", "high"))
            yield f"    {name} = {p['value']:.4g} {p['unit']} ({low} … {high})"
        yield from (f"    {line}" for line in own_lines(effect))
    yield error_line(found)
    if said := noise_told(errors_of(found)):
        yield f"{said[0].lower()}{said[1:].rstrip('.')}"
    if described := found.get("description"):
        yield f"  described, without a name: {described['formula']}, {p_is(described['p_value'])}"
        for term in described["terms"]:
            yield f"    {term['term']}: {term['value']:.4g} {term['unit']} ({term['low']:.4g} … {term['high']:.4g})"
        error = described["error_mm"]["held_out"]
        yield f"    with it in the model: {size(error['before'], 'mm')} → {size(error['after'], 'mm')} mm"
    if balance := found.get("balance"):
        shares = ", ".join(f"{what} {share:.0%}" for what, share in balance["shares"].items())
        yield f"without any model, the torque about the grips goes with {shares} (on recordings left out)"
    if telling := [row for row in found.get("whereabouts", ()) if more_is_left(row)]:
        places = ", ".join(f"{row['part']} ({row['ratio']:.2f} times the whole)" for row in telling)
        yield f"more is left than elsewhere: {places}"
    if found["hint"]:
        yield f"hint: {found['hint']}"
    yield f"{found['evaluations']} evaluations, {found['wall_s']:.0f} s"


def own_lines(effect: Mapping[str, Any]) -> Iterator[str]:
    """What is each recording's own of an effect."""
    for one in effect.get("by_recording") or ():
        amounts = ", ".join(f"{name} = {p['value']:.3g} {p['unit']}" for name, p in one["parameters"].items())
        yield f"{one['recording']} ({one['split'].replace('_', ' ')}): {amounts}"


def error_line(found: Mapping[str, Any]) -> str:
    error = errors_of(found)
    unit = error["unit"]

    def fall(split: str) -> str:
        return f"{size(error[split]['before'], unit)} → {size(error[split]['after'], unit)} {unit}"

    held = "" if error["held_out"]["before"] is None else f"; held out: {fall('held_out')}"
    return f"fit recordings: {fall('fit')}{held}; {limit_line(error)}"
