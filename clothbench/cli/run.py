"""`clothbench run`: Hydra composes the settings, the plan's missing cells are run, and the table is printed."""

from __future__ import annotations

import io
import itertools
import json
import math
import os
import re
import shlex
import shutil
import sys
import tempfile
import traceback
import uuid
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, suppress
from functools import cache
from pathlib import Path
from typing import Any

import hydra
from hydra import compose, initialize_config_module
from hydra._internal.utils import get_args_parser
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.errors import HydraException, OverrideParseException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.types import RunMode
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from clothbench.cli.hydra_words import either_way
from clothbench.cli.idle import refuse_idle, say_alone, say_idle, say_split
from clothbench.cli.own_suites import each_choice, require_harmless, settings_among, where_searched
from clothbench.cli.results import print_results
from clothbench.cli.settings_help import settings_help
from clothbench.cli.spelling import as_setting, given_twice
from clothbench.core.errors import ClothbenchError, known_names, nearest
from clothbench.core.parallel import available_cores
from clothbench.engine.bucket import is_address
from clothbench.engine.executors.settings import executor_settings
from clothbench.engine.limits import Limits
from clothbench.engine.mirror import results_folder, up_to_date
from clothbench.engine.pool import failed, run_cells
from clothbench.engine.progress import CellBar, Sweep, counting
from clothbench.engine.settings import KNOWN, checked, flat, last_word
from clothbench.engine.store import Store
from clothbench.engine.study import refuse_unsound
from clothbench.engine.suite import plan, suites_folder
from clothbench.plugins.discovery import PluginBroken, catalogue, config_groups

JOBS = "CLOTHBENCH_RUN_JOBS"  # how many jobs a sweep has, for the jobs to say
NOTES = "CLOTHBENCH_RUN_NOTES"  # folder in which the jobs of one command leave word for it, whatever launched them
MAIN_SUITE = "static_dynamic"  # what a sweep is over if it names no recordings
RECORDINGS = ("suite=", "recording=", "recordings=")  # how a command line names some
KINDS = {
    "study": "studies", "model": "models", "optimizer": "optimizers", "metric": "metrics", "report": "metrics",
    "effects": "effects", "tracker": "trackers",
}  # fmt: skip
TOGETHER = (
    "found several of --run, -m, --cfg, --info and --shell_completion, expected one of them; to see the settings of a "
    "sweep's jobs, leave -m out and give each setting one value"
)
TRIED = 100  # jobs of a sweep whose settings are put together before the first begins, at a tenth of a second each


class PluginSearchPath(SearchPathPlugin):
    """Puts the built-in suites, then every plugin's config package, on Hydra's search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        search_path.append("clothbench-suites", f"file://{suites_folder()}")
        for place in catalogue().configs:
            if taken := config_groups(place) & (KNOWN - {"suite"}):
                print(
                    f"clothbench: {place}: left out: its folder {min(taken)!r} hides a setting; rename it",
                    file=sys.stderr,
                )
            else:
                search_path.append("clothbench-plugin", place)


def run(arguments: Sequence[str]) -> int:
    """Run `clothbench run ARGUMENTS` and return the exit code."""
    require_settings(arguments)
    given = list(arguments)
    if {"--help", "-h"} & set(arguments):
        print(settings_help())
    sweep = bool({"-m", "--multirun"} & set(arguments))
    if sweep and not any(word.lstrip("+").startswith(RECORDINGS) for word in arguments):
        print(f"clothbench: the sweep names no recordings; it takes +suite={MAIN_SUITE}", file=sys.stderr)
        arguments = [*arguments, f"+suite={MAIN_SUITE}"]
    Plugins.instance().register(PluginSearchPath)
    notes = Path(tempfile.mkdtemp(prefix="clothbench-"))
    os.environ.update({NOTES: str(notes), "HYDRA_FULL_ERROR": "1"})
    os.environ.setdefault("CLOTHBENCH_SWEEP_DIR", str(notes / "sweep"))
    try:
        words = settings_among(arguments)  # first: Hydra takes no settings on both sides of a flag
        arguments = either_way([*words, *(word for word in arguments if word not in words)], sweep)
        os.environ[JOBS] = str(jobs_of(arguments) if sweep else 0)
        sweep_so_far.cache_clear()
        sys.argv = ["clothbench run", *arguments]
        require_harmless(arguments)
        if sweep:
            require_known(arguments)
            require_sound(arguments)
        hydra.main(version_base="1.3", config_path="pkg://clothbench.conf", config_name="run")(job)()
    except (HydraException, OmegaConfBaseException) as fault:
        raise ClothbenchError(_one_line(fault)) from fault
    except ValueError as fault:
        if _of_a_job(fault):
            raise
        raise ClothbenchError(f"found a setting without a place ({fault}), expected KEY=VALUE of a run") from fault
    else:
        if not (code := _conclude(notes, sweep)):  # a refusal is one line, and the first thing to mend
            say_twice(given)
        return code
    finally:
        shutil.rmtree(notes, ignore_errors=True)


def require_settings(arguments: Sequence[str]) -> None:
    """Refuse an option that is none of Hydra's, and say how a setting is written; and several that exclude each other,
    which Hydra refuses only after a sweep's settings have been looked at.
    """
    reader = get_args_parser()
    asked, over = reader.parse_known_args(arguments)
    commands = (asked.run, asked.multirun, asked.cfg is not None, asked.info is not None, asked.shell_completion)
    if not asked.help and sum(commands) > 1:
        raise ClothbenchError(TOGETHER)
    for word in (word for word in over if word.startswith("-")):
        option = word.partition("=")[0]
        name = word.lstrip("-").partition("=")[0].replace("-", "_")
        near = nearest(name, [*KNOWN, *(known.lstrip("-") for known in reader._option_string_actions)])
        remedy = f"is no option; {near}see clothbench run --help"
        if name.partition(".")[0] in KNOWN:
            remedy = f"is written {as_setting(word, arguments)} here"
        raise ClothbenchError(f"run: {option} {remedy}")


def say_twice(arguments: Sequence[str]) -> None:
    """A line on a key with two values: as everywhere in Hydra the last one counts, which few may mean. Words with signs
    of Hydra's own before them are meant so.
    """
    if twice := given_twice([word for word in settings_among(arguments) if not word.startswith(("+", "~"))]):
        print(f"clothbench: run: {twice}; the last counts", file=sys.stderr)


def _of_a_job(fault: Exception) -> bool:
    """Whether it came up in a job, and not before, when OmegaConf read its settings: that has no exception of its own
    for a place in a list that is no number.
    """
    return any(frame.f_code is job.__code__ for frame, _ in traceback.walk_tb(fault.__traceback__))


def leaves(words: Sequence[str]) -> list[str]:
    """Hydra's words, KEY={NAME:VALUE,…} as one KEY.NAME= for each, so that it is known what was spoken of."""
    out = []
    for word in words:
        key, _, value = word.partition("=")
        inside = OverridesParser.create().parse_override(word).value() if value.startswith("{") else None
        out += [f"{key}.{name}=" for name in (flat(inside) if isinstance(inside, dict) else ())] or [word]
    return out


def jobs_of(words: Sequence[str]) -> int:
    """How many jobs Hydra's own sweeper makes of the words of a sweep; 0 where another one decides."""
    if any(word.startswith(("hydra/sweeper=", "hydra.sweeper")) for word in words):
        return 0
    return math.prod(len(values) for _, values in swept(words))


def swept(words: Sequence[str]) -> list[tuple[str, list[str]]]:
    """What a sweep goes over: each KEY and its values. Nothing where Hydra cannot read the words: it says so itself."""
    try:
        given = OverridesParser.create().parse_overrides(settings_among(words))
        return [(one.key_or_group, list(one.sweep_string_iterator())) for one in given if one.is_sweep_override()]
    except HydraException:
        return []


def require_known(words: Sequence[str]) -> None:
    """Refuse a sweep over a plugin that does not exist: its jobs are read one by one, the last perhaps hours later."""
    for key, values in swept(words):
        for name in (name for value in values for name in value.strip("[]").split(",")):
            if key in KINDS and name not in ("", "null"):
                with suppress(PluginBroken):  # its own cells say so
                    catalogue().find(KINDS[key], name.strip("'\" "))


def require_sound(words: Sequence[str]) -> None:
    """Refuse a sweep with a value that can be no setting, of whatever job: recordings are read as jobs come. Each value
    is tried in one job at least, up to `TRIED` of them; nothing where another sweeper than Hydra's own makes the jobs.
    """
    if not jobs_of(words):
        return
    jobs = list(itertools.islice(each_choice(words), TRIED))
    with redirect_stderr(io.StringIO()):  # what Hydra has to say of folders and words it says again
        found = settings_of(jobs, where_searched(words))
    for config in found:
        executor_settings(config.get("executor"))
        Limits.of(config.get("limits"))
        out = tempfile.gettempdir() if is_address(config.get("out")) else config.get("out")
        with suppress(PluginBroken):  # its own cells say so
            study = catalogue().load("studies", str(config.get("study")))
            refuse_unsound(study, checked({**config, "out": out}, catalogue(), study.suite_words))


@cache
def sweep_so_far() -> Sweep:
    """The sweep that the jobs of this process belong to."""
    return Sweep(int(os.environ[JOBS]))


def job_number() -> int | None:
    """Which job of a sweep this is, counted from 0 as the sweep goes on, whatever launched it; None outside of one."""
    asked = HydraConfig.get()
    return int(asked.job.num) if asked.mode == RunMode.MULTIRUN else None


def sweep_now() -> Sweep | None:
    """The sweep, with the job that begins now; None where there is none."""
    if (number := job_number()) is None:
        return None
    sweep = sweep_so_far()
    sweep.passed = number + 1
    return sweep


def composed(words: Sequence[str]) -> dict[str, Any]:
    """The settings that Hydra makes of KEY=VALUE words, for one job; nothing is run."""
    return settings_of([either_way(words)])[0]


def settings_of(jobs: Sequence[Sequence[str]], where: Sequence[str] = ()) -> list[dict[str, Any]]:
    """The settings that Hydra makes of the words of several jobs; where: the word that says where else suites lie."""
    Plugins.instance().register(PluginSearchPath)
    out = []
    try:
        with initialize_config_module("clothbench.conf", version_base="1.3"):
            for words in jobs:
                config = compose("run", overrides=[*where, *words])
                settings = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
                out.append(last_word(settings, leaves(words)))  # type: ignore[arg-type]
    except (HydraException, OmegaConfBaseException) as fault:
        raise ClothbenchError(_one_line(fault)) from fault
    return out


def job(config: Any) -> None:
    """One Hydra job. Leaves a note of its cells; a user's error is noted too, so that any launcher can carry it. Notes
    are read in the order of the jobs, which their names have.
    """
    try:
        settings = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
        words = leaves(HydraConfig.get().overrides.task)
        note = _run(last_word(settings, words), sweep_now(), words)  # type: ignore[arg-type]
    except ClothbenchError as fault:
        note = {"error": str(fault)}
    except OmegaConfBaseException as fault:
        note = {"error": _one_line(fault)}
    folder = Path(os.environ[NOTES])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{job_number() or 0:06d}-{uuid.uuid4().hex}.json").write_text(json.dumps(note))


def _run(config: Any, sweep: Sweep | None, words: Sequence[str] = ()) -> dict[str, Any]:
    executor, limits = executor_settings(config.get("executor")), Limits.of(config.get("limits"))
    if is_address(config.get("out")):
        config = {**config, "out": str(results_folder(config["out"]))}
    with counting("files") as told:
        cells = plan(config, catalogue(), told)
    if sweep is None:  # a sweep may mean them for other jobs
        refuse_idle(words, config, cells)
        say_idle(words, cells, config)
        say_alone(config, cells)
    say_split(cells)
    out = Path(config["out"])
    with CellBar(cells, sweep, at_once=int(config["jobs"]) or available_cores()) as bar:
        run_cells(
            cells, out, jobs=int(config["jobs"]), rerun=bool(config["rerun"]), done=bar.done, progress=bar.tell,
            executor=executor,
            limits=limits,
        )  # fmt: skip
    return {"out": str(out.absolute()), "cells": [c.key for c in cells]}


def _conclude(notes: Path, sweep: bool) -> int:
    """Print the table over all jobs' cells and where things lie; the exit code of the whole command.

    Without a job there is nothing to conclude (`--help`, `--cfg job`), except after a sweep, which always has jobs.
    """
    found = [json.loads(p.read_text()) for p in sorted(notes.glob("*.json"))]
    errors, ran = [n["error"] for n in found if "error" in n], [n for n in found if "error" not in n]
    if sweep and not found:
        raise ClothbenchError("no job left word of what it did; give the jobs a folder they share, with TMPDIR")
    code = 0
    for out in sorted({n["out"] for n in ran}):
        mine = [n for n in ran if n["out"] == out]
        store, keys = up_to_date(Store(out)), list(dict.fromkeys(k for n in mine for k in n["cells"]))
        rows = print_results(store, keys)
        say_all_skipped(rows)
        _say_where(store, keys)
        code = max(code, int(failed(r["status"] for r in rows)))
    if errors:  # of some of a sweep's jobs; what the others did is told all the same
        raise ClothbenchError(errors[0] + (f" (and {len(errors) - 1} more jobs)" if len(errors) > 1 else ""))
    return code


def say_all_skipped(rows: Sequence[Mapping[str, Any]]) -> None:
    """A line where a run has come to nothing though no cell of it failed: every one was skipped for its reason."""
    skipped = {row["key"] for row in rows}
    if rows and all(row["status"] == "skipped" for row in rows):
        cells = f"all {len(skipped)} cells were" if len(skipped) > 1 else "the one cell was"
        print(
            f"clothbench: nothing was computed: {cells} skipped, for what stands above; take a model that can do this "
            "(`clothbench plugins`, docs/models.md), or other recordings",
            file=sys.stderr,
        )


def _say_where(store: Store, keys: Sequence[str]) -> None:
    from clothbench.engine.run import TRACEBACK
    from clothbench.report.page import PAGE, write_page
    from clothbench.studies.calibration.film_rerun import BEST, write_best

    shown = Path(os.path.relpath(store.folder)) if store.folder.is_relative_to(Path.cwd()) else store.folder
    named = shlex.quote(str(store.address if store.bucket is not None else shown))
    write_page(store.folder)
    print(f"page:   {shown / PAGE}")
    print(f"tables: {shown / 'cells'}/KEY/*.parquet   (clothbench leaderboard --out {named})")
    if fell := [key for key in keys if (store.cell(key) / TRACEBACK).is_file()]:
        more = f"   (and of {len(fell) - 1} more cells)" if len(fell) > 1 else ""
        print(f"trace:  {shown / 'cells' / fell[0] / TRACEBACK}{more}")
    best = write_best(store, keys)
    if best or any((store.cell(k) / "fit.rrd").exists() for k in keys):
        files = f"   ({shown / BEST}: the best fit of each case)" if best else ""
        print(f"rerun:  clothbench view {keys[0]} --out {named}{files}")
    for key in dict.fromkeys(path.parent.name for path in store.disagreements(keys)):
        print(f"fault:  {key} was computed twice and did not come to the same (clothbench store check {named})")


def _one_line(fault: Exception) -> str:
    """Hydra's message without its line breaks; what the choices are, where it lists them."""
    text = str(fault).split("Config search path")[0].partition("See https://hydra.cc")[0]
    if unknown := re.match(r"Could not override '(.*)'\.\s+To append to your config", text):
        near = nearest(unknown[1].partition(".")[0], KNOWN)
        return f"setting {unknown[1]!r} is not known; {near}`clothbench run --cfg job` shows all that are"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if isinstance(fault, OverrideParseException):
        why = "" if lines[0].startswith("Lexer") else f" ({' '.join(lines)})"  # that one only points at a letter
        return (
            f"found {fault.override!r}, which Hydra cannot read{why}; a value with signs like = or ' in it stands in "
            "quotes of its own: 'KEY=\"VALUE\"'"
        )
    if missing := re.match(r"In 'run': Could not find '(.*)/(.*)'\s+Available options in '.*':\s", text):
        return f"found no {missing[1]}/{missing[2]}; {known_names(missing[2], lines[2:])}"
    return " ".join(lines) or type(fault).__name__
