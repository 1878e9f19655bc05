"""Verbs take the options of a dataclass as one argument."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from heli_host.ui.cli.verb import with_option_groups
from typer.testing import CliRunner

from tests.cli.terminal import Terminal


@dataclass(frozen=True)
class Light:
    """Options of a verb that shines."""

    colour: Annotated[str, typer.Option("--colour")] = "white"
    watts: Annotated[float, typer.Option("--power")] = 5.0
    lumens: float = 400.0


def printed(*words: str, without: tuple[str, ...] = ()) -> str:
    """Return what a verb with the group printed, or its error."""
    app = typer.Typer()

    @app.command()
    @with_option_groups(without=without)
    def shine(lamp: str, *, light: Light, minutes: Annotated[int, typer.Option("--for")] = 1) -> None:
        """Shine."""
        print(lamp, light, minutes)

    return CliRunner().invoke(app, words).output


def test_fields_are_options_of_the_verb_and_the_others_keep_their_defaults() -> None:
    assert printed("desk") == "desk Light(colour='white', watts=5.0, lumens=400.0) 1\n"
    given = printed("desk", "--power", "7", "--for", "3", "--colour", "red")
    assert given == "desk Light(colour='red', watts=7.0, lumens=400.0) 3\n"
    assert "No such option" in printed("desk", "--lumens", "3")


def test_a_verb_leaves_options_out() -> None:
    assert printed("desk", without=("colour",)) == "desk Light(colour='white', watts=5.0, lumens=400.0) 1\n"
    assert "No such option" in printed("desk", "--colour", "red", without=("colour",))


@pytest.mark.medium
def test_a_law_flies_with_every_option_of_a_flight(terminal: Terminal) -> None:
    fly, law = (
        set(re.findall(r"^│\W*(--[a-z-]+)", terminal(*words, "--help").out, re.MULTILINE))
        for words in (("fly",), ("law", "fly"))
    )
    assert {"--foxglove", "--twin", "--seed", "--log"} <= fly
    assert fly - law == {"--again"}
