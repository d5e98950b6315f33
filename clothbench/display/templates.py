"""HTML from templates that lie beside the code that fills them; whatever is put in is escaped unless it is HTML."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from clothbench.display.html import table


def rendered(folder: Path, name: str, **values: Any) -> str:
    """The template `name` in FOLDER/templates with these values; one that it lacks is a fault of ours."""
    return _environment(folder / "templates").get_template(name).render(**values)


@cache
def _environment(folder: Path) -> Environment:
    out = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    out.globals["table"] = lambda *told: Markup(table(*told))
    return out


def asset(name: str) -> str:
    """A script or style sheet that every page has, as text."""
    return asset_of(Path(__file__).parent, name)


@cache
def asset_of(folder: Path, name: str) -> str:
    """The text of FOLDER/assets/name."""
    return (folder / "assets" / name).read_text(encoding="utf-8")
