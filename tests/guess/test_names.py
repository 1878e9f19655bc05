"""Names of columns in several languages, and what they mean."""

import pytest
from heli_lab.setup.guess.names import (
    VOLTAGE_ROLES,
    direction_columns,
    is_time,
    meaning_of,
    meanings_of,
    unknown_unit_of,
)


@pytest.mark.parametrize(
    ("name", "role", "quantity"),
    [
        ("Höhenwinkel Soll", "elevation", "a setpoint"),
        ("Nickwinkelgeschwindigkeit", "pitch", "a rate"),
        ("Vandring filtrert", "travel", "an estimate"),
        ("elevationMeasuredLowPass", "elevation", "an estimate"),
        ("dpitch", "pitch", "a rate"),
        ("epsilon_d", "elevation", "a setpoint or a rate"),
        ("Strom vorne", "front", "a current"),
        ("I_h", "back", "a current"),
        ("i1", "", "a current"),
        ("i1_A", "", "a current"),
        ("I2_mA", "", "a current"),
        ("logsout.i1_A", "", "a current"),
        ("/rig/i2", "", "a current"),
        ("motor_A", "", ""),
        ("motorFront_mA[2]", "front", "a current"),
        ("front [A]", "front", "a current"),
        ("Versorgungsspannung", "", "a supply voltage"),
        ("U_bat", "", "a supply voltage"),
        ("pitch_imu", "pitch", "another sensor"),
        ("loopCount", "", "a counter"),
        ("P_front [W]", "front", "another quantity"),
        ("pose.qx", "", "a quaternion"),
        ("U_v", "front", ""),
        ("F_front", "front", "a force"),
        ("PWM_h", "back", ""),
        ("V_f", "front", ""),
        ("V_r", "back", ""),
        ("pwmR", "", ""),
        ("PWM_R (0..4095)", "", ""),
        ("motor_left", "", ""),
        ("u_front_r", "front", "a setpoint"),
        ("heli3d/pitch", "pitch", ""),
        ("V_d", "difference", ""),
        ("Pådrag foran", "front", ""),
        ("Nick_ist", "pitch", ""),
        ("Elevationswinkel", "elevation", ""),
        ("Steigwinkel", "elevation", ""),
        ("elevação", "elevation", ""),
        ("beccheggio", "pitch", ""),
        ("verplaatsing", "travel", ""),
        ("tensione anteriore", "front", ""),
        ("tensão traseira", "back", ""),
        ("U_tył", "back", ""),
        ("obrót", "travel", ""),
        ("V_trás", "back", ""),
        ("目標仰角", "elevation", "a setpoint"),
        ("ピッチ角", "pitch", ""),
        ("前モーター電圧", "front", ""),
        ("後電流", "back", "a current"),
        ("旋回角（度）", "travel", ""),
        ("Угол подъёма [град]", "elevation", ""),
        ("Скорость тангажа", "pitch", "a rate"),
        ("Напряжение заднего двигателя, В", "back", ""),
        ("고도각", "elevation", ""),
        ("뒤 모터 전압", "back", ""),
        ("ε", "elevation", ""),
        ("θ̇", "elevation", "a rate"),
        ("λ_ref", "travel", "a setpoint"),
        # In words, marks are accents.
        ("Yükseliş açısı", "elevation", ""),
        # The rest of a compound has to be a word, too.
        ("wpitch", "", ""),
        ("Høyde (grader)", "elevation", ""),
        ("Höhenwinkel [°]", "elevation", ""),
        ("Élévation", "elevation", ""),
        ("高度角(°)", "elevation", ""),
        ("cabeceo", "pitch", ""),
        ("俯仰角", "pitch", ""),
        ("pitch_real_data", "pitch", ""),
        ("Vandring", "travel", ""),
        ("旋转角", "travel", ""),
        ("Moteur arrière [V]", "back", ""),
        ("前电机", "front", ""),
        ("v_delantero", "front", ""),
        ("cmd_front", "front", ""),
        ("V_s", "sum", ""),
        ("u2", "", ""),
        ("x3", "", ""),
        ("pitch_ref", "pitch", "a setpoint"),
        ("e_c", "elevation", "a setpoint"),
        ("r[1]", "", "a setpoint"),
        ("front_ref", "front", "a setpoint"),
        ("pitch [deg/s]", "pitch", "a rate"),
        ("lambda_dot", "travel", "a rate"),
        ("pitch_filtered", "pitch", "an estimate"),
        ("front_current", "front", "a current"),
        ("i_f", "front", "a current"),
    ],
)
def test_a_name_states_a_role_or_another_quantity(name: str, role: str, quantity: str) -> None:
    meaning = meaning_of(name)
    assert (meaning.role, meaning.quantity) == (role, quantity)


@pytest.mark.parametrize(
    "name",
    ["Tid [s]", "Zeit", "Temps (s)", "tiempo", "时间(s)", "Čas", "czas", "時刻", "Время, с", "Datum", "T"],
)
def test_a_name_states_the_time(name: str) -> None:
    assert is_time(name)


def test_a_bar_in_the_row_of_units_states_no_unit_of_an_angle() -> None:
    assert meaning_of("pitch", "duty").role == "pitch"
    assert meaning_of("front", "duty").possible_roles == ("front",)


def test_a_word_that_all_angles_share_states_none_of_them() -> None:
    roles = {"theta_e": "elevation", "theta_p": "pitch", "theta_t": "travel"}
    roles |= {"theta_p_raw": "pitch", "theta_t_raw": "travel"}
    meanings = meanings_of(dict.fromkeys((*roles, "theta_e_ref", "t"), ""))
    assert {name: meanings[name].role for name in roles} == roles
    assert not is_time("theta_t")
    assert is_time("t_rel")
    assert meanings["theta_e_ref"].quantity == "a setpoint"


def test_a_roll_is_the_pitch_of_the_rig_also_next_to_an_elevation() -> None:
    for names in (("pitch", "roll", "yaw"), ("Elevation", "Roll", "Azimuth")):
        meanings = meanings_of(dict.fromkeys(names, ""))
        assert [meanings[name].role for name in names] == ["elevation", "pitch", "travel"]
    assert meanings_of(dict.fromkeys(("elevation", "pitch", "roll"), ""))["roll"].role == ""


def test_a_state_before_the_role_is_part_of_a_message_and_behind_it_a_mode() -> None:
    meanings = meanings_of(dict.fromkeys(("/heli/state/pitch", "pitch_state", "/heli/cmd/voltage_front"), ""))
    assert [meaning.role for meaning in meanings.values()] == ["pitch", "pitch", "front"]
    assert [meaning.quantity for meaning in meanings.values()] == ["", "another quantity", ""]


@pytest.mark.parametrize(
    ("name", "unknown"),
    [
        ("pitch [gon]", "gon"),
        ("Zeit (10ms)", "10ms"),
        ("Azimut/gon", "gon"),
        ("pitch, gon", "gon"),
        ("pitch_gon", "gon"),
        ("heli/pitch", ""),
        ("pitch_angle", ""),
        ("pitch [deg]", ""),
        ("y[1]", ""),
        ("pitch (measured)", ""),
        ("Elevation (Arith Mean)", ""),
    ],
)
def test_a_unit_that_is_not_known_is_noticed(name: str, unknown: str) -> None:
    assert unknown_unit_of(name) == unknown


def test_a_duty_is_left_out_if_the_voltage_of_its_motor_is_logged() -> None:
    meanings = meanings_of(
        {
            "Spannung vorne": "",
            "Tastgrad vorne": "",
            "front duty [%]": "percent",
            "PWM_h": "",
            "Strom hinten": "",
        }
    )
    assert {name for name, meaning in meanings.items() if "duty" in meaning.quantity} == {
        "Tastgrad vorne",
        "front duty [%]",
    }
    assert meanings["PWM_h"].role == "back"


def test_pitch_roll_and_yaw_of_an_aircraft_are_the_three_axes() -> None:
    meanings = meanings_of(dict.fromkeys(("pitch", "roll", "yaw", "roll_ref"), ""))
    assert [meaning.role for meaning in meanings.values()] == ["elevation", "pitch", "travel", "pitch"]
    assert meanings["roll_ref"].quantity == "a setpoint"


def test_the_column_of_a_direction_is_found_by_its_motor() -> None:
    units = dict.fromkeys(("pwm_front", "dir_front", "duty_rear", "Drehrichtung hinten", "pitch"), "")
    assert direction_columns(units) == {"pwm_front": "dir_front", "duty_rear": "Drehrichtung hinten"}


def test_two_columns_of_one_matrix_with_the_name_of_a_motor_are_both_motors() -> None:
    matrix = meanings_of(dict.fromkeys(("t", "pitch", "Vf[1]", "Vf[2]"), ""))
    assert {matrix[name].possible_roles for name in ("Vf[1]", "Vf[2]")} == {VOLTAGE_ROLES}
    copies = meanings_of(dict.fromkeys(("t", "pitch", "Vf", "Vf_raw"), ""))
    assert copies["Vf"].role == copies["Vf_raw"].role == "front"
