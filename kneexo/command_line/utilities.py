"""The commands ``params``, ``diagram`` and ``cache``."""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

from kneexo.command_line.options import (
    ScenarioChoice,
    add_command,
    add_out,
    add_scenario,
    origin_of,
    scenario_choice,
    scenario_request,
)
from kneexo.command_line.outcome import Outcome, Request
from kneexo.errors import shown
from kneexo.version import __version__


def add_utilities(subparsers: Any) -> None:
    """Add ``params``, ``diagram`` and ``cache``."""
    parser = add_command(
        subparsers,
        "params",
        _params_request,
        "list every parameter with value, unit, range and provenance",
        "Without a scenario file also the settings of all studies. With --schema, editors complete "
        "and check scenario files: save the schema as kneexo.schema.json and begin a file with "
        "the line '# yaml-language-server: $schema=kneexo.schema.json'.",
    )
    add_scenario(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--yaml", action="store_true", help="print a complete scenario file instead")
    form.add_argument(
        "--schema", action="store_true", help="print the JSON schema of scenario files instead"
    )

    parser = add_command(
        subparsers,
        "diagram",
        _diagram_request,
        "draw the block diagram of a scenario",
        "Always writes closed_loop.dot; also SVG and PNG when Graphviz is installed.",
    )
    add_scenario(parser)
    add_out(parser, "closed_loop.dot, .svg and .png")

    parser = add_command(
        subparsers,
        "cache",
        _cache_request,
        "show or delete the compiled models that are kept on disk",
        "They stand in KNEEXO_CACHE_DIR, else in kneexo below XDG_CACHE_HOME, else in "
        "~/.cache/kneexo. KNEEXO_CACHE_SIZE_MB limits their total size in MiB; left out: 512.",
    )
    parser.add_argument("--clear", action="store_true", help="delete all of them")


def _params_request(options: argparse.Namespace) -> Request:
    form = "yaml" if options.yaml else "schema" if options.schema else "list"
    choice = scenario_choice(options)
    with_settings = form == "list" and choice.path is None  # those of studies, which import Drake
    return scenario_request(options, partial(params, choice, form), uses_drake=with_settings)


def _diagram_request(options: argparse.Namespace) -> Request:
    run = partial(diagram, scenario_choice(options), out=options.out)
    return scenario_request(options, run, directory=options.out)


def _cache_request(options: argparse.Namespace) -> Request:
    run = clear_cache if options.clear else cache
    return Request(run, json=options.json, uses_drake=False)


def params(choice: ScenarioChoice, form: str) -> Outcome:
    """Return all parameters as a ``"list"``, or the text of a ``"yaml"`` file or a ``"schema"``.

    The list has the settings of all studies too if the user named no scenario file.
    """
    scenario = choice.load()
    if form == "yaml":
        from kneexo.parameters.scenario_file import dump_scenario

        return Outcome(dump_scenario(scenario))
    if form == "schema":
        from kneexo.parameters.schema import json_schema

        return Outcome(json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n")
    from kneexo.command_line.parameter_list import parameter_rows, setting_rows, uncertainty_rows

    rows = list(parameter_rows(scenario, all_kinds=choice.path is None))
    if choice.path is None:
        rows += [*setting_rows(), *uncertainty_rows()]
    lines = []
    for row in rows:
        bounds = f"  [{row['range']}]" if row["range"] else ""
        unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
        value = f"{row['value']:.10g}" if isinstance(row["value"], float) else row["value"]
        lines.append(f"{row['parameter']} = {value}{unit}{bounds}\n    {row['provenance']}\n")
    document = {**origin_of(scenario), "parameters": rows}
    return Outcome("".join(lines), json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def diagram(choice: ScenarioChoice, *, out: Path) -> Outcome:
    """Return the block diagram as a Graphviz file, and as pictures if Graphviz is installed."""
    scenario = choice.load()
    from kneexo.diagrams import make_closed_loop

    text = make_closed_loop(scenario).GetGraphvizString()
    files: dict[str, str | bytes] = {"closed_loop.dot": text}
    notices = []
    graphviz = shutil.which("dot")
    for kind in ("svg", "png") if graphviz else ():
        process = subprocess.run(
            [str(graphviz), f"-T{kind}"], input=text.encode(), capture_output=True
        )
        if process.returncode:
            reason = (process.stderr.decode("utf-8", "replace").splitlines() or ["no message"])[0]
            notices.append(f"kneexo: Graphviz could not draw the {kind}: {reason}")
        else:
            files[f"closed_loop.{kind}"] = process.stdout
    names = sorted(files)
    advice = (
        "For a picture install Graphviz (Debian, Ubuntu: apt-get install graphviz) and run this "
        "again."
    )
    document = {**origin_of(scenario), "directory": str(out), "files": names}
    verb = "are" if len(names) > 1 else "is"
    line = f"{', '.join(names)} {verb} in {shown(out)}\n"
    return Outcome(
        line,
        json.dumps(document) + "\n",
        notices,
        advice="" if graphviz else advice,
        files=files,
    )


def cache() -> Outcome:
    """Return size, limit and last use of the compiled models on disk."""
    import time

    from kneexo.compiler.native import cache as models

    directory = models.cache_directory()
    entries, limit_bytes = models.entries(), models.size_limit()
    size_bytes = sum(entry.size_bytes for entry in entries)
    document = {
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
    lines = [
        f"directory  {directory}",
        f"entries    {len(entries)}",
        f"size       {size_bytes / 2**20:.1f} of at most {limit_bytes / 2**20:.0f} MiB",
    ]
    if entries:
        lines.append("used last")
    for entry in entries[:5]:
        last_use = time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.last_use_s))
        lines.append(f"  {last_use}  {entry.size_bytes / 2**10:8.1f} KiB  {entry.path.name}")
    return Outcome("\n".join(lines) + "\n", json.dumps(document, indent=2) + "\n")


def clear_cache() -> Outcome:
    """Delete the compiled models on disk; return their number."""
    from kneexo.compiler.native import cache as models

    directory = models.cache_directory()
    count = models.clear()
    document = {"kneexo": __version__, "directory": str(directory), "deleted": count}
    text = f"{directory}: {count} {'entry' if count == 1 else 'entries'} deleted\n"
    return Outcome(text, json.dumps(document) + "\n")
