"""Settings, numbers and helpers of the tests of the sliding study."""

import math

from kneexo.parameters.paths import changed
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings

# Lee et al. 2020, Tables 2 and 3.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
AREA = 0.5 * (AREA_1 + AREA_2)
OIL = 4.0 * 1.72e9 / 41_233e-9
M_HAT, BETA = math.sqrt(1.4 * 1.8), math.sqrt(1.8 / 1.4)
STIFFNESS = OIL * AREA**2 / M_HAT
AREA_TERM = {"controller.area_uncertainty": 1.0 / 7.0}
# 1.4 and 1.8 kg times (Ā/A_i)(4V_i/V_t) at 10 and 70 deg, by hand: 139.05 and 38.92 mm of rod.
VOLUMES = [
    (AREA_1, 5e-6 + AREA_1 * 0.13905),
    (AREA_1, 5e-6 + AREA_1 * 0.038916),
    (AREA_2, 5e-6 + AREA_2 * (0.150 - 0.13905)),
    (AREA_2, 5e-6 + AREA_2 * (0.150 - 0.038916)),
]
MASS_FACTORS = [AREA / area * 4.0 * volume / 41_233e-9 for area, volume in VOLUMES]
GAIN = AREA_TERM | {
    "controller.mass_min_kg": 1.4 * min(MASS_FACTORS),
    "controller.mass_max_kg": 1.8 * max(MASS_FACTORS),
}
SMALL = SlidingSettings(
    etas_m_s3=(1e3,),
    loads_n=(60.0, -60.0),
    start_duration_s=0.0135,
    start_sample_time_s=2e-5,
    sampled_eta_m_s3=200.0,
    sampled_offset_m=-0.009,
    settling_factor=0.1,
    rated_samples=20,
)
SHORT = changed(SLIDING_LAW, {"simulation.duration_s": 0.08})
