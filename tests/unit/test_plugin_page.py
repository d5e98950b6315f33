"""The first plugins of `docs/plugins.md` are taken from the page and do what the page says."""

from __future__ import annotations

import importlib.util
import re
import sys
from types import ModuleType

import numpy as np
import pytest
from conftest import ROOT, swinging_recording

import clothbench
import clothbench.modelling
from clothbench import write_recording
from clothbench.cli.improve import settings_of
from clothbench.cli.run import composed
from clothbench.core import optional
from clothbench.engine.store import Store
from clothbench.engine.study import Context, Results
from clothbench.engine.suite import plan
from clothbench.estimation.trials import score_of
from clothbench.plugins import hookspecs
from clothbench.plugins.discovery import Catalogue, Plugin, catalogue
from clothbench.studies.calibration.cell import set_up
from clothbench.studies.improve.prepare import prepare
from clothbench.testing import (
    ConformanceError,
    check_effect,
    check_metric,
    check_model,
    check_optimizer,
    check_tracker,
    scenes,
)
from clothbench.twins.of_preset import twin_of_preset

PAGE = (ROOT / "docs" / "plugins.md").read_text()
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def section(heading: str) -> str:
    """What stands below a heading of the page, up to the next one."""
    return re.split(rf"^#+ {re.escape(heading)}$", PAGE, flags=re.MULTILINE)[1].split("\n#")[0]


@pytest.fixture
def module_of(tmp_path, monkeypatch):
    """A section's code as a module on disk: kernels are compiled from files."""

    def build(heading: str) -> ModuleType:
        (code,) = BLOCK.findall(section(heading))
        name = f"page_{heading.lower().replace(' ', '_')}"
        path = tmp_path / f"{name}.py"
        path.write_text(code)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
        return module

    return build


CHECKS = {
    "effect": ("An effect", "Draught", check_effect),
    "metric": ("A metric", "MeanDistance", check_metric),
    "optimizer": ("An optimizer", "Shrinking", check_optimizer),
    "tracker": ("A tracker", "EverySecond", check_tracker),
    "model": ("A model", "Plumb", check_model),
}


@pytest.mark.parametrize("kind", CHECKS)
def test_a_first_plugin_keeps_every_rule(module_of, kind):
    heading, name, check = CHECKS[kind]
    check(getattr(module_of(heading), name))


def test_the_first_model_may_not_claim_to_keep_out_of_obstacles(module_of):
    class Boasting(module_of("A model").Plumb):
        capabilities = frozenset({"static", "contact"})

    with pytest.raises(ConformanceError, match="deep in a plane"):
        check_model(Boasting, only=["keeps out of a plane"])


def test_the_first_tracker_serves_run_and_improve(module_of, tmp_path):
    """It leaves out every second frame, and so does what is simulated."""
    module = module_of("A tracker")
    mine = Plugin("trackers", "every_second", f"{module.__name__}:EverySecond", "of the page", "mine", "1.0")
    plugins = Catalogue((*catalogue().plugins, mine))
    recording = swinging_recording("sway-1")
    write_recording(recording, tmp_path / "sway-1.nc")
    said = [f"recordings={tmp_path}", "model=mass_spring", "tracker=every_second", f"out={tmp_path / 'out'}"]
    (cell,) = plan(settings_of([*said, "resolution=5"]), plugins)
    (judged,) = prepare(cell, plugins).trials((), "fit")
    run = composed([*said, "optimizer=least_squares", "metric=node_error", "+options.mass_spring.resolution=5"])
    (cell,) = plan(run, plugins)
    bench = set_up(cell, plugins)
    fitted = bench.trials[0]
    for trial in (judged, fitted):
        assert np.array_equal(trial.observation.time, recording.time[::2])
        theta = trial.simulation.parameters.defaults[None]
        assert np.isfinite(score_of(trial, trial.metric, trial.simulation.run(theta)).value).all()
    assert np.array_equal(bench.recordings[0].time, recording.time[::2])  # films and pages show what was compared


def test_the_first_model_says_what_its_formula_says(module_of):
    model, scene = module_of("A model").Plumb(), scenes.still(scenes.hanging())
    rollout = model.prepare(scene).run(np.array([[50.0], [200.0]]))
    lowest = scene.points[:, 1].argmax()
    v, g = scene.points[lowest, 1], 9.81
    longer = scene.areal_density * g * (scene.height * v - v**2 / 2) / np.array([50.0, 200.0])
    fallen = scene.grip_position[0, 0, 2] - rollout.position[:, 0, lowest, 2]
    assert fallen == pytest.approx(v + longer, rel=1e-12)


def test_the_first_exporter_writes_what_the_page_says(module_of):
    module, twin = module_of("An exporter"), twin_of_preset("denim")
    assert module.skip_reason() is None
    written = module.export(twin)
    lines = [line.split() for line in written.text.splitlines() if not line.startswith("#")]
    corners = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    triangles = np.array([line[1:] for line in lines if line[0] == "f"], dtype=int) - 1
    edges = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
    assert area == pytest.approx(twin.scene.width * twin.scene.height)
    assert "# bending: 2.026e-05 N·m (4.96e-06" in written.text
    assert [line.partition(":")[0] for line in written.cannot] == ["material"]


def test_the_first_study_is_planned_run_and_shown(module_of, tmp_path):
    study, plugins = module_of("A study"), catalogue()
    cells = study.plan({"model": ["mass_spring", "linear_stretch"]}, plugins)
    store = Store(tmp_path)
    for cell in cells:
        result = study.run(cell, Context(plugins, tmp_path / cell.key))
        store.put(cell.key, result.tables, columns=study.tables)
    results = Results(store, store.rows(), tuple(cell.key for cell in cells))
    expected = [f"{name}: {len(plugins.make('models', name).parameters)} parameters" for name in
                ("linear_stretch", "mass_spring")]  # fmt: skip
    assert study.show(results) == expected
    (section,) = study.sections(results)
    assert "<h2>Census</h2>" in section.html
    members = {"name", "against", "suite_words", "tables", "plan", "run", "show", "sections", "claims"}
    assert members <= set(vars(study))


def test_registrations_on_the_page_are_found(module_of, monkeypatch):
    module = module_of("Registration")
    (model,) = module.clothbench_models()
    (effect,) = module.clothbench_effects()
    assert (model.name, effect.name) == ("plumb", "draught")
    hooks = set(re.findall(r"`(clothbench_\w+)` \|", section("Registration")))
    assert hooks == {name for name in vars(hookspecs) if name.startswith("clothbench_")}


def test_the_page_names_every_optional_part():
    """Each protocol of `core/optional` with the members that it has, all of them public."""
    parts = {
        p.__name__: p for p in vars(optional).values() if isinstance(p, type) and p.__module__ == optional.__name__
    }
    sections = [heading for heading in re.findall(r"^## (.+)$", PAGE, re.MULTILINE) if heading.endswith("may offer")]
    rows = [line for heading in sections for line in section(heading).splitlines() if line.startswith("|")]
    assert set(parts) <= set(clothbench.__all__)
    for name, part in parts.items():
        (row,) = (row for row in rows if f"`{name}`" in row)
        members = {m for m in (*vars(part), *part.__annotations__) if not m.startswith("_")}
        assert members <= set(re.findall(r"\w+", row)), row


def test_the_page_names_all_of_modelling():
    """What the package offers for model authors stands on the page, and what stands there is offered."""
    named = set(re.findall(r"`(\w+)`", section("`clothbench.modelling`").split("A model with effects")[0]))
    assert named <= set(clothbench.modelling.__all__)
