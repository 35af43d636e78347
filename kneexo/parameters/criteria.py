"""Bounds by which kneexo judges margins, steps, pushes and faults; −3 dB as a gain."""

import math

MINUS_3_DB = 1.0 / math.sqrt(2.0)
"""Gain of the fundamental that defines the bandwidth, 1/√2."""

SOUND_DISK_MARGIN = 0.5
"""Smallest disk margin of a sound loop. Assumption: 28° of phase alone, or gains of 0.6…1.67."""

SETTLING_BAND = 0.02
"""Share of a step within which its response is settled: 2 %, as usual (``stepinfo``)."""

RECOVERY_BAND_DEG = 0.1
"""A knee has recovered from a push when it is this near, in deg, to its run without the push.

Assumption. One count of the encoder is about 0.08° of the knee, and two runs differ by a count.
"""

TOLERATED_DEVIATION_DEG = 5.0
"""Largest deviation of the knee in deg that a wearer tolerates from a fault.

Assumption. It is more than twice the standard deviation of measured strides, at most 2.1°
(`kneexo.parameters.task.gait.gait_knee_flexion`).
"""

OBSERVED_S = 12.0
"""Time in s for which the knee is observed after the start of a fault.

Assumption. It is longer than a period of the paper's motion of 0.1 Hz, so that a fault is observed
in each phase of this motion.
"""

MARGINS = {"gain": (1.5, 2.0), "phase_deg": (30.0, 45.0), "delay_samples": (1.0, 2.0)}
"""For each margin of a page, the least sufficient value and the least large value.

Assumption. Åström and Murray, Feedback Systems, 2008, Section 9.3, call gains of 2…5 and phases of
30…60° reasonable. Each of these margins belongs to a change of one quantity alone. The disk margin
belongs to changes of gain and phase together.
"""
