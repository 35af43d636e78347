"""Draws the closed loop of a scenario as a block diagram with the names of its signals.

Blocks and wires are those of the Drake diagram that `make_closed_loop` builds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import Diagram, System

from kneexo.diagrams import make_closed_loop
from kneexo.parameters import (
    RPM,
    Cia402Parameters,
    LawParameters,
    ObserverParameters,
    Scenario,
)
from kneexo.view.wiring import Box, Point, Wiring, corners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STEP = 0.15
"""Size in inches of a step of the grid."""
_HALF = (5, 2)
"""Half the width and height of a block in steps of the grid."""
_PITCH = (14, 10)
"""Distance of neighbouring columns and of neighbouring rows in steps of the grid."""
_CORNER = (8, 6)
"""Distance of the first block's centre from the left and upper edge in steps of the grid."""
_KEY_HEIGHT = 5
"""Height of the strip with the key of colours in steps of the grid."""
_SLOTS = {
    "reference": (0, 0), "rod_reference": (1, 0), "law": (2, 0), "controller": (2, 0),
    "coordinates": (0, 1), "estimator": (1, 1), "drive": (2, 1),
    "encoder": (0, 2), "load_cell": (1, 2), "can_bus": (2, 2),
    "knee": (0, 3), "cylinder": (1, 3), "motor": (2, 3),
    "load": (0, 4), "cuff": (1, 4), "moment": (2, 4), "bypass": (0, 5), "wearer": (1, 5),
    "temperature": (2, 5),
}  # fmt: skip
"""Column and row of each block; blocks without an entry follow below these."""
_PARTS_OF = {"phase_sum": "encoder", "encoder_phase": "encoder", "limit": "law", "hold": "law"}
"""Systems that the diagram draws as a part of another block."""
_UNNAMED = re.compile(r"[yu]\d*|sum|delayed_u")
"""Pattern of the names of ports of Drake's primitives, which say nothing about the signal."""
_CONTROLLER_COLOUR, _MACHINE_COLOUR, _OUTSIDE_COLOUR = "#e3eefb", "#f3ead9", "#ffffff"
_OUTSIDE_BLOCKS = ("reference", "wearer", "moment")
_SYMBOLS = {
    "knee_reference": r"$\theta_d,\ \dot\theta_d,\ \ddot\theta_d,\ \dddot\theta_d$ (rad, s)",
    "rod_reference": r"$x_d,\ \dot x_d,\ \ddot x_d,\ \dddot x_d$ (m, s)",
    "estimated_state": r"$\hat x,\ \hat v,\ \hat a$ (m, s)",
    "motor_speed_command": r"$u$ (rad/s)",
    "encoder_reading": "(rad)",
    "encoder_angle": r"$\theta_4$ (rad)",
    "rod_extension": "$x$ (m)",
    "rod_state": r"$x,\ \dot x,\ \ddot x$ (m, s)",
    "knee_angle": r"$\theta_p$ (rad)",
    "moment_arm": "$r$ (m)",
    "load_flow": "$Q_L$ (m³/s)",
    "load_pressure": "$P_L$ (Pa)",
    "load_force": "$F_L$ (N)",
    "rod_force": "$F$ (N)",
    "rod_velocity": r"$\dot x$ (m/s)",
    "measured_force": "(N, s)",
    "interaction_torque": r"$\tau_i$ (N·m)",
    "biological_moment": "$M$ (N·m)",
    "wearer_motion": r"$\theta_h,\ \dot\theta_h$ (rad, s)",
}
"""Symbol and unit of a signal."""


def block_diagram(scenario: Scenario = Scenario()) -> Figure:
    """Draw the blocks of a scenario's closed loop, with the names of systems and signals.

    Each block has a few words on its parameters. Systems without a function of their own, such as
    the log, are left out. A law of a scenario file that has not run is a box, which reads what the
    sliding mode reads. Raises the errors of `make_closed_loop`.
    """
    import matplotlib.pyplot as plt

    law, drawn = scenario.controller, scenario
    if isinstance(law, LawParameters) and not law.function.is_loaded:
        drawn = scenario.with_law(_any_law)  # a drawing runs nothing of a file
    diagram = make_closed_loop(drawn, signals=())
    blocks = dict(_blocks(diagram))
    slots = dict(_slots(blocks))
    rows = 1 + max(row for _, row in slots.values())
    size = (3 * _PITCH[0] + 2, rows * _PITCH[1] + 1)
    boxes = {
        name: Box(_CORNER[0] + column * _PITCH[0], size[1] - _CORNER[1] - row * _PITCH[1], *_HALF)
        for name, (column, row) in slots.items()
    }
    figure = plt.figure(figsize=(_STEP * size[0], _STEP * (size[1] + _KEY_HEIGHT)))
    figure.set_label(
        "The closed loop. Its blocks are the systems of the Drake diagram. The words beside the "
        "wires are the names of the ports."
    )
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set(xlim=(0, size[0]), ylim=(-_KEY_HEIGHT, size[1]))
    ax.axis("off")
    words = _words(scenario)
    for name, box in boxes.items():
        kind, colour = blocks[name]
        _draw_block(ax, box, colour, name, words.get(name) or kind)
    _draw_wires(ax, boxes, size, _wires(diagram))
    period = f"microcontroller, every {1e3 * scenario.controller.sample_time_s:g} ms"
    for x, colour, text in ((3, _MACHINE_COLOUR, "machine"), (17, _CONTROLLER_COLOUR, period)):
        _draw_key(ax, x, colour, text)
    return figure


def _any_law(rod_extension: Any, rod_reference: Any, estimated_state: Any) -> float:
    """Stand for a law whose file has not run, so that nobody knows what it reads."""
    return 0.0


def _is_opened(system: System) -> bool:
    """Return whether the drawing shows the subsystems of a system in place of the system.

    The plant of the user's own and a law that is one block stay closed.
    """
    names = {"plant": "motor", "controller": "law"}
    name = system.get_name()
    return isinstance(system, Diagram) and name in names and system.HasSubsystemNamed(names[name])


def _blocks(diagram: Diagram) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the name of each block of the closed loop, with its system's class and its colour."""
    for system in diagram.GetSystems():
        for leaf in system.GetSystems() if _is_opened(system) else (system,):
            name, colour = leaf.get_name(), _MACHINE_COLOUR
            if system.get_name() == "controller":
                colour = _CONTROLLER_COLOUR
            elif name in _OUTSIDE_BLOCKS:
                colour = _OUTSIDE_COLOUR
            if name not in _PARTS_OF:
                yield name, (type(leaf).__name__.partition("_")[0], colour)


def _wires(diagram: Diagram) -> dict[tuple[str, str], list[str]]:
    """Return the names of the signals between each pair of blocks, by source and reader."""
    wires: dict[tuple[str, str], set[str]] = {}
    for source, reader in _connections(diagram):
        start, end = (
            _PARTS_OF.get(port.get_system().get_name(), port.get_system().get_name())
            for port in (source, reader)
        )
        name = source.get_name()
        if _UNNAMED.fullmatch(name):
            name = "encoder_reading" if start == "encoder" else reader.get_name()
        if start != end:
            wires.setdefault((start, end), set()).add(name)
    return {ends: sorted(wires[ends]) for ends in sorted(wires)}


def _connections(diagram: Diagram) -> Iterator[tuple[Any, Any]]:
    """Yield each output port of a block with each input port that reads it."""
    for level in (diagram, *filter(_is_opened, diagram.GetSystems())):
        for (system, index), (origin, output) in level.connection_map().items():
            source = origin.get_output_port(output)
            if _is_opened(origin):
                leaf, port = origin.get_output_port_locator(output)
                source = leaf.get_output_port(port)
            if not _is_opened(system):
                yield source, system.get_input_port(index)
                continue
            for leaf, port in system.GetInputPortLocators(index):
                yield source, leaf.get_input_port(port)


def _slots(systems: Any) -> Iterator[tuple[str, Point]]:
    """Yield column and row of each block. Rows without a block are removed."""
    known = {name: _SLOTS[name] for name in systems if name in _SLOTS}
    rows = sorted({row for _, row in known.values()})
    for name, (column, row) in known.items():
        yield name, (column, rows.index(row))
    others = [name for name in systems if name not in _SLOTS]
    for index, name in enumerate(others):
        yield name, (index % 3, len(rows) + index // 3)


def _words(scenario: Scenario) -> dict[str, str]:
    """Return a few words about each block of the closed loop that kneexo knows."""
    plant, encoder, law = scenario.plant, scenario.encoder, scenario.controller
    rpm = plant.pump.speed_limit_rad_s / RPM
    motor = f"{1e3 * plant.pump.lag_s:g} ms, ±{rpm:.0f} rpm"
    estimator = "differences"
    if isinstance(scenario.estimator, ObserverParameters):
        estimator = f"observer, {1e3 * scenario.estimator.time_constant_s:g} ms"
    laws = {"smc": "sliding mode", "pid": "PID", "torque": "torque control"}
    words = laws.get(law.kind, law.kind)
    if isinstance(law, LawParameters):
        words = law.function.short_name
    counts = f"counts of {math.degrees(encoder.resolution_rad):.3f}°"
    latency = scenario.bus.latency_samples
    bus, drive = scenario.bus, ""
    if isinstance(bus, Cia402Parameters):
        drive = f"units of {bus.velocity_unit_rpm:g} rpm"
    return {
        "reference": scenario.reference.kind,
        "rod_reference": "knee to rod",
        "law": words,
        "coordinates": "encoder to rod",
        "estimator": estimator,
        "encoder": counts if encoder.quantized else "no counts",
        "drive": drive,
        "can_bus": f"{latency} sample{'s' if latency > 1 else ''} of latency",
        "motor": "no lag, no limit" if plant.ideal_motor else motor,
        "cylinder": "reduced order" if plant.full_order is None else "full order",
        "knee": "polynomial" if plant.rod_map == "polynomial" else "four-bar linkage",
        "load": "weight, torques",
        "bypass": "opens to the reservoir",
        "temperature": "winding and case",
        "load_cell": "on the rod",
        "guard": "of the inputs",
        "detectors": "of faults",
        "supervisor": "stops the motor",
        "cuff": "straps and flesh",
        "wearer": "leg of the wearer",
        "moment": "of the muscles",
    }


def _draw_block(ax: Axes, box: Box, colour: str, name: str, words: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    corner = (box.x - box.half_width, box.y - box.half_height)
    size = (2 * box.half_width, 2 * box.half_height)
    style = "round,pad=0,rounding_size=0.5"
    block = FancyBboxPatch(corner, *size, boxstyle=style, fc=colour, ec="0.2", lw=1.3, zorder=2)
    block.set_gid(name)
    ax.add_patch(block)
    centred: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 3}
    ax.text(box.x, box.y + 0.8, name, fontsize=10, family="monospace", **centred)
    ax.text(box.x, box.y - 0.8, words, fontsize=8.7, color="0.25", **centred)


def _draw_key(ax: Axes, x: float, colour: str, text: str) -> None:
    from matplotlib.patches import Rectangle

    ax.add_patch(Rectangle((x, -3.6), 2.4, 1.6, fc=colour, ec="0.2"))
    ax.text(x + 3.2, -2.8, text, va="center", fontsize=9.5)


def _draw_wires(
    ax: Axes, boxes: dict[str, Box], size: Point, wires: dict[tuple[str, str], list[str]]
) -> None:
    """Draw all wires, short ones first, and then their labels."""
    wiring = Wiring(boxes, size)

    def distance(ends: tuple[str, str]) -> tuple[int, tuple[str, str]]:
        start, end = (boxes[name] for name in ends)
        return abs(start.x - end.x) + abs(start.y - end.y), ends

    paths = {}
    for ends in sorted(wires, key=distance):
        path = paths[ends] = wiring.connect(*ends)
        *inner, before, last = corners(path)
        for start, stop in pairwise((*inner, before)):
            ax.plot(*zip(start, stop, strict=True), color="0.15", lw=1.2, zorder=1)
        style = {"arrowstyle": "-|>", "color": "0.15", "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", last, before, arrowprops=style, zorder=1).set_gid("-".join(ends))
    taken: list[Any] = []
    for ends, path in paths.items():
        others = {p for pair, points in paths.items() if pair != ends for p in points}
        _label(ax, path, wires[ends], boxes, others, taken)


def _label(
    ax: Axes, path: list[Point], signals: list[str], boxes: dict[str, Box],
    others: set[Point], taken: list[Any],
) -> None:  # fmt: skip
    """Write the names of a wire's signals where they cover least. Add their place to ``taken``."""
    join = "\n" if len(signals) == 1 else " "
    lines = [join.join(filter(None, (name, _SYMBOLS.get(name)))) for name in signals]
    halo = {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.9}
    text = ax.text(0, 0, "\n".join(lines), ha="center", va="center", fontsize=8.7, bbox=halo)
    text.set_zorder(4)
    extent = text.get_window_extent().transformed(ax.transData.inverted())
    width, height = 0.5 * extent.width + 0.4, 0.5 * extent.height + 0.3

    def cost(place: tuple[float, float]) -> float:
        """Return how bad a place of the text is; the worse the thing it covers, the larger."""
        # Only the order of the weights matters: the edge of the figure before a block, another
        # label, an arrow head, another wire, the text's own wire, and the distance from this wire.
        x, y = place
        total = 0.0
        for box in boxes.values():
            overlap_x = box.half_width + width - abs(x - box.x)
            overlap_y = box.half_height + height - abs(y - box.y)
            if overlap_x > 0.0 and overlap_y > 0.0:
                total += 300.0 + 10.0 * min(overlap_x, overlap_y)
        for (other_x, other_y), other_width, other_height in taken:
            if abs(x - other_x) < width + other_width and abs(y - other_y) < height + other_height:
                total += 200.0
        covered = [p for p in (*others, *path) if abs(p[0] - x) < width and abs(p[1] - y) < height]
        total += 14.0 * sum(p in others for p in covered) + 1.0 * len(covered)
        total += 20.0 * sum(p in path[-3:] for p in covered)  # the arrow head
        (left, right), top = ax.get_xlim(), ax.get_ylim()[1]
        if x - width < left or x + width > right or y - height < -1.5 or y + height > top:
            total += 500.0  # outside the figure, or on the key of colours
        nearest = min(math.hypot(p[0] - x, p[1] - y) for p in path)
        return total + 6.0 * nearest + (0.0 if y >= path[0][1] else 3.0)  # rather above the wire

    beside = [0.0, height + 0.3, height + _HALF[1] + 0.2]
    shifts = [
        (along, sign * shift)
        for along in (0.0, width, -width, 2.0 * width, -2.0 * width)
        for shift in beside
        for sign in (1, -1)
    ]
    shifts += [(sign * (width + 0.3), 0.0) for sign in (1, -1)]
    places = [(x + dx, y + dy) for x, y in path for dx, dy in shifts]
    best = min(places, key=cost)
    text.set_position(best)
    taken.append((best, width, height))
