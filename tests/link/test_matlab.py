"""MATLAB's class speaks the link as the host does, and flies a board over TCP.

It runs in Octave with the package instrument-control, because MATLAB is not available here.
"""

import functools
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from heli_host.declaration import PROTOCOL, MessageId
from heli_host.link.frames import encode_frame

TELEMETRY = int(MessageId.TELEMETRY)
"""The longest message of the board."""
CLASS = Path(__file__).resolve().parents[2] / "docs" / "matlab"
HELI_HOST = "import sys; from heli_host.ui.cli import main; sys.exit(main())"
SLOW = "0.25"
"""Simulated seconds a second: a computer that stalls for a second does not make the board land."""

# Reads messages in hexadecimal, one per line, and prints their frames.
FRAMES = r"""
[bits, zeros_crc] = Heli.crcTables(488);
function bytes = hex(line)
  bytes = uint8(hex2dec(reshape(line, 2, [])'))';
end
for line = strsplit(fileread('messages.txt'), "\n")
  if ~isempty(line{1})
    body = hex(line{1});
    crc = typecast(Heli.crc(body, bits, zeros_crc), 'uint8');
    frame = Heli.encode([body, crc]);
    assert(isequal(Heli.decode(frame), [body, crc]));
    printf('%s\n', lower(sprintf('%02X', [frame, 0])));
  end
end
"""
# Flies the board at the port in the environment, and prints what the test reads: one name and value per line.
FLIES = r"""
pkg load instrument-control
h = Heli('127.0.0.1', str2double(getenv('HELI_PORT')));
printf('supply_V %g\n', h.parameters().supply_V);
printf('set %g\n', h.setParameter('travel_kp', 0.5));
try
  h.setParameter('travel_kp', 99);
catch refused
  printf('refused %s\n', refused.message);
end
% A machine that stalls for a second must not end the flight.
h.setParameter('setpoint_hold_s', 5);
h.setParameter('setpoint_land_s', 30);
h.takeOff(0);
h.setpoint(3, 12);
h.waitUntil(@(s) s.elevation_rad * 180 / pi > 2 && s.travel_rad * 180 / pi > 6, 240);
printf('flies %s\n', h.state());
h.land(120);
s = h.samples();
printf('landed %s\n', h.state());
printf('rest_deg %.2f\n', s.elevation_rad(end) * 180 / pi);
printf('gaps %d\n', sum(diff(s.tick) ~= 1));
printf('damaged %d\n', h.losses.frames);
printf('front_V %.3f\n', max(s.front_V));
printf('kp %g\n', h.parameters().travel_kp);
h.close();
"""


@functools.cache
def octave() -> str:
    octave = shutil.which("octave-cli")
    if octave is None:
        pytest.skip("skipped: no octave-cli (apt-get install octave)")
    return octave


def run(script: str, cwd: Path, **environment: str) -> str:
    (cwd / "script.m").write_text(script)
    process = subprocess.run(
        [octave(), "--quiet", "--norc", "--path", str(CLASS), "script.m"],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    if "package_name='instrument-control'" in process.stderr or "instrument-control" in process.stderr:
        pytest.skip("skipped: no instrument-control in Octave (apt-get install octave-instrument-control)")
    assert process.returncode == 0, process.stderr[-2000:]
    return process.stdout


@pytest.mark.medium
def test_its_frames_are_those_of_the_host(tmp_path: Path) -> None:
    drawn = random.Random(1)
    lengths = [0, 1, 57, 245, 246, 247, 248, 250, 251, 480]
    bodies = [bytes(drawn.choices(range(few), k=length)) for length in lengths for few in (1, 3, 256)]
    bodies += [bytes(drawn.choices(range(1, 256), k=length)) for length in lengths]
    messages = [bytes([PROTOCOL, TELEMETRY, number]) + body for number, body in enumerate(bodies)]
    (tmp_path / "messages.txt").write_text("\n".join(message.hex() for message in messages))
    frames = run(FRAMES, tmp_path).split()
    assert frames == [encode_frame(TELEMETRY, number, body).hex() for number, body in enumerate(bodies)]


@pytest.mark.slow
def test_it_takes_off_flies_and_lands(tmp_path: Path) -> None:
    octave()
    board = subprocess.Popen(
        [sys.executable, "-c", HELI_HOST, "sil", "--tcp", "127.0.0.1:0", "--speed", SLOW],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert board.stdout is not None
        port = re.search(r"socket://127\.0\.0\.1:(\d+)", board.stdout.readline())
        assert port is not None
        values = dict(line.split(" ", 1) for line in run(FLIES, tmp_path, HELI_PORT=port[1]).splitlines())
    finally:
        board.terminate()
        board.wait()
    assert values["supply_V"] == "12" and values["set"] == values["kp"] == "0.5"
    assert values["refused"] == "the board refuses param_set: out_of_range"
    assert (values["flies"], values["landed"]) == ("closed_loop", "idle")
    assert float(values["rest_deg"]) == pytest.approx(-25.0, abs=0.5)
    assert (values["gaps"], values["damaged"]) == ("0", "0")
    assert 1.0 < float(values["front_V"]) < 10.0
