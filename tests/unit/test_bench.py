"""The bench: what its rows say, and what a broken or absent plugin does to it. Its models are toys."""

from __future__ import annotations

import json
import textwrap
from types import SimpleNamespace

import pytest

from clothbench import ClothbenchError
from clothbench.display.terminal import console
from clothbench.engine.system import system_info
from clothbench.plugins.discovery import Catalogue, Plugin
from clothbench.studies.speed import bench, timing
from clothbench.studies.speed.answer import answer_of
from clothbench.studies.speed.roofline import Core
from clothbench.studies.speed.tables import sections, speed_tables

SCHEMA = [
    "model", "kind", "nodes", "threads", "batch", "node_steps_per_s", "realtime_factor", "peer", "ratio",
]  # fmt: skip

TOYS = """
    import time
    from types import SimpleNamespace

    import numpy as np
    from clothbench import Parameter, ParameterSpace, Rollout

    class Toy:
        name, version, kind, capabilities = "toy", 3, "explicit", frozenset({"dynamic"})
        parameters = ParameterSpace((Parameter("k", "k", "N/m", (1.0, 9.0), "log", 5.0, "none", "none"),))
        bench_options = ({}, {"precision": "single"})
        pace = 1e-4  # s a sheet

        def __init__(self, precision="double", dt=None):
            self.precision, self.dt = precision, dt

        def prepare(self, scene, effects=()):
            return SimpleNamespace(parameters=self.parameters, run=lambda theta: self.run(scene, theta))

        def run(self, scene, theta):
            assert (theta == 5.0).all()
            time.sleep(self.pace)
            status = ("diverged" if self.diverges(scene) else "ok",) * len(theta)
            nodes = scene.resolution[0] * scene.resolution[1]
            steps = np.full(len(theta), 1000)
            return Rollout(scene.times, np.zeros((len(theta), 1, 1, 3)), status, steps, nodes)

        def diverges(self, scene):
            return False

    class Counted(Toy):
        bench_options = ({},)
        work_per_node_step = {"operations": 4.0, "roots": 1.0, "numbers": 8.0}

    class Still(Toy):
        capabilities = frozenset({"static"})
        bench_options = ({},)

        def prepare(self, scene, effects=()):
            assert (scene.grip_position == scene.grip_position[0]).all()
            return super().prepare(scene, effects)

    class Curved(Toy):
        capabilities = frozenset({"curve"})

    class Stiff(Toy):
        bench_options = ({},)

        def diverges(self, scene):
            return self.dt is not None

    class Lost(Stiff):
        def diverges(self, scene):
            return True

    class Faulty:
        capabilities = frozenset({"dynamic"})

        def prepare(self, scene, effects=()):
            raise ZeroDivisionError("no cloth today")

    def skip_reason():
        return None

    def step_sheet(side, dt, steps):
        return SimpleNamespace(nodes=side**2, node_steps_per_s=2e6, finite=side < 50, version="1.2")
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Call it with names of toys: they, and they alone, are the plugins."""
    (tmp_path / "toys.py").write_text(textwrap.dedent(TOYS))
    (tmp_path / "absent.py").write_text("def skip_reason(): return 'pip install clothbench[absent]'\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # for the separate processes
    for name, value in (("MIN_SECONDS", 0.0), ("REPEATS", 1), ("ROUNDS", 1)):
        monkeypatch.setattr(timing, name, value)

    def use(*models: str, peers: tuple[str, ...] = ()):
        plugins = [Plugin("models", m.lower(), f"toys:{m}", "", "test", "1") for m in models]
        plugins += [Plugin("peers", p, p, "a peer", "test", "1") for p in peers]
        monkeypatch.setattr(bench, "catalogue", lambda: Catalogue(tuple(plugins)))
        return plugins

    return use


@pytest.fixture
def one_core(monkeypatch):
    """No comparison with separate processes, which take seconds to start."""
    monkeypatch.setenv("CLOTHBENCH_THREADS", "1")


def test_rows_have_the_keys_of_the_schema(install, one_core):
    install("Toy", peers=("toys",))
    rows = bench.run_bench(sides=(5,))
    assert rows
    assert all(tuple(row) == bench.KEYS and list(row)[: len(SCHEMA)] == SCHEMA for row in rows)
    json.dumps(rows, allow_nan=False)


def test_every_case_of_a_model_stands_beside_every_peer(install, monkeypatch):
    monkeypatch.setenv("CLOTHBENCH_THREADS", "3")
    monkeypatch.setattr(bench, "two_cores", lambda name, side: [])
    install("Toy", peers=("toys",))
    rows = [r for r in bench.run_bench(sides=(5, 7)) if r["model"] == "toy"]
    cases = [(r["nodes"], r["precision"], r["threads"], r["batch"]) for r in rows]
    expected = [(n, p, t, b) for n in (25, 49) for p in ("double", "single") for t, b in ((1, 1), (1, 64), (3, 64))]
    assert cases == expected
    about = {(r["kind"], r["version"], r["peer"], r["note"]) for r in rows}
    assert about == {("explicit", 3, "toys", "step 0.2 ms")}


def test_a_model_that_says_what_its_steps_take_is_held_against_the_roofline(install, one_core, monkeypatch):
    """64 B, 4 operations and a root a node-step; 6.4 GB, a billion operations and half as many roots a second."""
    core = Core(operations=1e9, roots=0.5e9, bytes=6.4e9, size=8)
    monkeypatch.setattr(bench, "measured_core", lambda precision: core)
    install("Counted", "Still", "Stiff", peers=("toys",))
    rows = bench.run_bench(sides=(5, 7))
    found = [r for r in rows if r["peer"] == bench.ROOFLINE]
    fastest = max(r["node_steps_per_s"] for r in rows if r["model"] == "counted")
    assert [r["model"] for r in found] == ["counted"]
    assert found[0]["ratio"] == pytest.approx(fastest / 1e8)
    lines = [line for line in speed_tables(rows) if isinstance(line, str)]
    assert "of 100 million node-steps/s that memory allows one core (6 GB/s, 64 B a node-step)" in lines[-1]
    assert "arithmetic would allow 250, roots would allow 500" in lines[-1]
    assert bench.ROOFLINE not in answer_of(rows)
    (page,) = sections(SimpleNamespace(table=lambda name: [*rows, *found]))
    assert page.html.count("that memory allows one core") == 1
    assert bench.ROOFLINE not in page.html


def test_ratios_are_per_thread_and_to_the_peer_of_the_same_size(install, monkeypatch):
    monkeypatch.setenv("CLOTHBENCH_THREADS", "2")
    monkeypatch.setattr(bench, "two_cores", lambda name, side: [])
    install("Toy", peers=("toys",))
    rows = bench.run_bench(sides=(5, 7))
    speed = {r["nodes"]: r["node_steps_per_s"] for r in rows if r["model"] == "toys"}
    assert speed == {25: pytest.approx(2e6), 49: pytest.approx(2e6)}
    for row in (r for r in rows if r["model"] == "toy"):
        assert row["ratio"] == pytest.approx(row["node_steps_per_s"] / row["threads"] / speed[row["nodes"]])


def test_the_speed_counts_all_sheets_of_the_batch(install, one_core):
    install("Toy")
    one, many = bench.run_bench(sides=(5,))[:2]
    # 25 nodes × 1000 steps a sheet, 0.1 s of simulated time; a toy takes as long for 64 sheets as for one.
    assert one["node_steps_per_s"] / one["realtime_factor"] == pytest.approx(25 * 1000 / timing.FIRST_SPAN)
    assert many["node_steps_per_s"] / many["realtime_factor"] == pytest.approx(25 * 1000 / timing.FIRST_SPAN)
    assert one["node_steps_per_s"] <= 25 * 1000 / 1e-4


def test_a_run_is_made_long_enough():
    spans = []

    def run(span):
        spans.append(span)
        return timing.Speed(nodes=4, node_steps=4e3 * span, simulated=span, seconds=span / 10)

    assert timing.best_of(run).seconds >= timing.MIN_SECONDS
    assert spans == sorted(spans)
    assert spans[-timing.REPEATS :] == [spans[-1]] * timing.REPEATS


def test_without_peers_a_model_has_one_row_a_case(install, one_core):
    install("Toy")
    rows = bench.run_bench(sides=(5,))
    assert len(rows) == 4
    assert {(r["peer"], r["ratio"]) for r in rows} == {(None, None)}


def test_an_absent_peer_is_named_on_standard_error(install, one_core, capsys):
    install("Toy", peers=("absent", "toys"))
    rows = bench.run_bench(sides=(5,))
    assert {r["peer"] for r in rows} == {None, "toys"}
    printed = capsys.readouterr()
    assert printed.err.splitlines() == ["absent: skipped: pip install clothbench[absent]"]
    assert printed.out == ""


def test_a_peer_that_blows_up_has_no_row(install, one_core, capsys):
    install(peers=("toys",))
    assert [r["nodes"] for r in bench.run_bench(sides=(51, 5))] == [25]
    assert "toys: skipped: its sheet of 51 × 51 nodes blew up" in capsys.readouterr().err


def test_a_static_model_settles_one_sheet_of_each_size(install, monkeypatch, capsys):
    monkeypatch.setenv("CLOTHBENCH_THREADS", "2")
    monkeypatch.setattr(bench, "two_cores", lambda name, side: pytest.fail("there is no motion to be divided"))
    install("Still", peers=("toys",))
    rows = [r for r in bench.run_bench(sides=(5, 21)) if r["model"] == "still"]
    about = [(r["kind"], r["nodes"], r["threads"], r["batch"], r["realtime_factor"], r["peer"]) for r in rows]
    assert about == [("static", n, 1, 1, None, None) for n in (25, 441)]
    assert all(0 < r["node_steps_per_s"] <= r["nodes"] * 1000 / 1e-4 for r in rows)
    json.dumps(rows, allow_nan=False)
    assert capsys.readouterr().err == ""


def test_what_finds_rest_is_shown_as_such_and_never_the_quickest(install, one_core, capsys):
    install("Still", "Toy")
    rows = bench.run_bench(sides=(5,))
    rows = [r | {"node_steps_per_s": 8520.0} if r["model"] == "still" else r for r in rows]
    console().print(speed_tables(rows)[0])
    line = next(line for line in capsys.readouterr().out.splitlines() if "still" in line)
    assert "0.0085" in line
    said = answer_of([r | {"node_steps_per_s": 1e12} if r["model"] == "still" else r for r in rows])
    assert "The quickest steps are <b>toy</b>" in said
    assert "million node-iterations/s" in said
    (page,) = sections(SimpleNamespace(table=lambda name: rows))
    assert page.html.count(bench.SETTLING) == 1


def test_a_model_without_sheets_is_not_measured(install, one_core, capsys):
    install("Curved")
    assert bench.run_bench(sides=(5,)) == []
    assert capsys.readouterr().err == ""


def test_a_broken_model_does_not_stop_the_bench(install, one_core, capsys):
    install("Faulty", "Missing", "Toy")
    assert {r["model"] for r in bench.run_bench(sides=(5,))} == {"toy"}
    lines = capsys.readouterr().err.splitlines()
    assert "faulty: skipped: ZeroDivisionError: no cloth today" in lines
    assert any(line.startswith("missing: skipped: model 'missing' (test) is broken") for line in lines)


def test_a_plugin_known_to_be_broken_is_named(install, one_core, monkeypatch, capsys):
    plugins = [Plugin("module", "odd", "odd", "", "test", "1", "ImportError: no module"), *install("Toy")]
    monkeypatch.setattr(bench, "catalogue", lambda: Catalogue(tuple(plugins)))
    assert bench.run_bench(sides=(5,))
    assert capsys.readouterr().err.splitlines() == ["odd: skipped: ImportError: no module"]


def test_a_model_unstable_at_the_peers_step_is_timed_at_its_own(install, one_core):
    install("Stiff")
    assert {r["note"] for r in bench.run_bench(sides=(5,))} == {"own step"}


def test_a_model_that_always_diverges_has_no_row(install, one_core, capsys):
    install("Lost")
    assert bench.run_bench(sides=(5,)) == []
    assert "lost: skipped: its sheet of 5 × 5 nodes could not be timed: diverged" in capsys.readouterr().err


def test_threads_are_compared_with_separate_processes(install, monkeypatch):
    monkeypatch.setenv("CLOTHBENCH_THREADS", "2")
    install("Toy")
    (row,) = bench.two_cores("toy", 5)
    assert tuple(row) == bench.KEYS
    assert (row["peer"], row["threads"]) == (bench.PROCESSES, 2)
    assert row["note"] == "share of two separate processes"
    assert row["ratio"] > 0


def test_a_process_that_fails_is_an_error_and_not_a_hang(install, monkeypatch):
    monkeypatch.setenv("CLOTHBENCH_THREADS", "2")
    install("Toy")
    monkeypatch.delenv("PYTHONPATH")  # now the processes do not find the toy
    with pytest.raises(timing.FailedRun, match="ended before it had run"):
        bench.two_cores("toy", 5)


def test_one_core_has_nothing_to_compare(install, one_core):
    install("Toy")
    assert bench.two_cores("toy") == []


def test_the_number_of_threads_is_given_back(install, monkeypatch):
    monkeypatch.setenv("CLOTHBENCH_THREADS", "5")
    with timing.on_threads(1):
        assert bench.thread_count() == 1
    assert bench.thread_count() == 5


def test_progress_is_told_what_comes_next(install, one_core):
    install("Toy", peers=("toys",))
    told = []
    bench.run_bench(sides=(5,), progress=told.append)
    assert told[0] == "toys: 5 × 5 nodes"
    assert "toy precision=single: 5 × 5 nodes, 64 at once, 1 thread(s)" in told


def test_the_table_has_a_line_for_each_measurement(install, one_core, capsys):
    install("Toy", peers=("toys",))
    rows = bench.run_bench(sides=(5,))
    rows.append(rows[-1] | {"peer": bench.PROCESSES, "ratio": 0.97, "note": "share of two processes"})
    for shown in speed_tables(rows):
        console().print(shown)
    out = capsys.readouterr().out
    assert "node-steps/s" in out
    assert "× │" in out or "× ┃" in out
    assert "toys ┃" in out
    assert "…" not in out  # where it is narrow, words give way to numbers
    assert all(len(line) <= 120 for line in out.splitlines())
    assert sum("toy " in line and "│" in line for line in out.splitlines()) == 4
    assert "0.97, share of two processes" in out


def test_speeds_are_kept_and_shown_as_a_study(tmp_path, monkeypatch):
    """One cell; every measurement a row, lower is better; the table and the page show them."""
    from clothbench.cli.results import print_results
    from clothbench.engine.run import run_cell
    from clothbench.engine.store import Store
    from clothbench.plugins.discovery import catalogue
    from clothbench.report.page import write_page
    from clothbench.studies.speed.cell import NOT_TIMED, plan, refuse_settings

    blank = dict.fromkeys(bench.KEYS)
    measured = {**blank, "model": "mass_spring", "nodes": 81, "threads": 1, "batch": 1, "node_steps_per_s": 5e7,
                "realtime_factor": 9.0, "version": 2}  # fmt: skip
    rows = [measured | {"peer": p, "ratio": r} for p, r in (("one", 2.0), ("other", 4.0))]
    monkeypatch.setattr("clothbench.studies.speed.run.run_bench", lambda sides, progress, chosen: rows)
    settings = {**dict.fromkeys(NOT_TIMED, ()), "scene": {}, "suite": {"sides": [9]}, "model": ["mass_spring"]}
    (cell,) = plan(settings, catalogue())
    assert run_cell(cell, tmp_path) == "ok"
    (row,) = print_results(Store(tmp_path))
    assert (row["study"], row["value"], row["unit"]) == ("speed", pytest.approx(0.02), "s")
    assert "mass_spring" in write_page(tmp_path).read_text()
    with pytest.raises(ClothbenchError, match="setting 'optimizer': speed is measured"):
        refuse_settings({**settings, "optimizer": ["ga"]})
    with pytest.raises(ClothbenchError, match="setting 'options': speed is measured"):
        refuse_settings({**settings, "options": {"mass_spring": {"precision": "single"}}})
    with pytest.raises(ClothbenchError, match="setting 'timeout': speed is measured"):
        refuse_settings({**settings, "timeout": 9.0})
    with pytest.raises(ClothbenchError, match="setting 'budget': speed is measured"):
        refuse_settings({**settings, "budget": 3})


def test_each_size_of_sheet_is_measured_once_and_an_empty_list_is_none():
    from clothbench.studies.speed.cell import mesh_sides

    assert mesh_sides([9, 9, 21]) == (9, 21)
    assert mesh_sides(9) == (9,)
    assert mesh_sides(None) == bench.SIDES
    with pytest.raises(ClothbenchError, match=r"setting 'suite\.sides' is empty; give numbers of nodes"):
        mesh_sides([])


def test_speed_is_asked_anew_on_another_machine_or_beside_other_peers(install, monkeypatch):
    from clothbench.studies.speed import cell as of_speed

    settings = {**dict.fromkeys(of_speed.NOT_TIMED, ()), "scene": {}, "suite": {"sides": [9]}, "model": ["toy"]}

    def key(*peers):
        (cell,) = of_speed.plan(settings, Catalogue(tuple(install("Toy", peers=peers))))
        return cell.key

    alone, beside = key(), key("toys")
    assert len({alone, beside}) == 2
    assert key("toys", "absent") == beside  # one that cannot run here is no peer
    assert key("toys") == beside
    import toys

    monkeypatch.setattr(toys, "built_on", ("numpy",), raising=False)
    assert key("toys") not in (alone, beside)
    monkeypatch.setattr(toys, "built_on", (), raising=False)
    monkeypatch.setenv("CLOTHBENCH_THREADS", "63")
    assert key() != alone
    monkeypatch.delenv("CLOTHBENCH_THREADS")
    assert key() == alone
    monkeypatch.setattr(of_speed, "system_info", lambda: {"cpu": "another", "cores": 2})
    assert key() != alone


def test_speeds_measured_by_another_version_of_the_study_are_another_question():
    from clothbench.studies.speed.cell import SpeedCell

    assert SpeedCell("speed", (), (9,), testbed=0).key != SpeedCell("speed", (), (9,)).key


def test_a_study_measures_all_sheets_in_one_run_and_counts_what_is_done(tmp_path, monkeypatch):
    """A run for each number of nodes had measured cores, and threads against processes, as often."""
    from clothbench.engine.study import Context
    from clothbench.studies.speed.cell import SpeedCell
    from clothbench.studies.speed.run import run

    asked, steps = [], []

    def run_bench(sides, progress, chosen):
        asked.append((sides, chosen))
        for side in sides:
            progress(f"toy: {side} × {side} nodes")
        return []

    monkeypatch.setattr("clothbench.studies.speed.run.run_bench", run_bench)
    told = Context(Catalogue(()), tmp_path, lambda done, value: steps.append((done, value)))
    assert run(SpeedCell("speed", ("toy",), (9, 21, 41)), told).status == "skipped"
    assert asked == [((9, 21, 41), ("toy",))]
    assert steps == [(0, 0.0), (1, 1.0), (2, 2.0)]


def test_measurements_of_several_runs_are_kept_apart(tmp_path, monkeypatch):
    from clothbench.cli.results import print_results
    from clothbench.engine.run import run_cell
    from clothbench.engine.store import Store
    from clothbench.report.page import write_page
    from clothbench.studies.speed.cell import SpeedCell

    blank = dict.fromkeys(bench.KEYS)
    for cpu, rate in (("slow", 1e7), ("fast", 5e7)):
        measured = {**blank, "model": "mass_spring", "nodes": 81, "threads": 1, "batch": 1, "node_steps_per_s": rate,
                    "realtime_factor": 9.0, "peer": "one", "ratio": 2.0}  # fmt: skip
        monkeypatch.setattr("clothbench.studies.speed.run.run_bench", lambda *_, rows=(measured,), **__: list(rows))
        monkeypatch.setattr("clothbench.engine.rows.system_info", lambda cpu=cpu: {**system_info(), "cpu": cpu})
        assert run_cell(SpeedCell("speed", ("mass_spring",), (9,), machine={"cpu": cpu}), tmp_path) == "ok"
    assert len(print_results(Store(tmp_path))) == 2
    page = write_page(tmp_path).read_text()
    assert ">Speed: slow, " in page
    assert ">Speed: fast, " in page


def test_a_model_with_other_options_is_another_case(tmp_path, monkeypatch):
    from clothbench.engine.run import run_cell
    from clothbench.engine.store import Store
    from clothbench.studies.speed.cell import SpeedCell

    measured = {**dict.fromkeys(bench.KEYS), "model": "baraff_witkin", "nodes": 81, "threads": 1, "batch": 1,
                "node_steps_per_s": 5e7, "realtime_factor": 9.0, "precision": "double", "note": "own step"}  # fmt: skip
    rows = [measured, {**measured, "options": "integrator=implicit_euler", "node_steps_per_s": 4e7}]
    monkeypatch.setattr("clothbench.studies.speed.run.run_bench", lambda sides, progress, chosen: rows)
    run_cell(SpeedCell("speed", ("baraff_witkin",), (9,)), tmp_path)
    case = "81 nodes, 1 at once, 1 threads, double"
    found = {r["case"]: round(r["value"], 3) for r in Store(tmp_path).rows()}
    assert found == {f"{case}, own step": 0.02, f"{case}, integrator=implicit_euler, own step": 0.025}
    for shown in speed_tables(rows):
        how = next(c for c in shown.columns if c.header == "how")._cells
        assert how == ["double, own step", "double, integrator=implicit_euler, own step"]
