"""A designed linkage that is G3, so that nothing is searched."""

import math
from functools import cache

import numpy as np

from kneexo.analysis.mechanism.alignment import align
from kneexo.analysis.mechanism.linkage_design import _design, _points_of, _Problem
from kneexo.geometry.shank_motion import anatomical_motion
from kneexo.parameters import (
    G1,
    G3,
    GAIT2392,
    HINGE,
    DesignLimits,
    RodPolynomialParameters,
    Scenario,
)
from kneexo.studies.design import DesignResult, DesignSettings

GROUND_M = math.hypot(G3.o_b_x_m - G3.o_a_x_m, G3.o_b_y_m - G3.o_a_y_m)
LIMITS = DesignLimits(link_angle_deg=5.0, joint_box_m=0.2, least_link_m=GROUND_M)


@cache
def made_up():
    angle = np.radians(np.arange(91.0))
    table = 1e-3 * np.polyval(RodPolynomialParameters().p_mm_deg, np.degrees(angle))
    motion = anatomical_motion(GAIT2392, angle)
    problem = _Problem(motion, angle, table, LIMITS, (1.0, 1.0), 5.0)
    design = _design(problem, _points_of(G3), [(problem, _points_of(G3))])
    others = {"hinge": align(HINGE), "linkage of the scenario": align(G1)}
    scenario = Scenario(plant={"linkage": design.linkage})
    return DesignResult(scenario, DesignSettings(limits=LIMITS), design, others)
