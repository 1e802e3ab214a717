"""The search of modes by output errors: where it ends, and its derivatives."""

import numpy as np
import pytest
from tapped_beam import tapped

from linkwise.modal.measured import ModalMeasurement
from linkwise.modal.output_error import _OutputError
from linkwise.modal.pursuit import PursuedModes


@pytest.mark.parametrize("pairs", [(), ((0, 1),)])
def test_the_derivatives_of_the_response_are_those_of_differences(pairs: tuple[tuple[int, int], ...]) -> None:
    measured = ModalMeasurement.of([tapped(release=0.02)], None)
    problem = _OutputError(measured, 2, pairs)
    rng = np.random.default_rng(2)
    start = PursuedModes(np.array([3.4, 20.0]), np.array([0.02, 0.01]), rng.standard_normal((2, 2, 1)))
    theta = problem.start(start) + 0.1
    for channel, (rows, numbers) in enumerate(problem._jacobian(theta, 0)):
        for row, number in zip(rows, numbers, strict=True):
            step = np.zeros(len(theta))
            step[number] = 1e-5 * max(abs(theta[number]), 0.1)
            ahead, behind = (problem.response(theta + sign * step, 0)[channel] for sign in (1.0, -1.0))
            expected = (ahead - behind) / (2.0 * step[number])
            # central differences over steps of 1e-5; measured 2e-9
            assert np.abs(row - expected).max() < 1e-5 * max(np.abs(expected).max(), 1e-9)
