"""Defects between segments as the linearised flow has them: how they follow a step, and how they pull at it."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel
from linkwise.likelihood.shooting.normal_equations import Linearization


def change_of_defects(linear: GaussNewtonModel, nodes: Floats, border: Floats) -> Floats:
    """What a step adds to the linearised defects.

    Parameters
    ----------
    linear : Linearization or LocalLinearization
        The linearised problem.
    nodes, border : array of shape (K, m) and (p,)
        The step in scaled unknowns.

    Returns
    -------
    array of shape (K - 1, m)
        The change.
    """
    if isinstance(linear, Linearization):
        change = linear.joined * nodes[1:] - np.einsum("kij,kj->ki", linear.state_ends, nodes[:-1])
        return np.asarray(change - linear.right_ends[..., :-1] @ border)
    change = linear.joined[:-1, None] * nodes[1:]
    for ends, group in zip(linear.ends, linear.groups, strict=True):
        a = len(group.states)
        moved = np.einsum("kij,kj->ki", ends[:-1, :, :a], nodes[:-1, group.states])
        change[:, group.rows] -= moved + ends[:-1, :, a:] @ border[group.border[: group.moving - a]]
    return change


def pull_of_defects(linear: GaussNewtonModel, defects: Floats) -> tuple[Floats, Floats]:
    """What defects add to the gradient of the cost, which normal equations have on their right-hand side.

    Parameters
    ----------
    linear : Linearization or LocalLinearization
        The linearised problem.
    defects : array of shape (K - 1, m)
        Defects for q = 1.

    Returns
    -------
    nodes, border : array of shape (K, m) and (p,)
        The gradient, sign reversed, in scaled unknowns.
    """
    nodes = np.zeros((len(defects) + 1, defects.shape[1]))
    if isinstance(linear, Linearization):
        nodes[:-1] = np.einsum("kij,ki->kj", linear.state_ends, defects)
        nodes[1:] -= linear.joined * defects
        return nodes, np.asarray(np.tensordot(defects, linear.right_ends[..., :-1], 2))
    border = np.zeros(len(linear.data.prior))
    for ends, group in zip(linear.ends, linear.groups, strict=True):
        a, own = len(group.states), defects[:, group.rows]
        nodes[:-1, group.states] += np.einsum("kij,ki->kj", ends[:-1, :, :a], own)
        border[group.border[: group.moving - a]] += np.tensordot(own, ends[:-1, :, a:], 2)
    nodes[1:] -= linear.joined[:-1, None] * defects
    return nodes, border
