"""The measured force of a link: what residuals about the identified one make of it."""

import numpy as np
import pytest
from problems import chain_record
from structures import link, structure, with_links

import linkwise as lw


@pytest.fixture(scope="module")
def quiet() -> lw.Record:
    return chain_record(2, duration=2.0)


def test_measured_force_is_the_true_one_even_where_the_law_is_wrong(quiet: lw.Record) -> None:
    chain = lw.bnes_chain(2)
    sink = chain.link("nes1")
    wrong = with_links(chain, link("nes1", "m2-m1", "k*d + c*v"))
    motion = lw.identify(quiet, wrong, method="weak").motion
    assert motion.force is not None
    true = sink.force(motion.d[:, 1], motion.v[:, 1])
    force = motion.structure.link("nes1").force(motion.d[:, 1], motion.v[:, 1])
    missed = np.sqrt(np.mean((force - true) ** 2) / np.var(true))
    left = np.sqrt(np.mean((motion.force[:, 1] - true) ** 2) / np.var(true))
    assert missed > 0.3  # a straight line through a cubic
    assert left < 0.5 * missed  # the curvature of both laws within one window is all that is lost


def test_links_that_close_a_circle_have_no_measured_force() -> None:
    one, two = link("one", "m1-ground", "k*d"), link("two", "m1-ground", "k3*d**3", k3=1e6)
    parallel = structure({"m1": 1.0}, one, two)
    true = parallel.with_values({"one.k": 900.0})
    record = lw.simulate(true, release={"x:m1": 0.01}, duration=1.0, rate=1000.0).with_noise(60.0, seed=0)
    assert lw.identify(record, parallel, method="weak").motion.force is None
