"""Words in the spelling of another command: some are told KEY=VALUE, some --KEY VALUE, and people mix both."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from clothbench.core.errors import ClothbenchError, nearest


def as_setting(word: str, given: Sequence[str]) -> str:
    """ "--out", of ["--out", "X"], or "--out=X" → "out=X"."""
    name, sign, value = word.lstrip("-").partition("=")
    after = [*given[list(given).index(word) + 1 :], ""][0]
    if not sign:
        value = after if after and "=" not in after and not after.startswith("-") else "VALUE"
    return f"{name.replace('-', '_')}={value}"


def unexpected(word: str, name: str, expected: Sequence[str]) -> ClothbenchError:
    """Of a word that is no NAME=VALUE with one of the names expected; name: which it has before the sign, if any."""
    near = nearest(name, expected) if "=" in word else ""
    return ClothbenchError(f"found {word!r}, {near}expected {' or '.join(f'{a}=VALUE' for a in expected)}")


def given_twice(settings: Sequence[str]) -> str:
    """Which key KEY=VALUE words give two values, in words; "" where there is none."""
    known: dict[str, str] = {}
    for word in settings:
        key, sign, value = word.partition("=")
        if sign and known.setdefault(key, value) != value:
            return f"{key} is given twice: {known[key]} and {value}"
    return ""


def require_once(settings: Sequence[str]) -> None:
    """Refuse a key with two values."""
    if twice := given_twice(settings):
        raise ClothbenchError(f"{twice}; leave one of them out")


class Reader(argparse.ArgumentParser):
    """Says in one line what is wrong with a command's words, and how one is written that is spelled as another command
    has it.
    """

    given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        self.given = list(args or ())
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        command = self.prog.partition(" ")[2]
        remedy = self.respelled(self.given) or f"{self.meant(message)}see {self.prog} --help"
        raise ClothbenchError(f"{command}: {message}; {remedy}" if command else f"{message}; {remedy}")

    def meant(self, message: str) -> str:
        """ "did you mean 'leaderboard'? " of what argparse says of a word or an option that there is not."""
        if found := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            return nearest(found[1], (choice.strip("' ") for choice in found[2].split(",")))
        if found := re.match(r"unrecognized arguments: (-[^\s=]*)", message):
            return nearest(found[1], self._option_string_actions)
        return ""

    def require_spelled(self, settings: Sequence[str]) -> None:
        """Refuse a KEY=VALUE of these that is an option of the command, where whatever else is said of it would
        mislead.
        """
        if remedy := self.respelled([word for word in settings if not word.startswith("-")]):
            raise ClothbenchError(f"{self.prog.partition(' ')[2]}: {remedy}")

    def respelled(self, words: Sequence[str]) -> str:
        """How the first of these words is written that another command writes so; "" if there is none."""
        settings = next((action.help or "" for action in self._actions if action.dest == "settings"), "")
        for word in words:
            name, sign, value = word.partition("=")
            option = self._option_string_actions.get(f"--{name}")
            own = any(one.startswith(name) for one in self._option_string_actions)  # which may be cut short
            if word.startswith("-") and settings and not own:
                setting = as_setting(word, words)
                if f"{setting.partition('=')[0]}=" in settings:
                    return f"{name} is written {setting} here"
                return f"settings are written KEY=VALUE here; see {self.prog} --help"
            if sign and option is not None:
                return f"{word} is written --{name}{'' if option.nargs == 0 else f' {value}'} here"
        return ""
