"""The history over commits: entries, series, what counts as a step and what is only noise, and the page."""

import json
import re
import subprocess

import numpy as np
import pytest
from browser_page import Page, started
from test_gate import failed_and_well, row

from clothbench import ClothbenchError
from clothbench.engine.leaderboard import ROW, SYSTEM
from clothbench.engine.store import Store
from clothbench.history import speed
from clothbench.history.commits import Commit, commit_at, commits_of
from clothbench.history.entries import Entry, add, entries_in, entries_of_git
from clothbench.history.page import page_html, write_page
from clothbench.history.series import all_series
from clothbench.history.show import document, print_history
from clothbench.history.steps import ALPHA, freedom_of, noise_of, steps_of

pytest.importorskip("ruptures", reason="ruptures is not installed: pip install 'clothbench[history]'")


def entry(number, *rows, machine="a cpu, 2 cores"):
    return Entry(f"{number:040x}", f"2026-01-{number + 1:02d}T00:00:00+00:00", f"change {number}", machine, rows)


def total(value, half=1.0, **changes):
    return row(value, half, recording=None, evaluations=None, wall_s=None, **changes)


def errors(*values, half=1.0):
    (found,) = all_series([entry(k, total(value, half)) for k, value in enumerate(values)])
    return found


def changes(series):
    return [(c.entry, c.verdict) for c in series.changes]


@pytest.mark.parametrize(
    ("values", "half", "expected"),
    [
        ((10, 10.4, 9.8, 10.2), 1.0, []),
        ((10, 10.4, 15, 15.2), 1.0, [(2, "worse")]),
        ((15, 15.2, 10, 10.1, 14.9), 1.0, [(2, "better"), (4, "worse")]),
        ((10, 10, 10.4, 10.4), 0.0, []),  # nothing but rounding, on another machine
        ((10, 10, 11, 11), 0.0, [(2, "worse")]),
        ((100, 101, 102, 103, 104, 105, 106, 107, 108, 109, 110, 111), 0.0, [(6, "worse")]),  # a slow drift adds up
        ((10, None, 10), 1.0, [(1, "worse"), (2, "better")]),
        ((10,), 1.0, []),
    ],
)
def test_steps_are_told_and_noise_is_not(values, half, expected):
    assert changes(errors(*values, half=half)) == expected


def test_a_question_that_is_answered_in_another_unit_has_a_series_in_each():
    entries = [entry(k, total(10.0 if k < 4 else 1.0, unit="mm" if k < 4 else "cm")) for k in range(8)]
    lost = entry(8, total(None, status="diverged", unit=None))
    found = {one.unit: one for one in all_series([*entries, lost])}
    assert {unit: [p.entry for p in one.points] for unit, one in found.items()} == {
        "mm": [0, 1, 2, 3], "cm": [4, 5, 6, 7, 8]
    }  # fmt: skip
    assert (changes(found["mm"]), changes(found["cm"])) == ([], [(8, "worse")])


def test_a_step_is_told_with_both_levels_and_their_interval():
    (change,) = errors(10, 10, 14, 14).changes
    assert (change.before, change.after, change.percent) == pytest.approx((10, 14, 40))
    assert change.half == pytest.approx(0.2)  # two values on each side, each ± 1, a fifth of which runs do not share


def test_noise_alone_makes_no_more_steps_than_is_said():
    random = np.random.default_rng(3)
    told = sum(bool(steps_of(random.normal(10, 1, 12), 1.0, 0.0)) for _ in range(1000))
    assert 0 < told <= 1.5 * ALPHA * 1000


@pytest.mark.parametrize("count", [6, 10, 20])
def test_nor_where_the_scatter_of_the_same_values_is_all_that_tells_the_noise(count):
    random = np.random.default_rng(5)

    def told(values):
        unknown = [float("nan")] * count
        return steps_of(values, noise_of(values, unknown), 1e-3, 0.0, freedom_of(values, unknown))

    assert sum(bool(told(random.normal(10, 1, count))) for _ in range(600)) <= 12  # 6 are said; 30 and more once
    level = 10 + 25.0 * (np.arange(count) >= count // 2)
    found = [[s.at for s in told(random.normal(level, 1))] for _ in range(50)]
    assert sum(at == [count // 2] for at in found) >= 45


def test_planted_steps_are_found_where_they_are():
    random = np.random.default_rng(4)
    level = np.repeat([10.0, 14.0, 11.0], 10)
    found = [[s.at for s in steps_of(random.normal(level, 0.5), 0.5, 0.05)] for _ in range(50)]
    assert sum(at == [10, 20] for at in found) >= 48


def test_noise_is_the_larger_of_intervals_and_scatter():
    values = [10.0, 11, 10, 11, 10, 11]
    assert noise_of(values, [0.1] * 6) == pytest.approx(1.4826 / 2**0.5)
    assert noise_of(values, [19.6] * 6) == pytest.approx(10, rel=1e-3)
    assert noise_of(values[:3], [float("nan")] * 3) is None


def test_a_distance_from_a_reference_counts_and_not_the_value():
    rows = [total(value, half=0.0, reference=1.0) for value in (1.0002, 1.0001, 1.02, 1.02)]
    (series,) = all_series([entry(k, one) for k, one in enumerate(rows)])
    assert changes(series) == [(2, "worse")]


def test_a_series_keeps_to_cells_of_the_same_recordings_whatever_their_version():
    def two(version):
        cells = (("easy", 10.0, f"{'ab'[version]}1"), ("hard", 50.0, f"{'ba'[version]}2"))
        return [
            one
            for name, value, key in cells
            for one in (total(value, key=key) | {"recording": name}, total(value, key=key))
        ]

    single = [r for r in two(0) if r["key"] == "a1"]
    for entries in ([two(0), two(1)], [two(0), single, two(1)], [two(0)[::-1], two(1), single], [two(0)[::-1], two(1)]):
        (mean,) = (
            s for s in all_series([entry(k, *rows) for k, rows in enumerate(entries)]) if not s.about["recording"]
        )
        assert len({p.value for p in mean.points}) == 1


def test_a_series_keeps_to_the_cell_that_most_entries_have():
    """Others about the same, with another budget, do not take its place in entries that have both."""
    once, short, long = total(9.0, key="b"), total(10.0, key="a"), total(5.0, key="b")
    (series,) = all_series([entry(0, once, short), entry(1, short, long), entry(2, short), entry(3, short)])
    assert [point.value for point in series.points] == [10.0] * 4
    assert series.changes == ()


def test_a_cell_that_fails_as_a_whole_has_lost_its_numbers():
    failed, well = failed_and_well()
    found = all_series([entry(k, *(well if k != 3 else [failed])) for k in range(5)])
    assert [one.about["split"] for one in found if one.kind == "error"] == ["fit", "held_out"]
    for series in found[:2]:
        assert changes(series) == [(3, "worse"), (4, "better")]
        assert series.points[3].reason == "error: boom"
        assert series.unit == "mm"
    (alone,) = all_series([entry(0, failed)])
    assert [p.value for p in alone.points] == [None]


def timed(seconds, cells=3, **about):
    """Cells of one model, each of which takes its own time for ten evaluations."""
    return [
        total(5.0, case=f"c{k}", key=f"k{k}", **about) | {"evaluations": 10, "wall_s": seconds * (k + 1)}
        for k in range(cells)
    ]


def speed_series(*entries):
    return [one for one in all_series(entries) if one.kind == "speed"]


def test_speeds_of_other_cells_are_compared_over_those_they_share():
    seconds = [1.0, 1.02, 0.99, 1.01, 2.0, 2.02, 1.98, 2.01]
    (series,) = speed_series(*(entry(k, *timed(s, cells=2 + k % 2)) for k, s in enumerate(seconds)))
    assert changes(series) == [(4, "worse")]
    assert series.changes[0].after / series.changes[0].before == pytest.approx(0.5, rel=0.03)
    slow_cell_came_late = [entry(k, *timed(1.0, cells=1 + (k > 3))) for k in range(8)]
    assert speed_series(*slow_cell_came_late)[0].changes == ()


@pytest.mark.parametrize("other", [{"metric": "fold"}, {}], ids=["metric", "options"])
def test_a_cell_that_minimises_something_else_is_another_cell(other):
    """A suite that gains slower cells has not become slower; entries know nothing of them but what they are about."""
    assert set(speed.CELL) <= set(ROW)
    slower = [{**row, "key": f"of {row['key']}"} for row in timed(5.0, **other)]
    (series,) = speed_series(*(entry(k, *timed(1.0), *(slower if k > 7 else ())) for k in range(16)))
    assert series.changes == ()
    assert series.points[-1].value == pytest.approx(series.points[0].value)


def test_a_cell_of_another_version_or_with_a_further_metric_is_the_same():
    newer = [{**row, "key": f"new {row['key']}"} for row in timed(2.0)]
    further = [row | {"metric": "fold", "status": "skipped"} for row in newer]
    (series,) = speed_series(*(entry(k, *(timed(1.0) if k < 8 else [*newer, *further])) for k in range(16)))
    assert changes(series) == [(8, "worse")]


def test_entries_that_share_cells_are_looked_for_once(monkeypatch):
    asked = []
    monkeypatch.setattr(speed, "_connected", lambda places: asked.append(len(places)) or {0, 1})
    speed_series(entry(0, *timed(1.0)), entry(1, *timed(1.0)))
    assert asked == [6]


def test_speeds_are_compared_within_one_machine_and_from_six_entries_on():
    by_turns = [entry(k, *timed(1.0 + 2 * (k % 2)), machine=f"cpu {k % 2}") for k in range(12)]
    assert [(len(one.points), one.changes) for one in speed_series(*by_turns)] == [(6, ()), (6, ())]
    assert speed_series(*(entry(k, *timed(1.0), machine=None) for k in range(8))) == []
    assert speed_series(*(entry(k, *timed(1.0 + 2 * (k > 1))) for k in range(4)))[0].changes == ()


def stored(folder, value, **about):
    kept = {**dict.fromkeys({**ROW, **SYSTEM}), **total(value), "seed": 0, "key": "ab", "cpu": "a cpu", "cores": 2}
    kept |= about
    Store(folder).put("ab", {"rows": [kept]})
    return Store(folder)


def test_entries_are_added_to_a_folder_and_none_meets_another(tmp_path):
    history = tmp_path / "history"
    for number, value in enumerate((10.0, 20.0)):
        commit = Commit(f"{number:040x}", f"2026-01-0{2 - number}T10:00:00+01:00", "a change")
        for _ in range(2):  # the same again is the same file
            (path,) = add(history, stored(tmp_path / str(number), value), commit)
    assert path.name.startswith("20260101T090000Z-0000000000-")
    found = entries_in(history)
    assert [e.rows[0]["value"] for e in found] == [20.0, 10.0]  # by the time of the commit
    assert {e.machine for e in found} == {"a cpu, 2 cores"}
    unknown = stored(tmp_path / "unknown", 5.0, cpu=None, cores=None)
    add(history, unknown, Commit("b" * 40, "2026-01-03T10:00:00+01:00", "a change"))
    assert entries_in(history)[-1].machine is None


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"schema": 2}, "schema is 2, expected 1"),
        ({"commit": 3}, "commit is 3, expected text"),
        ({"machine": []}, r"machine is \[\], expected text or null"),
        ({"date": "today"}, "is 'today', expected a date like"),
        ({"date": "0001-01-01T00:00:00+14:00"}, "is '0001-01-01T00:00:00.14:00', expected a date like"),
        ({"rows": [total(1.0, suite="")]}, r"json: rows\[0\].suite is '', expected the name of a suite"),
        ({"rows": [total(1.0, suite=None)]}, r"json: rows\[0\].suite is None, expected the name of a suite"),
        ({"rows": [total(1.0) | {"evaluations": -5}]}, r"rows\[0\].evaluations is -5, expected 0 at least"),
        ({"rows": [total(1.0) | {"wall_s": -5.0}]}, r"rows\[0\].wall_s is -5, expected 0, or 1e-09 to"),
        ({"rows": [total(1.0), total(1.0) | {"wall_s": 1e-320}]}, r"rows\[1\].wall_s is 9.99\S+, expected 0, or"),
        ({"rows": [total(1e300)]}, r"rows\[0\].value is 1e\+300, expected 1e\+100 at most"),
        ({"rows": {}}, "expected rows as `clothbench leaderboard --json` prints them"),
    ],
)
def test_a_damaged_entry_is_one_line(tmp_path, change, found):
    (path,) = add(tmp_path, stored(tmp_path / "runs", 1.0), Commit("a" * 40, "2026-01-01T00:00:00Z", "a change"))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ClothbenchError, match=found):
        entries_in(tmp_path)
    before = sorted(tmp_path.glob("*.json"))
    with pytest.raises(ClothbenchError, match=found):  # nor is one put beside it, of which no page could be made
        add(tmp_path, stored(tmp_path / "more", 2.0), Commit("b" * 40, "2026-01-02T00:00:00Z", "another"))
    assert sorted(tmp_path.glob("*.json")) == before


def test_results_that_no_series_can_be_made_of_are_not_added(tmp_path):
    with pytest.raises(ClothbenchError, match=r"runs: rows\[0\].suite is ''"):
        add(tmp_path / "h", stored(tmp_path / "runs", 1.0, suite=""), Commit("a" * 40, "2026-01-01T00:00:00Z", "one"))
    assert not list((tmp_path / "h").glob("*"))


def test_a_folder_without_entries_says_how_to_get_some(tmp_path):
    with pytest.raises(ClothbenchError, match="found no entries"):
        entries_in(tmp_path)


@pytest.fixture
def repository(tmp_path):
    """A leaderboard that is committed three times, and removed once in between."""
    place = tmp_path / "repository"
    (place / "results").mkdir(parents=True)

    def git(*words):
        about = ["-c", "user.name=n", "-c", "user.email=n@example.org", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", "-C", place, *about, *words], check=True, capture_output=True)

    git("init", "--quiet")
    path = place / "results" / "board.json"
    for number, value in enumerate((10.0, None, 10.0, 20.0)):
        if value is None:
            git("rm", "--quiet", "results/board.json")
            path.parent.mkdir(exist_ok=True)
        else:
            path.write_text(json.dumps([total(value)]))
            git("add", ".")
        git("commit", "--quiet", "--allow-empty", "-m", f"change\t{number}")
    return path


def test_git_itself_is_a_history(repository, clothbench, tmp_path):
    found = entries_of_git(repository, None)
    assert [(e.subject, e.rows[0]["value"]) for e in found] == [
        ("change\t0", 10.0), ("change\t2", 10.0), ("change\t3", 20.0)
    ]  # fmt: skip
    done = clothbench("history", "--git", repository, "--page", "history.html", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [c["entry"] for c in told["series"][0]["changes"]] == [2]
    assert (tmp_path / "history.html").is_file()
    assert clothbench("history", "--git", repository).stdout.splitlines()[-1].startswith("3 commits, 1 series of err")


def test_a_commit_whose_file_cannot_be_read_is_left_out_and_said(repository, clothbench, capsys):
    about = ["-c", "user.name=n", "-c", "user.email=n@example.org", "-c", "commit.gpgsign=false"]
    good = repository.read_text()
    for text in ("[{", good):
        repository.write_text(text)
        words = ["git", "-C", repository.parent, *about, "commit", "--quiet", "--all", "-m", "another"]
        subprocess.run(words, check=True, capture_output=True)
    assert [e.rows[0]["value"] for e in entries_of_git(repository, None)] == [10.0, 10.0, 20.0, 20.0]
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"clothbench: {repository} at ")
    assert said.endswith("; left out")
    other = repository.with_name("other.json")
    other.write_text("[{")
    subprocess.run(["git", "-C", repository.parent, "add", "."], check=True)
    words = ["git", "-C", repository.parent, *about, "commit", "--quiet", "-m", "bad"]
    subprocess.run(words, check=True, capture_output=True)
    done = clothbench("history", "--git", other)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("subject", ["ma\u00dfe".encode("latin-1"), "one\u2028two".encode(), b"one\x0ctwo\rthree"])
def test_a_subject_of_any_bytes_is_one_commit(repository, subject):
    def git(*words, text=b""):
        return subprocess.run(["git", "-C", repository.parent, *words], input=text, check=True, capture_output=True)

    # `git commit` would make UTF-8 of it; other programs that write commits do not.
    text = git("cat-file", "commit", "HEAD").stdout.replace(b"change\t3", subject)
    git("update-ref", "HEAD", git("hash-object", "-w", "-t", "commit", "--stdin", text=text).stdout.decode().strip())
    assert commit_at("HEAD", repository.parent).subject == subject.decode("utf-8", errors="replace")
    assert len(commits_of(repository)) == 4


SIGNER = """#!/bin/sh
case "$*" in *verify*) echo "[GNUPG:] GOODSIG 0 a"; echo "gpg: Good signature" >&2; exit;; esac
cat > /dev/null; echo "[GNUPG:] SIG_CREATED x" >&2
printf -- '-----BEGIN PGP SIGNATURE-----\\nx\\n-----END PGP SIGNATURE-----\\n'
"""


def test_a_signature_that_git_is_told_to_show_is_no_commit(repository, tmp_path):
    signer = tmp_path / "signer"
    signer.write_text(SIGNER)
    signer.chmod(0o755)
    for name, value in {"gpg.program": str(signer), "log.showSignature": "true"}.items():
        subprocess.run(["git", "-C", repository.parent, "config", name, value], check=True)
    signed = ["-c", "user.name=n", "-c", "user.email=n@example.org", "commit", "-qSa", "--allow-empty", "-m", "signed"]
    subprocess.run(["git", "-C", repository.parent, *signed], check=True)
    assert commit_at("HEAD", repository.parent).subject == "signed"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ((), "expected either a FOLDER of entries, or --git FILE"),
        (("folder", "--machine", "m"), "--machine is for --git"),
        (("folder", "--commit", "main"), "--commit says what the RUNS of --add are of"),
        (("--git", "nowhere/board.json"), "found no folder nowhere"),
        (("--git", "board.json"), "git log said:"),
        (("folder", "--add", "nothing"), "found no results (no folder 'cells')"),
    ],
)
def test_wrong_use_is_one_line(words, found, clothbench):
    done = clothbench("history", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert found in done.stderr
    assert len(done.stderr.splitlines()) == 1


def several():
    """Two models on two cases, a step for one, a number lost by the other, speeds of eight entries; strange names."""
    out = []
    for k in range(8):
        lost = total(None, status="diverged", model="two") | {"reason": "fell <b>over</b>"}
        rows = [total(10.0 + 5 * (k > 4), model="one<i>"), lost if k == 7 else total(12.0, model="two")]
        out.append(entry(k, *rows, *timed(1.0 + (k > 3), model="one<i>")))
    return out


def test_the_terminal_and_json_say_the_same(capsys):
    entries = several()
    series = all_series(entries)
    print_history(entries, series)
    said = capsys.readouterr().out
    told = document(entries, series)
    count = sum(len(one["changes"]) for one in told["series"])
    assert count == 3
    assert "3 changes for the worse, 0 for the better" in said
    json.dumps(told, allow_nan=False)


def figures_of(page, kind):
    return json.loads(re.search(rf'id="{kind}-figures">(.*?)</script>', page, re.DOTALL)[1])


def test_what_a_point_says_is_escaped_and_its_break_is_not():
    entries = several()
    page = page_html(entries, all_series(entries))
    said = [words for figure in figures_of(page, "error") for line in figure["data"] for words in line.get("text", ())]
    assert said
    assert all(words.count("<br>") == 1 and "&lt;br" not in words for words in said)
    assert any("one&lt;i&gt;" in words for words in said)
    assert any("fell &lt;b&gt;over" in words for words in said)


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    yield from started(tmp_path_factory.mktemp("chromium"))


def test_the_page_has_no_fault_and_shuts_nobody_out(chromium, tmp_path):
    entries = several()
    path = write_page(tmp_path / "history.html", entries, all_series(entries))
    text = path.read_text()
    assert "<b>over" not in text.replace("\\u003cb>", "")
    page = Page(chromium).open(path)
    page.wait('document.querySelectorAll(".js-plotly-plot").length > 0')
    assert page.barriers() == []
    assert page.faults() == []
