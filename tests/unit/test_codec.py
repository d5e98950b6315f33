"""A kind of recording is a record and its tables: the codec reads, writes and hashes a kind it has never seen."""

from dataclasses import dataclass, field, replace

import h5netcdf.legacyapi
import numpy as np
import pytest

from clothbench import ClothbenchError
from clothbench.recordings.codec import freeze, hash_of, read, write
from clothbench.recordings.kinds import READERS, read_any, reader_of
from clothbench.recordings.layout import KINDS, Layout, Part, Variable


def _wind(arrays, stated, path) -> float | None:
    return float(stated["wind_speed"]) if "wind_speed" in stated else None


WIND = Part({}, ("wind_speed",), lambda value: ({}, {"wind_speed": value}), _wind)
LAYOUT = Layout(
    kind="counts",
    variables={"time": Variable(("time",), "s"), "count": Variable(("time", "y"), "1", np.uint16, level=1)},
    texts=("name", "place"),
    numbers=("height",),
    vectors={"gravity": "three numbers"},
    parts={"wind": WIND},
)


@dataclass(frozen=True, eq=False)
class Counts:
    name: str
    time: np.ndarray
    count: np.ndarray
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    height: float = np.nan
    place: str = ""
    wind: float | None = None
    notes: dict[str, str] = field(default_factory=dict)
    path: str = ""

    def __post_init__(self) -> None:
        freeze(self, LAYOUT)


def counts(**changes) -> Counts:
    return replace(Counts("a", np.arange(2.0), np.array([[1, 2, 3], [4, 5, 60000]])), **changes)


def test_a_record_comes_back_as_it_was_written(tmp_path):
    made = counts(place="field", height=1.5, wind=3.0, notes={"crew": "two"})
    back = read(write(made, tmp_path / "a.nc", LAYOUT), LAYOUT, Counts)
    assert hash_of(back, LAYOUT) == hash_of(made, LAYOUT)
    assert (back.name, back.place, back.height, back.gravity, back.wind) == ("a", "field", 1.5, (0, 0, -9.81), 3.0)
    assert back.notes == {"crew": "two"}
    assert back.count.dtype == np.uint16
    assert not back.count.flags.writeable
    np.testing.assert_array_equal(back.count, made.count)


def test_a_part_that_is_not_there_leaves_no_trace(tmp_path):
    path = write(counts(), tmp_path / "a.nc", LAYOUT)
    assert read(path, LAYOUT, Counts).wind is None
    with h5netcdf.legacyapi.Dataset(path) as stream:
        assert "wind_speed" not in stream.ncattrs()


@pytest.mark.parametrize(
    "change",
    [{"count": np.ones((2, 3))}, {"time": np.array([0.0, 2.0])}, {"place": "b"}, {"height": 2.0}, {"wind": 1.0},
     {"gravity": (0.0, 0.0, -1.6)}, {"notes": {"crew": "one"}}],
)  # fmt: skip
def test_the_hash_is_over_everything(change):
    assert hash_of(counts(**change), LAYOUT) != hash_of(counts(), LAYOUT)


@pytest.mark.parametrize("name", ["place", "wind_speed", "count", "kind"])
def test_a_note_that_would_be_read_as_something_else_is_not_written(tmp_path, name):
    made = counts(notes={name: "two"})
    with pytest.raises(ClothbenchError, match=f"^a: note '{name}': found a word that recordings of kind 'counts' have"):
        write(made, tmp_path / "a.nc", LAYOUT)
    with pytest.raises(ClothbenchError, match="rename the note"):
        hash_of(made, LAYOUT)


@pytest.mark.parametrize("value", [0.5, -1.0, 65536.0, np.nan])
def test_whole_numbers_are_not_rounded_nor_clipped(tmp_path, value):
    as_numbers = replace(LAYOUT, variables={**LAYOUT.variables, "count": Variable(("time", "y"), "1")})
    made = counts()
    object.__setattr__(made, "count", np.full((2, 3), value))
    path = write(made, tmp_path / "a.nc", as_numbers)
    with pytest.raises(ClothbenchError, match="found other values than whole numbers from 0 to 65535"):
        read(path, LAYOUT, Counts)


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (lambda f: f["count"].attrs.update(_FillValue=np.uint16(0)),
         "variable 'count': found an attribute '_FillValue', expected none: its uint16 are taken as they stand"),
        (lambda f: f.attrs.update(format_version="1"),
         "'format_version': found the text '1', expected the number 1; write it as a number"),
    ],
)  # fmt: skip
def test_what_is_refused_is_what_is_wrong(tmp_path, spoil, found):
    import h5py

    exact = replace(
        LAYOUT, variables={**LAYOUT.variables, "count": Variable(("time", "y"), "1", np.uint16, exact=True)}
    )
    path = write(counts(), tmp_path / "a.nc", exact)
    with h5py.File(path, "a") as file:
        spoil(file)
    with pytest.raises(ClothbenchError) as caught:
        read(path, exact, Counts)
    assert found in str(caught.value)


def test_every_kind_in_the_table_has_its_reader(tmp_path):
    for kind in READERS:
        assert callable(reader_of(kind))
    assert set(READERS) == set(KINDS)
    known = ", ".join(map(repr, KINDS))
    with pytest.raises(ClothbenchError, match=f"attribute 'kind': found 'counts', expected one of {known}$"):
        read_any(write(counts(), tmp_path / "a.nc", LAYOUT))
