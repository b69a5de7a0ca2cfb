"""Generate recordings of a rig with known hidden effects, to test a diagnosis.

Nothing here comes from `ehls_ros`: equations, integrator and definitions of the effects are independent. With
no hidden effect, a recording equals the rig file's model to numerical precision, plus the sensors' noise.

    from truth_generator import draw_effect, record
    sizes = draw_effect("valve_dead_zone", rng, rig)
    r = record(rig, {"valve_dead_zone": sizes}, "rich", seed=1)
    r.time, r.columns["spool_m"], r.truth["natural"]["valve_dead_zone"]["positive"]
    r.write_csv("data.csv")

`draw_other_form` draws an effect by another formula; `OTHER_FORMS` lists the effects and their formulas.

No rig matches its model: `draw_forms` draws form errors of a given size in every stage, which `record(..., forms=...)` adds.
`draw_day` draws the condition of a healthy rig. `measured` samples a fine recording with skew, jitter and offsets. `variants`
has the tables that a rig's data acquisition may write instead.

A rig file with `cylinder: {model: two_chamber}` is a single rod: its recordings have both chamber pressures, its effects are
those of `listed_of(rig)` and `outside_of(rig)`, and effects of a chamber or an edge have a `side`.

    forms = draw_forms(rng, rig)
    fine = record(rig, {}, "rich", seed=1, rate=FINE, noise=0.0, forms=forms)
    r = measured(fine, rig, 1, draw_measurement(rng, fine.columns, skew=1.0, jitter=0.1))

`LISTED` are the effects that `ehls_ros` has too, `OUTSIDE` physical effects that it lacks. Each declares its stage, its range
and the listed names that are also acceptable as an answer (`near`). `EXPERIMENTS` are the experiments. `degrade` corrupts
recordings afterwards, and `visibility` returns the signal-to-noise ratio of an effect.

Conventions:

* Time. The control samples the sensors at t_k, and its command holds from t_k to t_k+1; both are recorded at t_k. The
  disturbance's force and the servo's displacement are linear between samples (constant with `hold=True`).
* Signals. Load pressure and force are separate sensors, as are position and velocity: a fault of one does not affect the
  other. `spool_m` and `supply_pressure_pa` have no faults. The controller uses the recorded values.
* Friction. An element breaks away in the direction of motion, at sgn(v) F_i >= alpha_i s(v), and sticks from the next reversal
  on. LuGre: dF/dt = sigma0 (v - |v| F/s(v)), sigma0 the sum of the element stiffnesses; Ff = F + sigma_f v.
* Stages are the groups of the effects. An effect with a `site` can act in more than one place: port-side valve faults (dead
  zone, and half the draws of null bias and gain asymmetry) leave the path from command to spool intact and show in the flow.

Files: `kernel` (all compiled equations), `effects`, `single_rod`, `other_forms`, `forms`, `experiments`, `recording`,
`measurement`, `variants`, `degrade`, `residuals`, `visibility`, `calibration`.
"""

from . import degrade, variants
from .calibration import draw_forms
from .effects import EFFECTS, LISTED, OUTSIDE, Effect, draw_effect, listed_of, outside_of
from .experiments import EXPERIMENTS
from .forms import Day, FormErrors, draw_day
from .measurement import FINE, Measurement, draw_measurement, measured
from .other_forms import OTHER_FORMS, draw_other_form
from .recording import COLUMNS, SENSORS, SERVO_COLUMNS, Recording, record
from .visibility import visibility

__all__ = [
    "COLUMNS", "EFFECTS", "EXPERIMENTS", "FINE", "LISTED", "OTHER_FORMS", "OUTSIDE", "SENSORS", "SERVO_COLUMNS", "Day",
    "Effect", "FormErrors", "Measurement", "Recording", "degrade", "draw_day", "draw_effect", "draw_forms", "draw_measurement",
    "draw_other_form", "listed_of", "measured", "outside_of", "record", "variants", "visibility",
]  # fmt: skip
