import array
import pickle
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp
from reference import planted_problem, project_cone, relative_residual

import signorini
from signorini import ContactProblem, Equality, FrictionCone, HalfLine, Interval


@pytest.fixture
def planted():
    mass, j, g, mu, impulse = planted_problem(0)
    return j @ np.linalg.solve(mass, j.T), g, mu, impulse


def strided(a):
    """The same values in every second place of a larger array."""
    big = np.zeros([2 * n for n in a.shape])
    view = big[tuple(slice(None, None, 2) for _ in a.shape)]
    view[...] = a
    return view


@pytest.mark.parametrize(
    "convert",
    [np.asarray, np.asfortranarray, np.ascontiguousarray, strided, lambda a: a.tolist()]
    + [
        sp.csc_array,
        sp.csr_array,
        sp.coo_array,
        sp.csc_matrix,
        sp.csr_matrix,
        sp.lil_array,
        sp.dok_array,
        sp.bsr_array,
    ],
)
def test_every_form_of_a_matrix_is_the_same_problem(planted, convert):
    delassus, g, mu, impulse = planted
    problem = ContactProblem(convert(delassus), g, mu)
    np.testing.assert_allclose(problem.delassus.toarray(), delassus, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(problem.velocity(impulse), delassus @ impulse + g, atol=1e-12)
    assert problem.num_contacts == problem.num_constraints == 5
    assert problem.size == 15


def test_integers_and_single_precision_are_converted():
    problem = ContactProblem(np.eye(3, dtype=int), np.array([1, 0, -1], dtype=np.int8), np.array([0.5], np.float32))
    assert problem.free_velocity.dtype == problem.friction.dtype == np.float64
    np.testing.assert_array_equal(problem.free_velocity, [1, 0, -1])


def test_duplicates_and_unsorted_entries_of_a_sparse_matrix_add_up():
    g = sp.csc_array((np.array([1.0, 2.0, 0.5, 1.0]), np.array([0, 1, 0, 2]), np.array([0, 1, 2, 4])), shape=(3, 3))
    twice = sp.csc_array((np.ones(6), np.array([0, 0, 1, 1, 2, 2]), np.array([0, 2, 4, 6])), shape=(3, 3))
    before = twice.nnz
    problem = ContactProblem(twice, np.zeros(3), [0.1])
    np.testing.assert_array_equal(problem.delassus.toarray(), 2 * np.eye(3))
    assert twice.nnz == before  # what was given is left alone
    unsorted = ContactProblem(g, np.zeros(3), [0.1], check=False).delassus.toarray()
    np.testing.assert_allclose(unsorted, 0.5 * (g + g.T).toarray())


def test_later_writes_to_the_arrays_given_change_nothing(planted):
    delassus, g, mu, _ = planted
    problem = ContactProblem(delassus, g, mu)
    kept = problem.delassus.toarray(), problem.free_velocity.copy(), problem.friction.copy()
    delassus[:], g[:], mu[:] = 7.0, 7.0, 7.0
    np.testing.assert_array_equal(problem.delassus.toarray(), kept[0])
    np.testing.assert_array_equal(problem.free_velocity, kept[1])
    np.testing.assert_array_equal(problem.friction, kept[2])
    with pytest.raises(ValueError, match="read-only"):
        problem.free_velocity[0] = 1.0
    with pytest.raises(AttributeError):
        problem.friction = mu


def test_later_writes_through_buffers_change_nothing(planted):
    delassus, g, mu, _ = planted
    buffers = array.array("d", g), array.array("d", mu), memoryview(array.array("d", np.ones_like(g)))
    problem = ContactProblem(delassus, *buffers)
    before = signorini.solve(problem).impulse
    for buffer in buffers:
        for i in range(len(buffer)):
            buffer[i] = 7.0
    np.testing.assert_array_equal(problem.free_velocity, g)
    np.testing.assert_array_equal(problem.friction, mu)
    np.testing.assert_array_equal(problem.compliance, np.ones_like(g))
    np.testing.assert_array_equal(signorini.solve(pickle.loads(pickle.dumps(problem))).impulse, before)


@pytest.mark.parametrize("convert", [np.array, sp.csc_array, sp.csc_matrix, sp.csr_array, sp.coo_array, sp.bsr_array])
def test_later_writes_to_mass_and_jacobian_change_nothing(convert):
    mass, j, g, mu, _ = planted_problem(1)
    given = convert(mass), convert(j)
    problem = ContactProblem.from_mass(*given, g, mu)
    for matrix in given:
        (matrix.data if sp.issparse(matrix) else matrix)[:] = 7.0
    np.testing.assert_array_equal(problem.mass.toarray(), mass)
    np.testing.assert_array_equal(problem.jacobian.toarray(), j)
    for matrix in (problem.mass, problem.jacobian):
        with pytest.raises(ValueError, match="read-only"):
            matrix.data[:] = 7.0


def test_mass_form_has_the_delassus_operator_of_its_definition():
    mass, j, g, mu, impulse = planted_problem(1)
    problem = ContactProblem.from_mass(mass, sp.csr_array(j), g, mu)
    np.testing.assert_allclose(problem.delassus.toarray(), j @ np.linalg.solve(mass, j.T), rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(problem.mass.toarray(), mass)
    np.testing.assert_array_equal(problem.jacobian.toarray(), j)
    assert signorini.residual(problem, impulse).relative < 1e-12
    assert ContactProblem(np.eye(3), np.zeros(3), [1.0]).mass is None


def test_an_unsymmetric_matrix_stands_for_its_symmetric_part(planted):
    delassus, g, mu, _ = planted
    skew = np.triu(np.ones_like(delassus), 1)
    skew -= skew.T
    problem = ContactProblem(delassus + 1e-3 * skew, g, mu)
    np.testing.assert_allclose(problem.delassus.toarray(), delassus, atol=1e-14)
    # max |G - G^T| = 2e-3, whatever G
    assert problem.asymmetry == pytest.approx(2e-3 / abs(delassus + 1e-3 * skew).max(), rel=1e-6)
    assert ContactProblem(delassus, g, mu).asymmetry < 1e-15
    for matrix in (delassus + 1e-3 * skew, sp.csc_array(delassus + 1e-3 * skew)):
        problem = ContactProblem(matrix, g, mu)
        assert pickle.loads(pickle.dumps(problem)).asymmetry == problem.asymmetry


def test_what_is_certified_is_true_of_an_ill_conditioned_mass_matrix():
    # M = T^T T of whole numbers, det T = 1, so that G is of whole numbers too; condition number 9e10.
    t = np.eye(6) + 8 * np.eye(6, k=-1)
    x = np.rint(np.linalg.inv(t)).T
    np.testing.assert_array_equal(t @ x.T, np.eye(6))
    rng = np.random.default_rng(0)
    solved = 0
    for _ in range(20):
        j = rng.integers(-3, 4, (9, 6)).astype(float)
        exact, g = (x @ j.T).T @ (x @ j.T), rng.normal(size=9)
        problem = ContactProblem.from_mass(t.T @ t, j, g, 0.5)
        solution = signorini.solve(problem, tolerance=1e-8)
        certificate = signorini.residual(ContactProblem(exact, g, 0.5), solution.impulse)
        assert certificate.relative == pytest.approx(solution.residual.relative, rel=1e-3, abs=1e-12)
        solved += solution.solved
    assert solved > 10


def test_scale_is_the_mean_diagonal_of_each_contact(planted):
    delassus, g, mu, _ = planted
    compliance = np.linspace(0.0, 1.0, 15)
    problem = ContactProblem(delassus, g, mu, compliance)
    mean = (np.diag(delassus) + compliance).reshape(-1, 3).mean(axis=1)
    np.testing.assert_allclose(problem.scale, np.repeat(mean, 3))
    np.testing.assert_array_equal(problem.compliance, compliance)


def test_velocity_holds_the_compliance(planted):
    delassus, g, mu, impulse = planted
    problem = ContactProblem(delassus, g, mu, np.full(15, 0.5))
    np.testing.assert_allclose(problem.velocity(impulse), delassus @ impulse + 0.5 * impulse + g, atol=1e-12)


def test_projection_is_the_nearest_point_of_the_cones():
    rng = np.random.default_rng(3)
    mu = np.array([0.0, 0.3, 1.0, 5.0] * 25)
    x = rng.normal(size=(100, 3))
    problem = ContactProblem(np.eye(300), np.zeros(300), mu)
    np.testing.assert_allclose(problem.project(x.ravel()).reshape(-1, 3), project_cone(mu, x), atol=1e-14)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
@pytest.mark.parametrize("seed", range(20))
def test_certificate_is_the_formula(seed, law):
    rng = np.random.default_rng(seed)
    mass, j, g, mu, impulse = planted_problem(seed)
    delassus, r = j @ np.linalg.solve(mass, j.T), rng.uniform(0, 0.1, 15)
    x = impulse + rng.normal(size=15)
    problem = ContactProblem(delassus, g, mu, r)
    expected = relative_residual(delassus, g, mu, x, r, law)
    assert signorini.residual(problem, x, law).relative == pytest.approx(expected, rel=1e-9)


def test_other_residuals_of_one_contact_by_hand():
    # G = I, g = 0: sigma = impulse = (3, 4, 1), friction 0.5; Gamma lifts the normal by 0.5 * 5.
    r = signorini.residual(ContactProblem(np.eye(3), np.zeros(3), [0.5]), [3.0, 4.0, 1.0])
    edge = (0.5 * 5 + 1) / 1.25  # normal of the projection on the cone
    assert r.primal == pytest.approx(np.hypot(5 - 0.5 * edge, 1 - edge))
    assert r.dual == 0.0  # (3, 4, 3.5): 0.5 * 5 <= 3.5
    assert r.complementarity == pytest.approx(25 + 3.5)
    assert r.dissipation == pytest.approx(25 + 0.5 * 1 * 5)
    assert r.signorini == 0.0
    assert r.against_free_velocity == np.inf  # nothing asked for an impulse
    names = "primal dual complementarity relative against_free_velocity signorini dissipation"
    assert list(r.to_dict()) == names.split()
    pull = signorini.residual(ContactProblem(np.eye(3), np.zeros(3), [0.5]), [0.0, 0.0, -2.0])
    assert pull.signorini == pytest.approx(2.0)


def test_certificate_of_nan_is_nan():
    r = signorini.residual(ContactProblem(np.eye(3), np.zeros(3), [0.5]), [np.nan, 0.0, 1.0])
    assert all(np.isnan(value) for value in r.to_dict().values())


def test_mixed_constraints():
    constraints = [HalfLine(), FrictionCone(0.5), Interval(-1.0, 2.0), Equality()]
    problem = ContactProblem(np.eye(6), np.zeros(6), constraints=constraints)
    assert (problem.num_contacts, problem.num_constraints, problem.size) == (1, 4, 6)
    assert problem.constraints == tuple(constraints)
    np.testing.assert_array_equal(problem.friction, [0.5])
    np.testing.assert_array_equal(problem.project([-1, 0, 0, 1, 5, -7]), [0, 0, 0, 1, 2, -7])
    infinite = ContactProblem(np.eye(1), [1.0], constraints=[Interval(-np.inf, np.inf)])
    np.testing.assert_array_equal(infinite.project([-1e9]), [-1e9])


def test_pure_contacts_and_explicit_cones_are_the_same(planted):
    delassus, g, mu, impulse = planted
    cones = ContactProblem(delassus, g, constraints=[FrictionCone(m) for m in mu])
    assert cones.constraints == ContactProblem(delassus, g, mu).constraints
    np.testing.assert_array_equal(cones.friction, mu)
    assert signorini.residual(cones, impulse).relative < 1e-12


def test_one_friction_coefficient_serves_all(planted):
    delassus, g, _, _ = planted
    np.testing.assert_array_equal(ContactProblem(delassus, g, 0.3).friction, np.full(5, 0.3))


@pytest.mark.parametrize("kind", ["delassus", "mass", "mixed"])
def test_pickle(kind):
    mass, j, g, mu, impulse = planted_problem(2)
    if kind == "mass":
        problem = ContactProblem.from_mass(mass, j, g, mu, np.full(15, 0.1), name="p")
    elif kind == "delassus":
        problem = ContactProblem(j @ np.linalg.solve(mass, j.T), g, mu, np.full(15, 0.1), name="p")
    else:
        problem = ContactProblem(np.eye(15), g, constraints=[Equality()] * 15, name="p")
    copy = pickle.loads(pickle.dumps(problem))
    assert copy.name == "p"
    assert copy.constraints == problem.constraints
    np.testing.assert_array_equal(copy.velocity(impulse), problem.velocity(impulse))
    assert (copy.mass is None) == (problem.mass is None)


def test_empty_problem():
    problem = ContactProblem(np.zeros((0, 0)), [], [])
    assert (problem.size, problem.num_contacts) == (0, 0)
    assert problem.delassus.shape == (0, 0)
    assert signorini.residual(problem, []).relative == 0.0
    mass = ContactProblem.from_mass(np.eye(6), np.zeros((0, 6)), [], [])
    assert mass.size == 0


def test_repr_says_what_it_is():
    text = repr(ContactProblem(np.eye(4), np.zeros(4), constraints=[FrictionCone(1.0), Equality()], name="block"))
    assert text == "ContactProblem('block', 1 contacts, 1 other constraints)"


def test_import_leaves_the_slow_packages_alone():
    slow = "scipy h5py typer rich matplotlib"
    code = f"import sys, signorini; print([m for m in '{slow}'.split() if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.mark.parametrize("friction", [0.5, np.float32(0.5), np.float64(0.5), np.array(0.5)])
def test_one_friction_of_any_number_type_serves_all(friction: object) -> None:
    problem = signorini.ContactProblem(np.eye(6), np.zeros(6), friction)
    assert problem.friction.tolist() == [0.5, 0.5]
