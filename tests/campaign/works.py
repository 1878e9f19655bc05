"""Cheap cases that a campaign can be killed in, and bad ones."""

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from heli_lab.errors import CampaignError


def count(settings: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, int]]:
    """Square a number after a nap and once the file `gate` exists, and write down that this was begun."""
    if "log" in settings:
        with Path(settings["log"]).open("a") as log:
            log.write(f"{settings['number']}\n")
    time.sleep(settings.get("nap_s", 0.0))
    while settings.get("gate") and not Path(settings["gate"]).exists():
        time.sleep(0.01)
    return {"square": settings["number"] ** 2}, {"pid": os.getpid()}


def bad(settings: Mapping[str, Any]) -> tuple[dict[str, int], None]:
    """Go wrong in the way that the case asks for."""
    how = settings["how"]
    if how == "crashes":
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "leaves":
        os._exit(7)
    if how == "runs away":
        while True:
            pass
    if how == "hangs":
        time.sleep(3600.0)
    if how == "raises":
        raise ValueError("seven\nlines of it")
    if how == "refuses":
        raise CampaignError("no such thing", "ask for another")
    if how == "returns a dict":
        return {"fine": 1}  # type: ignore[return-value]
    if how == "returns three":
        return {"fine": 1}, None, None  # type: ignore[return-value]
    if how == "returns a list as its row":
        return [1], None  # type: ignore[return-value]
    if how == "returns a row by number":
        return {1: 1}, None  # type: ignore[dict-item]
    if how == "returns no JSON":
        return {"set": {1}}, None  # type: ignore[dict-item]
    return {"fine": 1}, None
