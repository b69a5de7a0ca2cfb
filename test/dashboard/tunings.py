"""A tuning that has ended, as the dashboard's tests show it."""

from ehls_ros.dashboard.graph import TunedNumber, Tuning, TuningPoint, TuningResult

SCRIPT = "<img src=x onerror='window.ran = 1'>"

RESULT = TuningResult(
    sentence="Largest error 22.4 N; margins 6.6 dB and 30°.",
    holds=True,
    lost=False,
    numbers=(
        TunedNumber("g", "1/MPa", f"steepness {SCRIPT}", 60.0, 136.77),
        TunedNumber("rate_correction", "1", "fraction corrected", 1.0, 0.57735),
    ),
    default=TuningPoint(40.0, 8.0, 35.0, 0.03),
    found=TuningPoint(20.0, 6.5, 30.0, 0.03),
    curve=(
        TuningPoint(400.0, 12.0, 80.0, 0.03),
        TuningPoint(20.0, 6.5, 30.0, 0.03),
        TuningPoint(30.0, 0.0, 0.0, 0.03),
        TuningPoint(None, 0.0, 0.0, None),
    ),
    wanted_db=6.0,
    causal_limit=5.0,
    remarks=(f"a remark {SCRIPT}",),
)

TUNING = Tuning(
    "fasmc", f"sine {SCRIPT}", running=False, seconds=50.0, done=55, most=97, result=RESULT, folder="runs/sine-tuning"
)
