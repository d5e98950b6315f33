"""The walls of the house: who may import whom, and how light the door is."""

import ast
import subprocess
import sys
from pathlib import Path

from conftest import ROOT

FRAME = ROOT / "clothbench"
PLUGINS = ROOT / "plugins"
# What stands lower may not import what stands higher.
LAYERS = [
    {
        "errors",
        "parameters",
        "files",
        "recording",
        "recording_rules",
        "recording_file",
        "recording_video",
        "camera",
        "surface",
        "curve",
        "curve_rules",
        "laser",
        "scene",
        "observation",
        "rollout",
        "folding",
        "parallel",
        "hookspecs",
    },
    {"kernels", "render", "orientation", "protocols", "effects", "curve_simulation", "plugins"},
    {"datasets", "experiment", "testbed", "testing", "loop"},
    {"report", "bench", "timing"},
    {"run_command", "improve_command", "curve_command", "cli", "scaffold", "__main__"},
]


def imports_of(path: Path) -> set[str]:
    """Modules that a file imports anywhere, as dotted names."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{a.name}" for a in node.names}
    return found


def top_imports_of(path: Path) -> set[str]:
    """Modules imported when the file is, leaving out what functions import when they run."""
    body = [n for n in ast.parse(path.read_text()).body if isinstance(n, ast.Import | ast.ImportFrom)]
    names = {a.name for n in body if isinstance(n, ast.Import) for a in n.names}
    return names | {n.module for n in body if isinstance(n, ast.ImportFrom) and n.module}


def room(name: str) -> str | None:
    parts = name.split(".")
    return parts[1] if parts[0] == "clothbench" and len(parts) > 1 else None


def test_the_frame_knows_no_plugin_package():
    for path in FRAME.rglob("*.py"):
        strangers = {n for n in imports_of(path) if n.startswith("clothbench_")}
        assert not strangers, f"{path.relative_to(ROOT)} imports {strangers}"


def test_plugins_use_no_experiment_report_or_command():
    allowed = LAYERS[0] | LAYERS[1] | {"__init__"}
    names = {p.stem for p in FRAME.glob("*.py")} | {p.name for p in FRAME.iterdir() if p.is_dir()}
    for path in PLUGINS.rglob("*.py"):
        inside = {room(n) for n in imports_of(path)} & names
        assert inside <= allowed, f"{path.relative_to(ROOT)} imports {inside - allowed}"


def test_imports_point_downwards():
    level = {name: i for i, layer in enumerate(LAYERS) for name in layer}
    for path in FRAME.rglob("*.py"):
        mine = path.relative_to(FRAME).parts[0].removesuffix(".py")
        if mine in ("__init__", "conf", "templates"):
            continue
        for name in imports_of(path):
            other = room(name)
            if other in level:
                assert level[other] <= level[mine], f"{path.relative_to(ROOT)} imports {name}"


def test_there_is_no_import_cycle():
    modules = {f"clothbench.{'.'.join(p.relative_to(FRAME).with_suffix('').parts)}": p for p in FRAME.rglob("*.py")}
    graph = {name: top_imports_of(path) & set(modules) for name, path in modules.items()}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, f"import cycle: {' → '.join((*path, name))}"
        if name not in done:
            for other in graph[name]:
                visit(other, (*path, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_importing_the_package_loads_nothing_heavy():
    heavy = ("numpy", "numba", "pandas", "scipy", "hydra", "rerun", "xarray", "plotly", "cv2", "rich")
    code = f"import sys, clothbench, clothbench.cli.commands; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_nothing_read_from_disk_can_run_code():
    for path in [*FRAME.rglob("*.py"), *PLUGINS.rglob("*.py")]:
        used = imports_of(path) & {"pickle", "cloudpickle", "dill", "shelve", "marshal"}
        assert not used, f"{path.relative_to(ROOT)} imports {used}"
        assert "allow_pickle=True" not in path.read_text()
