"""What fabrics are like: no number without its spread, unit and source, and the same as the data say."""

from __future__ import annotations

import json

import make_presets
import pytest

from clothbench import catalogue
from clothbench.cli.presets import preset_rows
from clothbench.reference.presets import presets
from clothbench.twins.of_preset import twin_of_preset


def test_every_number_has_a_spread_a_unit_and_a_source():
    rows = preset_rows(None)
    assert {row["preset"] for row in rows} == set(presets())
    for row in rows:
        assert row["low"] <= row["value"] <= row["high"], row
        assert row["low"] < row["high"], row
        assert row["unit"]
        assert len(row["source"]) > 10
    for one in presets().values():
        assert {"areal_density", "bending_warp", "bending_weft", "stretch", "shear"} <= set(one.numbers)


def test_a_fitted_class_says_by_what_and_of_what():
    """The interval of a fit holds what its stand-in was made with."""
    made = {"linen": (0.0008, 0.0045), "fleece": (0.0001,)}
    for name, truths in made.items():
        bending = presets()[name].bending
        assert all(bending.low <= truth <= bending.high for truth in truths)
        assert bending.source.startswith(f"fitted by baraff_witkin to {name}/static-2")
        assert "Bhat et al. 2003" in bending.source


def test_they_are_printed_with_their_sources(clothbench):
    done = clothbench("presets", "wool")
    assert (done.returncode, done.stderr) == (0, "")
    assert "1.46e-05 … 4.11e-05" in done.stdout
    assert len(json.loads(clothbench("presets", "--json").stdout)) == len(preset_rows(None))
    assert clothbench("presets", "Wool").stdout == done.stdout
    unknown = clothbench("presets", "silk")
    assert unknown.returncode == 2
    assert unknown.stderr.strip().endswith(f"there are: {', '.join(presets())}")


def test_a_preset_leaves_for_a_simulator():
    text = catalogue().load("exporters", "json").export(twin_of_preset("denim")).text
    bending = json.loads(text)["material"]["bending"]
    assert bending["low"] < bending["value"] < bending["high"]
    assert json.loads(text)["interval"] == "range of the class"
    assert "along the warp and" in catalogue().load("exporters", "ppf").export(twin_of_preset("denim")).text


@pytest.mark.data
def test_the_numbers_are_those_of_the_data(data_dir):
    for name in ("wang2011-arcsim-materials", "cantilever-618-fabrics", "knit-uniaxial-gatech"):
        if not (data_dir / name).is_dir():
            pytest.skip(f"{name} is not in {data_dir}")
    assert make_presets.presets(data_dir) == json.loads(make_presets.TARGET.read_text())
