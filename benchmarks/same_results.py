"""Compare what two trees compute: every command's JSON, number by number.

    python benchmarks/same_results.py OLD NEW [--only NAME ...] [--renamed OLD=NEW ...]

``OLD`` and ``NEW`` are checkouts of kneexo. Each command runs with small settings in both; its
``--json`` (or its JSON file) is compared with equal keys, texts and bits of numbers. Prints each
difference; exit code 1 if there is any. ``kneexo`` (the version) is left out. ``--renamed``
replaces words in the keys of the old tree's results first.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FEW = ["--set", "samples=12", "--set", "corners_max=12", "--set", "sensitivity_duration_s=4"]
SCENARIO = """\
plant: {linkage: G3, cylinder: {mass_kg: 1.7}, load: {kind: knee}}
controller: {kind: pid, proportional_per_s: 14, integral_per_s2: 400, filter_s: 0.015}
reference: {kind: sine, amplitude_deg: 20, frequency_hz: 0.2}
simulation: {duration_s: 6}
"""
COMMANDS: dict[str, list[str]] = {
    "reproduce": ["reproduce"],
    "simulate": ["simulate"],
    "simulate, scenario": ["simulate", "{scenario}"],
    "simulate, drake": ["simulate", "{scenario}", "--engine", "drake"],
    "linearize": ["linearize"],
    "linearize, scenario": ["linearize", "{scenario}", "--knee-angle", "55"],
    "bandwidth": [
        *("study", "bandwidth", "--set", "amplitudes_deg=[0.3, 3, 30]"),
        *("--set", "frequencies_hz=[0.2, 2, 8]"),
    ],
    "robustness": ["study", "robustness", *FEW],
    "controller": [
        *("study", "controller", "--set", "lambdas_per_s=[10, 20]", "--set", "phis_m_s2=[3.2, 10]"),
        *("--set", "etas_m_s3=[8.9e4, 2.8e5]", "--set", "map_slopes_per_s=[1e4, 1e5]"),
        *("--set", "map_time_constants_s=[0.008, 0.016]"),
    ],
    "contest": [
        *("study", "contest", "--set", "population=5", "--set", "generations=2"),
        *("--set", "test_samples=4", "--set", "training_samples=2"),
        *("--set", "optimizer_seeds=[1]", "--set", "duration_s=10"),
    ],
    "size": ["size", "--set", "factors=[0.5, 1, 2]", "--set", "cycles=2"],
    "params": ["params"],
}


def result(tree: Path, command: list[str], folder: Path) -> Any:
    """Run a command of a tree; return the JSON that it prints."""
    scenario = folder / "scenario.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    words = [word.replace("{scenario}", str(scenario)) for word in command]
    out = [] if command[0] == "params" else ["--out", str(folder / "out")]
    done = subprocess.run(
        [sys.executable, "-m", "kneexo", *words, *out, "--json"],
        env=os.environ | {"PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        cwd=folder,
    )
    if done.returncode:
        raise SystemExit(f"{tree}: {' '.join(command)}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def with_renamed_keys(value: Any, names: dict[str, str]) -> Any:
    """Return a JSON value whose dictionaries have other keys where ``names`` has their words."""
    if isinstance(value, list):
        return [with_renamed_keys(item, names) for item in value]
    if not isinstance(value, dict):
        return value
    words = {key: "_".join(names.get(word, word) for word in key.split("_")) for key in value}
    return {words[key]: with_renamed_keys(item, names) for key, item in value.items()}


def differences(old: Any, new: Any, path: str = "") -> Iterator[str]:
    """Yield path and both values for each difference of two JSON values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(key for key in new if key not in old)]:
            if key in old and key in new:
                yield from differences(old[key], new[key], f"{path}.{key}")
            elif path or key != "kneexo":
                yield f"{path}.{key}: only in the {'old' if key in old else 'new'} one"
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, f"{path}[{index}]")
    elif old != new and path != ".kneexo":
        yield f"{path}: {str(old)[:60]} -> {str(new)[:60]}"


def numbers(value: Any) -> int:
    """Count the numbers in a JSON value."""
    if isinstance(value, dict):
        return sum(map(numbers, value.values()))
    if isinstance(value, list):
        return sum(map(numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def main() -> int:
    """Run the commands in both trees; return 1 if any results differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--only", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--renamed", nargs="*", default=[], metavar="OLD=NEW")
    options = parser.parse_args()
    names = dict(pair.split("=") for pair in options.renamed)
    count = 0
    for name in options.only:
        with tempfile.TemporaryDirectory() as folder:
            values = []
            for label in ("old", "new"):
                place = Path(folder, label)
                place.mkdir()
                tree = getattr(options, label).resolve()
                values.append(result(tree, COMMANDS[name], place))
        values[0] = with_renamed_keys(values[0], names)
        changes = list(differences(*values))
        print(f"{name}: {numbers(values[0])} numbers, {len(changes)} differences", flush=True)
        for line in changes[:50]:
            print(f"    {line}")
        count += len(changes)
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main())
