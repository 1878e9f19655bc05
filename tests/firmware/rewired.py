"""An emulated board whose every wire differs from the paper's. Its pins are not read from the firmware."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from firmware.due.report import Image
from tests.firmware.desk import Arm, Board

# A and B of elevation, pitch and travel.
ENCODERS: Final = (("PC25", "PC26"), ("PD0", "PD1"), ("PB25", "PB27"))
# RPWM, LPWM, R_EN, L_EN of front and back; low means on.
FRONT: Final = ("PC24", "PC23", "PC1", "PB21")
BACK: Final = ("PC22", "PC21", "PA19", "PD2")
STOP: Final = "PD6"


class RewiredBoard(Board):
    """A board with inverting stages before its drivers, and a stop that closes to ground."""

    def __init__(self, elf: Path, image: Image) -> None:
        super().__init__(elf, image, Arm())

    def connect_wires(self) -> None:
        """Attach encoders, pull-ups of the enables, and an open stop switch."""
        for a, b in ENCODERS:
            self.due.attach_encoder(a, b)
        for _, _, right, left in (FRONT, BACK):
            self.due.set_pin(right, "pull-up")
            self.due.set_pin(left, "pull-up")
        self.due.set_pin(STOP, "open")

    def duties(self) -> list[float]:
        """Return what acts on the motors, -1 to 1."""
        return [
            (self.due.pin_duty(left_pwm) - self.due.pin_duty(right_pwm))
            * (not self.due.pin(right) and not self.due.pin(left))
            for right_pwm, left_pwm, right, left in (FRONT, BACK)
        ]

    def off(self) -> bool:
        """Return whether every enable is high."""
        return all(self.due.pin(pin) for _, _, *enables in (FRONT, BACK) for pin in enables)

    def on(self) -> bool:
        """Return whether every enable is low."""
        return not any(self.due.pin(pin) for _, _, *enables in (FRONT, BACK) for pin in enables)

    def bridges_idle(self) -> bool:
        """Return whether all four PWM pins stay high."""
        return all(self.due.pin_duty(pin) == 1.0 for pins in (FRONT, BACK) for pin in pins[:2])

    def pwm_high(self) -> bool:
        """Return whether all four PWM pins are high now."""
        return all(self.due.pin(pin) for pins in (FRONT, BACK) for pin in pins[:2])

    def press_stop(self) -> None:
        """Close the stop switch to ground."""
        self.due.set_pin(STOP, "low")

    def angles_deg(self) -> tuple[float, float, float]:
        """Return elevation, pitch and travel of the arm."""
        assert self.arm is not None
        elevation, pitch, travel = (math.degrees(angle) for angle in self.arm.state[:3])
        return elevation, pitch, travel
