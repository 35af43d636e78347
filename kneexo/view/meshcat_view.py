"""Shows the knees of a diagram in Meshcat while Drake's Simulator runs."""

from __future__ import annotations

from collections.abc import Mapping

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, SceneGraph
from pydrake.systems.framework import DiagramBuilder, System

from kneexo.common.ports import output_ports, sizes
from kneexo.errors import ParameterError
from kneexo.parameters import CylinderParameters, LinkageParameters
from kneexo.view.knee_frames import KneeFrames
from kneexo.view.parts import ICR_COLOUR, depths_m, icr_path, look_at_legs
from kneexo.view.pressure_colour import PressureColour

PORTS = {"knee_angle": 1, "knee_reference": 4, "wearer_motion": 2, "load_pressure": 1}
"""Dictionary from an output port that the view shows to its size. ``knee_angle`` is required."""

PERIOD_S = 1.0 / 32.0
"""Time between two pictures, in s."""


def add_meshcat_view(
    builder: DiagramBuilder,
    legs: Mapping[System, LinkageParameters],
    meshcat: Meshcat,
    *,
    largest_pressure_pa: float = CylinderParameters().pressure_rating_pa,
) -> MeshcatVisualizer:
    """Show knees of a diagram beside each other in Meshcat. The first knee is nearest.

    Adds the subsystem ``knee_scene_graph``, and for each leg ``<leg>_frames`` (`KneeFrames`). A leg
    with a port ``load_pressure`` also gets ``<leg>_pressure_colour`` (`PressureColour`). In Meshcat
    the path ``knees/<leg>`` has bones, links, pins, cylinder and rod, the instantaneous centre of
    rotation, and a ghost of shank and foot at the reference. The Meshcat path ``icr_paths/<leg>``
    shows how this centre moves over 0…90° of knee angle.

    Parameters
    ----------
    builder
        The builder of the diagram.
    legs
        Dictionary from systems of ``builder`` to linkages. A system requires an output port
        ``knee_angle`` (1, rad); its ports ``knee_reference`` (4, the first in rad),
        ``wearer_motion`` (2, the first in rad) and ``load_pressure`` (1, Pa) are optional. A
        diagram of `make_closed_loop` has all of them, but ``wearer_motion`` only with a wearer.
    meshcat
        Shows the legs from the side; its grid and axes are hidden.
    largest_pressure_pa
        Load pressure in Pa at which the cylinder is fully red. At the negative of this pressure the
        cylinder is fully blue. The default is the pressure rating of the cylinder.

    Returns
    -------
    MeshcatVisualizer
        Records with ``StartRecording`` and ``PublishRecording``; then ``meshcat.StaticHtml()``
        returns a page with a time slider.

    Raises
    ------
    ParameterError
        There is no leg, a leg is not in the builder, two legs have the same name, a port is missing
        or has another size, the builder has a subsystem of a name above already, or the pressure
        is not finite and positive. Builder and Meshcat are unchanged.
    LinkageError
        A linkage cannot be assembled. Builder and Meshcat are unchanged.
    """
    if not legs:
        raise ParameterError("legs: there is none; must be at least one system with its linkage")
    ports_of = {leg: sizes(output_ports(leg)) for leg in legs}
    names = [leg.get_name() for leg in legs]
    for leg, ports in ports_of.items():
        if leg not in builder.GetSystems():
            raise ParameterError(f"{leg.get_name()}: must be a system of the builder")
        if names.count(leg.get_name()) > 1:
            raise ParameterError(f"legs: two have the name {leg.get_name()}; choose another")
        for name, size in PORTS.items():
            if ports.get(name, size) != size or (name == "knee_angle" and name not in ports):
                raise ParameterError(
                    f"{leg.get_name()}: must have an output port {name} of size {size}"
                )
    parameters = MeshcatVisualizerParams()
    parameters.prefix, parameters.publish_period = "knees", PERIOD_S
    parameters.visualizer_name = "knees"
    scene_graph, frames, colours, paths = SceneGraph(), {}, {}, {}
    for (leg, linkage), depth_m in zip(legs.items(), depths_m(len(legs)), strict=True):
        name = leg.get_name()
        frames[leg] = KneeFrames(scene_graph, linkage, name=name, depth_m=depth_m)
        if "load_pressure" in ports_of[leg]:
            cylinder = f"{parameters.prefix}/{name}/cylinder/cylinder"
            colours[leg] = PressureColour(meshcat, cylinder, largest_pressure_pa, PERIOD_S)
        paths[name] = icr_path(linkage, depth_m)
    subsystems = ["knee_scene_graph", *(f"{leg.get_name()}_frames" for leg in frames)]
    subsystems += [f"{leg.get_name()}_pressure_colour" for leg in colours]
    for name in filter(builder.HasSubsystemNamed, subsystems):
        raise ParameterError(f"{name}: the builder has a system of this name; choose another")
    builder.AddNamedSystem("knee_scene_graph", scene_graph)
    for leg, system in frames.items():
        builder.AddNamedSystem(f"{leg.get_name()}_frames", system)
        for port in ("knee_angle", "knee_reference", "wearer_motion"):
            if port in ports_of[leg]:
                builder.Connect(leg.GetOutputPort(port), system.GetInputPort(port))
        builder.Connect(
            system.GetOutputPort("frame_poses"), scene_graph.get_source_pose_port(system.source)
        )
    visualizer = MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, parameters)
    for leg, colour in colours.items():  # after the visualizer, which creates the cylinders
        builder.AddNamedSystem(f"{leg.get_name()}_pressure_colour", colour)
        builder.Connect(leg.GetOutputPort("load_pressure"), colour.GetInputPort("load_pressure"))
    for name, path in paths.items():
        # Outside the path of the visualizer, which deletes it when a simulation starts.
        meshcat.SetLine(f"icr_paths/{name}", path, 2.0, ICR_COLOUR)
    look_at_legs(meshcat, len(legs))
    return visualizer
