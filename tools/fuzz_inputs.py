"""What `tools/fuzz.py` feeds to clothbench: for each kind of input a valid one, spoiled by a seed, and who reads it."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import fuzz_mutations as spoil
import numpy as np
import pyarrow.parquet as pq
from fuzz_bases import CELL, pictures, png

from clothbench.engine.suite import suites_folder

Command = Sequence[str] | Callable[[], Any]


@dataclass(frozen=True)
class Kind:
    """make: writes a spoiled input into an empty folder, beside valid things from the folder `bases`, and says what is
    to be called there. slow: of tenths of a second, not of milliseconds.
    """

    make: Callable[[Path, Path, random.Random], list[Command]]
    slow: bool = False


# --- spoiled ones ---------------------------------------------------------------------------------------------------


def recording(*names: str) -> Kind:
    def make(here: Path, bases: Path, chance: random.Random) -> list[Command]:
        shutil.copy(bases / f"{chance.choice(names)}.nc", here / "in.nc")
        spoil.other_netcdf(here / "in.nc", chance)
        return [["validate", "in.nc", *chance.choice(([], ["--json"]))]]

    return Kind(make)


def run(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A recording whose numbers or texts are others: where it is still valid, it is simulated."""
    shutil.copy(bases / "nodes.nc", here / "in.nc")
    spoil.other_netcdf(here / "in.nc", chance)
    return [["run", "recording=in.nc", *CELL]]


def results(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A results folder of which one file, or the name of a cell, is not what a run writes."""
    shutil.copytree(bases / "runs", here / "runs")
    cell = next((here / "runs" / "cells").iterdir())
    tables = sorted(cell.rglob("*.parquet"))
    path = cell / "rows.parquet" if chance.random() < 0.5 else chance.choice(sorted(p for p in cell.rglob("*.*")))
    if path in tables and chance.random() < 0.75:
        spoil_table(path, chance)
    else:
        path.write_bytes(spoil.damaged(path.read_bytes(), chance))
    if chance.random() < 0.05:
        cell.rename(cell.parent / chance.choice(("nothing", "0", "abc\ndef", "-x", "a" * 200)))
    readers: list[Command] = [
        ["leaderboard", "--out", "runs"], ["leaderboard", "--json", "--out", "runs"], ["store", "check", "runs"],
        ["compare", "runs", str(bases / "runs")], ["compare", "--markdown", str(bases / "runs"), "runs"],
        ["store", "merge", "runs", "merged"], ["store", "prune", "runs", "--other-versions", "--dry-run"],
        ["export", cell.name, "--to", "json", "--runs", "runs", "--out", "made.json"], ["report", "out=runs"],
    ]  # fmt: skip
    return chance.sample(readers[:-1], 2) + (readers[-1:] if chance.random() < 0.3 else [])


def spoil_table(path: Path, chance: random.Random) -> None:
    table = pq.read_table(path)
    try:
        pq.write_table(spoil.other_table(table, chance), path, write_page_checksum=True)
    except Exception:  # Arrow does not write that; nobody meets it then
        path.write_bytes(spoil.damaged(path.read_bytes(), chance))


@cache
def leaderboard_rows(bases: Path) -> list[Any]:
    from clothbench.engine.leaderboard import leaderboard_row
    from clothbench.engine.store import Store

    return [leaderboard_row(row) for row in Store(bases / "runs").rows()]


def rows_json(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    (here / "in.json").write_bytes(spoil.other_json(leaderboard_rows(bases), chance))
    pair = chance.sample(["in.json", str(bases / "runs")], 2)
    return [["compare", *pair, *chance.choice(([], ["--json"], ["--markdown"]))]]


def submission(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    shutil.copytree(bases / "submission", here / "in")
    if chance.random() < 0.6:
        stated = json.loads((here / "in" / "submission.json").read_text())
        (here / "in" / "submission.json").write_bytes(spoil.other_json(stated, chance))
    else:
        spoil.other_netcdf(here / "in" / "sway-1.nc", chance)
        if chance.random() < 0.7:  # as one who means harm hands it in: the hash is right
            state_hashes(here / "in")
    measured = ["--recordings", str(bases / "measured")]
    if chance.random() < 0.2:
        return [["submit", "in", "--name", chance.choice(spoil.TEXTS[1:]), *measured]]
    return [["verify", "in", "--out", "taken", *measured], ["leaderboard", "--out", "taken"]]


def state_hashes(folder: Path) -> None:
    from clothbench.core.files import sha256

    stated = json.loads((folder / "submission.json").read_text())
    for entry in stated["entries"]:
        entry["sha256"] = sha256(folder / entry["file"])
    (folder / "submission.json").write_text(json.dumps(stated))


HYDRA = """hydra:
  callbacks: {mine: {_target_: os.system, command: touch FUZZED}}
  run: {dir: ../FUZZED}
  job: {env_set: {FUZZED: "1"}, chdir: true}
  job_logging: {version: 1, handlers: {h: {(): os.system, command: touch FUZZED}}}
  output_subdir: FUZZED
  launcher: {_target_: os.system}
"""
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefghi", "bcdefghij", strict=True)
)


# Most built-in suites refuse the recordings that are here before they read on; this one is planned to its end.
MINE = """# @package _global_
suite:
  name: mine
  version: 1
  title: of a stranger's
  select: ["*"]
  case: fabric
  each: ["*-1"]
  together: []
  fixed: {"*": {linear_drag.coefficient: 0.5}}
  effects:
    mass_spring: [linear_drag]
  budgets:
    long: {budget: 20, finer: {spacing: 0.02, share: 0.25}}
model: [mass_spring]
optimizer: [ga, least_squares]
metric: [node_error]
report: [relative_error]
scene: {spacing: 0.05, start: rest, thickness: 0.001}
bounds: {k1: [10, 100]}
options:
  ga: {generations: 3}
analysis:
  variability: {cases: ["*"], points: 2}
  repeats: {cases: ["*"], count: 2}
  morris: {cases: ["*"], trajectories: 2}
  map: {cases: ["*"], points: 3}
limits: {seconds: 10}
budget: 8
seed: 3
"""


def suite(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A suite from a folder of a stranger's; it is planned, not simulated."""
    (here / "conf" / "suite").mkdir(parents=True)
    text = MINE if chance.random() < 0.5 else chance.choice(suite_texts())
    measured = [f"recordings={bases / 'measured'}"] if "recordings:" in text or text is MINE else []
    if chance.random() < 0.3:
        lines = HYDRA.splitlines()
        text += "\n".join([lines[0], *chance.sample(lines[1:], chance.randrange(1, 4)), ""])
    elif chance.random() < 0.1:
        text += BOMB
    (here / "conf" / "suite" / "mine.yaml").write_bytes(spoil.other_text(text, chance))
    return [["run", "--config-dir", "conf", "+suite=mine", *measured]]


@cache
def suite_texts() -> list[str]:
    return [p.read_text(encoding="utf-8") for p in sorted((suites_folder() / "suite").glob("*.yaml"))]


WORDS = (*CELL, "study=calibration", "effects=[gravity_tilt]", "scene.areal_density=0.2", "scene.start=rest", "seed=1",
         "+bounds.k1=[1,2]", "+options.ga.generations=2", "prior=denim", "out=runs", "data_dir=x",
         "+suite=static_dynamic", "+suite.select=*", "tracker=markers", "report=[node_error]", "choice=knee",
         "scene.outline=[[0,0],[0.1,0],[0,0.1]]", "scene.obstacles=[{shape:plane}]", "+analysis.morris={cases:['*']}",
         "budget=paper", "~seed", "scene.thickness=0.001")  # fmt: skip


def words(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """Settings on the command line; they are planned, not simulated."""
    given = [*CELL[:3], f"recordings={bases / 'measured'}", *chance.sample(WORDS, chance.randrange(1, 5))]
    for _ in range(chance.choice((1, 1, 2))):
        at = chance.randrange(len(given))
        key, _, known = given[at].partition("=")
        fresh = str(
            chance.choice((*spoil.NUMBERS, *spoil.TEXTS, *spoil.RAW, "null", "[1,[2", "{a:1,b:{c:2}}", known * 2))
        )
        given[at] = chance.choice((f"{key}={fresh}", f"+{key}={fresh}", f"{key}.{fresh}={known}", fresh, f"~{key}"))
        if chance.random() < 0.1:
            given[at] = spoil.damaged(given[at].encode(), chance).decode("utf-8", "replace")
    return [["run", *(word.replace("\x00", "0") for word in given if not word.startswith("-"))]]


UPWARDS = "../../../../FUZZED"  # out of a cell's folder in `runs`, and out of the folder that may be written to
ODD_PATHS = (UPWARDS, f"a/../{UPWARDS}", "/tmp/FUZZED", "rows.parquet/x", "a//b", "./a")


def archive(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A cell as a bucket holds it, brought into a results folder."""
    from clothbench.core.packed import files_in, packed, unpacked, write_files

    files = dict(files_in(next((bases / "runs" / "cells").iterdir())))
    if chance.random() < 0.6:
        odd = chance.choice(chance.choice((spoil.TEXTS, ODD_PATHS)))
        files[odd.replace("\x00", "0")] = b"FUZZED"
    content = packed(files)
    if chance.random() < 0.5:
        content = spoil.damaged(content, chance)

    def bring() -> None:
        write_files(here / "runs" / "cells" / "abc", unpacked(content, "s3://somebody/cells/abc.zip"))

    return [bring, ["leaderboard", "--out", "runs"]]


# --- other programs' files ------------------------------------------------------------------------------------------


def cloud(chance: random.Random) -> bytes:
    """A cloud of points as PLY, or as NumPy writes it."""
    points = np.stack([*np.meshgrid(np.linspace(-0.1, 0.1, 5), np.linspace(-0.1, 0.1, 5)), np.ones((5, 5))], axis=-1)
    points = points.reshape(-1, 3).astype("<f4")
    form = chance.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 25\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    if form == "ascii":
        return head.encode() + "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
    return head.encode() + points.astype(">f4" if "big" in form else "<f4").tobytes()


def clouds(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A folder of clouds, or of depth frames."""
    camera = {"size": [8, 8], "fx": 20.0, "fy": 20.0, "cx": 3.5, "cy": 3.5}
    about = {"name": "c", "cloth_width": 0.2, "cloth_height": 0.2, "rate": 20, "weather": "fair", "camera": camera,
             "gravity": [0, 0, -9.81]}  # fmt: skip
    told = spoil.other_json(about, chance) if chance.random() < 0.4 else json.dumps(about).encode()
    (here / "in").mkdir()
    (here / "in" / "recording.json").write_bytes(told)
    form, spoilt = chance.choice(("ply", "npy", "png")), chance.randrange(3)
    folder = here / "in" / ("depth" if form == "png" else "clouds")
    folder.mkdir()
    for k in range(3):
        if form == "npy":
            np.save(folder / f"{k}.npy", np.ones((5, 3)))
            content = (folder / f"{k}.npy").read_bytes()
        else:
            content = png(np.full((8, 8), 1000, np.uint16)) if form == "png" else cloud(chance)
        if k == spoilt:
            head, mark, body = content.partition(b"end_header\n")
            if mark and chance.random() < 0.5:
                content = spoil.other_text(head.decode(), chance) + mark + body
            else:
                content = PICKLED if form == "npy" and chance.random() < 0.1 else spoil.damaged(content, chance)
        (folder / f"{k}.{form}").write_bytes(content)
    return [["import", "in", "out=made"]]


PICKLED = (
    b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }".ljust(117)
    + b"\n"
    + spoil.PICKLE
)


def film(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A video file, or a folder of pictures, with the template."""
    (here / "template.png").write_bytes(png(np.full((64, 64, 3), 90, np.uint8)))
    stated = ["template=template.png", "width=0.2", "height=0.2", "marks=4,4;60,4;60,60;4,60", "out=made"]
    if chance.random() < 0.6:
        (here / "in.mp4").write_bytes(spoil.damaged((bases / "film.mp4").read_bytes(), chance))
        return [["import", "in.mp4", *stated]]
    (here / "in").mkdir()
    for k, picture in enumerate(pictures()):
        content = cv2.imencode(".jpg", picture)[1].tobytes() if chance.random() < 0.5 else png(picture)
        (here / "in" / f"{k}.png").write_bytes(spoil.damaged(content, chance) if chance.random() < 0.3 else content)
    if chance.random() < 0.3:
        camera = {"size": [80, 72], "fx": 20.0, "fy": 20.0, "cx": 3.5, "cy": 3.5, "distortion": [0, 0, 0, 0, 0]}
        (here / "camera.json").write_bytes(spoil.other_json(camera, chance))
        stated.append("camera=camera.json")
    return [["import", "in", "rate=30", *stated]]


HEAD = "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t5\t2\tmm\n"
AXES = "Frame#\tTime\ta\t\t\tb\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
TRC = HEAD + AXES + "".join(f"{k + 1}\t{k / 100}\t1\t1\t{k}\t200\t1\t{k}\n" for k in range(5))
CSV = "# unit: mm\n# rate: 100\nframe,time,a_x,a_y,a_z,b_x,b_y,b_z\n"
CSV += "".join(f"{k},{k / 100},0,0,{k},200,0,{k}\n" for k in range(5))


def markers(here: Path, bases: Path, chance: random.Random) -> list[Command]:
    """A marker file, as the tracker `markers` reads it."""
    from clothbench_trackers.markers import Markers

    ending, text = chance.choice(((".csv", CSV), (".trc", TRC), (".c3d", "")))
    path = here / f"in{ending}"
    if ending == ".c3d":
        path.write_bytes(spoil.damaged(c3d_file(), chance))
    else:
        path.write_bytes(spoil.other_text(text, chance))
    return [lambda: Markers(material={"a": (0, 0), "b": (0.2, 0)}).track(path)]


@cache
def c3d_file() -> bytes:
    import io

    import c3d

    writer = c3d.Writer(point_rate=100, analog_rate=0)
    writer.set_point_labels(["a", "b"])
    for k in range(5):
        writer.add_frames([(np.array([[1.0, 1, k, 0, 0], [200, 1, k, 0, 0]]), np.array([[]]))])
    stream = io.BytesIO()
    writer.write(stream)
    return stream.getvalue()


KINDS = {
    "nodes": recording("nodes", "nodes_watched"),
    "curve": recording("curve"),
    "laser": recording("laser"),
    "depth": recording("depth"),
    "video": recording("video_pictures", "video_film"),
    "silhouette": recording("silhouette"),
    "run": Kind(run, slow=True),
    "results": Kind(results, slow=True),
    "archive": Kind(archive),
    "rows_json": Kind(rows_json),
    "submission": Kind(submission, slow=True),
    "suite": Kind(suite, slow=True),
    "words": Kind(words, slow=True),
    "clouds": Kind(clouds),
    "film": Kind(film),
    "markers": Kind(markers),
}
