import numpy as np
import pytest
import scipy.sparse.linalg as sla

import signorini
from signorini import fclib, scenes

GRAVITY_STEP = 9.81e-3  # m/s in one step of 1 ms

SCENES = {
    "stack": lambda: scenes.cube_stack(4, 100.0, 0.1),
    "wall": lambda: scenes.wall(3, 3, 1e3),
    "pile": lambda: scenes.pile(60, 1),
    "deep pile": lambda: scenes.pile(60, 1, layers=None, mass_ratio=100.0),
    "jammed pile": lambda: scenes.pile(60, 1, contacts_per_sphere=2.6),
    "chain": lambda: scenes.chain(11, 1),
}


@pytest.fixture(params=SCENES, scope="module")
def scene(request):
    return SCENES[request.param]


def test_delassus_is_that_of_mass_and_jacobian(scene):
    problem = scene()
    g = problem.jacobian @ sla.spsolve(problem.mass.tocsc(), problem.jacobian.T.tocsc()).toarray()
    np.testing.assert_allclose(problem.delassus.toarray(), g, atol=1e-12 * np.abs(g).max())
    eigenvalues = np.linalg.eigvalsh(g)
    assert eigenvalues[0] >= -1e-12 * eigenvalues[-1]
    assert np.linalg.eigvalsh(problem.mass.toarray())[0] > 0


def test_heaps_that_stand_are_solved_without_wandering():
    """Where branches of the NCP turn in every other step, to hold the De Saxce derivative back stalls at 1e-4."""
    factorizations = 0
    for shape in ({}, {"layers": None}, {"contacts_per_sphere": 2.6}):
        for seed in range(3):
            solution = signorini.solve(scenes.pile(464, seed, **shape))
            assert solution.solved
            factorizations += solution.factorizations
    assert factorizations < 1000  # 1800 that way


def test_same_arguments_same_problem(scene):
    first, second = scene(), scene()
    assert first.name == second.name
    np.testing.assert_array_equal(first.delassus.toarray(), second.delassus.toarray())
    np.testing.assert_array_equal(first.free_velocity, second.free_velocity)


def test_rows_are_relative_velocities_in_orthonormal_frames(scene):
    problem = scene()
    j = problem.jacobian.toarray()
    for contact in range(problem.num_contacts):
        rows = j[3 * contact : 3 * contact + 3]
        bodies = {column // 6 for column in np.flatnonzero(np.abs(rows).sum(0))}
        assert 1 <= len(bodies) <= 2
        linear = [rows[:, 6 * body : 6 * body + 3] for body in bodies]
        for frame in linear:
            np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
            assert abs(abs(np.linalg.det(frame)) - 1.0) < 1e-12
        if len(linear) == 2:
            np.testing.assert_allclose(linear[0], -linear[1], atol=1e-12)  # no net force from an inner contact


def test_other_seeds_are_other_problems():
    assert np.abs(scenes.pile(50, 0).free_velocity - scenes.pile(50, 1).free_velocity).max() > 0
    assert scenes.chain(11, 0).name != scenes.chain(11, 1).name


@pytest.mark.parametrize("num_contacts", [1, 2, 7, 100, 301])
@pytest.mark.parametrize("layers", [1.0, 4.0, None])
def test_pile_has_the_contacts_asked_for(num_contacts, layers):
    problem = scenes.pile(num_contacts, layers=layers)
    assert problem.num_contacts == num_contacts
    assert np.all(np.isfinite(problem.free_velocity))


def test_pile_is_settled():
    problem = scenes.pile(500, 3, speed=0.0)
    # No contact is nearer than touching or farther than a fiftieth of a radius, and gravity adds at most g dt.
    normal = problem.free_velocity[2::3]
    assert normal.min() >= -GRAVITY_STEP - 1e-12
    assert normal.max() <= 0.02 * 0.05 / 1e-3 + GRAVITY_STEP


@pytest.mark.parametrize("layers", [4.0, None])
def test_the_ground_carries_a_pile(layers):
    # With more friction solutions are several: what is wedged between walls and ground may press with any force.
    problem = scenes.pile(500, 1, layers=layers, speed=0.0, friction=0.2)
    solution = signorini.solve(problem, tolerance=1e-6)
    assert solution.status == "solved"
    ground = problem.free_velocity[2::3] < -0.99 * GRAVITY_STEP  # elsewhere it touches walls and bodies that fall along
    carried = solution.impulse[2::3][ground].sum()
    num_spheres = np.ceil(500 / 2.2)  # of 1 kg
    # The rest is up to the walls, which hold by friction.
    assert 0.7 < carried / (num_spheres * GRAVITY_STEP) < 1.3


def test_stack_stands_on_its_weight():
    problem = scenes.cube_stack(5, 1e3)
    solution = signorini.solve(problem, tolerance=1e-9)
    assert solution.status == "solved"
    weight = np.geomspace(1.0, 1e3, 5).sum() * GRAVITY_STEP
    assert solution.impulse.reshape(-1, 3)[:4, 2].sum() == pytest.approx(weight, rel=1e-6)
    np.testing.assert_allclose(solution.velocity, 0.0, atol=1e-8)


@pytest.mark.parametrize("mass_ratio", [1, 100, 10000])
@pytest.mark.parametrize("slip", [0, 0.05, 0.5])
def test_stack_is_that_of_the_files(data, mass_ratio, slip):
    path = data / "cube_stack" / f"CubeStack-{mass_ratio}-{slip}.hdf5"
    if not path.exists():
        pytest.skip(f"no {path}")
    stored, made = fclib.read(path), scenes.cube_stack(15, mass_ratio, slip)
    np.testing.assert_allclose(made.delassus.toarray(), stored.delassus.toarray(), atol=1e-12)
    np.testing.assert_allclose(made.free_velocity, stored.free_velocity, atol=1e-12)
    np.testing.assert_allclose(made.friction, stored.friction)


def test_ball_hits_the_wall():
    with_ball, without = scenes.wall(4, 3), scenes.wall(4, 3, ball_mass=0.0)
    assert with_ball.num_contacts == without.num_contacts + 1
    assert with_ball.free_velocity[-1] == pytest.approx(-5.0)  # it approaches the last contact's brick
    with_ball_solution = signorini.solve(with_ball, tolerance=1e-6)
    assert with_ball_solution.status == "solved"
    assert with_ball_solution.impulse[-1] > 0.0


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: scenes.cube_stack(0), "num_cubes"),
        (lambda: scenes.cube_stack(3, -1.0), "mass_ratio"),
        (lambda: scenes.cube_stack(3, float("nan")), "mass_ratio"),
        (lambda: scenes.cube_stack(3, friction=-1.0), "friction"),
        (lambda: scenes.wall(0, 3), "num_rows"),
        (lambda: scenes.pile(0), "num_contacts"),
        (lambda: scenes.pile(10, layers=0.0), "layers"),
        (lambda: scenes.pile(10, dt=0.0), "dt"),
        (lambda: scenes.chain(1), "num_links"),
        (lambda: scenes.chain(3, mass_ratio=0.0), "mass_ratio"),
        (lambda: scenes.chain(3, seed=-1), "seed"),
        (lambda: scenes.wall(3, 3, ball_mass=-1.0), "ball_mass"),
        (lambda: scenes.pile(10, contacts_per_sphere="x"), "contacts_per_sphere"),
        (lambda: scenes.cube_stack(2.5), "num_cubes"),
        (lambda: scenes.cube_stack(3, slip=float("inf")), "slip"),
        (lambda: scenes.cube_stack(3, slip=1e300), "slip"),
        (lambda: scenes.cube_stack(3, mass_ratio=1e-300), "mass_ratio"),
        (lambda: scenes.wall(3, 3, size=1e300), "size"),
        (lambda: scenes.wall(3, 3, ball_mass=1e-300), "ball_mass"),
        (lambda: scenes.pile(10, contacts_per_sphere=1e-300), "contacts_per_sphere"),
        (lambda: scenes.pile(10, radius=1e-300), "radius"),
        (lambda: scenes.scaled_masses(scenes.chain(3), 0.0), "factor"),
        (lambda: scenes.with_compliance(scenes.chain(3), -1e-6), "fraction"),
        (lambda: scenes.with_friction(scenes.chain(3), -0.1), "friction"),
    ],
)
def test_bad_arguments_are_named(make, field):
    with pytest.raises(signorini.InvalidInputError, match=rf"^{field}\b"):
        make()


@pytest.fixture(params=["mass", "delassus"])
def stack(request):
    made = scenes.cube_stack(3, 10.0, 0.2)
    if request.param == "mass":
        return made
    return signorini.ContactProblem(made.delassus, made.free_velocity, made.friction, name=made.name)


def test_scaled_masses_scale_the_impulses(stack):
    heavy = scenes.scaled_masses(stack, 1e6)
    np.testing.assert_allclose(heavy.delassus.toarray(), stack.delassus.toarray() / 1e6, atol=1e-20)
    impulse = np.random.default_rng(0).standard_normal(stack.size)
    relative = signorini.residual(heavy, 1e6 * impulse).relative
    assert relative == pytest.approx(signorini.residual(stack, impulse).relative, rel=1e-9)


def test_compliance_is_a_fraction_of_the_diagonal(stack):
    soft = scenes.with_compliance(stack, 1e-2)
    np.testing.assert_allclose(soft.compliance, 1e-2 * stack.delassus.diagonal())
    np.testing.assert_array_equal(soft.delassus.toarray(), stack.delassus.toarray())


def test_friction_is_replaced(stack):
    for friction in (0.0, 3.0):
        np.testing.assert_array_equal(scenes.with_friction(stack, friction).friction, friction)
    assert (scenes.with_friction(stack, 0.0).mass is None) == (stack.mass is None)


def test_every_stress_keeps_the_size(stack):
    for name, stress in scenes.STRESSES.items():
        assert stress(stack).size == stack.size, name


@pytest.mark.parametrize("make", [scenes.pile, scenes.chain])
def test_seeds_have_63_bits(make):
    make(3, seed=2**63 - 1)
    with pytest.raises(signorini.InvalidInputError, match=r"^seed: is \d+, must be in \[0, 2\^63\)"):
        make(3, seed=2**63)
