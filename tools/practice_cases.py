"""Verdicts on folders of recordings whose secrets somebody knows: `python tools/practice_cases.py CASES --out FOLDER`.

CASES holds a folder of node recordings for each case, and may hold an `answers.json` that says what is in them
({"cases": {NAME: {"effects": [{"name": …}]}}}). Each case is judged with each of the models; several at once are joined
by a plus (`--models mass_spring mass_spring+baraff_witkin`). A verdict that stands in FOLDER is not asked for again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from blind_test import mm


def verdict_on(case: Path, models: str, out: Path) -> dict:
    """What `clothbench improve` says of one case."""
    names = models.split("+")
    asked = f"model={names[0]}" if len(names) == 1 else f"model=[{','.join(names)}]"
    words = ["improve", f"recordings={case}", asked, f"out={out}", "rerun=false"]
    done = subprocess.run([sys.executable, "-m", "clothbench", *words], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{case.name}, {models}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads((out / "verdict.json").read_text())


def line(case: str, planted: str, models: str, found: dict) -> str:
    """A row of the table."""
    errors = found["error_mm"]
    named = "; ".join(" or ".join([e["name"], *e["tied_with"]]) for e in found["effects"])
    chance = max((e["p_value"] for e in found["effects"]), default=None)
    cells = [
        case, planted, models.replace("+", " and "), found["verdict"], named, "" if chance is None else f"{chance:.3g}",
        *(f"{mm(errors['held_out'][when])} mm" for when in ("before", "after")),
        *(f"{mm(errors[part])} mm" for part in ("noise", "mesh")), f"{found['wall_s']:.0f} s",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="Judge cases with models, and print the table.")
    parser.add_argument("cases", type=Path, help="folder with a folder of recordings for each case")
    parser.add_argument("--out", type=Path, required=True, help="folder for the verdicts; kept, so resumable")
    parser.add_argument("--models", nargs="+", default=["mass_spring"], help="models; several at once with a plus")
    options = parser.parse_args()
    answers = options.cases / "answers.json"
    known = json.loads(answers.read_text())["cases"] if answers.is_file() else {}
    print("| case | planted | judged with | verdict | named | p | held out: before | after | noise | mesh | time |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for models in options.models:
        for case in sorted(path for path in options.cases.iterdir() if path.is_dir()):
            planted = " and ".join(e["name"] for e in known[case.name]["effects"]) if case.name in known else "?"
            found = verdict_on(case, models, options.out / f"{case.name}-{models}")
            print(line(case.name, planted or "nothing", models, found), flush=True)


if __name__ == "__main__":
    main()
