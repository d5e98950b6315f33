"""What each command of the command line may be told."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clothbench.cli.spelling import Reader
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import require_folder

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
exit codes: 0 done; 1 some cells failed or the gate is broken; 2 wrong use or bad input; 130 stopped with Ctrl+C"""


def parser() -> Reader:
    """Of all commands; what is parsed says in `command` which one it is, and has its own parser as `reader`."""
    out = Reader(
        prog="clothbench", epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Which cloth model to trust, with which parameters, and what it still gets wrong.",
    )  # fmt: skip
    from clothbench import __version__

    out.add_argument("--version", action="version", version=f"clothbench {__version__}")
    out.add_argument("--debug", action="store_true", help="show the traceback of an error, too")
    commands = out.add_subparsers(metavar="COMMAND", required=True)
    commands.add_parser(
        "run", help="run a suite, a sweep or one cell (Hydra overrides; `run --help` shows all settings)"
    )
    _add(commands, "improve", "find what a calibrated model lacks, and add it", _improve, _json)
    _add(commands, "suggest", "which next experiment would tell most", _suggest, _json)
    _add(commands, "plugins", "every plugin, with parameters and units; broken ones with the reason", _json)
    _add(commands, "validate", "check recordings; exit 1 if one is bad", _paths, _json)
    _add(commands, "datasets", "known public data sets, their licence, and whether they are at hand", _json)
    _add(commands, "import", "convert a public data set into recordings", _import)
    _add(commands, "leaderboard", "all results so far", _store, _json)
    _add(commands, "compare", "exit 1 if NEW is worse than BASE beyond the noise", _compare)
    _add(commands, "history", "error and speed of every model against commit, and where they changed",
         _history, _json)  # fmt: skip
    _add(commands, "bench", "speed of every model beside the installed peers", _bench, _json)
    _add(commands, "report", "one self-contained page with figures", _report)
    _add(commands, "view", "open a fit in Rerun, recording beside rollout", _view)
    _add(commands, "export", "a calibrated cloth as a file that another simulator loads", _export)
    _add(commands, "units", "a simulator's parameters: as documented, and as measured by mechanics", _units, _json)
    _add(commands, "presets", "what measured fabrics are like, with spread and source", _presets, _json)
    _add(commands, "submit", "score what another simulator moved, for others to check", _submit)
    _add(commands, "verify", "compute the scores of submissions again; exit 1 if one does not stand", _verify)
    _add(commands, "site", "a leaderboard of submissions as a static site; all of them are verified first", _site)
    _store_commands(commands)
    _add(commands, "new-plugin", "start a plugin distribution with a passing conformance test", _new)
    return out


def _add(commands: Any, name: str, text: str, *extras: Callable) -> None:
    sub = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    sub.set_defaults(command=name, reader=sub)
    for extra in extras:
        extra(sub)


def _store_commands(commands: Any) -> None:
    text = "care of a results folder: check it, merge it into another, prune it"
    sub = commands.add_parser("store", help=text, description=f"{text[0].upper()}{text[1:]}.")
    tasks = sub.add_subparsers(metavar="TASK", required=True)
    _add(tasks, "check", "read every file; one line per fault, exit 1 if there is one", _folder, _json)
    _add(tasks, "merge", "take cells from another results folder; exit 1 if two disagree", _merge, _json)
    _add(tasks, "prune", "remove what stopped runs left, and cells that are asked for", _folder, _prune, _json)
    for task in ("check", "merge", "prune"):
        tasks.choices[task].set_defaults(command="store", task=task)


def _folder(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", metavar="FOLDER", help="results folder, or s3://BUCKET/PREFIX")


def _merge(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", metavar="FROM", help="results folder to take cells from; it stays as it is")
    sub.add_argument("into", metavar="INTO", help="results folder to put them into; nothing finished is replaced there")


def _prune(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--dry-run", action="store_true", help="say what would be removed, and remove nothing")
    sub.add_argument(
        "--older", type=_span("store prune: --older", "days"), default=1.0, metavar="DAYS",
        help="age from which on what stopped runs left is removed (default: 1)",
    )  # fmt: skip
    sub.add_argument(
        "--other-versions", action="store_true", help="cells of plugins in another version than the installed one, too"
    )
    sub.add_argument(
        "--cell", action="append", default=[], metavar="KEY",
        help="this cell, too, finished or not: its whole key, as clothbench leaderboard --json has it",
    )  # fmt: skip


def _span(word: str, unit: str, above: bool = False) -> Callable[[str], float]:
    """Reads a time. A negative age would take away what runs under way are at; what is no number would end nothing.
    above: whether 0 is none, as it is no limit.
    """

    def read(text: str) -> float:
        try:
            span = float(text)
        except ValueError:
            span = math.nan
        if not (math.isfinite(span) and (span > 0 if above else span >= 0)):
            least = "above 0" if above else "at least 0"
            raise ClothbenchError(f"{word} is {text!r}, expected {unit}, a number, {least}")
        return span

    return read


def _json(sub: argparse._ActionsContainer) -> None:
    sub.add_argument("--json", action="store_true", help="one JSON document on standard output")


def _paths(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("paths", nargs="+", metavar="PATH", help="recording (.nc) or folder")


def _store(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--out", "--runs", default=DEFAULT_OUT, help="results folder, or s3://BUCKET/PREFIX (default: runs)"
    )


def _recordings(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--recordings", nargs="+", default=["builtin:static_dynamic"], metavar="PATH",
        help="what was measured: .nc files or folders (default: builtin:static_dynamic)",
    )  # fmt: skip


def _submit(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", type=_local, help="of simulated recordings: copies of the measured ones' files (kind "
                     "nodes) with the simulated `position`")  # fmt: skip
    _recordings(sub)
    sub.add_argument("--name", required=True, help="what the model is called on the leaderboard")
    sub.add_argument("--by", default="", help="who hands it in")
    sub.add_argument("--about", default="", help="one line about the model")
    sub.add_argument("--suite", help="what its rows are grouped by (default: what --recordings are called)")
    sub.add_argument(
        "--metric", nargs="+", help="that scores it (default: node_error); not with --runs, whose fits have theirs"
    )
    sub.add_argument("--runs", metavar="RUNS", help="pack the calibrations of a results folder into FOLDER")
    sub.add_argument(
        "--wheel", nargs="+", type=Path, metavar="FILE", help="with --runs: the distribution that the plugins come from"
    )


def _verify(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folders", nargs="+", type=_local, metavar="FOLDER", help="a submission")
    _recordings(sub)
    sub.add_argument("--out", type=_local, help="results folder that takes what stands")
    sub.add_argument("--reproduce", action="store_true", help="run random cells of it again, with its own wheels")
    sub.add_argument(
        "--held-out", nargs="+", metavar="PATH", help="refit it, and score it, on recordings that were never published"
    )
    sub.add_argument(
        "--run-their-code", action="store_true",
        help="needed by both: they run the submitter's plugin with your rights",
    )  # fmt: skip
    sub.add_argument("--cells", type=_count, metavar="N", help="cells to run again (default: 2)")
    sub.add_argument("--seed", type=int, metavar="N", help="of their choice (default: drawn now, and told)")
    sub.add_argument(
        "--time-limit", type=_span("verify: --time-limit", "seconds", above=True), metavar="S",
        help="s that one fit may take (default: 3600)",
    )  # fmt: skip
    sub.add_argument(
        "--verdicts", type=_local, metavar="FOLDER",
        help="with --reproduce or --held-out: keep what they find here, for `clothbench site`; with --out: the grade "
        "that was found before",
    )  # fmt: skip


def _site(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", type=_local, metavar="FOLDER", help="with a folder for each submission")
    _recordings(sub)
    sub.add_argument(
        "--out", type=_local, required=True, metavar="FOLDER", help="that takes index.html and submissions/"
    )
    sub.add_argument(
        "--verdicts", type=_local, metavar="FOLDER",
        help="of `clothbench verify --verdicts`: grades that took running a plugin",
    )  # fmt: skip


def _local(text: str) -> Path:
    """A folder of this machine, by its name: of an address a path would drop a slash."""
    require_folder(text)
    return Path(text)


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
        "[areal_density=KG_PER_M2] [executor=dask|ray|slurm]; besides recording=FILE damping=EFFECT "
        "options.PLUGIN.NAME=… bounds.PARAMETER=[LOW,HIGH] data_dir=DIR jobs=N optimizer=NAME prior=CLASS rerun=false "
        "scene.NAME=… timeout=S tracker=NAME, as docs/improve.md and run --help have them",
    )  # fmt: skip


def _suggest(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name", metavar="RECORDINGS|CELL",
        help="a recording or a folder of them, with model=NAME; or a cell, a case or a recording of a run as in `view`",
    )  # fmt: skip
    sub.add_argument(
        "settings", nargs="*", default=[], metavar="KEY=VALUE",
        help="model=NAME [out=DIR] [effects=NAME,…] [tied=ONE,OTHER] [verdict=FOLDER of improve] "
        "[rank=information|tie|PARAMETER] [max_speed=M/S] [max_acceleration=M/S²] [reach=M] [durations=S,…] "
        "[grips=NAME,…] [cameras=all|NAME,…] [camera.kind=colour|depth] [draws=N] [best=N], "
        "and what improve takes of recordings and models; of a cell, recordings=PATH if they were moved",
    )  # fmt: skip
    sub.add_argument("--runs", default=DEFAULT_OUT, metavar="FOLDER", help="results folder of a cell (default: runs)")


def _compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("base", metavar="BASE", help="results folder or leaderboard .json to hold against")
    sub.add_argument("new", metavar="NEW", help="results folder or leaderboard .json to judge")
    either = sub.add_mutually_exclusive_group()
    either.add_argument("--markdown", action="store_true", help="as Markdown, for a comment on a pull request")
    _json(either)


def _history(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "folder", nargs="?", type=Path, metavar="FOLDER", help="of entries, one for each commit and machine"
    )
    sub.add_argument("--add", metavar="RUNS", help="a results folder, which becomes an entry of FOLDER first")
    sub.add_argument("--commit", help="with --add: that RUNS are of, in the repository here (default: HEAD)")
    sub.add_argument(
        "--git", type=Path, metavar="FILE",
        help="instead of FOLDER: a leaderboard .json that is committed, at every commit that changed it",
    )  # fmt: skip
    sub.add_argument("--machine", metavar="NAME", help="with --git: what all of that was computed on (else not known)")
    sub.add_argument("--page", type=Path, metavar="FILE", help="write a self-contained page, too")


def _bench(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--quick", action="store_true", help="the two smaller sheets only: some two minutes on two cores")


def _report(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="out=FOLDER with the results (default: runs)")
    sub.add_argument("--watch", action="store_true", help="follow a run: the page refreshes itself while cells finish")


def _view(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name", metavar="CELL|CASE|RECORDING",
        help="the name of a case or recording, as page and leaderboard show them, or the key of a cell, or its "
        "beginning (a name goes first), as clothbench leaderboard --json has it; of `improve`, a recording's name",
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
    sub.add_argument(
        "--recordings",
        nargs="+",
        default=[],
        metavar="PATH",
        help="where the cell's recordings lie, if they were moved",
    )


def _units(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "name", metavar="MODEL", help="mujoco, newton, or any model that knows materials; usd or ppf, as documented"
    )
    sub.add_argument(
        "settings", nargs="*", default=[], metavar="OPTION=VALUE", help="options of the model, for example solver=vbd"
    )


def _presets(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("name", nargs="?", metavar="NAME", help="a class of fabrics (default: all)")


def _new(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("kind", choices=("model", "effect", "metric", "optimizer", "tracker"))
    sub.add_argument("name", metavar="NAME", help="the plugin's name, an identifier")
    sub.add_argument("--into", default=".", metavar="FOLDER", help="where to put it (default: here)")
