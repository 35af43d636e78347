"""Makes a command from each study of `kneexo.studies.catalogue`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kneexo.command_line import arguments
from kneexo.command_line.arguments import ScenarioChoice
from kneexo.command_line.html_page import ReportPage
from kneexo.command_line.outcome import FILES, Outcome, files_line
from kneexo.command_line.plain_text import head_of, plain_text
from kneexo.common.progress import Stage, progress_bar, whole_bar
from kneexo.errors import ParameterError
from kneexo.studies.catalogue import Study
from kneexo.studies.markdown import failure_file

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from kneexo.sweeps.checkpoint import Checkpoint

FIGURES = "figures"
"""Description of the progress bar of drawing a study's figures."""


def add_studies(subparsers: Any, studies: Iterable[Study]) -> None:
    """Add a command for each study.

    A name of two words, such as ``study contest``, adds the command ``contest`` to the group
    ``study``.
    """
    groups = {"": subparsers}
    for study in studies:
        group, _, name = study.command.rpartition(" ")
        if group not in groups:
            summary = "answer a question by many runs: speed, robustness, mechanism, wearer"
            groups[group] = arguments.add_group(subparsers, group, summary, "STUDY")
        _add_study(groups[group], name, study)


def _add_study(group: Any, name: str, study: Study) -> None:
    def checkpoint_path(options: argparse.Namespace) -> Path:
        return arguments.out(options) / f"{name}.checkpoint.jsonl"

    drawing, writing = Stage(FIGURES, study.drawing_s), Stage(FILES, study.writing_s)
    stages = (*study.stages, drawing, writing)
    parser = arguments.add_command(
        group,
        name,
        partial(run_study, study),
        study.summary,
        study.detail,
        directory=arguments.out,
        checkpoint_path=checkpoint_path if study.resumable else None,
        restart=lambda options: study.resumable and options.restart,
        uses_workers=True,
        progress=lambda options: partial(whole_bar, study.name, stages),
        duration_s=sum(stage.duration_s for stage in stages),
    )
    if study.takes_scenario:
        arguments.add_scenario(parser, study.setup or arguments.PAPER)
    arguments.add_engine(parser)
    arguments.add_out(parser, "figures (PNG, PDF), results (JSON) and report (Markdown)")
    arguments.add_html(parser)
    label = study.label or study.command
    listed = f"`kneexo params` lists them with their defaults after '{label}:'"
    arguments.add_set(parser, f"a setting, by its dotted name; {listed}", "settings")
    if study.uncertain:
        parser.add_argument(
            "--uncertainty",
            metavar="FILE.yaml",
            help="values by dotted path, each {low, high, scale} or {options}; left out: the "
            "default set (see `kneexo params`)",
        )
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument(
        "--workers",
        type=arguments.integer,
        metavar="N",
        help="processes; left out: one for each core",
    )
    workers.add_argument(
        "--dask",
        metavar="tcp://HOST:PORT",
        help="run on the workers of this Dask cluster instead; they need the same version of "
        "kneexo (pip install distributed)",
    )
    if study.resumable:
        parser.add_argument(
            "--restart",
            action="store_true",
            help="begin anew; left out: go on from the finished pieces that an interrupted run "
            "left in the directory",
        )


def run_study(
    study: Study,
    choice: ScenarioChoice,
    settings: Sequence[str],
    out: Path,
    page: ReportPage | None,
    workers: int | None,
    dask: str | None,
    uncertainty: str | None = None,
    checkpoint: Checkpoint | None = None,
) -> Outcome:
    """Run a study; return results, report and figures. If ``page`` is given, add an HTML page.

    The text of the outcome has the findings, with which the report begins, and where the files are.
    ``choice`` selects the scenario. ``settings`` changes settings of the study, each by NAME=VALUE.
    ``workers`` is the number of processes, by default the number of cores. If ``dask`` is the
    address of a Dask cluster, the cluster replaces the processes. If the study is `uncertain`,
    ``uncertainty`` is the path of a file of uncertain values. If the study is `resumable`,
    ``checkpoint`` stores its finished pieces.
    """
    computation = study.computation()
    scenario = choice.load(computation.scenario)
    changed = arguments.with_values(computation.settings(), settings)
    compute = computation.compute
    from kneexo.parameters.scenario_file import load_uncertainty, scenario_files

    if uncertainty is not None:
        compute = partial(compute, uncertainty=load_uncertainty(uncertainty, scenario))
    from kneexo.command_line.output import to_json

    shown = study.presentation()  # imports Matplotlib: if this fails, it fails before the work
    if checkpoint is not None:
        compute = partial(compute, checkpoint=checkpoint)
    with _executor(workers, dask) as executor:
        result = compute(
            scenario, settings=changed, workers=workers, executor=executor, progress=True
        )
    origin = arguments.origin_of(scenario, changed)
    document = to_json(origin | result.results())
    report = shown.report(result)
    results_file, report_file = study.files
    files: dict[str, str | bytes] = {
        results_file or f"{study.name}.json": document,
        report_file or f"{study.name}.md": report,
    }
    with progress_bar(1.0, FIGURES):
        figures = shown.figures(result)
    if page is not None:
        files |= page.file(report, figures, origin, shown.motions(result))
    for number, failed in enumerate(shown.failed_runs(result).values(), start=1):
        files |= scenario_files(failed, failure_file(number), out)
    for file_name, made in shown.scenarios(result).items():
        files |= scenario_files(made, file_name, out)
    text = f"{plain_text(head_of(report))}\n{files_line(out, files, figures)}"
    return Outcome(text, document, files=files, figures=figures)


def _executor(workers: int | None, dask: str | None) -> AbstractContextManager[Executor | None]:
    """Context manager: give the Dask cluster at the address ``dask``, or None without address.

    A study that gets None starts processes. Raises `ParameterError` if ``workers`` is less than 1.
    """
    if workers is not None and workers < 1:
        raise ParameterError(f"--workers = {workers}: must be at least 1")
    if dask is None:
        return nullcontext()
    from kneexo.sweeps.parallel import dask_cluster

    return dask_cluster(dask)
