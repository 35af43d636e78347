"""Smallest stability margins that kneexo calls good."""

SOUND_DISK_MARGIN = 0.5
"""Smallest disk margin of a sound loop. Assumption: 28° of phase alone, or gains of 0.6…1.67."""

MARGINS = {"gain": (1.5, 2.0), "phase_deg": (30.0, 45.0), "delay_samples": (1.0, 2.0)}
"""For each margin of a page the least value that is sufficient, and the least that is large.

Assumption. Åström and Murray, Feedback Systems, 2008, Section 9.3, call gains of 2…5 and phases of
30…60° reasonable. Each of these margins changes alone, the disk margin gain and phase together.
"""
