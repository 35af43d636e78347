"""References from files as other programs write them: the same numbers, or a line with the remedy.

Excel in three locales, MATLAB, OpenSim, pandas, NumPy and a logger. Nothing here is written by the
code that reads.
"""

from dataclasses import dataclass, field
from io import StringIO

import numpy as np
import pandas as pd
import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import CsvReference

TIMES = [0.0, 0.5, 1.25, 2.0, 1000.5]
ANGLES = [5.0, 12.5, 61.0625, 30.0, 5.125]
NAMES = ["time_s", "knee_angle_deg"]
ROWS = list(zip(TIMES, ANGLES, strict=True))


@dataclass
class File:
    """A file, the entries that read it, and its samples or words of the message."""

    data: str | bytes
    entries: dict[str, object] = field(default_factory=dict)
    times: list[float] = field(default_factory=lambda: TIMES)
    angles: list[float] = field(default_factory=lambda: ANGLES)
    rounding: float = 0.0
    """Relative error of the samples, where radians or percent are multiplied."""
    message: str = ""
    """What the message says, if the file is refused."""


FILES: dict[str, File] = {}

# ---------------------------------------------------------------------------------- Excel

LOCALES = {"en": (",", ".", ","), "de": (";", ",", "."), "fr": (";", ",", "\u202f")}
"""Separator of a list, decimal sign and sign for thousands."""


def excel(separator, decimal, rows=ROWS, names=NAMES):
    lines = [names, *([f"{value:.15g}".replace(".", decimal) for value in row] for row in rows)]
    return "".join(separator.join(line) + "\r\n" for line in lines)


def quoted(text, separator):
    rows = [line.split(separator) for line in text.splitlines()]
    return "".join(separator.join(f'"{cell}"' for cell in row) + "\r\n" for row in rows)


def replaced(text, line, old, new):
    lines = text.splitlines(keepends=True)
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new)
    return "".join(lines)


for locale, (separator, decimal, thousands) in LOCALES.items():
    text = excel(separator, decimal)
    exact = excel("\t", decimal)
    wide = excel(separator, decimal, [(*row, 1.5) for row in ROWS], [*NAMES, "Moment"])
    long = f"1{thousands}000{decimal}5"
    long = f'"{long}"' if thousands == separator else long
    FILES |= {
        f"Excel {locale}: {name}": file
        for name, file in {
            "CSV": File(text),
            "CSV UTF-8": File("\ufeff" + text),
            "text with tabs": File(exact),
            "CSV of a Mac": File(text.replace("\r\n", "\r")),
            "an empty column": File(text.replace("\r\n", f"{separator}\r\n")),
            "empty rows": File(text + f"{separator}\r\n" * 2),
            "sep= for other locales": File(f"sep={separator}\r\n{text}"),
            "quoted": File(quoted(text, separator)),
            "one more column": File(wide),
            "a comma in a name": File(
                excel(separator, decimal, names=['"time, s"', '"knee, deg"']),
                {"time": "time, s", "angle": "knee, deg"},
            ),
            "exponents": File(replaced(text, 3, f"0{decimal}5", f"5{decimal}0E-01")),
            "bars": File(excel("|", decimal)),
            "thousands": File(
                replaced(text, 6, f"1000{decimal}5", long),
                message=f":6: time_s: {long.strip(chr(34))!a}; must be a finite number",
            ),
            "Unicode text": File(
                exact.encode("utf-16"), message=":1: is not UTF-8: byte 0xff; save"
            ),
            "units": File(
                replaced(text, 1, "\r\n", f"\r\ns{separator}deg\r\n"),
                message=":2: time_s: 's'; must be a finite number in the digits 0-9; delete or",
            ),
            "a missing value": File(
                replaced(text, 4, f"1{decimal}25", ""),
                message=":4: time_s: no value; must be a finite number in the digits 0-9; delete",
            ),
            "times of day": File(
                replaced(text, 3, f"0{decimal}5", f"00:00:00{decimal}5"),
                message=f":3: time_s: '00:00:00{decimal}5'; must be a finite number in the digits "
                f"0-9; write a time in seconds",
            ),
            "no names": File(
                text.partition("\r\n")[2],
                message=":1: has numbers; must have the names of the columns",
            ),
        }.items()
    }
GERMAN = excel(";", ",")
FILES |= {
    "Excel de: a name in ANSI": File(
        excel(";", ",", names=["time_s", "Winkel in °"]).encode("cp1252"),
        {"angle": "Winkel in °"},
        message=":1: is not UTF-8: byte 0xb0; save it as UTF-8",
    ),
    "Excel de: 12.500 among decimal commas": File(
        replaced(GERMAN, 3, "12,5", "12.500"),
        message=":3: knee_angle_deg: '12.500'; must be a finite number in the digits 0-9; write no "
        "points in a file with decimal commas such as 0,5",
    ),
    "Excel de: whole numbers and commas in another column": File(
        "time_s;knee_angle_deg;F\r\n0;12.500;1,5\r\n1;12.501;2\r\n2;13;2\r\n",
        message=":2: knee_angle_deg: '12.500'; must be a finite number in the digits 0-9; write no "
        "points in a file with decimal commas such as 1,5",
    ),
    "Excel de: whole numbers and a point for thousands in another column": File(
        "time_s;knee_angle_deg;F\r\n0;12.500;-1.234,5\r\n1;12.501;2\r\n2;13;2\r\n",
        message=":2: knee_angle_deg: '12.500'; must be a finite number in the digits 0-9; write no "
        "points in a file with decimal commas such as -1.234,5",
    ),
    "Excel de: points for decimals": File(excel(";", ".")),
    "Excel de: no decimals": File(
        "time_s;knee_angle_deg\r\n0;5\r\n1;60\r\n2;5\r\n", times=[0, 1, 2], angles=[5, 60, 5]
    ),
    "decimal commas between commas": File(
        excel(",", ","),
        message=":3: has 4 values; must have 2, one of each column; separate them by semicolons",
    ),
}

# ------------------------------------------------------------------- MATLAB, NumPy, logger


def plain(separator, names=NAMES, rows=ROWS, end="\n"):
    lines = [names, *([repr(value) for value in row] for row in rows)]
    return "".join(separator.join(line) + end for line in lines)


def savetxt(**options):
    stream = StringIO()
    np.savetxt(stream, ROWS, **options)
    return stream.getvalue()


BEFORE = [(-2.0, 40.0), (-1.0, 35.5)]
FILES |= {
    "MATLAB writetable": File(plain(",")),
    "MATLAB writetable, tabs": File(plain("\t")),
    "MATLAB writetable, semicolons": File(plain(";")),
    "MATLAB writetable, bars": File(plain("|")),
    "MATLAB writetable, spaces": File(plain(" ")),
    "MATLAB fprintf": File(
        "% gait, trial 3\n%\n"
        + "".join(f"{a:>16} {b:>16} \n" for a, b in [NAMES, *ROWS])
        + "% end; 0,5\n"
    ),
    "MATLAB NaN": File(
        replaced(plain(","), 3, "12.5", "NaN"),
        message=":3: knee_angle_deg: 'NaN'; must be a finite number in the digits 0-9; delete or "
        "fill the rows of units and of missing values",
    ),
    "MATLAB writematrix": File(
        plain(",").partition("\n")[2],
        message=":1: has numbers; must have the names of the columns, without # or %",
    ),
    "MATLAB, names in a comment": File(
        "% " + plain(","), message=":2: has numbers; must have the names of the columns, without # "
    ),
    "spaces, a value missing": File(
        replaced(plain(" "), 4, "1.25 ", ""),
        message=":4: has 1 values; must have 2, one of each column",
    ),
    "NumPy": File(savetxt(header=" ".join(NAMES), comments="")),
    "NumPy, commas": File(savetxt(header=",".join(NAMES), comments="", delimiter=",")),
    "NumPy, names in a comment": File(
        savetxt(header=" ".join(NAMES)), message=":2: has numbers; must have the names of the "
    ),
    "logger": File("# device 7\n# rate;100 Hz\n\n" + plain(";", end="\r\n") + "# stop\n"),
    "logger, trigger at 0 s": File(
        plain("\t", rows=BEFORE + ROWS), times=[-2.0, -1.0, *TIMES], angles=[40.0, 35.5, *ANGLES]
    ),
    "logger, all before the trigger": File(
        plain(",", rows=[(-3.0, 20.0), *BEFORE]),
        message=": times_s ends at -1 s: must end at >= 0.001 s, because a run starts at 0 s; "
        "subtract the first time, -3 s, from all times",
    ),
    "logger, dates": File(
        plain(",").replace("0.5,", "2026-01-05T10:00:00.5,"),
        message=":3: time_s: '2026-01-05T10:00:00.5'; must be a finite number in the digits 0-9; "
        "write a time in seconds",
    ),
    "logger, units in each value": File(
        plain(",").replace("12.5", "12.5°"),
        message=":3: knee_angle_deg: '12.5°'; must be a finite number in the digits 0-9; write no "
        "unit and no sign for thousands",
    ),
}

# --------------------------------------------------------------------------------- pandas

FRAME = pd.DataFrame({"time_s": TIMES, "knee_angle_deg": ANGLES, "side": "left, right"})
FILES |= {
    f"pandas {options}": File(FRAME.to_csv(**options))
    for options in (
        {},
        {"index": False},
        {"index": False, "sep": ";"},
        {"index": False, "sep": ";", "decimal": ","},
        {"sep": "\t", "decimal": ","},
        {"sep": "|"},
        {"sep": "|", "decimal": ",", "lineterminator": "\r\n"},
        {"quoting": 1},
        {"quoting": 1, "sep": ";", "decimal": ","},
        {"float_format": "%.6e"},
    )
}
FILES |= {
    "pandas, time as index": File(FRAME.set_index("time_s").to_csv(sep=";", decimal=",")),
    "pandas, decimal commas in quotes": File(
        FRAME.to_csv(index=False, decimal=","), message=":2: time_s: '0,0'; must be a finite number"
    ),
    "pandas, names left out": File(
        FRAME[NAMES].to_csv(index=False, header=False), message=":1: has numbers; must have the"
    ),
    "pandas, an empty cell": File(
        FRAME.mask(FRAME == 12.5).to_csv(), message=":3: knee_angle_deg: no value; must be"
    ),
}

# -------------------------------------------------------------------------------- OpenSim

COORDINATES = {"angle": "knee_angle_r"}


def opensim(
    unit="inDegrees=yes\n", times=TIMES, angles=ANGLES, sign=1.0, cell="{:16.8f}", end="\n"
):
    scale = sign * (np.pi / 180.0 if "no" in unit.lower() else 1.0)
    names = ["time", "pelvis_tilt", "pelvis_tx", "knee_angle_r", "knee_angle_l"]
    rows = [(t, 0.1, 0.9, scale * a, 7.0) for t, a in zip(times, angles, strict=True)]
    lines = ["Coordinates", "version=1", f"nRows={len(rows)}", "nColumns=5"]
    lines += [*unit.splitlines(), "", "Units are S.I. units (second, meters, Newtons, ...)", ""]
    lines += ["endheader", "\t".join(names)]
    lines += ["\t".join(map(cell.format, row)) for row in rows]
    return "".join(line + end for line in lines)


PERCENT = [0.0, 25.0, 50.0, 62.5, 100.0]
SECONDS = [0.0, 0.3, 0.6, 0.75, 1.2]
CYCLE = {"period_s": 1.2, **COORDINATES}
TWICE = {
    "times": [*SECONDS, 1.5, 1.8, 1.95, 2.4],
    "angles": [*ANGLES, *ANGLES[1:]],
    "rounding": 1e-14,
}
head, _, rows = opensim(unit="inDegrees=yes\n", cell="{!r}").partition("endheader\n")
opensim_of_excel = head.replace("\n", ",,,,\n") + "endheader,,,,\n" + rows.replace("\t", ",")
SIMM = "name ik.mot\ndatacolumns 5\ndatarows 5\nrange 0 2\n"
FILES |= {
    "OpenSim": File(opensim(), COORDINATES),
    "OpenSim, time named": File(opensim(), COORDINATES | {"time": "time"}),
    "OpenSim, Windows": File(opensim(end="\r\n"), COORDINATES),
    "OpenSim, IMU": File(opensim("inDegrees=yes\nOpenSimVersion=4.5\n", end=" \n"), COORDINATES),
    "OpenSim, full precision": File(opensim(cell="{!r}"), COORDINATES),
    "OpenSim, spaces": File(opensim().replace("\t", "  "), COORDINATES),
    "OpenSim, names in tabs": File(opensim(cell=" {!r} ").replace("\t ", "  "), COORDINATES),
    "OpenSim, radians": File(opensim("inDegrees=no\n", cell="{!r}"), COORDINATES, rounding=1e-14),
    "OpenSim, spaces in the header": File(
        opensim("inDegrees = No\n", cell="{!r}"), COORDINATES, rounding=1e-14
    ),
    "OpenSim, SIMM": File(opensim(SIMM + "inDegrees=yes\n"), COORDINATES),
    "OpenSim, gait2392": File(opensim(sign=-1.0), COORDINATES | {"flexion": "negative"}),
    "OpenSim, gait2392 in radians": File(
        opensim("inDegrees=no\n", sign=-1.0, cell="{!r}"),
        COORDINATES | {"flexion": "negative"},
        rounding=1e-14,
    ),
    "OpenSim, some hyperextension": File(
        opensim(angles=[-8.5, *ANGLES[1:]]), COORDINATES, angles=[-8.5, *ANGLES[1:]]
    ),
    "OpenSim, percent": File(opensim(times=PERCENT), CYCLE, times=SECONDS, rounding=1e-14),
    "OpenSim, percent in radians": File(
        opensim("inDegrees=no\n", times=PERCENT, cell="{!r}"), CYCLE, times=SECONDS, rounding=1e-14
    ),
    "OpenSim, two cycles in percent": File(opensim(times=PERCENT), CYCLE | {"cycles": 2}, **TWICE),
    "OpenSim, two cycles in seconds": File(
        opensim(times=SECONDS), COORDINATES | {"cycles": 2}, **TWICE
    ),
    "two cycles in percent": File(
        excel(";", ",", zip(PERCENT, ANGLES, strict=True), ["percent", "knee_angle_deg"]),
        {"time": "percent", "period_s": 1.2, "cycles": 2},
        **TWICE,
    ),
    "OpenSim, gait2392, flexion left out": File(
        opensim(sign=-1.0),
        COORDINATES,
        message=": knee_angle_r = -61.06 … -5 deg: flexion must be positive; set flexion: negative",
    ),
    "OpenSim, flexion positive but called negative": File(
        opensim(),
        COORDINATES | {"flexion": "negative"},
        message=": knee_angle_r = -61.06 … -5 deg: flexion must be positive; set flexion: positive",
    ),
    "OpenSim, angle not named": File(
        opensim(),
        message=": has no column 'knee_angle_deg'; it has knee_angle_r, knee_angle_l, time, "
        "pelvis_tilt, pelvis_tx; give its names as time: and angle:",
    ),
    "OpenSim, no unit": File(
        opensim(SIMM),
        COORDINATES,
        message=": lacks the unit of angles; add inDegrees=yes or inDegrees=no above endheader",
    ),
    "OpenSim, nan": File(
        replaced(opensim(), 12, "12.50000000", "nan"),
        COORDINATES,
        message=":12: knee_angle_r: 'nan'; must be a finite number in the digits 0-9; delete or",
    ),
    "OpenSim, a value missing": File(
        replaced(opensim(cell="{!r}"), 12, "\t0.1\t", "\t\t"),
        COORDINATES,
        message=":12: has 4 values; must have 5, one of each column",
    ),
    "OpenSim, the last row twice": File(opensim() + opensim().splitlines()[-1], COORDINATES),
    "OpenSim, one time with two angles": File(
        opensim(times=[*TIMES, TIMES[-1]], angles=[*ANGLES, 6.0]),
        COORDINATES,
        message=":16: time_s = 1000.5 s after 1000.5 s: must increase by at least 1e-06 s from row",
    ),
    "OpenSim, saved by Excel": File(opensim_of_excel, COORDINATES),
    "OpenSim, saved by Excel of a Mac": File(opensim_of_excel.replace("\n", "\r"), COORDINATES),
    "OpenSim, saved by Excel de": File(opensim_of_excel.replace(",", ";"), COORDINATES),
    "OpenSim, a trial within a recording": File(
        opensim(times=[12.3, 12.32, 12.36, 12.4, 14.3]),
        COORDINATES,
        times=[0.0, 0.02, 0.06, 0.1, 2.0],
    ),
    "OpenSim, time of the run": File(
        opensim(times=[12.3, 12.5, 13.0, 14.0, 14.25]),
        COORDINATES | {"shift_s": 12.0},
        times=[0.3, 0.5, 1.0, 2.0, 2.25],
    ),
    "OpenSim, deg under inDegrees=no": File(
        opensim().replace("inDegrees=yes", "inDegrees=no"),
        COORDINATES,
        message=": knee_angle_r reaches 61.06 rad by the flag inDegrees=no: must be <= 6.28 rad; "
        "write inDegrees=yes if it is in deg, 57.3 times as large",
    ),
    "logger, ms since 1970": File(
        plain(",", rows=[(1.7e12 + 20.0 * n, 5.0 + n) for n in range(5)]),
        message=":2: time_s = 1.7e+12 s is out of range: must be >= -100000 and <= 100000 s; "
        "divide all times by 1000 if they are in ms",
    ),
    "percent as a share": File(
        plain(",", rows=[(0.0, 5.0), (0.5, 60.0), (1.0, 5.0)]),
        {"period_s": 1.2},
        message=": time_s = 0 … 1 %: must run from 0 to 100 %; leave period_s out if it is in s",
    ),
    "cycles of a curve that does not close": File(
        plain(",", rows=[(0.0, 5.0), (0.5, 60.0), (1.0, 9.5)]),
        {"cycles": 2},
        message=": knee_angle_deg ends 4.5 deg from its first row: must be <= 2 deg, or each cycle "
        "jumps; subtract a straight line",
    ),
}


FILES |= {
    f"OpenSim, {what}": File(
        opensim().replace("Coordinates", what),
        COORDINATES,
        message=f":1: is a file of {what}; must be of Coordinates (_Kinematics_q.sto)",
    )
    for what in ("Speeds", "Accelerations", "PositionErrors", "controls", "ActuatorForces")
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_gives_its_numbers_or_a_line_with_the_remedy(tmp_path, name) -> None:
    file = FILES[name]
    data = file.data if isinstance(file.data, bytes) else file.data.encode()
    (tmp_path / "gait.txt").write_bytes(data)
    reference = CsvReference(file="gait.txt", **file.entries)
    if file.message:
        with pytest.raises(ParameterError) as caught:
            reference.samples(tmp_path)
        line = str(caught.value).removeprefix(f"{tmp_path}/")
        assert line.isprintable()
        assert line.startswith(f"gait.txt{file.message}")
        return
    samples = reference.samples(tmp_path)
    assert samples.times_s == pytest.approx(file.times, rel=file.rounding, abs=0.0)
    assert samples.angles_deg == pytest.approx(file.angles, rel=file.rounding, abs=0.0)
