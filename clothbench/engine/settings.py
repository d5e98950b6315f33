"""The settings of a run, checked before anything is read or written: a wrong one is one line, never a guess.

Here is what every study shares; what only one of them knows is checked by its own plan.
"""

from __future__ import annotations

import contextlib
import copy
import math
import os
import sys
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError, known_names
from clothbench.core.optional import takes_option
from clothbench.core.scene import AIR_DENSITY, HEAVIEST, Obstacle, obstacles_of
from clothbench.engine.bucket import is_address
from clothbench.plugins.discovery import Catalogue

LARGEST = 2**63 - 1  # whole number that a row can hold
PLUGINS = ("model", "optimizer", "metric", "effects", "report", "recording", "recordings")  # names, or lists of them
KNOWN = {
    *PLUGINS, "study", "tracker", "scene", "options", "bounds", "budget", "seed", "jobs", "timeout", "out", "data_dir",
    "suite", "rerun", "analysis", "choice", "prior", "finer", "executor", "limits",
}  # fmt: skip
OF_SUITE = "bounds_of_suite"  # names of bounds that the command line did not give, which `last_word` notes
STARTS = ("rest", "measured")
FINER_SHARE = 0.25  # of the evaluations, which a search that ends on a finer mesh gets there
SCENE_WORDS = {
    "areal_density", "air_density", "resolution", "spacing", "start", "thickness", "outline", "obstacles", "starts",
    "perturbation",
}  # fmt: skip
OF_A_RUN = ("seed", "budget")  # which an optimizer is told by the run
SUITE_WORDS = {"name", "version", "title", "budgets"}  # of every study; each may know more


def checked(config: Mapping[str, Any], plugins: Catalogue, suite_words: frozenset[str]) -> dict[str, Any]:
    """The settings with their types made sure; refuses what means nothing here. suite_words: of the study."""
    out = {**dict.fromkeys(KNOWN), **config}  # one that ~KEY takes out is empty
    of_suite = out.pop(OF_SUITE, ())
    known_words("setting", out, KNOWN)
    out["suite"] = mapping("suite", suite_chosen(out.get("suite")))
    known_words("setting of 'suite'", out["suite"], SUITE_WORDS | suite_words)
    out["suite"]["budgets"] = mapping("suite.budgets", out["suite"].get("budgets"))
    out = named_budget(out)
    for name, least in (("budget", 1), ("seed", 0), ("jobs", 0)):
        out[name] = whole(name, out.get(name), least)
    out["timeout"] = None if out.get("timeout") is None else number("timeout", out["timeout"], above=0.0)
    if not isinstance(out.get("rerun"), bool):
        raise ClothbenchError(f"setting 'rerun' is {out.get('rerun')!r}, expected true or false")
    out["out"] = str(writable(out.get("out")))
    out["scene"] = scene_settings(mapping("scene", out.get("scene")))
    bounds = flat(mapping("bounds", out.get("bounds")))
    out["bounds"] = {name: pair(f"bounds.{name}", b) for name, b in bounds.items()}
    out[OF_SUITE] = frozenset(of_suite)
    out["options"] = option_settings(mapping("options", out.get("options")), plugins)
    out["prior"] = None if out.get("prior") is None else one_word("prior", out["prior"])
    if out["data_dir"] is not None and not (isinstance(out["data_dir"], str) and out["data_dir"]):
        raise ClothbenchError(f"setting 'data_dir' is {out['data_dir']!r}, expected a folder")
    out["analysis"] = mapping("analysis", out.get("analysis"))
    out["finer"] = finer_settings(mapping("finer", out.get("finer")), out["scene"])
    for key in PLUGINS:
        out[key] = words(key, out.get(key))
    if out["recording"] and out["recordings"]:
        raise ClothbenchError(
            "found settings 'recording' and 'recordings', expected one of them; name files and folders together with "
            "recordings=[…]"
        )
    if twice := sorted({e for e in out["effects"] if out["effects"].count(e) > 1}):
        raise ClothbenchError(f"setting 'effects': {twice[0]!r} is given twice; name every effect once")
    return out


def suite_chosen(suite: Any) -> Any:
    if isinstance(suite, str):
        raise ClothbenchError(f"setting 'suite' is {suite!r}; choose a suite with +suite=NAME")
    return suite


def require_plugins(config: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Refuse settings that name none where a study needs one."""
    for key in keys:
        if not config[key]:
            raise ClothbenchError(f"setting '{key}' is empty; name a plugin (see `clothbench plugins`)")


OF_SEARCHES = {"seed": 0, "budget": 400, "tracker": "markers", "choice": "nearest"}  # as in run.yaml


def refuse_of_searches(config: Mapping[str, Any], why: str) -> None:
    """Refuse what steers a search or what is seen, in studies without either, where it is not what it is by default."""
    for key, usual in OF_SEARCHES.items():
        if config.get(key, usual) not in (usual, None):
            raise ClothbenchError(f"setting '{key}': {why}; leave it out")


def refuse(config: Mapping[str, Any], keys: Sequence[str], why: str, scene: str) -> None:
    """Refuse settings that a study cannot follow, and any of the scene but the usual density of air; `why` and `scene`
    say so to the user.
    """
    for key in keys:
        if config[key]:
            raise ClothbenchError(f"setting '{key}': {why}; leave it out")
    for key, value in config["scene"].items():
        if not (key == "air_density" and value == AIR_DENSITY):
            raise ClothbenchError(f"setting 'scene.{key}': {scene}; leave it out")


def named_budget(config: dict[str, Any]) -> dict[str, Any]:
    """The settings with what a named budget (`budget=paper`) of the suite brings: evaluations, options, analyses, a
    finer mesh to end on, further recordings.
    """
    name, known = config.get("budget"), config["suite"]["budgets"]
    if not isinstance(name, str):
        return config
    if name not in known:
        there = f", or one of the suite's: {', '.join(sorted(known))}" if known else ""
        raise ClothbenchError(f"setting 'budget' is {name!r}, expected a whole number, at least 1{there}")
    brought = mapping(f"suite.budgets.{name}", known[name])
    known_words(f"setting of 'suite.budgets.{name}'", brought, {"budget", "options", "analysis", "finer", "recordings"})
    out = {**config, "budget": brought.get("budget")}
    if "recordings" in brought and not config.get("recording"):
        out["recordings"] = brought["recordings"]
    for key in ("options", "analysis", "finer"):
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
    suite's named budgets bring: a budget must not overrule the command line. Notes which bounds they leave as
    the suite has them.
    """
    out = copy.deepcopy({key: value for key, value in config.items() if key != OF_SUITE})
    suite = out.get("suite")
    budgets = suite.get("budgets") if isinstance(suite, dict) else None
    for word in overrides:
        path = word.lstrip("+~").partition("=")[0].split(".")
        for brought in (budgets or {}).values():
            *above, last = path
            for key in above:
                brought = brought.get(key) if isinstance(brought, dict) else None
            if path != ["budget"] and isinstance(brought, dict):
                brought.pop(last, None)
    if own := _not_asked_for(out.get("bounds"), overrides):
        out[OF_SUITE] = own
    return out


def _not_asked_for(bounds: Any, overrides: Sequence[str]) -> list[str]:
    """The names of bounds that no word of the command line speaks of."""
    asked = [f"{word.lstrip('+~').partition('=')[0]}." for word in overrides]
    names = flat(bounds) if isinstance(bounds, Mapping) else ()
    return [name for name in names if not any(f"bounds.{name}.".startswith(word) for word in asked)]


def refuse_strays(settings: Mapping[str, Any], known: Iterable[str], plugins: Catalogue) -> None:
    """Refuse bounds of parameters that are not among the known ones. A suite's own may be of other models than those
    that are run here, but not of what no plugin has.
    """
    own, there = settings.get(OF_SUITE, ()), sorted(known)
    strays = [name for name in settings["bounds"] if name not in there]
    if elsewhere := {name for name in strays if name in own}:
        elsewhere &= parameters_of_all(plugins)
    if strays := [name for name in strays if name not in elsewhere]:
        name = "" if strays[0] in parameters_of_all(plugins) else strays[0]  # another model's is spelled as it is meant
        raise ClothbenchError(f"setting 'bounds': no parameter {strays[0]!r}; {known_names(name, there)}")


def parameters_of_all(plugins: Catalogue) -> set[str]:
    """Names of the parameters of every installed model, also of one that tells warp from weft, and of every effect."""
    made = list(plugins.made("models")[0].values())
    for name in plugins.names("models"):
        with contextlib.suppress(ClothbenchError):
            if takes_option(plugins.load("models", name), "orthotropic"):
                made.append(plugins.make("models", name, orthotropic=True))
    names = {n for model in made for n in model.parameters.names}
    return names | {f"{n}.{p}" for n, effect in plugins.made("effects")[0].items() for p in effect.parameters.names}


def known_words(what: str, given: Mapping[str, Any], known: set[str]) -> None:
    if unknown := sorted(set(map(str, given)) - known):
        raise ClothbenchError(f"{what} {unknown[0]!r} is not known; {known_names(unknown[0], sorted(known))}")


def whole(name: str, value: Any, least: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= LARGEST:
        limit = " and below 2⁶³" if isinstance(value, int) and value > LARGEST else ""
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected a whole number, at least {least}{limit}")
    return value


def is_number(value: Any) -> bool:
    """Whether it is a finite number; a whole one may have more digits than any float, and is none then."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def number(name: str, value: Any, above: float = -math.inf, least: float = -math.inf) -> float:
    """A finite number."""
    if not is_number(value) or not value > above or not value >= least:
        limit = f", at least {least:g}" if least > -math.inf else f" above {above:g}" if above > -math.inf else ""
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


def flat(nested: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """ "effect.parameter" → value, where a parser of settings has taken the dot for a level."""
    out: dict[str, Any] = {}
    for name, value in nested.items():
        out |= flat(value, f"{above}{name}.") if isinstance(value, Mapping) else {f"{above}{name}": value}
    return out


def one_word(name: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected one name")
    return value


def words(name: str, value: Any) -> list[str]:
    values = [value] if isinstance(value, str) else [] if value is None else value
    if not isinstance(values, list | tuple) or not all(isinstance(v, str) and v for v in values):
        raise ClothbenchError(f"setting '{name}' is {value!r}, expected a name or a list of names")
    return list(values)


def some_words(name: str, value: Any, usual: list[str]) -> list[str]:
    """Names that a setting lists, each once; the usual ones where it is not given. None at all would run nothing."""
    if value is None:
        return usual
    if not (told := words(name, value)):
        raise ClothbenchError(f"setting '{name}' is empty; give some, for example [{','.join(usual)}], or leave it out")
    return list(dict.fromkeys(told))


def writable(value: Any) -> Path:
    """The results folder: it exists or can be made, and can be written to."""
    if not isinstance(value, str) or not value:
        raise ClothbenchError(f"setting 'out' is {value!r}, expected a folder")
    if is_address(value):
        raise ClothbenchError(
            f"setting 'out' is {value!r}, expected a folder (`run` and `improve` alone take a bucket)"
        )
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in value):
        raise ClothbenchError(f"setting 'out' is {value!r}, expected a folder whose name a terminal can show")
    folder = Path(value)
    above = next(p for p in (folder.absolute(), *folder.absolute().parents) if os.path.exists(p))
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        raise ClothbenchError(f"setting 'out': {folder} cannot be written to; give a folder of yours")
    return folder


def scene_settings(scene: dict[str, Any]) -> dict[str, Any]:
    known_words("setting of 'scene'", scene, SCENE_WORDS)
    out: dict[str, Any] = {}
    if scene.get("spacing") is not None and scene.get("resolution") is not None:
        raise ClothbenchError("settings 'scene.spacing' and 'scene.resolution' both say how fine the mesh is; give one")
    for name in ("areal_density", "air_density", "spacing", "perturbation"):
        if scene.get(name) is not None:
            out[name] = number(f"scene.{name}", scene[name], above=0.0)
    if out.get("areal_density", 0.0) > HEAVIEST:
        raise ClothbenchError(
            f"setting 'scene.areal_density' is {out['areal_density']:g}, expected kg/m², {HEAVIEST:g} at most; "
            f"if g/m² were meant, give {out['areal_density'] / 1e3:g}"
        )
    if (start := scene.get("start") or "rest") not in STARTS:
        raise ClothbenchError(f"setting 'scene.start' is {start!r}, expected one of {', '.join(STARTS)}")
    if start != "rest":  # what is as it always was leaves keys as they were
        out["start"] = start
    if (resolution := scene.get("resolution")) is not None:
        if not isinstance(resolution, list | tuple) or len(resolution) != 2:
            raise ClothbenchError(f"setting 'scene.resolution' is {resolution!r}, expected [nodes along u, along v]")
        out["resolution"] = tuple(whole("scene.resolution", n, 3) for n in resolution)
    if scene.get("thickness") is not None:
        out["thickness"] = number("scene.thickness", scene["thickness"], least=0.0)
    if scene.get("starts") is not None:
        out["starts"] = whole("scene.starts", scene["starts"], 1)
    if scene.get("outline") is not None:
        out["outline"] = _outline(scene["outline"])
    if scene.get("obstacles") is not None:
        out["obstacles"] = _obstacles(scene["obstacles"])
    return out


def finer_settings(finer: dict[str, Any], scene: Mapping[str, Any]) -> dict[str, float]:
    """The finer mesh that a search ends on, and the share of the evaluations that it gets there."""
    if not finer:
        return {}
    known_words("setting of 'finer'", finer, {"spacing", "share"})
    out = {"spacing": number("finer.spacing", finer.get("spacing"), above=0.0)}
    out["share"] = number("finer.share", finer.get("share", FINER_SHARE), above=0.0)
    if out["share"] >= 1:
        raise ClothbenchError(f"setting 'finer.share' is {out['share']:g}, expected a number below 1")
    if (coarse := scene.get("spacing")) is None:
        raise ClothbenchError("setting 'finer': found no 'scene.spacing' for it to be finer than; give one")
    if out["spacing"] >= coarse:
        found = f"setting 'finer.spacing' is {out['spacing']:g} m"
        raise ClothbenchError(f"{found}, expected less than scene.spacing, {coarse:g} m")
    return out


def _outline(corners: Any) -> list[list[float]]:
    """Corners [[u, v], …] m of the polygon that a sheet has been cut to."""
    if not isinstance(corners, list | tuple) or len(corners) < 3:
        raise ClothbenchError(f"setting 'scene.outline' is {corners!r}, expected three corners [u,v] or more")
    if any(not isinstance(corner, list | tuple) or len(corner) != 2 for corner in corners):
        raise ClothbenchError("setting 'scene.outline': found a corner that is not [u,v], expected metres")
    return [[number("scene.outline", c) for c in corner] for corner in corners]


def _obstacles(given: Any) -> list[dict[str, Any]]:
    """Obstacles as settings state them, each with what `Obstacle` takes; made once, so that faults show here."""
    if not isinstance(given, list | tuple):
        raise ClothbenchError(f"setting 'scene.obstacles' is {given!r}, expected a list like [{{shape:plane}}]")
    out = []
    for k, one in enumerate(given):
        stated = mapping(f"scene.obstacles.{k}", one)
        known_words(f"setting of 'scene.obstacles.{k}'", stated, {f.name for f in fields(Obstacle)})
        if "shape" not in stated:
            raise ClothbenchError(f"setting 'scene.obstacles.{k}' states no shape, expected plane, disc or sphere")
        try:
            obstacles_of([stated])
        except TypeError:
            raise ClothbenchError(f"setting 'scene.obstacles.{k}' is {stated!r}, expected numbers in SI") from None
        out.append(stated)
    return out


def option_settings(options: dict[str, Any], plugins: Catalogue) -> dict[str, dict[str, Any]]:
    """Options by plugin; a name that no installed plugin has is refused, broken ones included, and so is that of an
    effect: it has parameters, and no options.
    """
    known_words("plugin in 'options'", options, {p.name for p in plugins.plugins})
    for name, value in options.items():
        if value and {p.kind for p in plugins.plugins if p.name == name} == {"effects"}:
            raise ClothbenchError(
                f"setting 'options.{name}': found an effect, which takes no options; bounds.{name}.PARAMETER says "
                f"where one of its parameters is sought, suite.fixed.{name}.PARAMETER=VALUE holds it"
            )
        seeks = any((p.kind, p.name) == ("optimizers", name) for p in plugins.plugins)
        if seeks and (word := next((word for word in OF_A_RUN if word in (value or ())), None)):
            raise ClothbenchError(f"setting 'options.{name}.{word}': found what a run sets; give {word}=… instead")
    return {name: mapping(f"options.{name}", value) for name, value in options.items()}
