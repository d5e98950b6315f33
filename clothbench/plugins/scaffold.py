"""`clothbench new-plugin`: a ready plugin distribution, written from the templates that ship with the package."""

from __future__ import annotations

import importlib.util
import keyword
import os
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from clothbench import __version__
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import whole_folder
from clothbench.plugins.discovery import KINDS, catalogue

# where it goes in the new distribution: the template that it is made from
LAYOUT = {
    "pyproject.toml": "pyproject.toml.txt",
    "README.md": "README.md.txt",
    ".gitignore": "gitignore.txt",
    "src/$package/__init__.py": "init.py.txt",
    "src/$package/$name.py": "$kind.py.txt",
    "tests/test_conformance.py": "test_conformance.py.txt",
}
# what the plugin that a template makes is and does, in one line
SUMMARIES = {
    "model": "a hanging sheet in linear theory, held taut by its own weight",
    "effect": "air drag, linear in the velocity",
    "metric": "root mean square distance of the nodes",
    "optimizer": "evolution strategy with one parent and the one-fifth rule",
    "tracker": "the nodes of a recording without those that jump",
}


def create(kind: str, name: str, into: Path) -> Path:
    """Write the distribution `clothbench-NAME` below `into` and return its folder; it is there whole or not at all."""
    if kind not in SUMMARIES:
        raise ClothbenchError(f"no kind of plugin {kind!r}; there are: {', '.join(SUMMARIES)}")
    check_name(kind, name)
    words = substitutes(kind, name)
    folder = into / words["distribution"]
    if folder.exists():
        raise ClothbenchError(f"{folder}: is there already; choose another name, or another place with --into FOLDER")
    content = {Template(path).substitute(words): filled(template, words) for path, template in LAYOUT.items()}
    try:
        _write_whole(folder, content)
    except OSError as fault:
        said = os.strerror(fault.errno) if fault.errno else fault
        raise ClothbenchError(f"{folder}: cannot be written to ({said}); give another place with --into") from fault
    return folder


def check_name(kind: str, name: str) -> None:
    """Refuse a name that Python, an index of packages or an installed plugin would not go along with."""
    if not re.fullmatch(r"[A-Za-z]([A-Za-z0-9_]*[A-Za-z0-9])?", name):
        raise ClothbenchError(f"name {name!r}: expected an identifier in plain letters, such as my_{kind}")
    if keyword.iskeyword(name):
        raise ClothbenchError(f"name {name!r}: is a word of Python's own; choose another")
    for plugin in catalogue().plugins:
        if (plugin.kind, plugin.name) == (f"{kind}s", name):
            raise ClothbenchError(f"name {name!r}: is taken by the {kind} of {plugin.distribution}; choose another")
    if importlib.util.find_spec(f"clothbench_{name}") is not None:
        raise ClothbenchError(f"name {name!r}: a package clothbench_{name} is installed already; choose another name")


def substitutes(kind: str, name: str) -> dict[str, str]:
    """What the templates' $words stand for."""
    return {
        "kind": kind,
        "kinds": f"{kind}s",
        "article": "an" if kind[0] in "eo" else "a",
        "Protocol": kind.capitalize(),
        "name": name,
        "Class": class_name(kind, name),
        "package": f"clothbench_{name}",
        "distribution": f"clothbench-{name.replace('_', '-').lower()}",
        "summary": SUMMARIES[kind],
        "version": __version__,
        "requires": ', "numba>=0.60", "scipy>=1.15"' if kind == "model" else "",
    }


def class_name(kind: str, name: str) -> str:
    """my_model → MyModel; with the kind behind it where the template, or Python, uses that word for something else."""
    camel = "".join(part[0].upper() + part[1:] for part in name.split("_") if part)
    used = re.search(rf"\b{camel}\b", template_text(f"{kind}.py.txt")) or keyword.iskeyword(camel)
    return camel + kind.capitalize() if used else camel


def template_text(name: str) -> str:
    return files("clothbench.plugins").joinpath("templates", name).read_text(encoding="utf-8")


def filled(template: str, words: dict[str, str]) -> str:
    return Template(template_text(Template(template).substitute(words))).substitute(words)


def _write_whole(folder: Path, content: dict[str, str]) -> None:
    """Write all files, or none."""
    with whole_folder(folder) as part:
        for path, text in content.items():
            (part / path).parent.mkdir(parents=True, exist_ok=True)
            (part / path).write_text(text, encoding="utf-8")


assert {f"{kind}s" for kind in SUMMARIES} == set(KINDS)
