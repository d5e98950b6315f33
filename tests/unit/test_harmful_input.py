"""Input that means harm: what was found with `tools/fuzz.py`, smallest as it can be, and a short run of it."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
import zlib

import cv2
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import swinging_recording

from clothbench import ClothbenchError, read_recording, write_recording
from clothbench.cli import main
from clothbench.cli.own_suites import each_choice, require_harmless, require_plain
from clothbench.core.errors import one_line
from clothbench.core.files import read_arrays, read_json
from clothbench.core.pictures import PNG, picture_of
from clothbench.datasets.depth_folder import read_folder
from clothbench.display.film import read_film
from clothbench.engine.leaderboard import ROW
from clothbench.engine.settings import KNOWN
from clothbench.engine.store import Store, load_rows
from clothbench.engine.suite import resolve
from clothbench.engine.tables import read_table, write_table
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.cell import asked_and_fitted
from clothbench.studies.calibration.matrix import one_way
from clothbench.twins.of_cell import _theta

# --- recordings -----------------------------------------------------------------------------------------------------


def elsewhere(file):
    del file["position"]
    file["position"] = h5py.ExternalLink("/etc/hostname", "/x")


def in_a_ring(file):
    del file["position"]
    file["position"] = h5py.SoftLink("/position")


def raw_bytes_of_another_file(file):
    of, shape = file["time"].dtype, file["time"].shape
    del file["time"]
    file.create_dataset("time", shape, of, external=[("/proc/self/environ", 0, h5py.h5f.UNLIMITED)])


def a_group(file):
    del file["time"]
    file.create_group("time")


def claimed(file):
    del file["time"]
    file.create_dataset("time", (10**9,), "f8", chunks=(1024,)).attrs["units"] = "s"


HARM = {
    "a link to another file": (elsewhere, "variable 'position': found a link"),
    "a link to itself": (in_a_ring, "variable 'position'"),
    "the bytes of another file": (raw_bytes_of_another_file, "values that lie in another file"),
    "a group": (a_group, "variable 'time': found a link, a group"),
    "a claim of 10⁹": (claimed, "variable 'time'"),
    "a reference": (lambda f: f.attrs.__setitem__("fabric", f.ref), "attribute 'fabric': found 1 values of object"),
    "an array for a text": (lambda f: f.attrs.__setitem__("format", np.arange(3.0)), "'format': found '0.0 1.0 2.0'"),
    "two marks for nothing": (lambda f: f["time"].attrs.__setitem__("_FillValue", [0.0, 1.0]), "'_FillValue'"),
    "coordinates of none": (lambda f: f["time"].attrs.__setitem__("coordinates", h5py.Empty("f")), None),
    "places beyond": (lambda f: f["position"].write_direct(np.full(f["position"].shape, 1e308)), "found 1e+308 m at"),
    "a weight of no cloth": (lambda f: f.attrs.__setitem__("areal_density", 1.7e308), "'areal_density': found 1.7e"),
    "grips beyond": (lambda f: f["grip_position"].__setitem__((1, 0, 2), -1e307), "found -1e+307 m at (1, 0, 2)"),
}  # fmt: skip


@pytest.mark.parametrize("harm", HARM)
def test_a_recording_is_valid_or_refused_in_one_line(tmp_path, capsys, harm):
    path = write_recording(swinging_recording(), tmp_path / "in.nc")
    change, found = HARM[harm]
    with h5py.File(path, "r+") as file:
        change(file)
    code = main(["validate", str(path)])
    said = capsys.readouterr()
    assert (said.err, said.out.count("\n")) == ("", 1)
    assert code == 0 if found is None else (code == 1 and found in said.out), said.out


def test_a_heap_of_texts_without_an_end_is_refused(tmp_path):
    """HDF5 itself never comes back from reading it, and cannot be interrupted."""
    path = write_recording(swinging_recording(), tmp_path / "in.nc")
    content = bytearray(path.read_bytes())
    first = content.index(b"GCOL") + 16
    content[first : first + 16] = bytes(16)
    path.write_bytes(content)
    with pytest.raises(ClothbenchError, match="found a heap of texts with an entry of 0 bytes"):
        read_recording(path)


def test_packed_values_are_unpacked_and_the_mark_for_nothing_is_nan(tmp_path):
    path = write_recording(swinging_recording(), tmp_path / "in.nc")
    before = read_recording(path)
    with h5py.File(path, "r+") as file:
        file["position"][...] = file["position"][...] * 1000
        file["position"][0, 0] = -1e9
        file["position"].attrs["scale_factor"] = 1e-3
        file["position"].attrs["_FillValue"] = -1e9
    after = read_recording(path)
    assert np.isnan(after.position[0, 0]).all()
    assert np.allclose(after.position[1:], before.position[1:])


# --- documents, arrays, tables --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["[" * 5000, "9" * 5000, "[NaN]", "[1e999]", '["\\ud800"]', "\xff", "{"], ids=lambda text: text[:6]
)
def test_a_document_is_json_or_refused_in_one_line(tmp_path, text):
    (tmp_path / "in.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(ClothbenchError, match=r"in\.json: found no JSON that can be read .* expected rows"):
        read_json(tmp_path / "in.json", "rows")


@pytest.mark.parametrize("value", [[], {}, "one", True, None, 3])
@pytest.mark.parametrize("name", ["value", "reference", "case", "seed", "status"])
def test_a_row_of_another_type_is_refused(tmp_path, capsys, name, value):
    row = {**dict.fromkeys(ROW), "suite": "s", "case": "c", "status": "ok", "value": 1.0, "low": 0.5, "high": 1.5}
    for file, rows in (("base.json", [row]), ("new.json", [{**row, name: value}])):
        (tmp_path / file).write_text(json.dumps(rows))
    code = main(["compare", str(tmp_path / "base.json"), str(tmp_path / "new.json")])
    said = capsys.readouterr().err
    assert code in (0, 1, 2)
    assert said.count("\n") == (code == 2)


ABOUT = {"study": "calibration", "split": "held_out", "seed": 1, "evaluations": 1, "wall_s": 1.0,
         "finished": "2026-01-01T00:00:00", "clothbench": "0"}  # fmt: skip


def whole_row(**changes):
    """A row that says all that the terminal's tables and the page show."""
    return {**row(recording="r", objective="m", metric="m", optimizer="o", unit="m"), **ABOUT, **changes}


@pytest.mark.parametrize("name", [n for n in ROW if n not in ("key", "effects", "status")])
def test_rows_in_which_something_is_missing_are_shown_all_the_same(tmp_path, capsys, name):
    rows = [whole_row() for _ in range(2)]
    Store(tmp_path).put("ab", {"rows": [rows[0] | {name: None}, rows[1]]})
    assert main(["leaderboard", "--out", str(tmp_path)]) == 0
    assert main(["report", f"out={tmp_path}"]) == 0


def test_a_table_that_says_nothing_of_its_cell_is_refused_and_of_another_left_out(tmp_path, capsys):
    rows, bars = [whole_row()], {"name": "k1", "percent": 1.0}
    for key, code in (("cd", 0), (None, 2)):
        Store(tmp_path / str(key)).put("ab", {"rows": rows, "variability": [{**bars, "key": key}]})
        assert main(["leaderboard", "--out", str(tmp_path / str(key))]) == code
        assert main(["report", f"out={tmp_path / str(key)}"]) == code
    assert "variability.parquet: column 'key': found nothing in a row" in capsys.readouterr().err


def test_a_version_is_no_markup_of_a_page(tmp_path):
    rows = [whole_row(clothbench="<img src=x>")]
    Store(tmp_path).put("ab", {"rows": rows})
    assert main(["report", f"out={tmp_path}"]) == 0
    assert "<img src=x>" not in (tmp_path / "report.html").read_text()


def test_rows_of_a_page_are_not_compared_each_with_each():
    """Of twenty thousand that would take minutes."""

    class Alone(dict):
        __hash__ = None

        def __eq__(self, other):
            pytest.fail("rows are compared")

    rows = [Alone(row(recording=f"r{n}", metric="m", unit="m", split="fit")) for n in range(3)]
    assert len(one_way("s", "m", rows, lambda suite, case: "").lines) == 1


@pytest.mark.parametrize("value", [-1.0, -1e300, np.inf, -np.inf])
def test_errors_that_none_can_be_are_shown_all_the_same(tmp_path, capsys, value):
    rows = [whole_row(recording=name, value=found) for name, found in (("a", value), ("b", 1.0), ("c", -value))]
    Store(tmp_path).put("ab", {"rows": rows})
    assert main(["leaderboard", "--out", str(tmp_path)]) == 0
    assert main(["report", f"out={tmp_path}"]) == 0


def test_a_parameter_without_a_name_is_shown_all_the_same(tmp_path, capsys):
    fitted = {"key": "ab", "name": None, "unit": "N/m", "value": 1.0, "low": 0.9, "high": 1.1, "at_bound": False}
    Store(tmp_path).put("ab", {"rows": [whole_row()], "parameters": [fitted]})
    assert main(["leaderboard", "--out", str(tmp_path)]) == 0
    assert main(["report", f"out={tmp_path}"]) == 0


def test_an_analysis_without_units_is_shown(tmp_path, capsys):
    rows = [whole_row()]
    Store(tmp_path).put("ab", {"rows": rows, "variability": [{"key": "ab", "case": None, "name": "k1", "value": 1.0}]})
    assert main(["leaderboard", "--out", str(tmp_path)]) == 0
    assert "k1" in capsys.readouterr().out


def test_texts_of_a_table_are_no_markup_of_the_terminal(tmp_path, capsys):
    names = {n: f"[/]{n}" for n in ("suite", "model", "optimizer", "metric", "unit", "recording")}
    rows = [row(**names, **ABOUT, objective=names["metric"], case=f"[/]{n}") for n in range(2)]
    Store(tmp_path).put("ab", {"rows": rows})
    assert main(["leaderboard", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "[/]suite: error" in said
    assert "1.00 [/]unit over 2 recordings ([/]model" in said


def test_texts_of_a_leaderboard_move_no_cursor(tmp_path):
    (tmp_path / "in.json").write_text(json.dumps([{"suite": "\x1b[2Js", "status": "ok", "value": 1}]))
    assert load_rows(tmp_path / "in.json")[0]["suite"] == "\ufffd[2Js"


@pytest.mark.parametrize("character", ["\x00", "\x1b", "\x7f", "\x9b", "\u202e", "\u2066"])
def test_texts_of_a_table_move_no_cursor(tmp_path, character):
    Store(tmp_path).put("ab", {"rows": [row(case=f"é{character}"), row(case="µ, ‰ and \t")]})
    assert {r["case"] for r in Store(tmp_path).rows()} == {"é\ufffd", "µ, ‰ and \t"}


def row(**changes):
    return {**dict.fromkeys(ROW), "suite": "s", "case": "c", "model": "m", "effects": "", "status": "ok", "key": "ab",
            "value": 1.0, **changes}  # fmt: skip


@pytest.mark.parametrize(
    ("column", "found"),
    [
        (pa.array([["a"]]), "column 'case': found list<"), (pa.array([1.5]), "column 'case': found double"),
        (pa.array([b"cos\nsystem\n"]), "column 'case': found binary"),
    ],
)  # fmt: skip
def test_a_table_with_another_type_is_refused(tmp_path, column, found):
    store = Store(tmp_path)
    store.put("ab", {"rows": [row()]})
    path = store.cell("ab") / "rows.parquet"
    table = pq.read_table(path)
    pq.write_table(table.set_column(table.column_names.index("case"), "case", column), path)
    with pytest.raises(ClothbenchError, match=found):
        store.rows()


def test_a_table_that_claims_a_thousand_million_values_is_refused(tmp_path):
    pq.write_table(pa.table({"a": pa.nulls(20_000_000, pa.bool_())}), tmp_path / "in.parquet")
    with pytest.raises(ClothbenchError, match=r"found a claim of 20000000 values in a file of \d+ bytes"):
        read_table(tmp_path / "in.parquet")


@pytest.mark.parametrize("key", ["../../elsewhere", "AB", ""])
def test_a_row_that_names_no_cell_is_not_followed(tmp_path, capsys, key):
    Store(tmp_path).put("ab", {"rows": [{**row(key=key), "finished": "2026-01-01T00:00:00", "clothbench": "0"}]})
    for command in (["leaderboard", "--out"], ["store", "check"]):
        assert main([*command, str(tmp_path)]) in (1, 2)
    assert "found a row of 'c' with" in capsys.readouterr().err


def test_pickles_bombs_and_claims_are_no_arrays(tmp_path):
    np.save(tmp_path / "pickle.npy", np.array([{}], object), allow_pickle=True)
    header = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000,), }"
    (tmp_path / "claim.npy").write_bytes(header.ljust(127) + b"\n" + bytes(80))
    with zipfile.ZipFile(tmp_path / "dense.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a.npy", header.ljust(127) + b"\n")
    (tmp_path / "no.npz").write_bytes(b"PK")
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises((ValueError, zipfile.BadZipFile)):
            read_arrays(path)
        with pytest.raises(ClothbenchError, match="found a damaged film"):
            read_film(path)


def test_arrays_that_an_old_python_wrote_are_read_in_silence(tmp_path):
    header = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (2L,), }"
    (tmp_path / "old.npy").write_bytes(header.ljust(127) + b"\n" + np.array([1.0, 2.0]).tobytes())
    assert read_arrays(tmp_path / "old.npy")["array"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("rate", ["1e-320", "1e308", "nan", "-1", "9" * 400])
def test_a_marker_file_of_no_possible_rate_is_refused(tmp_path, rate):
    from clothbench_trackers.markers import Markers

    rows = "".join(f"{k},{k / 100},0,0,{k}\n" for k in range(5))
    (tmp_path / "in.csv").write_text(f"# unit: mm\n# rate: {rate}\nframe,time,a_x,a_y,a_z\n{rows}")
    with pytest.raises(ClothbenchError, match=r"in\.csv: (rate|time): found"):
        Markers(material={"a": (0, 0)}).track(tmp_path / "in.csv")


@pytest.mark.parametrize("rate", ["1e-320", "0", "-1", "[]", '"fast"'])
def test_frames_of_no_possible_rate_are_refused(tmp_path, rate):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "0.png").write_bytes(picture())
    camera = '{"size": [8, 8], "fx": 20, "fy": 20, "cx": 3.5, "cy": 3.5}'
    text = f'{{"name": "c", "cloth_width": 0.2, "cloth_height": 0.2, "rate": {rate}, "camera": {camera}}}'
    (tmp_path / "recording.json").write_text(text)
    with pytest.raises(ClothbenchError, match=r"recording\.json: 'rate': found"):
        read_folder(tmp_path)


def test_a_picture_that_claims_more_bytes_than_it_has_is_none(monkeypatch):
    whole = picture()
    place = whole.index(b"IDAT") - 4
    claiming = whole[:place] + (2**31 + 38).to_bytes(4, "big") + whole[place + 4 :]
    assert picture_of(whole, cv2.IMREAD_UNCHANGED).shape == (8, 8)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("OpenCV was asked for room for 2 GB"))
    assert picture_of(claiming, cv2.IMREAD_UNCHANGED) is None


def test_a_picture_of_more_pixels_than_any_camera_has_is_none(tmp_path):
    side = 12_000  # 144 MB of black in a file of 140 kB
    header = side.to_bytes(4, "big") * 2 + bytes([8, 0, 0, 0, 0])
    black = zlib.compress(bytes(side * (side + 1)), 1)
    chunks = [
        len(of).to_bytes(4, "big") + kind + of + zlib.crc32(kind + of).to_bytes(4, "big")
        for kind, of in ((b"IHDR", header), (b"IDAT", black), (b"IEND", b""))
    ]
    (tmp_path / "black.png").write_bytes(PNG + b"".join(chunks))
    code = "import sys; from clothbench.core.pictures import *; print(picture_of(Path(sys.argv[1]), -1) is None)"
    command = [sys.executable, "-c", code, str(tmp_path / "black.png")]  # OpenCV asks when it is loaded
    assert subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout == "True\n"


def picture() -> bytes:
    """A PNG of 8 × 8 px of 16 bit."""
    return cv2.imencode(".png", np.full((8, 8), 500, np.uint16))[1].tobytes()


@pytest.mark.parametrize("missing", ["name", "value"])
def test_a_fit_without_values_is_refused(tmp_path, missing):
    cell = tmp_path / "cells" / "e6427d47f5f2b72c"
    cell.mkdir(parents=True)
    there = {"name": "k1", "value": 1.0, "key": cell.name}
    write_table(cell / "parameters.parquet", [{name: value for name, value in there.items() if name != missing}])
    write_table(cell / "question.parquet", [{"question": "{}", "key": cell.name}])
    with pytest.raises(ClothbenchError, match="found a parameter without name or value"):
        asked_and_fitted(Store(tmp_path), cell.name)


# --- suites ---------------------------------------------------------------------------------------------------------

HYDRAS = {
    "builds objects": "callbacks: {mine: {_target_: shutil.rmtree, path: x}}",
    "builds loggers": "job_logging: {handlers: {mine: {(): os.system}}}",
    "writes elsewhere": "run: {dir: elsewhere}",
    "sets the environment": "job: {env_set: {LD_PRELOAD: mine.so}}",
}


@pytest.mark.parametrize(("harm", "flag"), list(zip(HYDRAS, ["--config-dir=conf", "-cd conf"] * 2, strict=True)))
def test_a_suite_from_a_folder_sets_nothing_of_hydras(clothbench, tmp_path, harm, flag):
    (tmp_path / "conf" / "suite").mkdir(parents=True)
    text = f"# @package _global_\nsuite: {{name: mine}}\nhydra:\n  {HYDRAS[harm]}\n"
    (tmp_path / "conf" / "suite" / "mine.yaml").write_text(text)
    done = clothbench("run", *flag.split(), "+suite=mine")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert "found settings of Hydra's own in a suite (hydra." in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["conf"]


@pytest.mark.parametrize("words", [["--config-di", "conf"], ["--config-di=conf"], ["--config-p", "conf"]])
def test_a_flag_cut_short_is_refused(capsys, words):
    assert main(["run", *words, "+suite=mine"]) == 2
    said = capsys.readouterr().err
    assert (said.count("\n"), "write that flag in full" in said) == (1, True), said


def test_a_place_of_a_list_that_is_no_number_is_refused(capsys):
    assert main(["run", "effects.first=[gravity_tilt]"]) == 2
    assert capsys.readouterr().err == (
        "clothbench: found a setting without a place (invalid literal for int() with base 10: 'first'), expected "
        "KEY=VALUE of a run\n"
    )


def test_a_setting_that_refers_to_none_is_refused(capsys):
    assert main(["run", "+bounds.k1=${sue}"]) == 2
    said = capsys.readouterr().err
    assert (said.count("\n"), said[:48]) == (1, "clothbench: Interpolation key 'sue' not found fu"), said


def test_a_place_of_results_moves_no_cursor(capsys):
    words = ["model=mass_spring", "optimizer=ga", "metric=node_error", "recordings=builtin:static_dynamic"]
    assert main(["run", *words, "out=\x1b[31mred"]) == 2
    said = capsys.readouterr().err
    assert (said.count("\n"), "whose name a terminal can show" in said) == (1, True), said


def test_a_name_that_is_a_number_is_refused():
    with pytest.raises(ClothbenchError, match=r"no tracker named 0\.5"):
        catalogue().find("trackers", 0.5)


@pytest.mark.parametrize(
    "word", ["recordings=pkg://", "recordings=pkg://.os/", f"recordings={'a' * 300}", f"recording={'a' * 300}"]
)
def test_recordings_that_can_be_nowhere_are_refused(capsys, word):
    assert main(["run", "model=mass_spring", "optimizer=ga", "metric=node_error", word]) == 2
    said = capsys.readouterr().err
    assert (said.count("\n"), said[:12]) == (1, "clothbench: "), said


def test_recordings_in_a_package_are_found_without_importing_it(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(tmp_path)
    harmful = f"open({str(tmp_path / 'harm')!r}, 'w')"
    (tmp_path / "evil_module.py").write_text(harmful)
    for folder in ("evil_package/data", "evil_package/inner/data"):
        (tmp_path / folder).mkdir(parents=True)
    for package in ("evil_package", "evil_package/inner"):
        (tmp_path / package / "__init__.py").write_text(harmful)
    assert resolve("pkg://evil_package/data", {}) == [tmp_path / "evil_package" / "data"]
    assert resolve("pkg://evil_package.inner/data", {}) == [tmp_path / "evil_package" / "inner" / "data"]
    for word in ("pkg://evil_module/data", "pkg://evil_module.inner/data", "pkg://evil_package.none/data"):
        with pytest.raises(ClothbenchError, match=r"found no package '.*'; install the package that has them"):
            resolve(word, {})
    assert not (tmp_path / "harm").exists()


def test_a_place_of_results_whose_name_is_too_long_is_refused(tmp_path, capsys):
    write_recording(swinging_recording(), tmp_path / "in.nc")
    words = [f"recording={tmp_path / 'in.nc'}", "model=mass_spring", "optimizer=ga", "metric=node_error", "jobs=1"]
    assert main(["run", *words, f"out={tmp_path / ('a' * 300)}"]) == 2
    said = capsys.readouterr().err
    assert (said.count("\n"), "File name too long" in said) == (1, True), said


@pytest.mark.parametrize("name", sorted(KNOWN - {"study", "suite"}))
def test_a_setting_may_be_taken_out(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    write_recording(swinging_recording(), tmp_path / "in.nc")
    monkeypatch.setattr("clothbench.cli.run.run_cells", lambda *_, **__: None)
    words = ["recording=in.nc", "model=mass_spring", "optimizer=ga", "metric=node_error"]
    code = main(["run", *(word for word in words if not word.startswith(f"{name}=")), f"~{name}"])
    assert (code, capsys.readouterr().err.count("\n")) in ((0, 0), (2, 1))


def test_a_suite_that_does_not_say_where_its_settings_belong_is_told_the_line(tmp_path):
    (tmp_path / "suite").mkdir()
    file, words = tmp_path / "suite" / "mine.yaml", ["--config-dir", str(tmp_path), "+suite=mine"]
    file.write_text("# my suite\nsuite: {name: mine}\nmodel: mass_spring\n")
    with pytest.raises(
        ClothbenchError, match=r"mine\.yaml: found 'suite' and no line '# @package _global_', expected it"
    ):
        require_harmless(words)
    require_harmless([*words[:2], "+suite@_global_=mine"])
    file.write_text("# my suite\n# @package _global_\nsuite: {name: mine}\n")  # where Hydra does not see it
    with pytest.raises(ClothbenchError, match="expected it as the file's first line"):
        require_harmless(words)
    for text in ("\n#@package _global_\nsuite: {name: mine}\n", "name: mine\ntitle: Hydra puts it where it belongs\n"):
        file.write_text(text)
        require_harmless(words)


@pytest.mark.parametrize("text", ["a: [", "a: \x00", "&a [*a]", "\xff: 1"])
def test_a_file_that_is_no_yaml_is_refused(tmp_path, text):
    (tmp_path / "in.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(ClothbenchError, match=r"in\.yaml: found"):
        require_plain(tmp_path / "in.yaml")


def test_aliases_that_fill_the_memory_are_counted_and_not_followed(tmp_path):
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
    (tmp_path / "in.yaml").write_text("\n".join(lines))
    with pytest.raises(ClothbenchError, match="found more than 100000 values"):
        require_plain(tmp_path / "in.yaml")


def test_every_suite_of_a_sweep_is_looked_at():
    words = ["-m", "--config-dir", "conf", "+suite=a,b,c", "seed=1,2", "hydra/launcher=joblib"]
    assert list(each_choice(words)) == [["+suite=a", "seed=1"], ["+suite=b", "seed=2"], ["+suite=c", "seed=2"]]


# --- lines ----------------------------------------------------------------------------------------------------------


def test_an_error_is_one_line_that_a_terminal_shows_as_it_is():
    assert one_line("a\n  b\x1b[31m\u202ec\udc80") == "a b\ufffd[31m\ufffdc\ufffd"
    assert str(ClothbenchError("found " + "x" * 10**6 + ", expected less")).endswith("x, expected less")
    assert len(str(ClothbenchError("x" * 10**6))) < 2000


# --- the fuzzer -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_short_run_of_the_fuzzer_finds_nothing(tmp_path):
    pytest.importorskip("resource", reason="memory is bounded on POSIX only")
    import fuzz

    tallies = fuzz.fuzz(fuzz.kinds_known(), 600, 28, tmp_path, most=5, together=True)
    assert fuzz.finds(tallies) == []
    assert min(tally.done for tally in tallies.values()) == 5


def test_a_fit_that_no_search_can_leave_is_not_exported():
    """Found by the fuzzer: a stiffness of 0 N/m in a cell's table was divided by."""
    model = catalogue().make("models", "mass_spring")
    with pytest.raises(ClothbenchError, match=r"parameter k1: found 0, expected more than 0 N/m"):
        _theta(model, {"k1": 0.0})
