"""The suite `hold_and_move` in small, as a user runs it: a video in; parameters, pictures, the paper's figures out."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

SMALL = ("suite.select=[stiff/hold-1]", "options.ga.generations=2", "options.ga.population=6", "budget=11")


@pytest.mark.slow
def test_the_protocol_end_to_end(clothbench, tmp_path):
    out = clothbench("run", "+suite=hold_and_move", *SMALL)
    assert out.returncode == 0, out.stderr
    (row,) = [r for r in json.loads(clothbench("leaderboard", "--json").stdout) if r["recording"] is None]
    assert row["unit"] == "cm"
    assert row["value"] < 2.5  # the paper's
    page = (tmp_path / "runs" / "report.html").read_text()
    for word in ("Beside the paper", "paper: flexible cloth", "Tracked and fitted", "data:image/jpeg;base64,"):
        assert word in page
    (cell,) = (tmp_path / "runs" / "cells").iterdir()
    assert sorted(p.name for p in (cell / "frames").iterdir()) == ["frame 30.jpg", "frame 59.jpg"]
    assert sorted(p.name for p in (cell / "tracker").iterdir()) == [
        "0 template.png",
        "1 first frame.png",
        "2 graph.png",
    ]


def test_improve_asks_effects_of_the_camera(clothbench, tmp_path):
    out = clothbench(
        "run", "+suite=hold_improve", "suite.select=[stiff/*]", "recordings=builtin:hold_nodes", "tracker=markers",
        "suite.candidates=lens_distortion", "suite.resolution=5", "timeout=5",
    )  # fmt: skip
    assert out.returncode in (0, 1), out.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {r["case"] for r in rows} == {"stiff"}


@pytest.mark.parametrize(
    ("settings", "found"),
    [
        (("+suite=hold_and_move", "tracker=depth_mesh"), "does not read; take tracker=optical_flow or sift_graph"),
        (("+suite=hold_and_move", "+options.sift_graph.place=middle"), "expected one of offset, literal"),
        (("+suite=hold_and_move", "options.node_error.unit=inch"), "unit is 'inch'"),
        (("+suite=hold_and_move", "scene.start=measured", "recordings=builtin:hold_nodes", "tracker=markers"),
         "says nothing of their depth"),
        (("+suite=shake_improve", "suite.candidates=lens_distortion", "recordings=builtin:shake_nodes",
          "tracker=markers"), "acts on pictures only"),
    ],
)  # fmt: skip
def test_wrong_settings_are_one_line(clothbench, settings, found):
    out = clothbench("run", *settings)
    assert out.returncode in (1, 2)
    lines = [line for line in (out.stderr + out.stdout).splitlines() if found in line]
    assert len(lines) >= 1, out.stderr


def test_a_video_that_is_none_is_one_line(clothbench, tmp_path):
    (tmp_path / "run.mp4").write_text("no video")
    (tmp_path / "y.png").write_text("no picture")
    cv2.imwrite(str(tmp_path / "t.png"), np.random.default_rng(1).integers(0, 255, (90, 90, 3)).astype(np.uint8))
    for template, found in (
        ("x", "x.png: found no picture"),
        ("y", "y.png: found no picture"),
        ("t", "found 0 frames"),
    ):
        out = clothbench("import", "run.mp4", f"template={template}.png", "width=0.6", "height=0.3")
        assert out.returncode == 2
        assert found in out.stderr
        assert len(out.stderr.splitlines()) == 1, out.stderr
