"""Rules of the diagnosis: every tuning number with its unit, meaning and origin.

A rule is a plain number in this module's namespace; its annotation holds the rest. :func:`table` lists them all, and the
reference is generated from it.
"""

import sys
from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple, get_args, get_type_hints

Step = Literal[
    "record",
    "stages",
    "evidence",
    "hypotheses",
    "fit",
    "starts",
    "search",
    "verdict",
    "partial answer",
    "free run",
    "baseline",
    "monitor",
]
STEPS: tuple[Step, ...] = get_args(Step)

CHOSEN = "chosen"
"""Origin of a number set by judgement; it is confirmed by the benchmark as a whole, not by a dedicated run."""


class Rule(NamedTuple):
    """Declaration of a tuning number: step, unit, meaning and origin.

    Attributes:
        step: the step of the diagnosis that uses it.
        unit: in SI notation; ``1`` for a pure number, ``nat`` for a difference of log-likelihoods.
        meaning: one sentence.
        origin: source of the value: a benchmark run with its figures, a derivation, or :data:`CHOSEN`.
    """

    step: Step
    unit: str
    meaning: str
    origin: str = CHOSEN


class Entry(NamedTuple):
    """A row of the table."""

    name: str
    value: float
    rule: Rule


def table() -> Iterator[Entry]:
    """Yield every rule in the order of declaration."""
    module = sys.modules[__name__]
    for name, hint in get_type_hints(module, include_extras=True).items():
        for note in getattr(hint, "__metadata__", ()):
            if isinstance(note, Rule):
                yield Entry(name, getattr(module, name), note)


# --- record ------------------------------------------------------------------------------------

MIN_SAMPLES: Annotated[int, Rule("record", "1", "Fewest samples a recording must have.")] = 200

COMMAND_LATENESS: Annotated[
    float, Rule("record", "1", "Fraction of a sampling period by which the time stamp of a held command may be late.")
] = 0.3

SPIKE: Annotated[
    float,
    Rule(
        "record", "1", "Ratio of a lone sample's jump to the median change around it above which a command sample is a spike."
    ),
] = 20.0

SPIKE_NEIGHBOURS: Annotated[int, Rule("record", "1", "Samples over which the median change around a command is taken.")] = 41

MIN_SPIKE: Annotated[
    float, Rule("record", "1", "Fraction of the largest command below which a jump is rounding and not a spike.")
] = 1e-6

ANSWERED: Annotated[
    float,
    Rule(
        "record",
        "1",
        "Fraction of the valve's response to a one-sample command that the spool must show for the command to count as sent.",
    ),
] = 0.3

ANSWERED_WITHIN: Annotated[float, Rule("record", "s", "Longest time the spool may take to show that response.")] = 0.015

MAX_FILLED: Annotated[int, Rule("record", "1", "Most consecutive missing samples that are interpolated.")] = 3

MAX_BAD: Annotated[float, Rule("record", "1", "Largest fraction of a signal that may be missing or outliers.")] = 0.25

MENTIONED_BAD: Annotated[float, Rule("record", "1", "Fraction of bad samples in a signal above which a remark is made.")] = 1e-4

MENTIONED_LOSS: Annotated[float, Rule("record", "1", "Fraction of lost samples above which a remark is made.")] = 1e-3

UNEVEN: Annotated[
    float, Rule("record", "1", "Fraction of the period by which a time step may differ before the sampling is called uneven.")
] = 0.01

MAX_RECORDING: Annotated[
    float, Rule("record", "s", "Longest recording that is used completely; a longer one is sampled in stretches of this total.")
] = 150.0

STRETCHES: Annotated[int, Rule("record", "1", "Stretches taken of a longer recording, spread evenly over it.")] = 15

UNIT_QUANTILE: Annotated[float, Rule("record", "1", "Quantile of a signal's magnitude that counts as its reach.")] = 0.99

SIZE_FACTOR: Annotated[
    float,
    Rule(
        "record",
        "1",
        "Factor between a measured and a modelled quantity above which a unit, a sign or a column is taken to be wrong.",
        "units differ by 60 or more, and rigs whose coefficients were all off by 2 keep within 4",
    ),
] = 10.0

SIZE_FLOW: Annotated[
    float, Rule("record", "1", "The same for the flow, of which more coefficients and the compressed oil are part.")
] = 30.0

SIZE_DOUBT: Annotated[float, Rule("record", "1", "Factor within that bound from which a remark is made.")] = 3.0

SIZE_RELATED: Annotated[
    float,
    Rule(
        "record",
        "1",
        "Correlation from which two quantities count as measurements of one, so that factor and sign are informative.",
    ),
] = 0.9

SIZE_BLOCKS: Annotated[
    int, Rule("record", "1", "Most blocks that signals are averaged over before they are compared by size.")
] = 2000

SIZE_BLOCK: Annotated[float, Rule("record", "s", "Shortest of these blocks.")] = 0.02

SIZE_FEWEST: Annotated[int, Rule("record", "1", "Fewest blocks that determine a factor.")] = 50

SIZE_READINGS: Annotated[int, Rule("record", "1", "Most values and signals that are taken to be wrong at once.")] = 3

SIZE_OUTSIDE: Annotated[
    float,
    Rule(
        "record",
        "1",
        "Distance outside the rig's stroke up to which a position may count from mid-stroke, as a fraction of the stroke.",
    ),
] = 0.1

SPRING_LEFT: Annotated[
    float, Rule("verdict", "1", "Fitted stiffness up to which no spring acts in the force, as a fraction of the rig file's.")
] = 0.05

SPRING_SIGMAS: Annotated[float, Rule("verdict", "1", "The same in standard errors.")] = 2.0

RESOLUTION_SAMPLES: Annotated[int, Rule("record", "1", "Samples in which a signal's resolution is looked for.")] = 20000

RESOLUTION_MISFIT: Annotated[
    float,
    Rule(
        "record", "1", "Largest distance of a difference from a multiple of the smallest step for that step to be a resolution."
    ),
] = 1e-3

# --- stages ----------------------------------------------------------------------------------

WINDOW: Annotated[float, Rule("stages", "s", "Length of the windows of the balances.")] = 0.04

MIN_WINDOW: Annotated[int, Rule("stages", "1", "Fewest samples in a window of a balance.")] = 8

SPOOL_WINDOW: Annotated[float, Rule("stages", "s", "Length of the windows over which spool and sensors are averaged.")] = 0.008

VELOCITY_FIT: Annotated[float, Rule("stages", "s", "Length of the local fit that velocities are taken from.")] = 0.011

SPOOL_SETTLING: Annotated[float, Rule("stages", "s", "Time left out of the spool's residual after a gap in the command.")] = (
    0.08
)

SLOWEST: Annotated[
    float,
    Rule(
        "stages",
        "1",
        "Sampling period relative to the valve's time constant above which commands between two samples would be missed;"
        " and rms change of the command within a sample, relative to its rms, up to which none was missed anyway.",
        "for a sine, the latter is its angular frequency times the period: as slow as the valve",
    ),
] = 0.25

SLOWEST_TURN: Annotated[
    float, Rule("stages", "s", "Sampling period up to which every turn of the piston counts as resolved.")
] = 2.6e-3

TURN_SEEN: Annotated[
    float,
    Rule(
        "stages",
        "1",
        "Path within the sample in which the piston turns, relative to the travel over which static friction builds up, above"
        " which the turn is not resolved: friction is then known only once that travel has been slid SLIDING times.",
        "travel of the test rig's piston in 2.6 ms (SLOWEST_TURN) at its usual 1 m/s²: 3.4 of 380 µm",
    ),
] = 0.01

CLEAR_TURN: Annotated[
    float,
    Rule("stages", "1", "Change of velocity within a sample, in standard deviations of its noise, above which a turn is one."),
] = 5.0

MIN_KEPT_WINDOWS: Annotated[
    float,
    Rule(
        "stages",
        "1",
        "Part of the windows that must be left for a balance to be judged, after unresolved turns or operating points outside"
        " the baselines are removed.",
    ),
] = 0.25

SETTLING: Annotated[
    float, Rule("stages", "s", "Time left out at the start of a stretch, where the state of the friction model is not known.")
] = 0.3

END_SETTLING: Annotated[float, Rule("stages", "s", "Time left out at the end of a recording.")] = 0.06

MEMORY_STEP: Annotated[
    float,
    Rule(
        "stages",
        "s",
        "Longest integration step of an effect's own states.",
        "at twice that, the plays of a hysteresis lag as if by a command delay of 0.13 ms",
    ),
] = 2.5e-4

FRICTION_STEP: Annotated[float, Rule("stages", "s", "Longest integration step of a friction model.")] = 1e-3

FASTEST_SHARE: Annotated[
    float, Rule("stages", "1", "Quantile of the speed for which a stiff friction model is integrated.")
] = 0.999

RELAXED: Annotated[float, Rule("stages", "1", "Relaxation times of a friction model per integration step, at most.")] = 1.5

MAX_STEPS: Annotated[int, Rule("stages", "1", "Most integration steps of a friction model per sample.")] = 40

MIN_STEP: Annotated[
    float, Rule("stages", "s", "Shortest integration step of a separate load; a model that diverges at that step is no rig.")
] = 1e-4

LOAD_STEP: Annotated[float, Rule("stages", "s", "Longest integration step of a separate load.")] = 2.5e-4

GUIDED_STEP: Annotated[
    float,
    Rule(
        "stages", "1", "Integration step of a separate load relative to the guide's time constant of the lighter mass, at most."
    ),
] = 0.6

KEPT_RUNS: Annotated[int, Rule("stages", "1", "Runs of each part of the model that are kept for reuse.")] = 3

# --- evidence ----------------------------------------------------------------------------------

REALISATIONS: Annotated[int, Rule("evidence", "1", "Realisations of sensor noise that the noise floor is averaged over.")] = 8

TOLERANCE: Annotated[
    float, Rule("evidence", "1", "Accuracy no model of a rig exceeds, as a fraction of the largest term in the balance.")
] = 1e-4

RESOLVED_PERIOD: Annotated[
    float,
    Rule("evidence", "s", "Sampling period above which the tolerance holds the error of straight lines between samples."),
] = 1e-3

CLEAR_BEND: Annotated[
    float, Rule("evidence", "1", "Standard deviations of its noise by which a signal must bend between samples to be bent.")
] = 3.0

UNSEEN_COMMANDS: Annotated[
    float,
    Rule("evidence", "1", "Multiple of that period above which a signal bends, or a command changes, unseen between samples."),
] = 1.2

WIDER_FIT: Annotated[
    float,
    Rule(
        "evidence",
        "1",
        "Fraction of its length by which the local fit of the motion is widened at each end to estimate its error.",
    ),
] = 0.2

SLOW_SAMPLES: Annotated[
    float, Rule("evidence", "1", "Fraction of a signal's samples, the slowest, whose noise is taken to be free of jitter.")
] = 0.5

FAST_SAMPLES: Annotated[
    float, Rule("evidence", "1", "Quantile of a signal's rate above which more noise than there is due to jitter.")
] = 0.75

FAST_RATE: Annotated[
    float,
    Rule(
        "evidence", "1", "Rms rate of these samples, in the noise of the slow ones per sample, above which jitter is estimated."
    ),
] = 7.0

MIN_JITTER: Annotated[
    float,
    Rule(
        "evidence",
        "1",
        "Jitter in sampling periods below which it is indistinguishable from the third differences of a smooth signal.",
        "of 47 recordings without jitter, no signal this fast had more; with a jitter of 0.1, half had 0.09 to 0.10",
    ),
] = 0.05

MAX_JITTER: Annotated[
    float,
    Rule(
        "evidence", "1", "Largest jitter in sampling periods.", "a converter that takes this sample or the one before, evenly"
    ),
] = 0.5

VARIANCE_WINDOWS: Annotated[int, Rule("evidence", "1", "Windows over which the noise variance is smoothed.")] = 9

MIN_VARIANCE: Annotated[
    float, Rule("evidence", "1", "Least noise variance of a window, as a fraction of the channel's median variance.")
] = 0.5

FIT_ERROR_WINDOWS: Annotated[int, Rule("evidence", "1", "Windows over which the error of the local fit is smoothed.")] = 3

LEAD_WINDOWS: Annotated[
    int, Rule("evidence", "1", "Windows over which the error of an unseen command is smoothed: a lagging spool remembers it.")
] = 9

SKEW: Annotated[
    float,
    Rule(
        "evidence",
        "1",
        "Fault-free skew of a signal, standard deviation, in its sampling periods; the same for its drift.",
        "1 / √12: even within a sample",
    ),
] = 0.29

OFFSET: Annotated[
    float,
    Rule(
        "evidence",
        "1",
        "Fault-free offset of a converter, standard deviation, as a fraction of UNIT_QUANTILE of its signal.",
        "data sheets of 12-bit converters state some units of 1 / 4096 at most",
    ),
] = 3e-4

MAX_ALLOWED: Annotated[float, Rule("evidence", "1", "Largest fault-free error of the measurement, in standard deviations.")] = (
    3.0
)

EDGE: Annotated[
    float,
    Rule(
        "evidence",
        "1",
        "Weight of each further standard deviation; a hard bound would stop fits.",
        "a second-order valve distinguished from a delay: 10 and 30 find it, 100 and more do not where signals are skewed",
    ),
] = 30.0

MIN_ALLOWED: Annotated[
    float, Rule("evidence", "1", "Variance in units of the noise below which a direction is not allowed for.")
] = 0.01

HUBER: Annotated[
    float, Rule("evidence", "1", "Whitened residual above which the loss grows linearly, so that a few windows do not decide.")
] = 3.0

MIN_NOISE_POWER: Annotated[
    float, Rule("evidence", "1", "Least mean square ascribed to noise in a whitened residual; the floor holds a tolerance too.")
] = 0.8

MAX_RESIDUAL: Annotated[
    float, Rule("evidence", "1", "Whitened residual that stands for any larger one and for a model that diverges.")
] = 1e6

BLOCK: Annotated[float, Rule("evidence", "s", "Length of the blocks that cross-validation leaves out.")] = 2.5

MIN_BLOCKS: Annotated[int, Rule("evidence", "1", "Fewest blocks of a recording.")] = 6

MAX_BLOCKS: Annotated[int, Rule("evidence", "1", "Most blocks of a recording.")] = 60

MAX_NOISE_SCALE: Annotated[
    float,
    Rule("evidence", "1", "Largest factor by which the loss saved by averaging noise is scaled up for underestimated noise."),
] = 2.0

PENALTY: Annotated[float, Rule("evidence", "nat", "Cost of each free parameter of a hypothesis.")] = 3.0

MAX_SQUARE: Annotated[
    float,
    Rule(
        "evidence",
        "1",
        "Square at which a whitened residual is cut off when a channel's scatter is estimated.",
        "HUBER squared",
    ),
] = 9.0

NOISE_LOSS: Annotated[
    float, Rule("evidence", "1", "Multiple of the loss due to noise that a residual may have before the rest counts as excess.")
] = 1.5

HELD_OUT_CUTOFF: Annotated[
    float, Rule("evidence", "1", "Relative singular value below which a direction is left out of the step to the held-out fit.")
] = 1e-10

# --- hypotheses --------------------------------------------------------------------------------

OUTER: Annotated[
    float,
    Rule(
        "hypotheses",
        "1",
        "Fraction of a signal's samples that must lie below a threshold sought at the upper end of its range.",
    ),
] = 0.5

MAX_LINE_PERIODS: Annotated[
    float,
    Rule(
        "hypotheses",
        "1",
        "Periods within a window of the balances up to which a spectral line is sought.",
        "the mean over the window then is a sixth of the line's amplitude, and soon zero",
    ),
] = 2.0

# --- fit ---------------------------------------------------------------------------------------

CHANGE: Annotated[
    float, Rule("fit", "1", "Least norm of the change in whitened residuals that a difference quotient's step should make.")
] = 5.0

CHANGE_FRACTION: Annotated[
    float,
    Rule(
        "fit",
        "1",
        "The same as a fraction of the residuals' norm: where friction elements break away early or late, they are rough.",
    ),
] = 0.03

MAX_COUNTED: Annotated[float, Rule("fit", "1", "Square at which a whitened residual is cut off in that norm.")] = 1e6

MIN_CHANGE: Annotated[float, Rule("fit", "1", "Fraction of that change below which the step is enlarged.")] = 0.1

MAX_CHANGE: Annotated[float, Rule("fit", "1", "Multiple of that change above which the step is shortened.")] = 5.0

STEP_GROWTH: Annotated[float, Rule("fit", "1", "Largest factor by which a step is enlarged at once.")] = 1e3

STEP_SHRINKAGE: Annotated[float, Rule("fit", "1", "Smallest factor by which a step is shortened at once.")] = 0.01

ENLARGED_BELOW: Annotated[float, Rule("fit", "1", "Fraction of a parameter's range below which its step may be enlarged.")] = (
    0.2
)

MAX_FIT_STEP: Annotated[float, Rule("fit", "1", "Longest step, as a fraction of a parameter's range.")] = 0.25

STEP_TRIES: Annotated[int, Rule("fit", "1", "Most sizes tried for one step.")] = 5

FIRST_STEP: Annotated[float, Rule("fit", "1", "First step, as a fraction of the parameter's value.")] = 1e-2

FIRST_STEP_AT_ZERO: Annotated[
    float, Rule("fit", "1", "First step of a parameter that is zero, as a fraction of its range.")
] = 1e-4

MAX_ITERATIONS: Annotated[int, Rule("fit", "1", "Most Gauss-Newton steps of a fit.")] = 8

CONVERGED: Annotated[float, Rule("fit", "nat", "Decrease of the loss below which a fit has settled.")] = 0.02

CONVERGED_FRACTION: Annotated[float, Rule("fit", "1", "The same as a fraction of the loss, added to it.")] = 1e-4

CONVERGED_EXCESS: Annotated[
    float,
    Rule(
        "fit",
        "1",
        "The same, for a fit whose runs are expensive, as a fraction of the loss beyond noise: details say little then.",
    ),
] = 3e-3

MANY_PARAMETERS: Annotated[
    int,
    Rule(
        "fit",
        "1",
        "Free parameters above which derivatives are updated and not evaluated again after every step.",
        "fits of about 10 take at most 70 evaluations then, on EMPS, instead of 104 to 191",
    ),
] = 6

LOW_DAMPING: Annotated[float, Rule("fit", "1", "Levenberg damping of the first step from fresh derivatives.")] = 1e-6

MIN_DAMPING: Annotated[float, Rule("fit", "1", "Least Levenberg damping, also used to predict the result of a step.")] = 1e-9

DAMPED: Annotated[float, Rule("fit", "1", "Levenberg damping tried after an undamped step that does not help.")] = 0.1

DAMPING_FACTOR: Annotated[
    float, Rule("fit", "1", "Factor on the damping from one failed step to the next, and its inverse after a good one.")
] = 10.0

MAX_TRIES: Annotated[int, Rule("fit", "1", "Most dampings tried for one step.")] = 4

SHORTENED: Annotated[float, Rule("fit", "1", "Fraction of the first step that is tried when the full step falls short.")] = 0.3

TRUSTED: Annotated[
    float,
    Rule(
        "fit", "1", "Fraction of its predicted decrease that a step must reach for its derivatives to be updated, not redone."
    ),
] = 0.5

MIN_STEP_EFFICIENCY: Annotated[
    float, Rule("fit", "1", "Fraction of its predicted decrease below which a step shows that the loss is too rough to go on.")
] = 0.05

MIN_STEP_FRACTION: Annotated[
    float, Rule("fit", "1", "Fraction of the loss below which a step's decrease must lie as well for the fit to stop there.")
] = 5e-3

# --- starts ------------------------------------------------------------------------------------

SCREENED_BLOCKS: Annotated[int, Rule("starts", "1", "Blocks of the recording in which the starting values are compared.")] = 8

PROMISING: Annotated[float, Rule("starts", "nat", "Predicted gain above which a hypothesis is fitted.")] = 5.0

MORE_PROMISING: Annotated[
    float, Rule("starts", "1", "Ratio of predicted gains above which another start replaces the one that is best alone.")
] = 1.5

EXTENSIONS: Annotated[int, Rule("starts", "1", "Additional causes that are fitted beside each hypothesis.")] = 5

LINES: Annotated[int, Rule("starts", "1", "Spectral lines of a residual from which periodic disturbances start.")] = 3

LINE_SAMPLES: Annotated[int, Rule("starts", "1", "Fewest windows in which spectral lines are looked for.")] = 16

LINE_CLIP: Annotated[
    float, Rule("starts", "1", "Whitened residual at which the signal is clipped before its spectrum is taken.")
] = 20.0

LINE_PADDING: Annotated[int, Rule("starts", "1", "Zero padding of the spectrum, as a multiple of the signal's length.")] = 4

LINE_WIDTH: Annotated[
    float, Rule("starts", "1", "Half width of the band removed around a line, in multiples of the frequency resolution.")
] = 3.0

LOWEST_LINE: Annotated[float, Rule("starts", "1", "Lowest line, in periods within the recording.")] = 2.0

# --- search ------------------------------------------------------------------------------------

NEEDED_GAIN: Annotated[
    float,
    Rule("search", "nat", "Gain on held-out data, less the penalty, that a further cause must bring; noise alone does not."),
] = 20.0

MIN_SIGMAS: Annotated[
    float,
    Rule("search", "1", "Standard errors by which a cause's best determined parameter must differ from its neutral value."),
] = 4.5

NINE_OF_TEN: Annotated[
    float, Rule("search", "1", "Standard deviations below which a normal variable lies in nine of ten cases.", "a quantile")
] = 1.2816

RELEVANT: Annotated[
    float,
    Rule("search", "1", "Change of the balance, as a fraction of its largest term, below which a cause does not matter."),
] = 5e-4

RELEVANT_BESIDE: Annotated[
    float,
    Rule("search", "1", "The same where another cause already acts in the channel, whose form need not be exactly its file's."),
] = 1e-3

MIN_GAIN_RATIO: Annotated[
    float,
    Rule(
        "search",
        "1",
        "Minimum gain of a cause, as a fraction of the possible gain of its change of the residuals; 1 if fitted and linear.",
    ),
] = 0.1

RECURRING: Annotated[
    float,
    Rule("search", "1", "Fraction of its gain that a further cause must have beyond the block in which it gains most."),
] = 0.25

SHOWN: Annotated[
    float,
    Rule("search", "1", "Rms change in units of the noise below which a cause may be an error of the noise floor itself."),
] = 0.5

RARE_QUANTILE: Annotated[
    float, Rule("search", "1", "Quantile of a residual that stands for rare errors, which a mean would hide.")
] = 0.99

RARE_FACTOR: Annotated[float, Rule("search", "1", "Factor by which that quantile may exceed the limit of the rms.")] = 5.0

REMOVED_EXCESS: Annotated[
    float, Rule("search", "1", "Fraction of the excess a hypothesis leaves that a further cause must gain.")
] = 0.1

PROMISED_EXCESS: Annotated[
    float, Rule("search", "1", "Fraction of that gain which must be predicted for a fit to be made.")
] = 0.5

NEEDED_SHARE: Annotated[
    float,
    Rule(
        "search",
        "1",
        "Fraction of the remainder of the others that a further cause must close if it gains less than REMOVED_EXCESS.",
    ),
] = 0.25

CLOSED: Annotated[
    float, Rule("search", "1", "Minimum fraction of the removable error a cause must explain to be reported.")
] = 0.95

ALL_BUT_FORM: Annotated[
    float,
    Rule(
        "search",
        "1",
        "Fraction of the removable error above which the named causes lack nothing but the exact form of an effect.",
        "a form that is off by 3 % in amplitude leaves 0.001 of the power",
    ),
] = 0.999

SIMPLER: Annotated[
    float, Rule("search", "1", "Fraction of a cause's gain that may be given up for a hypothesis with fewer parameters.")
] = 5e-3

BETTER: Annotated[float, Rule("search", "nat", "Gain for which a cause is exchanged for a rival.")] = 1.0

BEAM: Annotated[int, Rule("search", "1", "Hypotheses carried on to the next number of causes.")] = 3

FITTED: Annotated[int, Rule("search", "1", "Hypotheses fitted to the end, of those tried together.")] = 5

POLISHED: Annotated[int, Rule("search", "1", "Hypotheses of these that are fitted further if they have not settled.")] = 3

POLISHING_STEPS: Annotated[int, Rule("search", "1", "Gauss-Newton steps of such a further fit.")] = 25

REACH: Annotated[
    float, Rule("search", "1", "Fraction of the best gain that an unsettled fit must predict to be fitted further.")
] = 0.9

TRIED_SINGLES: Annotated[int, Rule("search", "1", "Single causes that are tried.")] = 24

FITTED_SINGLES: Annotated[int, Rule("search", "1", "Single causes that are fitted to the end.")] = 10

MAX_CAUSES: Annotated[int, Rule("search", "1", "Most causes that are sought together.")] = 3

MAX_EXCHANGES: Annotated[int, Rule("search", "1", "Most rounds in which causes are exchanged or dropped.")] = 4

# --- verdict -----------------------------------------------------------------------------------

SCATTER: Annotated[
    float, Rule("verdict", "1", "Ratio of residual power to noise power above which something other than noise may remain.")
] = 2.5

RARE_SCATTER: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "The same for RARE_QUANTILE of the squares, as a multiple of SCATTER.",
        "rounded up from 6.6, that quantile of the squares of Gaussian noise",
    ),
] = 7.0

CLEAR: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "Multiple of the noise's rms by which a residual stands clear of it: where no cause is named, that matters however"
        " small it is beside the largest term, and even if it comes from one block only.",
        "a constant force of 2.6 times the noise below 25 Hz is 1.4 times that of the windows; of 50 healthy recordings of"
        " benchmarks/diagnosis none comes near",
    ),
] = 1.0

LITTLE: Annotated[
    float, Rule("verdict", "1", "Ratio of residual power to noise power up to which a cause has left nothing in its channel.")
] = 1.5

LEFT_BY_FORM: Annotated[
    float, Rule("verdict", "1", "Fraction of the removable error above which the remainder casts doubt on a cause.")
] = 0.01

STANDS_OUT: Annotated[
    float, Rule("verdict", "1", "Ratio of rms remainder to noise above which the remainder casts doubt on a cause.")
] = 3.0

FORM_RIGHT: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "Factor on the probability of a cause that leaves such a remainder.",
        "right in 3 of 6 in 290 cases of benchmarks/diagnosis, seeds 1601269076 and 550123",
    ),
] = 0.5

BOTH_RIGHT: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "Factor on the probability of two causes in one stage: an effect outside the list can look like two that are on it.",
        "right in 5 of 8 in 191 cases of benchmarks/diagnosis, seed 1426017875; in 26 of 28 in different stages",
    ),
] = 0.6

FORM: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "Uncertainty of a parameter due to the effect's form, as a fraction of its distance from neutral.",
        "held the truth in 202 of 219 intervals of benchmarks/diagnosis, seed 550123; half of it in 195, twice in 206",
    ),
] = 1e-2

EQUAL: Annotated[float, Rule("verdict", "nat", "Gain by which a rival may fall short of a cause and still be equivalent.")] = (
    4.0
)

EQUAL_FRACTION: Annotated[
    float, Rule("verdict", "1", "The same as a fraction of the cause's gain: no effect has exactly the form of its file.")
] = 2e-2

RIVALS: Annotated[int, Rule("verdict", "1", "Rivals reported for each cause.")] = 5

RESAMPLED: Annotated[int, Rule("verdict", "1", "Bootstrap samples of the blocks for probabilities and intervals.")] = 1000

REMOVABLE: Annotated[
    float,
    Rule("verdict", "1", "Ratio of residual power to noise power above which a channel counts towards the closed fraction."),
] = 1.1

MIN_REMOVABLE: Annotated[
    float, Rule("verdict", "1", "Removable power, as a fraction of the noise's, below which the closed fraction is zero.")
] = 0.01

SLIDING: Annotated[
    float,
    Rule("verdict", "1", "Travel, in multiples of that over which static friction builds up, above which a piston slides."),
] = 6.0

MAX_UNDETECTED: Annotated[
    float, Rule("verdict", "1", "Smallest detectable change of a stage's key parameter, as a fraction of its nominal value.")
] = 0.3

MAX_UNDETECTED_BESIDE_SPREAD: Annotated[
    float, Rule("verdict", "1", "The same of a recording judged against baselines, whose healthy spread may hide more.")
] = 1.0

ENOUGH_STAGES: Annotated[
    float, Rule("verdict", "1", "Fraction of the recorded stages that must be excited for the model to be called consistent.")
] = 0.5

SENSORS_FIRST: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "Weight of the sensors' stage when the unknown stage is chosen: two sensors that disagree need no model.",
    ),
] = 1e6

KNOTS: Annotated[int, Rule("verdict", "1", "Knots of the piecewise linear curve that relates a residual to a signal.")] = 12

RIDGE: Annotated[
    float, Rule("verdict", "1", "Ridge of that regression, as a fraction of the mean curvature, for knots without data.")
] = 1e-3

STRONGEST_CLIP: Annotated[float, Rule("verdict", "1", "Whitened residual at which that regression clips.", "5 times HUBER")] = (
    15.0
)

DEPENDS: Annotated[
    float, Rule("verdict", "1", "Fraction of a residual's variance a signal must explain on held-out data to be named.")
] = 0.05

DEPENDS_BESIDE: Annotated[
    float,
    Rule(
        "verdict",
        "1",
        "Fraction of the variance explained by the strongest signal that another must reach to be named beside it.",
    ),
] = 0.4

# --- partial answer ---------------------------------------------------------------------------

FORM_FREEDOMS: Annotated[
    float,
    Rule(
        "partial answer",
        "1",
        "Independent windows equivalent to a whole recording where only errors of form remain.",
        "held the truth in 56 of 62 intervals of benchmarks/diagnosis --exam partial, seeds 9001, 9002, 61977 and 815209",
    ),
] = 10.0

WORTHWHILE: Annotated[
    float,
    Rule("partial answer", "1", "Fraction of the removable error that causes must close to be named although more remains."),
] = 0.5

FORM_LEFT: Annotated[
    float,
    Rule(
        "partial answer",
        "1",
        "Largest remainder, relative to the largest term of the balance, that the form of a model may leave.",
        "twice the 5 % that models of real rigs are off by in one stage",
    ),
] = 0.1

MIN_PROBABILITY: Annotated[
    float,
    Rule(
        "partial answer",
        "1",
        "Probability that a cause, or another in its place, is there at all, below which it is not named beside others.",
        "on EMPS with three values of the rig file 30 % off, in two patterns of signs: an absent cause has at most 0.06, one"
        " that is present 0.3 or more, but for one wrong value with 0.15",
    ),
] = 0.2

FORM_ERROR: Annotated[
    float,
    Rule(
        "partial answer",
        "1",
        "Change of a balance, as a fraction of its largest term, that a further cause must make.",
        "models of real rigs are off by up to 5 % in any stage, and some effect of the list resembles that",
    ),
] = 0.05

RIGHT_BESIDE_FORM: Annotated[
    float,
    Rule(
        "partial answer",
        "1",
        "Factor on the probability of a cause that is named although more than noise remains.",
        "right in 58 of 61 that would have 0.85 or more without it, in benchmarks/diagnosis --exam partial, seeds 9001, 9002,"
        " 40417, 52093, 61977 and 815209; rounded down, as they are few",
    ),
] = 0.9

# --- free run --------------------------------------------------------------------------------

FREE_RUN: Annotated[float, Rule("free run", "s", "Longest time simulated without the measured states.")] = 20.0

FREE_START: Annotated[float, Rule("free run", "s", "Time over which the initial state of a free run is averaged.")] = 0.01

PAST: Annotated[float, Rule("free run", "s", "Time before a window of a prediction from which its initial state is taken.")] = (
    0.02
)

FEWEST_PAST: Annotated[int, Rule("free run", "1", "Fewest samples from which that state is taken.")] = 8

STARTS_A_WINDOW: Annotated[
    int, Rule("free run", "1", "Number of windows of a prediction that start within the length of the shortest.")
] = 4

PAST_ORDER: Annotated[int, Rule("free run", "1", "Order of the polynomial fitted to them.")] = 2

MOVED: Annotated[
    float,
    Rule("free run", "1", "Standard deviation of a signal relative to its noise above which a free run is compared with it."),
] = 10.0

BEYOND_STROKE: Annotated[
    float, Rule("free run", "1", "Distance beyond the stroke, relative to the stroke, at which a free run is stopped.")
] = 1.0

# --- baseline ----------------------------------------------------------------------------------

COEFFICIENT_STEP: Annotated[
    float, Rule("baseline", "1", "Relative change of a coefficient by which the derivative of a residual is taken.")
] = 0.01

BASELINE_STEPS: Annotated[int, Rule("baseline", "1", "Most steps in which the rig is fitted to the baselines.")] = 20

BASELINE_FREEDOMS: Annotated[
    float,
    Rule(
        "baseline",
        "1",
        "Windows of a channel, in effect, over which errors of form average out in that fit.",
        "rig files 30 % off in three values: fewer leave much of the error, more drag static friction away",
    ),
] = 30.0

LEFT_ERROR: Annotated[
    float,
    Rule(
        "baseline",
        "1",
        "Relative error of a coefficient after that fit, standard deviation, where the data do not identify it.",
    ),
] = 0.2

AREA_ERROR: Annotated[float, Rule("baseline", "1", "Relative error of the piston area, standard deviation.")] = 0.05

SPREAD: Annotated[
    float,
    Rule("baseline", "1", "Relative change of a coefficient from recording to recording that is no fault, standard deviation."),
] = 3e-3

HOMOGENEOUS: Annotated[
    float,
    Rule(
        "baseline",
        "1",
        "Rest of a residual that the coefficients' terms do not form, relative to the noise, below which they form all of it.",
        "of an incomplete sum, such as one without a measured load, all of the noise is left",
    ),
] = 0.3

SPREAD_WITH_OIL: Annotated[
    float, Rule("baseline", "1", "The same for friction and leakage, which follow the oil and its temperature.")
] = 0.01

SPREAD_OF_OFFSET: Annotated[
    float, Rule("baseline", "1", "The same for a channel's offset, as a fraction of its largest term.")
] = 2e-4

WARMER: Annotated[
    float,
    Rule(
        "baseline",
        "K",
        "Change of the oil's temperature that may change a coefficient that follows the oil by LEFT_ERROR, others by less as"
        " they spread less.",
        "the viscosity of mineral oil falls by some 3 % per K at 40 °C; a third of that, as little of the friction is viscous",
    ),
] = 20.0

FUNCTION_SPREAD: Annotated[
    float, Rule("baseline", "1", "The same for the smooth remainder, as a fraction of its standard deviation.")
] = 0.1

SECTIONS: Annotated[
    int, Rule("baseline", "1", "Sections of an only baseline that stand for recordings when the healthy spread is estimated.")
] = 3

SPREAD_STEPS: Annotated[int, Rule("baseline", "1", "Rounds in which that spread is estimated.")] = 12

MAX_LEARNT: Annotated[int, Rule("baseline", "1", "Most windows of all baselines together that a channel is learnt from.")] = (
    9000
)

TOGETHER: Annotated[
    float, Rule("baseline", "1", "Number of neighbouring windows that the sensors' noise moves together.", "windows overlap")
] = 3.0

MIN_SCALE: Annotated[float, Rule("baseline", "1", "Least scale of a signal, as a fraction of its largest magnitude.")] = 1e-3

SINGLE_CENTRES: Annotated[int, Rule("baseline", "1", "Most centres of the function of one signal.")] = 20

JOINT_CENTRES: Annotated[int, Rule("baseline", "1", "Most centres of the function of all signals together.")] = 60

SMOOTH: Annotated[
    float, Rule("baseline", "1", "Length over which such a function varies, in units of a signal's scale near its median.")
] = 0.5

RESOLVED_KERNEL: Annotated[
    float, Rule("baseline", "1", "Fraction of a function's variance that may be left out at any point.")
] = 1e-3

COLLINEAR: Annotated[
    float, Rule("baseline", "1", "Relative singular value below which derivatives by coefficients count as the same.")
] = 0.01

MIN_FUNCTION: Annotated[
    float, Rule("baseline", "1", "Least standard deviation of such a function, as a fraction of the one it starts from.")
] = 1e-3

STRETCH: Annotated[
    int,
    Rule(
        "baseline",
        "1",
        "Windows in each such stretch: longer than the memory of the remainder, too short to hold all rare events.",
    ),
] = 40

FOLDS: Annotated[int, Rule("baseline", "1", "Parts in which stretches are held out when the remainder is learnt.")] = 5

LEARNING_STEPS: Annotated[int, Rule("baseline", "1", "Rounds in which sizes and noise of the remainder are estimated.")] = 8

ROBUST_STEPS: Annotated[int, Rule("baseline", "1", "Rounds of Huber's weights in each.")] = 3

MAX_MEMORY: Annotated[int, Rule("baseline", "1", "Windows over which the remainder may be correlated, at most.")] = 40

UNCORRELATED: Annotated[float, Rule("baseline", "1", "Correlation below which windows no longer err together.")] = 0.05

SEEN: Annotated[
    float,
    Rule("baseline", "1", "Fraction of a signal's samples at each end of its range that do not count as having been there."),
] = 1e-3

MAX_EXTRAPOLATION: Annotated[
    float,
    Rule("baseline", "1", "Distance from the middle, in half ranges of the baselines, beyond which nothing is judged."),
] = 2.0

MARGIN: Annotated[
    float, Rule("baseline", "1", "Fraction of a signal's range in the baselines by which it may leave it and still be covered.")
] = 0.05

NOISE_MARGIN: Annotated[
    float, Rule("baseline", "1", "Standard deviations of its noise by which it may leave it beside that.")
] = 5.0

MENTIONED_UNSEEN: Annotated[
    float, Rule("baseline", "1", "Fraction of samples that are not covered above which a remark is made.")
] = 0.1

# --- monitor -----------------------------------------------------------------------------------

MONITOR_BLOCK: Annotated[float, Rule("monitor", "s", "Length of a block, over which the monitor sums.", "BLOCK")] = 2.5

MONITOR_AT_ONCE: Annotated[int, Rule("monitor", "1", "Blocks that are compared with the model at once, which saves work.")] = 3

MONITOR_LEAD: Annotated[
    float,
    Rule(
        "monitor",
        "s",
        "Time before a block in which the state of the friction model is found.",
        "three times in which slipping elements relax, 0.5 s: healthy scores then scatter alike in all programmes",
    ),
] = 1.5

HELD_TIME: Annotated[float, Rule("monitor", "s", "Time over which the piston is held if it hardly moves.")] = 0.5

HELD_TRAVEL: Annotated[
    float, Rule("monitor", "1", "Travel, in multiples of that over which static friction builds up, up to which it is held.")
] = 2.0

MONITOR_SQUARE: Annotated[
    float,
    Rule("monitor", "1", "Largest square of a residual in units of its noise floor that counts in a channel's power."),
] = 25.0

MONITOR_SIGNAL: Annotated[
    float,
    Rule(
        "monitor",
        "1",
        "Least ratio of a channel's largest term to its noise floor in a block that counts.",
        "with less, noise in what a gain multiplies biases it by more than half of RELEVANT",
    ),
] = 60.0

BIASED: Annotated[
    float,
    Rule("monitor", "1", "Standard errors by which a healthy rig may seem to depart in a direction that is followed."),
] = 4.0

MOST_SCORE: Annotated[
    float,
    Rule(
        "monitor",
        "1",
        "Score of a block, in units of its scatter, above which it counts no more: one block alone is an incident.",
        "two such blocks exceed what a rate of one alarm in 1000 h takes once the scatter is known well",
    ),
] = 5.0

ALIKE: Annotated[
    float, Rule("monitor", "1", "Correlation of two departures' changes from which on the monitor follows one of them only.")
] = 0.95

MONITOR_REALISATIONS: Annotated[
    int, Rule("monitor", "1", "Realisations of sensor noise that the noise floor of a block is averaged over.")
] = 4

LEARNT_SCATTER: Annotated[
    float,
    Rule(
        "monitor",
        "1",
        "Scatter of a block's scores that is expected before any was measured.",
        "healthy recordings of the truth generator: 0.8 to 2.5",
    ),
] = 1.5

LEAST_SCATTER: Annotated[
    float,
    Rule("monitor", "1", "Least scatter of a block's scores: less shows that the noise floor is too high in a programme."),
] = 1.0

POWER_TOLERATED: Annotated[
    float,
    Rule(
        "monitor",
        "1",
        "Rise of the logarithm of a channel's mean square that is no change: how well a noise floor is known.",
        "healthy programmes of the truth generator: -0.7 to 0.3",
    ),
] = 0.5

LEARNT_BLOCKS: Annotated[int, Rule("monitor", "1", "Blocks that this expectation counts as.")] = 30

LONGEST_DEPENDENCE: Annotated[int, Rule("monitor", "1", "Blocks over which scores of a healthy rig are taken to depend.")] = 8

LONGEST_WATCH: Annotated[int, Rule("monitor", "1", "Blocks of the longest sum: 71 min.")] = 1704

ONSET_DROP: Annotated[
    float, Rule("monitor", "nat", "Loss of likelihood up to which an onset is still possible.", "95 % of a normal error")
] = 1.92

INSEPARABLE: Annotated[
    float,
    Rule(
        "monitor",
        "1",
        "Smallest fraction of a coefficient's information that the others may leave it; with less it is not told.",
    ),
] = 1e-7

TOLD_COEFFICIENT: Annotated[
    float, Rule("monitor", "1", "Largest standard error of a coefficient that is told, as a fraction of its given value.")
] = 0.25

TOLD_ERROR: Annotated[
    float, Rule("monitor", "1", "The same of an offset or an asymmetry, as a fraction of the rig's limit, and of a gain.")
] = 0.01
