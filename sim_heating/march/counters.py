"""Counters of a march.

Source: docs/theory/equations_march.md, equations 18, 22 and 24.
"""

from __future__ import annotations

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels import block
from sim_heating.march.lanes import LaneMemory


class Counters:
    """What has been counted of the points of an ensemble since its last reset."""

    def __init__(self, memory: LaneMemory) -> None:
        self._memory = memory

    def clear(self) -> None:
        """Set to zero the counters of a march: failures, iterations, samples outside the table or of negative ratio,
        absorbed and emitted energy [J/m2] (docs/theory/equations_march.md, equation 24).
        """
        for g in range(len(self._memory.groups)):
            B = self._memory.block(g)
            for row in (*block.COUNTERS, block.LAG_PAST):
                B[block.scalar_row(row)] = 0.0
            B[block.scalar_row(block.COLUMN)] = -1.0

    @property
    def failures(self) -> FloatArray:
        """(point,) stages not converged since the last reset [-]: docs/theory/equations_thermal_step.md, section 6."""
        return self._memory.scalars(block.FAILED)

    @property
    def iterations(self) -> FloatArray:
        """(point,) Newton iterations since the last reset [-]: docs/theory/equations_thermal_step.md, equation 25."""
        return self._memory.scalars(block.ITERATIONS)

    @property
    def steps(self) -> FloatArray:
        """(point,) time steps taken since the last reset [-]: docs/theory/equations_thermal_step.md, section 9."""
        return self._memory.scalars(block.STEPS)

    @property
    def steps_outside_table(self) -> FloatArray:
        """(point,) number of steps that ended outside the ratio table since the last reset [-].

        For a host, which steps frame by frame; durations of a whole march are docs/theory/equations_march.md,
        equation 19.
        """
        return self._memory.scalars(block.OUTSIDE)

    @property
    def steps_of_negative_ratio(self) -> FloatArray:
        """(point,) number of steps that ended with a negative ratio since the last reset [-].

        The ratio is that of docs/theory/equations_march.md, equation 18; it is not clipped.
        """
        return self._memory.scalars(block.NEGATIVE)

    @property
    def absorbed_J_m2(self) -> FloatArray:
        """(point,) energy that entered at the surface and in gaps since the last reset [J/m2].

        Source: docs/theory/equations_march.md, equation 24.
        """
        return self._memory.scalars(block.ENERGY_IN)

    @property
    def emitted_J_m2(self) -> FloatArray:
        """(point,) energy that left at the back since the last reset [J/m2]; docs/theory/equations_march.md, eq 24."""
        return self._memory.scalars(block.ENERGY_OUT)
