"""The store: whole cells or none, one schema, errors tried again."""

import subprocess
import sys

import pandas as pd
import pytest

from clothbench import ClothbenchError
from clothbench.engine import index
from clothbench.engine.cells import plugin_versions
from clothbench.engine.disagreement import recorded
from clothbench.engine.leaderboard import ROW, leaderboard_row
from clothbench.engine.store import Store, load_rows, superseded
from clothbench.plugins.discovery import catalogue


def one_row(status="ok", **changes):
    return {**dict.fromkeys(ROW), "suite": "s", "case": "c", "model": "m", "status": status, "key": "abc", **changes}


def test_put_and_read_back(tmp_path):
    store = Store(tmp_path)
    store.put("abc", {"rows": [one_row(value=2.0)], "history": pd.DataFrame({"evaluation": [1], "value": [3.0]})})
    assert store.has("abc")
    assert store.rows()[0]["value"] == 2.0
    assert {p.name for p in store.cell("abc").iterdir()} == {"rows.parquet", "history.parquet"}


def test_cells_that_are_called_the_same_come_by_seed_and_key_however_they_are_asked_for(tmp_path):
    store = Store(tmp_path)
    cells = [("e", None), ("d", 0), ("a", 2), ("c", 2), ("b", 10)]
    for key, seed in cells:
        store.put(key, {"rows": [one_row(key=key, seed=seed, recording=name, split="fit") for name in ("x", None)]})
    for keys in (None, ["c", "b", "d", "a", "e"], ["b", "e", "a", "c", "d"]):
        assert [row["key"] for row in store.rows(keys) if row["recording"]] == [key for key, _ in cells]


def test_an_error_is_not_finished(tmp_path):
    store = Store(tmp_path)
    store.put("abc", {"rows": [one_row("error")]})
    assert not store.has("abc")
    store.put("abc", {"rows": [one_row("diverged")]})
    assert store.has("abc")
    assert len(store.rows()) == 1


def test_a_finished_cell_stays_and_a_disagreement_is_told(tmp_path):
    store = Store(tmp_path)
    store.put("abc", {"rows": [one_row(value=1.0), one_row("skipped")]})
    store.put("abc", {"rows": [one_row(value=1.0), one_row("skipped")]})
    with pytest.warns(
        UserWarning, match=r"computed twice, first \[1\.0, 'skipped'\], which stays, then \[2\.0, 'skipped'\]"
    ):
        store.put("abc", {"rows": [one_row(value=2.0), one_row("skipped")]})
    (record,) = store.disagreements()
    assert record.parent.name == "abc"
    assert recorded(record) == ([1.0, "skipped"], [2.0, "skipped"], [])
    assert store.rows()[0]["value"] == 1.0
    assert [p.name for p in (tmp_path / "cells").iterdir()] == ["abc"]


WRITES = """
import sys
from clothbench.engine.leaderboard import ROW
from clothbench.engine.store import Store
store = Store(sys.argv[1])
for k in range(60):
    status = "error" if k < 30 else "ok"
    key = f"{k % 30:04x}"
    about = {**dict.fromkeys(ROW), "suite": "s", "case": "c", "model": "m", "key": key}
    store.put(key, {"rows": [{**about, "status": status, "value": float(k)}]})
"""


@pytest.mark.parametrize("few", [4, 1000], ids=["with an index", "without"])
def test_processes_that_write_the_same_cells_lose_none_and_none_is_ever_absent(tmp_path, monkeypatch, few):
    """Three processes, each 30 errors and then their 30 finished cells, all at once; and one that looks on."""
    monkeypatch.setattr(index, "FEW", few)
    store, seen = Store(tmp_path), set()
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITES, str(tmp_path)], stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    while any(writer.poll() is None for writer in writers):
        finished = {row["value"] for row in store.rows() if row["status"] == "ok"}
        assert seen <= finished
        seen = finished
    assert [writer.communicate()[1] for writer in writers] == [""] * 3
    assert [writer.returncode for writer in writers] == [0] * 3
    assert sorted(row["value"] for row in store.rows()) == list(range(30, 60))
    assert {p.name for p in (tmp_path / "cells").iterdir()} == {f"{k:04x}" for k in range(30)}


def plugin(version):
    return f"models/mass_spring ({version})"


def test_of_one_question_asked_with_several_versions_the_installed_one_counts_or_else_the_last(tmp_path):
    store = Store(tmp_path)
    here = plugin_versions([("models", "mass_spring")], catalogue())["models/mass_spring"]
    cells = {  # key: version, when it was finished, and what else is another
        "a0": ("clothbench 0.1, 1", "2026-01-01", {}),
        "a1": (here, "2026-01-02", {}),
        "a2": ("clothbench 9.9, 9", "2026-01-03", {}),
        "b0": ("clothbench 0.1, 1", "2026-01-01", {"settings": "other"}),
        "c0": ("clothbench 0.1, 1", "2026-01-01", {"recording": "r2"}),
        "d0": ("clothbench 0.1, 1", "2026-01-01", {"seed": 3}),
        "d1": ("clothbench 0.2, 1", "2026-01-02", {"seed": 3, "status": "diverged", "value": None, "recording": None}),
        "e0": ("clothbench 0.1, 1", "2026-01-01", {"budget": 20}),
        "e1": ("clothbench 0.1, 1", "2026-01-02", {"budget": 80}),
    }
    for key, (version, finished, other) in cells.items():
        about = {"key": key, "plugins": plugin(version), "finished": finished, "recording": "r1", "split": "fit"}
        store.put(key, {"rows": [{**one_row(), **about, **other}]})
    assert superseded(store.rows(every=True)) == {"a0", "a2", "d0"}
    assert {row["key"] for row in store.rows()} == {"a1", "b0", "c0", "d1", "e0", "e1"}
    assert {row["key"] for row in store.rows(["a0"])} == {"a0"}  # what is named is meant


def test_a_write_that_fails_leaves_the_old_cell_and_no_debris(tmp_path):
    store = Store(tmp_path)
    store.put("abc", {"rows": [one_row(value=1.0)]})

    def fails(folder):
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        store.put("abc", {"rows": [one_row(value=2.0)]}, fails)
    assert store.rows()[0]["value"] == 1.0
    assert [p.name for p in (tmp_path / "cells").iterdir()] == ["abc"]


def test_a_damaged_table_is_one_line(tmp_path):
    store = Store(tmp_path)
    store.put("abc", {"rows": [one_row()]})
    (store.cell("abc") / "rows.parquet").write_bytes(b"PAR1 nonsense")
    with pytest.raises(ClothbenchError, match="damaged table"):
        store.rows()


def test_json_rows_have_exactly_the_contract_keys():
    keys = [
        "suite", "case", "recording", "split", "model", "effects", "optimizer", "metric", "value", "unit", "low",
        "high", "floor", "reference", "status", "reason", "evaluations", "wall_s", "seed", "key",
    ]  # fmt: skip
    out = leaderboard_row(one_row(value=float("nan"), cpu="fast"))
    assert list(out) == keys
    assert out["value"] is None


@pytest.mark.parametrize("text", ["not json", "{}", '[{"a": 1}]'])
def test_a_file_that_is_no_leaderboard_is_refused(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(ClothbenchError, match=r"x\.json"):
        load_rows(path)


def test_whoever_gives_a_file_with_a_bad_row_is_not_told_to_delete_its_folder(tmp_path):
    path = tmp_path / "x.json"
    path.write_text('[{"suite": "s", "status": null, "value": 1.0}]')
    with pytest.raises(ClothbenchError) as said:
        load_rows(path)
    assert str(said.value) == (
        f"{path}: column 'status': found nothing in a row, expected string; "
        "write the file anew with clothbench leaderboard --json"
    )
