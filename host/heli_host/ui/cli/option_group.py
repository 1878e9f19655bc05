"""Groups of options: a dataclass declares options once, and several verbs take them as one argument."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_origin, get_type_hints

_Verb = Callable[..., None]


def with_option_groups(*, without: Collection[str] = ()) -> Callable[[_Verb], _Verb]:
    """Give a verb the options of its groups, where typer expects one parameter per option.

    A group is a keyword argument whose type is a dataclass. Its options are the fields with annotated types,
    in their order. The other fields keep their defaults.
    """

    def decorate(verb: _Verb) -> _Verb:
        """Return a command that has the options of all groups as parameters, for typer, and passes them to
        the verb as one dataclass per group.
        """
        parameters: list[inspect.Parameter] = []
        groups: dict[str, tuple[type[Any], list[str]]] = {}
        for parameter in inspect.signature(verb, eval_str=True).parameters.values():
            group = parameter.annotation
            if isinstance(group, type) and is_dataclass(group):
                options = [option for option in _options_of_dataclass(group) if option.name not in without]
                groups[parameter.name] = group, [option.name for option in options]
                parameters += options
            else:
                parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

        @functools.wraps(verb)
        def command(**values: Any) -> None:
            for name, (group, options) in groups.items():
                values[name] = group(**{option: values.pop(option) for option in options})
            verb(**values)

        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return command

    return decorate


def _options_of_dataclass(group: type[Any]) -> list[inspect.Parameter]:
    """Return the options of a dataclass as parameters of a function."""
    types = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=types[field.name]
        )
        for field in fields(group)
        if get_origin(types[field.name]) is Annotated
    ]
