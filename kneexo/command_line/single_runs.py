"""The commands ``simulate`` and ``linearize``."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kneexo.command_line import arguments
from kneexo.command_line.arguments import ScenarioChoice
from kneexo.command_line.html_page import ReportPage
from kneexo.command_line.outcome import Outcome, file_names
from kneexo.command_line.view import run_names
from kneexo.errors import shown

if TYPE_CHECKING:
    from kneexo.analysis import TrackingResult
    from kneexo.parameters import Scenario


def add_single_runs(subparsers: Any) -> None:
    """Add the commands ``simulate`` and ``linearize`` to the parser."""
    parser = arguments.add_command(
        subparsers, "simulate", simulate, "run one scenario", directory=arguments.out
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
        directory=arguments.out,
    )
    arguments.add_scenario(parser)
    arguments.add_values(parser)
    parser.add_argument(
        "--knee-angle",
        type=arguments.decimal,
        default=40.0,
        metavar="DEG",
        help="posture, knee angle in deg",
    )
    arguments.add_out(parser, "linearization.json; loop, nyquist and poles as PNG and PDF")
    arguments.add_html(parser)


def simulate(choice: ScenarioChoice, out: Path, page: ReportPage | None = None) -> Outcome:
    """Run a scenario; return signals, metrics and plot. If ``page`` is given, add an HTML page."""
    scenario = choice.load()
    from kneexo.analysis import track
    from kneexo.command_line.output import to_json, write_csv
    from kneexo.parameters.scenario_file import dump_scenario
    from kneexo.studies.markdown import markdown_table, number

    if page is not None:
        page.require_replaceable()
    if scenario.simulation.compiled:
        result = track(scenario, all_signals=True)
    else:
        result = _track_with_bar(scenario)
    metrics = asdict(result.metrics)
    document = to_json(arguments.origin_of(scenario) | metrics)
    files: dict[str, Any] = {
        "signals.csv": lambda path: write_csv(path, result.run),
        "metrics.json": document,
        "scenario.yaml": dump_scenario(scenario),
    }
    figures = {"tracking": result.plot()[0].figure}
    rows = [(name, number(value, ".6g")) for name, value in metrics.items()]
    if page is not None:
        report = "\n".join(markdown_table(("metric", "value"), rows))
        (name,) = run_names([choice.path] if choice.path else [])
        motions = {name: (scenario.plant.linkage, result.run.columns)}
        files |= page.file(report, figures, arguments.origin_of(scenario), motions)
    lines = [f"{name:28s} {value}" for name, value in rows]
    lines.append(f"In {shown(out)}: {', '.join(file_names(files, figures))}")
    return Outcome("\n".join(lines) + "\n", document, files=files, figures=figures)


def _track_with_bar(scenario: Scenario) -> TrackingResult:
    """Run a scenario in Drake's Simulator, and show a progress bar of the simulated time."""
    from kneexo.analysis import track
    from kneexo.diagrams import make_closed_loop
    from kneexo.progress import progress_bar

    make_closed_loop(scenario)  # so that its errors come before the bar
    with progress_bar(scenario.simulation.duration_s, "simulated time") as bar:
        return track(scenario, all_signals=True, progress=lambda time: bar.update(time - bar.n))


def linearize(
    choice: ScenarioChoice, knee_angle: float, out: Path, page: ReportPage | None = None
) -> Outcome:
    """Linearize plant and sampled loop at a knee angle in deg; return poles, margins and plots."""
    scenario = choice.load()
    from kneexo.analysis import linearize_loop, linearize_plant
    from kneexo.command_line.output import to_json
    from kneexo.studies.markdown import document, markdown_table, number

    if page is not None:
        page.require_replaceable()
    plant = linearize_plant(scenario.plant, knee_angle)
    loop = linearize_loop(scenario, knee_angle)
    frequency, damping = plant.damping
    margins = asdict(loop.margins())
    if not loop.stable:  # the margins of an unstable loop are not defined
        margins = dict.fromkeys(margins, math.nan) | {"stable": False}
    origin = arguments.origin_of(scenario) | {"settings": {"knee_angle_deg": knee_angle}}
    results = to_json(
        {
            **origin,
            "operating_point": asdict(plant.operating_point),
            "plant_poles_per_s": [[p.real, p.imag] for p in plant.poles],
            "plant_frequencies_rad_s": frequency,
            "plant_damping_ratios": damping,
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
    if page is not None:
        rows = [(name, number(value, ".6g")) for name, value in margins.items()]
        report = document(
            *_section("Plant", str(plant)),
            *_section("Loop", str(loop)),
            markdown_table(("margin", "value"), rows),
        )
        files |= page.file(report, figures, origin)
    names = ", ".join(file_names(files, figures))
    text = f"plant: {plant}\nloop: {loop}\nIn {shown(out)}: {names}\n"
    return Outcome(text, results, files=files, figures=figures)


def _section(title: str, text: str) -> list[str | list[str]]:
    """Return a section for `document`: heading, first line of ``text``, other lines as a list."""
    first, *others = text.splitlines()
    return [f"## {title}", first, [f"- {line.strip()}" for line in others]]
