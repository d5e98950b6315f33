"""`clothbench improve` on force-extension curves: the same loop, with errors in newtons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clothbench.cli.improve import StageBar, asked_for, say, sensors_first, splits_of, tell_splits, whole
from clothbench.core.errors import ClothbenchError
from clothbench.engine.settings import writable
from clothbench.modelling.curves import acts_on_curves
from clothbench.plugins.discovery import Catalogue, absent, catalogue
from clothbench.recordings.codec import kind_of
from clothbench.recordings.curve import Curve
from clothbench.recordings.kinds import read_any
from clothbench.recordings.nodes import find_recordings
from clothbench.studies.improve.budget import Stage
from clothbench.studies.improve.curves import CurveProblem, curve_problem, in_newtons
from clothbench.studies.improve.files import json_text, write_folder
from clothbench.studies.improve.rounds import Outcome, improve
from clothbench.studies.improve.verdict import judged


def command(settings: Mapping[str, str], as_json: bool = False) -> int:
    """Run the loop on curves; write verdict, page and tables, print the verdict in words or as the document."""
    plugins = catalogue()
    out = writable(settings.get("out", "improve"))
    problem = problem_of(settings, plugins)
    candidates = candidates_of(settings.get("candidates"), plugins)
    tell_splits(problem)
    with StageBar() as bar:
        outcome, found = improved(problem, candidates, bar.stage)
        bar.stage("page and tables", 0, 1)
        write_folder(out, outcome, found)
    print(json_text(found)) if as_json else say(found, out)
    return 0


def improved(
    problem: CurveProblem, candidates: Sequence[str], told: Stage = lambda *_: None
) -> tuple[Outcome, dict[str, Any]]:
    """What the loop found, and the document of its verdict."""
    outcome = improve(problem, candidates, told)
    return outcome, in_newtons(judged(outcome))


def problem_of(settings: Mapping[str, str], plugins: Catalogue) -> CurveProblem:
    """Everything read and checked before anything is fitted."""
    model, seed = settings["model"], whole("seed", settings.get("seed", "0"))
    if reason := absent(plugins.load("models", model)):
        raise ClothbenchError(f"model {model!r}: {reason}")
    for key in ("resolution", "base", "areal_density"):
        if key in settings:
            raise ClothbenchError(f"found {key}=…, which force-extension curves have no use for; leave it out")
    curves = []
    for path in find_recordings([settings["recordings"]]):
        recording = read_any(path)
        if not isinstance(recording, Curve):
            raise ClothbenchError(f"{path}: found kind {kind_of(path)!r} among curves, expected one kind in a folder")
        curves.append(recording)
    return curve_problem(model, curves, splits_of(curves, settings["recordings"], seed), plugins, seed)


def candidates_of(given: str | None, plugins: Catalogue) -> list[str]:
    """All installed effects that act on curves, or those that were named, where the loop tries them: sensors first."""
    effects = asked_for(given, plugins)
    on_curves = {name: effect for name, effect in effects.items() if acts_on_curves(effect)}
    if given and (stray := next((name for name in effects if name not in on_curves), None)):
        known = [name for name, effect in plugins.made("effects")[0].items() if acts_on_curves(effect)]
        raise ClothbenchError(
            f"effect {stray!r} does not act on force-extension curves; those that do: {', '.join(known)}"
        )
    return sensors_first(on_curves)
