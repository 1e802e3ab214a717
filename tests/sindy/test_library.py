"""Columns over states: monomials named, counted and evaluated in blocks; links with both masses sharing."""

from dataclasses import replace

import numpy as np
import pytest
from present import some
from structures import oscillator

import linkwise as lw
from linkwise.signals.states import States
from linkwise.sindy.library import Monomials, link_columns, monomial_equations
from linkwise.sindy.regression.regressor import LeastSquares, Stlsq

COUNT = 400
SAME = 1e-9  # same numerics: rounding times the condition number of the columns
ROUNDING = 1e-11  # what rounding leaves of equations that hold exactly


def _states(structure: lw.Structure, *, forces: bool = False, base: bool = False, seed: int = 0) -> States:
    """Arbitrary motion, and the accelerations that the structure has in it: Eq. 1 holds point by point, whatever the orbit."""
    random = np.random.default_rng(seed)
    x = 0.02 * random.normal(size=(COUNT, structure.size))
    v = random.normal(size=x.shape)
    push = random.normal(size=x.shape) if forces else np.zeros_like(x)
    ground = 0.01 * random.normal(size=COUNT) if base else None
    rate = random.normal(size=COUNT) if base else None
    d, d_rate = structure.elongations(x, ground), structure.elongations(v, rate)
    force = np.column_stack([link.force(d[:, k], d_rate[:, k]) for k, link in enumerate(structure.links)])
    a = (push - (structure.incidence @ force.T).T) / structure.mass_values
    driven = structure.mass_names if forces else ()
    return States(np.arange(COUNT) / 1000, structure.mass_names, x, v, a, push, driven, ground, rate)


def test_monomials_are_counted_named_and_evaluated_in_the_same_order() -> None:
    # C(2n + 3, 3) for n = 2, 4, 6, 8, 10 masses: METHODS section 3.
    counts = [len(Monomials(tuple(f"y{j}" for j in range(2 * n)), 3)) for n in (2, 4, 6, 8, 10, 50)]
    assert counts == [35, 165, 455, 969, 1771, 176851]
    library = Monomials(("x1", "v1", "x2"), 3)
    assert library.names[:6] == ("1", "x1", "v1", "x2", "x1**2", "x1*v1")
    assert "x1**2*x2" in library.names and "x1*v1*x2" in library.names and library.names[-1] == "x2**3"
    assert len(library.names) == len(library) == len(set(library.names))
    values = np.random.default_rng(0).normal(size=(50, 3))
    columns = library.evaluate(values)
    assert columns.flags.f_contiguous
    for column, name in enumerate(library.names[1:], start=1):
        expected = np.ones(50)
        for factor in name.replace("**", "^").split("*"):
            variable, _, power = factor.partition("^")
            expected = expected * values[:, library.variables.index(variable)] ** int(power or 1)
        np.testing.assert_allclose(columns[:, column], expected, rtol=1e-12)


def test_a_library_that_cannot_be_is_refused() -> None:
    message = "an order of 0 or more and names that differ, got order -1 in a, b"
    with pytest.raises(lw.IdentificationError, match=message):
        Monomials(("a", "b"), -1)
    with pytest.raises(lw.IdentificationError, match="names that differ"):
        Monomials(("a", "a"), 2)


def test_a_library_of_a_mass_and_its_neighbours_holds_its_equation() -> None:
    states = _states(lw.bnes_chain(6))
    own = monomial_equations(states, 3, columns_of=("m3", "m4"), equations_of=("m4",))
    assert len(own.names) == 35
    fit = LeastSquares().fit(own)
    assert fit.targets == ("x4'", "x4''") and np.all(fit.residual < ROUNDING)
    sink = Stlsq().fit(own).terms("x4''")
    assert sink["x4"] == pytest.approx(1e4, rel=SAME) and sink["x4**3"] == pytest.approx(-1e8, rel=SAME)
    alone = monomial_equations(states, 3, columns_of=("m4",), equations_of=("m4",))
    fit = LeastSquares().fit(alone)
    assert fit.residual[fit.targets.index("x4''")] > 0.1  # the primary mass is missing


def test_masses_without_states_are_refused() -> None:
    states = _states(lw.bnes_chain(2))
    with pytest.raises(lw.IdentificationError, match=r"no states of m3; there are states of m1, m2"):
        monomial_equations(states, 3, columns_of=("m1", "m3"))
    with pytest.raises(lw.IdentificationError, match="no mass was chosen; there are states of"):
        monomial_equations(states, 3, equations_of=())
    with pytest.raises(lw.RecordError, match="mass m3 of the structure has no channel"):
        link_columns(states, lw.bnes_chain(4).unknown("nes"))


@pytest.mark.parametrize("which", [("nes",), ("all",), ("all", "mass:m2"), ("spring1.k", "nes2.beta")])
def test_the_links_of_the_chain_come_back_exactly(which: tuple[str, ...]) -> None:
    chain = lw.bnes_chain(4)
    unknown = chain.unknown(*which)
    equations = link_columns(_states(chain), unknown)
    assert equations.names == tuple(parameter.name for parameter in unknown.parameters)
    assert equations.units == tuple(parameter.unit for parameter in unknown.parameters)
    assert equations.rows == 4 * COUNT
    fit = LeastSquares().fit(equations)
    for name, value in zip(some(fit.names), fit.coefficients[:, 0], strict=True):
        truth = chain.coefficient(name).value
        assert value == pytest.approx(truth, rel=SAME), name
    assert fit.residual[0] < ROUNDING


def test_a_known_nonlinear_coefficient_is_no_obstacle_and_an_unknown_one_is() -> None:
    friction = oscillator("k*d + F*tanh(v/s)", mass=0.5, name="spring", k=900.0, F=0.2, s=0.05)
    states = _states(friction)
    fit = LeastSquares().fit(link_columns(states, friction.unknown("spring.k", "spring.F")))
    assert fit.terms("force")["spring.F"] == pytest.approx(0.2, rel=SAME)
    message = r"k\*d \+ F\*tanh\(v/s\) of link spring is not linear in its unknown .*ml"
    with pytest.raises(lw.IdentificationError, match=message):
        link_columns(states, friction.unknown("all"))


def test_what_cannot_be_identified_is_refused() -> None:
    chain = lw.bnes_chain(2)
    states = _states(chain)
    message = r"every coefficient of .* is known: there is nothing to identify"
    with pytest.raises(lw.IdentificationError, match=message):
        link_columns(states, chain)
    with pytest.raises(lw.IdentificationError, match="nothing sets their scale"):
        link_columns(states, chain.unknown("all", "mass:m1", "mass:m2"))
    alone = replace(states, masses=("m1", "q"))
    message = r"mass m2 of the structure has no channel, .* there are states of m1, q"
    with pytest.raises(lw.RecordError, match=message):
        link_columns(alone, chain.unknown("all"))


def test_link_columns_beyond_memory_say_how_large_they_are() -> None:
    long = np.broadcast_to(0.0, (10**8, 2))
    states = States(long[:, 0], ("m1", "m2"), long, long, long, long)
    message = r"5 unknowns over 2 masses and 100000000 samples are 8\.0 GB of columns; use the weak form"
    with pytest.raises(lw.IdentificationError, match=message):
        link_columns(states, lw.bnes_chain(2).unknown("all"))
