"""The command line as a user meets it: exit codes, messages, what is written and what is not."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from conftest import swinging_recording
from hydra.types import RunMode
from omegaconf import OmegaConf
from rich.console import Console

from clothbench import ClothbenchError, PointCloud, write_points, write_recording
from clothbench.cli.commands import COMMANDS, main, parsed, print_json_rows
from clothbench.cli.hydra_words import either_way
from clothbench.cli.idle import say_alone, say_idle
from clothbench.cli.improve import SHOWN
from clothbench.cli.own_suites import each_choice, require_harmless
from clothbench.cli.run import (
    _conclude,
    composed,
    job,
    jobs_of,
    require_known,
    require_sound,
    run,
    say_all_skipped,
    say_twice,
    swept,
)
from clothbench.cli.settings_help import settings_help, settings_meanings
from clothbench.core.errors import nearest, slips
from clothbench.core.files import whole_folder
from clothbench.display.film import read_film
from clothbench.display.terminal import console
from clothbench.engine.leaderboard import ROW
from clothbench.engine.settings import KNOWN
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.tables import error_table

CELL = ("model=mass_spring", "optimizer=ga", "metric=node_error", "+options.mass_spring.resolution=5", "budget=25")


def only_line(text: str) -> str:
    """The one line of an error; more than one would be a fault of its own."""
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    return lines[0]


def test_a_run_whose_cells_are_all_skipped_says_so_and_what_to_do(clothbench, recordings_folder):
    out = clothbench("run", f"recordings={recordings_folder}", *CELL[1:3], "model=linear_stretch", "rerun=false")
    assert out.returncode == 0  # a cell that was skipped for a stated reason is no failure
    assert "answers force-extension curves only" in out.stdout
    said = [line for line in out.stderr.splitlines() if "nothing was computed" in line]
    assert said == [
        "clothbench: nothing was computed: the one cell was skipped, for what stands above; take a model that can do "
        "this (`clothbench plugins`, docs/models.md), or other recordings"
    ]


def test_where_one_cell_was_computed_nothing_is_said_of_those_skipped(capsys):
    skipped, done = {"key": "a", "status": "skipped"}, {"key": "b", "status": "ok"}
    say_all_skipped([skipped, done])
    say_all_skipped([])
    assert capsys.readouterr().err == ""
    say_all_skipped([skipped, skipped, {**skipped, "key": "c"}])
    assert "all 2 cells were skipped" in capsys.readouterr().err


def test_help_answers_at_once_and_names_every_command(clothbench):
    began = time.perf_counter()
    out = clothbench("--help")
    bare = subprocess.run([sys.executable, "-c", "pass"], check=True)
    assert bare.returncode == out.returncode == 0
    assert time.perf_counter() - began < 30  # the measured figure is in the benchmarks; this only catches a hang
    for command in ("run", "plugins", "validate", "datasets", "import", "leaderboard", "compare", "bench", "report",
                    "view", "export", "units", "presets", "new-plugin"):  # fmt: skip
        assert command in out.stdout


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (("run", "+suite=nonsense"), "suite/nonsense"),
        (("run", "+suite=worn_skrit"), "found no suite/worn_skrit; did you mean 'worn_skirt'? there are: drape, "),
        (("run", "+suite=nonsense"), "waving_linear_drag, worn_skirt"),  # all of them
        (("run", "modle=x"), "modle"),
        (("run", *CELL), "no recordings named"),
        (("run", *CELL, "recording=none.nc"), "none.nc: no such file"),
        (
            ("run", "recording=good.nc", "model=mass_sping", "optimizer=ga", "metric=node_error"),
            "did you mean 'mass_spring'",
        ),
        (("run", "recording=good.nc", "optimizer=ga", "metric=node_error"), "setting 'model' is empty"),
        (("run", "recording=good.nc", *CELL, "effects=[quadratic_drag,quadratic_drag]"), "given twice"),
        (
            ("run", "recording=good.nc", *CELL, "effects=[rolling_shutter]"),
            "'rolling_shutter' acts on points that were",
        ),
        (
            ("import", "unknown_set"),
            "unknown_set: no such file or folder, and no data set 'unknown_set'; known: cusick",
        ),
        (("import", "none.mp4", "template=x.png", "width=0.3"), "none.mp4: no such file or folder, and no data set"),
        (("export", "denim", "--to", "mujoco", "--out", "-"), "--out -: an export is a file, which others name"),
        (("run", "-m", "recording=good.nc", "--cfg", "job"), "found several of --run, -m, --cfg, --info and"),
        (("run", "--config-dir", "none", "+suite=mine"), "none: no such folder; --config-dir names one"),
        (("import", "iri_wam_cloth_swin"), "'iri_wam_cloth_swin'; did you mean 'iri_wam_cloth_swing'? known: cusick"),
        (("report", "uot=x"), "found 'uot=x', did you mean 'out'? expected out=VALUE"),
        (("report", "out"), "found 'out', expected out=VALUE"),
        (("presets", "denimm"), "did you mean 'denim'? there are: any, cotton"),
        (("import", "iri_wam_cloth_swing", "data_dir=/nowhere"), "/nowhere is not a folder"),
        (("import", "good.nc"), "good.nc: found a recording, expected a video; see it with clothbench validate good"),
        (("import", "iri_wam_cloth_swing", "dir=x"), "expected data_dir=VALUE"),
        (("compare", "a.json", "b.json"), "a.json: no such folder or file"),
        (("compare", ".", "good.nc"), ".: found no results (no folder 'cells'); make some with clothbench run"),
        (("compare", "../empty.json", "../empty.json"), "empty.json: found an empty list, expected"),
        (("view", "abc"), "found no cells; make some with: clothbench run +suite=static_dynamic\n"),
        (("view", "abc", "--out", "empty"), "run +suite=static_dynamic out=empty\n"),
        (("validate", "nowhere"), "nowhere: no such file or folder"),
        (("leaderboard", "--out", "nowhere"), "nowhere: found no results"),
        (("report", "out=nowhere"), "nowhere: found no results"),
        (("report",), "runs: found no results (no folder 'cells'); make some with clothbench run … out=runs"),
    ],
)
def test_wrong_use_is_one_line_and_exit_2(clothbench, tmp_path, arguments, found):
    write_recording(swinging_recording(), tmp_path / "good.nc")
    (tmp_path.parent / "empty.json").write_text("[]")
    out = clothbench(*arguments)
    assert out.returncode == 2, out.stderr
    assert found in only_line(out.stderr) + "\n"
    assert [p.name for p in tmp_path.iterdir()] == ["good.nc"]


def test_a_folder_hides_no_data_set_and_motion_capture_is_no_video(clothbench, tmp_path):
    (tmp_path / "phi_sft_r1").mkdir()
    (tmp_path / "m.csv").write_text("frame,time\n")
    for words, found in (
        (("phi_sft_r1", "data_dir=/nowhere"), "/nowhere is not a folder"),
        (("m.csv",), "m.csv: found motion capture, expected a video; docs/recordings.md tells under Motion capture"),
    ):
        out = clothbench("import", *words)
        assert out.returncode == 2
        assert found in only_line(out.stderr)


def test_hydra_s_own_questions_are_answered(clothbench, tmp_path):
    out = clothbench("run", "--cfg", "job", "+suite=static_dynamic")
    assert out.returncode == 0, out.stderr
    assert "budget: 40" in out.stdout
    assert clothbench("run", "seed=7", "--cfg", "job", "+suite=static_dynamic").stdout == out.stdout.replace(
        "seed: 0", "seed: 7"
    )
    out = clothbench("run", "--help", "budget=7")
    assert out.returncode == 0
    assert out.stdout.startswith("usage: clothbench run +suite=NAME")
    for said in ("evaluations per cell, or the name of a budget", "static_dynamic", "\nbudget: 7\n"):
        assert said in out.stdout
    assert not list(tmp_path.iterdir())


def test_the_help_of_run_has_every_setting_with_its_usual_value_and_a_meaning():
    """From the comments of the file that the settings are read from, each of which has one."""
    settings = yaml.safe_load(files("clothbench.conf").joinpath("run.yaml").read_text(encoding="utf-8"))
    told = {name: (usual, meaning) for name, usual, meaning in settings_meanings()}
    assert list(told) == [name for name in settings if name not in ("defaults", "hydra")]
    assert set(told) == KNOWN - {"suite", "executor"}  # of which Hydra lists the choices
    for name, (usual, meaning) in told.items():
        assert len(meaning) > 10, name
        if not isinstance(settings[name], dict) or not settings[name]:
            assert yaml.safe_load(usual or "null") == settings[name]
        assert f"\n  {name} " in settings_help()
    assert all(re.search(rf"\b{study}\b", told["study"][1]) for study in catalogue().names("studies"))
    assert max(map(len, settings_help().splitlines())) <= 120


def test_words_may_stand_behind_options():
    for command in (["suggest", "rec"], ["report"], ["improve", "model=newton"], ["units", "newton"]):
        option = {"suggest": ["--runs", "there"], "report": ["--watch"]}.get(command[0], ["--json"])
        options = parsed([*command, "seed=1", *option, "draws=0", "best=1"])
        assert options.settings[-3:] == ["seed=1", "draws=0", "best=1"]
    for wrong in (["suggest", "rec", "--run", "there", "--fast"], ["leaderboard", "out=there"]):
        with pytest.raises(ClothbenchError):
            parsed(wrong)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("improve recordings=a model=b --out X", "--out is written out=X here"),
        ("improve --recordings a --model b", "--recordings is written recordings=a here"),
        ("report --out=X", "--out is written out=X here"),
        ("import video.mp4 --data-dir", "--data-dir is written data_dir=VALUE here"),
        ("report --frob", "settings are written KEY=VALUE here; see clothbench report --help"),
        ("leaderboard out=X", "out=X is written --out X here"),
        ("view out=X swing", "out=X is written --out X here"),
        ("export denim to=json", "the following arguments are required: --to; to=json is written --to json here"),
        ("suggest swing runs=X", "suggest: runs=X is written --runs X here"),
        ("improve json=1 model=a recordings=b", "json=1 is written --json here"),
        (
            "leaderboard --jsn",
            "unrecognized arguments: --jsn; did you mean '--json'? see clothbench leaderboard --help",
        ),
        ("lederboard", "did you mean 'leaderboard'? see clothbench --help"),
        ("store chek runs", "did you mean 'check'? see clothbench store --help"),
        ("new-plugin modle mine", "did you mean 'model'? see clothbench new-plugin --help"),
        ("leaderboard --frob", "unrecognized arguments: --frob; see clothbench leaderboard --help"),
        ("store check runs json=1", "store check: unrecognized arguments: json=1; json=1 is written --json here"),
    ],
)
def test_a_word_in_the_spelling_of_another_command_is_told_as_it_is_written_here(words, said):
    with pytest.raises(ClothbenchError) as fault:
        parsed(words.split())
    assert str(fault.value).endswith(said)


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("rnu", "run"), ("improv", "improve"), ("lederboard", "leaderboard"), ("exprot", "export"),
        *((other, "") for other in ("fetch", "remove", "plot", "prune", "simulate", "results", "init", "version")),
        ("calibrate", ""), ("run", ""),
    ],
)  # fmt: skip
def test_a_command_is_suggested_for_a_slip_and_not_for_another_word(word, meant):
    assert nearest(word, [*COMMANDS, "run"]) == (f"did you mean {meant!r}? " if meant else "")


def test_the_nearest_name_is_one_that_was_misspelled():
    for word, meant in (("modle", "model"), ("bugdet", "budget"), ("optimiser", "optimizer"), ("swimg-7", "swing-7")):
        assert nearest(word, ("model", "metric", "budget", "optimizer", "swing-7")) == f"did you mean {meant!r}? "
    assert nearest("swing-7", [f"swing-{number}" for number in (1, 6, 17)]) == ""  # each of them is meant by somebody
    assert [slips(word, "budget") for word in ("budget", "bugdet", "budgt", "budgett", "badget")] == [0, 1, 1, 1, 1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("+suite=shake --out X", "run: --out is written out=X here"),
        ("--out=X +suite=shake -m seed=1,2", "run: --out is written out=X here"),
        ("--recordings rec model=mass_spring", "run: --recordings is written recordings=rec here"),
        ("--scene.spacing 0.02", "run: --scene.spacing is written scene.spacing=0.02 here"),
        ("+suite=shake --json", "run: --json is no option; see clothbench run --help"),
        ("+suite=shake --budgett 3", "run: --budgett is no option; did you mean 'budget'? see clothbench run --help"),
        ("--multrun", "run: --multrun is no option; did you mean 'multirun'? see clothbench run --help"),
    ],
)
def test_a_setting_of_run_that_is_written_as_an_option_is_told_as_it_is_written(words, said):
    with pytest.raises(ClothbenchError) as fault:
        run(words.split())
    assert str(fault.value) == said


def test_an_unknown_command_or_flag_is_exit_2(clothbench):
    assert clothbench("frobnicate").returncode == 2
    assert clothbench("plugins", "--jsn").returncode == 2
    assert clothbench().returncode == 2


def test_one_cell_end_to_end(clothbench, recordings_folder, tmp_path):
    out = clothbench("run", f"recordings={recordings_folder}", *CELL, "out=results", "report=[relative_error]")
    assert out.returncode == 0, out.stderr
    assert "held out: all, node_error" in out.stdout
    assert "N/m" in out.stdout
    assert "page:" in out.stdout
    rows = json.loads(clothbench("leaderboard", "--json", "--out", "results").stdout)
    assert {r["metric"] for r in rows} == {"node_error", "relative_error"}
    assert {(r["split"], bool(r["recording"])) for r in rows} == {
        (s, b) for s in ("fit", "held_out") for b in (True, False)
    }
    for row in rows:
        assert row["status"] == "ok"
        assert row["low"] <= row["value"] <= row["high"]
        assert row["evaluations"] == 25
    floor = next(r["floor"] for r in rows if r["metric"] == "node_error")
    assert floor == pytest.approx(1.596, abs=1e-3)  # σ √(8/π) at σ = 1 mm
    folder = tmp_path / "results" / "cells" / rows[0]["key"]
    assert {p.name for p in folder.iterdir()} == {
        "rows.parquet", "parameters.parquet", "question.parquet", "history.parquet", "starts.parquet", "trace.parquet",
        "fit.rrd", "films",
    }  # fmt: skip
    assert (tmp_path / "results" / "report.html").is_file()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["recordings", "results"]  # no Hydra litter


def test_clouds_without_identity_end_to_end(clothbench, tmp_path):
    """Drawn, filmed and kept as any recording, whatever the number of points that were seen."""
    nodes, random = swinging_recording(), np.random.default_rng(1)
    taken = {n: getattr(nodes, n) for n in ("time", "grip_time", "grip_material", "grip_position")}
    sizes = {n: getattr(nodes, n) for n in ("cloth_width", "cloth_height", "areal_density", "noise_sigma")}
    for name, split in (("a", "fit"), ("b", "held_out")):
        seen = np.stack([random.permutation(frame)[: 2 * len(frame) // 3] for frame in nodes.position])
        seen[3] = np.nan
        cloud = PointCloud(name=name, position=seen, split=split, fabric="x", **taken, **sizes)
        write_points(cloud, tmp_path / f"{name}.nc")
    asked = ("recordings=.", "model=mass_spring", "+options.mass_spring.resolution=5", "optimizer=ga", "budget=25")
    refused = clothbench("run", *asked, "metric=node_error", "tracker=cloud")
    assert refused.returncode == 2
    assert "take metric=chamfer or hausdorff" in only_line(refused.stderr)
    out = clothbench("run", *asked, "metric=chamfer", "report=[hausdorff]", "tracker=cloud")
    assert out.returncode == 0, out.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {(r["metric"], r["status"], r["floor"]) for r in rows} == {(m, "ok", None) for m in ("chamfer", "hausdorff")}
    folder = tmp_path / "runs" / "cells" / rows[0]["key"]
    assert {"fit.rrd", "films"} <= {p.name for p in folder.iterdir()}
    film = read_film(folder / "films" / "0.npz")
    assert film.cloud
    assert film.seen.shape[1] != len(film.material) == next(iter(film.takes.values())).position.shape[1]
    assert len(list((tmp_path / "runs" / "rerun").glob("*.rrd"))) == 1
    assert (tmp_path / "runs" / "report.html").is_file()


def test_a_finished_cell_is_not_run_again_and_the_same_cell_gives_the_same_bits(
    clothbench, recordings_folder, tmp_path
):
    command = ("run", f"recordings={recordings_folder}", *CELL, "rerun=false")
    assert "ok:" in clothbench(*command, "out=a").stderr
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "a" / "cells").rglob("*.parquet")}
    assert "kept:" in clothbench(*command, "out=a").stderr
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "a" / "cells").rglob("*.parquet")}
    clothbench(*command, "out=b")
    first, second = (json.loads(clothbench("leaderboard", "--json", "--out", o).stdout) for o in "ab")
    for row in (*first, *second):
        row["wall_s"] = None
    assert first == second


def test_a_sweep_is_a_product_and_prints_one_table(clothbench, recordings_folder):
    out = clothbench(
        "run", "-m", f"recordings={recordings_folder}", *CELL, "seed=1,2", "optimizer=ga,least_squares", "rerun=false"
    )
    assert out.returncode == 0, out.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert len({r["key"] for r in rows}) == 4
    assert out.stdout.count("error, 95 % interval") == 1


def test_a_job_that_is_refused_does_not_hide_the_others_of_its_sweep(clothbench, recordings_folder):
    """What it asks of its recordings is known when it comes; settings that can be none are refused before all."""
    words = (*CELL, "seed=1,2", "suite.select=['*'],[zzz]", "rerun=false")
    out = clothbench("run", "-m", f"recordings={recordings_folder}", *words)
    assert out.returncode == 2
    assert "setting 'suite.select' ['zzz'] matches none of" in out.stderr.splitlines()[-1]
    assert out.stdout.count("error, 95 % interval") == 1
    assert {r["seed"] for r in json.loads(clothbench("leaderboard", "--json").stdout)} == {1, 2}


def test_what_a_sweep_says_is_in_the_order_of_its_jobs(tmp_path, monkeypatch):
    """Whichever of them end first, and whatever launched them; of several refused jobs the first one is told."""
    monkeypatch.setenv("CLOTHBENCH_RUN_NOTES", str(tmp_path))
    monkeypatch.setenv("CLOTHBENCH_RUN_JOBS", "6")
    told, shown = list[int](), list[list[str]]()
    mode = RunMode.MULTIRUN

    def now():
        about = SimpleNamespace(num=told[-1]) if mode == RunMode.MULTIRUN else SimpleNamespace()
        return SimpleNamespace(mode=mode, job=about, overrides=SimpleNamespace(task=[]))

    def refused(*_):
        if told[-1] in (2, 11):
            raise ClothbenchError(f"job {told[-1]}")
        return {"out": str(tmp_path), "cells": [f"{told[-1]:016d}"]}

    monkeypatch.setattr("clothbench.cli.run.HydraConfig", SimpleNamespace(get=now))
    monkeypatch.setattr("clothbench.cli.run._run", refused)
    monkeypatch.setattr("clothbench.cli.run.print_results", lambda store, keys: shown.append(keys) or [])
    monkeypatch.setattr("clothbench.cli.run._say_where", lambda store, keys: None)
    for number in (11, 3, 0, 10, 2, 1):
        told.append(number)
        job(OmegaConf.create({}))
    with pytest.raises(ClothbenchError, match=r"^job 2 \(and 1 more jobs\)$"):
        _conclude(tmp_path, sweep=True)
    assert [int(key) for key in shown[0]] == [0, 1, 3, 10]
    mode = RunMode.RUN  # where Hydra knows no number of a job
    job(OmegaConf.create({}))
    assert len(list(tmp_path.iterdir())) == 7


@pytest.mark.parametrize(
    ("swept", "said"),
    [("model=mass_spring,mass_sprung", "mass_sprung"), ("report=[],[node_error,node_eror]", "node_eror")],
)
def test_a_sweep_over_what_does_not_exist_is_refused_before_it_begins(clothbench, recordings_folder, swept, said):
    out = clothbench("run", "-m", f"recordings={recordings_folder}", *CELL, swept, "rerun=false")
    assert out.returncode == 2
    (line,) = out.stderr.splitlines()
    assert f"named {said!r}; did you mean" in line
    assert not out.stdout


def test_a_sweep_without_recordings_is_over_the_main_suite(clothbench):
    out = clothbench(
        "run", "-m", "model=mass_spring", "optimizer=ga,annealing", "metric=node_error",
        "suite.select=[satin/static-?]", "suite.each=[satin/static-1]", "budget=8", "~analysis", "scene.spacing=0.1",
    )  # fmt: skip
    assert out.returncode == 0, out.stderr
    assert "it takes +suite=static_dynamic" in out.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {r["suite"] for r in rows} == {"static_dynamic"}
    assert {r["optimizer"] for r in rows} == {"ga", "annealing"}
    assert len({r["key"] for r in rows}) == 2


def test_the_launcher_can_be_exchanged(clothbench, recordings_folder):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    out = clothbench(
        "run", "-m", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"recordings={recordings_folder}", *CELL,
        "seed=1,2", "jobs=1", "rerun=false",
    )  # fmt: skip
    assert out.returncode == 0, out.stderr
    assert len({r["key"] for r in json.loads(clothbench("leaderboard", "--json").stdout)}) == 2


def test_a_setting_is_set_with_a_sign_or_without():
    """Hydra asks for + where the suite has none of it, and refuses it where it has."""
    signed = ["+suite=static_dynamic", "+options.ga.generations=3", "+bounds.bend=[1e-6,1e-5]", "++scene.spacing=0.02"]
    assert composed([word.lstrip("+") for word in signed]) == composed(signed)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("recordings=a b", "a b"),
        ("recordings=josé/s.nc", "josé/s.nc"),
        ("out=k(1)", "k(1)"),
        ("+data_dir=a#b", "a#b"),
        ("recording='a b'", "a b"),
        ("recordings=[a b,k(1)]", ["a b", "k(1)"]),
        ("recordings=builtin:shake/*", "builtin:shake/*"),
        ("recording=null", None),
        ("out=multirun/seed=1", "multirun/seed=1"),
        ("recordings=[a,x=y.nc]", ["a", "x=y.nc"]),
        ("recording=it's.nc", "it's.nc"),
        ('recordings=[it\'s.nc,"b, c.nc"]', ["it's.nc", "b, c.nc"]),
        ("recording=a[1].nc", "a[1].nc"),
        ("out=20261128", "20261128"),
        ("++out=1e3", "1e3"),
        ("out=true", "true"),
        ("out=1_0", "1_0"),
        ("recordings=[2026,a]", ["2026", "a"]),
        ("recordings=null", None),
    ],
)
def test_paths_are_no_words_of_a_grammar(word, value):
    assert composed([word])[word.strip("+").partition("=")[0]] == value


@pytest.mark.parametrize(
    ("words", "key", "values"),
    [
        (["recording=[a,b],[c]"], "recording", ["[a,b]", "[c]"]),
        (["recording=[josé,b],[c]"], "recording", ["['josé',b]", "[c]"]),
        (["recording='a,b',josé"], "recording", ["'a,b'", "'josé'"]),
        (["out=x=1,it's"], "out", ["'x=1'", '"it\'s"']),
        (["recordings=[1,a],[b]"], "recordings", ["['1',a]", "[b]"]),
        (["--config-dir", "my-suites", "seed=0,1"], "seed", ["0", "1"]),
        (["--config-dir", "a=b,c", "bounds={k1:[1,2]},{k1:[2,3]}"], "bounds", ["{k1:[1,2]}", "{k1:[2,3]}"]),
    ],
)
def test_a_sweep_goes_over_what_hydra_makes_of_it(words, key, values):
    assert swept(either_way(words, sweep=True)) == [(key, values)]
    assert jobs_of(either_way(words, sweep=True)) == 2


def test_a_path_with_commas_is_one_path_unless_its_parts_are_meant(tmp_path, monkeypatch):
    """Without a sweep results go where they are said to; with one, commas part what is not there as a whole."""
    monkeypatch.chdir(tmp_path)
    for name in ("my rec, a=b é", "here, there", "x", "y"):
        (tmp_path / name).mkdir()
    for sweep in (False, True):
        (word,) = either_way([f"recordings={tmp_path}/my rec, a=b é"], sweep)
        assert composed([word])["recordings"] == f"{tmp_path}/my rec, a=b é"
        (word,) = either_way(["out=here, there/runs"], sweep)
        assert composed([word])["out"] == "here, there/runs"
    for word in ("out=x/a,y/b", "out=a=b, c é", "recording=a,b.nc", "recordings=a b,c", "recording=a\\,b"):
        key, _, path = word.partition("=")
        assert composed([word])[key] == path.replace("\\", "")
    for word in ("recordings=x,y", "recordings=x,typo", "recordings=builtin:shake,typo"):
        with pytest.raises(ClothbenchError, match="Ambiguous value"):  # which says how several are written
            composed([word])
    for word in (
        "out=x/a,y/b", "out=a,b", "recording=a,b.nc", "recordings=x,builtin:shake", "recordings=choice(x,y)",
        "recordings=builtin:shake,builtin:shake_nodes", "recordings=dataset:a,dataset:b",
        "recordings=pkg://a/x,pkg://b/y", "out=s3://x/a,new/b", "out=s3://x/a,s3://x/b",
    ):  # fmt: skip
        assert jobs_of(either_way([word], sweep=True)) == 2, word
    with pytest.raises(ClothbenchError, match="requires --multirun"):
        composed(["recordings=choice(x,y)"])


def test_braces_that_do_not_match_are_one_line(clothbench, tmp_path):
    """And nothing is left where temporary files lie."""
    (tmp_path / "temporary").mkdir()
    out = clothbench("run", "analysis={morris:{}", "recording=x", TMPDIR=str(tmp_path / "temporary"))
    assert out.returncode == 2, out.stderr
    assert "found '++analysis={morris:{}', which Hydra cannot read" in only_line(out.stderr)
    assert not list((tmp_path / "temporary").glob("clothbench-*"))
    with pytest.raises(ClothbenchError, match=r"found '\+\+bounds=\{\}\}', which Hydra cannot read"):
        composed(["++bounds={}}"])


@pytest.mark.parametrize(
    "word",
    ["analysis={}", "suite.fixed={}", "suite.budgets={}", "suite.effects.mass_spring={}", "options={}",
     "options.annealing={ }", "scene={}"],
)  # fmt: skip
def test_an_empty_mapping_takes_out_what_the_suite_has(word):
    """To Hydra it adds nothing to what is there."""

    def found(*words):
        out = composed(["suite=static_dynamic", *words])
        for key in word.partition("=")[0].split("."):
            out = out[key]
        return out

    assert found()
    assert not found(word)
    key = word.partition("=")[0]
    assert found(word, f"{key}.k1=1") == {"k1": 1}
    assert swept(either_way([f"{key}={{k1:1}},{{}}"], sweep=True)) == [(key, ["{k1:1}", "null"])]


@pytest.mark.parametrize(
    "words",
    [["suite=fold_phase_one", "suite.fold={}"], ["suite=fold_over", "suite.path={}"], ["limits.seconds=9", "limits={}"],
     ["suite=physical_validation", "suite.effects={}"], ["suite=shake", "suite.published.relative_error={}"],
     ["suite=fold_phase_one", "+bounds={}"]],
)  # fmt: skip
def test_so_does_one_that_only_some_suites_have(words):
    before, after = composed(words[:-1]), composed(words)
    for key in words[-1].lstrip("+").partition("=")[0].split("."):
        before, after = before[key], after[key]
    assert before
    assert not after


def test_settings_that_are_not_there_may_be_empty():
    for word in ("bounds={}", "+finer={}", "++analysis={}", "+suite.fixed={}", "+options.ga={}"):
        path = word.strip("+").partition("=")[0].split(".")
        found = composed([word])
        for key in path:
            found = found[key]
        assert found is None
    assert either_way(["analysis={morris:{}}", "analysis.morris={}"]) == [
        "++analysis={morris:{}}", "++analysis.morris={}",
    ]  # fmt: skip


def test_a_folder_of_suites_hides_no_unknown_plugin():
    with pytest.raises(ClothbenchError, match="mass_sprung"):
        require_known(["-m", "--config-dir", "my-suites", "model=mass_spring,mass_sprung"])


@pytest.mark.parametrize(
    ("word", "found"),
    [
        ("seed=0,-1", "setting 'seed' is -1, expected a whole number, at least 0"),
        ("budget=3,paperr", "setting 'budget' is 'paperr', expected a whole number"),
        ("scene.resolution=[5,5],5", "expected [nodes along u, along v]"),
        ("jobs=1,x", "setting 'jobs' is 'x'"),
        ("limits.seconds=9,x", "setting 'limits.seconds' is 'x'"),
        ("executor=local,dusk", "found no executor/dusk; did you mean 'dask'"),
    ],
)
def test_a_wrong_value_in_a_sweep_is_refused_before_its_first_job(clothbench, recordings_folder, tmp_path, word, found):
    given = [w for w in CELL if w.partition("=")[0] != word.partition("=")[0]]
    out = clothbench("run", "-m", f"recordings={recordings_folder}", *given, word)
    assert out.returncode == 2, out.stderr
    assert found in only_line(out.stderr)
    assert [p.name for p in tmp_path.iterdir()] == ["recordings"]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["choice=nearest,bogus"], "setting 'choice' is 'bogus', expected one of nearest, knee"),
        (["prior=denim,demin"], "no preset 'demin'"),
        (["suite.case=all,fabrik"], "setting 'suite.case' is 'fabrik', expected one of fabric, "),
        (["analysis.morris.trajectories=4,0"], "setting 'analysis.morris.trajectories' is 0, expected a whole number"),
        (["suite.fixed.k2=2,{}"], "setting 'suite.fixed.k2' is None, expected a number; ~suite.fixed.k2 takes it out"),
        (["optimizer=ga,null"], "setting 'optimizer' is empty"),
        (["study=improve", "metric=null", "suite.case=fabric,all"], "setting 'suite.case' is 'all', expected fabric"),
        (["study=improve", "metric=null", "suite.resolution=9,2"], "setting 'resolution' is 2, expected a whole"),
        (["+suite=physical_validation", "suite.tests=cantilever,cantilevver"], "cantilevver"),
        (["+suite=fold_over", "suite.path.lift=0.01,-1"], "setting 'suite.path.lift' is -1"),
        (["+suite=fold_phase_one", "suite.fold.fit=[eta_b],[]"], "setting 'suite.fold.fit' is empty"),
        (
            ["+suite=fold_phase_one", "suite.fold.fit=[eta_b],[grip_offset.dx]"],
            "setting 'suite.fold.fit' begins with 'grip_offset.dx', expected 'eta_b'",
        ),
        (
            ["+suite=physical_validation", "suite.effects.drag=quadratic_drag,{}"],
            "setting 'suite.effects' has no 'drag', which the test 'terminal_speed' asks for",
        ),
        (["+suite=speed", "suite.sides=[9],[]"], "setting 'suite.sides' is empty"),
    ],
)
def test_what_a_study_can_take_for_no_setting_of_its_own_is_refused_before_a_sweep(words, found):
    given = [] if words[0].startswith("+suite") else ["recording=none.nc", *CELL[:3]]
    keys = [word.partition("=")[0] for word in words]
    words = either_way([*(word for word in given if word.partition("=")[0] not in keys), *words])
    require_sound(["-m", *next(each_choice(words)), "jobs=1,2"])
    with pytest.raises(ClothbenchError, match=re.escape(found)):
        require_sound(["-m", *words])


def test_settings_of_a_sweep_over_suites_of_ones_own_are_looked_at(tmp_path):
    (tmp_path / "suite").mkdir()
    for name, seed in (("good", 1), ("bad", -3)):
        (tmp_path / "suite" / f"{name}.yaml").write_text(
            f"# @package _global_\nsuite: {{name: {name}}}\nseed: {seed}\n"
        )
    words = ["-m", "--config-dir", str(tmp_path), *CELL[:3]]
    require_sound([*words, "+suite=good,static_dynamic", "out=s3://bucket/of/results", "hydra/launcher=basic"])
    with pytest.raises(ClothbenchError, match="setting 'seed' is -3"):
        require_sound([*words, "+suite=good,bad"])


def test_settings_may_be_given_as_one_mapping():
    """They are added to what the suite has, as each by itself would be, and leave the rest of a budget alone."""
    suite = ["suite=static_dynamic", "budget=paper"]
    for word, same in (
        ("bounds={k1:[10,500]}", ["bounds.k1=[10,500]"]),
        ("options={ga:{generations:3},mass_spring:{resolution:5}}",
         ["options.ga.generations=3", "options.mass_spring.resolution=5"]),
    ):  # fmt: skip
        assert composed([*suite, word]) == composed([*suite, *same])


@pytest.mark.parametrize(
    ("setting", "found"),
    [
        ("scene.start=a=b", "Hydra cannot read (mismatched input '=' expecting <EOF>); a value with signs like ="),
        ("scene.thickness=it's", 'found "++scene.thickness=it\'s", which Hydra cannot read; a value with signs like'),
        ("analysis.sobol.cases=[nope]", "'analysis.sobol.cases' is ['nope'], which matches none of the cases"),
        ("analysis={sobol:{cases:nope}}", "'analysis.sobol.cases' is nope, which matches none of the cases"),
        ("bounds={k9:[1,2]}", "setting 'bounds': no parameter 'k9'"),
        ("+options.ga.nonsense=1", "nonsense"),
        ("options.ga.seed=1", "setting 'options.ga.seed': found what a run sets; give seed=… instead"),
        ("options.gaa.population=5", "plugin in 'options' 'gaa' is not known; did you mean 'ga'?"),
        ("bugdet=3", "'bugdet' is not known; did you mean 'budget'? `clothbench run --cfg job` shows all"),
        ("bounds.zetta=[1,2]", "no parameter 'zetta'; did you mean 'zeta'? there are: k1, k2, zeta"),
        ("prior=denimm", "of that class at hand; did you mean 'denim'? there are: any, cotton, denim, "),
        ("model.dt=0.1", "setting 'model.dt' is not known"),
        ("options.ga.nonsense=1", "nonsense"),
        ("scene.size=1", "setting of 'scene' 'size' is not known"),
        ("+options.gaa.population=5", "plugin in 'options' 'gaa' is not known"),
        ("+options.ga.population=1", "population is 1, expected a whole number, at least 3"),
        ("+options.mass_spring.dt=abc", "dt is 'abc'"),
        ("options=3", "setting 'options' is 3"),
        (
            "options.quadratic_drag.normal=5",
            "'options.quadratic_drag': found an effect, which takes no options; bounds",
        ),
        ("budget=abc", "setting 'budget' is 'abc', expected a whole number, at least 1"),
        ("budget=1.5", "setting 'budget' is 1.5"),
        ("seed=-1", "setting 'seed' is -1"),
        (f"seed={10**20}", f"setting 'seed' is {10**20}, expected a whole number, at least 0 and below 2⁶³"),
        ("jobs=x", "setting 'jobs' is 'x'"),
        ("timeout=abc", "setting 'timeout' is 'abc', expected a number above 0"),
        ("rerun=maybe", "setting 'rerun' is 'maybe'"),
        ("+bounds.k1=3", "setting 'bounds.k1' is 3, expected [low,high]"),
        ("+bounds.k1=[5,3]", "expected low below high"),
        ("+bounds.nope=[1,2]", "no parameter 'nope'; there are: k1, k2, zeta"),
        ("scene.resolution=5", "expected [nodes along u, along v]"),
        ("scene.resolution=[2,2]", "setting 'scene.resolution' is 2"),
        ("scene.areal_density=abc", "setting 'scene.areal_density' is 'abc'"),
        ("scene.areal_density=220", "expected kg/m², 5 at most; if g/m² were meant, give 0.22"),
        ("scene.areal_density=0.15", "states 0.2 kg/m², as all 2 do; leave it out"),
        ("recording=x.nc", "found settings 'recording' and 'recordings', expected one of them"),
        ("recording=3", "found settings 'recording' and 'recordings', expected one of them"),
        ("data_dir=[3]", "setting 'data_dir' is ['3'], expected a folder"),
        ("data_dir=[a,b]", "setting 'data_dir' is ['a', 'b'], expected a folder"),
        ("recordings=pkg://nowhere/x", "install the package that has them"),
        ("out=/proc/nothing", "cannot be written to"),
    ],
)
def test_a_wrong_setting_is_refused_before_anything_is_run(clothbench, recordings_folder, tmp_path, setting, found):
    words = dict(w.split("=", 1) for w in (f"recordings={recordings_folder}", *CELL))
    key, value = setting.split("=", 1)
    out = clothbench("run", *(f"{k}={v}" for k, v in {**words, key: value}.items()))
    assert out.returncode == 2, out.stderr
    assert found in only_line(out.stderr)
    assert [p.name for p in tmp_path.iterdir()] == ["recordings"]


def test_a_terminal_that_cannot_write_every_letter_shows_another(clothbench):
    out = clothbench("presets", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert out.returncode == 0, out.stderr
    assert "?" in out.stdout
    assert out.stdout.isascii()
    assert out.stderr == ""


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_json_names_things_as_they_are_wherever_it_goes(tmp_path, monkeypatch, encoding):
    """Latin-1 has ü, but what reads JSON takes it for UTF-8."""
    write_recording(swinging_recording(), path := tmp_path / "ü – 1.nc")
    with (tmp_path / "out").open("w+", encoding=encoding) as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert main(["validate", "--json", str(path)]) == 0
        print_json_rows([{"recording": "ü – 1"}])
    first, end = json.JSONDecoder().raw_decode(text := (tmp_path / "out").read_text(encoding="utf-8"))
    assert first[0]["file"] == str(path)
    assert json.loads(text[end:]) == [{"recording": "ü – 1"}]
    assert text.isascii() == (encoding != "utf-8")


@pytest.mark.parametrize("words", [
    ["import", "cusick_drape_bdp", "out=30", "data_dir=here", "out=60"], ["suggest", "here", "out=30", "out=60"],
    ["report", "out=30", "out=60"],
])  # fmt: skip
def test_a_setting_that_is_given_two_values_is_refused(capsys, words):
    assert main(words) == 2
    assert only_line(capsys.readouterr().err).endswith("out is given twice: 30 and 60; leave one of them out")


@pytest.mark.parametrize("words", [["validate", "nowhere"], ["run", "model=none", "optimizer=ga", "recording=nowhere"]])
def test_a_traceback_that_was_asked_for_changes_no_exit_code(capsys, monkeypatch, tmp_path, words):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    plain = capsys.readouterr().err
    assert main([*words, "--debug"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("Traceback")
    assert said.endswith("\n" + only_line(plain) + "\n")


def test_a_file_that_cannot_be_written_is_exit_2_also_with_its_traceback(capsys, monkeypatch):
    def full(options):
        raise OSError(28, "No space left on device", "page.html")

    monkeypatch.setitem(COMMANDS, "plugins", full)
    assert main(["plugins", "--debug"]) == 2
    assert capsys.readouterr().err.endswith("\nclothbench: page.html: No space left on device\n")


def test_a_run_says_which_of_two_values_counts(capsys):
    say_twice(["budget=6", "++budget=7", "+a.b=1", "+a.b=2", "~c=1", "~c=2", "jobs=1", "jobs=1"])
    assert capsys.readouterr().err == ""
    say_twice(["budget=6", "-m", "model=m", "budget=7"])
    assert capsys.readouterr().err == "clothbench: run: budget is given twice: 6 and 7; the last counts\n"


def test_a_gate_says_it_one_way_only(capsys):
    assert main(["compare", "a.json", "b.json", "--json", "--markdown"]) == 2
    assert "argument --json: not allowed with argument --markdown" in capsys.readouterr().err


def test_options_of_a_plugin_that_is_not_in_use_are_told(capsys):
    cell = SimpleNamespace(versions={"models/mass_spring": "1", "optimizers/cma_es": "1"})
    say_idle(["options.ga.generations=9", "++options.cma_es.sigma=1", "budget=3"], [cell], {})
    assert capsys.readouterr().err == "clothbench: options.ga: ga is not in use here, so this changes nothing\n"


@pytest.mark.parametrize(("fabric", "case", "told"), [("", "", True), ("", "recording", False), ("silk", "", False)])
def test_recordings_that_state_no_fabric_are_told_to_be_cases_of_their_own(tmp_path, capsys, fabric, case, told):
    for name in ("swing-1", "swing-2", "swing-3"):
        write_recording(swinging_recording(name, fabric=fabric), tmp_path / f"{name}.nc")
    words = [f"recordings={tmp_path}", "model=mass_spring", "optimizer=ga", "metric=node_error"]
    config = composed([*words, *([f"suite.case={case}"] if case else [])])
    say_alone(config, plan(config, catalogue()))
    said = capsys.readouterr().err
    assert ("3 recordings state no fabric" in said and "suite.case=all takes them together" in said) == told
    assert bool(said) == told


def test_what_changes_nothing_is_told(recordings_folder, capsys):
    words = [f"recordings={recordings_folder}", "model=mass_spring", "optimizer=ga", "options.mass_spring.resolution=5"]
    for more, told in (
        (["metric=node_error"], ""),
        (["metric=node_error", "scene.spacing=0.05"], "clothbench: options.mass_spring.resolution: the scene says how"),
        (["metric=[node_error,fold]", "choice=knee"], "clothbench: choice: fold, node_error has one objective, and no"),
        (["metric=node_error", "data_dir=originals"], "clothbench: data_dir: no recordings of a data set are named"),
    ):
        config = composed([*words, *more])
        say_idle([*words, *more], plan(config, catalogue()), config)
        said = capsys.readouterr().err
        assert said.startswith(told)
        assert said.count("so this changes nothing\n") == said.count("\n") == bool(told)
    drape = SimpleNamespace(versions={}, metric="drape", choice="knee", options={"drape": {"quantities": ["folds"]}})
    say_idle(["choice=knee"], [drape], {})
    assert "choice: drape has one objective" in capsys.readouterr().err
    drape.options = {}
    say_idle(["data_dir=originals"], [drape], {"suite": {"recordings": ["dataset:cusick_drape_bdp"]}})
    say_idle(["choice=knee"], [drape], {})
    assert capsys.readouterr().err == ""


def test_a_reader_that_goes_away_is_no_failure(clothbench, tmp_path):
    """As `| head -1` does, after one line or before any."""
    for words in (["plugins"], ["plugins", "--json"], ["presets"], ["--version"]):
        command = [sys.executable, "-m", "clothbench", *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path) as reading:
            reading.stdout.close()
            said = reading.stderr.read().decode()
        assert (reading.returncode, said) == (0, ""), (words, said)


def unheard(words, folder):
    """The exit code of a command that nobody listens to."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        return subprocess.run(
            [sys.executable, "-m", "clothbench", *map(str, words)], stdout=writing, stderr=writing, cwd=folder
        ).returncode
    finally:
        os.close(writing)


@pytest.mark.slow
def test_a_command_that_nobody_listens_to_goes_on_to_its_end(recordings_folder, tmp_path):
    """As of `… 2>&1 | head -1`: its page is there, and its exit code says what it found."""
    assert unheard(["run", f"recordings={recordings_folder}", *CELL, "seed=1", "jobs=1"], tmp_path) == 0
    assert (tmp_path / "runs" / "report.html").is_file()
    row = {"suite": "s", "case": "c", "value": 10.0, "low": 9.0, "high": 11.0, "unit": "mm", "status": "ok"}
    (tmp_path / "base.json").write_text(json.dumps([row]))
    (tmp_path / "worse.json").write_text(json.dumps([{**row, "value": 20.0, "low": 19.0, "high": 21.0}]))
    for words in ([], ["--json"], ["--markdown"]):
        assert unheard(["compare", "base.json", "worse.json", *words], tmp_path) == 1


def test_only_the_suite_that_is_asked_for_is_read(tmp_path):
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "broken.yaml").write_text("a: [")
    (tmp_path / "suite" / "mine.yaml").write_text("# @package _global_\nsuite: {name: mine}\n")
    flag = ["--config-dir", str(tmp_path)]
    require_harmless([*flag, "+suite=mine"])
    for word in ("+suite=broken", "suite=mine,broken"):
        with pytest.raises(ClothbenchError, match=r"broken\.yaml: found no YAML that can be read"):
            require_harmless([*flag, word])
    (tmp_path / "suite" / "mine.yaml").write_text("defaults: [broken]\n")  # which brings others in
    with pytest.raises(ClothbenchError, match=r"broken\.yaml: found no YAML that can be read"):
        require_harmless([*flag, "+suite=mine"])


def test_a_suite_with_a_byte_order_mark_is_told_so(tmp_path):
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "mine.yaml").write_text("# @package _global_\nbudget: 5\n", encoding="utf-8-sig")
    with pytest.raises(ClothbenchError, match=r"mine\.yaml: found a byte order mark, expected none; save it as UTF-8"):
        require_harmless(["--config-dir", str(tmp_path), "+suite=mine"])


def test_an_import_that_is_told_to_end_leaves_nothing_half_written(tmp_path, monkeypatch, capsys):
    def converted(*told, **settings):
        with whole_folder(tmp_path / "imp") as part:
            (part / "half.nc").touch()
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)  # Python hears of it between two instructions

    monkeypatch.setattr("clothbench.datasets.convert.converted", converted)
    before = signal.getsignal(signal.SIGTERM)
    assert main(["import", "knit_uniaxial_gatech"]) == 130
    assert "clothbench: stopped" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_stopped_bench_keeps_nothing_and_says_so(monkeypatch, capsys):
    def stopped(sides, progress):
        progress("mass_spring: 9 nodes a side")
        raise KeyboardInterrupt

    monkeypatch.setattr("clothbench.studies.speed.bench.run_bench", stopped)
    assert main(["bench", "--quick"]) == 130
    said = capsys.readouterr().err
    assert said.startswith("mass_spring: 9 nodes a side\nclothbench: stopped; a speed is a ratio within one run")


@pytest.mark.parametrize(("command", "kept"), [("units", False), ("import", False), ("improve", True)])
def test_only_commands_that_keep_something_say_so_when_they_are_stopped(monkeypatch, capsys, command, kept):
    def stopped(options):
        raise KeyboardInterrupt

    monkeypatch.setitem(COMMANDS, command, stopped)
    assert main([command, "x"]) == 130
    said = capsys.readouterr().err
    assert said.startswith("clothbench: stopped")
    assert ("kept" in said) == kept


def test_a_step_too_long_diverges_with_its_reason(clothbench, recordings_folder):
    out = clothbench("run", f"recordings={recordings_folder}", *CELL, "+options.mass_spring.dt=0.05", "rerun=false")
    assert out.returncode == 1
    row = json.loads(clothbench("leaderboard", "--json").stdout)[0]
    assert (row["status"], row["value"]) == ("diverged", None)
    assert "step is too long" in row["reason"]


def test_a_time_limit_keeps_the_best_so_far(clothbench, recordings_folder):
    out = clothbench(
        "run",
        f"recordings={recordings_folder}",
        *CELL,
        "budget=1000000",
        "+options.ga.generations=100000",
        "timeout=2",
        "rerun=false",
    )
    assert out.returncode == 1
    row = json.loads(clothbench("leaderboard", "--json").stdout)[0]
    assert row["status"] == "timeout"
    assert row["value"] > 0


def test_validate(clothbench, recordings_folder, tmp_path):
    good = clothbench("validate", recordings_folder)
    assert good.returncode == 0
    assert good.stdout.count(": ok") == 2
    (recordings_folder / "bad.nc").write_text("time,node")
    bad = clothbench("validate", recordings_folder, "--json")
    assert bad.returncode == 1
    faults = [r["fault"] for r in json.loads(bad.stdout) if not r["ok"]]
    assert len(faults) == 1
    assert "bad.nc" in faults[0]


def test_bad_input_to_run_writes_nothing(clothbench, recordings_folder, tmp_path):
    (recordings_folder / "bad.nc").write_text("time,node")
    for sweep in ((), ("-m", "seed=1,2")):
        out = clothbench("run", *sweep, f"recordings={recordings_folder}", *CELL)
        assert out.returncode == 2
        assert "bad.nc" in only_line(out.stderr)
        assert [p.name for p in tmp_path.iterdir()] == ["recordings"]


@pytest.mark.data
def test_every_broken_recording_is_refused_by_run(clothbench, data_dir, tmp_path):
    broken = sorted((data_dir / "bad-recordings").glob("*.nc"))[::4]
    assert broken
    for path in broken:
        out = clothbench("run", f"recording={path}", *CELL)
        assert out.returncode == 2
        assert path.name in only_line(out.stderr)
        assert not list(tmp_path.iterdir())


def test_plugins_as_json_and_as_table(clothbench):
    rows = json.loads(clothbench("plugins", "--json").stdout)
    assert {r["kind"] for r in rows} >= {"model", "effect", "metric", "optimizer", "tracker"}
    assert not [r for r in rows if r["broken"]]
    model = next(r for r in rows if r["name"] == "mass_spring")
    assert [(p["name"], p["unit"]) for p in model["parameters"]] == [("k1", "N/m"), ("k2", "N/m"), ("zeta", "1")]
    assert model["options"] == {
        "resolution": 13,
        "dt": None,
        "step_scale": 1.0,
        "precision": "double",
        "strain_limit": None,
    }
    assert next(r for r in rows if r["name"] == "least_squares")["options"]["starts"] == 31  # its seed is no option
    assert "mass_spring" in clothbench("plugins").stdout


def test_compare_is_a_gate(clothbench, tmp_path):
    row = {"suite": "s", "case": "c", "value": 10.0, "low": 9.0, "high": 11.0, "unit": "mm", "status": "ok"}
    (tmp_path / "base.json").write_text(json.dumps([row]))
    (tmp_path / "same.json").write_text(json.dumps([{**row, "value": 10.4}]))
    (tmp_path / "worse.json").write_text(json.dumps([{**row, "value": 20.0, "low": 19.0, "high": 21.0}]))
    assert clothbench("compare", "base.json", "same.json").returncode == 0
    worse = clothbench("compare", "base.json", "worse.json")
    assert worse.returncode == 1
    assert "gate failed" in worse.stdout
    assert not json.loads(clothbench("compare", "base.json", "worse.json", "--json").stdout)["passed"]


def test_a_narrow_terminal_shows_what_a_row_is_about():
    about = dict.fromkeys(ROW) | {
        "suite": "s", "case": "linen", "model": "mass_spring", "optimizer": "ga", "metric": "node_error", "key": "a",
        "objective": "node_error", "evaluations": 25, "split": "held_out", "unit": "mm", "status": "ok",
        "value": 10.23, "low": 9.1, "high": 11.2, "floor": 1.5,
    }  # fmt: skip
    narrow = Console(width=40, record=True, file=io.StringIO())
    narrow.print(error_table("s", [about | {"recording": "waving-1"}]))
    said = narrow.export_text()
    assert "waving-1" in said
    assert "10.2 mm" in said


def test_keys_are_said_to_be_where_they_are(capsys):
    for words in (["store", "prune", "--help"], ["view", "--help"]):
        with pytest.raises(SystemExit):
            main(words)
        assert "clothbench leaderboard --json" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", ["view swing --runs there", "leaderboard --runs there"])
def test_a_results_folder_goes_by_the_name_that_export_has_for_it_too(command):
    assert parsed(command.split()).out == "there"


def test_the_help_of_improve_has_every_setting_that_it_takes(capsys):
    with pytest.raises(SystemExit):
        main(["improve", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert [word for word in SHOWN if not re.search(rf"\b{word}(=|\.)", told)] == []


@pytest.mark.parametrize(("columns", "width"), [("60", 60), ("", 120), ("no number", 120)])
def test_a_table_that_is_piped_is_as_wide_as_columns_says(monkeypatch, columns, width):
    monkeypatch.setenv("COLUMNS", columns)
    assert console().width == width


def test_an_empty_leaderboard_says_what_to_do(clothbench):
    out = clothbench("leaderboard")
    assert out.returncode == 0
    assert "clothbench run +suite=static_dynamic" in out.stdout
    assert json.loads(clothbench("leaderboard", "--json").stdout) == []
