"""Verdicts on folders of recordings whose secrets somebody knows: `python tools/practice_cases.py CASES --out FOLDER`.

CASES holds a folder of node recordings for each case, and may hold an `answers.json` that says what is in them
({"cases": {NAME: {"effects": [{"name": …}]}}}). Each case is judged with each of the models; several at once are joined
by a plus (`--models mass_spring mass_spring+baraff_witkin`). A verdict that stands in FOLDER is not asked for again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from blind_test import mm, verdict_on


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
        asked = f"[{models.replace('+', ',')}]" if "+" in models else models
        for case in sorted(path for path in options.cases.iterdir() if path.is_dir()):
            planted = " and ".join(e["name"] for e in known[case.name]["effects"]) if case.name in known else "?"
            out = options.out / f"{case.name}-{models}"
            found = verdict_on(f"{case.name}, {models}", case, asked, out, "rerun=false")
            print(line(case.name, planted or "nothing", models, found), flush=True)


if __name__ == "__main__":
    main()
