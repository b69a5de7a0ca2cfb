"""Time stamps of the cycles: evenly spaced, as the samples are, and never far from the clock of the graph."""

FAR = 1.0
"""Difference between stamps and clock at which the stamps are set to the clock [s]: much more than one late cycle."""


class Stamps:
    """Assigns time stamps to the cycles.

    Attributes:
        behind: distance of the last stamp behind the clock; negative if ahead [s].
        jumps: number of times the stamps were set to the clock.
        jump: size of the last adjustment; negative for backwards [s].
    """

    def __init__(self, period: float) -> None:
        """Begin with cycle 0 at time 0; ``period`` is that of the cycles [s]."""
        self._period = period
        self._epoch_ns = 0
        self.begin(0, 0)

    def begin(self, cycle: int, now_ns: int) -> None:
        """Start a cycle now, without counting a jump.

        Args:
            cycle: its number.
            now_ns: time of the clock [ns].
        """
        self._epoch_ns = now_ns - self._since_first(cycle)
        self.behind = self.jump = 0.0
        self.jumps = 0

    def of(self, cycle: int, now_ns: int | None) -> int:
        """Return the stamp of a cycle that begins now [ns].

        Args:
            cycle: its number.
            now_ns: time of the clock [ns]; None: the clock has no time, or it is the cycles'.
        """
        stamp_ns = self._epoch_ns + self._since_first(cycle)
        if now_ns is None:
            return stamp_ns
        self.behind = (now_ns - stamp_ns) * 1e-9
        if abs(self.behind) < FAR:
            return stamp_ns
        self.jump, self.behind = self.behind, 0.0
        self.jumps += 1
        self._epoch_ns += now_ns - stamp_ns
        return now_ns

    def _since_first(self, cycle: int) -> int:
        return round(cycle * self._period * 10**9)

    def figures(self) -> dict[str, float]:
        """Return figures for diagnostics."""
        return {"stamps_behind_s": self.behind, "stamp_jumps": self.jumps, "last_stamp_jump_s": self.jump}
