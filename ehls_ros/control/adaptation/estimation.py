"""Run all stages of the adaptation: from readings to estimates, and to the model for the controller."""

import math
from collections.abc import Mapping

from ehls_ros.arrays import Array
from ehls_ros.control.adaptation import area, evidence, flow, friction
from ehls_ros.control.adaptation import valve as valve_stage
from ehls_ros.control.adaptation.correction import COEFFICIENTS, AdaptationLimits, Correction, Estimated, corrected, differs
from ehls_ros.control.adaptation.evidence import AREA, FLOW, SPOOL_READ, VALVE
from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.friction import gms

TURNS = 20
"""Calls in which every stage is solved once; each call solves one stage, so that no cycle waits for all of them."""

FROM_REVERSALS = ("friction_level", "viscous_coefficient", "moving_mass")
"""Names of the coefficients estimated from reversals, in the order of :mod:`ehls_ros.control.adaptation.friction`."""

BANDWIDTH_OFF, BANDWIDTH_CERTAIN = 0.03, 0.01
"""Relative error of the bandwidth in use above which it is replaced, and the standard error required for this."""


class Estimation:
    """Estimates of the errors of a rig file from the cycles so far."""

    def __init__(
        self,
        original: Model,
        limits: AdaptationLimits,
        forgetting: float,
        around: friction.Surroundings | None = None,
        cylinder: str = "double_rod",
        valve: str = "load_flow",
    ) -> None:
        """Start from the rig file's values.

        Args:
            original: the model of the rig file.
            limits: how estimates are used.
            forgetting: time constant of the forgetting of readings [s].
            around: coupling of the piston; None if unknown, so that friction cannot be estimated.
            cylinder: file name of the model's cylinder.
            valve: that of its valve.
        """
        self._original = original
        self._limits = limits
        self._basis = evidence.basis_of(original, limits.reach, forgetting)
        self._memory = evidence.memory(self._basis)
        self._take = evidence.evidence_kernel(cylinder, valve).take
        known = around is not None and isinstance(original.friction, gms.Parameters)
        self._reversals = friction.Reversals(original, around, forgetting) if known and around is not None else None
        self._turn = 0
        self._coefficients = {
            name: Correction(name, original.command_delay if description.unit else 1.0, original.period)
            for name, description in COEFFICIENTS.items()
        }

    def interrupt(self) -> None:
        """Discard incomplete data after an interruption."""
        evidence.interrupt(self._memory)
        if self._reversals is not None:
            self._reversals.interrupt()

    def take(self, measured: Array, command: Array) -> None:
        """Add cycles: readings in the order of ``SENSED``, shape (n, 7), and spool commands [m], shape (n,)."""
        self._take(measured, command, self._basis, self._memory)

    def corrected(self, model: Model, cycles: int) -> Model:
        """Return a model with the corrections so far, after a number of further cycles."""
        self._turn = (self._turn + 1) % TURNS
        match self._turn:
            case 1:
                self._judge(self._valve())
            case 7:
                self._judge(self._area_and_flow())
            case 13:
                self._judge(self._friction())
            case _ if self._reversals is not None:
                self._reversals.look(self._memory.track, self._memory.ring)
            case _:
                pass
        duration = cycles * self._original.period
        moved = [each.move(duration, self._limits) for each in self._coefficients.values()]
        if not any(moved):
            return model
        return corrected(model, self._original, self.values())

    def values(self) -> dict[str, float]:
        """Return the values handed over, relative to the rig file's; the delay in s."""
        return {name: each.value for name, each in self._coefficients.items()}

    def changed(self) -> bool:
        """Return whether any value handed over differs from the rig file."""
        nominal = {"command_delay": self._original.command_delay}
        return any(differs(value, nominal.get(name, 1.0)) for name, value in self.values().items())

    def report(self) -> dict[str, float | str]:
        """Return values and sentences as of the last solution of each stage, without side effects."""
        figures: dict[str, float | str] = dict(self.values())
        figures.update({f"{name}_told": each.sentence(self._limits) for name, each in self._coefficients.items()})
        return figures

    def at_bounds(self) -> tuple[str, ...]:
        """Return a sentence for each coefficient that is handed over at its bound, as the estimate is beyond it."""
        return tuple(each.at_bound(self._limits) for each in self._coefficients.values() if each.capped(self._limits))

    def solve(self) -> None:
        """Estimate all coefficients from the accumulated data."""
        for found in (self._valve(), self._area_and_flow(), self._friction()):
            self._judge(found)

    def _judge(self, found: Mapping[str, Estimated | None]) -> None:
        for name, estimated in found.items():
            self._coefficients[name].judge(estimated, self._limits)

    def _area_and_flow(self) -> dict[str, Estimated | None]:
        size = area.find(self._original, self._memory.area, float(self._memory.counts[AREA, 0]))
        through = flow.find(self._original, self._memory.flow, float(self._memory.counts[FLOW, 0]))
        found: dict[str, Estimated | None] = dict.fromkeys(("piston_area", "discharge_coefficient", "bulk_modulus"))
        if size is not None:
            found["piston_area"] = Estimated(size.area, size.area_std)
        if through is not None:
            self._flow(through, size, found)
        return found

    def _friction(self) -> dict[str, Estimated | None]:
        """Return the estimates from the reversals."""
        found: dict[str, Estimated | None] = dict.fromkeys(FROM_REVERSALS)
        if self._reversals is None:
            return found
        sliding = self._reversals.found()
        if sliding is not None:
            for name, value, std in zip(FROM_REVERSALS, sliding.values, sliding.std, strict=True):
                found[name] = Estimated(float(value), float(std))
        return found

    def _flow(self, through: flow.Found, size: area.Found | None, found: dict[str, Estimated | None]) -> None:
        """Add the estimates of the flow stage; without a load cell, per piston area."""
        usable = size is not None and size.area_std <= self._limits.certain
        scale, scale_std = (size.area, size.area_std) if size is not None and usable else (1.0, 0.0)
        spool_read = self._memory.flags[SPOOL_READ] == 1.0
        parts = (
            ["discharge coefficient"] + ([] if spool_read else ["times valve gain"]) + ([] if usable else ["over piston area"])
        )
        meaning = f"the rig file's {' '.join(parts)}" if len(parts) > 1 else ""
        discharge = through.discharge * scale
        found["discharge_coefficient"] = Estimated(
            discharge, math.hypot(through.discharge_std * scale, through.discharge * scale_std), meaning
        )
        if through.compression > 0.0:
            modulus = 1.0 / (through.compression * scale)
            relative = math.hypot(through.compression_std / through.compression, scale_std / scale)
            found["bulk_modulus"] = Estimated(modulus, modulus * relative)

    def _valve(self) -> dict[str, Estimated | None]:
        bank = self._basis.bank
        found = valve_stage.find(bank, self._memory.valve, float(self._memory.counts[VALVE, 0]))
        if found is None:
            return dict.fromkeys(("valve_gain", "valve_bandwidth", "command_delay"))
        scale = bank.bandwidth / self._original.plant.valve_bandwidth
        certain = found.bandwidth_std < BANDWIDTH_CERTAIN and found.bandwidth > 0.0
        if certain and abs(found.bandwidth - 1.0) > BANDWIDTH_OFF:
            # The slope over the bandwidth is valid only near it.
            self._basis = evidence.with_bandwidth(self._basis, bank.bandwidth * found.bandwidth, self._memory)
        return {
            "valve_gain": Estimated(found.gain, found.gain_std),
            "valve_bandwidth": Estimated(found.bandwidth * scale, found.bandwidth_std * scale),
            "command_delay": Estimated(found.delay, found.delay_std),
        }
