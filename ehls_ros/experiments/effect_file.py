"""Source text of an effect made from a term that a diagnosis found: its formula, parameters, forms and wording.

The shape of the term decides the formula: waves for one that repeats, a power, a bump at one place, otherwise its table with a
size. The found numbers become starting values; with the defaults the effect changes nothing.
"""

import math
import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.reading import FITS, LIKELY, Power, Reading, Shape
from ehls_ros.diagnosis.result import Term, argument_unit
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS

ARGUMENTS = {
    "position_m": ("y[X]", "x"), "velocity_m_s": ("y[V]", "v"), "load_pressure_pa": ("y[PL]", "pL"), "spool_m": ("y[XV]", "xv"),
    "valve_command_m": ("value", "u"), "disturbance_force_n": ("disturbance_force(t, w)", "fd"), "time_s": ("t", "t"),
    "oil_temperature_k": ("w[TEMPERATURE]", "T"),
}  # fmt: skip
"""Code and symbol of each signal on which a term may depend."""

OWN = {"opening": "spool_m", "command": "valve_command_m"}
"""Signal that a hook receives as its value."""

CHANGES = {
    "position_reading": "x,read = x + {}", "pressure_reading": "pL,read = pL + {}", "force_reading": "F,read = F + {}",
    "force": "F = {}", "friction_level": "s -> s + {}, at least 1 N", "opening": "xv,eff = xv + {}", "leakage": "q -> q + {}",
    "command": "u -> u + {}",
}  # fmt: skip
"""Equation of each hook at which a term acts."""

FEEDBACK_STEP = 1e-3
"""Longest integration step of a valve with a term over the spool's distance from its command [s]."""

NEEDED = ("disturbance_force_n", "oil_temperature_k", "valve_command_m")
"""Arguments without whose record an effect cannot show; the others are estimated."""

TURNING = {"empirical_force": False, "empirical_friction": True}
"""Effects in the force balance, where a period along the stroke is looked for, and whether all of them follow the motion."""

DIGITS, WIDTH = 6, 128
"""Digits of a number in the file, and largest length of a line."""

DENSE = 400
"""Points at which a formula is fitted to a table."""

LARGEST = 100.0
"""Largest size of a parameter, over its found value."""

HARMONICS, LEAST_HARMONIC = 3, 0.05
"""Most harmonics of a wave, and least amplitude of one, over the largest."""

SIGNIFICANT = 3.0
"""Standard errors from which a harmonic or a constant counts."""

LEAST_CONSTANT = 0.1
"""Least constant beside a power, over the term's amplitude."""

BESIDE_LINE = (2.0, 3.0, 0.5)
"""Exponents of a power beside a line; others are too alike."""

SYMMETRIES: tuple[Literal["odd", "even"], ...] = ("odd", "even")
"""Symmetries of a power about zero."""

PLACES = (0.1, 0.25, 0.4, 0.6, 0.75, 0.9)
"""Quantiles of the argument at which a bump is looked for."""

STRETCHES = (0.5, 1.0, 2.0)
"""Stretches of a table's argument from which its fit starts."""


class Number(NamedTuple):
    """A parameter of the effect.

    Attributes:
        name: its name.
        unit: its SI unit.
        meaning: description.
        low, high: its range.
        default: neutral value.
        found: value of the term.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    default: float
    found: float


class Formula(NamedTuple):
    """A formula for a term.

    Attributes:
        numbers: its parameters.
        equation: the formula as text.
        code: lines of the hook that compute ``term`` from the argument ``a``.
        forms: starting values of the free parameters of each form, as source text.
        constants: lines of the module before the hook.
        starts: types of starting values to import.
    """

    numbers: tuple[Number, ...]
    equation: str
    code: tuple[str, ...]
    forms: tuple[Mapping[str, str], ...]
    constants: tuple[str, ...] = ()
    starts: tuple[str, ...] = ()


def term_of(document: object, where: str) -> Term:
    """Return the term in the content of a ``diagnosis.json``.

    Args:
        document: the content.
        where: the file, for errors.

    Raises:
        BadInput: it holds no term.
    """
    if not isinstance(document, Mapping) or "verdict" not in document:
        raise BadInput("it is not the result of a diagnosis", where, "a diagnosis.json of `ehls diagnose`")
    entry = document.get("term")
    if entry is None:
        raise BadInput(
            f"no term was found in the data (verdict: {document['verdict']})", where, "a diagnosis that found a term"
        )
    try:
        reading = entry["reading"]
        power = None if reading["power"] is None else Power(**reading["power"])
        arrays = {key: np.array(entry[key], dtype=np.float64) for key in ("at", "values", "std")}
        shape = Reading(**{**reading, "power": power})
        estimates = {key: None if entry[key] is None else Estimate(**entry[key]) for key in ("period", "lag", "play")}
        formula = tuple(
            Shape(**{**one, "numbers": {name: Estimate(**e) for name, e in one["numbers"].items()}}) for one in entry["formula"]
        )
        return Term(**{**entry, **arrays, **estimates, "reading": shape, "formula": formula})
    except (KeyError, TypeError, ValueError) as error:
        what = f"the term cannot be read ({type(error).__name__}: {error})"
        raise BadInput(what, where, "a diagnosis.json of this version of ehls") from None


def effect_text(name: str, term: Term, source: str) -> str:
    """Return the text of an effect's file.

    Args:
        name: name of the effect.
        term: the term.
        source: origin of the term.
    """
    base: Any = EFFECTS.load(term.effect)
    (hook,) = (hook for hook in HOOKS if hasattr(base, hook))
    formula = formula_of(term)
    argument = _argument(term, hook)
    states = term.lag is not None or term.play is not None
    change = "shifted_level(value, term)" if hook == "friction_level" else "value + term"
    noun = f"{'an' if name[0] in 'aeiou' else 'a'} {name.replace('_', ' ')}"
    found = ", ".join(f"{n.name}: {n.found:.{DIGITS}g}" for n in formula.numbers)
    needs = [f'NEEDS = ("{term.argument}",)'] if term.argument in NEEDED else []
    lines = [
        f'"""{noun[0].upper()}{noun[1:]}, found by `ehls diagnose` as a table and written as a formula.',
        "",
        "The values found, as an entry of `effects` in a rig file:",
        "",
        f"    {{name: {name}, {found}}}",
        '"""',
        "",
        *_imports(term, hook, formula),
        "",
        f'GROUP: Group = "{base.GROUP}"',
        *_text("EQUATION", CHANGES[hook].format(formula.equation)),
        *_text("SOURCE", f"{source}: closes {term.closed:.0%} of the error on held-out data"),
        "WORDS = Words(",
        f'    "{noun}",',
        f'    inspect="{base.WORDS.inspect}",',
        f'    measure="{base.WORDS.measure}",',
        f'    change="keep `{name}` under `effects` in the rig file",',
        ")",
        *(["STATES = 1"] if states else []),
        *needs,
        *formula.constants,
        "",
        "",
        "class Parameters(NamedTuple):",
        '    """Numbers of the formula; with the defaults the effect changes nothing."""',
        "",
        *(line for number in formula.numbers for line in _declared(number)),
        "",
        "",
        "@kernel",
        f"def {hook}(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:",
        '    """Add the term."""',
        f"    a = {argument}{' - z[0]' if states else ''}",
        *(["    a = clamp(a, -0.5 * p.play, 0.5 * p.play)"] if term.play is not None else []),
        *(f"    {line}" for line in formula.code),
        f"    return {change}",
        "",
        "",
        *(_derivatives(term, hook) if states else []),
        *(_longest_step() if _feeds_back(term, hook) and not states else []),
        "def forms(rig: Rig) -> tuple[Form, ...]:",
        '    """Return the ways to fit the term, from the values found."""',
        "    return (",
        *(line for form in formula.forms for line in _form(form)),
        "    )",
    ]
    return "\n".join(lines) + "\n"


def formula_of(term: Term) -> Formula:
    """Return the formula that the shape of a term calls for."""
    alone = [shape for shape in term.formula if shape.name != "level"]
    if term.period is not None:
        formula = _waves(term, term.period)
    elif len(alone) == 1 and alone[0].name == "step":
        formula = _step(term, alone[0])
    elif len(alone) == 1 and alone[0].name == "beyond":
        formula = _beyond(term, alone[0])
    elif term.reading.power is not None:
        formula = _power(term, term.reading.power)
    else:
        bump = None if term.reading.place is None else _bump(term, term.reading.place)
        formula = bump or _power_beside_line(term) or _table(term)
    symbol = "(u - xv)" if term.error else ARGUMENTS[term.argument][1]
    symbol = f"|{symbol}|" if term.magnitude else symbol
    (hook,) = (hook for hook in HOOKS if hasattr(EFFECTS.load(term.effect), hook))
    if term.lag is not None:
        symbol = f"({symbol} - its lag)"
        lag = Number("lag", "s", "time constant of the lag subtracted", *_around(term.lag.value), term.lag.value)
        formula = formula._replace(numbers=(*formula.numbers, lag))
    elif term.play is not None:
        symbol = f"({symbol} in the gap of a play)"
        play = Number("play", term.play.unit, "width of the play", *_around(term.play.value), term.play.value)
        formula = formula._replace(numbers=(*formula.numbers, play))
    formula = formula._replace(equation=formula.equation.replace("{a}", symbol))
    if term.factor:
        of = "(u - xv)" if term.factor_error else ARGUMENTS[term.factor][1]
        reach = f"{_short(term.factor_reach)} {argument_unit(term.factor)}"
        code, equation = (*formula.code, f"term *= {_factor(term, hook)}"), f"({formula.equation}) {of}/{reach}"
        formula = formula._replace(code=code, equation=equation)
    if not term.direction > 0.0:
        return formula
    return formula._replace(
        numbers=(*formula.numbers, _speed(term)),
        code=(*formula.code, "term *= math.tanh(y[V] / p.speed)"),
        equation=f"({formula.equation}) tanh(v/speed)",
    )


def _around(found: float) -> tuple[float, float, float]:
    """Return range and default of a parameter about its found value."""
    return found / LARGEST, found * LARGEST, found


def _step(term: Term, shape: Shape) -> Formula:
    """Return a hyperbolic tangent."""
    size, place, width = (shape.numbers[name].value for name in ("size", "place", "width"))
    found = shape.numbers["place"].std > 0.0
    unit, bound, far = argument_unit(term.argument), LARGEST * abs(size), LARGEST * float(np.max(np.abs(term.at)))
    numbers = (
        Number("size", term.unit, "half the height", -bound, bound, 0.0, size),
        Number("place", unit, "middle", -far, far, 0.0 if found else place, place),
        Number("width", unit, "width", width / LARGEST, width * LARGEST, _other(width), width),
    )
    form = {"size": "()", "width": f"({_short(width)},)"}
    form |= {"place": f"({_short(place)},)"} if found else {}
    code = "term = p.size * math.tanh((a - p.place) / p.width)"
    return Formula(numbers, "size tanh(({a} - place)/width)", (code,), (form,))


def _beyond(term: Term, shape: Shape) -> Formula:
    """Return a line beyond a place: above it, below it, or on both sides of zero."""
    place, distance = shape.numbers["place"].value, shape.numbers["at_distance"].value
    size, unit = shape.numbers["size"].value, argument_unit(term.argument)
    bound, far = LARGEST * abs(size), LARGEST * float(np.max(np.abs(term.at)))
    numbers = (
        Number("size", term.unit, f"value {distance:.4g} {unit} beyond the place", -bound, bound, 0.0, size),
        Number("place", unit, "place", -far, far, 0.0, place),
    )
    beyond = {
        "above": "max(a - p.place, 0.0)",
        "below": "min(a - p.place, 0.0)",
        "both": "(max(a - p.place, 0.0) - max(-a - p.place, 0.0))",
    }[shape.kind]
    sides = {"above": "max({a} - place, 0)", "below": "min({a} - place, 0)", "both": "sgn({a}) max(|{a}| - place, 0)"}
    constants = (
        "",
        f"DISTANCE = {_short(distance)}",
        f'"""Distance beyond the place at which the value is `size` [{unit}]."""',
    )
    form = {"size": "()", "place": f"({_short(place)},)"}
    equation = f"size {sides[shape.kind]}/({distance:.4g} {unit})"
    return Formula(numbers, equation, (f"term = p.size * {beyond} / DISTANCE",), (form,), constants)


def _waves(term: Term, period: Estimate) -> Formula:
    """Return a sum of harmonics."""
    place, values = _dense(term)
    angle = 2.0 * np.pi * place / period.value
    most = max((len(term.at) - 1) // 2, 1)
    columns = [wave(k * angle) for k in range(1, most + 1) for wave in (np.sin, np.cos)]
    pairs = _solved([*columns, np.ones(DENSE)], values)[: 2 * most].reshape(-1, 2)
    sizes = np.hypot(*pairs.T)
    least = max(LEAST_HARMONIC * float(np.max(sizes)), SIGNIFICANT * float(np.mean(term.std)) * np.sqrt(2.0 / len(term.at)))
    present = [k for k in range(1, most + 1) if sizes[k - 1] > least] or [1 + int(np.argmax(sizes))]
    # Without the wave of its length, a table repeats more often.
    repeats = math.gcd(*present)
    period, pairs = period._replace(value=period.value / repeats), pairs[repeats - 1 :: repeats]
    kept = [k // repeats for k in present if k <= HARMONICS * repeats] or [1]
    in_time = term.argument == "time_s"
    scale = period.value if not in_time else 1.0 / period.value
    name, unit, of_period = ("frequency", "Hz", "frequency") if in_time else ("wavelength", period.unit, "length of the wave")
    bound = LARGEST * float(np.max(sizes))
    numbers, sums, texts = list[Number](), list[str](), list[str]()
    of = {"sine": "sin", "cosine": "cos"}
    for k in kept:
        for wave, size in zip(of, pairs[k - 1], strict=True):
            own = wave if k == 1 else f"{wave}_{k}"
            meaning = f"{wave} part of {'the wave' if k == 1 else f'harmonic {k}'}"
            numbers.append(Number(own, term.unit, meaning, -bound, bound, 0.0, float(size)))
            sums.append(f"p.{own} * math.{of[wave]}({'' if k == 1 else f'{k}.0 * '}angle)")
            texts.append(f"{own} {of[wave]}({'' if k == 1 else f'{k} '}φ)")
    free = {n.name: "()" for n in numbers}
    numbers.append(Number(name, unit, of_period, scale / LARGEST, scale * LARGEST, _other(scale), scale))
    starts = [_short(scale)]
    if term.argument == "position_m" and term.effect in TURNING:
        turning = TURNING[term.effect] or term.direction > 0.0
        starts.append(f'Period("{term.argument}", turning={turning})')
    phase = f"2π {name} {{a}}" if in_time else f"2π {{a}}/{name}"
    form = {**free, name: f"({', '.join(starts)},)" if len(starts) == 1 else f"({', '.join(starts)})"}
    equation = f"{' + '.join(texts)}, φ = {phase}"
    turns = "p.frequency * a" if in_time else "a / p.wavelength"
    code = (
        f"angle = 2.0 * math.pi * {turns}",
        f"term = {' + '.join(sums[:2])}",
        *(f"term += {' + '.join(sums[k : k + 2])}" for k in range(2, len(sums), 2)),
    )
    return Formula(tuple(numbers), equation, code, (form,), starts=("Period",) if len(starts) > 1 else ())


def _power(term: Term, power: Power, *, line: bool = False) -> Formula:
    """Return a power of the argument, odd or even, and a constant if there is one.

    Args:
        term: the term.
        power: the power.
        line: whether a part in proportion to the argument stands beside it.
    """
    place, values = _dense(term)
    scale = _scale(term)
    half = round(2.0 * power.exponent) / 2.0
    exponent = half if abs(half - power.exponent) <= 2.0 * power.std else round(power.exponent, 2)
    columns = [_shape(place / scale, exponent, power.symmetry), np.ones(DENSE), *([place / scale] if line else [])]
    size, constant, *slope = map(float, _solved(columns, values))
    unit, bound = argument_unit(term.argument), LARGEST * abs(size)
    numbers = [
        Number("size", term.unit, f"value at {scale:g} {unit}", -bound, bound, 0.0, size),
        Number("exponent", "1", "exponent of the power", 0.1, 8.0, exponent, exponent),
    ]
    sign = "math.copysign(1.0, a) * " if power.symmetry == "odd" else ""
    code, equation = [f"term = p.size * {sign}abs(a / SCALE) ** p.exponent"], f"size |{{a}}/{scale:g} {unit}|^exponent"
    equation = equation.replace("size ", "size sgn({a}) ") if sign else equation
    forms = [{"size": "()"}, {"size": f"({_short(size)},)", "exponent": f"({_short(exponent)},)"}]
    if line:
        meaning = f"part in proportion to the argument, at {scale:g} {unit}"
        numbers.append(Number("linear", term.unit, meaning, -bound, bound, 0.0, slope[0]))
        code, equation = [*code, "term += p.linear * a / SCALE"], f"{equation} + linear {{a}}/{scale:g} {unit}"
        forms.append({"size": "()", "linear": "()"})
    if abs(constant) > max(LEAST_CONSTANT * term.reading.amplitude, SIGNIFICANT * term.reading.std):
        numbers.append(Number("constant", term.unit, "constant part", -bound, bound, 0.0, constant))
        code, equation = [*code, "term += p.constant"], f"{equation} + constant"
        forms = [{**form, "constant": "()"} for form in forms]
    constants = ("", f"SCALE = {scale!r}", f'"""Argument at which the value is `size` [{unit}]."""')
    return Formula(tuple(numbers), equation, tuple(code), tuple(forms), constants)


def _power_beside_line(term: Term) -> Formula | None:
    """Return a power beside a part in proportion to the argument, which a named cause may hold; None if none describes it."""
    if term.argument == "time_s" or not term.at[0] < 0.0 < term.at[-1]:
        return None
    a, spread = term.at / _scale(term), np.hypot(term.std, 0.01 * float(np.ptp(term.values)))
    best, least = None, FITS * float(np.sum(((term.values - np.mean(term.values)) / spread) ** 2))
    least = max(least, float(scipy.stats.chi2.ppf(LIKELY, max(len(a) - 3, 1))))
    for exponent in BESIDE_LINE:
        for symmetry in SYMMETRIES:
            columns = [_shape(a, exponent, symmetry) / spread, a / spread, 1.0 / spread]
            left = term.values / spread
            left = left - np.stack(columns, axis=1) @ _solved(columns, left)
            if float(left @ left) < least:
                best, least = Power(exponent, 0.0, symmetry), float(left @ left)
    return None if best is None else _power(term, best, line=True)


def _scale(term: Term) -> float:
    """Return the largest argument in the data, to two digits."""
    return float(f"{float(np.max(np.abs(term.at))):.2g}")


def _shape(a: Array, exponent: float, symmetry: str) -> Array:
    return np.abs(a) ** exponent * (np.sign(a) if symmetry == "odd" else 1.0)


def _bump(term: Term, place: float) -> Formula | None:
    """Return a bump at one place; None if the table has no whole one."""
    at, values = _dense(term)
    step = float(term.at[1] - term.at[0])

    def bump(a: Array, size: float, centre: float, width: float, constant: float) -> Array:
        return constant + size * np.exp(-(((a - centre) / width) ** 2))

    start = (float(values[np.argmin(np.abs(at - place))] - np.median(values)), place, step, float(np.median(values)))
    lower, upper = (-np.inf, at[0], 0.1 * step, -np.inf), (np.inf, at[-1], float(np.ptp(at)), np.inf)
    fitted, _ = scipy.optimize.curve_fit(bump, at, values, start, bounds=(lower, upper))
    size, centre, width = map(float, fitted[:3])
    if not at[0] + width < centre < at[-1] - width or np.var(values - bump(at, *fitted)) > FITS * np.var(values):
        return None
    unit, bound, far = argument_unit(term.argument), LARGEST * abs(size), LARGEST * max(abs(float(end)) for end in at[[0, -1]])
    numbers = (
        Number("size", term.unit, "value at the place", -bound, bound, 0.0, size),
        Number("place", unit, "place", -far, far, 0.0, centre),
        Number("width", unit, "distance from the place with 1/e of it", width / LARGEST, width * LARGEST, _other(width), width),
    )
    places = f'{_short(centre)}, *(Quantile("{term.argument}", part) for part in {PLACES})'
    widths = f"({', '.join([_short(width)] * (1 + len(PLACES)))})"
    form = {"size": "()", "place": f"({places})", "width": widths}
    code = "term = p.size * math.exp(-(((a - p.place) / p.width) ** 2))"
    return Formula(numbers, "size exp(-(({a} - place)/width)²)", (code,), (form,), starts=("Quantile",))


def _table(term: Term) -> Formula:
    """Return the table, of a fitted size, with a stretch of its argument where that has a meaning."""
    size, unit = term.reading.amplitude, argument_unit(term.argument)
    bound = LARGEST * size
    numbers = [Number("size", term.unit, "half the range of the values", -bound, bound, 0.0, size)]
    first, step = float(term.at[0]), float(term.at[1] - term.at[0])
    argument, equation, forms = "a", "size × table({a})", [{"size": "()"}]
    if term.argument not in ("time_s", "oil_temperature_k"):
        numbers.append(Number("stretch", "1", "stretch of the table's argument", 0.05, 20.0, 1.0, 1.0))
        argument, equation = "a / p.stretch", "size × table({a}/stretch)"
        starts = f"({', '.join(map(repr, STRETCHES))})"
        forms.append({"size": f"({', '.join([_short(size)] * len(STRETCHES))})", "stretch": starts})
    last = len(term.at) - 1
    hats = [f"{_short(value / size)} * max(0.0, 1.0 - abs(s - {k}.0))" for k, value in enumerate(term.values)]
    constants = (
        "",
        "",
        "@kernel",
        "def table(a: float) -> float:",
        f'    """Return the value over `size`, linear between knots {step:.6g} {unit} apart, from {first:.6g} {unit} on."""',
        f"    s = min(max((a - ({_short(first)})) / {_short(step)}, 0.0), {last}.0)",
        "    total = 0.0",
        *(f"    total += {' + '.join(hats[k : k + 2])}" for k in range(0, len(hats), 2)),
        "    return total",
    )
    return Formula(tuple(numbers), equation, (f"term = p.size * table({argument})",), tuple(forms), constants)


def _speed(term: Term) -> Number:
    meaning, speed = "speed within which the sign follows the direction of motion", term.direction
    return Number("speed", "m/s", meaning, speed / LARGEST, speed * LARGEST, speed, speed)


def _dense(term: Term) -> tuple[Array, Array]:
    """Return places between the knots and the values there, shape (DENSE,)."""
    at, values = term.at, term.values
    if term.period is not None:
        at, values = np.append(at, at[0] + term.period.value), np.append(values, values[0])
    place = np.linspace(at[0], at[-1], DENSE, endpoint=term.period is None)
    return place, np.interp(place, at, values)


def _solved(columns: list[Array], values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0], dtype=np.float64)


def _other(scale: float) -> float:
    """Return a round default that is no start: from neutral values alone no fit starts."""
    return float(f"{2.0 * scale:.1g}")


def _form(form: Mapping[str, str]) -> list[str]:
    """Return the lines of a form, one for each parameter if they are long."""
    entries = [f'"{name}": {starts}' for name, starts in form.items()]
    line = f"        Form({{{', '.join(entries)}}}),"
    if len(line) <= WIDTH:
        return [line]
    return ["        Form({", *(f"            {entry}," for entry in entries), "        }),"]


def _argument(term: Term, hook: str) -> str:
    """Return the code of a term's argument."""
    if term.error:
        return "value - y[XV]"
    argument = "value" if OWN.get(hook) == term.argument else ARGUMENTS[term.argument][0]
    return f"abs({argument})" if term.magnitude else argument


def _feeds_back(term: Term, hook: str) -> bool:
    """Return whether the spool's command depends on the spool."""
    return hook == "command" and (term.error or term.factor_error or "spool_m" in (term.argument, term.factor))


def _factor(term: Term, hook: str) -> str:
    """Return the code of a term's factor, 1 where the values hold."""
    code = "value" if OWN.get(hook) == term.factor else ARGUMENTS[term.factor][0]
    code = "(value - y[XV])" if term.factor_error else code
    return f"{code} / {_short(term.factor_reach)}"


def _derivatives(term: Term, hook: str) -> list[str]:
    """Return the lines of the rate of a memory: a lag of the argument, or the output of a play."""
    before = {"command": "u", "opening": "y[XV]"}.get(hook, "value")
    argument = re.sub(r"\bvalue\b", before, _argument(term, hook))
    rate = (
        f"({argument} - z[0]) / p.lag"
        if term.lag is not None
        else f"FOLLOW_RATE * (play_output(z[0], {argument}, p.play) - z[0])"
    )
    return [
        "@kernel",
        "def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:",
        '    """Write the rate of the memory."""',
        f"    dz[0] = {rate}",
        "",
        "",
    ]


def _longest_step() -> list[str]:
    return [
        "def longest_step(parameters: Parameters) -> float:",
        '    """Return the longest integration step, as the command depends on the spool [s]."""',
        f"    return {FEEDBACK_STEP!r}",
        "",
        "",
    ]


def _imports(term: Term, hook: str, formula: Formula) -> list[str]:
    argument = _argument(term, hook)
    code = " ".join(formula.code)
    play = ["from ehls_ros.physics.effects._play import FOLLOW_RATE, clamp, play_output"] if term.play is not None else []
    indices = [name for name in ("PL", "TEMPERATURE", "V", "X", "XV") if f"[{name}]" in argument + code]
    indices += ["disturbance_force"] if "disturbance_force" in argument + code else []
    return [
        *(["import math"] if "math." in code else []),
        "from typing import Annotated, NamedTuple",
        "",
        "from ehls_ros.arrays import Array, kernel",
        *(["from ehls_ros.physics.effects._friction import shifted_level"] if hook == "friction_level" else []),
        *play,
        f"from ehls_ros.physics.effects.base import {', '.join(sorted(('Form', 'Group', 'Words', *formula.starts)))}",
        "from ehls_ros.physics.parameters import Plant",
        *([f"from ehls_ros.physics.plant import {', '.join(indices)}"] if indices else []),
        "from ehls_ros.physics.rig import Rig",
        "from ehls_ros.schema import quantity",
    ]


def _text(name: str, text: str) -> list[str]:
    """Return the assignment of a text, in brackets if it is long."""
    line = f"{name} = {text!r}" if '"' in text else f'{name} = "{text}"'
    return [line] if len(line) <= WIDTH else [f"{name} = (", f"    {line.split(' = ', 1)[1]}", ")"]


def _declared(number: Number) -> list[str]:
    bounds = f"minimum={number.low:.4g}, maximum={number.high:.4g}"
    note = f'float, quantity("{number.unit}", "{number.meaning}", {bounds})'
    line = f"    {number.name}: Annotated[{note}] = {_short(number.default)}"
    if len(line) <= WIDTH:
        return [line]
    return [f"    {number.name}: Annotated[", f"        {note}", f"    ] = {_short(number.default)}"]


def _short(number: float) -> str:
    """Return a float of source text."""
    return repr(float(f"{number:.{DIGITS}g}"))
