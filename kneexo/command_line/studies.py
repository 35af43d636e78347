"""Makes a command from each study of `kneexo.studies.catalogue`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from typing import TYPE_CHECKING, Any

from diagramc import available_cores
from kneexo.command_line import arguments
from kneexo.command_line.delivery import FILES
from kneexo.command_line.html_page import page_file
from kneexo.command_line.outcome import Outcome, files_line
from kneexo.command_line.plain_text import head_of, plain_text
from kneexo.command_line.request import Request, origin_of, with_values
from kneexo.common.progress import Stage, progress_bar
from kneexo.errors import ParameterError
from kneexo.studies.catalogue import Study
from kneexo.studies.markdown import failure_file

if TYPE_CHECKING:
    from concurrent.futures import Executor

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
    drawing, writing = Stage(FIGURES, study.drawing_s), Stage(FILES, study.writing_s)
    stages = (*study.stages, drawing, writing)
    parser = arguments.add_command(
        group,
        name,
        run_study,
        study.summary,
        study.detail,
        duration_s=sum(stage.duration_s for stage in stages),
        study=study,
        first=first_request,
        stages=stages,
        resumable=study.resumable,
        fills_directory=True,
    )
    for name, (metavar, text) in study.arguments.items():
        count = None if name.startswith("-") else "?"
        parser.add_argument(name, nargs=count, metavar=metavar, help=text)
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


_LEAST = 10
"""Smallest number of plants that give a first answer."""

_TOLD_S = 60.0
"""A study whose typical duration in s is longer tells this duration before it starts."""


def first_request(request: Request) -> Request | None:
    """Return the request for a tenth of a study's plants, or None if a tenth is too few."""
    settings = with_values(request.study.computation().settings(), request.settings)
    tenths = {name: getattr(settings, name) // 10 for name in request.study.amounts}
    if min(tenths.values(), default=0) < _LEAST:
        return None
    first = copy(request)
    texts = [f"{name}={number}" for name, number in tenths.items()]
    first.settings, first.first_answer = [*request.settings, *texts], ", ".join(texts)
    return first


def run_study(request: Request) -> Outcome:
    """Run a study; return results, report and figures. With ``--html`` add an HTML page.

    A long study first tells its typical duration on stderr.

    The text of the outcome has the findings, with which the report begins, and where the files are.
    """
    study: Study = request.study
    options: dict[str, Any] = {}
    if request.checkpoint_path is not None:
        from kneexo.sweeps.checkpoint import Checkpoint

        path, resume = request.checkpoint_path, not request.restart
        options["checkpoint"] = request.checkpoint = Checkpoint(path, resume=resume)
    computation = study.computation()
    scenario = request.load(request.scenario, computation.scenario)
    for name in study.arguments:
        if (text := getattr(request, name.lstrip("-"))) is not None:
            value = text.split(",") if name.startswith("-") else text
            change = f"{name.lstrip('-')}={json.dumps(value, ensure_ascii=False)}"
            request.settings = [change, *request.settings]
    settings = with_values(computation.settings(), request.settings)
    from kneexo.parameters.scenario_file import load_uncertainty, scenario_files

    if study.uncertain and request.uncertainty is not None:
        options["uncertainty"] = load_uncertainty(request.uncertainty, scenario)
    from kneexo.command_line.output import to_json

    shown = study.presentation()  # imports Matplotlib: if this fails, it fails before the work
    duration_s = sum(stage.duration_s for stage in request.stages)
    if duration_s > _TOLD_S and not request.answered:
        words = f"with default settings about {arguments.rounded(duration_s)} on two cores"
        sys.stderr.write(f"kneexo: {words}; this machine has {available_cores()}\n")
    with _executor(request.workers, request.dask) as executor:
        result = computation.compute(
            scenario,
            settings=settings,
            workers=request.workers,
            executor=executor,
            progress=True,
            **options,
        )
    origin = origin_of(scenario, settings)
    document = to_json(origin | result.results())
    report = shown.report(result)
    results_file, report_file = study.files
    files: dict[str, str | bytes] = {
        results_file or f"{study.name}.json": document,
        report_file or f"{study.name}.md": report,
    }
    with progress_bar(1.0, FIGURES):
        figures = shown.figures(result)
    if request.html:
        files |= page_file(request, report, figures, origin, shown.motions(result))
    for number, failed in enumerate(shown.failed_runs(result).values(), start=1):
        files |= scenario_files(failed, failure_file(number), request.out)
    for file_name, made in shown.scenarios(result).items():
        files |= scenario_files(made, file_name, request.out)
        files[file_name] = f"{shown.comments(result)}{files[file_name]!s}"
    text = f"{plain_text(head_of(report))}\n{files_line(request.out, files, figures)}"
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
