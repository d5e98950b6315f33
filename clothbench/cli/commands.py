"""The command line. Each command imports what it needs when it runs, so that `--help` answers at once."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError, one_line

DEFAULT_OUT = "runs"

EPILOG = """\
examples:
  clothbench run +suite=static_dynamic                 the default benchmark, nothing else needed
  clothbench run -m +suite=static_dynamic seed=1,2,3   a Hydra sweep over any setting
  clothbench run recording=swing.nc model=mass_spring optimizer=ga metric=node_error
  clothbench improve recordings=DIR model=mass_spring  what does the model lack?
  clothbench suggest DIR model=mass_spring             which experiment to do next
  clothbench import iri_wam_cloth_swing data_dir=DATA  real recordings of a robot
  clothbench leaderboard --json > results.json
  clothbench export fleece/waving-1 --to mujoco        what was calibrated, for another simulator
exit codes: 0 done; 1 some cells failed or the gate is broken; 2 wrong use or bad input"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code. Errors a user can cause are one line on standard error."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    arguments.sort(key=lambda a: a == "--json")  # last: argparse takes no flag between KEY=VALUE words
    for library in (
        "OPENBLAS",
        "MKL",
        "OMP",
    ):  # the cores are filled with whole rollouts; more threads only get in the way
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))  # a picture's header may claim anything
    try:
        if arguments[:1] == ["run"]:  # Hydra reads the rest
            from clothbench.cli.run import run

            return run(arguments[1:])
        options = parser().parse_args(arguments)
        return options.function(options)
    except ClothbenchError as fault:
        if debug:
            raise
        print(f"clothbench: {fault}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of our output has gone, as `| head` does
        sys.stderr.close()
        return 0
    except OSError as fault:
        if debug:
            raise
        line = one_line(f"{fault.filename or 'a file'}: {fault.strerror or fault}")
        print(f"clothbench: {line}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("clothbench: stopped; finished cells are kept, run the same command again to go on", file=sys.stderr)
        return 130


def parser() -> argparse.ArgumentParser:
    out = argparse.ArgumentParser(
        prog="clothbench", epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Which cloth model to trust, with which parameters, and what it still gets wrong.",
    )  # fmt: skip
    from clothbench import __version__

    out.add_argument("--version", action="version", version=f"clothbench {__version__}")
    out.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = out.add_subparsers(metavar="COMMAND", required=True)
    commands.add_parser(
        "run", help="run a suite, a sweep or one cell (Hydra overrides; `run --help` shows all settings)"
    )
    _add(commands, "improve", improve, "find what a calibrated model lacks, and add it", _improve, _json)
    _add(commands, "suggest", suggest, "which next experiment would tell most", _suggest, _json)
    _add(commands, "plugins", plugins, "every plugin, with parameters and units; broken ones with the reason", _json)
    _add(commands, "validate", validate, "check recordings; exit 1 if one is bad", _paths, _json)
    _add(commands, "datasets", datasets, "known public data sets, their licence, and whether they are at hand", _json)
    _add(commands, "import", import_data, "convert a public data set into recordings", _import)
    _add(commands, "leaderboard", leaderboard, "all results so far", _store, _json)
    _add(commands, "compare", compare, "exit 1 if NEW is worse than BASE beyond the noise", _compare, _json)
    _add(commands, "history", history, "error and speed of every model against commit, and where they changed",
         _history, _json)  # fmt: skip
    _add(commands, "bench", bench, "speed of every model beside the installed peers", _bench, _json)
    _add(commands, "report", report, "one self-contained page with figures", _report)
    _add(commands, "view", view, "open a fit in Rerun, recording beside rollout", _view)
    _add(commands, "export", export, "a calibrated cloth as a file that another simulator loads", _export)
    _add(
        commands, "units", units, "a simulator's parameters: as documented, and as measured by mechanics", _units, _json
    )
    _add(commands, "presets", presets, "what measured fabrics are like, with spread and source", _presets, _json)
    _add(commands, "submit", submit, "score what another simulator moved, for others to check", _submit)
    _add(commands, "verify", verify, "compute the scores of submissions again; exit 1 if one does not stand", _verify)
    _add(commands, "site", site, "a leaderboard of submissions as a static site; all of them are verified first", _site)
    _store_commands(commands)
    _add(commands, "new-plugin", new_plugin, "start a plugin distribution with a passing conformance test", _new)
    return out


def _add(commands: Any, name: str, function: Callable, text: str, *extras: Callable) -> None:
    sub = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    sub.set_defaults(function=function)
    for extra in extras:
        extra(sub)


def _store_commands(commands: Any) -> None:
    text = "care of a results folder: check it, merge it into another, prune it"
    sub = commands.add_parser("store", help=text, description=f"{text[0].upper()}{text[1:]}.")
    tasks = sub.add_subparsers(metavar="TASK", required=True)
    _add(tasks, "check", store, "read every file; one line per fault, exit 1 if there is one", _folder, _json)
    _add(tasks, "merge", store, "take cells from another results folder; exit 1 if two disagree", _merge, _json)
    _add(tasks, "prune", store, "remove what stopped runs left, and cells that are asked for", _folder, _prune, _json)
    for task in ("check", "merge", "prune"):
        tasks.choices[task].set_defaults(task=task)


def _folder(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", metavar="FOLDER", help="results folder, or s3://BUCKET/PREFIX")


def _merge(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", metavar="FROM", help="results folder to take cells from; it stays as it is")
    sub.add_argument("into", metavar="INTO", help="results folder to put them into; nothing finished is replaced there")


def _prune(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--dry-run", action="store_true", help="say what would be removed, and remove nothing")
    sub.add_argument(
        "--older", type=float, default=1.0, metavar="DAYS",
        help="age from which on what stopped runs left is removed (default: 1)",
    )  # fmt: skip
    sub.add_argument(
        "--other-versions", action="store_true", help="cells of plugins in another version than the installed one, too"
    )
    sub.add_argument("--cell", action="append", default=[], metavar="KEY", help="this cell, too, finished or not")


def _json(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--json", action="store_true", help="one JSON document on standard output")


def _paths(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("paths", nargs="+", metavar="PATH", help="recording (.nc) or folder")


def _store(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--out", default=DEFAULT_OUT, help="results folder, or s3://BUCKET/PREFIX (default: runs)")


def _recordings(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--recordings", nargs="+", default=["builtin:static_dynamic"], metavar="PATH",
        help="what was measured: .nc files or folders (default: builtin:static_dynamic)",
    )  # fmt: skip


def _submit(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", type=Path, help="of simulated recordings: copies of the measured ones' files (kind "
                     "nodes) with the simulated `position`")  # fmt: skip
    _recordings(sub)
    sub.add_argument("--name", required=True, help="what the model is called on the leaderboard")
    sub.add_argument("--by", default="", help="who hands it in")
    sub.add_argument("--about", default="", help="one line about the model")
    sub.add_argument("--suite", default="static_dynamic", help="what its rows are grouped by (default: static_dynamic)")
    sub.add_argument("--metric", nargs="+", help="that scores it (default: node_error; of --runs: those of the fits)")
    sub.add_argument("--runs", metavar="RUNS", help="pack the calibrations of a results folder into FOLDER")
    sub.add_argument(
        "--wheel", nargs="+", type=Path, metavar="FILE", help="with --runs: the distribution that the plugins come from"
    )


def _verify(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="a submission")
    _recordings(sub)
    sub.add_argument("--out", type=Path, help="results folder that takes what stands")
    sub.add_argument("--reproduce", action="store_true", help="run random cells of it again, with its own wheels")
    sub.add_argument(
        "--held-out", nargs="+", metavar="PATH", help="refit it, and score it, on recordings that were never published"
    )
    sub.add_argument(
        "--run-their-code", action="store_true",
        help="needed by both: they run the submitter's plugin with your rights",
    )  # fmt: skip
    sub.add_argument("--cells", type=_count, default=2, metavar="N", help="cells to run again (default: 2)")
    sub.add_argument("--seed", type=int, metavar="N", help="of their choice (default: drawn now, and told)")
    sub.add_argument(
        "--time-limit", type=float, default=3600.0, metavar="S", help="s that one fit may take (default: 3600)"
    )
    sub.add_argument("--verdicts", type=Path, metavar="FOLDER", help="keep what was found here, for `clothbench site`")


def _site(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", type=Path, metavar="FOLDER", help="with a folder for each submission")
    _recordings(sub)
    sub.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="that takes index.html and submissions/")
    sub.add_argument(
        "--verdicts", type=Path, metavar="FOLDER",
        help="of `clothbench verify --verdicts`: grades that took running a plugin",
    )  # fmt: skip


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected a whole number, at least 1")
    return int(text)


def _import(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name",
        metavar="NAME",
        help="a data set that `clothbench datasets` lists, a folder of depth frames, or a video "
        "(a file, or a folder of pictures)",
    )
    sub.add_argument(
        "settings",
        nargs="*",
        metavar="KEY=VALUE",
        help="data_dir=FOLDER of the originals, out=FOLDER for the recordings; of a video: template=PICTURE width=M "
        "height=M, and if they are known rate, name, fabric, motion, split, areal_density, camera=JSON, marks",
    )


def _improve(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "settings", nargs="+", metavar="KEY=VALUE",
        help="recordings=DIR model=NAME [out=DIR] [candidates=NAME,…] [seed=N] [resolution=NODES] [base=NAME,…] "
        "[areal_density=KG_PER_M2] [executor=dask|ray|slurm]",
    )  # fmt: skip


def _suggest(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name", metavar="RECORDINGS|CELL",
        help="a recording or a folder of them, with model=NAME; or a cell, a case or a recording of a run as in `view`",
    )  # fmt: skip
    sub.add_argument(
        "settings", nargs="*", metavar="KEY=VALUE",
        help="model=NAME [out=DIR] [effects=NAME,…] [tied=ONE,OTHER] [verdict=FOLDER of improve] "
        "[rank=information|tie|PARAMETER] [max_speed=M/S] [max_acceleration=M/S²] [reach=M] [durations=S,…] "
        "[grips=NAME,…] [draws=N] [best=N], and what improve takes of recordings and models",
    )  # fmt: skip
    sub.add_argument("--runs", default=DEFAULT_OUT, metavar="FOLDER", help="results folder of a cell (default: runs)")


def _compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("base", metavar="BASE", help="results folder or leaderboard .json to hold against")
    sub.add_argument("new", metavar="NEW", help="results folder or leaderboard .json to judge")
    sub.add_argument("--markdown", action="store_true", help="as Markdown, for a comment on a pull request")


def _history(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "folder", nargs="?", type=Path, metavar="FOLDER", help="of entries, one for each commit and machine"
    )
    sub.add_argument("--add", metavar="RUNS", help="a results folder, which becomes an entry of FOLDER first")
    sub.add_argument("--commit", default="HEAD", help="that RUNS are of, in the repository here (default: HEAD)")
    sub.add_argument(
        "--git", type=Path, metavar="FILE",
        help="instead of FOLDER: a leaderboard .json that is committed, at every commit that changed it",
    )  # fmt: skip
    sub.add_argument("--machine", metavar="NAME", help="with --git: what all of that was computed on (else not known)")
    sub.add_argument("--page", type=Path, metavar="FILE", help="write a self-contained page, too")


def _bench(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--quick", action="store_true", help="the two smaller sheets only")


def _report(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="out=FOLDER with the results (default: runs)")
    sub.add_argument("--watch", action="store_true", help="follow a run: the page refreshes itself while cells finish")


def _view(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name", metavar="CELL|CASE|RECORDING",
        help="key of a cell, or its beginning, or the name of a case or recording, as page and leaderboard show them; "
        "of `improve`, a recording's name",
    )  # fmt: skip
    sub.add_argument("--web", action="store_true", help="in a browser; so it is where there is no display, too")
    _store(sub)


def _export(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name",
        metavar="CELL|PRESET",
        help="a cell, a case or a recording, as for `view`; or a class of fabrics",
    )
    sub.add_argument("--to", required=True, metavar="TARGET", help="mujoco, newton, usd, ppf, json, or a plugin's")
    sub.add_argument("--out", type=Path, metavar="FILE", help="the file to write (default: named after the cell, here)")
    sub.add_argument("--runs", default=DEFAULT_OUT, metavar="FOLDER", help="results folder (default: runs)")


def _units(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("name", metavar="MODEL", help="mujoco, newton, or any model that knows materials")
    sub.add_argument("settings", nargs="*", metavar="OPTION=VALUE", help="options of the model, for example solver=vbd")


def _presets(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("name", nargs="?", metavar="NAME", help="a class of fabrics (default: all)")


def _new(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("kind", choices=("model", "effect", "metric", "optimizer", "tracker"))
    sub.add_argument("name", metavar="NAME", help="the plugin's name, an identifier")
    sub.add_argument("--into", default=".", metavar="FOLDER", help="where to put it (default: here)")


def key_values(settings: Sequence[str], allowed: Sequence[str]) -> dict[str, str]:
    """ "key=value" words as a dictionary; anything else is refused."""
    out = {}
    for word in settings:
        key, sign, value = word.partition("=")
        if not sign or key not in allowed:
            raise ClothbenchError(f"found {word!r}, expected {' or '.join(f'{a}=VALUE' for a in allowed)}")
        out[key] = value
    return out


def results_in(place: str | Path, default: str = DEFAULT_OUT, whole: bool = True) -> Any:
    """The store in a folder or a bucket; one that was named and holds no results is the user's error.

    whole: whether an object of a bucket that cannot be read is one, too.
    """
    from clothbench.engine.mirror import results_folder
    from clothbench.engine.store import Store

    folder = results_folder(place, whole)
    if str(place) != default and not (folder / "cells").is_dir():
        raise ClothbenchError(f"{place}: found no results (no 'cells'); make some with clothbench run … out={place}")
    return Store(folder)


def _folder_of(place: str) -> Path:
    """A folder as it was named; the mirror of a bucket, which has to hold results."""
    from clothbench.engine.bucket import is_address

    return results_in(place).folder if is_address(place) else Path(place)


def print_json(document: Any) -> None:
    print(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False))


def print_json_rows(rows: Sequence[dict[str, Any]]) -> None:
    """The same as `print_json` of rows that hold neither lists nor rows; of very many, several times as fast."""
    texts = (json.dumps(row, ensure_ascii=False, allow_nan=False, separators=(",\n  ", ": ")) for row in rows)
    body = ",\n ".join(f"{{\n  {text[1:-1]}\n }}" for text in texts)
    print(f"[\n {body}\n]" if body else "[]")


# --- commands -------------------------------------------------------------------------------------------------------


def improve(options: argparse.Namespace) -> int:
    from clothbench.cli.improve import command

    return command(options.settings, options.json)


def suggest(options: argparse.Namespace) -> int:
    from clothbench.cli.suggest import command

    return command(options.name, options.settings, _folder_of(options.runs), options.json)


def plugins(options: argparse.Namespace) -> int:
    from clothbench.cli.listings import plugin_rows, print_plugins

    rows = plugin_rows()
    print_json(rows) if options.json else print_plugins(rows)
    return 0


def validate(options: argparse.Namespace) -> int:
    from clothbench.recordings.kinds import read_any
    from clothbench.recordings.nodes import find_recordings

    rows = []
    for path in find_recordings(options.paths):
        try:
            recording = read_any(path)
            rows.append({"file": str(path), "ok": True, "fault": None, "name": recording.name, "hash": recording.hash})
        except ClothbenchError as fault:
            rows.append({"file": str(path), "ok": False, "fault": str(fault), "name": None, "hash": None})
    if options.json:
        print_json(rows)
    else:
        for row in rows:
            print(f"{row['file']}: ok" if row["ok"] else row["fault"])
    return 0 if all(row["ok"] for row in rows) else 1


def datasets(options: argparse.Namespace) -> int:
    from clothbench.cli.listings import dataset_rows, print_datasets

    rows = dataset_rows()
    print_json(rows) if options.json else print_datasets(rows)
    return 0


def import_data(options: argparse.Namespace) -> int:
    from clothbench.cli.listings import print_import
    from clothbench.datasets.convert import converted
    from clothbench.datasets.video_file import SETTINGS, is_video, video_recording
    from clothbench.engine.progress import counting

    given = Path(options.name)
    if is_video(given):
        settings = key_values(options.settings, SETTINGS)
        with counting("frames") as told:
            path = video_recording(given, settings, told)
        print(f"{path}: one recording of kind 'video'; next: clothbench run recording={path} tracker=sift_graph …")
        return 0
    settings = key_values(options.settings, ("data_dir", "out"))
    if given.is_dir():
        from clothbench.datasets.depth_folder import depth_recording

        with counting("frames") as told:
            path = depth_recording(given, Path(settings.get("out", "recordings")), told)
        print(f"{path}: one recording of kind 'depth'; next: clothbench validate {path}")
        return 0
    with counting("files") as told:
        folder = converted(options.name, **settings, again=True, progress=told)
    print_import(folder)
    return 0


def leaderboard(options: argparse.Namespace) -> int:
    from clothbench.cli.results import print_results
    from clothbench.engine.store import leaderboard_row

    store = results_in(options.out)
    if options.json:
        print_json_rows([leaderboard_row(r) for r in store.rows()])
    elif not print_results(store):
        print(f"no results in {options.out}; make some with: clothbench run +suite=static_dynamic")
    return 0


def compare(options: argparse.Namespace) -> int:
    from clothbench.engine.store import load_rows
    from clothbench.report.gate import compare_rows, markdown, print_gate

    verdict = compare_rows(load_rows(_folder_of(options.base)), load_rows(_folder_of(options.new)))
    if options.json:
        print_json(verdict)
    elif options.markdown:
        print(markdown(verdict), end="")
    else:
        print_gate(verdict)
    return 0 if verdict["passed"] else 1


def history(options: argparse.Namespace) -> int:
    from clothbench.cli.history import history as command

    done = command(options, results_in(options.add, default="") if options.add else None)
    if options.json:
        print_json(done)
    return 0


def bench(options: argparse.Namespace) -> int:
    from clothbench.display.terminal import console
    from clothbench.studies.speed.bench import run_bench
    from clothbench.studies.speed.tables import speed_tables

    def told(line: str) -> None:
        if sys.stderr.isatty():
            print(line, file=sys.stderr)

    rows = run_bench(sides=(9, 21) if options.quick else (9, 21, 41, 65), progress=told)
    if options.json:
        print_json(rows)
        return 0
    for shown in speed_tables(rows):
        console().print(shown)
    return 0


def report(options: argparse.Namespace) -> int:
    from clothbench.report.page import write_page

    place = key_values(options.settings, ("out",)).get("out", DEFAULT_OUT)
    if options.watch:
        from clothbench.engine.bucket import is_address

        if is_address(place):
            raise ClothbenchError(f"{place}: found a bucket, expected a folder: --watch follows a run of this machine")
        return watched(Path(place))
    print(f"page: {write_page(results_in(place).folder)}")
    return 0


def watched(folder: Path) -> int:
    """The page of a folder, in which a run may have yet to begin, followed until Ctrl+C."""
    from clothbench.cli.view import hear_interrupts
    from clothbench.report.page import PAGE
    from clothbench.report.watch import watch

    folder.mkdir(parents=True, exist_ok=True)
    print(f"page: {folder / PAGE}   (open it once: it follows by itself; Ctrl+C ends that)", flush=True)

    def told(page: Path, cells: int) -> None:
        print(f"{page}: {cells} cells", file=sys.stderr, flush=True)

    hear_interrupts()
    with contextlib.suppress(KeyboardInterrupt):
        watch(folder, told)
    return 0


def view(options: argparse.Namespace) -> int:
    from clothbench.cli.view import open_viewer

    return open_viewer(_folder_of(options.out), options.name, options.web)


def export(options: argparse.Namespace) -> int:
    from clothbench.cli.export import export as command

    return command(options.name, options.to, _folder_of(options.runs), options.out)


def submit(options: argparse.Namespace) -> int:
    from clothbench.cli.submissions import submit as command

    return command(options, results_in(options.runs, default="") if options.runs else None)


def verify(options: argparse.Namespace) -> int:
    from clothbench.cli.submissions import verify_all

    return verify_all(options)


def site(options: argparse.Namespace) -> int:
    from clothbench.cli.submissions import site as command

    return command(options.folder, options.out, options.recordings, options.verdicts)


def units(options: argparse.Namespace) -> int:
    from clothbench.cli.units import print_units, unit_rows

    rows = unit_rows(options.name, options.settings)
    print_json(rows) if options.json else print_units(options.name, rows)
    return 0


def presets(options: argparse.Namespace) -> int:
    from clothbench.cli.presets import preset_rows, print_presets

    print_json(preset_rows(options.name)) if options.json else print_presets(options.name)
    return 0


def store(options: argparse.Namespace) -> int:
    from clothbench.cli.store import TASKS

    done = TASKS[options.task](results_in(options.folder, default="", whole=options.task != "check"), options)
    if options.json:
        print_json(done.document)
    else:
        print("\n".join(done.lines))
    return done.code


def new_plugin(options: argparse.Namespace) -> int:
    from clothbench.plugins.scaffold import create

    folder = create(options.kind, options.name, Path(options.into))
    print(f"{folder}: ready; next: pip install -e '{folder}[test]' && pytest {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
