"""The settings of a run, checked before anything is read or written: a wrong one is one line, never a guess."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.scene import AIR_DENSITY
from clothbench.plugins.discovery import Catalogue
from clothbench.studies.folding.cell import chosen_fabrics, fold_settings
from clothbench.studies.mechanics.cell import MESHES, chosen_tests

PRODUCT = ("model", "optimizer", "metric")
CASES = ("fabric", "experiment", "motion", "recording", "all")
KNOWN = {
    *PRODUCT, "effects", "report", "tracker", "recordings", "recording", "scene", "options", "bounds", "budget",
    "seed", "jobs", "timeout", "out", "data_dir", "suite", "rerun", "analysis",
}  # fmt: skip
SUITE_KEYS = {
    "name", "version", "title", "recordings", "select", "case", "each", "fixed", "effects", "budgets", "tests",
    "meshes", "fold",
}  # fmt: skip
# What can be asked of a finished fit, with the options of each and their defaults.
ANALYSES: dict[str, dict[str, Any]] = {
    "variability": {"points": 8},  # perturbations of each parameter, up to ±20 %
    "repeats": {"count": 5},  # further fits from starts within ±5 %
    "morris": {"trajectories": 8},
    "sobol": {"samples": 16},  # a power of two
    "map": {"parameters": ["bend", "stretch"], "points": 9},  # the error over two parameters
    "confusion": {},  # these parameters beside the other fabrics' recordings of the same trials
}
# What a suite of tests against mechanics has no use for, beside `scene`.
CALIBRATION = ("optimizer", "metric", "effects", "report", "recording", "recordings", "bounds")


def checked(config: Mapping[str, Any], plugins: Catalogue) -> dict[str, Any]:
    """The settings with their types made sure; refuses what means nothing here."""
    out = dict(config)
    known_words("setting", out, KNOWN)
    out["suite"] = suite_settings(out.get("suite"))
    out = named_budget(out)
    for name, least in (("budget", 1), ("seed", 0), ("jobs", 0)):
        out[name] = whole(name, out.get(name), least)
    out["timeout"] = None if out.get("timeout") is None else number("timeout", out["timeout"], above=0.0)
    if not isinstance(out.get("rerun"), bool):
        raise ClothbenchError(f"setting 'rerun' is {out.get('rerun')!r}, expected true or false")
    out["out"] = str(writable(out.get("out")))
    out["scene"] = scene_settings(mapping("scene", out.get("scene")))
    out["bounds"] = {name: pair(f"bounds.{name}", b) for name, b in mapping("bounds", out.get("bounds")).items()}
    out["options"] = option_settings(mapping("options", out.get("options")), plugins)
    out["analysis"] = analysis_settings(mapping("analysis", out.get("analysis")))
    for key in (*PRODUCT, "effects", "report", "recording", "recordings"):
        out[key] = words(key, out.get(key))
    if out["suite"]["tests"]:
        _nothing_to_fit(out)
    if out["suite"]["fold"]:
        _nothing_recorded(out)
    for key in PRODUCT:
        if not out[key] and not out["suite"]["tests"]:
            raise ClothbenchError(f"setting '{key}' is empty; name a plugin (see `clothbench plugins`)")
    if twice := sorted({e for e in out["effects"] if out["effects"].count(e) > 1}):
        raise ClothbenchError(f"setting 'effects': {twice[0]!r} is given twice; name every effect once")
    return out


def named_budget(config: dict[str, Any]) -> dict[str, Any]:
    """The settings with what a named budget (`budget=paper`) of the suite brings: budget, options, analysis."""
    name, known = config.get("budget"), config["suite"]["budgets"]
    if not isinstance(name, str):
        return config
    if name not in known:
        there = f", or one of the suite's: {', '.join(sorted(known))}" if known else ""
        raise ClothbenchError(f"setting 'budget' is {name!r}, expected a whole number, at least 1{there}")
    brought = mapping(f"suite.budgets.{name}", known[name])
    known_words(f"setting of 'suite.budgets.{name}'", brought, {"budget", "options", "analysis"})
    out = {**config, "budget": brought.get("budget")}
    for key in ("options", "analysis"):
        out[key] = deep(mapping(key, config.get(key)), mapping(key, brought.get(key)))
    return out


def deep(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Both nested mappings in one; where both say something, `above` has it."""
    out = dict(below)
    for key, value in above.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = deep(out[key], value) if both else value
    return out


def last_word(config: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """The settings, with what `overrides` (Hydra's words: KEY=VALUE, +KEY=VALUE, ~KEY) speak of taken out of what the
    suite's named budgets bring: a budget must not overrule the command line.
    """
    out = copy.deepcopy(dict(config))
    suite = out.get("suite")
    budgets = suite.get("budgets") if isinstance(suite, dict) else None
    for word in overrides:
        path = word.lstrip("+~").partition("=")[0].split(".")
        for brought in (budgets or {}).values():
            *above, last = path
            for key in above:
                brought = brought.get(key) if isinstance(brought, dict) else None
            if above and isinstance(brought, dict):
                brought.pop(last, None)
    return out


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
                options[key] = whole(f"analysis.{name}.{key}", options[key], 2)
            elif isinstance(default, list):
                options[key] = words(f"analysis.{name}.{key}", options[key])
        out[name] = options
    axes = out.get("map", {}).get("parameters", ["x", "y"])
    if len(set(axes)) != 2:
        raise ClothbenchError(f"setting 'analysis.map.parameters' is {axes!r}, expected two different parameters")
    if (samples := out.get("sobol", {}).get("samples", 2)).bit_count() != 1:
        raise ClothbenchError(f"setting 'analysis.sobol.samples' is {samples}, expected a power of two")
    return out


def _nothing_to_fit(config: Mapping[str, Any]) -> None:
    """Refuse what tests against mechanics cannot follow: they bring their own scenes, effects and parameters."""
    for key in CALIBRATION:
        if config[key]:
            raise ClothbenchError(f"setting '{key}': the tests of this suite are not fitted to anything; leave it out")
    for key, value in config["scene"].items():
        if not (key == "air_density" and value == AIR_DENSITY):
            raise ClothbenchError(
                f"setting 'scene.{key}': the tests of this suite bring their own scenes; leave it out"
            )


def _nothing_recorded(config: Mapping[str, Any]) -> None:
    """Refuse what a fold cannot follow: its recordings are made in its course, and its scene is a strip on a desk."""
    for key in ("recording", "recordings", "report"):
        if config[key]:
            raise ClothbenchError(f"setting '{key}': the recordings of this suite are made as it runs; leave it out")
    for key, value in config["scene"].items():
        if not (key == "air_density" and value == AIR_DENSITY):
            raise ClothbenchError(f"setting 'scene.{key}': this suite has a strip on a desk; leave it out")


def known_words(what: str, given: Mapping[str, Any], known: set[str]) -> None:
    if unknown := sorted(set(map(str, given)) - known):
        raise ClothbenchError(f"{what} {unknown[0]!r} is not known; there are: {', '.join(sorted(known))}")


def whole(name: str, value: Any, least: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected a whole number, at least {least}")
    return value


def number(name: str, value: Any, above: float = -math.inf) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or not value > above:
        limit = "" if above == -math.inf else f" above {above:g}"
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected a number{limit}")
    return float(value)


def pair(name: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected [low,high]")
    low, high = (number(name, v) for v in value)
    if not low < high:
        raise ClothbenchError(f"setting '{name}' is [{low:g},{high:g}], expected low below high")
    return low, high


def mapping(name: str, value: Any) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected {name}.KEY=VALUE")
    return {str(k): v for k, v in value.items()}


def words(name: str, value: Any) -> list[str]:
    values = [value] if isinstance(value, str) else [] if value is None else value
    if not isinstance(values, list | tuple) or not all(isinstance(v, str) and v for v in values):
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected a name or a list of names")
    return list(values)


def writable(value: Any) -> Path:
    """The results folder: it exists or can be made, and can be written to."""
    if not isinstance(value, str) or not value:
        raise ClothbenchError(f"setting 'out' is {value!r}, expected a folder")
    folder = Path(value)
    above = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        raise ClothbenchError(f"setting 'out': {folder} cannot be written to; give a folder of yours")
    return folder


def suite_settings(suite: Any) -> dict[str, Any]:
    if isinstance(suite, str):
        raise ClothbenchError(f"setting 'suite' is {suite!r}; choose a suite with +suite=NAME")
    out = mapping("suite", suite)
    known_words("setting of 'suite'", out, SUITE_KEYS)
    for key in ("fixed", "effects", "budgets"):
        out[key] = mapping(f"suite.{key}", out.get(key))
    out["effects"] = {model: words(f"suite.effects.{model}", names) for model, names in out["effects"].items()}
    out["fixed"] = {
        pattern: {n: number(f"suite.fixed.{n}", v) for n, v in mapping("suite.fixed", values).items()}
        for pattern, values in out["fixed"].items()
    }
    if out.get("case", "fabric") not in CASES:
        raise ClothbenchError(f"setting 'suite.case' is {out['case']!r}, expected one of {', '.join(CASES)}")
    out["tests"] = chosen_tests(words("suite.tests", out.get("tests")))
    out["meshes"] = mesh_sizes(out.get("meshes"))
    out["select"] = words("suite.select", out.get("select")) or ["*"]
    out["fold"] = None if out.get("fold") is None else fold_settings(mapping("suite.fold", out["fold"]))
    if out["fold"]:
        out["select"] = chosen_fabrics(out["select"])
    out["each"] = words("suite.each", out.get("each"))
    return out


def mesh_sizes(value: Any) -> list[int]:
    """Nodes along a strip, from the coarsest mesh to the finest."""
    if value is None:
        return list(MESHES)
    sizes = value if isinstance(value, list | tuple) else [value]
    if not sizes:
        raise ClothbenchError("setting 'suite.meshes' is empty; give numbers of nodes, for example [9,17,33]")
    return sorted({whole("suite.meshes", n, 5) for n in sizes})


def scene_settings(scene: dict[str, Any]) -> dict[str, Any]:
    known_words("setting of 'scene'", scene, {"areal_density", "air_density", "resolution", "spacing"})
    out: dict[str, Any] = {}
    if scene.get("spacing") is not None and scene.get("resolution") is not None:
        raise ClothbenchError("settings 'scene.spacing' and 'scene.resolution' both say how fine the mesh is; give one")
    for name in ("areal_density", "air_density", "spacing"):
        if scene.get(name) is not None:
            out[name] = number(f"scene.{name}", scene[name], above=0.0)
    if (resolution := scene.get("resolution")) is not None:
        if not isinstance(resolution, list | tuple) or len(resolution) != 2:
            raise ClothbenchError(f"setting 'scene.resolution' is {resolution!r}, expected [nodes along u, along v]")
        out["resolution"] = tuple(whole("scene.resolution", n, 3) for n in resolution)
    return out


def option_settings(options: dict[str, Any], plugins: Catalogue) -> dict[str, dict[str, Any]]:
    """Options by plugin; a name that no installed plugin has is refused, broken ones included."""
    known_words("plugin in 'options'", options, {p.name for p in plugins.plugins})
    return {name: mapping(f"options.{name}", value) for name, value in options.items()}
