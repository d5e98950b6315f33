"""The list of many cells is the list of its cells, whatever has become of the index."""

from __future__ import annotations

import os

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from clothbench.cli.commands import print_json, print_json_rows
from clothbench.engine import index
from clothbench.engine.index import dicts, segments_in
from clothbench.engine.leaderboard import ROW
from clothbench.engine.store import Store


def put(store, number, value, status="ok"):
    key = f"{number:04x}"
    row = {**dict.fromkeys(ROW), "suite": "s", "case": f"c{number}", "model": "m", "status": status, "key": key}
    store.put(key, {"rows": [{**row, "value": value}, {**row, "recording": "r", "value": value}]})
    return key


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setattr(index, "FEW", 4)
    monkeypatch.setattr(index, "AT_ONCE", 8)
    made = Store(tmp_path)
    for number in range(16):
        put(made, number, float(number))
    return made


def plain(store, monkeypatch, name="rows", keys=None):
    """The same list, every cell read by itself."""
    with monkeypatch.context() as patch:
        patch.setattr(index, "FEW", 10**9)
        return store.table(name, keys)


def segments(store, name="rows"):
    return sorted((store.folder / index.INDEX / name).glob("*"))


def test_what_was_read_is_not_read_again(store, monkeypatch):
    expected = store.table("rows")
    assert expected == plain(store, monkeypatch)
    assert 1 <= len(segments(store)) <= 4
    monkeypatch.setattr("clothbench.engine.tables.read_table", lambda path: pytest.fail(f"{path} was read"))
    assert store.table("rows") == expected
    some = [f"{number:04x}" for number in (7, 3, 11, 5, 99)]
    assert [row["key"] for row in store.table("rows", some)] == [key for key in some[:4] for _ in range(2)]
    assert store.finished(some) == set(some[:4])


def test_cells_come_go_and_are_replaced(store, monkeypatch):
    """Changes by chance, some of them to the index itself; after each the list is that of the cells."""
    rng, value = np.random.default_rng(28), 100.0
    for _ in range(80):
        value += 1
        number = int(rng.integers(0, 20))
        cell = store.cell(f"{number:04x}")
        match int(rng.integers(0, 7)):
            case 0:
                put(store, number, None, "error")
            case 1 | 2:
                put(store, number, value) if not store.has(cell.name) else None
            case 3 if cell.is_dir():
                remove(cell)
            case 4 if cell.is_dir():  # made anew in the same moment, of the same size
                remove(cell)
                put(store, number, value)
            case 5 if found := segments(store):
                damage(found[int(rng.integers(0, len(found)))], rng)
            case 6 if found := segments(store):
                found[0].unlink()
        assert store.table("rows") == plain(store, monkeypatch)
    assert 1 <= len(segments(store)) <= 6


def remove(cell):
    for path in cell.iterdir():
        path.unlink()
    cell.rmdir()


def damage(segment, rng):
    content = bytearray(segment.read_bytes())
    if rng.random() < 0.3:
        content = content[: len(content) // 2]
    else:
        content[int(rng.integers(0, len(content)))] ^= 0xFF
    segment.write_bytes(content)


def test_a_damaged_segment_is_known_as_such_and_removed(store):
    expected = store.table("rows")
    folder = store.folder / index.INDEX / "rows"
    content = segments(store)[-1].read_bytes()
    other = folder / segments(store)[0].name.replace("1-", "1-0")
    other.write_bytes(content)  # whole, under a name that is not its own
    before = len(segments(store))
    assert len(segments_in(folder)) == before - 1
    assert not other.exists()
    assert store.table("rows") == expected


def with_head(table, head):
    return table.replace_schema_metadata(head)


def with_numbers(table, numbers):
    at = table.column_names.index(index.AT)
    return table.set_column(at, index.AT, pa.array((list(numbers) * table.num_rows)[: table.num_rows]))


@pytest.mark.parametrize(
    "change",
    [
        lambda table: with_head(table, None),
        lambda table: with_head(table, {"another": "head"}),
        lambda table: with_head(table, {index.HEAD: "no JSON"}),
        lambda table: with_head(table, {index.HEAD: "3"}),
        lambda table: with_head(table, {index.HEAD: '[["0000", 1, 2]]'}),
        lambda table: with_head(table, {index.HEAD: '[[["0000"], 1, 2, 3]]'}),
        lambda table: with_head(table, {index.HEAD: "[[7, 1, 2, 3]]"}),
        lambda table: with_head(table, {index.HEAD: "[" * 10**5}),
        lambda table: table.drop_columns([index.AT]),
        lambda table: table.append_column("suite", table["suite"]),
        lambda table: with_numbers(table, [10**6]),
        lambda table: with_numbers(table, [-1]),
        lambda table: with_numbers(table, [1, 0]),
        lambda table: with_numbers(table, [None]),
        lambda table: with_numbers(table, ["0"]),
        lambda table: table.set_column(0, "suite", pa.array([b"\xff"] * table.num_rows).view(pa.string())),
    ],
)
def test_what_is_no_segment_is_passed_over(store, change):
    """Of a folder that comes from elsewhere, whole and under the name of its bytes."""
    expected = store.table("rows")
    for path in segments(store):
        sink = pa.BufferOutputStream()
        pq.write_table(change(pq.read_table(path)), sink)
        path.unlink()
        (path.parent / index._name(content := sink.getvalue().to_pybytes())).write_bytes(content)
    assert segments_in(store.folder / index.INDEX / "rows") == []
    assert store.table("rows") == expected


def test_tables_of_other_columns_and_without_rows(store, monkeypatch):
    for number in range(16, 28):
        content = {
            0: pd.DataFrame({"a": [number, None]}),
            1: [],
            2: [{"b": "x", "c": [1.0, 2.0]}, {"b": None, "c": None}],
        }
        columns = {"more": {"a": pa.float64()}} if number % 3 == 1 else None
        row = {**dict.fromkeys(ROW), "suite": "s", "case": "c", "model": "m", "status": "ok", "key": f"{number:04x}"}
        store.put(f"{number:04x}", {"rows": [row], "more": content[number % 3]}, columns=columns)
    expected = plain(store, monkeypatch, "more")
    assert len(expected) == 16
    for _ in range(2):
        found = store.table("more")
        assert str(found) == str(expected)  # with NaN, which is not itself
        assert [list(row) for row in found] == [list(row) for row in expected]
    assert sum(len(s.cells) for s in segments_in(store.folder / index.INDEX / "more")) == 12


def test_a_column_that_is_declared_later_is_in_every_row(store):
    keys = [f"{number:04x}" for number in range(16)]
    old = {"key": pa.string(), "a": pa.float64()}
    for key in keys:
        store.put(f"f{key}", {"more": [{"key": key, "a": 1.0}]}, columns={"more": old})
    asked = [f"f{key}" for key in keys]
    assert store.table("more", asked, old)[0] == {"key": "0000", "a": 1.0}
    rows = store.table("more", asked, {**old, "b": pa.float64()})
    assert rows == [{"key": key, "a": 1.0, "b": None} for key in keys]
    assert store.table("more", asked, old)[3]["a"] == 1.0


def test_nothing_is_kept_where_nothing_can_be_written(store, monkeypatch):
    expected = plain(store, monkeypatch)
    (store.folder / index.INDEX).write_text("in the way")
    assert store.table("rows") == expected


def test_few_cells_have_no_index(tmp_path):
    store = Store(tmp_path)
    put(store, 1, 1.0)
    assert len(store.rows()) == 2
    assert os.listdir(tmp_path) == ["cells"]


@pytest.mark.parametrize(
    "values",
    [
        pa.array(["a", None, "", "a"]), pa.array([1, None, 2**60, -1]), pa.array([1.5, None, float("nan"), -0.0]),
        pa.array([True, None, False, True]), pa.nulls(4), pa.array([[1.0], None, [], [2.0]]),
        pa.array([1, 2, 3, 4], pa.int8()),
        pa.array(["a", "b", None, "a"]).dictionary_encode(), pa.array([0, 1, None, 3], pa.timestamp("ns")),
    ],
    ids=lambda values: str(values.type),
)  # fmt: skip
def test_rows_as_arrow_has_them(values):
    table = pa.table({"x": pa.chunked_array([values, values[:2]]), "y": pa.chunked_array([values, values[2:]])})
    assert str(dicts(table)) == str(table.to_pylist())
    assert str(dicts(table.slice(0, 0))) == "[]"


@pytest.mark.parametrize("rows", [[], [{"a": "x, y", "b": None}], [{"a": 'q"', "b": 1.5}, {"a": "ä: {}", "b": True}]])
def test_many_rows_are_printed_as_json_prints_them(rows, capsys):
    print_json(rows)
    print_json_rows(rows)
    out = capsys.readouterr().out
    assert out[: len(out) // 2] == out[len(out) // 2 :]
