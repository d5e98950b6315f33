"""What several models lack in common, from the verdicts of each: that is physics or the sensor. What one lacks and
another does not is a fault of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.engine.cells import digest

Document = dict[str, Any]
LEAST = 2  # models that have something to say, from which on something is in common
ENTRY = ("key", "verdict", "hint", "effects", "error_mm", "error")  # what stands of each model in the common document


def common_document(documents: Sequence[Document]) -> Document:
    """The verdict on all of them (`verdict.json`): that of the model that comes nearest to the recordings held out,
    with what was found in common in place of its own, and `models`, what was found with each. documents: one for each
    model, on the same recordings.

    A model that ends without a name for what is left neither bears a name out nor speaks against it; at least two have
    to have something to say.
    """
    best = min(speaking(documents) or documents, key=error_after)
    shared = shared_effects(documents, best)
    if shared:
        word = "tied" if any(entry["tied_with"] for entry in shared) else "attributed"
    else:
        word = "complete" if any(found["verdict"] == "complete" for found in documents) else "unexplained"
    total = {name: sum(found[name] for found in documents) for name in ("evaluations", "wall_s")}
    return best | total | {
        "verdict": word, "effects": shared, "hint": hint(documents, shared, word),
        "key": digest([found["key"] for found in documents]),
        "models": [model_entry(found, documents, shared) for found in documents],
    }  # fmt: skip


def model_entry(found: Document, documents: Sequence[Document], shared: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What stands of one model in the common document; own: names of what another lacks not."""
    own = [entry["name"] for entry in own_faults(found, documents, shared)]
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
    """What every model that says anything lacks, as the best of them has it; tied are those that all of them tie."""
    heard, out = speaking(documents), []
    if len(heard) < LEAST:
        return []
    for entry in best["effects"]:
        matches = [match(entry, found) for found in heard if found is not best]
        if any(one is None for one in matches):
            continue
        names = set.intersection(names_of(entry), *(names_of(one) for one in matches if one is not None))
        if not names:  # each shares one with the best model, and no two others the same
            continue
        named = next((e for e in (entry, *matches) if e is not None and e["name"] in names), entry)
        out.append(named | {"tied_with": sorted(names - {named["name"]})})
    return out


def match(entry: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any] | None:
    """What another model lacks that may be the same."""
    return next((other for other in found["effects"] if names_of(other) & names_of(entry)), None)


def names_of(entry: Mapping[str, Any]) -> set[str]:
    return {entry["name"], *entry["tied_with"]}


def own_faults(
    found: Mapping[str, Any], documents: Sequence[Document], shared: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """What this model lacks while another that says something does not."""
    others = [other for other in speaking(documents) if other["model"] != found["model"]]
    return [
        entry for entry in found["effects"] if others and not any(names_of(entry) & names_of(one) for one in shared)
    ]


def hint(documents: Sequence[Document], shared: Sequence[Mapping[str, Any]], word: str) -> str:
    """Which lack is whose, and which model has nothing to say."""
    heard, said = speaking(documents), []
    for found in heard:
        if names := [entry["name"] for entry in own_faults(found, documents, shared)]:
            others = [other["model"] for other in heard if other is not found]
            without = " and ".join(o for o in others if not any(lacks(d, names) for d in heard if d["model"] == o))
            beside = f", which {without} does not lack" if without else ""
            said.append(f"{found['model']} lacks {' and '.join(names)}{beside}: a fault of its own")
    if complete := [found["model"] for found in heard if found["verdict"] == "complete"]:
        said.insert(0, f"{' and '.join(complete)} lacks nothing" if word == "complete" else "")
    for found in documents:
        if found["verdict"] == "unexplained":
            said.append(f"{found['model']} leaves what it has no name for, and neither bears a name out nor speaks "
                        "against it")  # fmt: skip
    if len(heard) < LEAST:
        said.append(f"fewer than {LEAST} models have something to say, so that nothing is known to be in common")
    return "; ".join(filter(None, said))


def lacks(found: Mapping[str, Any], names: Sequence[str]) -> bool:
    return any(names_of(entry) & set(names) for entry in found["effects"])
