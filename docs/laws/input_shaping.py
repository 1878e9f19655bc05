"""Input shaping: a step of travel in two parts; the swing of the second undoes that of the first."""

from heli_lab.control.tune import linear_plant
from heli_lab.law import Command, control_law, law_rig, motor_volts, saturated

plant = linear_plant(law_rig())
RATE_Hz = 50
# Half a period of the slow mode that the gains below leave.
HALF_s = 1.2
LINE = [f"delay{k}" for k in range(round(HALF_s * RATE_Hz / 4))]
DT_s = 1.0 / RATE_Hz


@control_law(
    rate_Hz=RATE_Hz, states=dict.fromkeys([*LINE, "phase", "elevation_V"], 0.0), parameters={"share": 0.55}
)
def input_shaping(now, state, parameter):
    # The delay line moves at every fourth call: a quarter of the states.
    phase = state.phase + 0.25
    moves = phase >= 0.99
    line = [getattr(state, name) for name in LINE]
    moved = [now.travel_setpoint_rad, *line[:-1]]
    shaped_rad = parameter.share * now.travel_setpoint_rad + (1 - parameter.share) * line[-1]
    pitch_rad = saturated(
        0.6 * (shaped_rad - now.travel_rad) - 2.2 * (now.travel_rad_s - now.travel_setpoint_rad_s), -0.4, 0.4
    )
    hold = -plant.tilt_A[2, 0]
    differential_V = (
        16.0 * (pitch_rad - now.pitch_rad) - 7.0 * now.pitch_rad_s + hold * now.pitch_rad
    ) / plant.pitch_gain
    error_rad = now.elevation_setpoint_rad - now.elevation_rad
    collective_V = (
        plant.hover_V
        + 8.0 * error_rad
        - 6.0 * (now.elevation_rad_s - now.elevation_setpoint_rad_s)
        + state.elevation_V
    )
    states = {name: moves * new + (1 - moves) * old for name, new, old in zip(LINE, moved, line, strict=True)}
    return Command(
        *motor_volts(collective_V, saturated(differential_V, -1.4, 1.4)),
        states={
            **states,
            "phase": phase * (1 - moves),
            "elevation_V": saturated(state.elevation_V + DT_s * 8.0 * error_rad, -2.0, 2.0),
        },
        travel_setpoint_rad=shaped_rad,
        pitch_setpoint_rad=pitch_rad,
    )


LAW = input_shaping
