"""Suites of the user's own, `--config-dir FOLDER`: YAML that may come from anywhere, and is settings of a run, no more.

Hydra builds objects from its own settings, and writes where these say. A suite from a folder must not touch them: they
are for the command line.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_module
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from clothbench.core.errors import ClothbenchError

FLAGS = ("--config-dir", "-cd")
OTHERS = ("--config-path", "-cp", "--config-name", "-cn")
QUOTES = "'\""
MOST = 100_000  # values in a file, those counted again that it names by an alias
GLOBAL = "# @package _global_"
OF_RUN = ("suite", "study", "model", "optimizer", "metric")  # beside `suite`, whose own settings have other names
OF_ONE_RUN = ("searchpath", "overrides", "runtime", "mode")  # settings of Hydra's that tell what was asked for


def require_harmless(arguments: Sequence[str]) -> None:
    """Refuse a folder of suites that cannot be read, or that reaches for Hydra's own settings."""
    if given := [word for word in arguments if word.partition("=")[0] in OTHERS]:
        raise ClothbenchError(
            f"found {given[0]!r}: a run has its own settings file; put yours into FOLDER/suite and give "
            "--config-dir FOLDER +suite=NAME"
        )
    for word in arguments:
        if whole := _cut_short(word.partition("=")[0]):
            raise ClothbenchError(f"found {word!r}, which would be taken for {whole}; write that flag in full")
    for word in settings_among(arguments):
        values_of(word)
    for folder in _folders(arguments):
        if not folder.is_dir():
            raise ClothbenchError(f"{folder}: no such folder; --config-dir names one with suite/NAME.yaml in it")
        require_all_plain(folder, arguments)
        for words in each_choice(arguments):
            require_no_hydra(folder, words)


def _cut_short(word: str) -> str | None:
    """A flag that a word is only the beginning of, which Hydra takes for it, too."""
    flags = [flag for flag in (*FLAGS, *OTHERS) if flag.startswith("--")]
    cut = len(word) > len("--") and word not in flags
    return next((flag for flag in flags if cut and flag.startswith(word)), None)


def _folders(arguments: Sequence[str]) -> list[Path]:
    out = _after(arguments)
    out += [word.partition("=")[2] for word in arguments if word.partition("=")[0] in FLAGS and "=" in word]
    return [Path(folder).absolute() for folder in out]


def require_all_plain(folder: Path, arguments: Sequence[str]) -> None:
    """Refuse the files of a folder that are asked for and cannot be read; and all others, where one of those names
    further files in a `defaults` list.
    """
    asked = list(dict.fromkeys(_asked_for(folder, arguments)))
    brings = any([require_plain(file) for file in asked])
    for file in asked:
        if file.parent.name == "suite" and not any("@" in word.partition("=")[0] for word in settings_among(arguments)):
            require_global(file)
    if brings:
        for file in sorted({*folder.rglob("*.yaml"), *folder.rglob("*.yml")} - set(asked)):
            require_plain(file)


def _asked_for(folder: Path, arguments: Sequence[str]) -> Iterator[Path]:
    """The files GROUP/NAME.yaml of a folder that settings GROUP=NAME choose."""
    for word in settings_among(arguments):
        for one in values_of(word):
            group, _, names = one.lstrip("+").partition("=")
            for name in names.strip("[]").split(","):
                file = folder / group.partition("@")[0] / f"{name.strip().strip(QUOTES)}.yaml"
                if os.path.isfile(file):  # which does not stumble over what can be no path
                    yield file


def require_plain(file: Path) -> bool:
    """Refuse a file that is no YAML, names objects of Python, or says so much by aliases that it fills the memory;
    returns whether it has a `defaults` list.
    """
    try:
        node = yaml.compose(file.read_text(encoding="utf-8"), yaml.SafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as fault:
        raise ClothbenchError(f"{file}: found no YAML that can be read ({fault}), expected settings") from None
    if node is not None and _size(node, {}) > MOST:
        raise ClothbenchError(f"{file}: found more than {MOST} values, or an alias of itself, expected settings")
    return isinstance(node, yaml.MappingNode) and any(key.value == "defaults" for key, _ in node.value)


def require_global(file: Path) -> None:
    """Refuse a suite whose settings of a run Hydra would put below those of `suite`, as it does unless a line says
    where they belong.
    """
    text = file.read_text(encoding="utf-8")
    if text.startswith("\ufeff"):  # before which Hydra knows no line that says where settings belong
        raise ClothbenchError(f"{file}: found a byte order mark, expected none; save it as UTF-8 without")
    # Hydra looks for it no further than to the first line that is another one, comments included.
    head = itertools.takewhile(lambda line: not line or re.match(r"#\s*@", line), map(str.strip, text.splitlines()))
    if any(re.match(r"#+\s*@package\b", line) for line in head):
        return
    node = yaml.compose(text, yaml.SafeLoader)
    names = [str(key.value) for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    if found := [name for name in names if name in OF_RUN]:
        raise ClothbenchError(
            f"{file}: found {found[0]!r} and no line {GLOBAL!r}, expected it as the file's first line"
        )


def _size(node: yaml.Node, known: dict[int, int]) -> int:
    """How many values a file amounts to; one that is inside of itself has no end."""
    if id(node) not in known:
        if isinstance(node, yaml.ScalarNode):
            inside: list[yaml.Node] = []
        else:
            inside = [n for one in node.value for n in (one if isinstance(one, tuple) else (one,))]
        known[id(node)] = MOST + 1
        known[id(node)] = 1 + sum(_size(one, known) for one in inside)
    return known[id(node)]


def each_choice(arguments: Sequence[str]) -> Iterator[list[str]]:
    """The settings of the run without Hydra's own, as one job has them: of a sweep, once with every value."""
    words = [word for word in settings_among(arguments) if not word.lstrip("+~").startswith("hydra")]
    values = [values_of(word) for word in words]
    for n in range(max(map(len, values), default=1)):
        yield [several[min(n, len(several) - 1)] for several in values]


def where_searched(arguments: Sequence[str]) -> list[str]:
    """The setting by which Hydra finds the suites of the folders that are named, where some are."""
    return [_searched(folders)] if (folders := _folders(arguments)) else []


def _searched(folders: Sequence[Path]) -> str:
    places = [f"file://{folder}".replace("\\", "\\\\").replace("'", "\\'") for folder in folders]
    return "hydra.searchpath=[" + ",".join(f"'{place}'" for place in places) + "]"


def _after(arguments: Sequence[str]) -> list[str]:
    """Words that belong to a flag."""
    return [after for word, after in itertools.pairwise(arguments) if word in FLAGS]


def settings_among(arguments: Sequence[str]) -> list[str]:
    """KEY=VALUE and ~KEY; a word that is neither belongs to one of Hydra's flags."""
    words = [word for word in arguments if not word.startswith("-") and word not in _after(arguments)]
    return [word for word in words if "=" in word or word.startswith("~")]


def values_of(word: str) -> list[str]:
    """A setting once with each of its values, where it is one of a sweep."""
    try:
        (given,) = OverridesParser.create().parse_overrides([word])
        key = word.partition("=")[0]
        return [f"{key}={v}" for v in given.sweep_string_iterator()] if given.is_sweep_override() else [word]
    except (ValueError, RecursionError) as fault:
        raise ClothbenchError(f"found {word[:80]!r}, expected a setting KEY=VALUE ({fault})") from None


def require_no_hydra(folder: Path, words: Sequence[str]) -> None:
    """Refuse settings in which a suite of the folder's has changed Hydra's own."""
    try:
        with initialize_config_module("clothbench.conf", version_base="1.3"):
            usual = _hydras(compose("run", return_hydra_config=True))
            asked = [_searched([folder]), *words]
            found = _hydras(compose("run", overrides=asked, return_hydra_config=True))
    except (HydraException, OmegaConfBaseException):
        raise
    except Exception as fault:  # of the YAML and of the head of a suite: Hydra lets all sorts of them through
        raise ClothbenchError(f"{folder}: found a suite that cannot be read ({fault}), expected settings") from fault
    if changed := [name for name in {**usual, **found} if usual.get(name) != found.get(name)]:
        raise ClothbenchError(
            f"{folder}: found settings of Hydra's own in a suite (hydra.{changed[0]}), expected those of a run only; "
            f"give them on the command line if you trust them"
        )


def _hydras(config: Any) -> dict[str, Any]:
    """Hydra's own settings that do not tell what was asked for."""
    hydra: Any = OmegaConf.to_container(config.hydra, resolve=False)
    hydra["job"].pop("override_dirname")
    return {name: value for name, value in hydra.items() if name not in OF_ONE_RUN}
