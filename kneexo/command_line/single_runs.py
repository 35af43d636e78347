"""The commands ``simulate`` and ``linearize``."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from kneexo.command_line import arguments
from kneexo.command_line.html_page import page_file
from kneexo.command_line.outcome import Outcome, file_names
from kneexo.command_line.request import Request, origin_of
from kneexo.command_line.view import run_names
from kneexo.errors import shown

if TYPE_CHECKING:
    from kneexo.analysis import TrackingResult
    from kneexo.parameters import Scenario


def add_single_runs(subparsers: Any) -> None:
    """Add the commands ``simulate`` and ``linearize`` to the parser."""
    parser = arguments.add_command(
        subparsers,
        "simulate",
        simulate,
        "run one scenario",
        "With --engine drake a simulated second takes 0.2 s (preset paper) to 2 s (wearer).",
        fills_directory=True,
        duration_s=2.0,
    )
    arguments.add_scenario(parser)
    arguments.add_engine(parser)
    arguments.add_values(parser)
    arguments.add_out(parser, "signals.csv, metrics.json, scenario.yaml and tracking.png, .pdf")
    arguments.add_html(parser)

    parser = arguments.add_command(
        subparsers,
        "linearize",
        linearize,
        "poles, margins and small-signal bandwidths of plant and sampled loop",
        "At a posture; the quantizer is bypassed.",
        fills_directory=True,
        duration_s=2.0,
    )
    arguments.add_scenario(parser)
    arguments.add_values(parser)
    parser.add_argument(
        "--knee-angle",
        type=arguments.decimal,
        metavar="DEG",
        help="posture, knee angle in deg; left out: the middle of the reference within the run",
    )
    arguments.add_out(parser, "linearization.json; loop, nyquist and poles as PNG and PDF")
    arguments.add_html(parser)


def simulate(request: Request) -> Outcome:
    """Run a scenario; return an outcome with signals, metrics and plot."""
    scenario = request.load(request.scenario)
    from kneexo.analysis import track
    from kneexo.analysis.tracking.notices import wrapped
    from kneexo.command_line.output import to_json, write_csv
    from kneexo.geometry.rod_polynomial import completed
    from kneexo.parameters.scenario_file import scenario_files
    from kneexo.simulation.engines import is_compiled
    from kneexo.studies.markdown import number

    if is_compiled(scenario):
        result = track(scenario, all_signals=True)
    else:
        result = _track_with_bar(scenario)
    verdict, metrics = result.verdict, result.metrics
    origin = origin_of(scenario)
    step = {} if result.step is None else {"step": asdict(result.step)}
    push = {} if result.push is None else {"push": asdict(result.push)}
    results = to_json(origin | {"verdict": verdict.results()} | asdict(metrics) | step | push)
    files: dict[str, Any] = {
        "signals.csv": lambda path: write_csv(path, result.run),
        "metrics.json": results,
        **scenario_files(completed(scenario), "scenario.yaml", request.out),
    }
    figures = {"tracking": result.plot()[0].figure}
    if request.html:
        from kneexo.studies.simulate.report import report as report_of

        report = report_of(result)
        (name,) = run_names([request.scenario] if request.scenario else [], request.preset)
        motions = {name: (scenario.plant, result.run.columns)}
        files |= page_file(request, report, figures, origin, motions)
    error = "rms from the reference" if verdict.tracks is None else "error (root mean square)"
    delivered_j = metrics.shaft_energy_delivered_j
    lines = [
        verdict.text,
        *([] if result.push is None else [wrapped(result.push.line)]),
        f"  {error:24}  {number(metrics.rms_error_deg, '.3g')} deg",
        f"  {'change of the command':24}  {number(metrics.mean_command_change_rpm, '.3g')} rpm per "
        f"sample",
        f"  {'work of the motor':24}  {delivered_j:.3g} J; "
        f"{delivered_j - metrics.shaft_energy_j:.3g} J flows back to the motor",
        wrapped(f"In {shown(request.out)}: {', '.join(file_names(files, figures))}"),
    ]
    return Outcome("\n".join(lines) + "\n", results, files=files, figures=figures)


def _track_with_bar(scenario: Scenario) -> TrackingResult:
    """Run a scenario in Drake's Simulator, and show a progress bar of the simulated time."""
    from kneexo.analysis import track
    from kneexo.common.progress import progress_bar
    from kneexo.diagrams import make_closed_loop

    make_closed_loop(scenario)  # so that its errors come before the bar
    with progress_bar(scenario.duration_s, "simulated time") as bar:
        return track(scenario, all_signals=True, progress=lambda time: bar.update(time - bar.n))


def linearize(request: Request) -> Outcome:
    """Linearize plant and sampled loop; return an outcome with poles, margins and plots.

    Without ``--knee-angle`` the posture is the middle of the knee angles that the reference reaches
    within a run.
    """
    scenario = request.load(request.scenario)
    from kneexo.analysis import linearize_loop, linearize_plant
    from kneexo.analysis.linear.plant_linearization import plant_at
    from kneexo.analysis.tracking.notices import model_lines, model_notices, wrapped
    from kneexo.analysis.tracking.verdict import loop_lines
    from kneexo.command_line.output import to_json
    from kneexo.systems.knee_reference import run_middle_deg

    knee_angle: float | None = request.knee_angle
    if knee_angle is None:
        knee_angle = run_middle_deg(scenario)
    scenario.plant.knee.require_posture(knee_angle, "--knee-angle")
    plant = linearize_plant(plant_at(scenario, knee_angle), knee_angle_deg=knee_angle)
    loop = linearize_loop(scenario, knee_angle_deg=knee_angle)
    frequencies_rad_s, damping_ratios = plant.damping
    margins = asdict(loop.margins())
    if not loop.stable:  # the margins of an unstable loop are not defined
        margins = dict.fromkeys(margins, math.nan) | {"stable": False}
    origin = origin_of(scenario) | {"settings": {"knee_angle_deg": knee_angle}}
    verdict_lines, notices = loop_lines(loop), model_lines(scenario, model_notices(scenario))
    results = to_json(
        {
            **origin,
            "verdict": {"lines": verdict_lines, "stable": loop.stable},
            "operating_point": asdict(plant.operating_point),
            "plant_poles_per_s": [[p.real, p.imag] for p in plant.poles],
            "plant_frequencies_rad_s": frequencies_rad_s,
            "plant_damping_ratios": damping_ratios,
            "plant_velocity_gain": plant.velocity_gain,
            "loop_eigenvalues": [[z.real, z.imag] for z in loop.eigenvalues],
            "margins": margins,
            "bandwidth_hz": loop.bandwidth_hz() if loop.stable else None,
            "complementary_sensitivity_bandwidth_hz": (
                loop.complementary_sensitivity_bandwidth_hz() if loop.stable else None
            ),
        }
    )
    axes = {"loop": loop.plot()[0], "nyquist": loop.plot_nyquist(), "poles": loop.plot_poles()}
    figures = {name: ax.figure for name, ax in axes.items()}
    files = {"linearization.json": results}
    if request.html:
        from kneexo.studies.linearize.report import report as report_of

        report = report_of(plant, loop, verdict_lines, notices)
        files |= page_file(request, report, figures, origin)
    text = [
        *map(wrapped, verdict_lines),
        *notices,
        f"Plant: {plant}",
        wrapped(f"In {shown(request.out)}: {', '.join(file_names(files, figures))}"),
    ]
    return Outcome("\n".join(text) + "\n", results, files=files, figures=figures)
