"""What a calibration knows under `suite` and `analysis`, checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.settings import flat, known_words, mapping, number, some_words, whole, words
from clothbench.studies.calibration.schema import LEAST_BLOCKS

SUITE_WORDS = frozenset(
    {"textile", "recordings", "select", "case", "each", "together", "fixed", "effects", "published"}
)
TEXTILES = ("soft", "medium", "stiff")
CASES = ("fabric", "experiment", "motion", "recording", "all")
# What can be asked of a finished fit, with the options of each and their defaults.
ANALYSES: dict[str, dict[str, Any]] = {
    "variability": {"points": 8},  # perturbations of each parameter, up to ±20 %
    "repeats": {"count": 5},  # further fits from starts within ±5 %
    "morris": {"trajectories": 8},
    "sobol": {"samples": 16},  # a power of two
    "map": {"parameters": ["bend", "stretch"], "points": 9},  # the error over two parameters
    "confusion": {},  # these parameters beside the other fabrics' recordings of the same trials
}
LEAST = {("sobol", "samples"): LEAST_BLOCKS}  # of numbers of which more than two are needed


def suite_settings(suite: Mapping[str, Any], effects: Collection[str] = ()) -> dict[str, Any]:
    """What is said under `suite`, checked; effects: names of those that are installed."""
    out = dict(suite)
    for key in ("fixed", "effects"):
        out[key] = mapping(f"suite.{key}", out.get(key))
    out["effects"] = {model: words(f"suite.effects.{model}", names) for model, names in out["effects"].items()}
    out["fixed"] = _fixed(out["fixed"], effects)
    out["published"] = {
        metric: {
            str(n): _figure(f"suite.published.{metric}.{n}", v) for n, v in mapping("suite.published", values).items()
        }
        for metric, values in mapping("suite.published", out.get("published")).items()
    }
    out["textile"] = {p: _textile(p, t) for p, t in mapping("suite.textile", out.get("textile")).items()}
    if out.get("case", "fabric") not in CASES:
        raise ClothbenchError(f"setting 'suite.case' is {out['case']!r}, expected one of {', '.join(CASES)}")
    out["select"] = some_words("suite.select", out.get("select"), ["*"])
    out["each"] = words("suite.each", out.get("each"))
    out["together"] = words("suite.together", out.get("together"))
    if out["each"] and out["together"]:
        raise ClothbenchError(
            "settings 'suite.each' and 'suite.together' both say what is fitted; empty one of them, as in suite.each=[]"
        )
    return out


def _figure(name: str, told: Any) -> float | str:
    """A paper's figure: a number in the unit that the metric has in the run, or a text with its own: "2.5 cm"."""
    value, _, unit = told.strip().partition(" ") if isinstance(told, str) else ("", "", "")
    if not unit.strip():
        return number(name, told)
    try:
        return f"{number(name, float(value)):g} {unit.strip()}"
    except ValueError:
        raise ClothbenchError(
            f"setting '{name}' is {told!r}, expected a number, or one with its unit: \"2.5 cm\""
        ) from None


def _fixed(stated: Mapping[str, Any], effects: Collection[str]) -> dict[str, dict[str, float]]:
    """What is held, by pattern of cases; a parameter with a number, as in suite.fixed.k1=100, is held in all cases.

    So is what lies below the name of an effect, which is its parameter (suite.fixed.linear_drag.coefficient=2): a case
    that bears an effect's name is told by a pattern that is not that name, as "[l]inear_drag".
    """
    out: dict[str, dict[str, float]] = {}
    for name, values in stated.items():
        if values is None:
            raise ClothbenchError(
                f"setting 'suite.fixed.{name}' is None, expected a number; ~suite.fixed.{name} takes it out"
            )
        everywhere = name in effects or not isinstance(values, Mapping)
        pattern, told = ("*", {name: values}) if everywhere else (name, values)
        held = {n: number(f"suite.fixed.{n}", value) for n, value in flat(told).items()}
        out[pattern] = out.get(pattern, {}) | held
    return out


def _textile(pattern: str, stated: Any) -> str:
    if stated not in TEXTILES:
        raise ClothbenchError(f"setting 'suite.textile.{pattern}' is {stated!r}, expected one of {', '.join(TEXTILES)}")
    return str(stated)


def analysis_settings(given: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What is asked of a fit beside its errors: each analysis with its options and patterns of the cases it is for."""
    known_words("analysis", given, set(ANALYSES))
    out = {}
    for name, told in given.items():
        wanted = mapping(f"analysis.{name}", told)
        known_words(f"setting of 'analysis.{name}'", wanted, {"cases", *ANALYSES[name]})
        options = {**ANALYSES[name], **wanted}
        options["cases"] = words(f"analysis.{name}.cases", wanted.get("cases", "*"))
        for key, default in ANALYSES[name].items():
            if isinstance(default, int):
                options[key] = whole(f"analysis.{name}.{key}", options[key], LEAST.get((name, key), 2))
            elif isinstance(default, list):
                options[key] = words(f"analysis.{name}.{key}", options[key])
        out[name] = options
    if (points := out.get("variability", {}).get("points", 2)) % 2:
        raise ClothbenchError(
            f"setting 'analysis.variability.points' is {points}, expected an even number, half of them on each side"
        )
    axes = out.get("map", {}).get("parameters", ["x", "y"])
    if len(set(axes)) != 2:
        raise ClothbenchError(f"setting 'analysis.map.parameters' is {axes!r}, expected two different parameters")
    if (samples := out.get("sobol", {}).get("samples", 2)).bit_count() != 1:
        raise ClothbenchError(f"setting 'analysis.sobol.samples' is {samples}, expected a power of two")
    return out
