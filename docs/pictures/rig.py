"""Draw rig.svg, the sketch of the rig on docs/concepts.md: signs, sensors and the names of the signals."""

from html import escape
from pathlib import Path

WIDTH, HEIGHT = 390, 578
"""Narrow, so that a telephone shows it in full size."""

STYLE = """
svg { --paper: #ffffff; --ink: #222222; --faint: #8a8a8a; --signal: #0b5c9e; --oil: #f3d9b1; --steel: #dcdfe3; }
@media (prefers-color-scheme: dark) {
  svg { --paper: #1a1c1e; --ink: #e6e6e6; --faint: #9a9a9a; --signal: #7cc0ff; --oil: #6b4f23; --steel: #3d4248; }
}
.paper { fill: var(--paper); }
text { fill: var(--ink); font: 13px sans-serif; }
.signal { fill: var(--signal); font: 12px monospace; }
.small { font-size: 11.5px; fill: var(--ink); }
.line { stroke: var(--ink); stroke-width: 1.4; fill: none; }
.thin { stroke: var(--faint); stroke-width: 1; fill: none; stroke-dasharray: 3 3; }
.arrow { stroke: var(--signal); stroke-width: 2; fill: none; marker-end: url(#head); }
.head { fill: var(--signal); }
.steel { fill: var(--steel); stroke: var(--ink); stroke-width: 1.4; }
.oil { fill: var(--oil); stroke: var(--ink); stroke-width: 1.4; }
.cell { fill: var(--paper); stroke: var(--signal); stroke-width: 2; }
"""

HEAD = '<marker id="head" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="6" markerHeight="6" orient="auto">'


def words(x: float, y: float, text: str, kind: str = "", anchor: str = "start") -> str:
    """Return a text; ``_`` begins an index of one letter."""
    first, *rest = escape(text).split("_") if kind != "signal" else [escape(text)]
    inside = first + "".join(
        f'<tspan dy="3" font-size="10">{part[0]}</tspan><tspan dy="-3">{part[1:] or "&#8203;"}</tspan>' for part in rest
    )
    return f'<text x="{x}" y="{y}" class="{kind}" text-anchor="{anchor}">{inside}</text>'


def box(x: float, y: float, width: float, height: float, kind: str) -> str:
    """Return a rectangle."""
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" class="{kind}"/>'


def path(kind: str, *points: tuple[float, float]) -> str:
    """Return a line through points."""
    return f'<path d="M{" L".join(f"{x} {y}" for x, y in points)}" class="{kind}"/>'


def ground(x: float, y: float, width: float) -> list[str]:
    """Return what stands still, from below."""
    hatches = [path("line", (x + at, y), (x + at - 7, y + 7)) for at in range(8, int(width) + 1, 8)]
    return [path("line", (x, y), (x + width, y)), *hatches]


def load() -> list[str]:
    """Return the moving mass and what acts on it."""
    spring = [
        (70.0, 128.0),
        (70.0, 140.0),
        *((70.0 + (-1) ** k * 8.0, 146.0 + 8.0 * k) for k in range(6)),
        (70.0, 194.0),
        (70.0, 206.0),
    ]
    return [
        path("arrow", (160, 22), (160, 66)),
        words(170, 30, "f_d  disturbance, down"),
        words(170, 47, "disturbance_force_n", "signal"),
        box(50, 72, 220, 56, "steel"),
        words(60, 96, "moving mass m_0 (beam and load)"),
        words(60, 116, "weight m_0 g, damping B_0, friction F_f", "small"),
        path("line", *spring),
        *ground(54, 206, 32),
        words(86, 178, "k_s"),
        words(62, 226, "no force at x = 0", "small", "middle"),
    ]


def cylinder() -> list[str]:
    """Return the cylinder with its rod, load cell and sensors."""
    return [
        box(155, 128, 10, 280, "steel"),
        box(148, 148, 24, 24, "cell"),
        words(184, 157, "load cell: A_c p_L, up"),
        words(184, 173, "force_n", "signal"),
        box(110, 232, 100, 150, "steel"),
        box(116, 238, 88, 66, "oil"),
        box(116, 312, 88, 64, "oil"),
        box(155, 238, 10, 138, "steel"),
        box(112, 300, 96, 16, "steel"),
        words(135, 275, "B", anchor="middle"),
        words(135, 350, "A", anchor="middle"),
        words(186, 275, "p_B", anchor="middle"),
        words(186, 350, "p_A", anchor="middle"),
        path("thin", (212, 308), (270, 308)),
        path("arrow", (270, 330), (270, 268)),
        words(280, 264, "x, ẋ  up"),
        words(280, 282, "position_m", "signal"),
        words(280, 299, "velocity_m_s", "signal"),
        words(222, 352, "p_L = p_A − p_B"),
        words(222, 370, "load_pressure_pa", "signal"),
        words(222, 388, "piston area A_c", "small"),
    ]


def valve() -> list[str]:
    """Return the valve with its ports, command and supply."""
    return [
        path("line", (110, 260), (36, 260), (36, 440), (130, 440), (130, 452)),
        path("line", (110, 345), (88, 345), (88, 422), (190, 422), (190, 452)),
        words(120, 434, "B", "small"),
        words(196, 440, "A", "small"),
        box(96, 452, 128, 34, "steel"),
        path("line", (104, 469), (216, 469)),
        *(box(x, 459, 18, 20, "cell") for x in (112, 151, 190)),
        path("arrow", (228, 469), (262, 469)),
        words(270, 464, "x_v  spool, right"),
        words(270, 481, "spool_m", "signal"),
        words(270, 506, "u  command"),
        words(270, 523, "valve_command_m", "signal"),
        path("line", (190, 510), (190, 486)),
        path("line", (130, 510), (130, 486)),
        words(190, 525, "p_s", anchor="middle"),
        words(190, 541, "supply_pressure_pa", "signal", "middle"),
        words(130, 525, "tank", anchor="middle"),
        words(190, 566, "x_v > 0 opens p_s to A and B to the tank", anchor="middle"),
    ]


def sketch() -> str:
    """Return the SVG file."""
    inside = "\n".join(filter(None, [*cylinder(), *load(), *valve()]))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">\n'
        f'<style>{STYLE}</style>\n<defs>{HEAD}<path class="head" d="M0 0 L8 4 L0 8 z"/></marker></defs>\n'
        f'<rect width="100%" height="100%" class="paper"/>\n{inside}\n</svg>\n'
    )


if __name__ == "__main__":
    target = Path(__file__).with_name("rig.svg")
    target.write_text(sketch(), encoding="utf-8")
    print(target)
