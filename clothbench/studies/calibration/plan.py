"""From settings to cells: which recordings × models × optimizers × metrics, case by case."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import fnmatch
import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError, known_names
from clothbench.core.optional import takes_option, textile_of
from clothbench.core.progress import FileProgress
from clothbench.engine.cells import Source, matching, plugin_versions, require_own_names, resplit
from clothbench.engine.settings import parameters_of_all, refuse_strays, require_plugins
from clothbench.engine.suite import where
from clothbench.estimation.front import CHOICES
from clothbench.estimation.prior import Prior, density_of, hanging, prior_of
from clothbench.plugins.discovery import Catalogue, PluginBroken
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.nodes import Recording
from clothbench.recordings.points import PointCloud
from clothbench.recordings.scenes import refuse_stated_weight, scenes_of
from clothbench.reference.presets import Preset, preset
from clothbench.studies.calibration.cell import CalibrationCell, Names, rehearse, uses
from clothbench.studies.calibration.moved import lasting
from clothbench.studies.calibration.settings import analysis_settings, suite_settings

PRODUCT = ("model", "optimizer", "metric")


def refuse_settings(settings: Mapping[str, Any]) -> None:
    """Refuse what can be no setting of a calibration, whatever it is of."""
    require_plugins(settings, PRODUCT)
    suite_settings(settings["suite"])
    analysis_settings(settings["analysis"])
    choice_of(settings.get("choice"))
    if settings.get("prior"):
        preset(str(settings["prior"]))


def plan(settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[CalibrationCell]:
    """Every cell of checked settings; all recordings are read and all plugins made once before any is run."""
    suite = suite_settings(settings["suite"], plugins.names("effects"))
    analyses = analysis_settings(settings["analysis"])
    recordings = read_all(where({**settings, "suite": suite}, progress))
    refuse_stated_weight(recordings, settings["scene"].get("areal_density"))
    by, each, joint = suite.get("case") or "fabric", suite["each"], suite["together"]
    cases = group(recordings, by, suite["select"], fitted=not each and not joint)
    if each:
        cases = one_by_one(cases, each)
    elif joint:
        cases = together(cases, joint)
    prior = preset(str(settings["prior"])) if settings.get("prior") else None
    if prior:
        settings = with_prior(settings, prior, plugins)
    by_path = {r.path: r for r in recordings}
    cells: dict[str, CalibrationCell] = {}
    searched: list[Names | None] = []
    for case, sources in cases.items():
        analysis = {n: _told(a) for n, a in analyses.items() if _matches(case, a["cases"])}
        textile = next((t for p, t in suite["textile"].items() if _matches(case, [p])), None)
        for model, optimizer, metric in itertools.product(*(settings[key] for key in PRODUCT)):
            free, held = gene_set(plugins, model, textile)
            begin: dict[str, float] = {}
            if prior:
                known = known_before(prior, model, settings, by_path[sources[0].path], plugins)
                free, begin = free | known.bounds, known.start
            cell = CalibrationCell(
                suite=suite.get("name") or "single",
                case=case,
                recordings=tuple(sources),
                model=model,
                optimizer=optimizer,
                metric=metric,
                effects=tuple(dict.fromkeys([*settings["effects"], *suite["effects"].get(model, [])])),
                fixed=held
                | {n: v for p, values in suite["fixed"].items() if _matches(case, [p]) for n, v in values.items()},
                analysis=analysis,
                rivals=tuple(rivals(sources, cases)) if "confusion" in analysis else (),
                report=tuple(settings["report"]),
                published=suite["published"],
                choice=choice_of(settings.get("choice")),
                start=begin,
                finer=settings["finer"],
                tracker=str(settings["tracker"]),
                bounds=free | settings["bounds"],
                **{key: settings[key] for key in ("options", "scene", "budget", "seed", "timeout")},
            )
            cell = dataclasses.replace(cell, versions=plugin_versions(uses(cell), plugins))
            searched.append(rehearse(cell, plugins, by_path))
            cells[cell.key] = cell
    if None not in searched:  # else not all names are known
        refuse_strays(settings, {name for names in searched if names for name in names.free}, plugins)
    refuse_unmatched(suite, cases, {r.name for r in recordings} | {_case_of(r, by) for r in recordings})
    refuse_unknown(suite, analyses, searched, plugins)
    return [
        dataclasses.replace(cell, recordings=lasting(cell.recordings), rivals=lasting(cell.rivals))
        for cell in cells.values()
    ]


def gene_set(
    plugins: Catalogue, model: str, textile: str | None
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """What a model says of a type of textile: bounds of what is free, and values of what is held."""
    if textile is None:
        return {}, {}
    try:
        return textile_of(plugins.load("models", model), textile)
    except PluginBroken:  # its own cell says so
        return {}, {}


def with_prior(settings: dict[str, Any], prior: Preset, plugins: Catalogue) -> dict[str, Any]:
    """The settings of a search that begins at a class of fabrics: optimizers that can begin at the defaults do, and a
    recording that does not know its weight has that of the class.
    """
    scene = {"areal_density": prior.numbers["areal_density"].value, **settings["scene"]}
    options = dict(settings["options"])
    for name in settings["optimizer"]:
        with contextlib.suppress(PluginBroken):
            if takes_option(plugins.load("optimizers", name), "start"):
                options[name] = {"start": "defaults", **options.get(name, {})}
    return {**settings, "scene": scene, "options": options}


def known_before(prior: Preset, model: str, settings: dict[str, Any], recording: Any, plugins: Catalogue) -> Prior:
    """What a class of fabrics says of a model's parameters in the scene of a recording, or in one of its size."""
    try:
        made = plugins.make("models", model, **settings["options"].get(model, {}))
    except PluginBroken:  # its own cell says so
        return Prior()
    width, height = (getattr(recording, name, 0.3) for name in ("cloth_width", "cloth_height"))
    scene = hanging(width, height, density_of(recording, prior))
    if isinstance(recording, Recording | PointCloud):
        scene = scenes_of(recording, **settings["scene"])[0]
    return prior_of(prior, made, scene)


def choice_of(stated: Any) -> str:
    """How one parameter set is chosen from a front."""
    choice = stated or CHOICES[0]
    if choice not in CHOICES:
        raise ClothbenchError(f"setting 'choice' is {stated!r}, expected one of {', '.join(CHOICES)}")
    return str(choice)


def refuse_unmatched(suite: Mapping[str, Any], cases: Iterable[str], others: set[str]) -> None:
    """Patterns of cases that say nothing of any case, nor of recordings that are left out (`others`: their names).

    A suite may speak of the cases of other recordings beside its own; then a pattern is wrong if it is almost the name
    of a case of which nothing is said.
    """
    for key in ("fixed", "textile"):
        patterns, there = list(suite[key]), sorted(cases)
        unmatched = [p for p in patterns if not any(_matches(c, [p]) for c in {*there, *others})]
        silent = [case for case in there if not _matches(case, patterns)]
        wrong = [
            p for p in unmatched if len(unmatched) == len(patterns) or difflib.get_close_matches(p, silent, 1, 0.8)
        ]
        if wrong:
            found = f"setting 'suite.{key}': {wrong[0]!r} matches none of the cases {', '.join(there)}"
            raise ClothbenchError(f"{found}; name one, or take all out with ~suite.{key}")


def refuse_unknown(
    suite: Mapping[str, Any], analyses: Mapping[str, Any], searched: Sequence[Names | None], plugins: Catalogue
) -> None:
    """Models, metrics and parameters that a suite or an analysis speaks of and no plugin has. A suite may speak of
    models that are not run here, so that their parameters and those of any effect may be fixed, or mapped, as well.
    """
    for key, kind in (("effects", "models"), ("published", "metrics")):
        for name in suite[key]:
            try:
                plugins.find(kind, name)
            except PluginBroken:  # its own cell says so
                continue
            except ClothbenchError as fault:
                raise ClothbenchError(f"setting 'suite.{key}': {fault}") from fault
    here = {name for names in searched if names is not None for name in names.all}
    spoken = {
        "suite.fixed": [name for values in suite["fixed"].values() for name in values],
        "analysis.map.parameters": analyses.get("map", {}).get("parameters", []),
    }
    if None in searched or here.issuperset(name for names in spoken.values() for name in names):
        return
    known = here | parameters_of_all(plugins)
    for key, names in spoken.items():
        if strays := [name for name in names if name not in known]:
            there = known_names(strays[0], sorted(here))
            raise ClothbenchError(f"setting '{key}': no parameter {strays[0]!r}; {there}")


def _matches(case: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch.fnmatch(case, p) for p in patterns)


def _named(source: Source, case: str, patterns: Sequence[str]) -> bool:
    """Whether a recording is meant, by its name with or without that of its case."""
    return _matches(source.name, patterns) or _matches(source.name.removeprefix(f"{case}/"), patterns)


def _told(options: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in options.items() if key != "cases"}


def one_by_one(cases: Mapping[str, Sequence[Source]], patterns: Sequence[str]) -> dict[str, list[Source]]:
    """A case of its own for each recording whose name matches, called by that name: it is fitted, the others of its
    case are held out, whatever split the files state.
    """
    out = {}
    for case, sources in cases.items():
        for fitted in (s for s in sources if _named(s, case, patterns)):
            split = [dataclasses.replace(s, split="fit" if s is fitted else "held_out") for s in sources]
            out[fitted.name] = sorted(split, key=lambda s: s.split)
    if not out:
        raise ClothbenchError(f"setting 'suite.each' {list(patterns)} matches none of the recordings")
    return out


def together(cases: Mapping[str, Sequence[Source]], patterns: Sequence[str]) -> dict[str, list[Source]]:
    """All recordings of a case whose names match are fitted at once, its others held out, whatever the files state."""
    out = {
        case: [dataclasses.replace(s, split="fit" if _named(s, case, patterns) else "held_out") for s in sources]
        for case, sources in cases.items()
        if any(_named(s, case, patterns) for s in sources)
    }
    if not out:
        raise ClothbenchError(f"setting 'suite.together' {list(patterns)} matches none of the recordings")
    return out


def rivals(sources: Sequence[Source], cases: Mapping[str, Sequence[Source]]) -> list[Source]:
    """The recordings of other fabrics ("FABRIC/TRIAL") whose trial is one that this case could have fitted."""
    known = {s.name: s for mine in cases.values() for s in mine}
    fitted = {s.name for mine in cases.values() for s in mine if s.split == "fit"}
    trials = {s.name.partition("/")[2] for s in sources if s.name in fitted} - {""}
    mine = {s.name for s in sources}
    return [s for name, s in sorted(known.items()) if name.partition("/")[2] in trials and name in fitted - mine]


def read_all(paths: Iterable[Path]) -> list[Any]:
    return [read_sheet(path) for path in paths]


def _case_of(r: Recording, by: str) -> str:
    if by in ("all", "recording"):
        return "all" if by == "all" else r.name
    if by == "experiment":  # of one fabric, as the recording's header says
        return "/".join(filter(None, (r.fabric, r.notes.get("experiment", "")))) or r.name
    return getattr(r, by) or r.name


def group(
    recordings: Sequence[Recording], by: str, patterns: Sequence[str], fitted: bool = True
) -> dict[str, list[Source]]:
    """Recordings by case, each with a fit split if `fitted`; a recording's name must match one of `patterns`.

    Where no split is stated it is the same for every seed: searches with several are repetitions on one question. A
    name that recordings of several cases have becomes CASE/NAME: rows know a recording by its name alone.
    """
    chosen = matching(recordings, patterns)
    of_name = Counter(r.name for r in chosen)
    cases: dict[str, list[Source]] = {}
    for r in chosen:
        cases.setdefault(_case_of(r, by), []).append(Source(r.path, r.name, r.hash, r.split))
    for case, mine in cases.items():
        require_own_names(mine, "" if by in ("all", "recording") else case)
        cases[case] = [dataclasses.replace(s, name=f"{case}/{s.name}") if of_name[s.name] > 1 else s for s in mine]
    out = {case: resplit(sources, seed=0) for case, sources in sorted(cases.items())}
    for case, sources in out.items():
        if fitted and not any(s.split == "fit" for s in sources):
            remedy = "see suite.select"
            if by not in ("all", "recording") and [s.name for s in sources] == [case]:
                remedy = f"it states no {by}, so that it is a case of its own: suite.case=all"
            raise ClothbenchError(
                f"case {case!r}: found only held-out recordings, expected at least one to fit; {remedy}"
            )
    require_own_names([s for sources in out.values() for s in sources])
    return out
