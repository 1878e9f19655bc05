"""Hides from a process what Windows lacks; Python imports a module of this name by itself."""

import os
import signal
import sys

# psutil and pyserial choose their own parts for the system: that is their business, and done before.
import psutil  # noqa: F401
import serial  # noqa: F401

HIDDEN = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}


class Hider:
    """Finds what is hidden first, and says that it is not there."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Refuse a module that is hidden; None leaves others to who comes next."""
        if name in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


for module in HIDDEN:
    sys.modules.pop(module, None)
sys.meta_path.insert(0, Hider)
for where, names in ((os, ("openpty", "geteuid", "getuid")), (signal, ("SIGHUP",))):
    for attribute in names:
        delattr(where, attribute)
