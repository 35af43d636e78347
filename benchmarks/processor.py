"""Exported controllers and a stiff plant on an emulated microcontroller.

    python benchmarks/processor.py

A row of differences, instructions and memory for each processor, model and precision. The stiff
plant is that of preset leg, by the Rosenbrock method. The harness replays the test vectors under
QEMU, built by arm-none-eabi-gcc with -O2: the largest difference of a command. QEMU counts the
instructions of each step (mean and largest) and sees how deep the stack goes, C library included.
Flash is that of the model, its parameters and what it needs of the C library; RAM is its state
and outputs.

The share of the sample time is that of the largest step at the clock of the processor, with
`CYCLES` cycles an instruction: an assumption, for QEMU does not tell cycles. A Cortex-M4F takes one
cycle for most instructions, two for loads, 14 for a division or square root, and waits for flash.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagramc.c.export import files_of
from kneexo.export.firmware import make_firmware
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import with_preset

FOLDER = Path(__file__).with_name("cortex_m")
GCC, SIZE, QEMU = "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm"
FLAGS = ("-std=gnu99", "-O2", "-ffp-contract=off", "-ffunction-sections", "-mthumb")
CYCLES = 2.0
RPM = 2.0 * math.pi / 60.0
SECONDS = 60
"""After which a run under QEMU counts as hung."""


@dataclass(frozen=True)
class Processor:
    """A processor, a board of QEMU that has it, and the clock of a usual microcontroller."""

    name: str
    board: str
    options: tuple[str, ...]
    clock_hz: float


M4F = Processor(
    "Cortex-M4F",
    "mps2-an386",
    ("-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
    168e6,  # STM32F405
)
M7 = Processor(
    "Cortex-M7",
    "mps2-an500",
    ("-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-d16"),
    216e6,  # STM32F767
)
PROCESSORS = (M4F, M7)
PRECISIONS = ("float", "float, table", "double")
"""With ``table`` the encoder count is looked up: ``kneexo export c --look-up``."""
SCENARIOS = {
    "SMC": Scenario(),
    "PID": changed(Scenario(), {"controller": {"kind": "pid"}}),
    "torque": changed(
        Scenario(), {"plant.load": "knee", "wearer": "leg", "controller": {"kind": "torque"}}
    ),
}


LEG = Scenario.model_validate(with_preset("leg", {}))
STIFF_PLANT: Mapping[str, Any] = {
    "what": "plant",
    "integrator": "rosenbrock",
    "tolerance": 1e-5,
    "outputs": ("rod_extension", "load_pressure"),
    "vectors_s": 0.5,
}
"""Options of `make_firmware` for the plant of preset leg."""


class MissingToolError(RuntimeError):
    """A cross-compiler or QEMU is missing."""


@dataclass(frozen=True)
class Figures:
    """What a model takes on a processor."""

    failures: int
    """Of the harness: steps with a status, outputs beyond its tolerance."""
    difference: float
    """Largest of the first output, for a controller the command in rad/s."""
    hundred: float
    """Instructions counted for a hundred."""
    mean: float
    largest: float
    """Instructions of a step."""
    stack_bytes: int
    state_bytes: int
    flash_bytes: int

    def share(self, processor: Processor, sample_time_s: float) -> float:
        """Part of the sample time that the largest step takes."""
        return self.largest * CYCLES / processor.clock_hz / sample_time_s


def require_tools() -> None:
    """Raise `MissingToolError` unless compiler and emulator are there."""
    missing = [name for name in (GCC, SIZE, QEMU) if shutil.which(name) is None]
    if missing:
        raise MissingToolError(f"{', '.join(missing)}: not installed")


def figures(
    scenario: Scenario,
    precision: str,
    processor: Processor,
    what: str = "controller",
    **options: Any,
) -> Figures:
    """Build a model with its harness, run it, measure it. ``options``: of `make_firmware`.

    Raises `MissingToolError`, and `subprocess.SubprocessError` where a build or a run fails.
    """
    require_tools()
    precision, _, table = precision.partition(", ")
    options |= {"precision": precision, "look_up": bool(table)}
    source, vectors = make_firmware(scenario, what, **options)
    name = source.name
    model = (f"{name}.c", f"{name}_params.c")
    start = ("-nostartfiles", "--specs=rdimon.specs", f"-T{FOLDER / 'memory.ld'}")
    program = (*start, str(FOLDER / "start.c"), *model, f"{name}_vectors.c")
    macros = [f'-DHEADER="{name}_vectors.h"', f"-DOF(x)={name}_##x"]
    macros += [f"-DVECTORS={name.upper()}_VECTORS"]
    alone = ("-nostartfiles", "--specs=nosys.specs", "-Wl,--gc-sections", f"-Wl,-e,{name}_init")
    with tempfile.TemporaryDirectory() as directory:
        for file, text in files_of(source, vectors).items():
            Path(directory, file).write_text(text, encoding="utf-8")

        def run(*command: str) -> str:
            return subprocess.run(
                command,
                cwd=directory,
                check=True,
                stdout=subprocess.PIPE,
                text=True,
                timeout=SECONDS,
            ).stdout

        def compiled(output: str, *arguments: str) -> None:
            run(GCC, *FLAGS, *processor.options, "-I.", *arguments, "-lm", "-o", output)

        def emulated(output: str, *options: str) -> str:
            board = ("-M", processor.board, "-nographic", "-semihosting", "-monitor", "none")
            return run(QEMU, *board, *options, "-kernel", output)

        compiled("test.elf", *program, f"{name}_test.c")
        compiled("measure.elf", *macros, *program, str(FOLDER / "measure.c"))
        compiled("alone.elf", *alone, f"-Wl,-u,{name}_step,-u,{name}_params", *model)
        replay = emulated("test.elf")
        text = emulated("measure.elf", "-icount", "shift=6")
        sizes = run(SIZE, "alone.elf").splitlines()[1].split()

    def measured(what: str) -> float:
        return float(re.findall(rf"^{what}: (\S+) ", text, re.MULTILINE)[0])

    return Figures(
        int(re.findall(r"(\d+) failures", replay)[0]),
        float(re.findall(r"difference (\S+),", replay)[0]),
        measured("a hundred"),
        measured("mean"),
        measured("largest"),
        int(measured("stack")),
        int(measured("state")),
        int(sizes[0]) + int(sizes[1]),
    )


def main() -> None:
    """Print the table."""
    try:
        require_tools()
    except MissingToolError as error:
        sys.exit(str(error))
    print(
        "processor | model | precision | difference (rpm; m) | instructions, mean, largest | "
        f"share of sample time at {CYCLES:g} cycles each | stack, state (bytes) | flash (kB)"
    )
    models = [(name, scenario, p, {}) for name, scenario in SCENARIOS.items() for p in PRECISIONS]
    models += [("leg, Rosenbrock", LEG, p, STIFF_PLANT) for p in ("float", "double")]
    for processor in PROCESSORS:
        for name, scenario, precision, options in models:
            row = figures(scenario, precision, processor, **options)
            share = row.share(processor, scenario.controller.sample_time_s)
            difference = row.difference if options else row.difference / RPM
            print(
                f"{processor.name}, {processor.clock_hz / 1e6:g} MHz | {name} | {precision} | "
                f"{difference:.2g} | {row.mean:.0f}, {row.largest:.0f} | "
                f"{100.0 * share:.2g} % | {row.stack_bytes}, {row.state_bytes} | "
                f"{row.flash_bytes / 1e3:.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
