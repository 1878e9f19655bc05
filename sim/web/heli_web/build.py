"""Build the page: one HTML file that holds the dashboard, the board and the rig, and loads nothing."""

from __future__ import annotations

import base64
import gzip
import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Final

from heli_sim.errors import OptionError
from heli_sim.rig import load_rig

from heli_web.compiler import built_board, is_checkout
from heli_web.facts import RIGS, combined_facts, page_facts
from heli_web.puzzle import hidden_facts

_PAGE: Final = Path(__file__).resolve().parent / "page"
_DASHBOARD: Final = "heli_host.ui.page"
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
)
_WORKER: Final = (
    *("declaration.js", "frames.js", "engine.js", "vendor/fzstd.js", "zstd.js", "replay.js", "log.js", "plans.js"),
    *("world.js", "settings.js", "host.js", "worker.js"),
)
"""Modules of the worker, each behind those that it imports."""
_SHOWN: Final = (
    *("vendor/three.core.min.js", "vendor/three.js", "keys.js", "history.js", "link.js", "scene.js", "strips.js"),
    *("controls.js", "main.js"),
)
"""Modules of the dashboard, likewise."""
_OWN_TAB: Final = (
    '<button type="button" role="tab" id="tab-lab" aria-controls="lab" aria-selected="false" tabindex="-1">Lab</button>'
)


def page_text(board: bytes, facts: Mapping[str, Any], firmware: Sequence[tuple[int, bytes]] = ()) -> str:
    """Return the text of a page from the module of the boards, its facts, and the segments of the firmware for
    the emulated Due; without segments the page does not offer this board.
    """
    static = files(_DASHBOARD) / "static"
    modules = [[name, _static(static, name)] for name in _SHOWN]
    modules += [[name, (_PAGE / name).read_text("utf-8")] for name in ("settings.js", "lab.js")]
    parts = {
        "facts": facts,
        "modules": modules,
        "worker": bundle((_PAGE / name).read_text("utf-8") for name in _WORKER),
        "uplot": _static(static, "vendor/uplot.js"),
    }
    html = _static(static, "index.html")
    html = re.sub(r'<(?:link|script)\b[^>]*>(?:</script>)?\n', "", html)
    icon = base64.b64encode(_static(static, "icon.svg").encode()).decode()
    style = "\n".join(
        (_static(static, "vendor/uplot.css"), _static(static, "page.css"), (_PAGE / "lab.css").read_text("utf-8"))
    )
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f'<link rel="icon" href="data:image/svg+xml;base64,{icon}">\n<style>\n{style}\n</style>\n</head>'
    )
    html = html.replace("</head>", head, 1)
    html = html.replace('    </div>\n    <div id="fly"', f'      {_OWN_TAB}\n    </div>\n    <div id="fly"', 1)
    html = html.replace('    <div id="parameters"', f'{(_PAGE / "lab.html").read_text("utf-8")}    <div id="parameters"', 1)
    bars = '<p id="lab-message" class="hint" role="status"></p>\n<p id="lab-paused" role="status"></p>\n<main>'
    html = html.replace("<main>", bars, 1)
    data = {"parts": json.dumps(parts, separators=(",", ":")).encode(), "board-module": board}
    if firmware:
        segments = [{"address": address, "content": base64.b64encode(content).decode()} for address, content in firmware]
        data["firmware"] = json.dumps(segments).encode()
    blocks = [
        f'<script type="text/plain" id="{name}">{base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()}</script>'
        for name, content in data.items()
    ]
    boot = f"<script>\n{(_PAGE / 'boot.js').read_text('utf-8')}</script>"
    return html.replace("</body>", "\n".join([*blocks, boot, "</body>"]), 1)


def bundle(modules: Any) -> str:
    """Return ES modules as one script, each in a function of its own; each stands behind those that it imports."""
    texts = []
    for text in modules:
        exported = re.findall(r"^export (?:async )?(?:function\*?|class|const|let|var) (\w+)", text, re.M)
        exported += [name for names in re.findall(r"^export \{([^}]*)\};", text, re.M) for name in names.replace(" ", "").split(",")]
        text = re.sub(r"^export \{[^}]*\};", "", text, flags=re.M)
        text = re.sub(r"^export ", "", text, flags=re.M)
        text = re.sub(r'^import \{([^}]*)\} from "[^"]*";', r"const {\1} = shared;", text, flags=re.M)
        texts.append(f"(() => {{\n{text}\nObject.assign(shared, {{ {', '.join(exported)} }});\n}})();")
    return '"use strict";\nconst shared = {};\n' + "\n".join(texts)


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
    progress: Callable[[str], object] = lambda _: None,
) -> list[str]:
    """Write a page, and the truth file of a puzzle; return the lines about them for the user."""
    from heli_host.data.log.blind import Truth, truth_path
    from heli_host.errors import HeliError
    from heli_host.fly.plan import load_plan, plan_names
    from heli_host.data.files import write_bytes
    from heli_sim.due.firmware import find_firmware, read_firmware
    from heli_sim.model.effects.parse import parse_effects

    if puzzle and not effect_texts:
        raise OptionError("a puzzle hides nothing", "name what it hides, such as --effect cable_spring.travel=0.06")
    plans = [load_plan(name) for name in plan_list or plan_names()]
    effects = parse_effects(effect_texts)
    loaded = [load_rig(name) for name in ((rig,) if rig else RIGS)]
    board = board_module(progress)
    lines, segments = [f"page: {output}"], ()
    try:
        firmware = find_firmware()
        segments = read_firmware(firmware).segments
    except HeliError as error:
        lines.append(f"without the emulated Due: {error}")
    facts = page_facts(plans, {plan.name: tomllib.loads(plan.text) for plan in plans}, loaded)
    if puzzle:
        truth = Truth.seal({"rig": loaded[0].name, "effects": list(effect_texts), "plans": [plan.name for plan in plans]})
        facts = {**facts, "effects": [], "puzzle": hidden_facts(effects, loaded[0], truth), "rigs": facts["rigs"][:1]}
        place = truth_path(output)
        truth.write(place)
        lines += [f"sealed: {truth.digest}", f"truth (keep it, share only the page): {place}"]
    elif effects:
        combined = combined_facts(effects, loaded[0])
        facts = {**facts, "effects": [combined, *facts["effects"]], "start": combined["id"]}
    write_bytes(output, page_text(board, facts, segments).encode())
    return lines


def board_module(progress: Callable[[str], object]) -> bytes:
    """Return the WebAssembly module of the boards: that of the package, or compiled from the sources."""
    packaged = Path(__file__).with_name("board.wasm")
    if packaged.exists() and not is_checkout():
        return packaged.read_bytes()
    return built_board(progress).read_bytes()
