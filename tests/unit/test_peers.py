"""The peers simulate the sheet that they are timed on."""

from __future__ import annotations

import importlib
import subprocess
import sys

import numpy as np
import pytest
from clothbench_models import peers

PEERS = {"mujoco_flex": "mujoco", "newton_cloth": "newton", "newton_springs": "newton"}
SIZE = 0.30


@pytest.fixture(params=PEERS)
def peer(request):
    pytest.importorskip(PEERS[request.param])
    return importlib.import_module(f"clothbench_models.peers.{request.param}")


def test_the_sheet_hangs_from_its_grips(peer):
    run = peer.step_sheet(side=5, dt=2e-4, steps=1001, size=SIZE)
    assert run.finite
    assert -1.2 * SIZE < run.lowest < -SIZE
    assert (run.nodes, run.steps) == (25, 1001)
    assert run.node_steps_per_s == pytest.approx(25 * 1001 / run.seconds)
    assert run.node_steps_per_s > 0
    assert run.version


def test_a_fine_sheet_stays_finite(peer):
    run = peer.step_sheet(side=33, dt=4e-4, steps=500, size=SIZE)
    assert run.finite
    assert -2 * SIZE < run.lowest < -SIZE


def test_a_run_leaves_no_file_behind(peer, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    peer.step_sheet(side=4, dt=2e-4, steps=20)
    assert list(tmp_path.iterdir()) == []


def test_the_same_run_ends_alike(peer):
    first, second = (peer.step_sheet(side=4, dt=2e-4, steps=60) for _ in range(2))
    assert first.lowest == second.lowest


@pytest.mark.parametrize("name", PEERS)
def test_an_absent_peer_says_what_to_install(name, monkeypatch):
    module = importlib.import_module(f"clothbench_models.peers.{name}")
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert module.skip_reason() == f"pip install clothbench[{PEERS[name]}]"


def test_a_present_peer_has_no_reason_to_skip(peer):
    assert peer.skip_reason() is None


def test_stiffness_is_the_sheets_until_the_step_forbids_it():
    mass = peers.node_mass(21, SIZE, 0.2)
    assert peers.stable_stiffness(mass, 2e-4) == peers.STIFFNESS
    assert peers.stable_stiffness(mass, 1e-3) == pytest.approx(0.15 * mass / 1e-6)


def test_newtons_net_has_six_springs_a_node():
    from clothbench_models.peers import newton_springs

    springs = list(newton_springs.springs(5))
    assert len(springs) == len(set(springs)) == 2 * 5 * 4 + 2 * 4 * 4 + 2 * 5 * 3
    assert all(0 <= first < 25 and 0 <= second < 25 for first, second in springs)


def test_newtons_cloth_has_triangles_and_bending():
    pytest.importorskip("newton")
    from clothbench_models.peers import newton_cloth

    model = newton_cloth.Sheet(newton_cloth._add_cloth, 5, 2e-4, SIZE, 0.2).solver.model
    inner_edges = 2 * 3 * 4 + 16  # along the three inner lines each way, and the diagonals
    assert (model.tri_count, model.spring_count) == (2 * 16, 0)
    assert (model.edge_indices.numpy() >= 0).all(axis=1).sum() == inner_edges
    assert (model.edge_bending_properties.numpy()[:, 0] > 0).all()


def test_newton_weighs_what_it_should_and_holds_the_upper_corners():
    pytest.importorskip("newton")
    from clothbench_models.peers import newton_cloth, newton_springs

    for add in (newton_cloth._add_cloth, newton_springs._add_net):
        sheet = newton_cloth.Sheet(add, 5, 2e-4, SIZE, 0.2)
        mass = sheet.solver.model.particle_mass.numpy()
        assert np.flatnonzero(mass == 0).tolist() == [0, 4]
        np.testing.assert_allclose(mass[mass > 0], 0.2 * SIZE**2 / 25, rtol=1e-6)
        position, _ = sheet.motion()
        np.testing.assert_allclose(position[[0, 4, 20]], [[0, 0, 0], [SIZE, 0, 0], [0, 0, -SIZE]], atol=1e-6)


def test_naming_the_peers_imports_none_of_them():
    code = """
import sys
from clothbench_models.peers import mujoco_flex, newton_cloth, newton_springs
mujoco_flex.skip_reason(), newton_cloth.skip_reason(), newton_springs.skip_reason()
print({"mujoco", "newton", "warp", "numpy"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_replaying_newtons_graph_is_stepping():
    pytest.importorskip("newton")
    from clothbench_models.peers import newton_cloth

    replayed, stepped = (newton_cloth.Sheet(newton_cloth._add_cloth, 5, 2e-4, SIZE, 0.2) for _ in range(2))
    replayed.advance(2)
    replayed.captured(117)()
    stepped.advance(2 + newton_cloth.GRAPH_STEPS + 117)
    np.testing.assert_array_equal(replayed.motion()[0], stepped.motion()[0])


def test_nothing_is_printed_on_standard_output(peer):
    code = f"from {peer.__name__} import step_sheet; step_sheet(4, 2e-4, 20)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
