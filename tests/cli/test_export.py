"""`clothbench export`: from a fit to a file; whatever is wrong is one line, and nothing is half-written."""

from __future__ import annotations

import dataclasses
import json
import os
from types import SimpleNamespace

import pyarrow.parquet as parquet
import pytest
from conftest import swinging_recording

from clothbench import ClothbenchError, Material, write_recording
from clothbench.cli import export as command
from clothbench.cli.view import find_cell
from clothbench.engine.store import Store
from clothbench.twins.of_cell import FittedCell, _together, twin_of_cell

CELL = ("model=baraff_witkin", "optimizer=ga", "metric=node_error", "+options.baraff_witkin.resolution=5", "budget=8")
ORTHOTROPIC = "+options.baraff_witkin.orthotropic=true"


@pytest.fixture
def fitted(clothbench, tmp_path):
    """A folder with the results of one cell."""
    write_recording(swinging_recording(), tmp_path / "swing.nc")
    done = clothbench("run", *CELL, ORTHOTROPIC, "effects=[added_mass]", "recording=swing.nc", "rerun=false")
    assert done.returncode == 0, done.stderr
    return tmp_path


def test_what_was_held_keeps_its_unit_and_is_called_so(fitted, monkeypatch):
    monkeypatch.chdir(fitted)
    fit = FittedCell.of(fitted / "runs", find_cell(fitted / "runs", "paper").name)
    name = "added_mass.areal_density"
    store = SimpleNamespace(rows=lambda keys: fit.store.rows([fit.cell.key]))  # whose key holds what is fixed
    cell, rows = dataclasses.replace(fit.cell, fixed={name: 0.1}), [r for r in fit.fitted if r["name"] != name]
    held = dataclasses.replace(fit, store=store, cell=cell, fitted=rows)
    twin = twin_of_cell(held)
    assert twin.others[name] == (0.1, "kg/m²")
    assert twin.provenance["held"] == [name]
    assert "held" not in twin_of_cell(fit).provenance


@pytest.mark.slow
def test_a_fit_leaves_with_units_intervals_and_provenance(clothbench, fitted):
    done = clothbench("export", "paper", "--to", "json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads((fitted / "paper.json").read_text())
    assert document["material"]["stretch"]["unit"] == "N/m"
    low, high = (document["material"]["stretch"][end] for end in ("low", "high"))
    assert low <= document["material"]["stretch"]["value"] <= high
    ratio = document["material"]["bending_ratio"]
    assert ratio["unit"] == "1"
    assert ratio["low"] < ratio["high"]
    assert document["provenance"]["recordings"] == {"swing": swinging_recording().hash}
    assert document["provenance"]["model"].startswith("baraff_witkin (clothbench")
    added = document["others"]["added_mass.areal_density"]
    assert added["unit"] == "kg/m²"
    assert added["low"] <= added["value"] <= added["high"]
    assert document["schema"] == 1
    assert (document["provenance"]["seed"], document["provenance"]["budget"]) == (0, 8)

    done = clothbench("export", "paper", "--to", "mujoco", "--out", "deep/cloth.xml")
    assert done.returncode == 0, done.stderr
    assert (fitted / "deep" / "cloth.xml").read_text().startswith("<!--\nclothbench export: paper")
    assert "not held: shear: MuJoCo has no parameter of its own" in done.stderr
    assert "altogether this moves baraff_witkin's own sheet by" in done.stderr

    os.mkfifo(fitted / "pipe")
    for arguments, found in (
        (("paper", "--to", "json", "--out", "pipe"), "pipe: found a device, pipe or socket, expected a file"),
        (("nothing", "--to", "json"), "there are: paper, swing; a class of fabrics"),
        (("paper", "--to", "bullet"), "no exporter named 'bullet'"),
        (("paper", "--to", "json", "--out", "deep"), "is a folder"),
        (("paper", "--to", "json", "--out", "swing.nc/cloth.json"), "swing.nc"),
        (("paper", "--to", "json", "--runs", "nowhere"), "nowhere"),
    ):
        before = sorted(p.name for p in fitted.rglob("*"))
        done = clothbench("export", *arguments)
        assert done.returncode == 2, done.stderr
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr
        assert found in done.stderr
        assert sorted(p.name for p in fitted.rglob("*")) == before

    (rows,) = fitted.glob("runs/cells/*/rows.parquet")
    whole = rows.read_bytes()
    nothing = parquet.read_table(rows).slice(0, 0)
    rows.unlink()
    parquet.write_table(nothing, rows)
    done = clothbench("export", rows.parent.name, "--to", "json")
    assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1)
    assert "found no rows of this cell" in done.stderr
    rows.write_bytes(whole)

    elsewhere = fitted / "elsewhere"
    elsewhere.mkdir()
    runs = ("--to", "json", "--runs", str(fitted / "runs"))
    done = clothbench("export", "paper", *runs, cwd=elsewhere)
    assert (done.returncode, done.stderr) == (0, "")
    (fitted / "swing.nc").rename(elsewhere / "moved.nc")
    done = clothbench("export", "paper", *runs)
    assert done.returncode == 2
    assert "swing.nc: cell " in done.stderr
    assert "it is not there any more; say where it lies with --recordings PATH" in done.stderr
    done = clothbench("export", "paper", *runs, "--recordings", "elsewhere")
    assert (done.returncode, done.stderr) == (0, "")
    done = clothbench("export", "denim", *runs, "--recordings", "elsewhere")
    assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1)


def test_a_quantity_that_the_recordings_leave_open_is_called_so(fitted, monkeypatch):
    monkeypatch.chdir(fitted)
    store = Store(fitted / "runs")
    (row,) = store.rows()[:1]
    fit = FittedCell.of(fitted / "runs", row["key"])
    wide = [
        {**r, "low": r["lower"], "high": r["upper"], "at_bound": False} if r["name"] == "bend" else
        {**r, "low": 0.9 * r["value"], "high": 1.1 * r["value"], "at_bound": False} for r in fit.fitted
    ]  # fmt: skip
    twin = twin_of_cell(dataclasses.replace(fit, fitted=wide))
    assert (twin.determined["bending"], twin.determined["stretch"]) == (False, True)
    assert "not determined" in twin.interval("bending")
    assert any(line.startswith("bending:") and "not determined" in line for line in twin.about())
    at_bound = [{**r, "at_bound": r["name"] == "stretch"} for r in wide]
    assert not twin_of_cell(dataclasses.replace(fit, fitted=at_bound)).determined["stretch"]


def test_what_cannot_be_reckoned_is_said_so_and_nothing_is_written_before_it(fitted, monkeypatch):
    monkeypatch.chdir(fitted)
    key = Store(fitted / "runs").rows()[0]["key"]
    fit = FittedCell.of(fitted / "runs", key)
    twin = twin_of_cell(fit)
    assert (twin.nulls["added_mass.areal_density"], twin.places["added_mass.areal_density"]) == (0.0, "dynamics")
    (trial,) = fit.bench.trials

    class Broken:
        parameters = trial.simulation.parameters

        def run(self, theta):
            return dataclasses.replace(trial.simulation.run(theta), status=("diverged",), reasons=("it flew off",))

    assert command.altogether(fit, twin.material).endswith("mm (mean, swing)")
    around = dataclasses.replace(fit, scene=dataclasses.replace(fit.scene, thickness=1e-3))
    assert command.altogether(around, twin.material).endswith("mm (mean, swing; thickness as recorded)")
    broken = dataclasses.replace(fit.bench, trials=(dataclasses.replace(trial, simulation=Broken()),))
    line = command.altogether(dataclasses.replace(fit, bench=broken), twin.material)
    assert line.endswith("not reckoned: the fit could not be simulated (it flew off)")

    def refused(material, scene):
        raise ClothbenchError("no such cloth")

    monkeypatch.setattr(fit.model, "of_material", refused)
    assert command.altogether(fit, Material(1e-5, 100.0, 20.0)).endswith("not reckoned: no such cloth")
    monkeypatch.setattr(command, "brought", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        command.export(key, "mujoco", fitted / "runs", fitted / "cloth.xml")
    assert not (fitted / "cloth.xml").exists()


def test_a_fit_with_a_fault_is_no_class_of_fabrics(monkeypatch, tmp_path):
    def gone(out, key, named):
        raise ClothbenchError("its recording has gone")

    monkeypatch.setattr(command, "find_cell", lambda results, name: tmp_path)
    monkeypatch.setattr(command.FittedCell, "of", gone)
    with pytest.raises(ClothbenchError, match="its recording has gone"):
        command.fitted("denim", tmp_path)


def test_parameters_that_move_one_quantity_are_taken_together():
    assert _together(8.0, [4.0, 4.0], [16.0, 8.0]) == pytest.approx((8.0 / 2**2**0.5, 16.0))
    assert _together(0.0, [-3.0, 0.0], [0.0, 4.0]) == pytest.approx((-3.0, 4.0))


def test_a_recording_goes_by_its_last_name_where_that_is_enough(fitted, monkeypatch):
    rows = [{**r, "recording": r["recording"] and f"paper/{r['recording']}"} for r in Store(fitted / "runs").rows()]
    monkeypatch.setattr(Store, "rows", lambda self: rows)
    assert find_cell(fitted / "runs", "swing").name == rows[0]["key"]
    monkeypatch.setattr(Store, "rows", lambda self: [*rows, *({**r, "recording": "denim/swing"} for r in rows)])
    with pytest.raises(ClothbenchError, match="there are: paper, denim/swing, paper/swing"):
        find_cell(fitted / "runs", "swing")


def test_a_name_goes_before_the_beginning_of_a_key(fitted, monkeypatch):
    (key,) = {r["key"] for r in Store(fitted / "runs").rows()}
    other = ("0" if key[0] != "0" else "1") * 16
    (fitted / "runs" / "cells" / other).mkdir()
    assert find_cell(fitted / "runs", other[:3]).name == other
    rows = [{**r, "recording": r["recording"] and f"paper/{other[0]}"} for r in Store(fitted / "runs").rows(every=True)]
    monkeypatch.setattr(Store, "rows", lambda self: rows)
    assert find_cell(fitted / "runs", other[0]).name == key
    assert find_cell(fitted / "runs", other[:2]).name == other
    monkeypatch.setattr(Store, "rows", lambda self: [{**r, "case": other} for r in rows])
    assert find_cell(fitted / "runs", other).name == other


def test_a_cell_and_a_class_of_fabrics_of_one_name_are_told_apart(tmp_path, monkeypatch, capsys):
    """The cell is taken, as ever, and the line says how the class is named."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "find_cell", lambda results, name: results / "cells" / "0123456789abcdef")
    monkeypatch.setattr(command.FittedCell, "of", lambda results, key, named: key)
    assert command.fitted("linen", tmp_path) == "0123456789abcdef"
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "linen: taken for the cell 0123456789abcdef of" in said
    assert "the class of fabrics is preset:linen" in said
    assert command.export("preset:linen", "mujoco", tmp_path, None) == 0
    assert (tmp_path / "linen.xml").is_file()
    with pytest.raises(ClothbenchError, match="no preset 'nylon'"):
        command.export("preset:nylon", "mujoco", tmp_path, None)
