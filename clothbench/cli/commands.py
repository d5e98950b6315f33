"""The command line. Each command imports what it needs when it runs, so that `--help` answers at once."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shlex
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from clothbench.cli.arguments import DEFAULT_OUT, parser
from clothbench.cli.spelling import require_once, unexpected
from clothbench.core.errors import ClothbenchError, nearest, one_line, seen
from clothbench.core.output import kept_on, takes_all_letters

KEEP = {"run", "improve", "suggest"}  # commands that go on where they were stopped
FIT_OF_VIDEO = "tracker=sift_graph model=mass_spring optimizer=ga metric=node_error options.node_error.unit=cm"
FIT_OF_DEPTH = (
    "tracker=depth_mesh model=inextensible optimizer=least_squares metric=relative_error scene.start=measured"
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code. Errors a user can cause are one line on standard error."""
    if isinstance(sys.stdout, TextIOWrapper):  # where not every letter can be written, another stands in its place
        sys.stdout.reconfigure(errors="replace")
    with kept_on():
        return _main(argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    arguments.sort(key=lambda a: a == "--json")  # last: argparse takes no flag between KEY=VALUE words
    for library in ("OPENBLAS", "MKL", "OMP"):  # cores are filled with whole rollouts; threads only get in the way
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))  # a picture's header may claim anything
    try:
        if arguments[:1] == ["run"]:  # Hydra reads the rest
            from clothbench.cli.run import run

            return flushed(run(arguments[1:]))
        options = parsed(arguments)
        return flushed(COMMANDS[options.command](options))
    except ClothbenchError as fault:
        return refused(str(fault), debug)
    except OSError as fault:
        return refused(one_line(f"{fault.filename or 'a file'}: {fault.strerror or fault}"), debug)
    except KeyboardInterrupt:
        kept = "; what is finished is kept, run the same command again to go on" if set(arguments[:1]) & KEEP else ""
        print(f"clothbench: stopped{kept}", file=sys.stderr)
        return 130


def refused(line: str, debug: bool) -> int:
    """Say what is wrong, below its traceback where that was asked for, which changes no exit code; returns it."""
    if debug:
        traceback.print_exc()
    print(f"clothbench: {line}", file=sys.stderr)
    return 2


def flushed(code: int) -> int:
    """The exit code, with all that was printed gone out: that a disk is full shows here at the latest."""
    print(end="", flush=True)
    return code


def parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """The arguments as their command takes them. argparse takes KEY=VALUE words in one go only: those that come after
    an option it leaves over.
    """
    options, over = parser().parse_known_args(arguments)
    if over and (not hasattr(options, "settings") or any(word.startswith("-") for word in over)):
        options.reader.error(f"unrecognized arguments: {' '.join(over)}")
    if hasattr(options, "settings"):
        options.settings = [*options.settings, *over]
        options.reader.require_spelled(options.settings)
    return options


def key_values(settings: Sequence[str], allowed: Sequence[str]) -> dict[str, str]:
    """ "key=value" words as a dictionary; anything else is refused."""
    out = {}
    for word in settings:
        key, sign, value = word.partition("=")
        if not sign or key not in allowed:
            raise unexpected(word, key, allowed)
        out[key] = value
    require_once(settings)
    return out


def results_in(place: str | Path, default: str = DEFAULT_OUT) -> Any:
    """The store in a folder or a bucket; one that was named and holds no results is the user's error."""
    from clothbench.engine.mirror import results_folder
    from clothbench.engine.store import Store, require_results

    folder = results_folder(place)
    return Store(folder if str(place) == default else require_results(folder, place))


def _folder_of(place: str) -> Path:
    """A folder as it was named; the mirror of a bucket, which has to hold results."""
    from clothbench.engine.bucket import is_address

    return results_in(place).folder if is_address(place) else Path(place)


def print_json(document: Any) -> None:
    from clothbench.core.files import json_text

    print(json_text(document, plain=not takes_all_letters()))


def print_json_rows(rows: Sequence[dict[str, Any]]) -> None:
    """The same as `print_json` of rows that hold neither lists nor rows; of very many, several times as fast."""
    plain = not takes_all_letters()
    texts = (json.dumps(row, ensure_ascii=plain, allow_nan=False, separators=(",\n  ", ": ")) for row in rows)
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
    from clothbench.recordings.colour_video import ColourVideo
    from clothbench.recordings.kinds import read_any
    from clothbench.recordings.nodes import find_recordings

    rows = []
    for path in find_recordings(options.paths):
        try:
            recording = read_any(path)
            if isinstance(recording, ColourVideo):  # whose readers take frames as they need them
                for _ in recording.frames():
                    pass
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
    from clothbench.cli.view import ended_in_order

    with ended_in_order():
        return _import(options)


def _import(options: argparse.Namespace) -> int:
    from clothbench.cli.listings import print_import
    from clothbench.datasets.convert import converted
    from clothbench.datasets.registry import DATASETS
    from clothbench.datasets.video_file import SETTINGS, is_video, stated_rate, video_recording
    from clothbench.engine.progress import counting

    given, known = Path(options.name), options.name in DATASETS
    if not (known or os.path.exists(given)):
        names = sorted(DATASETS, key=lambda name: (not DATASETS[name].importer, name))  # recordings come first
        raise ClothbenchError(
            f"{given}: no such file or folder, and no data set {options.name!r}; {nearest(options.name, names)}known: "
            f"{', '.join(names)}"
        )
    if not known and is_video(given):
        settings = key_values(options.settings, SETTINGS)
        with counting("frames") as told:
            path = video_recording(given, settings, told)
        if "rate" in settings and given.is_file() and abs((own := stated_rate(given)) - float(settings["rate"])) > 0.01:
            says = f"rate={settings['rate']} is taken in place of the {own:g} frames a second that {given} states"
            print(f"clothbench: {says}", file=sys.stderr)
        named = shlex.quote(str(path))
        print(f"{path}: one recording of kind 'video'; next: clothbench run recording={named} {FIT_OF_VIDEO}")
        return 0
    settings = key_values(options.settings, ("data_dir", "out"))
    if not known and given.is_dir():
        from clothbench.datasets.depth_folder import depth_recording, notes_in

        with counting("frames") as told:
            path = depth_recording(given, Path(settings.get("out", "recordings")), told)
        if notes := notes_in(given):
            says = f"kept as notes, which neither trackers nor models heed: {', '.join(map(seen, notes))}"
            print(f"clothbench: {given / 'recording.json'}: {says}", file=sys.stderr)
        named = shlex.quote(str(path))
        print(f"{path}: one recording of kind 'depth'; next: clothbench run recording={named} {FIT_OF_DEPTH}")
        return 0
    if known and not DATASETS[options.name].importer:
        return _fetch_originals(options.name, key_values(options.settings, ("data_dir",)))
    with counting("files") as told:
        folder = converted(options.name, **settings, again=True, progress=told)
    print_import(folder)
    return 0


def _fetch_originals(name: str, settings: dict[str, str]) -> int:
    """Of a data set without recordings: its files, checked, and what they are for."""
    from clothbench.datasets.registry import checked_copy, dataset
    from clothbench.engine.progress import counting

    known = dataset(name)
    with counting("files") as told:
        folder = checked_copy(name, settings.get("data_dir"), told)
    count = f"{len(known.files)} file{'s' * (len(known.files) > 1)}"
    print(f"{folder}: {count} of {name}, with the registry's SHA-256; no recordings to be made of them: {known.use}")
    return 0


def leaderboard(options: argparse.Namespace) -> int:
    from clothbench.cli.results import print_results
    from clothbench.engine.leaderboard import leaderboard_row

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
        print(line, file=sys.stderr, flush=True)

    try:
        rows = run_bench(sides=(9, 21) if options.quick else (9, 21, 41, 65), progress=told)
    except KeyboardInterrupt:
        print("clothbench: stopped; a speed is a ratio within one run, so nothing was kept", file=sys.stderr)
        return 130
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
        return watched(place)
    print(f"page: {write_page(results_in(place, default='').folder)}")
    return 0


def watched(place: str) -> int:
    """The page of a folder or a bucket, in which a run may have yet to begin, followed until Ctrl+C."""
    from clothbench.cli.view import hear_interrupts
    from clothbench.core.files import placing
    from clothbench.engine.bucket import is_address
    from clothbench.engine.mirror import results_folder, up_to_date
    from clothbench.engine.store import Store
    from clothbench.report.page import PAGE
    from clothbench.report.watch import EVERY, watch

    folder = results_folder(place, whole=False)
    with placing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = Store(folder)
    print(f"page: {folder / PAGE}   (open it once: it follows by itself; Ctrl+C ends that)", flush=True)

    def told(page: Path, cells: int) -> None:
        print(f"{page}: {cells} cells", file=sys.stderr, flush=True)

    def bring() -> None:
        try:
            up_to_date(store)
        except ClothbenchError as fault:  # a network that is away for a while ends no watch
            print(f"clothbench: {fault}", file=sys.stderr, flush=True)

    hear_interrupts()
    with contextlib.suppress(KeyboardInterrupt):
        watch(folder, told, bring, every=5 * EVERY if is_address(place) else EVERY)
    return 0


def view(options: argparse.Namespace) -> int:
    from clothbench.cli.view import open_viewer

    return open_viewer(_folder_of(options.out), options.name, options.web)


def export(options: argparse.Namespace) -> int:
    from clothbench.cli.export import export as command

    return command(options.name, options.to, _folder_of(options.runs), options.out, options.recordings)


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
    from clothbench.cli.store import TASKS, store_in

    done = TASKS[options.task](store_in(options.folder, whole=options.task != "check"), options)
    if options.json:
        print_json(done.document)
    else:
        print("\n".join(done.lines))
    return done.code


def new_plugin(options: argparse.Namespace) -> int:
    from clothbench.plugins.scaffold import create

    folder = create(options.kind, options.name, Path(options.into))
    install, test = shlex.quote(f"{folder}[test]"), shlex.quote(str(folder))
    print(f"{folder}: ready; next: pip install -e {install} && pytest {test}")
    return 0


COMMANDS: Mapping[str, Callable[[argparse.Namespace], int]] = {
    "improve": improve, "suggest": suggest, "plugins": plugins, "validate": validate, "datasets": datasets,
    "import": import_data, "leaderboard": leaderboard, "compare": compare, "history": history, "bench": bench,
    "report": report, "view": view, "export": export, "units": units, "presets": presets, "submit": submit,
    "verify": verify, "site": site, "store": store, "new-plugin": new_plugin,
}  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
