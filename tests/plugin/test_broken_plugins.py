"""A broken plugin is listed as broken with the reason, stands in nobody's way, and costs one error row at most."""

from __future__ import annotations

import json
import textwrap

import pytest

from clothbench.plugins.discovery import Catalogue, Plugin, catalogue
from clothbench.studies.improve.candidates import candidates_of, unusable

HOOK = """
    from clothbench import Registration, hookimpl

    @hookimpl
    def clothbench_{kind}():
        return [Registration({name!r}, {target!r}, "a plugin for a test")]
    """
# distribution: its module, what it is found under, and the reason that is given
BROKEN = {
    "cancelled": ("import asyncio; raise asyncio.CancelledError('no time')", "module", "CancelledError: no time"),
    "crashing": ("import no_such_library", "module", "ModuleNotFoundError: No module named 'no_such_library'"),
    "raising": ("raise RuntimeError('out of wool')", "module", "RuntimeError: out of wool"),
    "misspelt": (
        "import clothbench\n@clothbench.hookimpl\ndef clothbench_modles():\n    return []", "module",
        "unknown hook 'clothbench_modles', did you mean 'clothbench_models'?",
    ),
    "hookless": ("nothing = 1", "module", "it implements no clothbench hook"),
    "mistyped": (
        "import clothbench\n@clothbench.hookimpl\ndef clothbench_models():\n    return ['mistyped']", "module",
        "clothbench_models gave str, expected clothbench.Registration",
    ),
    "formless": (
        "import clothbench\n@clothbench.hookimpl\ndef clothbench_models():\n    return 3", "module",
        "TypeError: 'int' object is not iterable",
    ),
    "missing": (
        HOOK.format(kind="models", name="missing", target="missing:Missing"), "model", "has no attribute 'Missing'",
    ),
    "nowhere": (HOOK.format(kind="metrics", name="nowhere", target="gone:Gone"), "metric", "No module named 'gone'"),
    "copycat": (
        HOOK.format(kind="models", name="mass_spring", target="copycat:Copy"), "model",
        "the name is taken by clothbench (clothbench_models.mass_spring:MassSpring); rename one of the two",
    ),
    "unnameable": (HOOK.format(kind="models", name="my model", target="unnameable:A"), "model", "is not an identifier"),
    "memberless": (
        HOOK.format(kind="metrics", name="memberless", target="memberless:Half")
        + "\n    class Half:\n        name, version, unit = 'memberless', 1, 'mm'\n",
        "metric", "it has no floor, no __call__, which every metric has",
    ),
    "placeless": (
        HOOK.format(kind="effects", name="placeless", target="placeless:Half")
        + "\n    class Half:\n        name, version, parameters = 'placeless', 1, ()\n",
        "effect", "it has no place, no summary, which every effect has",
    ),
    "alphabetic": (
        HOOK.format(kind="metrics", name="alphabetic", target="alphabetic:Half")
        + "\n    from clothbench_metrics.node_error import NodeError\n    class Half(NodeError):\n"
        + "        name, built_on = 'alphabetic', 'numpy'\n",
        "metric", "built_on: found 'numpy', expected a tuple of distributions' names",
    ),
}  # fmt: skip
FINE = HOOK.format(kind="metrics", name="fine", target="clothbench_metrics.node_error:NodeError")

# Effects of which one cannot be made, one fails when it is tried, and one cannot be compiled.
EFFECTS = """
    import numpy as np
    from clothbench import Parameter, ParameterSpace, Registration, effect_kernel, hookimpl

    @hookimpl
    def clothbench_effects():
        return [Registration(c.name, f"strange:{c.__name__}", "for a test") for c in (Lost, Torn, Mistyped)]

    class Torn:
        name, version, place, summary = "torn", 1, "sensor", "for a test"
        parameters = ParameterSpace((Parameter("a", "a", "m", (0.0, 1.0), "linear", 0.1, "none", "none", null=0.0),))

        def positions(self, time, position, points, phi):
            raise KeyError("seam")

    @effect_kernel
    def force(t, dt, x, v, f, sheet, p, state):
        f[0] += sheet.weight

    class Mistyped(Torn):
        name, place, force, positions = "mistyped", "dynamics", staticmethod(force), None

    class Lost(Torn):
        name = "lost"

        def __init__(self):
            raise RuntimeError("out of wool")
    """


@pytest.fixture
def installed(tmp_path):
    """`installed(name=text, …)`: fake distributions in a folder for PYTHONPATH, one module each."""

    def install(**modules: str) -> str:
        folder = tmp_path / "site"
        for name, text in modules.items():
            about = folder / f"{name}-1.0.dist-info"
            about.mkdir(parents=True)
            (folder / f"{name}.py").write_text(textwrap.dedent(text))
            (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
            (about / "entry_points.txt").write_text(f"[clothbench]\n{name} = {name}\n")
        return str(folder)

    return install


def listed(clothbench, path):
    done = clothbench("plugins", "--json", PYTHONPATH=path)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_each_is_listed_with_its_reason_and_no_other_is_touched(clothbench, installed):
    usual = listed(clothbench, "")
    rows = listed(clothbench, installed(fine=FINE, **{name: text for name, (text, _, _) in BROKEN.items()}))
    theirs = {r["distribution"].split()[0]: r for r in rows if r not in usual}
    assert set(theirs) == {*BROKEN, "fine"}
    assert theirs["fine"]["broken"] is None
    for name, (_, kind, reason) in BROKEN.items():
        assert theirs[name]["kind"] == kind
        assert reason in theirs[name]["broken"]
        assert "\n" not in theirs[name]["broken"]
    assert [r for r in rows if r in usual] == usual


def test_one_that_never_returns_from_its_import_is_broken(clothbench, installed):
    sleeps, quick = "import time\ntime.sleep(600)", {"CLOTHBENCH_IMPORT_SECONDS": "1"}
    late = HOOK.format(kind="models", name="late", target="later:Later")
    path = installed(never=sleeps, fine=FINE, late=late, later=sleeps)
    done = clothbench("plugins", "--json", PYTHONPATH=path, **quick)
    assert done.returncode == 0, done.stderr
    broken = {r["name"]: r["broken"] for r in json.loads(done.stdout)}
    assert broken["fine"] is None
    for name in ("never", "late"):
        assert "it was still being imported after 1 s" in broken[name]
    refused = clothbench("plugins", CLOTHBENCH_IMPORT_SECONDS="soon")
    assert refused.returncode == 2
    assert "CLOTHBENCH_IMPORT_SECONDS: found 'soon', expected seconds above 0" in refused.stderr


def test_the_table_names_them_too(clothbench, installed):
    done = clothbench("plugins", PYTHONPATH=installed(crashing=BROKEN["crashing"][0]), COLUMNS="200")
    assert done.returncode == 0
    assert "broken: module crashing (crashing 1.0): ModuleNotFoundError" in done.stdout


def test_two_strangers_of_one_name_are_settled_by_their_distributions_names(clothbench, installed):
    """What a name means must not depend on which was installed first."""
    path = installed(
        zeta=HOOK.format(kind="metrics", name="shared", target="clothbench_metrics.node_error:NodeError"),
        alpha=HOOK.format(kind="metrics", name="shared", target="clothbench_metrics.relative_error:RelativeError"),
    )
    shared = {r["distribution"]: r["broken"] for r in listed(clothbench, path) if r["name"] == "shared"}
    assert shared["alpha 1.0"] is None
    assert "the name is taken by alpha" in shared["zeta 1.0"]


def test_a_broken_one_in_a_product_costs_its_own_cells_only(clothbench, installed, recordings_folder):
    settings = [
        f"recordings={recordings_folder}", "model=[mass_spring,missing]", "optimizer=least_squares",
        "metric=node_error", "budget=3", "jobs=1", "rerun=false",
    ]  # fmt: skip
    path = installed(missing=BROKEN["missing"][0], crashing=BROKEN["crashing"][0])
    done = clothbench("run", *settings, PYTHONPATH=path)
    assert done.returncode == 1, done.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {r["status"] for r in rows if r["model"] == "mass_spring"} == {"ok"}
    (row,) = (r for r in rows if r["model"] == "missing")
    assert (row["status"], row["value"]) == ("error", None)
    assert "missing" in row["reason"]
    assert "has no attribute 'Missing'" in row["reason"]


# A model that simulates nothing (and takes no effects), says that all is well, and answers with what `x` is.
PLAIN = """
    import numpy as np
    from clothbench import Parameter, ParameterSpace, Rollout

    class Plain:
        name, version, capabilities = "plain", 1, frozenset({"dynamic"})
        parameters = ParameterSpace((Parameter("k", "k", "N/m", (1.0, 9.0), "linear", 2.0, "none", "none"),))

        def prepare(self, scene, effects=()):
            self.scene = scene
            return self

        def run(self, theta):
            shape = (len(theta), len(self.scene.times), len(self.scene.points), 3)
            return Rollout(
                self.scene.times, np.full(shape, X), ("ok",) * len(theta), np.ones(len(theta), dtype=int), 4
            )
    """


@pytest.mark.parametrize(("x", "words", "status", "said"), [
    ("np.nan", [], "error", "model 'plain' says 'ok' of positions that are not finite, expected 'diverged'"),
    ("0.0", ["effects=[quadratic_drag]"], "skipped", "the model takes no effects"),
    ("0.0", ["bounds.kk=[1,2]"], "error", "setting 'bounds': no parameter 'kk'"),
    ("0.0", ["+suite.fixed.kk=1"], "error", "setting 'suite.fixed': no parameter 'kk'"),
    ("0.0", ["bounds.k=[1,2]"], "ok", ""),
])  # fmt: skip
def test_what_a_strangers_model_cannot_do_is_the_reason_of_its_row(
    clothbench, installed, recordings_folder, x, words, status, said
):
    path = installed(plain=HOOK.format(kind="models", name="plain", target="plainly:Plain"),
                     plainly=PLAIN.replace("X)", f"{x})"))  # fmt: skip
    clothbench(
        "run", f"recordings={recordings_folder}", "model=plain", "optimizer=ga", "metric=node_error", "budget=3",
        "rerun=false", *words, PYTHONPATH=path,
    )  # fmt: skip
    rows = json.loads(clothbench("leaderboard", "--json", PYTHONPATH=path).stdout)
    assert {row["status"] for row in rows} == {status}
    assert all(said in (row["reason"] or "") for row in rows)


def test_a_stranger_beside_the_model_hides_no_misspelled_bounds(clothbench, installed, recordings_folder):
    done = clothbench(
        "run", f"recordings={recordings_folder}", "model=mass_spring", "optimizer=ga", "metric=fine", "bounds.k9=[1,2]",
        PYTHONPATH=installed(fine=FINE),
    )  # fmt: skip
    assert done.returncode == 2
    assert "setting 'bounds': no parameter 'k9'; there are: k1, k2, zeta" in done.stderr


def test_a_name_twice_in_one_distribution_is_taken_and_odd_types_are_listed(clothbench, installed):
    twice = HOOK.format(kind="metrics", name="odd", target="oddly:Odd").replace(
        '"a plugin for a test")]', '"one"), Registration("odd", "oddly:Odd", "other")]'
    )
    oddly = """
        import numpy as np
        from clothbench import Parameter, ParameterSpace

        class Odd:
            name, version, floor, __call__ = "odd", np.int64(3), None, None
            parameters = ParameterSpace((
                Parameter("a", "a", "m", tuple(np.array([1, 9])), "linear", np.int64(2), "none", "none"),))

            @staticmethod
            def skip_reason():
                return True
        """
    path = installed(twice=twice, oddly=oddly)
    first, second = (r for r in listed(clothbench, path) if r["name"] == "odd")
    assert (first["broken"], first["version"], first["parameters"][0]["high"]) == (None, 3, 9.0)
    assert "the name is taken by twice" in second["broken"]
    assert clothbench("plugins", PYTHONPATH=path).returncode == 0


@pytest.mark.parametrize(("options", "status", "said"), [
    ([], "error", "metric 'endless' gave no finite number for any parameter set, also where the cloth was simulated"),
    (["+options.mass_spring.dt=0.05"], "diverged", "step is too long"),
])  # fmt: skip
def test_a_metric_without_a_number_is_not_told_as_a_model_that_diverged(
    clothbench, installed, recordings_folder, options, status, said
):
    endless = """
        import dataclasses
        import numpy as np
        from clothbench_metrics.node_error import NodeError

        class Endless(NodeError):
            name = "endless"

            def __call__(self, observation, rollout):
                score = super().__call__(observation, rollout)
                return dataclasses.replace(score, value=np.full_like(score.value, np.inf))
        """
    path = installed(endless=HOOK.format(kind="metrics", name="endless", target="limitless:Endless"), limitless=endless)
    done = clothbench(
        "run", f"recordings={recordings_folder}", "model=mass_spring", "optimizer=ga", "metric=endless", "budget=6",
        "options.mass_spring.resolution=5", "rerun=false", *options, PYTHONPATH=path,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    (row,) = json.loads(clothbench("leaderboard", "--json").stdout)
    assert (row["status"], row["value"]) == (status, None)
    assert said in row["reason"]


@pytest.mark.slow
def test_a_broken_study_stands_in_the_way_of_its_own_rows_only(clothbench, installed):
    path = installed(lost=HOOK.format(kind="studies", name="lost", target="gone.study"))
    quick = ("+suite=physical_validation", "model=[mass_spring]", "suite.meshes=[5]", "suite.tests=[free_fall]")
    for words in (("run", *quick), ("leaderboard",), ("report",), ("store", "check", "runs")):
        done = clothbench(*words, PYTHONPATH=path)
        assert (done.returncode, "broken" in done.stderr) == (0, False), done.stderr
    asked = clothbench("run", "study=lost", "model=mass_spring", PYTHONPATH=path)
    assert (asked.returncode, "study 'lost' (lost) is broken" in asked.stderr) == (2, True)


def test_a_plugin_whose_module_is_broken_cannot_be_chosen(clothbench, installed, recordings_folder):
    """Its names are not known, so nothing is begun."""
    path = installed(crashing=BROKEN["crashing"][0])
    done = clothbench(
        "run", f"recordings={recordings_folder}", "model=crashing", "optimizer=ga", "metric=node_error", PYTHONPATH=path
    )
    assert done.returncode == 2
    assert "no model named 'crashing'; there are: mass_spring" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
def test_broken_effects_cost_an_improvement_themselves_only(clothbench, installed, recordings_folder, tmp_path):
    settings = [f"recordings={recordings_folder}", "model=mass_spring", "resolution=5", "base="]
    path = installed(strange=EFFECTS)
    done = clothbench("improve", *settings, "candidates=gravity_tilt,torn,mistyped", PYTHONPATH=path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "improve" / "verdict.json").read_text())
    why = {c["name"]: c["why_not"] for c in found["candidates"]}
    assert why["torn"] == "KeyError: 'seam'"
    assert why["mistyped"].startswith("effect 'mistyped': 'force' cannot be compiled by numba: Unknown attribute")
    assert "KeyError" not in why["gravity_tilt"]


def test_an_effect_that_cannot_be_made_is_no_candidate_and_that_is_told(clothbench, installed, recordings_folder):
    settings = [f"recordings={recordings_folder}", "model=mass_spring", "candidates=lost"]
    reason = "effect 'lost' (strange) is broken: RuntimeError: out of wool"
    named = clothbench("improve", *settings, PYTHONPATH=installed(strange=EFFECTS))
    assert (named.returncode, named.stderr) == (2, f"clothbench: {reason}\n")


def test_candidates_are_all_effects_but_the_broken_and_why_is_told(monkeypatch):
    def lost(*_, **__):
        raise RuntimeError("out of wool")

    monkeypatch.setattr("wrong_plugins.Idle.__init__", lost)
    strange = Plugin("effects", "lost", "wrong_plugins:Idle", "for a test", "strange", "1.0")
    half = Plugin("effects", "half", "wrong_plugins:Placeless", "for a test", "strange", "1.0")
    monkeypatch.delattr("wrong_plugins.HonestEffect.place")
    monkeypatch.delattr("wrong_plugins.Placeless.place", raising=False)
    plugins = Catalogue((*catalogue().plugins, strange, half))
    usual = candidates_of(None, "nodes", (), catalogue())
    assert candidates_of(None, "nodes", (), plugins) == usual
    assert unusable(plugins) == [
        "effect 'lost' (strange) is broken: RuntimeError: out of wool",
        "effect 'half' (strange) is broken: it has no place, which every effect has",
    ]
