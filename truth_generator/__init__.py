"""A rig that knows more than its rig file: recordings whose hidden causes are known, to judge a diagnosis by.

Nothing here comes from `ehls_ros`: own equations, own integrator, own reading of what each effect's name means. With nothing
hidden a recording is the rig file's model, to numerical precision, plus the sensors' noise.

    from truth_generator import draw_effect, record
    sizes = draw_effect("valve_dead_zone", rng, rig)
    r = record(rig, {"valve_dead_zone": sizes}, "rich", seed=1)
    r.time, r.columns["spool_m"], r.truth["natural"]["valve_dead_zone"]["positive"]
    r.write_csv("data.csv")

`LISTED` are the effects of the design, `OUTSIDE` physical ones that none of them is; each member knows its stage, its range and
what else a fair judge would take for it (`near`). `EXPERIMENTS` names what can be done with the rig, `degrade` what happens to
data afterwards, `visibility` how far an effect stands out of the noise.

How it is to be read:

* Time. The control samples the sensors at t_k, and its command holds from t_k to t_k+1; both are recorded at t_k. The
  disturbance's force and the servo's displacement run straight from sample to sample (`hold=True`: stand still in between).
* Signals. Load pressure and force are two sensors, position and velocity too: a fault of one does not touch the other.
  `spool_m` is where the spool is, `supply_pressure_pa` what the supply is. The controller sees what is recorded.
* Friction. An element breaks away in the direction of motion, at sgn(v) F_i >= alpha_i s(v), and sticks from the next reversal
  on. LuGre: dF/dt = sigma0 (v - |v| F/s(v)), sigma0 the sum of the element stiffnesses; Ff = F + sigma_f v.
* Stages are those of the design's groups. Effects with a `site` can sit in more than one place: port-side valve faults (dead
  zone, and half the draws of null bias and gain asymmetry) leave the command-to-spool path right and show in the flow.

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
