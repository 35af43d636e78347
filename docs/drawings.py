"""Drawings of the idea, made from the parameters; ``pictures.md`` shows and explains them."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Polygon, Rectangle

from kneexo.analysis.signals import to_rpm
from kneexo.geometry.linkage import icr, pose, rod_anchor
from kneexo.parameters import G1, LinkageParameters, PlantParameters, Scenario
from kneexo.simulation import compile_scenario, scenario_run

_HALO = {"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none"}


def _arrow(ax: Axes, start: Any, end: Any, **style: Any) -> None:
    options = {"arrowstyle": "-|>", "mutation_scale": 11, "color": "0.15", "lw": 1.1} | style
    ax.add_patch(FancyArrowPatch(start, end, shrinkA=0, shrinkB=0, **options))


def _angle(ax: Axes, at: complex, radius: float, start: float, end: float, name: str) -> None:
    """An arc from ``start`` to ``end`` in deg, with its name in the middle."""
    low, high = min(start, end), max(start, end)
    ax.add_patch(Arc((at.real, at.imag), 2 * radius, 2 * radius, theta1=low, theta2=high, lw=1))
    tip = at + radius * np.exp(1j * np.radians(end))
    before = at + radius * np.exp(1j * np.radians(end - np.sign(end - start) * 9.0))
    _arrow(ax, (before.real, before.imag), (tip.real, tip.imag), mutation_scale=8, lw=0.8)
    middle = at + (radius + 2.6) * np.exp(1j * np.radians(0.5 * (start + end)))
    ax.text(middle.real, middle.imag, name, ha="center", va="center", fontsize=11, bbox=_HALO)


def mechanism(link: LinkageParameters = G1, knee_angle_deg: float = 35.0) -> Figure:
    """The four-bar knee in the frame of its ground link: whole, and its joints; in mm."""
    at = pose(link, np.radians(knee_angle_deg))
    o_a = 1e3 * complex(link.o_a_x_m, link.o_a_y_m)
    o_b = 1e3 * complex(link.o_b_x_m, link.o_b_y_m)
    a, b, pin = (1e3 * complex(p) for p in (at.joint_a, at.joint_b, at.rod_pin))
    anchor = 1e3 * rod_anchor(link)
    centre = 1e3 * complex(*(float(c) for c in icr(link, at.theta_3, at.theta_4)))
    theta = {n: float(np.degrees(getattr(at, f"theta_{n}"))) for n in (2, 3, 4)}
    fig, (whole, joints) = plt.subplots(1, 2, figsize=(9.6, 5.8), width_ratios=(1, 1.35))

    for ax in (whole, joints):
        for start, end, colour, name in (
            (o_a, o_b, "0.4", "a_1"),
            (o_a, a, "C0", "a_2"),
            (a, b, "C2", "a_3"),
            (o_b, b, "C1", "a_4"),
        ):
            x, y = (start.real, end.real), (start.imag, end.imag)
            ax.plot(x, y, color=colour, lw=4, zorder=3, gid=name)
        for point in (o_a, o_b, a, b):
            ax.plot(point.real, point.imag, "o", mfc="white", mec="0.1", ms=7, zorder=5)
        ax.set_aspect("equal")
        ax.set(xlabel="x of the ground link (mm)", ylabel="y of the ground link (mm)")
        ax.grid(alpha=0.25)

    turn = np.exp(1j * np.radians(knee_angle_deg))
    thigh = b + 300j * turn
    whole.plot([b.real, thigh.real], [b.imag, thigh.imag], color="#e8dcc0", lw=16, zorder=0)
    whole.plot([0, 0], [0, -200], color="#d8ccb0", lw=16, zorder=0)
    along = (pin - anchor) / abs(pin - anchor)
    end = anchor + 1e3 * link.rod_length_m * along
    whole.plot([anchor.real, end.real], [anchor.imag, end.imag], color="0.6", lw=9, zorder=1)
    whole.plot([anchor.real, pin.real], [anchor.imag, pin.imag], color="0.35", lw=3, zorder=1)
    whole.plot([b.real, pin.real], [b.imag, pin.imag], "C2--", lw=1, zorder=1)
    for point, name, shift in (
        (pin, "P'", (-26, 8)),
        (anchor, r"$P_\mathrm{rod}$", (28, -14)),
    ):
        whole.plot(point.real, point.imag, "o", mfc="white", mec="0.1", ms=7, zorder=5)
        whole.text(point.real + shift[0], point.imag + shift[1], name, ha="center", bbox=_HALO)
    side = 26 * along * 1j
    for start, stop, name in (
        (anchor, end, "$L_0$"),
        (end, pin, "$x$"),
    ):
        p, q = start + side, stop + side
        _arrow(whole, (p.real, p.imag), (q.real, q.imag), arrowstyle="<|-|>", lw=0.9)
        middle = 0.5 * (p + q) + 14j * along
        whole.text(middle.real, middle.imag, name, ha="center", va="center", bbox=_HALO)
    foot = anchor + along * np.real((centre - anchor) * np.conj(along))
    arm = [centre, foot]
    whole.plot(np.real(arm), np.imag(arm), "C3", lw=1.4, zorder=2, gid="r")
    whole.plot(centre.real, centre.imag, "k+", ms=8, mew=1.4, zorder=6)
    middle = 0.35 * centre + 0.65 * foot + 15j
    whole.text(middle.real, middle.imag, "$r$", ha="center", va="center", color="C3", bbox=_HALO)
    whole.text(thigh.real + 60, thigh.imag - 30, "thigh", color="0.35")
    whole.text(-20, -190, "shank,\nground link", color="0.35", ha="right")
    whole.set_title(f"knee flexed by {knee_angle_deg:g}°")
    whole.margins(0.12)

    for start, stop, share, name, shift in (
        (o_a, o_b, 0.5, "$a_1$", -3.0 - 2.0j),
        (o_a, a, 0.5, "$a_2$", 3.2),
        (a, b, 0.4, "$a_3$", 1.2 - 2.4j),
        (o_b, b, 0.72, "$a_4$", 1.8 - 2.6j),
    ):
        middle = start + share * (stop - start) + shift
        joints.text(middle.real, middle.imag, name, ha="center", va="center", bbox=_HALO, zorder=6)
    for point, name, shift in (
        (o_a, "$O_A$", 4.6 - 1.5j),
        (o_b, "$O_B$", -1.0 - 4.2j),
        (a, "$A$", 3.2 - 1.6j),
        (b, "$B$", -1.2 + 3.2j),
    ):
        at_name = point + shift
        joints.text(at_name.real, at_name.imag, name, ha="center", va="center", zorder=6)
    for start in (o_a, o_b):  # the lines that meet in the centre of rotation
        joints.plot([start.real, centre.real], [start.imag, centre.imag], "0.5", ls=":", lw=1)
    joints.plot(centre.real, centre.imag, "k+", ms=10, mew=1.6)
    joints.text(centre.real, centre.imag + 2.2, "ICR", ha="center", bbox=_HALO)
    joints.plot(0, 0, "kx", ms=6)
    joints.text(-1.2, 1.6, "origin", fontsize=8, color="0.35", ha="right")

    direction_3 = np.exp(1j * np.radians(theta[3]))
    for point, direction, reach, ls in (
        (b, 1.0, 33.0, "-"),
        (b, turn, 33.0, "--"),
        (o_b, 1.0, 14.0, "-"),
        (o_a, 1.0, 11.0, "-"),
        (b, direction_3, 14.0, "-."),
    ):
        tip = point + reach * direction
        joints.plot([point.real, tip.real], [point.imag, tip.imag], color="0.45", lw=0.8, ls=ls)
    _angle(joints, b, 26.0, 0.0, knee_angle_deg, r"$\theta_p$")
    phi = float(np.degrees(link.phi_rad))
    _angle(joints, b, 11.0, knee_angle_deg - phi, knee_angle_deg, r"$\varphi$")
    four = theta[4] % 360.0 if theta[4] < -90.0 else theta[4]
    _angle(joints, o_b, 6.5, 0.0, four, r"$\theta_4$")
    _angle(joints, o_a, 6.5, 0.0, theta[2], r"$\theta_2$")
    name_3 = b + 16.0 * direction_3
    joints.text(name_3.real, name_3.imag, r"$\theta_3$", ha="center", va="center", fontsize=11)
    joints.set_title("joints, links and angles")
    joints.margins(0.1)
    fig.tight_layout()
    return fig


def hydraulic_circuit(plant: PlantParameters = PlantParameters()) -> Figure:
    """Motor, gear, pump, lines, cylinder and mass; what only the full order has is blue."""
    pump, cylinder = plant.pump, plant.cylinder
    fig, ax = plt.subplots(figsize=(9.6, 4.1))
    extra = "C0"

    def circle(x: float, y: float, text: str) -> None:
        ax.add_patch(Circle((x, y), 0.62, fc="white", ec="0.15", lw=1.6, zorder=3))
        ax.text(x, y, text, ha="center", va="center", fontsize=13, zorder=4)

    def line(*points: tuple[float, float], **style: Any) -> None:
        x, y = zip(*points, strict=True)
        ax.plot(x, y, **({"color": "0.15", "lw": 1.8, "zorder": 1} | style))

    circle(1.2, 3.0, "M")
    line((1.82, 3.0), (2.4, 3.0), lw=4)
    ax.add_patch(Rectangle((2.4, 2.62), 0.75, 0.76, fc="white", ec="0.15", lw=1.6))
    ax.text(2.775, 3.0, f"{pump.gear_ratio:g}:1", ha="center", va="center")
    line((3.15, 3.0), (3.88, 3.0), lw=4)
    circle(4.5, 3.0, "")
    for sign in (1.0, -1.0):  # a pump for both directions
        tip, foot = 3.0 + 0.6 * sign, 3.0 + 0.3 * sign
        shape = [(4.5, tip), (4.3, foot), (4.7, foot)]
        ax.add_patch(Polygon(shape, fc="0.15", ec="0.15", zorder=4))
    ax.text(
        1.2,
        1.95,
        f"motor\n±{to_rpm(pump.speed_limit_rad_s):.0f} rpm, "
        rf"$\tau_m$ = {1e3 * pump.lag_s:g} ms",
        ha="center",
        va="center",
        fontsize=9,
    )
    ax.text(1.2, 3.95, r"$\omega_m$", ha="center", fontsize=12)
    displacement = 2e6 * np.pi * pump.displacement_m3_per_rad
    ax.text(3.6, 2.05, f"pump\n{displacement:.2g} cm³/rev", ha="center", va="center", fontsize=9.5)

    # Lines to the chambers of the cylinder.
    line((4.5, 3.62), (4.5, 5.0), (9.2, 5.0), (9.2, 3.75))
    line((4.5, 2.38), (4.5, 1.0), (11.4, 1.0), (11.4, 2.25))
    ax.text(5.15, 5.15, "$P_1$", fontsize=12)
    ax.text(5.15, 0.6, "$P_2$", fontsize=12)
    _arrow(ax, (4.75, 4.1), (4.75, 4.75))
    ax.text(4.9, 4.35, "$Q_1$", fontsize=11)
    _arrow(ax, (4.75, 1.25), (4.75, 1.9))
    ax.text(4.9, 1.5, "$Q_2$", fontsize=11)

    # Cylinder with piston, rod and mass.
    ax.add_patch(Rectangle((8.9, 2.25), 2.9, 1.5, fc="#f3ead9", ec="0.15", lw=1.8))
    ax.add_patch(Rectangle((10.15, 2.27), 0.22, 1.46, fc="0.35", ec="0.15", zorder=2))
    ax.add_patch(Rectangle((10.37, 2.85), 2.4, 0.3, fc="0.75", ec="0.15", zorder=2))
    ax.add_patch(Rectangle((12.77, 2.35), 0.95, 1.3, fc="white", ec="0.15", lw=1.6))
    ax.text(13.25, 3.0, f"$m$\n{cylinder.mass_kg:g} kg", ha="center", va="center", fontsize=10)
    area_1, area_2 = 1e6 * cylinder.cap_area_m2, 1e6 * cylinder.rod_side_area_m2
    ax.text(9.52, 3.0, f"$A_1$, $V_1$\n{area_1:.0f} mm²", ha="center", va="center", fontsize=9.5)
    ax.text(11.1, 3.4, "$A_2$, $V_2$", ha="center", va="center", fontsize=9.5)
    ax.text(11.1, 2.55, f"{area_2:.0f} mm²", ha="center", va="center", fontsize=9.5)
    _arrow(ax, (12.1, 4.05), (13.1, 4.05))
    ax.text(12.6, 4.2, r"$x,\ \dot{x}$", ha="center", fontsize=12)
    _arrow(ax, (14.75, 3.0), (13.75, 3.0), color="C3", lw=1.8)
    ax.text(14.3, 3.2, "$F_L$", ha="center", color="C3", fontsize=12)

    # Leakage between the lines.
    line((5.9, 5.0), (5.9, 1.0), ls="--", lw=1.1, color="0.45")
    ax.text(5.9, 3.0, r"$C_{im}$", ha="center", va="center", bbox=_HALO, color="0.3")
    line((10.26, 3.75), (10.26, 4.25), ls="--", lw=1.1, color="0.45")
    ax.text(10.26, 4.45, r"$C_L$ past the piston", ha="center", color="0.3", fontsize=9)

    # Make-up and relief valves of the full order, both to the reservoir.
    for x, name in ((6.85, "make-up"), (7.95, "relief")):
        line((x, 5.0), (x, 1.0), color=extra, lw=1.2)
        for y in (4.1, 1.9):
            shape = [(x - 0.22, y + 0.2), (x + 0.22, y + 0.2), (x, y - 0.2)]
            if (name == "make-up") == (y > 3.0):
                shape = [(p, 2 * y - q) for p, q in shape]
            ax.add_patch(Polygon(shape, fc="white", ec=extra, lw=1.4, zorder=3))
        ax.text(x, 5.12, name, ha="center", color=extra, fontsize=9)
    line((6.85, 3.0), (7.95, 3.0), color=extra, lw=1.2)
    line((7.4, 3.0), (7.4, 2.6), color=extra, lw=1.2)
    line((7.1, 2.75), (7.1, 2.5), (7.7, 2.5), (7.7, 2.75), color=extra, lw=1.4)
    ax.text(7.4, 2.32, "$P_r$", ha="center", va="top", color=extra, bbox=_HALO)
    ax.text(
        7.0, 0.05,
        r"positive: $\omega_m,\ Q_L = (Q_1+Q_2)/2,\ P_L = P_1 - P_2$ push the rod out; "
        r"$F_L$ pushes it in.  Blue: full order only.",
        ha="center", fontsize=11,
    )  # fmt: skip
    ax.set(xlim=(0.1, 15.0), ylim=(-0.2, 5.6))
    ax.set_aspect("equal")
    ax.axis("off")
    fig.tight_layout()
    return fig


def sample_timing(
    scenario: Scenario = Scenario(), start_s: float = 2.5, samples: int = 5
) -> Figure:
    """What a run of the loop does within some samples: count, held command, motor speed."""
    period, fine = scenario.controller.sample_time_s, 2e-5
    model = compile_scenario(scenario)
    parameters, state, table = scenario_run(scenario, model)
    end = start_s + samples * period
    run = model.simulate(
        parameters,
        state,
        end,
        outputs=("encoder_reading", "motor_speed_command", "motor_speed"),
        record_period_s=fine,
        inputs=table,
    )
    kept = run.time_s > start_s + 0.5 * fine
    time = 1e3 * (run.time_s[kept] - start_s)
    count = run["encoder_reading"][kept, 0] / scenario.encoder.resolution_rad
    command, speed = (to_rpm(run[name][kept, 0]) for name in ("motor_speed_command", "motor_speed"))
    fig, (top, bottom) = plt.subplots(2, 1, figsize=(7.0, 5.2), sharex=True)
    top.step(time, count, "C0", where="pre", label="encoder")
    ticks = 1e3 * period * np.arange(samples + 1)
    at = np.searchsorted(time, ticks[:-1] - 1e-6)
    top.plot(ticks[:-1], count[at], "C0o", label="read by the microcontroller")
    top.set(ylabel="encoder count (1)", yticks=np.unique(count.round()))
    top.legend(loc="upper right")
    lag_ms = 1e3 * scenario.plant.pump.lag_s
    bottom.step(time, command, "C3", where="pre", lw=1.8, label="command, held for a sample")
    bottom.plot(time, speed, "C2", lw=1.8, label=f"motor speed, lag {lag_ms:g} ms")
    bottom.set(xlabel=f"time after {start_s:g} s (ms)", ylabel="motor speed (rpm)", xticks=ticks)
    bottom.legend(loc="upper right")
    for ax in (top, bottom):
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.45 * (high - low))
        for tick in ticks:
            ax.axvline(tick, color="0.75", lw=0.8, zorder=0)
    _arrow(
        top,
        (ticks[0], 0.9),
        (ticks[1], 0.9),
        arrowstyle="<|-|>",
        transform=top.get_xaxis_transform(),
    )
    top.text(
        ticks[:2].mean(), 0.8, f"$T$ = {1e3 * period:g} ms", ha="center", va="center",
        transform=top.get_xaxis_transform(), bbox=_HALO,
    )  # fmt: skip
    bottom.text(
        0.06 * ticks[1], 0.95, "at a tick: count, estimate, command;\nthen the command holds",
        va="top", transform=bottom.get_xaxis_transform(), bbox=_HALO,
    )  # fmt: skip
    fig.align_ylabels()
    fig.tight_layout()
    return fig


DRAWINGS = (mechanism, hydraulic_circuit, sample_timing)

if __name__ == "__main__":
    for drawing in DRAWINGS:
        drawing().savefig(f"{drawing.__name__}.png", dpi=110)
