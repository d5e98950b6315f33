"""Force-extension curves on the command line: import, validate, improve, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from clothbench import Curve, read_curve, write_curve
from clothbench.engine.bucket import Bucket

LINE = np.linspace(1.0, 1.5, 300)


def only_line(text: str) -> str:
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    return lines[0]


def pulled(name: str, seed: int, **changes) -> Curve:
    """A knit that locks, with 0.05 N of noise."""
    noise = np.random.default_rng(seed).normal(0, 0.05, LINE.size)
    force = 20 * (LINE - 1) + 0.05 * np.expm1(10 * (LINE - 1)) + noise
    content = {"name": name, "stretch": LINE, "force": force, "fabric": "rib", "direction": "wale"}
    return Curve(**{**content, **changes})


@pytest.fixture
def curves(tmp_path) -> Path:
    for number in range(4):
        write_curve(pulled(f"run{number}", number), tmp_path / "rib" / f"run{number}.nc")
    return tmp_path / "rib"


def swatch(folder: Path, name: str, *, readings: dict[int, float] | None = None, points: int = 7) -> Path:
    """An HDF5 file as the laboratory stored them: two videos of a swatch 200 px long, drawn to 300."""
    folder.mkdir(exist_ok=True)
    with h5py.File(folder / name, "w") as stream:
        stream["clampSize"], stream["fabricSize"] = [160.0], [400.0]
        for number in (1, 2):
            drawn = np.repeat(np.linspace(0, 100, 40), 5)
            force = 0.1 * drawn + 1e-6 * drawn**3
            for frame, value in (readings or {}).items():
                force[frame] = value
            track = np.zeros((points, 2, drawn.size))
            heights = (110 + drawn / 2, 110 + drawn / 2, 190 + 0.8 * drawn, 30 + 0 * drawn, 110 + drawn / 2,
                       210 + drawn, 10 + 0 * drawn)  # fmt: skip
            for point, height in zip(range(points), heights, strict=False):
                track[point, 0], track[point, 1] = 100.0, height
            group = stream.create_group(f"video{number}")
            group["forces"], group["traj"], group["frames"] = force, track, np.arange(1.0, drawn.size + 1)
    return folder / name


def test_import_refuses_bytes_that_are_not_the_registrys(clothbench, tmp_path):
    swatch(tmp_path / "lab", "outputData_Acrylic Yarn Rib X.h5")
    out = clothbench("import", "knit_uniaxial_gatech", "data_dir=lab", "out=knits")
    assert out.returncode == 0, out.stderr
    report = json.loads((tmp_path / "knits" / "import-report.json").read_text())["recordings"]
    wrong = "outputData_Acrylic Yarn Rib X.h5: SHA-256 differs from the registry's; fetch it again"
    assert report[0]["skipped"] == wrong  # a name that the registry knows, with other bytes


def test_import_makes_a_folder_for_each_stitch_and_direction(clothbench, tmp_path):
    swatch(tmp_path / "lab", "outputData_Pearlized Cotton Rib X.h5", readings={100: 0.3})
    swatch(tmp_path / "lab", "outputData_Pearlized Cotton Seed Y.h5", points=6)
    out = clothbench("import", "knit_uniaxial_gatech", "data_dir=lab", "out=knits")
    assert out.returncode == 0, out.stderr
    assert "next: clothbench improve recordings=knits/pearlized-cotton-rib-course model=linear_stretch" in out.stdout
    curve = read_curve(tmp_path / "knits" / "pearlized-cotton-rib-course" / "run1.nc")
    assert (curve.fabric, curve.direction, len(curve.stretch)) == ("pearlized cotton rib", "course", 199)
    assert (curve.stretch[0], curve.stretch[-1]) == (1.0, 1.5)
    assert curve.notes["width_over_length"] == "2.0000"
    assert curve.licence == "MIT"
    assert np.isnan(curve.sample_width)
    report = json.loads((tmp_path / "knits" / "import-report.json").read_text())["recordings"]
    assert report[0]["dropped"] == {"reading apart from its neighbours": 1}
    assert report[0]["notes"] == ["outputData_Pearlized Cotton Rib X.h5 is not in the registry: not verified"]
    assert "found shape (6, 2, 200), expected (7, 2, 200)" in report[2]["skipped"]
    assert clothbench("validate", "knits").returncode == 0


def test_improve_names_what_a_linear_sample_lacks(clothbench, curves, tmp_path):
    out = clothbench("improve", "recordings=rib", "model=linear_stretch", "out=found")
    assert out.returncode == 0, out.stderr
    assert "strain_locking" in out.stdout
    assert " N; the spread between runs alone would give " in out.stdout
    found = json.loads((tmp_path / "found" / "verdict.json").read_text())
    assert found["verdict"] in ("attributed", "tied")
    assert found["error"]["unit"] == "N"
    assert found["error"]["held_out"]["after"] < 0.5 * found["error"]["held_out"]["before"]
    assert found["error_mm"]["fit"] == {"before": None, "after": None}
    assert len(found["recordings"]["held_out"]) == 1
    again = clothbench("improve", "recordings=rib", "model=linear_stretch", "out=found", "--json")
    assert json.loads(again.stdout)["effects"] == found["effects"]


@pytest.mark.slow
def test_a_verdict_in_a_bucket_is_found_from_another_machine(clothbench, s3, curves):
    asked = ("improve", "recordings=rib", "model=linear_stretch", f"out={s3}", "--json")
    here, there = clothbench(*asked), clothbench(*asked, CLOTHBENCH_CACHE="elsewhere")
    assert here.returncode == there.returncode == 0, here.stderr + there.stderr
    assert "kept" not in here.stderr
    assert "kept, these recordings were judged" in there.stderr
    assert json.loads(there.stdout) == json.loads(here.stdout)
    assert len(Bucket(s3).names("cells")) == 1
    said = clothbench(*asked[:-1])
    page = Path(said.stdout.partition("page: ")[2].partition("\n")[0])
    assert page.is_file()
    assert page.with_name("verdict.json").is_file()


@pytest.mark.parametrize(
    ("settings", "found"),
    [
        (("recordings=rib", "model=mass_spring"), "model 'mass_spring' answers no force-extension curves"),
        (("recordings=rib", "model=linear_stretch", "candidates=lift"), "effect 'lift' does not act on"),
        (("recordings=rib", "model=linear_stretch", "resolution=9"), "found resolution=…, which force-extension"),
        (("recordings=rib", "model=linear_stretch", "scene.start=measured"), "found start=…, which force-extension"),
        (("recordings=sway", "model=linear_stretch"), "model 'linear_stretch': found the capabilities curve"),
        (("recordings=sway", "model=mass_spring", "candidates=load_offset"), "acts on force-extension curves only"),
        (("recordings=mixed", "model=linear_stretch"), "mixed"),
        (("recordings=broken", "model=linear_stretch"), "broken/run0.nc: variable 'force'"),
    ],
)
def test_wrong_use_is_one_line_and_exit_2(clothbench, curves, recordings_folder, tmp_path, settings, found):
    (tmp_path / "sway").mkdir()
    (tmp_path / "mixed").mkdir()
    for path in recordings_folder.iterdir():
        (tmp_path / "sway" / path.name).write_bytes(path.read_bytes())
        (tmp_path / "mixed" / path.name).write_bytes(path.read_bytes())
    (tmp_path / "mixed" / "a.nc").write_bytes((curves / "run0.nc").read_bytes())
    broken = write_curve(pulled("bad", 0), tmp_path / "broken" / "run0.nc")
    with h5py.File(broken, "a") as stream:
        stream["force"][3] = np.nan
    out = clothbench("improve", *settings, "out=found")
    assert out.returncode == 2, out.stdout + out.stderr
    assert found in only_line(out.stderr)
    assert not (tmp_path / "found" / "verdict.json").exists()


@pytest.mark.slow
@pytest.mark.data
def test_the_measured_knits_lock(clothbench, data_dir, tmp_path):
    out = clothbench("import", "knit_uniaxial_gatech", f"data_dir={data_dir}", "out=knits")
    assert out.returncode == 0, out.stderr
    assert "40 recordings with 133243 of 133262 frames" in out.stdout
    for folder in ("acrylic-rib-course", "acrylic-stockinette-wale"):
        done = clothbench("improve", f"recordings=knits/{folder}", "model=linear_stretch", "out=found", "--json")
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        names = {n for effect in found["effects"] for n in (effect["name"], *effect["tied_with"])}
        assert "strain_locking" in names
        assert found["error"]["held_out"]["after"] < 0.5 * found["error"]["held_out"]["before"]
