"""Benefit of updating a controller: the force error before and after, without the transition."""

import numpy as np

from ehls_ros.experiments.monitoring.benefit import Benefit


def test_the_error_before_and_after_is_told_and_what_lies_between_counts_for_neither():
    benefit = Benefit(100)
    benefit.add(np.full(60, 3.0))
    assert not benefit.ready
    benefit.add(np.array([np.nan] * 5 + [-4.0] * 40))
    assert benefit.ready
    benefit.inform(10)
    assert not benefit.ready
    benefit.add(np.concatenate([np.full(10, 1e3), np.full(50, 1.0)]))
    assert not benefit.complete
    benefit.add(np.full(50, -2.0))
    assert benefit.complete
    assert benefit.sentence() == (
        "force error before and after the controller was informed: 3.44 to 1.58 N rms, 4 to 2 N at most"
    )
