"""The browser gets our few lines, other projects' files as published, and nothing from other servers."""

from __future__ import annotations

import gzip
import re
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from heli_host.ui.page.service import page_file

from tests.page.fetch_vendor import FOLDER, integrity, pinned, stored, unpacked

STATIC = FOLDER.parent
OWN = sorted(path for path in STATIC.glob("*") if path.suffix in (".js", ".html", ".css", ".svg"))
MAX_LINES = 1200


def test_our_own_javascript_is_below_1200_lines() -> None:
    assert sum(len(path.read_text().splitlines()) for path in STATIC.glob("*.js")) < MAX_LINES


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_nothing_is_loaded_from_elsewhere(path: Path) -> None:
    addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[^\s\"')]*", path.read_text()))
    assert addresses <= {"http://www.w3.org/2000/svg"}


def test_the_policy_lets_a_page_load_from_its_server_only() -> None:
    policy = page_file("", {}).headers["content-security-policy"]
    sources = {word for rule in policy.split(";") for word in rule.split()[1:]}
    assert sources == {"'none'", "'self'"}


def test_every_file_that_the_page_names_is_there() -> None:
    for path in OWN:
        text = path.read_text()
        named = re.findall(r'(?:src|href)="([\w./]+)"', text) + re.findall(r'from "\./([\w./]+)"', text)
        named += re.findall(r'new Worker\("([\w./]+)"', text)
        for name in named:
            assert page_file(name, {}).status_code == 200, f"{path.name} names {name}"


@pytest.mark.parametrize("name", [name for entry in pinned().values() for name in entry["files"]])
def test_what_others_wrote_is_there_with_its_licence(name: str) -> None:
    data = stored(name).read_bytes()
    text = (gzip.decompress(data) if stored(name).suffix == ".gz" else data).decode()
    assert len(text) > 500
    if name.endswith("LICENSE"):
        assert "Permission is hereby granted, free of charge" in text


def test_a_browser_that_takes_no_gzip_gets_plain_text() -> None:
    plain = page_file("vendor/three.js", {})
    packed = page_file("vendor/three.js", {"accept-encoding": "gzip, deflate"})
    assert gzip.decompress(bytes(packed.body)) == bytes(plain.body)
    assert packed.headers["content-encoding"] == "gzip"


@pytest.mark.slow
@pytest.mark.parametrize("package", pinned())
def test_what_others_wrote_is_what_npm_has_under_the_pinned_hash(package: str) -> None:
    entry = pinned()[package]
    try:
        with urllib.request.urlopen(entry["url"], timeout=30) as answer:
            tarball = answer.read()
    except (urllib.error.URLError, TimeoutError) as error:
        pytest.skip(f"skipped: npm cannot be reached ({error})")
    assert integrity(tarball) == entry["integrity"]
    for name, data in unpacked(tarball, entry["files"]).items():
        kept = stored(name).read_bytes()
        assert (gzip.decompress(kept) if stored(name).suffix == ".gz" else kept) == data
