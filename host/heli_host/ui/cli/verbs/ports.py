"""``heli-host ports``: which serial ports there are."""

from __future__ import annotations

from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.verb import Verb


def ports(json: JsonOption = None) -> None:
    """List the serial ports, the Due's programming port first.

    Opens no port, so that no board is reset.

    Example: `heli-host ports`
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from heli_host.errors import printable
    from heli_host.link.transport import available_ports
    from heli_host.ui.cli.board import is_due, is_due_native
    from heli_host.ui.cli.say import write_result

    available = sorted(available_ports(), key=lambda port: not is_due(port))
    entries = [
        {
            "device": port.device,
            "description": port.description,
            "stable_name": port.stable_name,
            "due": is_due(port),
            "due_native": is_due_native(port),
        }
        for port in available
    ]
    if write_result(json, {"ports": entries}):
        return
    console = Console(highlight=False)
    if not available:
        console.print("no serial port; plug the board in by its programming port, next to the power jack")
        return
    table = Table("port", "what", "name that stays", box=None, pad_edge=False)
    for port in available:
        # pyserial describes a port without a description as "n/a".
        description = port.description if port.description != "n/a" else "serial port"
        if is_due(port):
            description = "Arduino Due, programming port"
        elif is_due_native(port):
            description = "Arduino Due, native port: use the other one"
        stable_name = port.stable_name if port.stable_name != port.device else ""
        table.add_row(*(Text(printable(cell)) for cell in (port.device, description, stable_name)))
    console.print(table)


VERB = Verb(ports, "Board")
