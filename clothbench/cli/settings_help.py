"""What `clothbench run --help` begins with: the settings and what they mean, as the comments of `conf/run.yaml` say."""

from __future__ import annotations

import re
import textwrap
from importlib.resources import files

SETTING = re.compile(r"(?P<name>\w+):\s*(?P<usual>.*?)\s+# (?P<meaning>.*)")
WIDTH = 110
USAGE = """\
usage: clothbench run +suite=NAME [KEY=VALUE ...]
       clothbench run recording=FILE model=NAME optimizer=NAME metric=NAME [KEY=VALUE ...]
       clothbench run -m [+suite=NAME] KEY=ONE,OTHER [KEY=VALUE ...]   a sweep: each with each
       clothbench run --cfg job [KEY=VALUE ...]                        prints the settings, and runs nothing

Cells that the results folder has are not run again.

The command line has the last word, then the suite, then what is usual. `clothbench plugins` lists names and options.
"""


def settings_help() -> str:
    """Usage, and a line for each setting with what is usual."""
    rows = [("setting", "usual", "meaning"), *settings_meanings()]
    wide = [max(len(row[k]) for row in rows) for k in (0, 1)]
    lines = []
    for name, usual, meaning in rows:
        begin = f"  {name:<{wide[0]}}  {usual:<{wide[1]}}  "
        lines += textwrap.wrap(meaning, WIDTH, initial_indent=begin, subsequent_indent=" " * len(begin))
    return USAGE + "\n" + "\n".join(lines) + "\n"


def settings_meanings() -> list[tuple[str, str, str]]:
    """(name, what is usual, meaning) of every setting that has its comment behind it; those below one are its own."""
    text = files("clothbench.conf").joinpath("run.yaml").read_text(encoding="utf-8")
    found = filter(None, map(SETTING.fullmatch, text.splitlines()))
    return [(one["name"], one["usual"].replace("null", ""), one["meaning"]) for one in found]
