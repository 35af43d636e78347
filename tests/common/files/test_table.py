import math
import re
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from kneexo.common.files.table import read_table
from kneexo.errors import ScenarioError


def test_columns_are_read_by_name(write):
    path = write('# measured\n\n b , "a",note\r\n1,2,"x,y"\n#,,,\n\n3e1, -.5 ,"two\n# lines"\n')
    columns = read_table(path, ("a", "b"))
    assert columns.columns == {"a": [2.0, -0.5], "b": [1.0, 30.0]}
    assert columns.lines == [4, 7]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_are_counted_after_a_quoted_newline(write, fault, end):
    rows = ["t,note", f'0,"a{end}b{end}#c{end}{end}d"', "", "x,y"]
    assert fault(read_table, write(end.join(rows)), ("t",)).startswith("table.csv:8: t: 'x'; must")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "table.csv: is empty"),
        ("# t\n\n", "table.csv: is empty"),
        ("a,b\n", "table.csv: has no column 't'; it has a, b"),
        ("Time (s), a (deg)\n", "table.csv: has no column 't'; it has Time (s), a (deg)"),
        ("1,2\n", "table.csv:1: has numbers; must have the names of the columns"),
        (
            "t;a\n1,5;0\n2;1\n3.5;1\n",
            "table.csv:4: t: '3.5'; must be a finite number in the "
            "digits 0-9; write no points in a file with decimal commas such as 1,5",
        ),
        ("t a\n0 1\n\n 0 \n", "table.csv:4: has 1 values; must have 2, one of each column"),
        ("t,a,t\n0,1,2\n", "table.csv: has 2 columns 't'; must have one column of this name"),
        ("t,a\n0,1\n\n0,1,5\n", "table.csv:4: has 3 values; must have 2, one of each column"),
        ('t\n0\n"1\n2\n', "table.csv:3: a quotation mark opens a field that does not end"),
        ('t,a\n0,"' + "x" * 140_000, "table.csv:2: a field has more than 131072 characters"),
        ('t,a\n0,"1"2\n', "table.csv:2: ',' expected after '\"'; must be a record of CSV"),
        *(
            (f"t\n0\n{number}\n", f"table.csv:3: t: {number!a}; must be a finite number".rstrip())
            for number in ("1_0", "nan", "inf", "1e999", "0x1", "1 0")
        ),
        ("t,a\n٣,1\n", "table.csv:2: t: '٣'; must be a finite number in the digits 0-9"),
        ("a,t\n1\n", "table.csv:2: t: no value; must be"),
        (f"{'t' * 9000}\n", "table.csv: has no column 't'; it has tttt"),
        (f"t\n{'x' * 9000}\n", "table.csv:2: t: 'xxx"),
    ],
)
def test_the_error_of_a_damaged_table_is_one_short_line(write, fault, content, message):
    line = fault(read_table, write(content), ("t",))
    assert line.startswith(message)
    assert len(line) < 500


DIALECTS = {
    "commas": (",", "."),
    "semicolons": (";", "."),
    "semicolons and decimal commas": (";", ","),
    "tabs": ("\t", "."),
    "tabs and decimal commas": ("\t", ","),
    "bars": ("|", "."),
    "bars and decimal commas": ("|", ","),
    "spaces": (" ", "."),
    "spaces and decimal commas": (" ", ","),
}
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
ROWS = st.lists(st.tuples(NUMBERS, NUMBERS), max_size=8)


@pytest.mark.parametrize("dialect", DIALECTS)
@settings(max_examples=15)
@given(
    rows=ROWS,
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    quote=st.sampled_from(["", '"']),
    head=st.sampled_from(["", "\ufeff", "# 1,5\n", "% 1.5\n\n", "sep=;\n"]),
)
def test_numbers_arrive_in_bits(tmp_path_factory, dialect, rows, end, quote, head):
    separator, decimal = DIALECTS[dialect]
    lines = [["a", "t"], *([repr(value).replace(".", decimal) for value in row] for row in rows)]
    text = "".join(separator.join(f"{quote}{c}{quote}" for c in line) + end for line in lines)
    assert read_back(tmp_path_factory, head + text, "t") == in_bits(rows)


@settings(max_examples=15)
@given(rows=ROWS, end=st.sampled_from(["\n", "\r\n"]), separator=st.sampled_from(["\t", "  "]))
def test_numbers_of_opensim_arrive_in_bits(tmp_path_factory, rows, end, separator):
    lines = [["a", "time"], *(map(repr, row) for row in rows)]
    text = "".join(separator.join(line) + end for line in lines)
    text = f"x, y{end}inDegrees=no{end}endheader{end}{text}"
    assert read_back(tmp_path_factory, text, "time_s") == in_bits(rows)


WHOLE = '# λ\n\nt,a,note\n0,1,x\n0.5,-2.5e3,"two\nlines"\n\n1,.5,\n2,3,# y\n'
ODD = (";", "\t", "|", "'", "\x00", "\u2028", "\ufeff", "٣", "nan", "1e999", "1,5", "1_0")
WORDS = sorted({*re.split(r"(\W)", WHOLE), *ODD})


@st.composite
def damaged(draw):
    """A table with some parts exchanged."""
    text = WHOLE
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        text = text[:start] + draw(st.sampled_from(WORDS)) + text[start + draw(st.integers(0, 9)) :]
    return text.encode()


@settings(max_examples=60)
@given(content=damaged() | st.binary(max_size=30))
def test_any_file_is_a_table_of_finite_numbers_or_one_short_line(tmp_path_factory, content):
    path = Path(tmp_path_factory.getbasetemp(), "damaged.csv")
    path.write_bytes(content)
    line = ""
    try:
        columns = read_table(path, ("t", "a")).columns
        assert all(math.isfinite(value) for column in columns.values() for value in column)
    except ScenarioError as error:
        line = str(error)
    assert line.isprintable()
    assert len(line) < 500


def read_back(tmp_path_factory, text, time):
    path = Path(tmp_path_factory.getbasetemp(), "table.csv")
    path.write_bytes(text.encode())
    columns = read_table(path, (time, "a")).columns
    return in_bits(zip(columns["a"], columns[time], strict=True))


def in_bits(rows):
    return [struct.pack("<dd", *row) for row in rows]


@pytest.mark.parametrize(
    ("content", "columns"),
    [
        ('t;"a, b, c"\n1;2\n', {"t": [1.0], "a, b, c": [2.0]}),
        ('"a;b|c",t\n2,1\n', {"t": [1.0], "a;b|c": [2.0]}),
        ("t\ta, b, c\n1\t2\n", {"t": [1.0], "a, b, c": [2.0]}),
        ("t|a;b\n1|2\n", {"t": [1.0], "a;b": [2.0]}),
        ("x;t;note\n1.5;2;1,2 and more\n", {"t": [2.0], "x": [1.5]}),
    ],
)
def test_the_columns_sought_tell_the_separator(write, content, columns):
    assert read_table(write(content), tuple(columns)).columns == columns


def test_angles_are_in_degrees(write, fault):
    text = "{}\nendheader\ntime\ta\n0\t1\n"
    for unit, degrees in (("inDegrees=no", math.degrees(1.0)), ("inDegrees=yes", 1.0)):
        assert read_table(write(text.format(unit)), ("a",)).degrees("a") == [degrees]
    assert read_table(write("a\n1\n"), ("a",)).degrees("a") == [1.0]
    for unit in ("", "inDegrees=maybe", "# inDegrees=no"):
        message = fault(read_table(write(text.format(unit)), ("a",)).degrees, "a")
        assert message.startswith("table.csv: lacks the unit of angles; add inDegrees=yes or")


def test_blank_fields_after_the_last_column_are_ignored(write):
    assert read_table(write("t,a\n0,1,, \n"), ("t",)).columns == {"t": [0.0]}


def test_a_value_outside_the_limits_of_its_column_is_an_error_with_its_line(write, fault):
    columns = read_table(write("t\n0\n\n1\n0.5\n"), ("t",))
    columns.require("t", 0.0, 1.0, "s")
    message = "table.csv:4: t = 1 s is out of range: must be >= 0 and <= 0.9 s"
    assert fault(columns.require, "t", 0.0, 0.9, "s") == message
    message = "table.csv:5: t = 0.5 s after 1 s: must increase by at least 0.1 s from row to row"
    assert fault(columns.require_increase, "t", 0.1, "s") == message
