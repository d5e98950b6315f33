"""The words of a command line as Hydra's grammar has them: signs before a setting, empty mappings, paths in quotes."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep
from hydra.errors import HydraException

from clothbench.cli.own_suites import QUOTES, values_of

# A setting below one that holds any number of them. Hydra would take it only with a sign that says whether the suite
# has it; what is not known is refused once all is put together.
OPEN = re.compile(r"(options|bounds|finer|scene|analysis|suite|limits)\.[^=]*=|(options|bounds|finer|analysis)=\{")
# Settings of which nothing is none. Hydra adds a mapping to what the suite has, to which an empty one adds nothing.
EMPTIED = re.compile(r"\+{0,2}(analysis|bounds|finer|limits|options(\.[^.=]+)?|scene|suite\.[^=]+)=.*\{\s*\}")
NOTHING = re.compile(r"\{\s*\}")
PATHS = re.compile(r"\+{0,2}(recording|recordings|out|data_dir)=")
ELSEWHERE = ("builtin:", "dataset:", "pkg://", "s3://")  # how what is no path of this machine begins
NOT_READ = object()
# What commas part: each in quotes, or with commas of its own in brackets.
PARTS = re.compile(r"""\s*'(?:[^'\\]|\\.)*'\s*(?=,|$)|\s*"(?:[^"\\]|\\.)*"\s*(?=,|$)|(?:\[[^\]]*\]|[^,\[]|\[)+""")


def either_way(words: Sequence[str], sweep: bool = False) -> list[str]:
    """Hydra's words: those of `OPEN` set whether a suite has them or not, a suite chosen with a sign or without, and
    paths quoted that are no words of Hydra's grammar. sweep: whether commas may part the values of several jobs.
    """
    return [_quoted(_signed(_emptied(word)), sweep) for word in words]


def _signed(word: str) -> str:
    return ("++" if OPEN.match(word) else "+" if word.startswith("suite=") else "") + word


def _emptied(word: str) -> str:
    """KEY={} of `EMPTIED` as ++KEY=null, which takes out what the suite has if it has any, also as one value of a
    sweep. What Hydra cannot read stays: it says so itself.
    """
    if not EMPTIED.match(word):
        return word
    try:
        values = [value.partition("=")[2] for value in values_of(word)]
    except HydraException:
        return word
    told = ",".join("null" if NOTHING.fullmatch(value) else value for value in values)
    return f"++{word.partition('=')[0].lstrip('+')}={told}"


def _quoted(word: str, sweep: bool) -> str:
    """KEY=PATH as Hydra reads it: what is no word of its grammar, or a number or truth to it, in quotes, also in a list
    or a sweep of several; and a path with commas in it.
    """
    key, sign, value = word.partition("=")
    if not PATHS.match(word):
        return word
    texts = list(map(_is_text, read := _read(word)))
    if not (all(texts) and len(read) == 1) and _is_one(key.lstrip("+"), value, sweep):
        return key + sign + _in_quotes(value)
    if all(texts):
        return word
    return key + sign + ",".join(_quoted_list(part.strip()) for part in PARTS.findall(value))


def _quoted_list(text: str) -> str:
    if text.startswith("[") and text.endswith("]"):
        return "[" + ",".join(_quoted_path(path.strip()) for path in PARTS.findall(text[1:-1])) + "]"
    return _quoted_path(text)


def _quoted_path(path: str) -> str:
    if all(map(_is_text, _read(f"out={path}"))):
        return path
    return _in_quotes(path)


def _in_quotes(path: str) -> str:
    return f'"{path}"' if "'" in path and '"' not in path else "'" + path.replace("'", "\\'") + "'"


def _is_one(key: str, value: str, sweep: bool) -> bool:
    """Whether a value with commas that no brackets or quotes hold together is one path. Of recordings: where it is
    there, and without a sweep also where none of its parts is. Of results: always without a sweep; with one where the
    folder that they would go to is there, and that of one of its parts is not.
    """
    parts = [part.strip() for part in PARTS.findall(value)]
    if len(parts) < 2 or any(part[0] in QUOTES or part[0] + part[-1] == "[]" for part in parts if part):
        return False

    def there(path: str) -> bool:
        return os.path.exists(os.path.dirname(path) or "." if key == "out" else path)

    known = [part.startswith(ELSEWHERE) or there(part) for part in parts]
    if key == "out":
        return not sweep or (there(value) and not all(known))
    return there(value) or not (sweep or any(known))


def _read(word: str) -> Sequence[Any]:
    """The values that Hydra makes of KEY=VALUE, those in a list or a sweep one by one; NOT_READ where it makes none."""
    with suppress(HydraException, ValueError, RecursionError):
        (given,) = OverridesParser.create().parse_overrides([word])
        value = given.value()
        if isinstance(value, ChoiceSweep) and value.simple_form:
            value = [one for each in value.list for one in (each if isinstance(each, list) else [each])]
        return value if isinstance(value, list) else [value]
    return [NOT_READ]


def _is_text(value: Any) -> bool:
    """Whether a value stands as it is: a text, nothing, or what only Hydra has a use for, as a range."""
    return value is not NOT_READ and not isinstance(value, bool | int | float)
