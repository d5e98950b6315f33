"""What several models lack in common, from the verdicts of each: that is physics or the sensor. What one lacks and
no other does is a fault of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.engine.cells import digest
from clothbench.studies.improve.verdict import left_beyond

Document = dict[str, Any]
LEAST = 2  # models that have something to say, from which on something is in common
# What stands of each model in the common document.
ENTRY = ("key", "verdict", "hint", "effects", "error_mm", "error", "unexplained_mm", "unexplained")


def common_document(documents: Sequence[Document]) -> Document:
    """The verdict on all of them (`verdict.json`): that of the model that comes nearest to the recordings held out,
    with what was found in common in place of its own, and `models`, what was found with each. documents: one for each
    model, on the same recordings.

    A model that ends without a name for what is left neither bears a name out nor speaks against it; at least two have
    to have something to say. Where nothing is in common, errors are those of the best calibrated fit.
    """
    heard = speaking(documents)
    complete = [found for found in heard if found["verdict"] == "complete"] if len(heard) >= LEAST else []
    best = min(complete or heard or documents, key=error_after)
    shared = shared_effects(documents, best)
    if shared:
        word = "tied" if any(entry["tied_with"] for entry in shared) else "attributed"
    else:
        word = "complete" if complete else "unexplained"
        best = min(map(without_names, complete or documents), key=error_after)
    total = {name: sum(found[name] for found in documents) for name in ("evaluations", "wall_s")}
    return best | total | {
        "verdict": word, "effects": shared, "hint": hint(documents, word),
        "key": digest([found["key"] for found in documents]),
        "models": [model_entry(found, documents) for found in documents],
    }  # fmt: skip


def without_names(found: Document) -> Document:
    """The document with the errors of the calibrated fit in place of the named one's."""
    if not found["effects"]:
        return found
    out = found | {name: calibrated(found[name]) for name in ("error_mm", "error") if name in found}
    for name, error in (("unexplained_mm", out["error_mm"]), ("unexplained", out.get("error"))):
        if found.get(name) is not None and error is not None:
            out[name] = left_beyond(error["fit"]["before"], error["noise_floor"])
    return out


def calibrated(error: Mapping[str, Any]) -> dict[str, Any]:
    """Errors of a document with those after as they were before."""
    fit, held = error["fit"], error["held_out"]
    each = [one | {"after": one["before"]} for one in held["per_recording"]]
    ci95 = [None if end is None else 0.0 for end in held["ci95"]]
    held = held | {"after": held["before"], "ci95": ci95, "per_recording": each, "placebo": None}
    return {**error, "fit": fit | {"after": fit["before"]}, "held_out": held}


def model_entry(found: Document, documents: Sequence[Document]) -> dict[str, Any]:
    """What stands of one model in the common document; own: names of what no other lacks."""
    own = [entry["name"] for entry in own_faults(found, documents)]
    kept = {name: found[name] for name in ENTRY if name in found}
    return {"name": found["model"], **kept, "own": own}


def speaking(documents: Sequence[Document]) -> list[Document]:
    """Those of the models that lack nothing, or have a name for what they lack."""
    return [found for found in documents if found["verdict"] != "unexplained"]


def error_after(found: Mapping[str, Any]) -> float:
    """On the recordings held out, or fitted where there are none; infinite where a run was stopped."""
    error = found.get("error") or found["error_mm"]
    split = "fit" if not error["held_out"]["per_recording"] else "held_out"
    after = error[split]["after"]
    return float("inf") if after is None else float(after)


def shared_effects(documents: Sequence[Document], best: Document) -> list[dict[str, Any]]:
    """What every model that says anything lacks, each name once, as the best of them has it; tied are those that all of
    them tie.
    """
    heard, out, listed = speaking(documents), [], set[str]()
    if len(heard) < LEAST:
        return []
    for entry in best["effects"]:
        matches = [match(entry, found) for found in heard if found is not best]
        if any(one is None for one in matches):
            continue
        names = set.intersection(names_of(entry), *(names_of(one) for one in matches if one is not None))
        names -= listed
        if not names:  # each shares one with the best model, and no two others the same
            continue
        named = next((e for e in (entry, *matches) if e is not None and e["name"] in names), None)
        named = named or named_first_by_none(best, next(name for name in entry["tied_with"] if name in names))
        out.append(named | {"tied_with": sorted(names - {named["name"]})})
        listed |= names
    return out


def named_first_by_none(found: Document, name: str) -> dict[str, Any]:
    """An entry for what models only tie with what they name, so that none of them states its amounts."""
    p_value = next(c["p_value"] for c in found["candidates"] if c["name"] == name)
    return {
        "name": name, "place": "", "summary": "each model has it tied with another name", "family": "",
        "parameters": {}, "by_recording": None, "tied_with": [], "p_value": p_value, "selected_in": "",
    }  # fmt: skip


def match(entry: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any] | None:
    """What another model lacks that may be the same."""
    return next((other for other in found["effects"] if names_of(other) & names_of(entry)), None)


def names_of(entry: Mapping[str, Any]) -> set[str]:
    return {entry["name"], *entry["tied_with"]}


def own_faults(found: Mapping[str, Any], documents: Sequence[Document]) -> list[dict[str, Any]]:
    """What this model lacks while no other that says something does."""
    others = [other for other in speaking(documents) if other["model"] != found["model"]]
    return [entry for entry in found["effects"] if others and not any(lacks(o, names_of(entry)) for o in others)]


def shared_by_some(documents: Sequence[Document]) -> list[tuple[str, list[str], list[str]]]:
    """(name, models that lack it, models that do not) of what several models that say something lack, and not all."""
    heard = speaking(documents)
    out: dict[tuple[str, ...], tuple[str, list[str], list[str]]] = {}
    for entry in (entry for found in heard for entry in found["effects"]):
        having = [found["model"] for found in heard if lacks(found, names_of(entry))]
        if 1 < len(having) < len(heard):
            others = [found["model"] for found in heard if found["model"] not in having]
            out.setdefault((entry["name"], *having), (entry["name"], having, others))
    return list(out.values())


def hint(documents: Sequence[Document], word: str) -> str:
    """Which lack is whose, and which model has nothing to say."""
    heard, said = speaking(documents), []
    for found in heard:
        if names := [entry["name"] for entry in own_faults(found, documents)]:
            without = " and ".join(other["model"] for other in heard if other is not found)
            said.append(
                f"{found['model']} lacks {' and '.join(names)}, which {without} does not lack: a fault of its own"
            )
    for name, having, others in shared_by_some(documents):
        said.append(f"{' and '.join(having)} lack {name}, which {' and '.join(others)} does not lack")
    if complete := [found["model"] for found in heard if found["verdict"] == "complete"]:
        said.insert(0, f"{' and '.join(complete)} lacks nothing" if word == "complete" else "")
    for found in documents:
        if found["verdict"] == "unexplained":
            what = "no more than noise and mesh account for" if leaves_nothing(found) else "what it has no name for"
            said.append(f"{found['model']} leaves {what}, and neither bears a name out nor speaks against it")
    if len(heard) < LEAST:
        said.append(f"fewer than {LEAST} models have something to say, so that nothing is known to be in common")
    return "; ".join(filter(None, said))


def leaves_nothing(found: Mapping[str, Any]) -> bool:
    """Whether noise and mesh account for all that a model leaves, on recordings fitted and held out."""
    suffix = "" if "error" in found else "_mm"
    floor, left = found[f"error{suffix}"]["noise_floor"], found.get(f"unexplained{suffix}")
    return left is not None and left_beyond(math.hypot(left, floor), floor) == 0.0


def lacks(found: Mapping[str, Any], names: set[str]) -> bool:
    return any(names_of(entry) & names for entry in found["effects"])
