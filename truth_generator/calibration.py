"""Calibrate form errors, the deviations of a rig from its model, to the sizes drawn (`draw_forms`)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .effects import is_single
from .experiments import TICK
from .forms import KINDS, LARGEST, PER_STAGE, SMALLEST, STAGES, FormErrors, Rng, Signals, draw_shapes
from .recording import IntegrationStopped, record
from .residuals import largest_terms, load_pressure, model_residuals, rms

ROUNDS, TOLERANCE, TRIES = 4, 0.05, 20


class Scale:
    """Size of form errors in an experiment: the residuals they add to those of the model, relative to the largest terms."""

    def __init__(self, rig: Mapping[str, Any], experiment: str, seed: int, duration: float) -> None:
        """Run the experiment on the model without form errors."""
        self.rig, self.experiment, self.same = rig, experiment, {"seed": seed, "duration": duration, "noise": 0.0}
        plain = record(rig, {}, experiment, **self.same)
        c = plain.columns
        speed = np.gradient(c["position_m"], TICK)
        self.signals = Signals(speed, load_pressure(rig, c), c["force_n"], c["valve_command_m"], c["spool_m"])
        self.terms, self.without = largest_terms(rig, plain), model_residuals(rig, plain)

    def rows(self, forms: FormErrors) -> dict[str, list[float]]:
        """Return the size of form errors in each residual, as a fraction of its largest term."""
        r = record(self.rig, {}, self.experiment, forms=forms, **self.same)
        found = model_residuals(self.rig, r)
        return {
            stage: [
                rms(a - b) / term if term > 0.0 else 0.0
                for a, b, term in zip(found[stage], self.without[stage], self.terms[stage], strict=True)
            ]
            for stage in STAGES
        }

    def sizes(self, forms: FormErrors) -> dict[str, float]:
        """Return the size of form errors in each stage: the root of the sum of squares over its residuals."""
        return {stage: float(np.linalg.norm(rows)) for stage, rows in self.rows(forms).items()}


def draw_forms(
    rng: Rng,
    rig: Mapping[str, Any],
    experiment: str = "rich",
    *,
    seed: int = 1,
    duration: float = 60.0,
    smallest: float = SMALLEST,
    largest: float = LARGEST,
) -> FormErrors:
    """Draw a rig's form errors, `smallest` to `largest` of the largest term in every stage, log-uniformly.

    Args:
        rng: random number generator.
        rig: content of the rig file.
        experiment: the experiment in which they have that size; in others they are larger or smaller.
        seed: seed of the experiment.
        duration: duration of the experiment, s.
        smallest: least size.
        largest: largest size.

    Sizes that the drawn kinds cannot reach are drawn again with other kinds.

    Raises:
        RuntimeError: the sizes were not reached in any draw.
    """
    scale = Scale(rig, experiment, seed, duration)
    for _ in range(TRIES):
        shapes = draw_shapes(rng, scale.signals, smallest, largest, 1 if is_single(rig) else 2)
        try:
            forms = _fitted(shapes, scale)
        except IntegrationStopped:
            # During calibration, some shapes exceed the physical limits of a rig.
            continue
        if forms is not None:
            return forms
    raise RuntimeError(f"form errors of {smallest:g} to {largest:g} of the largest terms: not reached in {TRIES} draws")


def _fitted(shapes: FormErrors, scale: Scale) -> FormErrors | None:
    """Return form errors of the drawn sizes; None if these cannot be reached."""
    forms = _equal(shapes, scale)
    for _ in range(ROUNDS):
        reached = scale.sizes(forms)
        factors = {stage: forms.sizes[stage] / reached[stage] for stage in STAGES}
        if all(abs(factor - 1.0) < TOLERANCE for factor in factors.values()):
            return replace(forms, sizes=reached)
        forms = _within(forms.scaled({kind: factors[stage] for stage in STAGES for kind in forms.kinds[stage]}))
    return None


def _equal(forms: FormErrors, scale: Scale) -> FormErrors:
    """Scale the kinds in each stage to equal sizes that add up to the drawn size, within the kinds' limits."""
    for place in range(PER_STAGE):
        chosen = tuple(forms.kinds[stage][place] for stage in STAGES)
        rows = scale.rows(forms.only(chosen))
        wanted = {kind: forms.sizes[KINDS[kind].stage] / PER_STAGE**0.5 for kind in chosen}
        found = {kind: rows[KINDS[kind].stage][KINDS[kind].row] for kind in chosen}
        forms = _within(forms.scaled({kind: wanted[kind] / max(found[kind], 1e-12) for kind in chosen}))
    return forms


def _within(forms: FormErrors) -> FormErrors:
    """Return form errors with every kind limited to the largest value a rig could have."""
    most = {KINDS[kind].amplitude: KINDS[kind].most for kinds in forms.kinds.values() for kind in kinds}
    fields = {
        name: float(np.clip(value, -most[name], most[name])) if name in most else value for name, value in forms.fields.items()
    }
    return replace(forms, fields=fields)
