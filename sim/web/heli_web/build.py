"""Build the page: one HTML file that holds the dashboard, the board and the rig, and loads nothing."""

from __future__ import annotations

import base64
import gzip
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Final

from heli_host.board.law_program import LawProgram
from heli_sim.errors import OptionError
from heli_sim.rig import load_rig

from heli_web.compiler import built_board, is_checkout
from heli_web.facts import RIGS, combined_facts, hidden_facts, page_facts

_PAGE: Final = Path(__file__).resolve().parent / "page"
_DASHBOARD: Final = "heli_host.ui.page"
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
)
_WORKER: Final = (
    *("declaration", "frames", "engine", "laws", "vendor/fzstd", "zstd", "replay", "log", "plans"),
    *("world", "rest", "random", "settings", "host", "worker"),
)
"""Modules of the worker, each behind those that it imports."""
_DASHBOARD_MODULES: Final = (
    *("vendor/three.core.min", "vendor/three", "keys", "history", "link", "scene", "strips", "controls"),
    "main",
)
"""Modules of the dashboard, likewise."""
_TAB: Final = (
    '      <button type="button" role="tab" id="tab-lab" aria-controls="lab" aria-selected="false" '
    'tabindex="-1">Lab</button>\n'
)
_BARS: Final = '<p id="lab-message" class="hint" role="status"></p>\n<p id="lab-paused" role="status"></p>\n'


def page_text(board: bytes, facts: Mapping[str, Any], firmware: Sequence[tuple[int, bytes]] = ()) -> str:
    """Return the text of a page from the module of the boards, facts, and segments of the firmware."""
    static = files(_DASHBOARD) / "static"
    modules = [[f"{name}.js", _static(static, f"{name}.js")] for name in _DASHBOARD_MODULES]
    parts = {
        "facts": facts,
        "modules": [*modules, *([name, _page_file(name)] for name in ("random.js", "settings.js", "lab.js"))],
        "worker": bundle(_page_file(f"{name}.js") for name in _WORKER),
        "uplot": _static(static, "vendor/uplot.js"),
    }
    packed = [_packed("parts", _json(parts)), _packed("board-module", board)]
    if firmware:
        segments = [{"address": address, "content": _base64(content)} for address, content in firmware]
        packed.append(_packed("firmware", _json(segments)))
    styles = (_static(static, "vendor/uplot.css"), _static(static, "page.css"), _page_file("lab.css"))
    icon = _base64(_static(static, "icon.svg").encode())
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f'<link rel="icon" href="data:image/svg+xml;base64,{icon}">\n'
        f"<style>\n{''.join(styles)}\n</style>\n"
    )
    # The page contains its styles and scripts, instead of links to the dashboard's.
    html = re.sub(r"<(?:link|script)\b[^>]*>(?:</script>)?\n", "", _static(static, "index.html"))
    panel, boot = _page_file("lab.html"), f"<script>\n{_page_file('boot.js')}</script>\n"
    for mark, added in (
        ("</head>", head),
        ('    </div>\n    <div id="fly"', _TAB),
        ('    <div id="parameters"', panel),
        ("<main>", _BARS),
        ("</body>", "".join(packed) + boot),
    ):
        before, matched, after = html.partition(mark)
        html = f"{before}{added}{matched}{after}"
    return html


def _packed(name: str, content: bytes) -> str:
    """Return an element that holds bytes, for boot.js, in short lines."""
    text = base64.encodebytes(gzip.compress(content, 9, mtime=0)).decode()
    return f'<script type="text/plain" id="{name}">\n{text}</script>\n'


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()


def _page_file(name: str) -> str:
    return (_PAGE / name).read_text(encoding="utf-8")


def bundle(modules: Iterable[str]) -> str:
    """Return ES modules as one script, each in a function of its own, behind the modules that it imports."""
    return '"use strict";\nconst shared = {};\n' + "\n".join(_as_function(text) for text in modules)


def _as_function(module: str) -> str:
    """Return a module as a function call that takes its imports from `shared`, and puts its exports there."""
    exported = re.findall(r"^export (?:async )?(?:function\*?|class|const|let|var) (\w+)", module, re.M)
    for names in re.findall(r"^export \{([^}]*)\};", module, re.M):
        exported += [name.strip() for name in names.split(",")]
    body = re.sub(r"^export \{[^}]*\};", "", module, flags=re.M)
    body = re.sub(r"^export ", "", body, flags=re.M)
    body = re.sub(r'^import \{([^}]*)\} from "[^"]*";', r"const {\1} = shared;", body, flags=re.M)
    return f"(() => {{\n{body}\nObject.assign(shared, {{ {', '.join(exported)} }});\n}})();"


def _static(folder: Traversable, name: str) -> str:
    """Return the text of a static file of the dashboard, which may be stored compressed."""
    for part in name.split("/"):
        parent, folder = folder, folder / part
    if folder.is_file():
        return folder.read_text(encoding="utf-8")
    return gzip.decompress((parent / f"{part}.gz").read_bytes()).decode()


def write_page(
    output: Path,
    plan_list: Sequence[str],
    rig: str | None,
    effect_texts: Sequence[str],
    *,
    puzzle: bool = False,
    laws: Sequence[LawProgram] = (),
    progress: Callable[[str], object] = lambda _: None,
) -> list[str]:
    """Write a page, and the truth file of a puzzle; return the lines about them for the user."""
    from heli_host.data.files import check_replaceable, write_signed
    from heli_host.data.log.blind import Truth, truth_path
    from heli_host.errors import HeliError
    from heli_host.fly.plan import load_plan, plan_names
    from heli_sim.due.firmware import find_firmware, read_firmware
    from heli_sim.model.effects.catalogue import parse_effects

    if puzzle and not effect_texts:
        raise OptionError(
            "a puzzle hides nothing", "name what it hides, such as --effect cable_spring.travel=0.06"
        )
    check_replaceable(output)
    plans = [load_plan(name) for name in plan_list or plan_names()]
    effects = parse_effects(effect_texts)
    loaded = [load_rig(name) for name in ((rig,) if rig else RIGS)]
    board = board_module(progress)
    lines = [f"page: {output}"]
    segments: Sequence[tuple[int, bytes]] = ()
    try:
        firmware = find_firmware()
        segments = read_firmware(firmware).segments
    except HeliError as error:
        lines.append(f"without the emulated Due: {error}")
    facts = page_facts(plans, {plan.name: tomllib.loads(plan.text) for plan in plans}, loaded, laws)
    if puzzle:
        truth = Truth.seal(
            {"rig": loaded[0].name, "effects": list(effect_texts), "plans": [plan.name for plan in plans]}
        )
        facts = {
            **facts,
            "effects": [],
            "puzzle": hidden_facts(effects, loaded[0], truth),
            "rigs": facts["rigs"][:1],
        }
        place = truth_path(output)
        truth.write(place)
        lines += [f"sealed: {truth.digest}", f"truth (keep it, share only the page): {place}"]
    elif effects:
        combined = combined_facts(effects, loaded[0])
        facts = {**facts, "effects": [combined, *facts["effects"]], "start": combined["id"]}
    write_signed(output, page_text(board, facts, segments))
    return lines


def board_module(progress: Callable[[str], object]) -> bytes:
    """Return the WebAssembly module of the boards: that of the package, or compiled from the sources."""
    packaged = Path(__file__).with_name("board.wasm")
    if packaged.exists() and not is_checkout():
        return packaged.read_bytes()
    return built_board(progress).read_bytes()
