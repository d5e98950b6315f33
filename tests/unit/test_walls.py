"""The walls of the house: who may import whom, and how light the door is. Imports inside functions count too."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path
from string import Template

import pytest
from conftest import ROOT

import clothbench
from clothbench.plugins.scaffold import substitutes

FRAME = ROOT / "clothbench"
PLUGINS = ROOT / "plugins"
EXAMPLES = ROOT / "examples"
# The floors, from the ground up: a room imports from its own floor's own room, and from the floors below.
FLOORS = (
    ("core",),
    ("recordings", "vision", "plugins"),
    ("modelling", "reference", "datasets"),
    ("display",),
    ("engine",),
    ("estimation",),
    ("studies",),
    ("report", "history", "submissions", "suggest", "testing", "twins"),
    ("cli",),
)
FACES = {"__init__", "__main__", "conf"}  # the package's own face and door


def imports_of(path: Path) -> set[str]:
    """Modules that a file imports anywhere, as dotted names."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{a.name}" for a in node.names}
    return found


def room(name: str) -> str | None:
    parts = name.split(".")
    return parts[1] if parts[0] == "clothbench" and len(parts) > 1 else None


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in FRAME.rglob("*.py"):
        parts = path.relative_to(FRAME).with_suffix("").parts
        found[".".join(("clothbench", *(p for p in parts if p != "__init__")))] = path
    return found


def test_every_room_has_a_floor():
    rooms = {p.name for p in FRAME.iterdir() if p.is_dir() and p.name != "__pycache__"} - FACES
    assert rooms == {name for floor in FLOORS for name in floor}
    assert {p.stem for p in FRAME.glob("*.py")} == FACES - {"conf"}


def test_imports_point_downwards():
    level = {name: i for i, floor in enumerate(FLOORS) for name in floor}
    for path in FRAME.rglob("*.py"):
        mine = path.relative_to(FRAME).parts[0].removesuffix(".py")
        if mine in FACES:
            continue
        for name in imports_of(path):
            other = room(name)
            if other in level and other != mine:
                assert level[other] < level[mine], f"{path.relative_to(ROOT)} imports {name}"


def test_a_study_knows_no_other_study():
    for folder in (p for p in (FRAME / "studies").iterdir() if p.is_dir()):
        for path in folder.rglob("*.py"):
            for name in imports_of(path):
                if name.startswith("clothbench.studies.") and len(name.split(".")) > 3:
                    assert name.split(".")[2] == folder.name, f"{path.relative_to(ROOT)} imports {name}"


@pytest.mark.parametrize("floor", ["engine", "report", "estimation", "display"])
def test_nobody_below_knows_a_study_by_name(floor):
    names = {p.name for p in (FRAME / "studies").iterdir() if p.is_dir() and p.name != "__pycache__"}
    rooms = list((FRAME / floor).rglob("*.py"))
    assert rooms
    for path in rooms:
        texts = {n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)}
        found = {t for t in texts if isinstance(t, str)} & names
        assert not found, f"{path.relative_to(ROOT)} names {found}"


def test_there_is_no_import_cycle():
    graph = {name: imports_of(path) & (set(modules()) - {"clothbench", name}) for name, path in modules().items()}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, f"import cycle: {' → '.join((*path, name))}"
        if name not in done:
            for other in graph[name]:
                visit(other, (*path, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_the_frame_knows_no_plugin_package():
    for path in FRAME.rglob("*.py"):
        strangers = {n for n in imports_of(path) if n.startswith("clothbench_")}
        assert not strangers, f"{path.relative_to(ROOT)} imports {strangers}"


def frame_modules(source: str) -> set[str]:
    """Modules of the frame that a source imports, or imports from, anywhere."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module)
            if node.module in ("clothbench", "clothbench.modelling"):  # a module is no public name of theirs
                found |= {f"{node.module}.{alias.name}" for alias in node.names} & set(modules())
    return {name for name in found if name.split(".")[0] == "clothbench"}


def test_plugins_import_the_public_names_only():
    """Functions' imports count too; the templates are what `clothbench new-plugin` begins with."""
    sources = {p: p.read_text() for folder in (PLUGINS, EXAMPLES) for p in folder.rglob("*.py")}
    words = substitutes("model", "sheet")
    for path in (FRAME / "plugins" / "templates").glob("*.py.txt"):
        sources[path] = Template(path.read_text()).substitute(words)
    assert len(sources) > 50
    for path, source in sources.items():
        public = {"clothbench", "clothbench.modelling"}
        if path.name.startswith("test_"):
            public.add("clothbench.testing")
        deep = frame_modules(source) - public
        assert not deep, f"{path.relative_to(ROOT)} imports {deep}"


def test_every_public_name_is_there():
    for name in clothbench.__all__:
        assert getattr(clothbench, name) is not None


def test_importing_the_package_loads_nothing_heavy():
    heavy = ("numpy", "numba", "pandas", "scipy", "hydra", "rerun", "xarray", "plotly", "cv2", "rich")
    code = f"import sys, clothbench, clothbench.cli; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_no_command_waits_for_what_few_cells_need():
    """Each takes a quarter of a second to import and more, before any word is said and in each process of a run."""
    heavy = ("scipy.stats", "scipy.integrate", "scipy.interpolate", "pandas", "rerun", "plotly", "cv2", "matplotlib")
    code = (
        "import sys, clothbench.cli.improve, clothbench.cli.run, clothbench.cli.suggest, clothbench.cli.results\n"
        "from clothbench.plugins.discovery import catalogue\n"
        "plugins = catalogue()\n"
        "studies = [plugins.load('studies', name) for name in plugins.names('studies')]\n"
        f"print(len(studies) > 3, [m for m in {heavy} if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "True []"


def test_nothing_read_from_disk_can_run_code():
    for path in [*FRAME.rglob("*.py"), *PLUGINS.rglob("*.py")]:
        used = imports_of(path) & {"pickle", "cloudpickle", "dill", "shelve", "marshal"}
        assert not used, f"{path.relative_to(ROOT)} imports {used}"
        assert "allow_pickle=True" not in path.read_text()
