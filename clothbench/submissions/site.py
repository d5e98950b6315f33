"""A leaderboard as a static site, from a folder of submissions: an index and a page for each; works from a disk."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_name, whole_files
from clothbench.display.answer import Card, answer
from clothbench.display.html import below, group, interval, table, text
from clothbench.display.page import whole_page
from clothbench.display.section import Section
from clothbench.engine.system import now
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording
from clothbench.submissions.kept import rows_of
from clothbench.submissions.submission import FILE
from clothbench.submissions.verdicts import Verdict, find_verdict
from clothbench.submissions.verification import GRADE, REFUSED, REPRODUCED, VERIFIED, Verified, verify

GRADES = """<h2>What the grades say</h2><dl>
<dt>recomputed</dt><dd>Every score was computed here, from the positions that were handed in, and these can be of the
recordings. Who or what made them is not known.</dd>
<dt>reproduced</dt><dd>Moreover the plugin was handed in, and the fit was done again with it, within the noise. A mean
is reproduced if all its fits are.</dd>
<dt>verified</dt><dd>The plugin was fitted here, with the settings handed in, and scored on recordings that were never
published.</dd></dl>
<p>Every score has a grade of its own. A submission as a whole is reproduced if fits that were chosen afterwards at
random are, and verified if it has been scored on unpublished recordings besides.</p>"""
USUAL = "node_error"  # what places go by where all have it
PAGES = "submissions"  # folder of the site
NAMED = 6  # recordings of a table that are listed
FIRST = {VERIFIED: 0, REPRODUCED: 1, GRADE: 2}


@dataclass(frozen=True)
class Standing:
    """A submission on the site. reason: why it does not stand, "" if it does; found and verdict: None where there are
    none.
    """

    folder: Path
    found: Verified | None
    verdict: Verdict | None
    reason: str = ""

    @property
    def grade(self) -> str:
        """Of the submission as a whole."""
        if self.reason:
            return REFUSED
        return self.verdict.grade if self.verdict else GRADE

    def grade_of(self, cells: Iterable[str]) -> str:
        """Of a row about these fits, on recordings that are published."""
        return self.verdict.grade_of(cells) if self.verdict else GRADE

    @property
    def name(self) -> str:
        return self.found.submission.name if self.found else self.folder.name

    @property
    def page(self) -> str:
        return f"{PAGES}/{file_name(self.folder.name)}.html"


def write_site(
    folder: Path, out: Path, measured: Sequence[Recording], verdicts: Path | None, plugins: Catalogue
) -> list[Standing]:
    """Verify every submission in a folder, and write OUT/index.html and a page for each of them."""
    found = sorted(path.parent for path in folder.glob(f"*/{FILE}"))
    if not found:
        raise ClothbenchError(f"{folder}: found no submissions, expected folders with a {FILE} in them")
    standings = _without_copies([_standing(one, measured, verdicts, plugins) for one in found])
    pages = {one.page: _page(one) for one in standings} | {"index.html": _index(standings)}
    if len(pages) != len(standings) + 1:
        raise ClothbenchError(f"{folder}: found folders whose pages would have one name; rename one of them")
    with whole_files(out, instead_of=[f"{PAGES}/*.html"]) as part:
        (part / PAGES).mkdir()
        for name, html in pages.items():
            (part / name).write_text(html, encoding="utf-8")
    return standings


def _standing(folder: Path, measured: Sequence[Recording], verdicts: Path | None, plugins: Catalogue) -> Standing:
    try:
        found = verify(folder, measured, plugins)
    except (ClothbenchError, OSError) as fault:  # whatever its files are, the others are shown
        return Standing(folder, None, None, _without(folder, str(fault)))
    if found.faults:
        return Standing(folder, found, None, _without(folder, "; ".join(found.faults)))
    verdict = find_verdict(verdicts, folder)
    faults = verdict.faults.values() if verdict else ()
    return Standing(folder, found, verdict, "; ".join(fault for said in faults for fault in said))


def _without_copies(standings: Sequence[Standing]) -> list[Standing]:
    """The same, with those refused that hold the very positions of another: the better grade stands, and of equal ones
    the first.
    """
    first: dict[frozenset[str], Standing] = {}
    for one in sorted((s for s in standings if not s.reason), key=lambda s: FIRST[s.grade]):
        first.setdefault(_positions(one), one)
    return [
        one
        if one.reason or (other := first[_positions(one)]) is one
        else dataclasses.replace(one, reason=f"holds the same positions as {other.folder.name}")
        for one in standings
    ]


def _positions(standing: Standing) -> frozenset[str]:
    """What tells the positions that were handed in from others."""
    assert standing.found is not None  # it stands
    return frozenset(entry.sha256 for entry in standing.found.submission.entries)


def _without(folder: Path, said: str) -> str:
    """A fault without where the folder lies on the machine that made the site."""
    return said.replace(f"{folder}/", "").replace(str(folder), folder.name)


def _index(standings: Sequence[Standing]) -> str:
    good = sorted((s for s in standings if not s.reason), key=lambda s: (FIRST[s.grade], s.name))
    bad = [s for s in standings if s.reason]
    cards = [Card(grade, str(sum(s.grade == grade for s in good)), "submissions") for grade in FIRST]
    cards.append(Card("refused", str(len(bad)), "do not stand as handed in", good=False if bad else None))
    top = f"<h1>Leaderboard of submissions</h1><p class='soft'>made {text(now()[:16].replace('T', ' '))} UTC</p>"
    lead = f"{len(standings)} submissions; every score below was computed here, and has a grade of its own."
    sections = [Section(top + answer("Who stands, and how sure is it?", lead, cards))]
    boards = group_of([(s, row) for s in good for row in means(s)])
    several = Counter((suite, split) for suite, split, _ in boards)
    for (suite, split, names), mine in boards.items():
        apart = several[suite, split] > 1
        words = (
            suite,
            split.replace("_", " "),
            f"{len(names)} recording{'s' if len(names) > 1 else ''}" if apart else "",
        )
        over = f"<p class='soft'>{text(_over(names))}</p>" if apart else ""
        sections.append(Section(f"<h2>{text(' · '.join(filter(None, words)))}</h2>{over}{_board(mine)}"))
    if bad:
        items = "".join(f'<li><a href="{text(s.page)}">{text(s.name)}</a>: {text(s.reason)}</li>' for s in bad)
        sections.append(Section(f'<h2>Refused</h2><div class="failures" role="note"><ul>{items}</ul></div>'))
    return whole_page("leaderboard of submissions", [*sections, Section(GRADES)])


def _over(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"Over {', '.join(names[:NAMED])}{more}; not ranked with means over other recordings."


def means(standing: Standing) -> list[dict[str, Any]]:
    """The means of a submission over its recordings, and over unpublished ones, each with its grade; `over`: names of
    the recordings, none where they were never published; `as_filed`: whether these are what their files state.
    """
    assert standing.found is not None  # it stands
    found, out = standing.found.found, []
    for row in rows_of(found):
        if row["recording"] is None:
            mine = [one for one in found if one.split == row["split"]]
            cells = {one.cell for one in mine}
            again = sum(standing.grade_of([cell]) == REPRODUCED for cell in cells)
            said = [f"{again} of {len(cells)} fits reproduced"] if 0 < again < len(cells) else []
            if names := {one.measured.name for one in mine if one.against_file}:
                how = "fitted to {} that are held out" if row["split"] == "fit" else "holds out {} that are to fit"
                said.append(f"{how.format(len(names))} by their files")
            over = tuple(sorted({one.measured.name for one in mine if row["metric"] in one.scores}))
            filed = {one.measured.name for one in found if one.measured.split == row["split"]}
            more = {"over": over, "as_filed": set(over) == filed, "said": "; ".join(said)}
            out.append({**row, **more, "grade": standing.grade_of(cells)})
    secret = standing.verdict.unpublished if standing.verdict else ()
    hidden = {"split": "unpublished", "grade": VERIFIED, "said": "", "over": (), "as_filed": True}
    return [*out, *({**row, **hidden} for row in secret)]


def group_of(
    rows: Sequence[tuple[Standing, dict[str, Any]]],
) -> dict[tuple[str, str, tuple[str, ...]], list[tuple[Standing, dict[str, Any]]]]:
    """By suite, split and recordings: means over other recordings say nothing about which model is better. What was
    never published comes first, what was fitted last; of one split first the recordings whose files state it.
    """
    order = {"unpublished": 0, "held_out": 1, "": 2, "fit": 3}
    found: dict[tuple[str, str, tuple[str, ...]], list[tuple[Standing, dict[str, Any]]]] = {}
    for standing, row in sorted(rows, key=lambda pair: (order[pair[1]["split"]], not pair[1]["as_filed"])):
        assert standing.found is not None
        found.setdefault((standing.found.submission.suite, row["split"], row["over"]), []).append((standing, row))
    return found


def _board(rows: Sequence[tuple[Standing, dict[str, Any]]]) -> str:
    """One line for each submission, the least error first; a column for each metric, first the one that ranks."""
    lines: dict[str, tuple[Standing, dict[tuple[str, str], dict[str, Any]]]] = {}
    for standing, row in rows:
        lines.setdefault(standing.page, (standing, {}))[1][row["metric"], row["unit"]] = row
    first = _ranking_metric([list(values) for _, values in lines.values()])
    metrics = [first, *sorted({metric for _, values in lines.values() for metric in values} - {first})]
    ranked = sorted(lines.values(), key=lambda line: line[1][first]["value"] if first in line[1] else math.inf)
    body = []
    for place, (standing, values) in enumerate(ranked, start=1):
        assert standing.found is not None
        about = standing.found.submission
        shown = [_score(values[m]) if m in values else "–" for m in metrics]
        of = next(iter(values.values()))  # one split has one grade
        grade = _pill(of["grade"]) + below(text(of["said"]))
        link = f'<a href="{text(standing.page)}">{text(about.name)}</a>{below(text(about.about))}'
        body.append([text(place if first in values else ""), link, text(about.by), grade, *shown])
    head = ["place", "model", "by", "grade", *(f"{name} [{unit}]" for name, unit in metrics)]
    return table(head, body, numeric={0, *range(4, len(head))})


def _ranking_metric(lines: Sequence[Sequence[tuple[str, str]]]) -> tuple[str, str]:
    """The metric, with its unit, that all lines of a table have, or else most of them: what its places go by, whatever
    order a submission states its metrics in. Of several `node_error`, or the first by name.
    """
    counts = Counter(metric for line in lines for metric in line)
    return min(counts, key=lambda metric: (-counts[metric], metric[0] != USUAL, metric))


def _score(row: dict[str, Any]) -> str:
    return f"{row['value']:.4g}" + below(interval(row, ".4g"))


def _pill(grade: str) -> str:
    kind = "" if grade == REFUSED else " note" if grade == GRADE else " ok"
    return f'<span class="pill{kind}">{text(grade)}</span>'


def _page(standing: Standing) -> str:
    """Of one submission: its grade and what it rests on, then every score."""
    top = f'<p><a href="../index.html">All submissions</a></p><h1>{text(standing.name)} {_pill(standing.grade)}</h1>'
    if standing.reason:
        said = f"<b>It does not stand as handed in</b><p>{text(standing.reason)}</p>"
        why = f'<div class="failures" role="note">{said}</div>'
        return whole_page(text(standing.name), [Section(top + why)])
    assert standing.found is not None
    about = standing.found.submission
    by = " · ".join(filter(None, (about.by, about.about, f"scored by clothbench {about.clothbench}")))
    sections = [Section(f"{top}<p class='soft'>{text(by)}</p>{_rests_on(standing)}")]
    if standing.verdict and standing.verdict.unpublished:
        sections.append(
            Section(f"<h2>On recordings that were never published</h2>{_means(standing.verdict.unpublished)}")
        )
    sections.append(Section(f"<h2>Every score</h2>{_scores(standing)}"))
    files = [[f"<code>{text(w.file)}</code>", f"<code>{text(w.sha256)}</code>"] for w in about.wheels]
    if files:
        sections.append(Section(f"<h2>Plugin</h2>{table(['wheel', 'SHA-256'], files, set())}"))
    return whole_page(text(standing.name), [*sections, Section(GRADES)])


def _rests_on(standing: Standing) -> str:
    """How the grade was come by."""
    verdict = standing.verdict
    if verdict is None:
        return "<p>Every score was computed again from the positions that were handed in.</p>"
    said = []
    if verdict.seed is not None:
        keys = ", ".join(verdict.cells)
        said.append(f"Done again, last chosen by seed {verdict.seed}, and the same within the noise: {keys}.")
    else:
        said.append("The scores of published recordings rest on the positions that were handed in.")
    if verdict.unpublished:
        said.append("Fitted and scored on recordings that were never published.")
    said.append(f"{verdict.date[:10]}, {verdict.machine}, network {verdict.network} while it ran.")
    return f"<p>{text(' '.join(said))}</p>"


def _means(rows: Sequence[dict[str, Any]]) -> str:
    body = [[text(row["metric"]), _score(row), text(row["unit"]), _floor(row), _pill(VERIFIED)] for row in rows]
    return table(["metric", "mean error", "unit", "floor", "grade"], body, numeric={1, 3})


def _scores(standing: Standing) -> str:
    assert standing.found is not None
    body = []
    for fit, mine in group(list(_each(standing.found)), lambda row: row["fit"]).items():
        grade = _pill(standing.grade_of([fit]))
        if fit:
            body.append([f"fit <code>{text(fit)}</code>"])
        body += [
            [text(r["recording"]), text(r["split"].replace("_", " ")), text(r["metric"]), _score(r), text(r["unit"]),
             _floor(r), grade]
            for r in mine
        ]  # fmt: skip
    return table(["recording", "split", "metric", "error", "unit", "floor", "grade"], body, numeric={3, 5})


def _each(found: Verified) -> list[dict[str, Any]]:
    out = []
    for fit in dict.fromkeys(one.cell for one in found.found):
        mine = [one for one in found.found if one.cell == fit]
        out += [{**row, "fit": fit} for row in rows_of(mine) if row["recording"]]
    return out


def _floor(row: dict[str, Any]) -> str:
    return "" if row["floor"] is None else f"{row['floor']:.3g}"
