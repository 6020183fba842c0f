"""Rung L4 against three-dimensional finite elements that know nothing of layers, harmonics or compliances."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, cg
from skfem import Basis, BilinearForm, ElementHex2, ElementVector, FacetBasis, LinearForm, MeshHex, MeshHex2
from skfem.helpers import ddot, sym_grad, trace

from palp_core.palpation.mechanics import Bead, Phantom, contact
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.units import Float64Array

NU, HEIGHT_M, RADIUS_M, DEPTH_M, OUTER_M = 0.45, 0.020, 0.005, 0.004, 0.050
CENTRE_M = DEPTH_M + RADIUS_M


def box_around_a_ball(inner: int, outer: int) -> MeshHex2:
    """Mesh half a box, y >= 0, minus the bead: a grid without its middle, shells mapped from ball to box."""
    index = np.arange(-outer, outer + 1.0)
    mesh = MeshHex.init_tensor(index, index[outer:], index)
    middle = np.abs(mesh.p[:, mesh.t].mean(axis=1)).max(axis=0)
    mesh = MeshHex2.from_mesh(mesh.restrict(np.flatnonzero(middle > inner)))
    at = mesh.doflocs
    shell = np.abs(at).max(axis=0)
    u = at / shell
    graded = u * (0.3 + 0.7 * u**2)
    wall = np.stack(
        [OUTER_M * graded[0], OUTER_M * graded[1], np.where(u[2] < 0, CENTRE_M, HEIGHT_M - CENTRE_M) * u[2]]
    )
    ball = RADIUS_M * np.tan(u * math.pi / 4) / np.linalg.norm(np.tan(u * math.pi / 4), axis=0)
    part = (shell - inner) / (outer - inner)
    part = part * (0.6 + 0.4 * part)
    return MeshHex2((1 - part) * ball + part * wall + np.array([[0.0], [0.0], [CENTRE_M]]), mesh.t)


def elasticity(u: Any, v: Any, _: Any) -> Float64Array:
    mu, lame = 0.5 / (1 + NU), NU / ((1 + NU) * (1 - 2 * NU))
    e, f = sym_grad(u), sym_grad(v)
    return np.asarray(2.0 * mu * ddot(e, f) + lame * trace(e) * trace(f))


TIP_M, OFFSET_M, INDENTATION_M = 0.006, 0.003, 0.0025


def miss(inner: int, outer: int) -> Float64Array:
    """Return how far the loaded elements miss the ball within 3 mm of its axis, over the indentation."""
    bead = Bead(depth_m=DEPTH_M, radius_m=RADIUS_M)
    model = HarmonicContact(Phantom(bead=bead, height_m=HEIGHT_M, poisson=NU), TIP_M, 0.0005)
    patch = model.patch(INDENTATION_M)
    force = patch.press(OFFSET_M).force_n
    x, y = patch.cells()
    h = patch.cell_m
    lookup = {(round(a / h - 0.5), round(b / h - 0.5)): f / h**2 for a, b, f in zip(x, y, force, strict=True)}

    mesh = box_around_a_ball(inner, outer)
    basis = Basis(mesh, ElementVector(ElementHex2()), intorder=4)
    stiffness = BilinearForm(elasticity).assemble(basis)

    def pressed(v: Any, w: Any) -> Float64Array:
        i = np.floor((w.x[0] - OFFSET_M) / h).astype(int)
        j = np.floor(np.abs(w.x[1]) / h).astype(int)
        value = np.array([lookup.get(key, 0.0) for key in zip(i.ravel(), j.ravel(), strict=True)])
        return np.asarray(value.reshape(i.shape) * v[2])

    top = mesh.facets_satisfying(lambda p: np.abs(p[2]) < 1e-9)
    load = LinearForm(pressed).assemble(
        FacetBasis(mesh, ElementVector(ElementHex2()), facets=top, intorder=20)
    )
    load *= force.sum() / load[2::3].sum()  # the cells' edges are not the elements'

    nodes = basis.doflocs[:, ::3]
    index = np.arange(basis.N).reshape(-1, 3)
    assert np.array_equal(basis.doflocs[:, 1::3], nodes)
    arm = nodes - np.array([[0.0], [0.0], [CENTRE_M]])
    on_bead = np.abs(np.linalg.norm(arm, axis=0) - RADIUS_M) < 1e-9
    held = (
        (np.abs(nodes[2] - HEIGHT_M) < 1e-9)
        | (nodes[0] ** 2 > (OUTER_M - 1e-9) ** 2)
        | (nodes[1] > OUTER_M - 1e-9)
    )
    symmetric = nodes[1] < 1e-9
    free = np.concatenate(
        [index[~(held | on_bead), 0], index[~(held | on_bead | symmetric), 1], index[~(held | on_bead), 2]]
    )
    rigid = np.zeros((basis.N, 3))  # along, down, turning about the axis across
    rigid[index[on_bead, 0], 0] = 1.0
    rigid[index[on_bead, 2], 1] = 1.0
    rigid[index[on_bead, 0], 2] = arm[2, on_bead] / RADIUS_M
    rigid[index[on_bead, 2], 2] = -arm[0, on_bead] / RADIUS_M
    to_all = sp.hstack([sp.identity(basis.N, format="csc")[:, free], sp.csc_matrix(rigid)]).tocsr()
    system = (to_all.T @ stiffness @ to_all).tocsr()
    scale = LinearOperator(system.shape, matvec=lambda v: v / system.diagonal())
    solved, failed = cg(system, to_all.T @ load, rtol=1e-7, M=scale, maxiter=20000)
    assert failed == 0
    down = (to_all @ solved)[index[:, 2]]

    on_top = (np.abs(nodes[2]) < 1e-9) & (np.hypot(nodes[0] - OFFSET_M, nodes[1]) < 0.003)
    overlap = INDENTATION_M - ((nodes[0] - OFFSET_M) ** 2 + nodes[1] ** 2) / (2 * TIP_M)
    assert np.count_nonzero(on_top) > 4
    return np.asarray((down - overlap)[on_top] / INDENTATION_M)


@pytest.mark.slow
def test_a_contact_solved_on_the_condensed_compliance_is_one_in_three_dimensional_finite_elements(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rung's pressure makes the elements' surface follow a paraboloid as the mesh is refined."""
    monkeypatch.setattr(contact.patch, "gap_m", lambda radius_m, aside_m: aside_m**2 / (2.0 * radius_m))
    coarse, fine = miss(3, 9), miss(4, 12)
    assert np.abs(fine).max() < 0.02
    share = 9.0**2 / 12.0**2  # the bead's corners in the mesh leave the second order
    limit = (fine.mean() - share * coarse.mean()) / (1.0 - share)
    assert abs(fine.mean()) < 0.7 * abs(coarse.mean())
    assert abs(limit) < 0.005
