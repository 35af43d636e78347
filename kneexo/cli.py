"""Command line of kneexo: ``kneexo --help``."""

from __future__ import annotations

import argparse
import codecs
import io
import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from kneexo import system
from kneexo.errors import KneexoError, WorkerError
from kneexo.interruption import Terminated, sigterm_raises
from kneexo.studies.catalogue import PAPER, STUDIES, Study
from kneexo.version import __version__

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from pydantic import BaseModel

    from kneexo.analysis import TrackingResult
    from kneexo.parameters import Scenario
    from kneexo.parameters.quantity import Parameters

Settings = TypeVar("Settings", bound="Parameters")

# Each command imports what it needs: `kneexo --help` and these commands need no Drake.
WITHOUT_DRAKE = ("params", "cache")

EPILOG = """\
examples:
  kneexo reproduce --out results       every figure and number of the paper
  kneexo simulate --out run            the paper's default scenario
  kneexo simulate my.yaml --out run    a scenario of your own
  kneexo params --yaml > my.yaml       a complete scenario file to edit
  kneexo linearize --out margins       stability margins of the sampled loop
  kneexo bandwidth --out response      frequency response, small to large signal
  kneexo robustness --out robust       worst cases over an uncertainty set
  kneexo study contest --out contest   sliding mode against PID, tuned alike
  kneexo size --out size               what a faster knee would take
  kneexo diagram --out pictures        the block diagram

Exit codes: 0 done, 2 wrong input or a run that failed (one line says why),
130 interrupted, 143 terminated.
"""


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows the defaults that tell something."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False, []):
            return action.help
        return super()._get_help_string(action)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    # Before numpy is there: on matrices as small as ours, threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Before Matplotlib is there: it refuses a name that it does not know, and we only write files.
    os.environ["MPLBACKEND"] = "Agg"
    codecs.register_error("kneexo", _escaped)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="kneexo")
    with sigterm_raises():
        options = argparse.Namespace()
        try:
            try:
                return _run(options, arguments)
            finally:
                if sys.stdout is not None:  # None when it was closed
                    sys.stdout.flush()
        except (KeyboardInterrupt, ImportError) as error:
            # An interrupt during the import of Drake arrives as an ImportError that it caused.
            cause = (
                error.__cause__ or error.__context__ if isinstance(error, ImportError) else error
            )
            if not isinstance(cause, KeyboardInterrupt):
                library, unloaded, _ = str(error).partition(": cannot open shared object file")
                if not unloaded:
                    raise
                line = f"this system lacks {library}; install the package that has it"
                print(f"kneexo: {line}", file=sys.stderr)
                return 2
            what, code = (
                ("terminated", 143) if isinstance(cause, Terminated) else ("interrupted", 130)
            )
            print(f"kneexo: {what}; {_left(options)}", file=sys.stderr)
            return code
        except OSError as error:
            if sys.stdout is not None:  # what it still holds would fail again at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            if isinstance(error, BrokenPipeError):  # the reader went away, as with `| head`
                return 0
            with suppress(OSError):
                where = f"{error.filename}: " if error.filename else ""
                print(f"kneexo: {where}{error.strerror or error}", file=sys.stderr)
            return 2


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Characters that a stream's encoding lacks, as JSON writes them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _run(options: argparse.Namespace, arguments: Sequence[str] | None) -> int:
    _parser().parse_args(arguments, options)
    # Drake itself would print a page.
    if options.command not in WITHOUT_DRAKE and (line := system.lacking()):
        print(f"kneexo: {line}", file=sys.stderr)
        return 2
    format_before = warnings.formatwarning
    warnings.formatwarning = _one_line
    try:
        options.run(options)
    except KneexoError as error:
        scenario = getattr(options, "scenario", None)
        where = f"{scenario}: " if scenario and scenario not in str(error) else ""
        kept = _kept(options) if isinstance(error, WorkerError) else ""
        print(f"kneexo: {where}{error}{kept and f'; {kept}'}", file=sys.stderr)
        return 2
    except MemoryError:
        print(
            "kneexo: out of memory; reduce simulation.duration_s, or the processes with --workers",
            file=sys.stderr,
        )
        return 2
    finally:
        warnings.formatwarning = format_before
    return 0


def _one_line(message: Warning | str, *_: Any, **__: Any) -> str:
    return f"kneexo: {message}\n"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="kneexo",
        description="Polycentric knee exoskeleton with electro-hydraulic actuator, on Drake: "
        "reproduces Lee et al. 2020 and simulates designs of your own.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kneexo {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def command(
        name: str, run: Any, text: str, detail: str = "", among: Any = None
    ) -> argparse.ArgumentParser:
        sub = (among or commands).add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}. {detail}".strip(),
            formatter_class=_HelpFormatter,
        )
        sub.add_argument("--json", action="store_true", help="print the result as JSON")
        sub.set_defaults(run=run, command=name)
        return sub

    def add_out(sub: argparse.ArgumentParser, files: str) -> None:
        sub.add_argument(
            "--out",
            metavar="DIR",
            type=Path,
            required=True,
            help=f"directory for {files}; made when missing, files of the same name are replaced",
        )

    def add_scenario(
        sub: argparse.ArgumentParser, default: str = PAPER, engine: bool = True
    ) -> None:
        sub.add_argument(
            "scenario",
            nargs="?",
            metavar="SCENARIO.yaml",
            help=f"scenario file; left out: {default}",
        )
        if engine:
            add_engine(sub)

    def add_engine(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--engine",
            choices=("compiled", "drake"),
            help="run on compiled equations, or through Drake's Simulator, a thousand times "
            "slower; left out: as the integrator in the scenario says",
        )

    def add_workers(sub: argparse.ArgumentParser) -> None:
        where = sub.add_mutually_exclusive_group()
        where.add_argument(
            "--workers", type=int, metavar="N", help="processes; left out: one for each core"
        )
        where.add_argument(
            "--dask",
            metavar="tcp://HOST:PORT",
            help="run on the workers of this Dask cluster instead; they need the same version of "
            "kneexo (pip install 'kneexo[cluster]')",
        )

    def add_sweep(sub: argparse.ArgumentParser, study: Study) -> None:
        add_scenario(sub, study.setup)
        add_out(sub, "figures (PNG, PDF), results (JSON) and report (Markdown)")
        sub.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="NAME=VALUE",
            dest="settings",
            help=f"a setting, by its dotted name; `kneexo params` lists them with their defaults "
            f"after '{study.command}:'. VALUE is YAML: 3, [1, 2]. May be given several times",
        )
        if study.uncertain:
            sub.add_argument(
                "--uncertainty",
                metavar="FILE.yaml",
                help="values by dotted path, each {low, high, scale} or {options}; left out: the "
                "default set (see `kneexo params`)",
            )
        add_workers(sub)
        before = sub.add_mutually_exclusive_group()
        before.add_argument(
            "--resume",
            action="store_true",
            help="go on from the finished pieces that an interrupted run left in the directory; "
            "always so without --restart",
        )
        before.add_argument(
            "--restart", action="store_true", help="delete these finished pieces and begin anew"
        )

    sub = command(
        "reproduce",
        _reproduce,
        "compute every figure and number of the paper",
        "Table 1 and Fig. 5 (linkage), Fig. 9 (ideal sliding mode), Fig. 12 (tracking with SMC and "
        "PID), Fig. 13 (frequency response), and Eq. 27 taken literally at 2 ms. "
        "Takes some seconds; the first time some more, to compile the equations.",
    )
    add_engine(sub)
    add_out(sub, "figures (PNG, PDF), results.json and report.md")
    add_workers(sub)

    sub = command("simulate", _simulate, "run one scenario")
    add_scenario(sub)
    add_out(sub, "signals.csv, metrics.json, scenario.yaml and tracking.png, .pdf")

    sub = command(
        "linearize",
        _linearize,
        "poles, margins and small-signal bandwidth of plant and sampled loop",
        "At a posture; the quantizer is bypassed.",
    )
    add_scenario(sub, engine=False)
    sub.add_argument(
        "--knee-angle", type=float, default=40.0, metavar="DEG", help="posture, knee angle in deg"
    )
    add_out(sub, "linearization.json; loop, nyquist and poles as PNG and PDF")

    def add_study(study: Study, add: Callable[..., argparse.ArgumentParser]) -> None:
        sub = add(study.command.split()[-1], partial(_sweep, study), study.summary, study.detail)
        add_sweep(sub, study)

    studies = None
    for study in STUDIES.values():
        if " " not in study.command:
            add_study(study, command)
            continue
        if studies is None:
            what = commands.add_parser(
                "study",
                help="compare controllers, or the full order with the reduced one",
                formatter_class=_HelpFormatter,
            )
            studies = what.add_subparsers(title="studies", required=True, metavar="STUDY")
        add_study(study, partial(command, among=studies))

    sub = command(
        "params",
        _params,
        "list every parameter with value, unit, range and provenance",
        "Without a scenario file also the settings of all studies. With --schema, editors complete "
        "and check scenario files: save the schema as kneexo.schema.json and begin a file with "
        "the line '# yaml-language-server: $schema=kneexo.schema.json'.",
    )
    add_scenario(sub, engine=False)
    form = sub.add_mutually_exclusive_group()
    form.add_argument("--yaml", action="store_true", help="print a complete scenario file instead")
    form.add_argument(
        "--schema", action="store_true", help="print the JSON schema of scenario files instead"
    )

    sub = command(
        "diagram",
        _diagram,
        "draw the block diagram of a scenario",
        "Always writes closed_loop.dot; also SVG and PNG when Graphviz is installed.",
    )
    add_scenario(sub, engine=False)
    add_out(sub, "closed_loop.dot, .svg and .png")

    sub = command(
        "cache",
        _cache,
        "show or delete the compiled models that are kept on disk",
        "They stand in KNEEXO_CACHE_DIR, else in kneexo below XDG_CACHE_HOME, else in "
        "~/.cache/kneexo. KNEEXO_CACHE_SIZE_MB limits their total size in MiB; left out: 512.",
    )
    sub.add_argument("--clear", action="store_true", help="delete all of them")
    return parser


def _scenario(options: argparse.Namespace, default: Scenario | None = None) -> Scenario:
    from kneexo.parameters import Scenario
    from kneexo.scenario_file import load_scenario

    if options.scenario is None:
        scenario = default or Scenario()
    else:
        scenario = load_scenario(options.scenario)
    return scenario.with_engine(getattr(options, "engine", None))


def _headless() -> None:
    import matplotlib

    matplotlib.use("Agg")


def _executor(options: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """The Dask cluster that was asked for; None leaves the choice to ``--workers``."""
    if options.workers is not None and options.workers < 1:
        from kneexo.errors import ParameterError

        raise ParameterError(f"--workers = {options.workers}: must be at least 1")
    if options.dask is None:
        return nullcontext()
    from kneexo.sweeps.parallel import dask_cluster

    return dask_cluster(options.dask)


def _checkpoint_path(options: argparse.Namespace) -> Path:
    """Where a sweep keeps its finished pieces."""
    return Path(options.out, f"{options.command}.checkpoint.jsonl")


def _kept(options: argparse.Namespace) -> str:
    """What an unfinished sweep has left; empty where it kept nothing."""
    kept = getattr(options, "checkpoint", None)
    if kept is not None:
        return f"{len(kept)} finished pieces are kept in {kept.path}; {_AGAIN}" if kept else ""
    if hasattr(options, "restart") and _checkpoint_path(options).exists():
        return f"finished pieces are kept in {_checkpoint_path(options)}; {_AGAIN}"
    return ""


_AGAIN = "the same command goes on from them"


def _left(options: argparse.Namespace) -> str:
    """What an interrupted command has left."""
    if getattr(options, "written", False):
        return f"the results are in {options.out}"
    return _kept(options) or "nothing was written"


def _results(options: argparse.Namespace) -> AbstractContextManager[Path]:
    """The directory for the results; notes when they are in ``--out``."""
    from kneexo.output import output_directory

    return output_directory(options.out, partial(setattr, options, "written", True))


def _origin(scenario: Scenario, settings: Parameters | None = None) -> dict[str, Any]:
    """What every JSON result begins with: version of kneexo, scenario and settings."""
    given = {} if settings is None else {"settings": settings.model_dump(mode="json")}
    return {"kneexo": __version__, "scenario": scenario.model_dump(mode="json")} | given


def _sweep(study: Study, options: argparse.Namespace) -> None:
    """Run a study whose finished pieces are kept, and write results, report and figures."""
    scenario = _scenario(options, study.scenario)
    settings = _settings(options, study.settings)
    compute = study.compute
    if study.uncertain and options.uncertainty is not None:
        from kneexo.scenario_file import load_uncertainty

        compute = partial(compute, uncertainty=load_uncertainty(options.uncertainty, scenario))
    _headless()
    import matplotlib.pyplot as plt

    from kneexo.output import save_figure, to_json
    from kneexo.sweeps.checkpoint import Checkpoint

    with _executor(options) as executor, _results(options) as directory:
        checkpoint = Checkpoint(_checkpoint_path(options), resume=not options.restart)
        options.checkpoint = checkpoint
        try:
            done = compute(
                scenario,
                settings=settings,
                workers=options.workers,
                executor=executor,
                checkpoint=checkpoint,
                progress=True,
            )
            numbers = to_json(_origin(scenario, settings) | done.results())
            text = study.report(done)
            (directory / f"{study.name}.json").write_text(numbers, encoding="utf-8")
            (directory / f"{study.name}.md").write_text(text, encoding="utf-8")
            for title, figure in study.figures(done).items():
                save_figure(directory, title, figure)
                plt.close(figure)
            written = ", ".join(sorted(file.name for file in directory.iterdir()))
        except BaseException:  # KeyboardInterrupt too: the next process may have the file
            checkpoint.close()
            raise
    others = checkpoint.remove()
    if others:
        print(
            f"kneexo: {others} finished pieces of other settings stay in {checkpoint.path}; "
            f"--restart deletes them",
            file=sys.stderr,
        )
    if options.json:
        print(numbers, end="")
    else:
        print(f"{text}\nIn {options.out}: {written}")


# -------------------------------------------------------------------------------- commands


def _reproduce(options: argparse.Namespace) -> None:
    _headless()
    import matplotlib.pyplot as plt

    from kneexo.analysis.frequency_response import SinestreamSettings
    from kneexo.output import save_figure, to_json
    from kneexo.parameters import Scenario
    from kneexo.studies.reproduce import reproduce, results
    from kneexo.studies.reproduce_figures import figures
    from kneexo.studies.reproduce_report import report

    with _executor(options) as executor, _results(options) as directory:
        done = reproduce(
            engine=options.engine, workers=options.workers, executor=executor, progress=True
        )
        numbers = results(done)
        base = Scenario().with_engine(options.engine)
        document = to_json(_origin(base, SinestreamSettings()) | numbers)
        (directory / "results.json").write_text(document, encoding="utf-8")
        text = report(numbers)
        (directory / "report.md").write_text(text, encoding="utf-8")
        for name, figure in figures(done).items():
            save_figure(directory, name, figure)
            plt.close(figure)
    if options.json:
        print(document, end="")
    else:
        print(text)
        print(f"In {options.out}: the figures, results.json, report.md")


def _simulate(options: argparse.Namespace) -> None:
    scenario = _scenario(options)
    _headless()
    from dataclasses import asdict

    from kneexo.analysis import track
    from kneexo.output import save_figure, to_json, write_csv
    from kneexo.scenario_file import dump_scenario
    from kneexo.studies.markdown import number

    with _results(options) as directory:
        if scenario.simulation.compiled:
            result = track(scenario, all_signals=True)
        else:
            result = _track_with_bar(scenario)
        metrics = to_json(_origin(scenario) | asdict(result.metrics))
        (directory / "metrics.json").write_text(metrics, encoding="utf-8")
        (directory / "scenario.yaml").write_text(dump_scenario(scenario), encoding="utf-8")
        write_csv(directory / "signals.csv", result.run)
        save_figure(directory, "tracking", result.plot()[0].figure)
    if options.json:
        print(metrics, end="")
        return
    for name, value in asdict(result.metrics).items():
        print(f"{name:28s} {number(value, '.6g')}")
    print(f"In {options.out}: signals.csv, metrics.json, scenario.yaml, tracking.png, tracking.pdf")


def _track_with_bar(scenario: Scenario) -> TrackingResult:
    from tqdm import tqdm

    from kneexo.analysis import track
    from kneexo.diagrams import make_closed_loop

    make_closed_loop(scenario)  # what is wrong with it shows before the progress bar
    with tqdm(
        total=scenario.simulation.duration_s,
        desc="simulated time",
        mininterval=0.5,
        bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}",
    ) as bar:
        return track(scenario, all_signals=True, progress=lambda time: bar.update(time - bar.n))


def _linearize(options: argparse.Namespace) -> None:
    scenario = _scenario(options)
    _headless()
    from dataclasses import asdict

    from kneexo.analysis import linearize_loop, linearize_plant
    from kneexo.output import save_figure, to_json

    with _results(options) as directory:
        plant = linearize_plant(scenario.plant, options.knee_angle)
        loop = linearize_loop(scenario, options.knee_angle)
        frequency, damping = plant.damping
        text = to_json(
            {
                **_origin(scenario),
                "settings": {"knee_angle_deg": options.knee_angle},
                "operating_point": asdict(plant.operating_point),
                "plant_poles_per_s": [[p.real, p.imag] for p in plant.poles],
                "plant_frequencies_rad_s": frequency,
                "plant_damping_ratios": damping,
                "plant_velocity_gain": plant.velocity_gain,
                "loop_eigenvalues": [[z.real, z.imag] for z in loop.eigenvalues],
                "margins": asdict(loop.margins()),
                "bandwidth_hz": loop.bandwidth_hz() if loop.stable else None,
            }
        )
        (directory / "linearization.json").write_text(text, encoding="utf-8")
        axes = {"loop": loop.plot()[0], "nyquist": loop.plot_nyquist(), "poles": loop.plot_poles()}
        for name, ax in axes.items():
            save_figure(directory, name, ax.figure)
    if options.json:
        print(text, end="")
        return
    print(f"plant: {plant}\nloop: {loop}")
    print(f"In {options.out}: linearization.json; loop, nyquist and poles as PNG and PDF")


def _settings(options: argparse.Namespace, cls: type[Settings]) -> Settings:
    """The settings of a study with what ``--set`` changes."""
    from kneexo.errors import ParameterError
    from kneexo.parameters.paths import changed
    from kneexo.scenario_file import read_value

    values = {}
    for text in options.settings:
        name, separator, value = text.partition("=")
        if not separator:
            raise ParameterError(f"--set {text}: must be NAME=VALUE")
        values[name] = read_value(f"--set {name}", value)
    return changed(cls(), values)


def _params(options: argparse.Namespace) -> None:
    scenario = _scenario(options)
    if options.yaml:
        from kneexo.scenario_file import dump_scenario

        print(dump_scenario(scenario), end="")
        return
    if options.schema:
        from kneexo.schema import json_schema

        print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
        return
    rows = list(_parameter_rows(scenario, others=options.scenario is None))
    if options.scenario is None:
        from kneexo.analysis.frequency_response import SinestreamSettings

        rows += _parameter_rows(SinestreamSettings(), "reproduce, Fig. 13: ")
        for study in STUDIES.values():
            rows += _parameter_rows(study.settings(), f"{study.command}: ")
        rows += _uncertainty_rows()
    if options.json:
        document = {**_origin(scenario), "parameters": rows}
        print(json.dumps(document, indent=2, ensure_ascii=False))
        return
    for row in rows:
        bounds = f"  [{row['range']}]" if row["range"] else ""
        unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
        value = f"{row['value']:.10g}" if isinstance(row["value"], float) else row["value"]
        print(f"{row['parameter']} = {value}{unit}{bounds}\n    {row['provenance']}")


def _uncertainty_rows() -> Iterator[dict[str, Any]]:
    """The default uncertainty set."""
    from kneexo.parameters import UNCERTAINTY

    for path, one in UNCERTAINTY.values.items():
        yield {
            "parameter": f"uncertainty: {path}",
            "value": list(one.options) or [one.low, one.high],
            "unit": "",
            "range": "one of these" if one.options else f"from, to; {one.scale}",
            "provenance": one.source + ("; known to the controller" if one.known else ""),
        }


def _parameter_rows(
    model: BaseModel | type[BaseModel], path: str = "", others: bool = False
) -> Iterator[dict[str, Any]]:
    """Every number and choice of a parameter object or class, with what is known of it.

    ``others``: also the kinds that are not chosen, with their defaults.
    """
    from pydantic import BaseModel

    from kneexo.parameters.quantity import allowed_range, models_of, source_of, unit_of

    cls = model if isinstance(model, type) else type(model)
    for name, field in cls.model_fields.items():
        required = isinstance(model, type) and field.is_required()
        default = "(required)" if required else field.default
        value = default if isinstance(model, type) else getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _parameter_rows(value, f"{path}{name}.", others)
            if others and field.discriminator:
                for other in models_of(field):
                    if other is not type(value):
                        kind = other.model_fields["kind"].default
                        yield from _parameter_rows(other, f"{path}{name}({kind}).")
        elif source_of(field):
            yield {
                "parameter": path + name,
                "value": value,
                "unit": unit_of(field),
                "range": allowed_range(field),
                "provenance": source_of(field),
            }


def _diagram(options: argparse.Namespace) -> None:
    scenario = _scenario(options)
    from kneexo.diagrams import make_closed_loop

    diagram = make_closed_loop(scenario)
    graphviz = shutil.which("dot")
    with _results(options) as directory:
        source = directory / "closed_loop.dot"
        source.write_text(diagram.GetGraphvizString(), encoding="utf-8")
        if graphviz:
            for kind in ("svg", "png"):
                picture = source.with_suffix(f".{kind}")
                done = subprocess.run(
                    [graphviz, f"-T{kind}", source, "-o", picture], capture_output=True, text=True
                )
                if done.returncode:
                    picture.unlink(missing_ok=True)
                    reason = (done.stderr.splitlines() or ["no message"])[0]
                    print(f"kneexo: Graphviz could not draw the {kind}: {reason}", file=sys.stderr)
        written = sorted(file.name for file in directory.iterdir())
    if options.json:
        print(json.dumps({**_origin(scenario), "directory": str(options.out), "files": written}))
        return
    print(
        f"{', '.join(written)} are in {options.out}"
        if graphviz
        else f"{written[0]} is in {options.out}"
    )
    if not graphviz:
        print(
            "For a picture install Graphviz (Debian, Ubuntu: apt-get install graphviz) and run "
            "this again.",
            file=sys.stderr,
        )


def _cache(options: argparse.Namespace) -> None:
    import time

    from kneexo.compilation import cache

    directory = cache.cache_directory()
    if options.clear:
        count = cache.clear()
        if options.json:
            document = {"kneexo": __version__, "directory": str(directory), "deleted": count}
            print(json.dumps(document))
        else:
            print(f"{directory}: {count} {'entry' if count == 1 else 'entries'} deleted")
        return
    entries, limit_bytes = cache.entries(), cache.size_limit()
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
