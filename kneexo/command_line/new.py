"""The command ``new``, which writes a scenario file with comments, and its reference."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from diagramc import write_files
from kneexo.command_line import arguments
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request
from kneexo.errors import OutputError, ParameterError, shown
from kneexo.version import __version__

if TYPE_CHECKING:
    from kneexo.parameters import Scenario

PRESET = "leg"
"""The new file starts from this preset, which models the most effects."""

_INTERVALS = 100  # number of equal time intervals between the samples of the reference

_PID_GAINS = ("proportional_per_s", "integral_per_s2", "derivative")

_JOINT_A, _JOINT_B = "joint O_A of ground and link 2", "joint O_B of ground and link 4"
_MEANINGS = {
    "o_a_x_m": f"{_JOINT_A}: x from the knee's axis",
    "o_a_y_m": f"{_JOINT_A}: y to the hip",
    "o_b_x_m": f"{_JOINT_B}: x from the knee's axis",
    "o_b_y_m": f"{_JOINT_B}: y to the hip",
    "a_2_m": "link 2 from O_A to joint A",
    "a_3_m": "coupler from joint A to joint B",
    "a_4_m": "link 4 from O_B to joint B (the encoder measures its angle)",
    "phi_rad": "knee angle minus angle of the coupler",
    "rod_pin_radius_m": "from joint B to the pin of the rod",
    "rod_pin_angle_rad": "direction of this line from the coupler",
    "rod_anchor_radius_m": "from the knee's axis to the pin of the cylinder",
    "rod_anchor_angle_rad": "direction of this line from x",
    "rod_length_m": "from pin to pin when the rod is in",
    "branch": "sign of sin(θ_4 − θ_2)",
}
"""Meaning of each value of the linkage, whose provenance is the same for all."""

_PLACES = {
    "plant.cylinder": ("bore_m", "rod_diameter_m", "stroke_m", "total_volume_m3", "mass_kg"),
    "plant.load": ("segment_mass_kg", "centre_of_mass_m"),
    "controller": ("lambda_per_s", "phi_m_s2", "eta_m_s3"),
}
"""Dictionary from a section of the file to the names of its values.

`_MEANINGS` has the values of the section ``plant.linkage``.
"""


def add_new(subparsers: Any) -> None:
    """Add the command ``new`` to the parser."""
    parser = arguments.add_command(
        subparsers,
        "new",
        new,
        "write a short scenario file to change: linkage, masses, controller, reference",
        "Each value has unit, range and origin in a comment. A CSV file of the same name holds "
        "the reference. Files that exist are never replaced.",
        uses_drake=False,
    )
    parser.add_argument(
        "path", metavar="SCENARIO.yaml", type=arguments.place, help="the scenario file to write"
    )


def new(request: Request) -> Outcome:
    """Write a scenario file and the CSV file of its reference, and say how to run it."""
    path: Path = request.path
    if path.suffix not in (".yaml", ".yml"):
        raise ParameterError(f"{shown(path)}: the name must end in .yaml")
    csv = path.with_suffix(".csv")
    for file in (path, csv):
        if os.path.lexists(file):
            raise OutputError(f"{shown(file)} exists already; choose another name")
    write_files(path.parent, {path.name: scenario_text(csv.name), csv.name: reference_text()})
    text = (
        f"{shown(path)} is a knee to change, {shown(csv)} its reference. Next:\n"
        f"  kneexo simulate {shown(path)} --out run\n"
        f"  kneexo view {shown(path)} --out knee.html\n"
        f"  kneexo params {shown(path)}\n"
    )
    document = {"kneexo": __version__, "files": [str(path), str(csv)]}
    return Outcome(text, json.dumps(document) + "\n")


def scenario_text(csv: str) -> str:
    """Return the text of the file that ``kneexo new`` writes; its reference is the file ``csv``."""
    return "\n".join(_lines(csv)) + "\n"


def reference_text() -> str:
    """Return the text of a CSV file: one period of the default sine, sampled evenly."""
    from kneexo.parameters import SineReference

    sine = SineReference()
    lines = ["time_s,knee_angle_deg"]  # the default names of `CsvReference`
    for n in range(_INTERVALS + 1):
        share = n / _INTERVALS
        angle = sine.mean_deg - sine.amplitude_deg * math.cos(2.0 * math.pi * share)
        lines.append(f"{share / sine.frequency_hz:.6g},{angle:.6g}")
    return "\n".join(lines) + "\n"


def _lines(csv: str) -> Iterator[str]:
    """Yield the lines of the scenario file."""
    from kneexo.parameters import CsvReference, PidParameters, Scenario
    from kneexo.parameters.fields.fields import source_of
    from kneexo.parameters.presets import PRESETS

    scenario = Scenario.preset(PRESET)
    others = ", ".join(name for name in PRESETS if name != PRESET)
    linkage_class = type(scenario.plant.linkage)
    origin = source_of(linkage_class.model_fields["a_2_m"]).partition(";")[0]
    columns = CsvReference(file=csv)
    pid = {name: getattr(PidParameters(), name) for name in _PID_GAINS}
    gains = ", ".join(f"{name}: {value:g}" for name, value in pid.items())
    yield "# A knee to change. Comments: unit, range; meaning or origin. Other values are the"
    yield "# preset's (kneexo params lists them). The polynomial is fitted to this linkage."
    yield f"preset: {PRESET}  # shank's weight, drive, chambers, friction; others: {others}"
    yield "plant:"
    yield f"  linkage:  # {origin}"
    for name, meaning in _MEANINGS.items():
        yield _value_line(scenario, "plant.linkage", name, meaning)
    yield "  cylinder:"
    yield from _section_lines(scenario, "plant.cylinder")
    yield f"  load:\n    kind: {scenario.plant.load.kind}"
    yield from _section_lines(scenario, "plant.load")
    yield "# In place of the next section, another controller, or a Python function of yours:"
    yield f"# controller: {{kind: pid, {gains}}}"
    yield "# controller: {kind: torque, mode: zero_torque}  # for a wearer; add wearer: leg"
    law = json.dumps(f"{Path(csv).stem}.py:law", ensure_ascii=False)
    yield f"# controller: {{kind: law, function: {law}}}  # docs/your_controller.md"
    yield f"controller:\n  kind: {scenario.controller.kind}"
    yield from _section_lines(scenario, "controller")
    yield "reference:  # time and angle: names of the columns of the file, in s and in deg"
    file = json.dumps(csv, ensure_ascii=False)
    yield f"  {{kind: csv, file: {file}, time: {columns.time}, angle: {columns.angle}}}"


def _section_lines(scenario: Scenario, section: str) -> Iterator[str]:
    """Yield the lines of the values at ``section``, with their provenance."""
    from kneexo.parameters.fields.fields import source_of
    from kneexo.parameters.paths import value_at

    fields = type(value_at(scenario, section)).model_fields
    for name in _PLACES[section]:
        yield _value_line(scenario, section, name, source_of(fields[name]))


def _value_line(scenario: Scenario, section: str, name: str, remark: str) -> str:
    """Return a line with a value, its unit and range, and the first phrase of ``remark``."""
    from kneexo.parameters.fields.fields import limits_of, unit_of
    from kneexo.parameters.paths import value_at

    holder = value_at(scenario, section)
    field = type(holder).model_fields[name]
    low, high = limits_of(field)
    unit = f"{unit_of(field)}, {low:g}…{high:g}"
    if choices := get_args(field.annotation):
        unit = " or ".join(map(str, choices))
    indent = "  " * (section.count(".") + 1)
    remark = re.split("[;,]", remark)[0]
    return f"{indent}{name}: {getattr(holder, name):.6g}  # {unit}; {remark}"
