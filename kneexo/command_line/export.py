"""The commands ``export c``, ``export sil`` and ``export fmu``."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from kneexo.command_line import arguments
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request, origin_of
from kneexo.common.progress import line_width
from kneexo.errors import shown

if TYPE_CHECKING:  # the compiler loads NumPy
    from diagramc import Measurement, SilMeasurement
    from kneexo.parameters import Scenario

NO_BINARY = "none; a binary needs 64-bit Linux and a C compiler (cc, gcc, clang)"
"""Text in place of the names of platforms, for an FMU that has C sources alone."""


def add_exports(subparsers: Any) -> None:
    """Add the commands ``export c``, ``export sil`` and ``export fmu`` to the parser."""
    summary = "write the controller, the plant or the closed loop for use outside Python"
    forms = arguments.add_group(subparsers, "export", summary, "FORM")
    parser = arguments.add_command(
        forms,
        "c",
        export_c,
        "write C99 for a microcontroller",
        "With the parameters as one struct, test vectors from the compiled closed loop, a harness "
        "that replays them, Makefile, CMakeLists.txt and a README that shows how to call it.",
        duration_s=2.0,
    )
    _add_target(parser, "encoder count")
    _add_code_options(parser)
    parser.add_argument(
        "--name",
        help="prefix of all C names and file names, so that several exports link into one program; "
        "left out: the word after --what",
    )
    parser.add_argument(
        "--outputs",
        nargs="+",
        metavar="PORT",
        help="output ports to export; left out: all",
    )
    arguments.add_out(parser, "the files, which no other files may share")

    parser = arguments.add_command(
        forms,
        "sil",
        export_sil,
        "write controller and plant as C99 with a program that closes their loop",
        "Software in the loop: the folders controller and plant as export c writes them, sil.c and "
        "a Makefile. make test compares each step with the compiled closed loop.",
        duration_s=2.0,
    )
    arguments.add_scenario(parser)
    arguments.add_values(parser)
    _add_code_options(parser)
    _add_step(parser)
    arguments.add_out(parser, "the files, which no other files may share")

    parser = arguments.add_command(
        forms,
        "fmu",
        export_fmu,
        "write a functional mock-up unit for co-simulation in other simulators",
        "With C sources and a binary for this machine, if it has a C compiler, or for the systems "
        "that --platforms names. Numbers of the scenario are parameters of the FMU.",
        duration_s=3.0,
    )
    _add_target(parser, "encoder reading (rad)")
    parser.add_argument(
        "--fmi",
        type=arguments.integer,
        choices=(2, 3),
        default=3,
        help="version of the FMI standard",
    )
    parser.add_argument(
        "--platforms",
        type=lambda text: "all" if text == "all" else text.split(","),
        metavar="NAME,…",
        help="platforms of the binaries, all or some of x86_64-linux, aarch64-linux, "
        "x86_64-windows, x86_64-darwin (macOS) and aarch64-darwin, compiled by Zig (pip install "
        "ziglang); left out: this machine, by its C compiler",
    )
    parser.add_argument(
        "--out",
        metavar="FILE.fmu",
        type=arguments.place,
        required=True,
        help="file, or directory for knee_controller.fmu, knee_plant.fmu or knee_loop.fmu; an "
        "earlier file is replaced",
    )


def _add_code_options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that ``export c`` and ``export sil`` share."""
    parser.add_argument(
        "--precision",
        choices=("double", "float"),
        default="double",
        help="type of the numbers in C; with sil, of the controller's alone",
    )
    parser.add_argument(
        "--look-up",
        action="store_true",
        help="take what depends on the encoder count alone from a table: faster, and more exact "
        "in float; the parameters behind it are fixed then",
    )
    parser.add_argument(
        "--vectors-s",
        type=arguments.decimal,
        metavar="S",
        help="time of the test vectors in s; left out: 2",
    )


def _add_target(parser: argparse.ArgumentParser, measurement: str) -> None:
    """Add the arguments that ``export c`` and ``export fmu`` share.

    ``measurement`` describes the measured input of the controller in the help text.
    """
    arguments.add_scenario(parser)
    arguments.add_values(parser)
    parser.add_argument(
        "--what",
        dest="target",
        choices=("controller", "plant", "loop"),
        default="controller",
        help=f"the controller, from {measurement} and knee reference to motor speed command; the "
        "plant with its encoder; or both as closed loop",
    )
    parser.add_argument(
        "--integrator",
        choices=("rk4", "rosenbrock"),
        default="rk4",
        help="method for the states of plant and loop: rk4 has fixed steps; rosenbrock is for "
        "stiff plants, such as that of preset leg, and chooses its substeps by --tolerance",
    )
    parser.add_argument(
        "--tolerance",
        type=arguments.decimal,
        metavar="X",
        help="largest error estimate of a substep of rosenbrock, the sum over all states of "
        "error / (1 + |state|); left out: 1e-7 in double and 1e-5 in float precision",
    )
    _add_step(parser)


def _add_step(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--step-s",
        type=arguments.decimal,
        metavar="S",
        help="largest step of RK4 of plant and loop in s; left out: from the plant's fastest mode, "
        "at most 0.0002",
    )


def export_c(request: Request) -> Outcome:
    """Write controller, plant or loop as C to the directory ``--out``; return the command's text.

    See `kneexo.export.firmware`. Adds a notice if the replay of the test vectors differs by more
    than the tolerance.
    """
    from kneexo.export.firmware import export_firmware

    scenario = request.load(request.scenario)
    measurement = export_firmware(
        scenario,
        request.out,
        request.target,
        integrator=request.integrator,
        tolerance=request.tolerance,
        precision=request.precision,
        vectors_s=request.vectors_s,
        step_s=request.step_s,
        look_up=request.look_up,
        name=request.name,
        outputs=request.outputs,
    )
    subject = f"{request.target} in {request.precision} precision"
    lines = [
        f"{subject}: {shown(request.out)}",
        f"  {sum(measurement.operations.values())} operations a step",
        f"  {measurement.state_bytes} bytes of state",
    ]
    lines += _differences(measurement)
    for processor, size in measurement.code_sizes.items():
        lines.append(f"  {processor}: {size.flash} bytes of flash, {size.stack} bytes of stack")
    for quantity, reason in measurement.not_measured.items():
        lines.append(f"  {quantity} not measured: {reason}")
    return _measured(subject, lines, scenario, measurement)


def export_sil(request: Request) -> Outcome:
    """Write controller, plant and the program of their loop as C; return the command's text.

    See `kneexo.export.firmware.export_sil`. Adds a notice if the loop in C differs from the
    compiled loop by more than the tolerance.
    """
    from kneexo.export import firmware

    scenario = request.load(request.scenario)
    measurement = firmware.export_sil(
        scenario,
        request.out,
        precision=request.precision,
        vectors_s=request.vectors_s,
        step_s=request.step_s,
        look_up=request.look_up,
    )
    subject = f"loop of controller in {request.precision} precision and plant"
    lines = [f"{subject}: {shown(request.out)}", *_differences(measurement)]
    if measurement.replay is None:
        reason = measurement.controller.not_measured["differences"]
        lines.append(f"  differences not measured: {reason}")
    return _measured(subject, lines, scenario, measurement)


def _differences(measurement: Measurement | SilMeasurement) -> list[str]:
    """Return a line for each output of a replay; none if there was no replay."""
    replay = measurement.replay
    if replay is None:
        return []
    return [
        f"  {name}: difference {difference:.3g} (largest value {replay.largest[name]:.6g})"
        for name, difference in replay.difference.items()
    ]


def _measured(
    subject: str,
    lines: list[str],
    scenario: Scenario,
    measurement: Measurement | SilMeasurement,
) -> Outcome:
    """Return the outcome of C code, with a notice if a replay differs by more than its tolerance.

    Parameters
    ----------
    subject
        What was exported, for the notice.
    lines
        The text.
    scenario
        The scenario whose parts were exported.
    measurement
        What the document says beside the scenario.
    """
    from kneexo.command_line.output import to_json

    notices = []
    if measurement.replay is not None and not measurement.replay.passed:
        notices.append(
            f"kneexo: {subject}: the replay differs by more than the harness allows; make test "
            f"fails"
        )
    document = to_json(origin_of(scenario) | asdict(measurement))
    return Outcome("\n".join(lines) + "\n", document, notices)


def export_fmu(request: Request) -> Outcome:
    """Write controller, plant or loop as FMU to ``--out``; return the command's text.

    See `kneexo.export.fmu`.
    """
    from kneexo.command_line.output import to_json
    from kneexo.export import fmu

    scenario = request.load(request.scenario)
    file = fmu.export_fmu(
        scenario,
        request.out,
        request.target,
        fmi=request.fmi,
        integrator=request.integrator,
        tolerance=request.tolerance,
        step_s=request.step_s,
        platforms=request.platforms,
    )
    lines = [
        f"{request.target} as FMU by FMI {request.fmi}: {shown(file.path)}",
        *wrap(f"  inputs: {', '.join(file.inputs)}", line_width(), subsequent_indent="    "),
        *wrap(f"  outputs: {', '.join(file.outputs)}", line_width(), subsequent_indent="    "),
        f"  parameters: {len(file.parameters)}, of which {len(file.scenario_parameters)} have "
        f"names of the scenario",
        f"  communication step: {file.sample_time_s:g} s or a whole multiple",
        *wrap(
            f"  binaries: {', '.join(file.platforms) or NO_BINARY}",
            line_width(),
            subsequent_indent="    ",
        ),
    ]
    return Outcome("\n".join(lines) + "\n", to_json(origin_of(scenario) | asdict(file)))
