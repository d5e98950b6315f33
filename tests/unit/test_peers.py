"""The peers simulate the sheet that they are timed on."""

from __future__ import annotations

import importlib
import subprocess
import sys

import numpy as np
import pytest
from clothbench_models import peers

PEERS = {"mujoco_flex": "mujoco", "newton_cloth": "newton"}
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


def test_newton_has_six_springs_a_node():
    from clothbench_models.peers import newton_cloth

    springs = list(newton_cloth._springs(5))
    assert len(springs) == len(set(springs)) == 2 * 5 * 4 + 2 * 4 * 4 + 2 * 5 * 3
    assert all(0 <= first < 25 and 0 <= second < 25 for first, second in springs)


def test_naming_the_peers_imports_none_of_them():
    code = """
import sys
from clothbench_models.peers import mujoco_flex, newton_cloth
mujoco_flex.skip_reason(), newton_cloth.skip_reason()
print({"mujoco", "newton", "warp", "numpy"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_replaying_newtons_graph_is_stepping():
    pytest.importorskip("newton")
    from clothbench_models.peers import newton_cloth

    replayed, stepped = (newton_cloth._Sheet(newton_cloth._build(5, 2e-4, SIZE, 0.2), 2e-4) for _ in range(2))
    replayed.advance(2)
    replayed.captured(117)()
    stepped.advance(2 + newton_cloth.GRAPH_STEPS + 117)
    np.testing.assert_array_equal(replayed.motion()[0], stepped.motion()[0])


def test_nothing_is_printed_on_standard_output(peer):
    code = f"from {peer.__name__} import step_sheet; step_sheet(4, 2e-4, 20)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
