"""Exports two models with a program in C that closes their loop: software in the loop."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import CompilationError
from ..files import write_files
from .build import REQUIRED_FLAGS, USUAL_FLAGS, BuildError, Replay, replay
from .export import REPLAY_TOLERANCES, Measurement, exported, require_export_folder
from .manifest import FILE as MANIFEST, manifest
from .printer import DOUBLE, literal
from .source import CSource
from .template import rendered
from .vectors import Vectors

_SIL = "sil"


@dataclass(frozen=True)
class SilMeasurement:
    """Measurements of both models, and the comparison of their loop in C with the test vectors."""

    controller: Measurement
    plant: Measurement
    replay: Replay | None
    """Differences of the outputs of both models; None if the program cannot be built."""


@dataclass(frozen=True)
class Sil:
    """A sampled controller and its plant as models in C, with test vectors of their closed loop.

    An input of one model that has the name of an output of the other model gets this output. All
    other inputs come from the test vectors.

    Parameters
    ----------
    controller, plant
        The models, with test vectors from the same run.
    counts
        Dictionary from an integer input of the controller to an output of the plant and the size of
        a count: the input is the output divided by this size, rounded to a whole number.

    Raises
    ------
    CompilationError
        The models have the same name, different ticks or test vectors of different length. Or no
        output of one model is an input of the other one.
    """

    controller: tuple[CSource, Vectors]
    plant: tuple[CSource, Vectors]
    counts: Mapping[str, tuple[str, float]]

    def __post_init__(self) -> None:
        """Check that the models form a loop."""
        (controller, controller_vectors), (plant, plant_vectors) = self.controller, self.plant
        names = f"{controller.name}, {plant.name}"
        ticks = controller.plan.schedule.tick_s, plant.plan.schedule.tick_s
        if controller.name == plant.name:
            raise CompilationError(f"{names}: two models need different names")
        if ticks[0] != ticks[1]:
            raise CompilationError(f"{names}: have ticks of {ticks[0]:g} and {ticks[1]:g} s")
        if len(controller_vectors.inputs) != len(plant_vectors.inputs):
            raise CompilationError(f"{names}: have test vectors of different length")
        if not (self._measured and self._actuated):
            raise CompilationError(f"{names}: no output of one is an input of the other")

    @property
    def _measured(self) -> list[tuple[str, str]]:
        """Inputs of the controller, each with the C text that computes it from the plant."""
        (controller, _), (plant, _) = self.controller, self.plant
        outputs = {field.name for field in plant.plan.outputs}
        values = {name: f"({controller.name}_real_t)signals.{name}" for name in outputs}
        for name, (output, size) in self.counts.items():
            if output in outputs:
                count = f"(double)signals.{output} / {literal(size, DOUBLE, name)}"
                values[name] = f"(int32_t)lround({count})"
        names = [field.name for field in controller.plan.inputs]
        return [(name, values[name]) for name in names if name in values]

    @property
    def _actuated(self) -> list[str]:
        """Inputs of the plant that are outputs of the controller."""
        (controller, _), (plant, _) = self.controller, self.plant
        commands = {field.name for field in controller.plan.outputs}
        return [field.name for field in plant.plan.inputs if field.name in commands]

    def files(self) -> dict[str, str]:
        """Return a dictionary from file name to text: program, Makefile and manifest."""
        sources = self.controller[0], self.plant[0]
        names = [source.name for source in sources]
        precision = "float" if any(s.precision == "float" for s in sources) else "double"
        first_line = f"{sources[0].first_line}, with {sources[1].name}"
        data = {
            "first_line": first_line,
            "controller": sources[0],
            "plant": sources[1],
            "outputs": [(s.name, field) for s in sources for field in s.plan.outputs],
            "measured": self._measured,
            "actuated": self._actuated,
            "tolerance": REPLAY_TOLERANCES[precision],
            "flags": {"required": REQUIRED_FLAGS, "usual": USUAL_FLAGS},
            "folders": names,
            "sources": [
                f"{name}/{name}{end}.c" for name in names for end in ("", "_params", "_vectors")
            ],
        }
        files = {f"{_SIL}.c": f"{_SIL}.c", "Makefile": f"{_SIL}.mk"}
        texts = {file: rendered(__package__, template, **data) for file, template in files.items()}
        return texts | {MANIFEST: manifest(first_line, sources[0].tool, {"name": _SIL}, texts)}


def require_sil_folder(directory: str | os.PathLike[str], *names: str) -> None:
    """Raise `OutputError` unless a directory is missing, empty or an earlier export by `write_sil`.

    ``names`` are the names of the loop's two models. Each has a subfolder, for which
    `require_export_folder` has the same rule.
    """
    require_export_folder(directory, _SIL)
    for name in names:
        require_export_folder(Path(directory, name), name)


def write_sil(directory: str | os.PathLike[str], sil: Sil) -> SilMeasurement:
    """Build, run and measure both models and their loop, and write the folder.

    Each model has a subfolder with its name, as `write_c` writes it. No file is written before both
    models and the program are complete. Raises the errors of `write_c`.
    """
    folder, loop_files = Path(directory), sil.files()
    sources = sil.controller[0], sil.plant[0]
    exports = [exported(source, vectors) for source, vectors in (sil.controller, sil.plant)]
    code = {
        name: text
        for files, _ in exports
        for name, text in files.items()
        if name.endswith((".c", ".h")) and not name.endswith("_test.c")
    }
    try:
        comparison = replay(_SIL, code | {f"{_SIL}.c": loop_files[f"{_SIL}.c"]})
    except BuildError:  # which both measurements report
        comparison = None
    require_sil_folder(folder, *(source.name for source in sources))
    # The manifest of the loop is written first. With it a call that was killed can be repeated.
    write_files(folder, loop_files)
    for source, (files, _) in zip(sources, exports, strict=True):
        write_files(folder / source.name, files)
    controller, plant = (measurement for _, measurement in exports)
    return SilMeasurement(controller, plant, comparison)
