"""Options that take several values: ``--validate A B`` as well as ``--validate A --validate B``."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand


class Variadic(TyperCommand):
    """A verb whose repeatable options take all words up to the next option.

    Without this, a second file behind ``--validate`` would be taken for one more flight to fit, without
    an error.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat an option before each of its values in `args`, then parse the arguments as usual.

        Returns the arguments that remain after parsing; `ctx` is the context of the command.
        """
        return list(super().parse_args(ctx, spread(args, self._repeatable_spellings())))

    def _repeatable_spellings(self) -> frozenset[str]:
        """Return the spellings of all options that may be given several times."""
        return frozenset(
            name
            for parameter in self.params
            if getattr(parameter, "multiple", False)
            for name in parameter.opts
        )


def spread(arguments: list[str], repeatable: frozenset[str]) -> list[str]:
    """Repeat each option whose name is in `repeatable` before each of its values in `arguments`; behind
    ``--`` nothing changes.
    """
    result: list[str] = []
    option = ""
    values = 0
    for number, word in enumerate(arguments):
        if word == "--":
            return result + arguments[number:]
        if word.startswith("-") and not _is_number(word):
            option, values = (word, 0) if word in repeatable else ("", 0)
            result.append(word)
            continue
        if option and values:
            result.append(option)
        values += 1
        result.append(word)
    return result


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
