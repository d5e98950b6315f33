"""`clothbench suggest`: which next experiment would tell most, and a motion file that a robot can run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from clothbench.cli.improve import WORDS as RECORDING_WORDS
from clothbench.cli.improve import StageBar, settings_of
from clothbench.cli.spelling import require_once
from clothbench.cli.view import find_cell
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import json_text
from clothbench.core.output import takes_all_letters
from clothbench.core.parallel import set_thread_count
from clothbench.display.terminal import console
from clothbench.plugins.discovery import Catalogue, catalogue
from clothbench.studies.calibration.moved import hashes
from clothbench.studies.improve.document import VERDICT
from clothbench.studies.improve.plan import NOT_ASKED as REFUSED
from clothbench.studies.improve.problem import Problem
from clothbench.suggest.document import CAMERA, DOCUMENT, MOTION, suggestion, write_all
from clothbench.suggest.experiments import Experiment, experiments
from clothbench.suggest.ranking import promises, rank_of, ranked, require_rank
from clothbench.suggest.settings import DEPTH, TIE, WORDS, Wanted, as_recorded, wanted_of
from clothbench.suggest.source import problem_of_cell, problem_of_settings, require_same, settings_in, verdict_in
from clothbench.suggest.subject import first_case, rate_of, sensor_of, subject_of

OUT = "suggest"
MOVED = "recordings"  # beside a cell: where its recordings lie, if they were moved
OWN = (*WORDS, "effects", "tied", "verdict", MOVED)
NOT_ASKED = ("recordings", "candidates", "rerun", "executor", "jobs")  # words of improve that mean nothing here
OF_RECORDINGS = tuple(word for word in RECORDING_WORDS if word not in NOT_ASKED)
SHOWN = 10  # lines of the table
WIDENS = "*"  # marks what makes the intervals wider

# Recordings with a model, its effects beyond the base, pairs of tied ones, and the values of a fit that is known.
Question = tuple[Problem, tuple[str, ...], Sequence[tuple[str, str]], Mapping[str, float] | None]


def command(name: str, words: Sequence[str], runs: Path, as_json: bool = False) -> int:
    """Rank experiments for recordings (a file, a folder) or a cell of a run; prints and writes what was found."""
    given = told(words)
    wanted, out = wanted_of(given), Path(given.get("out", OUT))
    plugins = catalogue()
    set_thread_count(0)
    with StageBar() as bar:
        question = asked(name, given, runs, out, plugins)
        wanted = as_recorded(wanted, given, sensor_of(question[0]))
        chosen = possible(question, wanted)
        bar.stage("fit", 0, 1)
        subject = subject_of(*question)
        rank_of(subject, wanted.rank)  # the parameters may be those of a rival that fits better
        found, left = promises(subject, chosen, wanted, bar.stage)
    if not found:
        raise ClothbenchError(f"no experiment can be simulated: {left[0].grips}, {left[0].motion}: {left[0].reason}")
    found = ranked(subject, found, wanted.rank)
    document = suggestion(subject, found, left, wanted)
    write_all(out, subject, found, document, wanted.camera)
    print(json_text(document, plain=not takes_all_letters())) if as_json else say(document, out)
    return 0


def possible(question: Question, wanted: Wanted) -> list[Experiment]:
    """The experiments to choose from; a wrong word comes to light here, before anything is fitted."""
    problem, effects, tied, _ = question
    swapped = [tuple(other if name == one else name for name in effects) for one, other in tied]
    names = [name for some in (effects, *swapped) for name in problem.space(some).names]
    require_rank(wanted.rank, list(dict.fromkeys(names)), bool(tied))
    like, model = first_case(problem), problem.plugins.load("models", problem.model)
    chosen = list(experiments(like.scene, rate_of(like), wanted, "contact" in model.capabilities))
    if not chosen:
        raise ClothbenchError(
            "found no motion that a robot with these limits can do; raise max_speed, max_acceleration or reach"
        )
    return chosen


def told(words: Sequence[str]) -> dict[str, str]:
    """KEY=VALUE words by key; one that means nothing here is refused."""
    out = {}
    for word in words:
        key, sign, value = word.partition("=")
        if not sign or key.partition(".")[0] not in (*OWN, *OF_RECORDINGS):
            known = sorted({*OWN, *OF_RECORDINGS} - set(REFUSED))
            raise ClothbenchError(f"found {word!r}, expected {' or '.join(f'{a}=VALUE' for a in known)}")
        out[key] = value
    require_once(words)
    return out


def asked(name: str, given: Mapping[str, str], runs: Path, out: Path, plugins: Catalogue) -> Question:
    """What is asked about; nothing is fitted yet."""
    place = Path(name)
    if (place / VERDICT).is_file():
        raise ClothbenchError(f"{name}: found a verdict of improve; give RECORDINGS model=NAME verdict={name}")
    if not (place.exists() or ":" in name):
        return of_cell(name, given, runs, plugins)
    if MOVED in given:
        raise ClothbenchError(f"found {MOVED}={given[MOVED]} beside {name}, which names them; leave one of them out")
    if place.is_dir() and out.resolve().is_relative_to(place.resolve()):
        raise ClothbenchError(
            f"out={out} lies in {name}, where what is only expected would be taken for recordings; give another out="
        )
    document = verdict_in(Path(given["verdict"])) if "verdict" in given else None
    problem = of_recordings(name, given, document, out, plugins)
    names, tied = effects_of(given, problem, plugins)
    if document is None:
        return problem, names, tied, None
    require_same(problem, document, Path(given["verdict"]))
    if names:
        raise ClothbenchError("found effects= or tied= beside verdict=, which names them; leave one of them out")
    named = tuple(effect["name"] for effect in document["effects"])
    tied = [(effect["name"], other) for effect in document["effects"] for other in effect["tied_with"]]
    values = {n: p["value"] for n, p in document["parameters"].items()}
    if document.get("models") and (more := sorted(set(values) - set(problem.space(named).names))):
        raise ClothbenchError(
            f"{given['verdict']}: found a verdict on several models, with parameters of a fit with more effects than "
            f"it names ({more[0]}); give that of improve with model={document['model']} alone"
        )
    return problem, named, tied, values


def of_recordings(
    name: str, given: Mapping[str, str], document: Mapping[str, Any] | None, out: Path, plugins: Catalogue
) -> Problem:
    words = {key: value for key, value in given.items() if key.partition(".")[0] in OF_RECORDINGS}
    words |= {"recordings": name, "out": str(out)}
    if document is not None and "prior" in words:
        raise ClothbenchError("found prior= beside verdict=, whose search is done; leave one of them out")
    if document is not None:
        for key, value in (("model", document["model"]), ("base", ",".join(document["base"]))):
            if words.setdefault(key, value) != value:
                raise ClothbenchError(f"found {key}={words[key]}, and a verdict on {value or 'none'}; leave {key}= out")
        words = settings_in(document) | words
    if "model" not in words:
        raise ClothbenchError("found no model=…, expected clothbench suggest RECORDINGS model=NAME")
    return problem_of_settings(settings_of([f"{key}={value}" for key, value in words.items()]), plugins, out)


def of_cell(name: str, given: Mapping[str, str], runs: Path, plugins: Catalogue) -> Question:
    """A cell, a case or a recording of a run, as it was fitted there."""
    try:
        key = find_cell(runs, name).name
    except ClothbenchError as fault:
        raise ClothbenchError(f"{name}: no such file or folder, and {fault}") from None
    if strays := [key for key in given if key.partition(".")[0] not in (*WORDS, "out", MOVED)]:
        raise ClothbenchError(f"{name}: of a cell of {runs} everything is known: leave {strays[0]}= out")
    problem, values = problem_of_cell(runs, key, plugins, hashes([given[MOVED]] if MOVED in given else []))
    return problem, (), (), values


def effects_of(
    given: Mapping[str, str], problem: Problem, plugins: Catalogue
) -> tuple[tuple[str, ...], list[tuple[str, str]]]:
    """The effects beyond the base, with the first of those that are tied; and the pairs of that one and each other."""
    listed = {key: [n.strip() for n in given.get(key, "").split(",") if n.strip()] for key in ("effects", "tied")}
    if "tied" in given and len(set(listed["tied"])) < 2:
        raise ClothbenchError(f"setting 'tied' is {given['tied']!r}, expected two effects or more, as tied=ONE,OTHER")
    for effect in (*listed["effects"], *listed["tied"]):
        plugins.find("effects", effect)
        if effect in problem.base:
            raise ClothbenchError(f"effect {effect!r} is in the base already; state base= without it")
    both = set(listed["effects"]) & set(listed["tied"])
    if both:
        raise ClothbenchError(f"effect {both.pop()!r} is named with effects= and with tied=; leave one of them out")
    names = (*dict.fromkeys(listed["effects"]), *listed["tied"][:1])
    return names, [(listed["tied"][0], other) for other in listed["tied"][1:]]


def say(found: Mapping[str, Any], out: Path) -> None:
    """What is open, and the experiments that would tell most."""
    show = console()
    noise = "" if found["noise_mm"] is None else f", its noise {size(found['noise_mm'])} mm"
    count = len(found["recordings"]["fit"])
    show.print(
        f"{' + '.join((found['model'], *found['base'], *found['effects']))} on {count} "
        f"recording{'s' if count > 1 else ''}: leaves {size(found['left_mm'])} mm{noise}; "
        f"a coordinate counts as {size(found['counted_mm'])} mm",
        soft_wrap=True,
    )
    for name, p in found["parameters"].items():
        open_ = "" if p["determined"] else "   not determined" + (", at its bound" if p["at_bound"] else "")
        show.print(f"  {name} = {p['value']:.3g} {p['unit']} ({p['low']:.3g} … {p['high']:.3g}){open_}", soft_wrap=True)
    for tie in found["ties"]:
        show.print(f"  {tie['one']} and {tie['other']}: {apart_now(tie)}", soft_wrap=True)
    if found["settings"]["cameras"]:
        camera = found["settings"]["camera"]
        depth = f" and {1e3 * camera['depth_noise']:g} mm at 1 m" if camera["kind"] == DEPTH else ""
        show.print(
            f"seen by one {camera['kind']} camera: {' x '.join(map(str, camera['size']))} px, "
            f"{camera['field_of_view']:.3g}° across, noise {camera['noise']:.2g} px{depth}",
            soft_wrap=True,
        )
    show.print(table(found))
    if any(one["widens"] for one in found["experiments"][:SHOWN]):
        show.print(f"{WIDENS} the intervals, multiplied, get no narrower: the mesh errs there by more than it tells")
    for one in found["left_out"]:
        show.print(f"left out: {one['grips']}: {one['motion']}: {one['reason']}", soft_wrap=True)
    camera = f", {CAMERA} beside it," if found["settings"]["cameras"] else ""
    print(f"motions: {out / 'experiments'}/1/{MOTION}{camera} and so on; all of it: {out / DOCUMENT}")


def size(millimetres: float) -> str:
    """Two digits, and all before the point."""
    return f"{millimetres:.2g}" if millimetres < 99.5 else f"{millimetres:.0f}"


def apart_now(tie: Mapping[str, Any]) -> str:
    """How far apart the two are in the recordings that there are, and which fits better."""
    if tie["sigma_other_better"] > 0:
        return f"{tie['other']} fits better by {tie['sigma_other_better']:.1f} σ now"
    return f"{tie['sigma_now']:.1f} σ apart now"


def table(found: Mapping[str, Any]) -> Table:
    """One line for each experiment, the best first."""
    ties, names = found["ties"], list(found["parameters"])
    by = f"{found['rank']} of two" if found["rank"] == TIE else found["rank"]
    out = Table(title=f"experiments by {by}", title_justify="left", title_style="bold")
    for head in ("", "grips", "motion"):
        out.add_column(head)
    if found["settings"]["cameras"]:
        out.add_column("camera", no_wrap=True)
        out.add_column("sees", justify="right", no_wrap=True)
    out.add_column("s", justify="right")
    for tie in ties:
        out.add_column(f"{tie['one']} |\n{tie['other']}", justify="right", overflow="fold")
    out.add_column("nats", justify="right")
    for name in names:
        out.add_column(name.replace(".", ".\n"), justify="right", overflow="fold")
    for one in found["experiments"][:SHOWN]:
        out.add_row(
            str(one["rank"]), one["grips"], one["motion"],
            *(text for best in one["cameras"][:1] for text in (best["name"], f"{100 * best['points_seen']:.0f} %")),
            f"{one['duration_s']:g}",
            *(f"{tie['sigma']:.1f} σ (≥ {tie['sigma_least']:.1f})" for tie in one["ties"]),
            f"{one['information_nats']:.1f}{WIDENS if one['widens'] else ''}",
            *(f"÷ {one['parameters'][name]['factor']:.2g}" for name in names),
        )  # fmt: skip
    return out
