"""A rig with hidden effects: recordings whose causes are known, to test a diagnosis with.

Nothing here comes from `ehls_ros`: the equations, the integrator and the meaning of each effect's name are its own. With
nothing hidden, a recording is the rig file's model to numerical precision, plus the sensors' noise.

    from truth_generator import draw_effect, record
    sizes = draw_effect("valve_dead_zone", rng, rig)
    r = record(rig, {"valve_dead_zone": sizes}, "rich", seed=1)
    r.time, r.columns["spool_m"], r.truth["natural"]["valve_dead_zone"]["positive"]
    r.write_csv("data.csv")

`LISTED` are the effects that `ehls_ros` has too, `OUTSIDE` physical effects that it does not have. Each declares its stage,
its range and the listed names that a fair judge would also accept (`near`). `EXPERIMENTS` are the experiments, `degrade`
spoils data afterwards, `visibility` tells how far an effect stands out of the noise.

Conventions:

* Time. The control samples the sensors at t_k, and its command holds from t_k to t_k+1; both are recorded at t_k. The
  disturbance's force and the servo's displacement are linear between samples (constant with `hold=True`).
* Signals. Load pressure and force are separate sensors, and so are position and velocity: a fault of one does not affect the
  other. `spool_m` and `supply_pressure_pa` have no faults. The controller sees what is recorded.
* Friction. An element breaks away in the direction of motion, at sgn(v) F_i >= alpha_i s(v), and sticks from the next reversal
  on. LuGre: dF/dt = sigma0 (v - |v| F/s(v)), sigma0 the sum of the element stiffnesses; Ff = F + sigma_f v.
* Stages are the groups of the effects. An effect with a `site` can act in more than one place: port-side valve faults (dead
  zone, and half the draws of null bias and gain asymmetry) leave the path from command to spool intact and show in the flow.

Files: `kernel` (everything compiled), `effects`, `experiments`, `recording`, `degrade`, `visibility`.
"""

from . import degrade
from .effects import EFFECTS, LISTED, OUTSIDE, Effect, draw_effect
from .experiments import EXPERIMENTS
from .recording import COLUMNS, SENSORS, SERVO_COLUMNS, Recording, record
from .visibility import visibility

__all__ = [
    "COLUMNS", "EFFECTS", "EXPERIMENTS", "LISTED", "OUTSIDE", "SENSORS", "SERVO_COLUMNS", "Effect", "Recording", "degrade",
    "draw_effect", "record", "visibility",
]  # fmt: skip
