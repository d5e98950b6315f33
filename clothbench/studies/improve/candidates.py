"""Which effects the loop tries, and in which order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import family_of
from clothbench.core.protocols import Effect
from clothbench.modelling.curves import acts_on_curves, acts_on_sheets, needs_a_picture
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.silhouette import LAYOUT as DRAPES

OF_THE_ROOM = ("air", "wind", "gravity")  # families of effects
ORDER = {"sensor": 0, "boundary": 1, "dynamics": 2}  # how the cloth was seen and held may look like physics


def candidates_of(
    given: Any, kind: str, base: Sequence[str], plugins: Catalogue, pictures: bool = False
) -> tuple[str, ...]:
    """All installed effects that act on recordings of this kind and that the model does not have, or those that were
    named; sensors first. pictures: whether points were seen in a camera's picture, not in space.
    """
    effects = asked_for(given, plugins)
    acts = ACTS.get(kind, acts_on_sheets)
    blind = {name for name, effect in effects.items() if needs_a_picture(effect) and not pictures}
    acting = {name: effect for name, effect in effects.items() if acts(effect) and name not in blind}
    if given is not None and (stray := next((name for name in effects if name not in acting), None)):
        raise ClothbenchError(why_stray(stray, kind, plugins, stray in blind))
    if given is not None and (owned := next((name for name in effects if name in base), None)):
        raise ClothbenchError(f"effect {owned!r} is in the base already; take it out of candidates, or state base=")
    rest = {name: effect for name, effect in acting.items() if name not in base}
    return tuple(sorted(rest, key=lambda name: ORDER.get(place_of(rest[name]), len(ORDER))))


def place_of(effect: Effect) -> str:
    """The place at which an effect is tried and told: its own, but "boundary" of one about the grips that acts through
    forces, since it says how the cloth was held.
    """
    return "boundary" if effect.place == "dynamics" and family_of(effect) == "grip" else effect.place


def acts_on_drapes(effect: Effect) -> bool:
    """Whether it is a force of the cloth itself: a drape has no grips, no clock or marker saw it, it is at rest, and
    what has a direction in the room would have to keep it while the sheet is turned over.
    """
    return acts_on_sheets(effect) and place_of(effect) == "dynamics" and family_of(effect) not in OF_THE_ROOM


ACTS = {"curve": acts_on_curves, DRAPES.kind: acts_on_drapes}


def why_stray(name: str, kind: str, plugins: Catalogue, blind: bool = False) -> str:
    if blind:
        return f"effect {name!r} acts on pictures only, and these recordings have none; take it out of candidates"
    if kind == DRAPES.kind:
        return f"effect {name!r} acts on grips, sensors, curves or in the room, and a drape tells none; take it out"
    if kind != "curve":
        return f"effect {name!r} acts on force-extension curves only; take it out of candidates"
    known = [other for other, effect in plugins.made("effects")[0].items() if acts_on_curves(effect)]
    return f"effect {name!r} does not act on force-extension curves; those that do: {', '.join(known)}"


def asked_for(given: Any, plugins: Catalogue) -> Mapping[str, Effect]:
    """The effects that were named; or else all that can be used (`unusable` says which cannot)."""
    if given is None:
        return plugins.made("effects")[0]
    if not names(given):
        raise ClothbenchError(f"candidates is {given!r}, expected names of effects; left out, all are tried")
    return {name: plugins.make("effects", name) for name in names(given)}


def unusable(plugins: Catalogue) -> list[str]:
    """Why some of the installed effects are no candidates."""
    return list(plugins.made("effects")[1].values())


def names(given: str | Sequence[str]) -> list[str]:
    """ "a,b" or "[a, b]" or a list."""
    words = given.strip("[]").split(",") if isinstance(given, str) else given
    return [word for word in (str(w).replace(" ", "") for w in words) if word]
