"""A store is checked, merged and pruned: nothing damaged passes, nothing finished goes unasked."""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from clothbench import ClothbenchError
from clothbench.cli import main
from clothbench.cli.view import find_cell
from clothbench.core.files import half_written
from clothbench.engine import upkeep
from clothbench.engine.check import check
from clothbench.engine.disagreement import SEEDLESS, recorded
from clothbench.engine.leaderboard import ROW
from clothbench.engine.leases import Leases
from clothbench.engine.store import Store
from clothbench.engine.tables import read_table
from clothbench.engine.upkeep import merge, prunable
from clothbench.plugins.discovery import catalogue

KEYS = [f"{n:016x}" for n in range(4)]


def row(key, value=1.0, **changes):
    about = {"suite": "s", "case": "c", "model": "m", "study": "calibration", "status": "ok", "key": key}
    return {**dict.fromkeys(ROW), **about, "value": value, **changes}


def put(folder, key, value=1.0, **changes):
    Store(folder).put(key, {"rows": [row(key, value, **changes)], "trace": [{"time": float(k)} for k in range(50)]})


@pytest.fixture
def filled(tmp_path):
    for key in KEYS:
        put(tmp_path / "a", key)
    return tmp_path / "a"


def faults(folder):
    return [found.line for found in check(Store(folder), catalogue()) if not found.harmless]


def test_a_whole_store_has_no_fault(filled, capsys):
    assert main(["store", "check", str(filled)]) == 0
    assert capsys.readouterr().out == f"{filled}: ok\n"


@pytest.mark.skipif(os.name != "posix", reason="names are bytes on POSIX")
def test_results_in_a_folder_whose_name_is_not_utf_8_are_read(filled, capsys):
    folder = filled.with_name(os.fsdecode(b"caf\xe9"))
    try:
        filled.rename(folder)
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    assert main(["store", "check", str(folder)]) == 0
    assert main(["compare", str(folder), str(folder)]) == 0
    capsys.readouterr()
    assert main(["leaderboard", "--json", "--out", str(folder)]) == 0
    assert [row["key"] for row in json.loads(capsys.readouterr().out)] == KEYS


def test_every_kind_of_fault_is_one_line(filled, capsys):
    def flip(path, at):
        content = bytearray(path.read_bytes())
        content[at] ^= 0xFF
        path.write_bytes(content)

    cells = filled / "cells"
    trace = cells / KEYS[0] / "trace.parquet"
    flip(trace, 150)  # in the numbers: without checksums, another one would be read
    (cells / KEYS[1] / "films").mkdir()
    np.savez(cells / KEYS[1] / "films" / "0.npz", time=np.arange(50.0))
    flip(cells / KEYS[1] / "films" / "0.npz", 300)
    (cells / KEYS[2] / "rows.parquet").unlink()
    os.rename(cells / KEYS[3], cells / "abc")
    put(filled, "0d", study="weaving")
    put(filled, "0e", status="fine")
    (cells / "notes").mkdir()
    (cells / "0f").mkdir()
    (cells / "0f" / "fit.rrd").touch()
    expected = {
        trace: "damaged table", cells / KEYS[1] / "films" / "0.npz": "no npz that can be read",
        cells / KEYS[2]: "no rows.parquet", cells / "abc" / "rows.parquet": f"rows of the cell {KEYS[3]}",
        cells / "0d" / "rows.parquet": "study 'weaving', expected calibration",
        cells / "0e" / "rows.parquet": "status 'fine'", cells / "notes": "a stray",
        cells / "0f" / "fit.rrd": "an empty file", cells / "0f": "no rows.parquet",
    }  # fmt: skip
    assert main(["store", "check", str(filled), "--json"]) == 1
    found = {told["path"]: told for told in json.loads(capsys.readouterr().out)}
    assert set(found) == {str(path) for path in expected}
    for path, words in expected.items():
        assert found[str(path)]["line"].startswith(f"{path}: found ")
        assert words in found[str(path)]["line"]
        assert "; " in found[str(path)]["line"]  # what to do


def test_a_copy_of_a_cell_beside_it_is_no_second_cell(filled, capsys):
    copies = [filled / "cells" / f"{KEYS[0]}{more}" for more in (" copy", "-1", ".bak")]
    for copy in copies:
        shutil.copytree(filled / "cells" / KEYS[0], copy)
    assert main(["leaderboard", "--json", "--out", str(filled)]) == 0
    assert [row["key"] for row in json.loads(capsys.readouterr().out)] == KEYS
    assert [line.split(": ")[0] for line in faults(filled)] == list(map(str, copies))


def test_a_copy_of_a_cell_is_not_viewed_in_its_place_and_not_pruned(tmp_path):
    put(tmp_path, "0a", plugins="metrics/node_error (x 1, 0)")
    shutil.copytree(tmp_path / "cells" / "0a", tmp_path / "cells" / "0a.bak")
    assert find_cell(tmp_path, "0") == tmp_path / "cells" / "0a"
    assert [path.name for path, _ in prunable(Store(tmp_path), catalogue(), other_versions=True)] == ["0a"]


def test_what_stopped_runs_left_is_told_and_is_no_fault(filled, capsys):
    (filled / "cells" / f".{KEYS[0]}.abcd_123").mkdir()
    (filled / ".report.html.abcd_123.part").touch()
    (filled / "journal" / KEYS[0]).mkdir(parents=True)
    (filled / "journal" / "0a").mkdir()
    assert main(["store", "check", str(filled)]) == 0
    out = capsys.readouterr().out
    assert out.count("left over: ") == 4
    assert "a cell that is finished" in out
    assert "goes on with it" in out


def test_merge_takes_what_is_missing_and_lets_errors_give_way(filled, tmp_path, capsys):
    there = tmp_path / "b"
    put(there, KEYS[0])
    put(there, KEYS[1], None, status="error", reason="no memory")
    put(filled, "0a", None, status="error", reason="here")
    put(there, "0a", 3.0)
    assert main(["store", "merge", str(filled), str(there)]) == 0
    assert capsys.readouterr().out == f"{there}: 3 cells taken, 1 there already, 1 errors left out, 0 faults\n"
    assert {r["key"]: r["value"] for r in Store(there).rows()} == {**dict.fromkeys(KEYS, 1.0), "0a": 3.0}
    assert faults(there) == []
    again = merge(Store(filled), Store(there), catalogue())
    assert (again.taken, again.same, again.errors, again.findings) == ([], KEYS, ["0a"], [])


def test_merge_tells_a_disagreement_and_overwrites_nothing(filled, tmp_path, capsys):
    there = tmp_path / "b"
    put(there, KEYS[0], 2.0)
    (filled / "cells" / KEYS[1] / "rows.parquet").write_bytes(b"PAR1")
    assert main(["store", "merge", str(filled), str(there)]) == 1
    out = capsys.readouterr().out
    assert f"fault: {there / 'cells' / KEYS[0]}: found [2.0], which stays, and [1.0] in " in out
    assert "damaged table" in out
    assert {r["key"]: r["value"] for r in Store(there).rows()} == {KEYS[0]: 2.0, KEYS[2]: 1.0, KEYS[3]: 1.0}


def test_what_another_machine_made_of_a_cell_is_no_fault_within_rounding_and_is_not_blamed_on_its_seed(
    tmp_path, capsys
):
    here, there = {"cpu": "a", "numpy": "2.2", "numba": "1"}, {"cpu": "b", "numpy": "2.3", "numba": "1"}
    for key, (value, machine) in zip(
        KEYS, [(1.0 + 1e-12, there), (1.0 + 1e-12, here), (2.0, there), (None, there)], strict=True
    ):
        put(tmp_path / "a", key, value, **machine, **({} if value else {"status": "timeout"}))
        put(tmp_path / "b", key, 1.0, **here)
    assert main(["store", "merge", str(tmp_path / "a"), str(tmp_path / "b")]) == 1
    *lines, last = capsys.readouterr().out.splitlines()
    assert last.endswith("0 cells taken, 1 there already, 0 errors left out, 3 faults")
    why = (
        "the two were computed with another processor and numpy, which may be why: bits depend on it (docs/cluster.md)"
    )
    assert [line.split("; ")[1] for line in lines] == [SEEDLESS, why, why]
    assert [line.split("; ")[1] for line in faults(tmp_path / "b")] == [SEEDLESS, why, why]
    merge(Store(tmp_path / "b"), Store(tmp_path / "c"), catalogue())
    assert [line.split("; ")[1] for line in faults(tmp_path / "c")] == [SEEDLESS, why, why]
    with pytest.warns(UserWarning, match="another processor and numpy"):
        put(tmp_path / "b", KEYS[2], 3.0, **there)


def disagreeing(folder):
    """A cell that was computed twice."""
    with pytest.warns(UserWarning, match="computed twice"):
        put(folder, KEYS[0], 2.0)
    (record,) = Store(folder).disagreements()
    return record


def test_a_disagreement_is_a_fault_until_its_cell_goes(filled, capsys):
    record = disagreeing(filled)
    assert faults(filled) == [
        f"{record}: found that this cell was computed twice, first [1.0], which stays, then [2.0], expected the same "
        f"of the same cell; {SEEDLESS}"
    ]
    assert main(["store", "check", str(filled)]) == 1
    assert main(["store", "prune", str(filled), "--cell", KEYS[0]]) == 0
    assert main(["store", "check", str(filled)]) == 0
    assert not record.exists()


@pytest.mark.parametrize("text", ["", "[]", '{"first": [1], "second": 2}', '{"first": [1], "second": [{}]}'])
def test_what_is_no_record_is_one_line(filled, text):
    record = disagreeing(filled)
    record.write_text(text)
    (said,) = faults(filled)
    assert said.startswith(f"{record}: found ")
    assert said.endswith("expected the record of a disagreement, as a run writes it")


def test_a_disagreement_goes_where_its_cell_goes(filled, tmp_path):
    there = tmp_path / "b"
    disagreeing(filled)
    merge(Store(filled), Store(there), catalogue())
    assert [recorded(path) for path in Store(there).disagreements()] == [([1.0], [2.0], [])]
    put(tmp_path / "c", KEYS[1], 3.0)
    merge(Store(filled), Store(tmp_path / "c"), catalogue())
    assert {path.parent.name: recorded(path) for path in Store(tmp_path / "c").disagreements()} == {
        KEYS[0]: ([1.0], [2.0], []), KEYS[1]: ([3.0], [1.0], []),
    }  # fmt: skip


def test_prune_removes_what_is_old_and_no_cell_unasked(filled, capsys):
    old, young = filled / "cells" / f".{KEYS[0]}.abcd_123", filled / "cells" / ".old.abcd_124"
    journal = filled / "journal" / "0a"
    for folder in (old, young, journal):
        folder.mkdir(parents=True)
    (journal / "batch.npz").touch()
    long_ago = time.time() - 3 * 86400
    for path in (old, journal):
        os.utime(path, (long_ago, long_ago))  # the file in the journal is young: a run is at it
    assert main(["store", "prune", str(filled), "--dry-run"]) == 0
    assert f"would remove: {old}: half-written" in capsys.readouterr().out
    assert old.is_dir()
    assert main(["store", "prune", str(filled)]) == 0
    assert not old.exists()
    assert young.is_dir()
    assert journal.is_dir()
    os.utime(journal / "batch.npz", (long_ago, long_ago))
    assert main(["store", "prune", str(filled), "--older", "2", "--cell", KEYS[2]]) == 0
    assert not journal.exists()
    assert sorted(p.name for p in (filled / "cells").glob("[!.]*")) == [KEYS[0], KEYS[1], KEYS[3]]
    assert list(half_written(filled / "cells")) == [young]


def test_prune_leaves_alone_what_a_live_command_is_at(filled):
    journal = filled / "journal" / "0a"
    journal.mkdir(parents=True)
    os.utime(journal, (0, 0))
    with Leases(Store(filled)) as leases:
        assert leases.take("0a")
        assert prunable(Store(filled), catalogue(), older=0) == []
    assert [path for path, _ in prunable(Store(filled), catalogue())] == [journal]


def test_prune_leaves_alone_what_is_just_being_written(filled):
    """A command with a lease, and a merge, a page or a tracker without."""
    cell, merged = (filled / "cells" / f".{key}.abcd_123" for key in ("0a", "0b"))
    others = [
        filled / "cells" / ".old.abcd_123",
        filled / ".report.html.abcd_123.part",
        filled / "tracked" / ".x.nc.abcd_123.part",
    ]
    (filled / "tracked").mkdir()
    for path in (cell, merged, *others):
        path.touch() if path.suffix == ".part" else path.mkdir()
    os.utime(cell, (0, 0))
    with Leases(Store(filled)) as leases:
        assert leases.take("0a")
        assert prunable(Store(filled), catalogue(), older=0) == []
    assert [path for path, _ in prunable(Store(filled), catalogue(), older=0)] == [cell]
    for path in (merged, *others):
        os.utime(path, (0, 0))
    assert {path for path, _ in prunable(Store(filled), catalogue(), older=0)} == {cell, merged, *others}


@pytest.mark.parametrize("left", ["journal", "leases", "tracked"])
def test_what_a_run_left_that_finished_no_cell_is_checked_and_pruned(tmp_path, capsys, left):
    remains = tmp_path / left / (".x.nc.abcd_123.part" if left == "tracked" else "0a")
    remains.parent.mkdir()
    remains.mkdir() if left == "journal" else remains.write_text("{}")
    os.utime(remains, (0, 0))
    assert main(["store", "check", str(tmp_path)]) == 0
    assert f"left over: {remains}: " in capsys.readouterr().out
    assert main(["store", "prune", str(tmp_path)]) == 0
    assert not remains.exists()


def test_what_goes_while_prune_looks_is_no_fault(filled, monkeypatch):
    gone = filled / "leases" / "0b"
    monkeypatch.setattr(upkeep, "remains", lambda store: iter([(gone, "the lease of a command that has gone")]))
    assert prunable(Store(filled), catalogue(), older=0) == []
    monkeypatch.setattr("pathlib.Path.is_dir", lambda path: True)
    upkeep.remove(filled / "gone")
    monkeypatch.undo()
    assert not list(filled.glob(".old.*"))


def test_prune_knows_cells_of_other_versions(filled, capsys):
    plugins = catalogue()
    known = plugins.find("metrics", "node_error")
    now = f"{known.distribution} {known.version}, {plugins.load('metrics', 'node_error').version}"
    for key, used in (
        ("0a", f"metrics/node_error ({now}); models/absent (x 1, 1)"),
        ("0b", "metrics/node_error (x 1, 0)"),
    ):
        put(filled, key, plugins=used)
    assert main(["store", "prune", str(filled), "--other-versions"]) == 0
    assert capsys.readouterr().out.startswith(f"removed: {filled / 'cells' / '0b'}: metrics/node_error x 1, 0; inst")
    assert sorted(p.name for p in (filled / "cells").iterdir()) == [*KEYS, "0a"]


@pytest.fixture
def locked(filled, monkeypatch):
    """A cell whose folder may not be looked into; the tests may run as root, who may look into all."""
    folder = filled / "cells" / KEYS[1]

    def refuse(where):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(where))

    def closed(real, itself):
        def call(path=".", *how, **more):
            at = Path(os.fspath(path)) if isinstance(path, str | os.PathLike) else Path()
            return refuse(path) if folder in at.parents or (itself and at == folder) else real(path, *how, **more)

        return call

    monkeypatch.setattr(os, "stat", closed(os.stat, itself=False))
    monkeypatch.setattr(os, "scandir", closed(os.scandir, itself=True))
    return folder


def test_a_cell_that_may_not_be_looked_into_is_not_taken_for_none(locked, filled, tmp_path, capsys):
    assert main(["leaderboard", "--json", "--out", str(filled)]) == 2
    said = capsys.readouterr()
    assert not said.out
    told = f"{locked}/rows.parquet: cannot be looked up (Permission denied)"
    assert said.err == f"clothbench: {told}; give a folder whose cells you may read\n"
    with pytest.raises(ClothbenchError, match="cannot be looked up"):
        Store(filled).has(KEYS[1])


def test_a_table_that_may_not_be_read_is_not_called_damaged(filled, monkeypatch):
    """Whoever is told that deletes what somebody else has finished."""

    def closed(path, **_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr("clothbench.engine.tables.pq.ParquetFile", closed)
    with pytest.raises(ClothbenchError, match=r"rows\.parquet: cannot be read \(Permission denied\); give a folder"):
        read_table(filled / "cells" / KEYS[1] / "rows.parquet")


def test_check_and_merge_tell_a_cell_that_may_not_be_looked_into(locked, filled, tmp_path, capsys):
    assert [line.split("; ")[0] for line in faults(filled)] == [
        f"{locked}: found a folder that cannot be looked into (Permission denied), expected one that can"
    ]
    assert main(["store", "merge", str(filled), str(tmp_path / "b")]) == 1
    assert "3 cells taken, 0 there already, 0 errors left out, 1 faults" in capsys.readouterr().out


def test_cells_that_may_not_be_listed_are_not_taken_for_none(filled, tmp_path, monkeypatch, capsys):
    def listed(path, real=os.listdir):
        if Path(path) == filled / "cells":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return real(path)

    monkeypatch.setattr(os, "listdir", listed)
    for words in (["store", "check"], ["store", "merge"], ["view", KEYS[0], "--out"]):
        more = [str(tmp_path / "b")] if words[-1] == "merge" else []
        assert main([*words, str(filled), *more]) == 2
        assert capsys.readouterr().err == f"clothbench: {filled}/cells: Permission denied\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["check", "runs"], "found no results"), (["merge", "nothing", "b"], "found no results"),
        (["merge", "a", "a"], "the folder to merge from"), (["prune", "a", "--cell", "0f"], "no such cell"),
        (["prune", "a", "--cell", ".."], "no such cell"),
        *((["prune", "a", "--older", days], f"--older is {days!r}, expected days, a number, at least 0")
          for days in ("-1", "nan", "inf", "old")),
    ],
)  # fmt: skip
def test_bad_words_are_one_line(filled, monkeypatch, capsys, words, told):
    monkeypatch.chdir(filled.parent)
    assert main(["store", *words]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert err.count("\n") == 1
