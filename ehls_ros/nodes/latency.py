"""Response times: the latest ones kept, percentiles on request."""

import numpy as np


class Latency:
    """A ring buffer of response times."""

    KEPT = 60_000

    def __init__(self) -> None:
        """Start empty."""
        # Not zeros: the kernel allocates zero pages on first write, which would stall the loop.
        self._seconds = np.full(self.KEPT, np.nan)
        self.count = 0

    def add(self, seconds: float) -> None:
        """Add a response time [s]."""
        self._seconds[self.count % self.KEPT] = seconds
        self.count += 1

    def figures(self) -> dict[str, float]:
        """Return median, 99th and 99.9th percentile and maximum [us]; empty before the first answer."""
        kept = self._seconds[: min(self.count, self.KEPT)]
        if not kept.size:
            return {}
        p50, p99, p999, largest = np.percentile(kept, [50.0, 99.0, 99.9, 100.0]) * 1e6
        return {
            "response_p50_us": float(p50),
            "response_p99_us": float(p99),
            "response_p99.9_us": float(p999),
            "response_max_us": float(largest),
        }
