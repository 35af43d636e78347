"""What each command of ``kneexo`` does with its parsed options.

Each imports what it needs: ``kneexo --help``, ``kneexo cache`` and, but for its list of settings,
``kneexo params`` need no Drake.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from kneexo.errors import OutputError, ParameterError, shown
from kneexo.files.writing import output_directory, require_mark
from kneexo.studies.catalogue import Study
from kneexo.version import __version__

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from matplotlib.figure import Figure

    from kneexo.analysis import TrackingResult
    from kneexo.parameters import Scenario
    from kneexo.parameters.quantity import Parameters
    from kneexo.studies.catalogue import Motion

_P = TypeVar("_P", bound="Parameters")

# ------------------------------------------------------------------- shared by the commands


def _with_values(parameters: _P, texts: Sequence[str]) -> _P:
    """The parameters with what ``--set`` changes, texts NAME=VALUE."""
    from kneexo.parameters.paths import changed
    from kneexo.parameters.scenario_file import read_value

    values = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator:
            raise ParameterError(f"--set {shown(text)}: must be NAME=VALUE")
        values[name] = read_value(f"--set {name}", value)
    return changed(parameters, values)


def _scenario(options: argparse.Namespace, default: Scenario | None = None) -> Scenario:
    """The scenario of the file or the default, with ``--set`` and then ``--engine`` applied."""
    from kneexo.parameters import Scenario
    from kneexo.parameters.scenario_file import load_scenario

    path = getattr(options, "scenario", None)
    scenario = (default or Scenario()) if path is None else load_scenario(path)
    scenario = _with_values(scenario, getattr(options, "values", ()))
    return scenario.with_engine(getattr(options, "engine", None))


def _executor(options: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """The Dask cluster that was asked for; None leaves the choice to ``--workers``."""
    if options.workers is not None and options.workers < 1:
        raise ParameterError(f"--workers = {options.workers}: must be at least 1")
    if options.dask is None:
        return nullcontext()
    from kneexo.sweeps.parallel import dask_cluster

    return dask_cluster(options.dask)


def _results(options: argparse.Namespace) -> AbstractContextManager[Path]:
    """The directory for the results; notes when they are in ``--out``."""
    return output_directory(options.out, partial(setattr, options, "written", True))


def _origin(scenario: Scenario, settings: Parameters | None = None) -> dict[str, Any]:
    """What every JSON result begins with: version of kneexo, scenario and settings."""
    given = {} if settings is None else {"settings": settings.model_dump(mode="json")}
    return {"kneexo": __version__, "scenario": scenario.model_dump(mode="json")} | given


def _write(
    directory: Path,
    texts: Mapping[str, str],
    figures: Mapping[str, Figure],
    page: Callable[[Mapping[str, Figure]], tuple[str, str]] | None = None,
) -> None:
    """Write texts by file name, and figures by name as PNG and PDF; the figures are closed.

    ``page``: makes name and text of an HTML page that shows the figures too.
    """
    import matplotlib.pyplot as plt

    from kneexo.command_line.output import save_figure

    pages = [page(figures)] if page is not None else []
    for name, text in (*texts.items(), *pages):
        (directory / name).write_text(text, encoding="utf-8")
    for name, figure in figures.items():
        save_figure(directory, name, figure)
        plt.close(figure)


def _require_page(options: argparse.Namespace, command: str) -> None:
    """Raise `OutputError` where ``--html`` would write over a file that kneexo has not written."""
    if options.html:
        page = Path(options.out, f"{command.split()[-1]}.html")
        require_mark(page, "<title>kneexo ", "page of kneexo")


def _page(
    options: argparse.Namespace,
    command: str,
    report: str,
    origin: Mapping[str, Any],
    motions: Callable[[], Mapping[str, Motion]] = dict,
) -> Callable[[Mapping[str, Figure]], tuple[str, str]] | None:
    """What makes the HTML page of the report of a command, where ``--html`` asks for it.

    ``motions``: gives what of it a view in three dimensions shows, by name.
    """
    if not options.html:
        return None

    def page(figures: Mapping[str, Figure]) -> tuple[str, str]:
        from kneexo.command_line.html_page import html_page

        view = ""
        if moving := motions():
            from kneexo.view.page import MOST_FRAMES_IN_REPORT, Leg, view_page

            legs = [Leg.of_signals(name, *motion) for name, motion in moving.items()]
            view = view_page(legs, MOST_FRAMES_IN_REPORT)
        given = vars(options)
        words = ["kneexo", *command.split()]
        words += [given["scenario"]] if given.get("scenario") else []
        words += [f"--set={value}" for value in given.get("values", given.get("settings", ()))]
        text = html_page(shlex.join(words), report, figures, origin, view)
        return f"{command.split()[-1]}.html", text

    return page


def _checkpoint_path(options: argparse.Namespace) -> Path:
    """Where a sweep keeps its finished pieces."""
    return Path(options.out, f"{options.command}.checkpoint.jsonl")


_AGAIN = "the same command goes on from them"


def kept(options: argparse.Namespace) -> str:
    """What an unfinished sweep has left; empty where it kept nothing."""
    checkpoint = getattr(options, "checkpoint", None)
    if checkpoint is not None:
        count = len(checkpoint)
        return (
            f"{count} finished pieces are kept in {shown(checkpoint.path)}; {_AGAIN}"
            if count
            else ""
        )
    if hasattr(options, "restart") and _checkpoint_path(options).exists():
        return f"finished pieces are kept in {shown(_checkpoint_path(options))}; {_AGAIN}"
    return ""


def left(options: argparse.Namespace) -> str:
    """What an interrupted command has left."""
    if getattr(options, "written", False):
        return f"the results are in {shown(options.out)}"
    return kept(options) or "nothing was written"


# -------------------------------------------------------------------------------- commands


def sweep(study: Study, options: argparse.Namespace) -> None:
    """Run a study, keep its finished pieces, and write results, report and figures."""
    scenario = _scenario(options, study.scenario)
    settings = _with_values(study.settings(), options.settings)
    compute = study.compute
    if study.uncertain and options.uncertainty is not None:
        from kneexo.parameters.scenario_file import load_uncertainty

        compute = partial(compute, uncertainty=load_uncertainty(options.uncertainty, scenario))
    import matplotlib.pyplot  # noqa: F401  (where it cannot be imported, no work is lost)

    from kneexo.command_line.output import to_json
    from kneexo.sweeps.checkpoint import Checkpoint

    def finish() -> None:
        options.written = True
        options.others = checkpoint.remove()

    _require_page(options, study.command)
    with _executor(options) as executor, output_directory(options.out, finish) as directory:
        if study.resumable:
            checkpoint = Checkpoint(_checkpoint_path(options), resume=not options.restart)
            compute = partial(compute, checkpoint=checkpoint)
        else:
            checkpoint = Checkpoint()
        options.checkpoint = checkpoint
        try:
            result = compute(
                scenario,
                settings=settings,
                workers=options.workers,
                executor=executor,
                progress=True,
            )
            origin = _origin(scenario, settings)
            document = to_json(origin | result.results())
            report = study.report(result)
            results_file, report_file = study.files
            texts = {
                results_file or f"{study.name}.json": document,
                report_file or f"{study.name}.md": report,
            }
            page = _page(options, study.command, report, origin, partial(study.motions, result))
            _write(directory, texts, study.figures(result), page)
            files = ", ".join(sorted(file.name for file in directory.iterdir()))
        except BaseException:  # KeyboardInterrupt too: the next process may have the file
            checkpoint.close()
            raise
    if options.others:
        print(
            f"kneexo: {options.others} finished pieces of other settings stay in "
            f"{shown(checkpoint.path)}; --restart deletes them",
            file=sys.stderr,
        )
    print(document if options.json else f"{report}\nIn {shown(options.out)}: {files}\n", end="")


def simulate(options: argparse.Namespace) -> None:
    """Run one scenario, and write its signals, metrics and plot."""
    scenario = _scenario(options)
    from kneexo.analysis import track
    from kneexo.command_line.output import to_json, write_csv
    from kneexo.parameters.scenario_file import dump_scenario
    from kneexo.studies.markdown import markdown_table, number

    _require_page(options, "simulate")
    with _results(options) as directory:
        if scenario.simulation.compiled:
            result = track(scenario, all_signals=True)
        else:
            result = _track_with_bar(scenario)
        metrics = asdict(result.metrics)
        document = to_json(_origin(scenario) | metrics)
        write_csv(directory / "signals.csv", result.run)
        texts = {"metrics.json": document, "scenario.yaml": dump_scenario(scenario)}
        rows = [(name, number(value, ".6g")) for name, value in metrics.items()]
        report = "\n".join(markdown_table(("metric", "value"), rows))
        ((name, _),) = _named_runs(options.scenario and [options.scenario])
        motions = {name: (scenario.plant.linkage, result.run.columns)}
        page = _page(options, "simulate", report, _origin(scenario), lambda: motions)
        _write(directory, texts, {"tracking": result.plot()[0].figure}, page)
        files = ", ".join(sorted(file.name for file in directory.iterdir()))
    if options.json:
        print(document, end="")
        return
    for name, text in rows:
        print(f"{name:28s} {text}")
    print(f"In {shown(options.out)}: {files}")


def _track_with_bar(scenario: Scenario) -> TrackingResult:
    from kneexo.analysis import track
    from kneexo.diagrams import make_closed_loop
    from kneexo.progress import progress_bar

    make_closed_loop(scenario)  # its faults are shown before the progress bar
    with progress_bar(scenario.simulation.duration_s, "simulated time") as bar:
        return track(scenario, all_signals=True, progress=lambda time: bar.update(time - bar.n))


def linearize(options: argparse.Namespace) -> None:
    """Linearize plant and sampled loop at a posture, and write poles, margins and plots."""
    scenario = _scenario(options)
    from kneexo.analysis import linearize_loop, linearize_plant
    from kneexo.command_line.output import to_json
    from kneexo.studies.markdown import document, markdown_table, number

    _require_page(options, "linearize")
    with _results(options) as directory:
        plant = linearize_plant(scenario.plant, options.knee_angle)
        loop = linearize_loop(scenario, options.knee_angle)
        frequency, damping = plant.damping
        margins = asdict(loop.margins())
        if not loop.stable:  # distances to stability are no margins
            margins = dict.fromkeys(margins, math.nan) | {"stable": False}
        origin = _origin(scenario) | {"settings": {"knee_angle_deg": options.knee_angle}}
        text = to_json(
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
        rows = [(name, number(value, ".6g")) for name, value in margins.items()]
        report = document(
            *_section("Plant", str(plant)),
            *_section("Loop", str(loop)),
            markdown_table(("margin", "value"), rows),
        )
        page = _page(options, "linearize", report, origin)
        _write(directory, {"linearization.json": text}, figures, page)
        files = ", ".join(sorted(file.name for file in directory.iterdir()))
    if options.json:
        print(text, end="")
        return
    print(f"plant: {plant}\nloop: {loop}")
    print(f"In {shown(options.out)}: {files}")


def _section(title: str, text: str) -> list[str | list[str]]:
    """Blocks of a `document`: a heading, the first line and the others as a list."""
    first, *others = text.splitlines()
    return [f"## {title}", first, [f"- {line.strip()}" for line in others]]


def params(options: argparse.Namespace) -> None:
    """List the parameters, or print a scenario file or the schema of such files."""
    scenario = _scenario(options)
    if options.yaml:
        from kneexo.parameters.scenario_file import dump_scenario

        print(dump_scenario(scenario), end="")
        return
    if options.schema:
        from kneexo.parameters.schema import json_schema

        print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
        return
    from kneexo.command_line.parameter_list import parameter_rows, setting_rows, uncertainty_rows

    rows = list(parameter_rows(scenario, all_kinds=options.scenario is None))
    if options.scenario is None:
        rows += [*setting_rows(), *uncertainty_rows()]
    if options.json:
        document = {**_origin(scenario), "parameters": rows}
        print(json.dumps(document, indent=2, ensure_ascii=False))
        return
    for row in rows:
        bounds = f"  [{row['range']}]" if row["range"] else ""
        unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
        value = f"{row['value']:.10g}" if isinstance(row["value"], float) else row["value"]
        print(f"{row['parameter']} = {value}{unit}{bounds}\n    {row['provenance']}")


def diagram(options: argparse.Namespace) -> None:
    """Write the block diagram as a Graphviz file, and as pictures where Graphviz is installed."""
    scenario = _scenario(options)
    from kneexo.diagrams import make_closed_loop

    text = make_closed_loop(scenario).GetGraphvizString()
    graphviz = shutil.which("dot")
    with _results(options) as directory:
        source = directory / "closed_loop.dot"
        source.write_text(text, encoding="utf-8")
        for kind in ("svg", "png") if graphviz else ():
            picture = source.with_suffix(f".{kind}")
            command = [str(graphviz), f"-T{kind}", str(source), "-o", str(picture)]
            process = subprocess.run(command, capture_output=True, text=True)
            if process.returncode:
                picture.unlink(missing_ok=True)
                reason = (process.stderr.splitlines() or ["no message"])[0]
                print(f"kneexo: Graphviz could not draw the {kind}: {reason}", file=sys.stderr)
        files = sorted(file.name for file in directory.iterdir())
    if options.json:
        print(json.dumps({**_origin(scenario), "directory": str(options.out), "files": files}))
        return
    print(f"{', '.join(files)} {'are' if len(files) > 1 else 'is'} in {shown(options.out)}")
    if not graphviz:
        print(
            "For a picture install Graphviz (Debian, Ubuntu: apt-get install graphviz) and run "
            "this again.",
            file=sys.stderr,
        )


def view(options: argparse.Namespace) -> None:
    """``kneexo view``."""
    import webbrowser

    from kneexo.command_line.output import to_json
    from kneexo.parameters.scenario_file import load_scenario
    from kneexo.view.legs import leg_of_results, leg_of_scenario
    from kneexo.view.page import MOST_LEGS, require_page, shown_s, view_page, write_page

    require_page(options.out)
    if len(options.runs) > MOST_LEGS:
        raise ParameterError(f"{len(options.runs)} runs: a page shows {MOST_LEGS} at most")
    if options.values and (results := [run for run in options.runs if Path(run).is_dir()]):
        raise ParameterError(
            f"--set: {shown(results[0])} holds a finished run; its values are fixed"
        )
    legs = []
    for name, run in _named_runs(options.runs):
        if run is not None and Path(run).is_dir():
            scenario = load_scenario(Path(run, "scenario.yaml"))
            legs.append(leg_of_results(name, Path(run), scenario))
            continue
        options.scenario = run  # for messages too, until the next run
        caption = ", ".join([name, *options.values])
        leg, failure = leg_of_scenario(caption, _scenario(options))
        options.scenario = None
        if failure:
            print(f"kneexo: {shown(caption)}: {failure}; shown up to there", file=sys.stderr)
        legs.append(leg)
    if (end_s := shown_s(legs)) < max(leg.time_s[-1] for leg in legs):
        print(f"kneexo: only the first {end_s:.3g} s are shown: the page is full", file=sys.stderr)
    write_page(options.out, view_page(legs))
    options.written = True
    names = [leg.name for leg in legs]
    if options.json:
        print(to_json({"kneexo": __version__, "page": str(options.out), "runs": names}), end="")
    else:
        listed = ", ".join(map(shown, names))
        print(f"{shown(options.out)}: {listed}; open it in a browser")
    if options.open and not webbrowser.open(options.out.resolve().as_uri()):
        raise OutputError(
            f"--open: no browser here; {shown(options.out)} is written, open it elsewhere"
        )


def _named_runs(runs: Sequence[str] | None) -> list[tuple[str, str | None]]:
    """Each run with its name; no two names are equal. Without runs the paper's, None.

    The name is that of its file or directory; where some are equal, after the parent's name; where
    these are equal too, the run as it was given, with a number from its second time on.
    """
    if not runs:
        return [("the paper's setup", None)]
    paths = [Path(os.path.realpath(run)) for run in runs]
    names = [path.name if path.is_dir() else path.stem for path in paths]
    in_parent = [f"{path.parent.name}/{name}" for path, name in zip(paths, names, strict=True)]
    for longer in (in_parent, runs):
        pairs = zip(names, longer, strict=True)
        names = [other if names.count(name) > 1 else name for name, other in pairs]
    times = [names[: index + 1].count(name) for index, name in enumerate(names)]
    return [
        (name if time == 1 else f"{name} ({time})", run)
        for name, time, run in zip(names, times, runs, strict=True)
    ]


def export_c(options: argparse.Namespace) -> None:
    """``kneexo export c``."""
    from kneexo.command_line.output import to_json
    from kneexo.compiler.c.export import TOLERANCES
    from kneexo.export.firmware import export_firmware

    scenario = _scenario(options)
    measured = export_firmware(
        scenario,
        options.out,
        options.what,
        precision=options.precision,
        vectors_s=options.vectors_s,
        step_s=options.step_s,
        look_up=options.look_up,
    )
    if measured.replay is not None and not measured.replay.passed:
        share = TOLERANCES[options.precision]
        print(
            f"kneexo: {options.what} in {options.precision} precision: the replay differs by more "
            f"than {share:g} of an output's largest value; make test fails",
            file=sys.stderr,
        )
    if options.json:
        print(to_json(_origin(scenario) | asdict(measured)), end="")
        return
    print(f"{options.what} in {options.precision} precision: {shown(options.out)}")
    print(f"  {sum(measured.operations.values())} operations a step")
    print(f"  {measured.state_bytes} bytes of state")
    if measured.replay:
        for field, difference in measured.replay.difference.items():
            largest = measured.replay.largest[field]
            print(f"  {field}: difference {difference:.3g} (largest value {largest:.6g})")
    for target, size in measured.code_sizes.items():
        print(f"  {target}: {size.flash} bytes of flash, {size.stack} bytes of stack")
    for what, reason in measured.not_measured.items():
        print(f"  {what} not measured: {reason}")


def export_fmu(options: argparse.Namespace) -> None:
    """``kneexo export fmu``."""
    from kneexo.command_line.output import to_json
    from kneexo.export import fmu

    scenario = _scenario(options)
    file = fmu.export_fmu(
        scenario, options.out, options.what, fmi=options.fmi, step_s=options.step_s
    )
    if options.json:
        print(to_json(_origin(scenario) | asdict(file)), end="")
        return
    print(f"{options.what} as FMU by FMI {options.fmi}: {shown(file.path)}")
    print(f"  inputs: {', '.join(file.inputs)}")
    print(f"  outputs: {', '.join(file.outputs)}")
    print(
        f"  parameters: {file.parameters}, of which {len(file.scenario_parameters)} have names "
        f"of the scenario"
    )
    print(f"  communication step: {file.sample_time_s:g} s or a whole multiple")
    if not file.binary:
        print("  sources only: no C compiler (cc, gcc or clang), or not Linux on x86-64")


def cache(options: argparse.Namespace) -> None:
    """Show or delete the compiled models that are kept on disk."""
    import time

    from kneexo.compiler.native import cache as models

    directory = models.cache_directory()
    if options.clear:
        count = models.clear()
        if options.json:
            document = {"kneexo": __version__, "directory": str(directory), "deleted": count}
            print(json.dumps(document))
        else:
            print(f"{directory}: {count} {'entry' if count == 1 else 'entries'} deleted")
        return
    entries, limit_bytes = models.entries(), models.size_limit()
    size_bytes = sum(entry.size_bytes for entry in entries)
    if options.json:
        summary = {
            "kneexo": __version__,
            "directory": str(directory),
            "size_bytes": size_bytes,
            "limit_bytes": limit_bytes,
            "entries": [
                {
                    "name": entry.path.name,
                    "size_bytes": entry.size_bytes,
                    "last_use_s": entry.last_use_s,
                }
                for entry in entries
            ],
        }
        print(json.dumps(summary, indent=2))
        return
    print(f"directory  {directory}")
    print(f"entries    {len(entries)}")
    print(f"size       {size_bytes / 2**20:.1f} of at most {limit_bytes / 2**20:.0f} MiB")
    if entries:
        print("used last")
    for entry in entries[:5]:
        last_use = time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.last_use_s))
        print(f"  {last_use}  {entry.size_bytes / 2**10:8.1f} KiB  {entry.path.name}")
