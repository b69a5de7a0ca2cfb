"""Rules of the diagnosis: numbers of judgement, each with its meaning and, unless it was chosen by judgement, its origin.

A chosen number is confirmed by the benchmark as a whole, not by a dedicated run. Numbers of an algorithm, such as iteration
counts and integration steps, are declared in its module. The reference lists both, by :mod:`ehls_ros.declared_numbers`.
"""

# --- record ------------------------------------------------------------------------------------

MIN_SAMPLES = 200
"""Fewest samples a recording must have."""

COMMAND_LATENESS = 0.3
"""Fraction of a sampling period by which the time stamp of a held command may be late."""

SPIKE = 20.0
"""Ratio of a lone sample's jump to the median change around it above which a command sample is a spike."""

ANSWERED = 0.3
"""Fraction of the valve's response to a one-sample command that the spool must show for the command to count as sent."""

ANSWERED_WITHIN = 0.015
"""Longest time the spool may take to show that response [s]."""

MAX_FILLED = 3
"""Most consecutive missing samples that are interpolated."""

MAX_BAD = 0.25
"""Largest fraction of a signal that may be missing or outliers."""

MENTIONED = 1e-3
"""Fraction of lost samples, or of bad ones in a signal, above which a remark is made."""

UNEVEN = 0.01
"""Fraction of the period by which a time step may differ before the sampling is called uneven."""

SIZE_FACTOR = 10.0
"""Factor between a measured and a modelled quantity above which a unit, a sign or a column is taken to be wrong.

Origin: units differ by 60 or more, and rigs whose coefficients were all off by 2 keep within 4.
"""

SIZE_DOUBT = 3.0
"""Factor within that bound from which a remark is made; and by which swapped pressures must fit better to be taken as such."""

SIZE_RELATED = 0.9
"""Correlation from which two quantities count as measurements of one, so that factor and sign are informative."""

SIZE_OUTSIDE = 0.1
"""Distance outside the rig's stroke up to which a position may count from mid-stroke, as a fraction of the stroke."""

SPRING_LEFT = 0.05
"""Fitted stiffness up to which no spring acts in the force, as a fraction of the rig file's; or MAX_ALLOWED standard errors."""

# --- stages ----------------------------------------------------------------------------------

WINDOW = 0.04
"""Length of the windows of the balances [s]."""

MIN_WINDOW = 8
"""Fewest samples in a window of a balance."""

SPOOL_WINDOW = 0.008
"""Length of the windows over which spool and sensors are averaged [s]."""

VELOCITY_FIT = 0.012
"""Longest local fit that velocities are taken from [s]."""

SPOOL_SETTLING = 0.08
"""Time left out of the spool's residual after a gap in the command, and of each residual at the end of a recording [s]."""

SLOWEST = 0.25
"""Sampling period relative to the valve's time constant above which commands between two samples would be missed; and rms
change of the command within a sample, relative to its rms, up to which none was missed anyway.

Origin: for a sine, the latter is its angular frequency times the period: as slow as the valve.
"""

SLOWEST_TURN = 2.6e-3
"""Sampling period up to which every turn of the piston counts as resolved [s]."""

TURN_SEEN = 0.01
"""Path within the sample in which the piston turns, relative to the travel over which static friction builds up, above which
the turn is not resolved: friction is then known only once that travel has been slid SLIDING times.

Origin: travel of the test rig's piston in 2.6 ms (SLOWEST_TURN) at its usual 1 m/s²: 3.4 of 380 µm.
"""

MIN_KEPT_WINDOWS = 0.25
"""Part of the windows that must be left for a balance to be judged, after unresolved turns or operating points outside the
baselines are removed.
"""

SETTLING = 0.3
"""Time left out at the start of a stretch, where the state of the friction model is not known [s]."""

# --- evidence ----------------------------------------------------------------------------------

TOLERANCE = 1e-4
"""Accuracy no model of a rig exceeds, as a fraction of the largest term in the balance."""

UNSEEN_PERIOD = 1.2e-3
"""Sampling period above which a signal bends, or a command changes, unseen between samples [s]."""

WIDER_FIT = 0.2
"""Fraction of its length by which the local fit of the motion is widened at each end to estimate its error."""

FAST_RATE = 7.0
"""Rms rate of a signal's fastest samples, in the noise of the slow ones per sample, above which jitter is estimated."""

MIN_JITTER = 0.05
"""Jitter in sampling periods below which it is indistinguishable from the third differences of a smooth signal.

Origin: of 47 recordings without jitter, no signal this fast had more; with a jitter of 0.1, half had 0.09 to 0.10.
"""

MAX_JITTER = 0.5
"""Largest jitter in sampling periods.

Origin: a converter that takes this sample or the one before, evenly.
"""

SKEW = 0.29
"""Fault-free skew of a signal, standard deviation, in its sampling periods; the same for its drift.

Origin: 1 / √12: even within a sample.
"""

OFFSET = 3e-4
"""Fault-free offset of a converter, standard deviation, as a fraction of its signal's reach.

Origin: data sheets of 12-bit converters state some units of 1 / 4096 at most.
"""

MAX_ALLOWED = 3.0
"""Standard deviations up to which a deviation may be chance: a fault-free error of the measurement, a bend within noise."""

EDGE = 30.0
"""Weight of each standard deviation beyond MAX_ALLOWED; a hard bound would stop fits.

Origin: a second-order valve distinguished from a delay: 10 and 30 find it, 100 and more do not where signals are skewed.
"""

HUBER = 3.0
"""Whitened residual above which the loss grows linearly, so that a few windows do not decide."""

MIN_NOISE_POWER = 0.8
"""Least mean square ascribed to noise in a whitened residual; the floor holds a tolerance too."""

BLOCK = 2.5
"""Length of the blocks that cross-validation leaves out, and over which the monitor sums [s]."""

MIN_BLOCKS = 6
"""Fewest blocks of a recording."""

MAX_NOISE_SCALE = 2.0
"""Largest factor by which the loss saved by averaging noise is scaled up for underestimated noise."""

PENALTY = 3.0
"""Cost of each free parameter of a hypothesis [nat]."""

MAX_SQUARE = HUBER**2
"""Square at which a whitened residual is cut off when a channel's scatter is estimated."""

# --- hypotheses --------------------------------------------------------------------------------

LINE_PERIODS = 2.0
"""Periods of a spectral line: at most so many within a window of the balances, at least so many within the recording.

Origin: the mean over the window then is a sixth of the line's amplitude, and soon zero; fewer periods in the recording are a
drift, which almost any coefficient fits as well.
"""

# --- starts ------------------------------------------------------------------------------------

# --- search ------------------------------------------------------------------------------------

NEEDED_GAIN = 20.0
"""Gain on held-out data, less the penalty, that a further cause must bring; noise alone does not [nat]."""

NEEDED_GAIN_BESIDE_FORM = 40.0
"""The same beside errors of form, whose correlation from window to window is known only roughly [nat]."""

MIN_SIGMAS = 4.5
"""Standard errors by which a cause's best determined parameter must differ from its neutral value."""

RELEVANT = 5e-4
"""Change of the balance, as a fraction of its largest term, below which a cause does not matter."""

RELEVANT_BESIDE = 1e-3
"""The same where another cause already acts in the channel, whose form need not be exactly its file's."""

MIN_GAIN_RATIO = 0.1
"""Minimum gain of a cause, as a fraction of the possible gain of its change of the residuals; 1 if fitted and linear."""

MIN_GAIN_RATIO_BESIDE_FORM = 0.5
"""The same beside errors of form, of which a cause that changes much may gain something by chance."""

RECURRING = 0.25
"""Fraction of its gain that a further cause must have beyond the block in which it gains most."""

SHOWN = 0.5
"""Rms change in units of the noise below which a cause may be an error of the noise floor itself."""

RARE_QUANTILE = 0.99
"""Quantile of magnitudes that stands for the largest: a signal's reach, and rare errors, which a mean would hide."""

RARE_FACTOR = 5.0
"""Factor by which that quantile may exceed the limit of the rms."""

REMOVED_EXCESS = 0.1
"""Fraction of the excess a hypothesis leaves that a further cause must gain."""

PROMISED_EXCESS = 0.5
"""Fraction of that gain which must be predicted for a fit to be made."""

NEEDED_SHARE = 0.25
"""Fraction of the remainder of the others that a further cause must close if it gains less than REMOVED_EXCESS."""

CLOSED = 0.95
"""Minimum fraction of the removable error a cause must explain to be reported."""

ALL_BUT_FORM = 0.999
"""Fraction of the removable error above which the named causes lack nothing but the exact form of an effect.

Origin: a form that is off by 3 % in amplitude leaves 0.001 of the power.
"""

SIMPLER = 5e-3
"""Fraction of a cause's gain that may be given up for a hypothesis with fewer parameters."""

BETTER = 1.0
"""Gain for which a cause is exchanged for a rival [nat]."""

# --- verdict -----------------------------------------------------------------------------------

SCATTER = 2.5
"""Ratio of residual power to noise power above which something other than noise may remain."""

RARE_SCATTER = 7.0
"""The same for RARE_QUANTILE of the squares, as a multiple of SCATTER.

Origin: rounded up from 6.6, that quantile of the squares of Gaussian noise.
"""

CLEAR = 1.0
"""Multiple of the noise's rms by which a residual stands clear of it: where no cause acts in the balance, that matters however
small it is beside the largest term, and where none is named even if it comes from one block only.

Origin: a constant force of 2.6 times the noise below 25 Hz is 1.4 times that of the windows; of 50 healthy recordings of
benchmarks/diagnosis none comes near.
"""

LITTLE = 1.5
"""Ratio of a residual's power or loss to that of noise up to which nothing but noise is left."""

STANDS_OUT = 3.0
"""Ratio of rms remainder to noise above which a remainder larger than FORM casts doubt on a cause."""

FORM_RIGHT = 0.5
"""Factor on the probability of a cause that leaves such a remainder.

Origin: right in 3 of 6 in 290 cases of benchmarks/diagnosis, seeds 1601269076 and 550123.
"""

BOTH_RIGHT = 0.6
"""Factor on the probability of two causes in one stage: an effect outside the list can look like two that are on it.

Origin: right in 5 of 8 in 191 cases of benchmarks/diagnosis, seed 1426017875; in 26 of 28 in different stages.
"""

FORM = 1e-2
"""Inexactness of an effect's form: uncertainty of a parameter, as a fraction of its distance from neutral, and fraction of the
removable error that a right cause may leave.

Origin: held the truth in 202 of 219 intervals of benchmarks/diagnosis, seed 550123; half of it in 195, twice in 206.
"""

EQUAL = 4.0
"""Gain by which a rival may fall short of a cause and still be equivalent [nat]."""

EQUAL_FRACTION = 2e-2
"""The same as a fraction of the cause's gain: no effect has exactly the form of its file."""

REMOVABLE = 1.1
"""Ratio of residual power to noise power above which a channel counts towards the closed fraction."""

SLIDING = 6.0
"""Travel, in multiples of that over which static friction builds up, above which a piston slides."""

MAX_UNDETECTED = 0.3
"""Smallest detectable change of a stage's key parameter, as a fraction of its nominal value."""

MAX_UNDETECTED_BESIDE_SPREAD = 1.0
"""The same of a recording judged against baselines, whose healthy spread may hide more."""

DEPENDS = 0.05
"""Fraction of a residual's variance a signal must explain on held-out data to be named."""

DEPENDS_BESIDE = 0.4
"""Fraction of the variance explained by the strongest signal that another must reach to be named beside it."""

# --- partial answer ---------------------------------------------------------------------------

FORM_FREEDOMS = 10.0
"""Independent windows equivalent to a whole recording where only errors of form remain.

Origin: held the truth in 56 of 62 intervals of benchmarks/diagnosis --exam partial, seeds 9001, 9002, 61977 and 815209.
"""

WORTHWHILE = 0.5
"""Fraction of the removable error that causes must close to be named although more remains."""

MIN_PROBABILITY = 0.2
"""Probability that a cause, or another in its place, is there at all, below which it is not named beside others.

Origin: on EMPS with three values of the rig file 30 % off, in two patterns of signs: an absent cause has at most 0.06, one that
is present 0.3 or more, but for one wrong value with 0.15.
"""

FORM_ERROR = 0.05
"""Change of a balance, as a fraction of its largest term, that a further cause must make.

Origin: models of real rigs are off by up to 5 % in any stage, and some effect of the list resembles that.
"""

FORM_LEFT = 2.0 * FORM_ERROR
"""Largest remainder, relative to the largest term of the balance, that the form of a model may leave."""

RIGHT_BESIDE_FORM = 0.9
"""Factor on the probability of a cause that is named although more than noise remains.

Origin: right in 58 of 61 that would have 0.85 or more without it, in benchmarks/diagnosis --exam partial, seeds 9001, 9002,
40417, 52093, 61977 and 815209; rounded down, as they are few.
"""

# --- baseline ----------------------------------------------------------------------------------

LEFT_ERROR = 0.2
"""Relative error of a coefficient after that fit, standard deviation, where the data do not identify it."""

AREA_ERROR = 0.05
"""Relative error of the piston area, standard deviation."""

SPREAD = 3e-3
"""Relative change of a coefficient from recording to recording that is no fault, standard deviation."""

HOMOGENEOUS = 0.3
"""Rest of a residual that the coefficients' terms do not form, relative to the noise, below which they form all of it.

Origin: of an incomplete sum, such as one without a measured load, all of the noise is left.
"""

SPREAD_WITH_OIL = 0.01
"""The same for friction and leakage, which follow the oil and its temperature."""

SPREAD_OF_OFFSET = 2e-4
"""The same for a channel's offset, as a fraction of its largest term."""

WARMER = 20.0
"""Change of the oil's temperature that may change a coefficient that follows the oil by LEFT_ERROR, others by less as they
spread less [K].

Origin: the viscosity of mineral oil falls by some 3 % per K at 40 °C; a third of that, as little of the friction is viscous.
"""

FUNCTION_SPREAD = 0.1
"""The same for the smooth remainder, as a fraction of its standard deviation."""

SMOOTH = 0.5
"""Length over which a function of signals varies, in units of a signal's scale near its median."""

UNCORRELATED = 0.05
"""Correlation below which windows no longer err together."""

OTHER_PROGRAMME = 3.0
"""Error of form in a programme of which there is no baseline, in multiples of that in the baselines' programmes.

Origin: in a healthy rig's random programme, the error of the force balance was 3.2 times that in a rich one.
"""

SEEN = 1e-3
"""Fraction of a signal's samples at each end of its range that do not count as having been there."""

MAX_EXTRAPOLATION = 2.0
"""Distance from the middle, in half ranges of the baselines, beyond which nothing is judged."""

MARGIN = 0.05
"""Fraction of a signal's range in the baselines by which it may leave it and still be covered."""

NOISE_MARGIN = 5.0
"""Standard deviations of a signal's noise that a sample hardly ever exceeds."""

MENTIONED_UNSEEN = 0.1
"""Fraction of samples that are not covered above which a remark is made."""

# --- monitor -----------------------------------------------------------------------------------

MONITOR_AT_ONCE = 3
"""Blocks that are compared with the model at once, which saves work."""

MONITOR_LEAD = 1.5
"""Time before a block in which the state of the friction model is found [s].

Origin: three times in which slipping elements relax, 0.5 s: healthy scores then scatter alike in all programmes.
"""

HELD_TIME = 0.5
"""Time over which the piston is held if it hardly moves [s]."""

HELD_TRAVEL = 2.0
"""Travel, in multiples of that over which static friction builds up, up to which it is held."""

MONITOR_SQUARE = 25.0
"""Largest square of a residual in units of its noise floor that counts in a channel's power."""

MONITOR_SIGNAL = 60.0
"""Least ratio of a channel's largest term to its noise floor in a block that counts.

Origin: with less, noise in what a gain multiplies biases it by more than half of RELEVANT.
"""

BIASED = 4.0
"""Standard errors by which a healthy rig may seem to depart in a direction that is followed."""

MOST_SCORE = 5.0
"""Score of a block, in units of its scatter, above which it counts no more: one block alone is an incident.

Origin: two such blocks exceed what a rate of one alarm in 1000 h takes once the scatter is known well.
"""

ALIKE = 0.95
"""Correlation of two departures' changes from which on the monitor follows one of them only."""

MONITOR_REALISATIONS = 4
"""Realisations of sensor noise that the noise floor of a block is averaged over."""

LEARNT_SCATTER = 1.5
"""Scatter of a block's scores that is expected before any was measured.

Origin: healthy recordings of the truth generator: 0.8 to 2.5.
"""

LEAST_SCATTER = 1.0
"""Least scatter of a block's scores: less shows that the noise floor is too high in a programme."""

POWER_TOLERATED = 0.5
"""Rise of the logarithm of a channel's mean square that is no change: how well a noise floor is known.

Origin: healthy programmes of the truth generator: -0.7 to 0.3.
"""

LEARNT_BLOCKS = 30
"""Blocks that this expectation counts as."""

LONGEST_DEPENDENCE = 8
"""Blocks over which scores of a healthy rig are taken to depend."""

LONGEST_WATCH = 1704
"""Blocks of the longest sum: 71 min."""

ONSET_DROP = 1.92
"""Loss of likelihood up to which an onset is still possible [nat].

Origin: 95 % of a normal error.
"""

INSEPARABLE = 1e-7
"""Smallest fraction of a coefficient's information that the others may leave it; with less it is not told."""

TOLD_COEFFICIENT = 0.25
"""Largest standard error of a coefficient that is told, as a fraction of its given value."""

TOLD_ERROR = 0.01
"""The same of an offset or an asymmetry, as a fraction of the rig's limit, and of a gain."""
