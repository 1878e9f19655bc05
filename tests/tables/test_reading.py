"""Every kind of file gives the same columns."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from heli_host.data.tables import Table, read_table
from heli_host.data.tables.table import split_unit
from heli_host.errors import FlightDataError
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

T_S = np.arange(200) * 0.01
X = np.round(np.sin(T_S) * 7.0, 4)
Y = np.round(np.cos(3.0 * T_S) - 2.5, 4)


def assert_same_columns(table: Table, x: str = "x", y: str = "y") -> None:
    assert table.columns[x].values == pytest.approx(X)
    assert table.columns[y].values == pytest.approx(Y)


def rows(separator: str, decimal: str) -> str:
    made = [separator.join(f"{value:.4f}" for value in row) for row in zip(T_S, X, Y, strict=True)]
    return "\n".join(made).replace(".", decimal)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("separator", "decimal"),
    [(",", "."), (";", "."), (";", ","), ("\t", ","), ("\t", "."), (" ", "."), ("|", ",")],
)
def test_dialects_of_text(separator: str, decimal: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"# made by hand\nt{separator}x{separator}y\n{rows(separator, decimal)}\n")
    table = read_table(path)
    assert_same_columns(table)
    assert table.notes == "made by hand"


def test_text_without_names_and_with_a_separator_at_each_end(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(rows(";", ".").replace("\n", ";\n") + ";\n")
    table = read_table(path)
    assert_same_columns(table, "column 2", "column 3")
    assert not table.named


def test_a_row_of_units_and_a_title(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Measurement 7\nt,x,y\n[ms],[deg],[V]\n" + rows(",", "."))
    table = read_table(path)
    assert_same_columns(table)
    assert [column.unit for column in table.columns.values()] == ["ms", "deg", "V"]


STAMPS = [f"10:59:{t:06.3f}" for t in T_S]
LINES = {
    "serial monitor": [
        "10:58:59.900 -> x,y",
        *(f"{s} -> {x},{y}" for s, x, y in zip(STAMPS, X, Y, strict=True)),
    ],
    "serial plotter": [f"x:{x}\ty:{y}\tn:{i}" for i, (x, y) in enumerate(zip(X, Y, strict=True))],
    "units and stamps": [
        f"{s} -> n: {i} count, x: {x} deg, y: {y} V"
        for i, (s, x, y) in enumerate(zip(STAMPS, X, Y, strict=True))
    ],
    "console": [
        "ready",
        *(f"[INFO] [{t + 1e9:.4f}] [heli]: n={t} x={x} y={y}" for t, x, y in zip(T_S, X, Y, strict=True)),
    ],
    "ESP-IDF": [
        "I (29) boot: ready",
        *(f"I ({t:.3f}) heli: n={t} x={x} y={y}" for t, x, y in zip(T_S, X, Y, strict=True)),
    ],
    "brackets": ["[10:58:59.900] x,y", *(f"[{s}] {x},{y}" for s, x, y in zip(STAMPS, X, Y, strict=True))],
    "time without a name": [
        "configsip: 0, SPIWP:0xee",
        *(f"{t:.3f};n={t};x={x};y={y}" for t, x, y in zip(T_S, X, Y, strict=True)),
    ],
    "header before the times": ["x,y", *(f"[{s}] {x},{y}" for s, x, y in zip(STAMPS, X, Y, strict=True))],
    "received with a date": [
        f"2024-05-06 {s} {x},{y}"
        for s, x, y in zip(["10:58:59.900", *STAMPS], ["x", *X], ["y", *Y], strict=True)
    ],
    "Tera Term": [
        f"[Mon May 06 {s} 2024] {x},{y}"
        for s, x, y in zip(["10:58:59.900", *STAMPS], ["x", *X], ["y", *Y], strict=True)
    ],
    "times in letters": [f"timestamp:0h00m{t:.3f}s,x:{x},y:{y}" for t, x, y in zip(T_S, X, Y, strict=True)],
    "times with a name": [
        f"timestamp=2024-05-06T{s} x={x} y={y}" for s, x, y in zip(STAMPS, X, Y, strict=True)
    ],
    "InfluxDB": [
        f"rig,lab=a x={x},y={y},n\\,\\ s={t},k=5i,m=7i {1_700_000_000_000_000_000 + round(t * 1e9)}"
        for t, x, y in zip(T_S, X, Y, strict=True)
    ],
    "dictionaries of Python": [
        repr({"timestamp": round(t, 3), "x": x, "n": None, "y": float(y)})
        for t, x, y in zip(T_S, X, Y, strict=True)
    ],
    "counter with a sign": [
        f"#:{i},x:{x},y:{y},timestamp:{t}" for i, (t, x, y) in enumerate(zip(T_S, X, Y, strict=True))
    ],
    "JSON": [f'{{"timestamp": {t:.3f}, "x": {x}, "y": {y}}}' for t, x, y in zip(T_S, X, Y, strict=True)],
}


@pytest.mark.parametrize("kind", LINES)
def test_lines_that_name_their_values_or_their_reception(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("\n".join(LINES[kind]) + "\n")
    table = read_table(path)
    names = {split_unit(name)[0]: name for name in table.columns}
    assert_same_columns(table, names["x"], names["y"])
    if kind != "serial plotter":
        times = table.columns["timestamp"].values
        unit_s = 1e-9 if kind == "InfluxDB" else 1.0
        assert unit_s * (times[-1] - times[0]) == pytest.approx(T_S[-1], abs=1e-3)


@pytest.mark.parametrize("form", ["{{{}}}", "10:59:01.5 -> {{{}}}", "{}"])
def test_lines_with_other_names_have_blank_cells(form: str, tmp_path: Path) -> None:
    equals, comma = ('"{}": {}', ", ") if "{{" in form else ("{}={}", " ")
    path = tmp_path / "a.txt"
    lines = [
        form.format(comma.join(equals.format(name, value) for name, value in cells.items()))
        for t, x, y in zip(T_S, X, Y, strict=True)
        for cells in (
            {"t": t, "x": x, "h\u00f6he" if "{{" not in form else "h\\u00f6he": x},
            {"t": t, "y": y},
        )
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    table = read_table(path)
    assert table.columns["h\u00f6he"].values[::2] == pytest.approx(X)
    assert table.columns["y"].values[1::2] == pytest.approx(Y)
    assert np.isnan(table.columns["y"].values[::2]).all()


@pytest.mark.parametrize("mark", ["# ", "%", "#"])
def test_names_in_the_last_comment(mark: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"# 3, 4, 5\n{mark}t,x,y\n{rows(',', '.')}\n")
    assert_same_columns(read_table(path))


def octave(path: Path, arrays: dict[str, Any]) -> None:
    blocks = [
        f"# name: {name}\n# type: matrix\n# rows: {values.size}\n# columns: 1\n"
        + "\n".join(map(str, values.tolist()))
        for name, values in arrays.items()
    ]
    path.write_text("# Created by Octave 8.4.0\n" + "\n\n\n".join(blocks) + "\n")


def records(path: Path, arrays: dict[str, Any]) -> None:
    names = list(arrays)
    path.write_text(
        json.dumps([dict(zip(names, row, strict=True)) for row in zip(*arrays.values(), strict=True)])
    )


ARRAYS: dict[str, tuple[str, Callable[[Path, dict[str, Any]], Any]]] = {
    "npz": ("a.npz", lambda path, arrays: np.savez_compressed(path, **arrays)),
    "npy": ("a.npy", lambda path, arrays: np.save(path, pandas.DataFrame(arrays).to_records(index=False))),
    "Octave": ("a.mat", octave),
    "Octave text": ("a.txt", octave),
    "JSON records": ("a.json", records),
    "JSON columns": (
        "a.json",
        lambda path, arrays: path.write_text(
            json.dumps({name: values.tolist() for name, values in arrays.items()})
        ),
    ),
    "JSON of pandas": ("a.json", lambda path, arrays: pandas.DataFrame(arrays).to_json(path)),
}


@pytest.mark.parametrize("kind", ARRAYS)
def test_named_arrays(kind: str, tmp_path: Path) -> None:
    name, write = ARRAYS[kind]
    write(tmp_path / name, {"t": T_S, "x": X, "y": Y})
    table = read_table(tmp_path / name)
    names = {name.rpartition(".")[2]: name for name in table.columns}
    assert_same_columns(table, names["x"], names["y"])


@pytest.mark.parametrize("names", ["# $ATT,time,x,n", "$ATT,time,x,n", ""])
def test_lines_of_several_kinds_have_blank_cells(names: str, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    lines = [
        line
        for t, x, y in zip(T_S, X, Y, strict=True)
        for line in (f"$ATT,{t:.3f},{x},{5 * t:.3f}", f"$MOT,{t + 0.004:.3f},{y}")
    ]
    path.write_text("\n".join([names, "ready", *lines]) + "\n")
    table = read_table(path)
    x, y = ("x" if names else "$ATT 2"), "$MOT 2"
    columns = {name: column.values[np.isfinite(column.values)] for name, column in table.columns.items()}
    assert columns[x] == pytest.approx(X)
    assert columns[y] == pytest.approx(Y)
    lines = [line for x, y in zip(X, Y, strict=True) for line in (f"$ATT,{x},{y},{x}", f"$MOT,{y},{x},1")]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(
        FlightDataError, match=r"several kinds \(\$ATT, \$MOT\), whose first values are no time"
    ):
        read_table(path)


def test_a_checksum_is_no_part_of_the_last_number(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("\n".join(f"$HELI,{t},{x},{y}*5A" for t, x, y in zip(T_S, X, Y, strict=True)))
    assert_same_columns(read_table(path), "column 3", "column 4")


@pytest.mark.parametrize(
    "clock", ["10:59:{:06.3f}", "2024-03-07T10:59:{:06.3f}Z", "07.03.2024 10:59:{:06.3f}"]
)
def test_rows_with_clock_times_above_a_repeated_header_are_rows(clock: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    body = [f"{clock.format(t)};{x};{y}" for t, x, y in zip(T_S, X, Y, strict=True)]
    path.write_text("\n".join(["t;x;y", ";deg;", *body[:30], "t;x;y", *body[30:]]))
    table = read_table(path)
    assert_same_columns(table)
    assert table.columns["x"].unit == "deg"


def test_units_that_are_few_or_unknown_are_no_names(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    body = [f"{t},{x},{y},{x},7,8,9" for t, x, y in zip(T_S, X, Y, strict=True)]
    path.write_text("\n".join(["t,x,y,z,mode,k,n", "s,gon,gon,gon,,,", *body]))
    table = read_table(path)
    assert_same_columns(table, "x [gon]", "y [gon]")
    assert table.columns["t"].unit == "s"


def test_rows_above_a_repeated_header_are_rows(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    body = rows(",", ".").splitlines()
    path.write_text("\n".join(["t,x,y", *body[:30], "t,x,y", *body[30:]]))
    assert_same_columns(read_table(path))


def test_quoted_decimal_commas_in_a_table_with_commas(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    body = [f'"{line.replace(";", chr(34) + "," + chr(34))}"' for line in rows(";", ",").splitlines()]
    path.write_text("\n".join(['"t","x","y"', *body]))
    assert_same_columns(read_table(path))


def test_cells_with_their_units(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        "\n".join(["t,x,y", *(f"{t} s,{x} deg,{y} V" for t, x, y in zip(T_S, X, Y, strict=True))])
    )
    table = read_table(path)
    assert_same_columns(table)
    assert [column.unit for column in table.columns.values()] == ["s", "deg", "V"]


@pytest.mark.parametrize(
    ("header", "row_of"),
    [
        ("time,signal,value", lambda t_s, name, value: f"{t_s},{name},{value}"),
        # As a database exports it.
        (
            "name,time,field,value",
            lambda t_s, name, value: f"heli,2024-03-07T09:59:{31.0 + t_s:.3f}Z,{name},{value}",
        ),
        # With the limits of the request, and the number of the signal.
        (
            ",table,_start,_time,_value,_field",
            lambda t_s, name, value: (
                f",{ord(name)},2024-03-07T09:00Z,2024-03-07T09:59:{31.0 + t_s:.3f}Z,{value},{name}"
            ),
        ),
    ],
)
def test_one_value_per_row_with_the_name_of_its_signal(
    tmp_path: Path, header: str, row_of: Callable[[float, str, float], str]
) -> None:
    path = tmp_path / "a.csv"
    body = [
        row_of(t, name, v)
        for t, *row in zip(T_S, X, Y, Y, strict=True)
        for name, v in zip("xyz", row, strict=True)
    ]
    path.write_text("\n".join([header, *body]))
    table = read_table(path)
    assert_same_columns(table)
    assert table.columns["x"].t_s == pytest.approx(T_S)
    path.write_text("\n".join([header, *body[::-1]]))
    assert_same_columns(read_table(path))


@pytest.mark.parametrize("form", ["({})", "{}-"])
def test_negative_numbers_of_accountants(form: str, tmp_path: Path) -> None:
    columns = [[f"{v:.4f}" if v >= 0.0 else form.format(f"{-v:.4f}") for v in values] for values in (X, Y)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t,x,y", *map(",".join, zip(T_S.astype(str), *columns, strict=True))]))
    assert_same_columns(read_table(path))


@pytest.mark.parametrize("decimal", [".", ","])
def test_a_column_that_rises_and_trembles_is_no_clock_without_zeros(decimal: str, tmp_path: Path) -> None:
    rising = np.floor(2.0 * T_S) + np.where(np.arange(T_S.size) % 2, 0.5, 0.4)
    path = tmp_path / "a.csv"
    path.write_text(
        "\n".join(["t;x", *(f"{t:.3f};{x:.4g}" for t, x in zip(T_S, rising, strict=True))]).replace(
            ".", decimal
        )
    )
    table = read_table(path)
    assert table.columns["x"].values == pytest.approx(rising) and not table.changes


def test_angles_next_to_a_damaged_cell_are_no_times_without_zeros(tmp_path: Path) -> None:
    cells = ["ERR", *np.where(np.arange(1, T_S.size) % 3, "0.5", "0.20")]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t,pitch", *(f"{t:.3f},{x}" for t, x in zip(T_S, cells, strict=True))]))
    assert not read_table(path).changes


def test_numbers_in_two_notations_are_no_column_of_numbers(tmp_path: Path) -> None:
    # Four hexadecimal digits may look like a number.
    words = [f"{round(100.0 * x) % 65536:04X}" for x in X]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t,x,y", *(f"{t},{x},{y}" for t, x, y in zip(T_S, words, Y, strict=True))]))
    table = read_table(path)
    assert "x" not in table.columns and table.unread["x"] in words


def test_exponents_of_fortran(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    body = [f"{t:.6E} {x:.6E} {y:.6E}".replace("E", "D") for t, x, y in zip(T_S, X, Y, strict=True)]
    path.write_text("\n".join(["t x y", *body]))
    assert_same_columns(read_table(path))


def test_a_header_without_the_name_of_the_row_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    body = [f"{row + 1},{line}" for row, line in enumerate(rows(",", ".").splitlines())]
    path.write_text("t,x,y\n" + "\n".join(body))
    assert_same_columns(read_table(path))


def test_a_header_with_too_few_names_is_refused_with_both_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x\n" + rows(",", "."))
    with pytest.raises(FlightDataError, match=r"names 2 columns \(t, x .*rows have 3 cells"):
        read_table(path)


def test_a_row_with_a_cell_too_many_is_shown_as_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = rows(",", ".").splitlines()
    path.write_text("\n".join(["t,x,y", *lines[:90], *(f"{line},0.5" for line in lines[90:])]) + "\n")
    with pytest.raises(FlightDataError, match=r"rows have 4 cells \(first: row 91: 0.9000,"):
        read_table(path)


def test_decimal_commas_between_commas_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    x = np.column_stack((T_S, X, Y, X, Y))
    body = [",".join(f"{value:.4f}" for value in row).replace(".", ",") for row in x]
    path.write_text("\n".join(["t,a,b,c,d", *body]) + "\n")
    with pytest.raises(FlightDataError, match="two cells for each: commas separate the columns, and are"):
        read_table(path)


def test_a_second_header_with_the_names_in_another_order_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = rows(",", ".").splitlines()
    for second, is_refused in (("t,x,y,z", False), ("t,y,x,z", True)):
        body = [f"{line},1" for line in lines]
        path.write_text("\n".join(["t,x,y,z", *body[:90], second, *body[90:]]) + "\n")
        if is_refused:
            with pytest.raises(FlightDataError, match="columns change their order at row 91"):
                read_table(path)
        else:
            assert len(read_table(path)) == 201


@pytest.mark.parametrize("minus", ["\u2212", "\u2013"])
def test_numbers_with_a_typographic_minus(minus: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(("t,x,y\n" + rows(",", ".")).replace("-", minus), encoding="utf-8")
    assert_same_columns(read_table(path))


def test_a_table_of_a_document_with_a_rule_below_its_header(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    body = "\n".join(f"| {line.replace(',', ' | ')} |" for line in rows(",", ".").splitlines())
    path.write_text(f"| t | x | y |\n|---|:---:|---|\n{body}\n")
    assert_same_columns(read_table(path))


@pytest.mark.parametrize("header", [["t,x,y"], []], ids=["names", "no names"])
def test_decimal_commas_of_a_clock_in_a_table_with_commas(header: list[str], tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    cells = [f"{s.replace('.', ',')},{x},{y}" for s, x, y in zip(STAMPS, X, Y, strict=True)]
    path.write_text("\n".join([*header, *cells]))
    table = read_table(path)
    assert_same_columns(table, *(["x", "y"] if header else ["column 2", "column 3"]))
    assert next(iter(table.columns.values())).values == pytest.approx(T_S)


def test_labels_with_accents_in_a_matlab_file_of_python(tmp_path: Path) -> None:
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    signals = [{"values": v[:, None], "label": name} for name, v in (("Winkel°", X), ("Elevação/deg", Y))]
    savemat(path, {"scope": {"time": T_S[:, None], "signals": signals}})
    assert_same_columns(read_table(path), "Winkel°", "Elevação/deg")


CLOCKS = [
    [f"13:47:{20.0 + t:06.3f}" for t in T_S],
    [f"23:59:{59.0 + t:06.3f}" if t < 1.0 else f"00:00:{t - 1.0:06.3f}" for t in T_S],
    [f"47:{20.0 + t:06.3f}" for t in T_S],
    [f"2024-01-04 12:58:{31.0 + t:06.3f}" for t in T_S],
    [f"2024-01-04T12:58:{31.0 + t:06.3f}Z" for t in T_S],
    [f"04.01.2024 12:58:{31.0 + t:06.3f}" for t in T_S],
]


@pytest.mark.parametrize("clock", CLOCKS, ids=lambda cells: cells[0])
@pytest.mark.parametrize("decimal", [".", ","])
def test_clocks_and_dates_are_times(clock: list[str], decimal: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{at};{x:.4f};{y:.4f}".replace(".", decimal) for at, x, y in zip(clock, X, Y, strict=True)]
    if decimal == "," and clock[0].count("."):
        lines = [line.replace("04,01,2024", "04.01.2024") for line in lines]
    path.write_text("at;x;y\n" + "\n".join(lines))
    table = read_table(path)
    assert_same_columns(table)
    assert table.columns["at"].values == pytest.approx(T_S, abs=1e-6)
    assert table.columns["at"].unit == "s"


def test_words_are_no_times(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x,y,state\n" + rows(",", ".").replace("\n", ",FLY\n") + ",FLY\n")
    table = read_table(path)
    assert_same_columns(table)
    assert "state" not in table.columns


def test_rows_of_zeros_behind_a_flight_are_none_of_it(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x,y\n" + rows(",", ".") + "\n" + "0,0,0\n" * 50)
    assert_same_columns(read_table(path).aligned())


def test_numbers_in_the_header_of_labview_are_no_rows(tmp_path: Path) -> None:
    head = "Writer_Version\t2\nDate\t2024/01/04\n***End_of_Header***\t\n\nSamples\t1\t1\nt\tx\ty\tComment\n"
    path = tmp_path / "a.lvm"
    path.write_text(head + rows("\t", ","))
    assert_same_columns(read_table(path))


def test_names_of_other_scripts_without_utf8(tmp_path: Path) -> None:
    encodings = {"高度角": "gb18030", "Höhe": "latin-1", "Тангаж": "cp1251", "ピッチ角": "shift_jis"}
    for name, encoding in encodings.items():
        path = tmp_path / "a.csv"
        path.write_bytes(f"t,{name},y\n{rows(',', '.')}".encode(encoding))
        assert_same_columns(read_table(path), name)


def test_utf16_as_spreadsheets_save_it(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(("t\tx\ty\n" + rows("\t", ".")).encode("utf-16"))
    assert_same_columns(read_table(path))


@pytest.mark.parametrize(
    ("name", "split"),
    [
        ("y[1]", ("y[1]", "")),
        ("u(1)", ("u(1)", "")),
        ("u [1]", ("u", "duty")),
        ("pitch [deg]", ("pitch", "deg")),
        ("pitch (rad)", ("pitch", "rad")),
        ("travel / deg", ("travel", "deg")),
        ("travel/deg", ("travel", "deg")),
        ("Motor F/mV", ("Motor F", "mV")),
        ("tijd_in_s", ("tijd", "s")),
        ("pitch deg/s", ("pitch deg/s", "")),
        ("/heli/v", ("/heli/v", "")),
        ("elevation_counts", ("elevation", "count")),
        ("t_ms", ("t", "ms")),
        ("t_s", ("t", "s")),
        ("V_s", ("V_s", "")),
        ("front_V", ("front", "V")),
        ("pitch_v", ("pitch_v", "")),
        ("Vinkel °", ("Vinkel", "deg")),
        ("pitch", ("pitch", "")),
    ],
)
def test_units_in_names(name: str, split: tuple[str, str]) -> None:
    assert split_unit(name) == split


@pytest.mark.medium
@pytest.mark.parametrize("lying", [False, True])
def test_a_matrix_of_matlab_in_rows_or_columns(lying: bool, tmp_path: Path) -> None:
    from scipy.io import savemat

    matrix = np.column_stack((T_S, X, Y))
    savemat(tmp_path / "a.mat", {"ans": matrix.T if lying else matrix})
    table = read_table(tmp_path / "a.mat")
    assert_same_columns(table, "ans[2]", "ans[3]")


@pytest.mark.medium
def test_a_recording_of_dspace(tmp_path: Path) -> None:
    from scipy.io import savemat

    signals = np.array(
        [("x", X[None], "deg"), ("y", Y[None], "V")],
        dtype=[("Name", object), ("Data", object), ("Unit", object)],
    )
    savemat(tmp_path / "a.mat", {"rec": {"X": {"Data": T_S}, "Y": signals}})
    table = read_table(tmp_path / "a.mat")
    assert_same_columns(table)
    assert [table.columns[name].unit for name in "xy"] == ["deg", "V"]


@pytest.mark.medium
def test_matrices_with_the_same_times_in_their_first_columns(tmp_path: Path) -> None:
    from scipy.io import savemat

    pairs = {"x": np.column_stack((T_S, X)), "y": np.column_stack((T_S, Y))}
    savemat(tmp_path / "a.mat", pairs)
    table = read_table(tmp_path / "a.mat")
    assert_same_columns(table, "x[2]", "y[2]")
    assert set(table.columns) == {"time", "x[2]", "y[2]"}


@pytest.mark.medium
def test_simulinks_structure_with_time(tmp_path: Path) -> None:
    from scipy.io import savemat

    signals = np.array([(X[:, None], "x"), (Y[:, None], "y")], dtype=[("values", object), ("label", object)])
    savemat(tmp_path / "a.mat", {"log": {"time": T_S[:, None], "signals": signals}})
    table = read_table(tmp_path / "a.mat")
    assert_same_columns(table)
    assert table.columns["x"].t_s == pytest.approx(T_S)
    both = {"values": np.column_stack((X, Y)), "label": "x, y"}
    savemat(tmp_path / "a.mat", {"log": {"time": T_S[:, None], "signals": both}})
    assert_same_columns(read_table(tmp_path / "a.mat"))


def test_a_structure_within_a_structure_that_has_the_times(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"run": {"t": T_S, "meas": {"x": X, "y": Y}, "params": {"Kp": 1.2}}})
    table = read_table(tmp_path / "a.mat")
    assert_same_columns(table, "run.meas.x", "run.meas.y")
    assert table.columns["run.meas.x"].t_s == pytest.approx(T_S)


@pytest.mark.medium
def test_a_time_series_as_its_fields(tmp_path: Path) -> None:
    from scipy.io import savemat

    series = {
        "Name": "x",
        "Data_": X[:, None],
        "TimeInfo": {"Start": 0.0, "Increment": 0.01, "Length": 200.0},
    }
    savemat(tmp_path / "a.mat", {"x": series})
    column = read_table(tmp_path / "a.mat").columns["x"]
    assert column.values == pytest.approx(X)
    assert column.t_s == pytest.approx(T_S)


@pytest.mark.medium
def test_matlab_7_3(tmp_path: Path) -> None:
    import matio

    matio.save_to_mat(str(tmp_path / "a.mat"), {"t": T_S, "x": X, "y": Y}, version="v7.3")
    assert_same_columns(read_table(tmp_path / "a.mat"))


@pytest.mark.medium
def test_an_index_without_a_name_is_a_column(tmp_path: Path) -> None:
    import pandas

    pandas.DataFrame({"x": X, "y": Y}, index=T_S).to_parquet(tmp_path / "a.parquet")
    table = read_table(tmp_path / "a.parquet")
    assert_same_columns(table)
    assert table.columns["index"].values == pytest.approx(T_S)


@pytest.mark.parametrize("suffix", ["parquet", "xlsx"])
def test_parquet_and_excel(suffix: str, tmp_path: Path) -> None:
    import pandas

    frame = pandas.DataFrame({"t": T_S, "x": X, "y": Y})
    path = tmp_path / f"a.{suffix}"
    if suffix == "parquet":
        frame.to_parquet(path)
    else:
        frame.to_excel(path, index=False)
    assert_same_columns(read_table(path))


@pytest.mark.medium
@pytest.mark.parametrize("cell", ["{:.1f} ms", "{:.4f}"])
def test_a_sheet_with_numbers_as_texts(cell: str, tmp_path: Path) -> None:
    scale = 1e3 if "ms" in cell else 1.0
    texts = {"t": [cell.format(scale * t) for t in T_S], "x": [f"{x}".replace(".", ",") for x in X], "y": Y}
    pandas.DataFrame(texts).to_excel(tmp_path / "a.xlsx", index=False)
    table = read_table(tmp_path / "a.xlsx")
    assert_same_columns(table)
    assert table.columns["t"].values == pytest.approx(scale * T_S)
    assert table.columns["t"].unit == ("ms" if "ms" in cell else "")


@pytest.mark.parametrize("suffix", ["parquet", "xlsx"])
def test_a_slower_signal_with_blank_cells_is_a_column(suffix: str, tmp_path: Path) -> None:
    import pandas

    slow = np.where(np.arange(X.size) % 5 == 2, X, np.nan)
    words = [None if number % 5 else "ready" for number in range(X.size)]
    frame = pandas.DataFrame({"t": T_S, "slow": slow, "words": words, "blank": np.nan * X})
    path = tmp_path / f"a.{suffix}"
    if suffix == "parquet":
        frame.to_parquet(path)
    else:
        frame.to_excel(path, index=False)
    table = read_table(path)
    np.testing.assert_allclose(table.columns["slow"].values, slow)
    assert set(table.columns) == {"t", "slow"} and dict(table.unread) == {"words": "ready"}


@pytest.mark.parametrize(
    ("separator", "decimal", "mark"), [("\t", ",", ","), (";", ".", "."), (";", ".", ",")]
)
def test_a_mark_that_repeats_separates_thousands(
    separator: str, decimal: str, mark: str, tmp_path: Path
) -> None:
    times_ms = [998_970 + 10 * number for number in range(len(X))]
    lines = [
        separator.join((f"{time:,}".replace(",", mark), f"{x:.4f}".replace(".", decimal)))
        for time, x in zip(times_ms, X, strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    table = read_table(tmp_path / "a.csv")
    assert table.columns["column 1"].values == pytest.approx(times_ms)
    assert table.columns["column 2"].values == pytest.approx(X)


@pytest.mark.medium
@pytest.mark.parametrize(
    "above", [[], [["Measurement 7"], ["Sample time", 0.01], []]], ids=["plain", "titles"]
)
@pytest.mark.parametrize("sheets_before", [0, 1])
def test_a_table_below_titles_or_on_the_second_sheet(
    above: list[list[object]], sheets_before: int, tmp_path: Path
) -> None:
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    for _ in range(sheets_before):
        book.create_sheet("Info").append(["Rig", 3, "Date", "2024-03-01"])
    sheet = book.create_sheet("Data")
    for row in [*above, ["t", "x", "y"], *np.column_stack((T_S, X, Y)).tolist()]:
        sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    table = read_table(tmp_path / "a.xlsx")
    assert_same_columns(table)
    assert list(table.columns) == ["t", "x", "y"]


@pytest.mark.medium
@pytest.mark.parametrize(("units", "times"), [("seconds", T_S), ("milliseconds", T_S * 1e3)])
def test_time_series_of_simulink_in_its_default_format(units: str, times: Any, tmp_path: Path) -> None:
    from matio import save_to_mat
    from matio.utils.matclass import MatlabOpaque

    nothing = np.zeros((0, 0))
    inner = {"Units": units, "Increment": nothing, "Time_": times[:, None]}

    def series(values: Any) -> Any:
        storage = MatlabOpaque({"Data": values[:, None]}, "timeseries.storage")
        properties = {
            "Data_": nothing,
            "Time_": nothing,
            "TimeInfo": MatlabOpaque(inner, "tsdata.timemetadata"),
            "Storage_": storage,
        }
        return MatlabOpaque(properties, "timeseries")

    save_to_mat(str(tmp_path / "a.mat"), {"x": series(X), "y": series(Y)})
    table = read_table(tmp_path / "a.mat")
    assert_same_columns(table)
    assert table.columns["x"].t_s == pytest.approx(T_S)


@pytest.mark.medium
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_bags_of_ros_2(storage: str, tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    made: Any = store.types["std_msgs/msg/Float64MultiArray"]
    layout: Any = store.types["std_msgs/msg/MultiArrayLayout"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        connection = writer.add_connection("/heli", made.__msgtype__, typestore=store)
        for t_s, x, y in zip(T_S, X, Y, strict=True):
            message = made(layout(dim=[], data_offset=0), np.array([x, y]))
            writer.write(connection, round(t_s * 1e9), store.serialize_cdr(message, made.__msgtype__))
    table = read_table(tmp_path / "bag")
    assert_same_columns(table, "heli.data[0]", "heli.data[1]")
    assert table.columns["heli.data[0]"].t_s == pytest.approx(T_S)
    (file,) = (tmp_path / "bag").glob("*.mcap" if storage == "mcap" else "*.db3")
    assert_same_columns(read_table(file), "heli.data[0]", "heli.data[1]")


@pytest.mark.medium
@pytest.mark.parametrize(
    "suffix", ["mat", "npy", "npz", "json", "parquet", "xlsx", "mcap", "csv", "docx", "db3", "bag"]
)
@pytest.mark.parametrize("content", [b"", b"\x00\x01\x02" * 99, b"hello\nworld\n"])
def test_a_file_of_anything_is_refused_in_a_line(suffix: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content)
    with pytest.raises(FlightDataError) as refused:
        read_table(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.medium
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lines=st.lists(st.text(alphabet='t,;x1.5-e \t#"°\n', max_size=12), max_size=12))
def test_any_text_is_a_table_or_one_refusal(lines: list[str], tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(lines))
    try:
        table = read_table(tmp_path / "a.csv")
    except FlightDataError as error:
        assert "\n" not in str(error)
    else:
        assert table.columns
