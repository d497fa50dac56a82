"""The impulse behind a contact velocity, against the law itself, closed forms and planted answers."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from reference import project_cone
from scipy.optimize import nnls

import signorini
from signorini import ContactProblem, Equality, FrictionCone, HalfLine, Interval, InvalidInputError, inverse_contact

LAWS = ("ncp", "ccp")


# The law once more (T2 to T8), and how far a velocity is from it.


def corrected(mu, sigma, law):
    """sigma + Gamma(sigma)"""
    return np.asarray(sigma) + [0.0, 0.0, mu * np.hypot(*sigma[:2]) if law == "ncp" else 0.0]


def distance_to_cone(rays, x):
    """From x to what nonnegative multiples of the rays add up to."""
    return nnls(np.array(rays, dtype=float).T, x)[1] if rays else np.linalg.norm(x)


def cone_distance(mu, impulse, s):
    """dist(-s, N_K(impulse)); N_K by what generates it."""
    t = np.hypot(*impulse[:2])
    if not impulse.any():
        # What the polar cone leaves of it (Moreau).
        return np.linalg.norm(project_cone([mu], -s[None])[0])
    if t < (1.0 - 1e-9) * mu * impulse[2]:
        return np.linalg.norm(s)
    if mu == 0.0:
        return distance_to_cone([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], -s)
    return distance_to_cone([(*(impulse[:2] / t), -mu)], -s)


def line_distance(lower, upper, impulse, s):
    rays = [(side,) for side, end in ((-1.0, lower), (1.0, upper)) if impulse == end]
    return distance_to_cone(rays, np.array([-s]))


def distances(constraints, impulse, sigma, law):
    found, at = [], 0
    for one in constraints:
        if isinstance(one, FrictionCone):
            x, s = impulse[at : at + 3], corrected(one.friction, sigma[at : at + 3], law)
            found.append(cone_distance(one.friction, x, s))
            at += 3
            continue
        lower, upper = {HalfLine: (0.0, np.inf), Equality: (-np.inf, np.inf)}.get(type(one)) or (one.lower, one.upper)
        found.append(line_distance(lower, upper, impulse[at], sigma[at]))
        at += 1
    return np.array(found)


def obeys(mu, impulse, sigma, law, tolerance):
    """Signorini and Coulomb, or the CCP, spelled out; tolerance relative to both vectors."""
    (t, n), (slip, gap) = [(np.hypot(*x[:2]), x[2]) for x in (impulse, sigma)]
    force, speed = tolerance * np.linalg.norm(impulse), tolerance * (np.linalg.norm(sigma) + np.linalg.norm(gap) + 1)
    power = tolerance * np.linalg.norm(impulse) * (np.linalg.norm(sigma) + 1)
    in_cone = n >= -force and t <= mu * n + force
    if law == "ccp":
        return in_cone and mu * slip <= gap + speed * max(1.0, mu) and abs(impulse @ sigma) <= power
    friction = impulse[:2] @ sigma[:2] + mu * n * slip
    return in_cone and gap >= -speed and abs(n * gap) <= power and abs(friction) <= power * max(1.0, mu)


# What one contact may be asked.

sizes = st.floats(-3.0, 3.0).map(lambda e: 10.0**e)
angles = st.floats(0.0, 2.0 * np.pi)
numbers = st.one_of(st.just(0.0), st.builds(lambda size, sign: sign * size, sizes, st.sampled_from((-1.0, 1.0))))
frictions = st.one_of(st.just(0.0), st.floats(0.05, 3.0))
vectors = st.builds(lambda t, a, n: np.array([t * np.cos(a), t * np.sin(a), n]), numbers, angles, numbers)
property_test = settings(max_examples=150, deadline=None, derandomize=True)


def pair(t, n):
    return np.array([t, t, n])


# Closed forms.


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("compliance", [None, (1e-3, 1e-3, 2e-3)])
def test_an_open_contact_carries_nothing(law, compliance):
    c = [0.1, -0.2, 0.5]  # within K* too, so that the CCP lets it be
    for guess in (None, [0.0, 0.0, 3.0], [0.5, 0.0, 3.0], [9.0, -4.0, -1.0]):
        solution = inverse_contact(c, compliance, 0.5, guess, law)
        assert solution.solved
        assert not solution.impulse.any()
        assert solution.velocity == pytest.approx(c, abs=0)
        assert solution.residual == 0.0


@pytest.mark.parametrize("law", LAWS)
def test_a_rigid_contact_that_sticks_keeps_the_guess_or_what_of_it_is_in_the_cone(law):
    inside, outside = np.array([0.3, -0.2, 1.0]), np.array([2.0, 0.0, 1.0])
    kept = inverse_contact(np.zeros(3), None, 0.5, inside, law)
    assert (kept.impulse == inside).all()
    assert kept.iterations == 0
    moved = inverse_contact(np.zeros(3), None, 0.5, outside, law)
    assert moved.impulse == pytest.approx(project_cone([0.5], outside[None])[0], rel=1e-15)
    assert not inverse_contact(np.zeros(3), None, 0.5, None, law).impulse.any()
    assert kept.solved
    assert moved.solved


@pytest.mark.parametrize("angle", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("speed", [1e-4, 1.0, 50.0])
@pytest.mark.parametrize("mu", [0.0, 0.3, 1.5])
def test_a_rigid_contact_that_slides(mu, speed, angle):
    direction = np.array([np.cos(angle), np.sin(angle)])
    c = np.append(speed * direction, 0.0)
    ray = np.append(-mu * direction, 1.0)
    assert not inverse_contact(c, None, mu).impulse.any()  # zero is one of the many
    for pressed in (1e-3, 2.0, 300.0):
        on_ray = pressed * ray
        again = inverse_contact(c, None, mu, on_ray)
        assert again.solved
        assert again.impulse == pytest.approx(on_ray, rel=1e-12, abs=1e-15)
        # Not on the ray: the wanted normal impulse counts, friction follows.
        for guess in (np.array([0.0, 0.0, pressed]), pressed * np.append(0.9 * mu * direction, 1.0)):
            solution = inverse_contact(c, None, mu, guess)
            assert solution.solved
            assert solution.impulse == pytest.approx(on_ray, rel=1e-9, abs=1e-12)
            again = inverse_contact(c, None, mu, solution.impulse)
            assert again.impulse == pytest.approx(solution.impulse, rel=1e-14)
            assert obeys(mu, solution.impulse, c, "ncp", 1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_compliant_closed_forms(law):
    d_t, d_n, mu = 4e-3, 1e-3, 0.5
    r = pair(d_t, d_n)
    pressed = inverse_contact([0.0, 0.0, -0.2], r, mu, None, law)
    assert pressed.impulse == pytest.approx([0.0, 0.0, 200.0])
    assert pressed.velocity == pytest.approx(np.zeros(3), abs=1e-15)
    sticks = inverse_contact([0.2, 0.1, -0.2], r, mu, None, law)
    assert sticks.impulse == pytest.approx([-50.0, -25.0, 200.0])
    assert sticks.solved
    slides = inverse_contact([3.0, 4.0, -0.2], r, mu, None, law)
    if law == "ncp":
        assert slides.impulse == pytest.approx([-60.0, -80.0, 200.0])
        assert slides.velocity == pytest.approx([2.76, 3.68, 0.0])
    else:  # along the edge: n (d_n + mu^2 d_t) = mu |c_T| - c_N, and it lifts off at mu |sigma_T|
        n = (mu * 5.0 + 0.2) / (d_n + mu**2 * d_t)
        assert slides.impulse == pytest.approx(n * np.array([-0.3, -0.4, 1.0]))
        assert slides.velocity[2] == pytest.approx(mu * np.hypot(*slides.velocity[:2]))
    assert slides.solved


def test_compliance_of_the_normal_alone():
    mu, c = 0.5, np.array([0.3, 0.4, -0.1])
    solution = inverse_contact(c, [0.0, 0.0, 1e-3], mu)
    assert solution.impulse == pytest.approx([-30.0, -40.0, 100.0])
    relaxed = inverse_contact(c, [0.0, 0.0, 1e-3], mu, law="ccp")
    assert relaxed.impulse == pytest.approx((mu * 0.5 + 0.1) / 1e-3 * np.array([-0.3, -0.4, 1.0]), rel=1e-6)
    sticks = inverse_contact([0.0, 0.0, -0.1], [0.0, 0.0, 1e-3], mu, [7.0, 0.0, 999.0])
    assert sticks.impulse == pytest.approx([7.0, 0.0, 100.0])  # of the tangents the guess decides


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("compliance", [(0.0, 0.0, 1e-3), (0.0, 0.0, 1e-6), (1e-3, 1e-3, 1e-3), (1e-3, 1e-3, 0.0)])
def test_a_contact_at_rest_needs_nothing_where_it_is_soft(compliance, law):
    for guess in ([0.2, 0.1, 3.0], [-5.0, 3.0, 1.0]):
        solution = inverse_contact(np.zeros(3), compliance, 2.0, guess, law)
        assert solution.solved
        soft = np.array(compliance) > 0.0
        assert solution.impulse[soft] == pytest.approx(np.zeros(soft.sum()), abs=1e-9)
        assert np.isfinite(solution.relative)


def test_lines():
    def impulse(constraint, c, guess=None, compliance=None):
        args = [None if x is None else [x] for x in (compliance, guess)]
        solution = inverse_contact([c], args[0], None, args[1], constraints=[constraint])
        assert solution.solved
        return solution.impulse[0]

    assert impulse(HalfLine(), 0.3, 5.0) == 0.0
    assert impulse(HalfLine(), 0.0, 5.0) == 5.0
    assert impulse(HalfLine(), 0.0, -5.0) == 0.0
    assert impulse(HalfLine(), -0.3, None, 0.1) == pytest.approx(3.0)
    friction = Interval(-2.0, 3.0)
    for guess in (None, -9.0, 1.0, 9.0):
        assert impulse(friction, 0.3, guess) == -2.0
        assert impulse(friction, -0.3, guess) == 3.0
    assert [impulse(friction, 0.0, guess) for guess in (None, -9.0, 1.5, 9.0)] == [0.0, -2.0, 1.5, 3.0]
    assert impulse(friction, -0.1, None, 0.1) == pytest.approx(1.0)
    assert impulse(friction, -1.0, None, 0.1) == 3.0
    for lower, upper, still in ((1.0, 3.0, 1.0), (-3.0, -1.0, -1.0), (2.0, 2.0, 2.0)):  # without 0
        assert impulse(Interval(lower, upper), 0.0) == still
        assert impulse(Interval(lower, upper), 0.4) == lower
        assert impulse(Interval(lower, upper), -0.4) == upper
    assert impulse(Interval(0.0, np.inf), 0.0, 4.0) == 4.0
    assert impulse(Equality(), 0.0) == 0.0
    assert impulse(Equality(), 0.0, -7.0) == -7.0
    assert impulse(Equality(), 0.5, None, 0.1) == pytest.approx(-5.0)


# Planted answers.


def plant(seed, law, num_contacts=6):
    """(c, R, mu, impulse): contacts that stick, slide and open by turns, R > 0, c chosen so that impulse solves."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(0.05, 1.5, num_contacts)
    impulse, s = np.zeros((num_contacts, 3)), np.zeros((num_contacts, 3))
    for i in range(num_contacts):
        # Moreau: a point is the sum of complementary parts, one in K, one in the polar cone.
        point = rng.normal(size=3) * 10.0 ** rng.uniform(-1, 1)
        if i % 3 == 0:
            point = np.append(rng.uniform(0, 0.95) * mu[i] * abs(point[2]) * point[:2] / np.hypot(*point[:2]), point[2])
            point[2] = abs(point[2])
        elif i % 3 == 1:
            point[2] = (rng.uniform(-0.9 / mu[i], 0.9 / mu[i] if mu[i] > 1.0 else 0.9 * mu[i])) * np.hypot(*point[:2])
        else:
            point[2] = -(mu[i] + rng.uniform()) * np.hypot(*point[:2])
        impulse[i] = project_cone(mu[i : i + 1], point[None])[0]
        s[i] = impulse[i] - point
    sigma = s.copy()
    if law == "ncp":
        sigma[:, 2] -= mu * np.hypot(s[:, 0], s[:, 1])
    r = 10.0 ** rng.uniform(-3, 1, (num_contacts, 2)) @ [[1, 1, 0], [0, 0, 1]]
    return (sigma - r * impulse).ravel(), r.ravel(), mu, impulse.ravel()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(12))
def test_planted_impulses_are_found(seed, law):
    # Unique: the normal rows alone are a strictly monotone complementarity problem, and with the normal impulses known
    # friction is the point of a disc closest to -c_T / R_T; the CCP is strictly convex.
    c, r, mu, impulse = plant(seed, law)
    for guess in (None, np.random.default_rng(seed).normal(size=c.size)):
        solution = inverse_contact(c, r, mu, guess, law)
        assert solution.solved
        assert solution.impulse == pytest.approx(impulse, rel=1e-10, abs=1e-10 * np.abs(impulse).max())
        assert solution.residual <= 1e-12 * np.abs(c).max()


def test_planted_impulses_of_all_sets_at_once():
    c, r, mu, impulse = plant(3, "ncp", 3)
    constraints = [FrictionCone(mu[0]), HalfLine(), Interval(0.5, 2.0), FrictionCone(mu[1]), Equality(), HalfLine()]
    constraints += [Interval(-1.0, np.inf), FrictionCone(mu[2])]
    lines = {3: (0.7, 0.2, 0.0), 4: (2.0, 0.3, -1.0), 8: (-0.4, 0.1, 0.0), 9: (0.0, 0.5, 0.8), 10: (-1.0, 0.0, 0.3)}
    x, d, sigma, contact = [], [], [], iter(range(3))  # of lines: impulse, compliance, velocity
    for one in constraints:
        if isinstance(one, FrictionCone):
            rows = slice(3 * (i := next(contact)), 3 * i + 3)
            x, d = [*x, *impulse[rows]], [*d, *r[rows]]
            sigma = [*sigma, *(c[rows] + r[rows] * impulse[rows])]
        else:
            for to, value in zip((x, d, sigma), lines[len(x)], strict=True):
                to.append(value)
    solution = inverse_contact(np.array(sigma) - np.array(d) * x, d, constraints=constraints)
    assert solution.solved
    assert solution.impulse == pytest.approx(x, rel=1e-10, abs=1e-12)


# The law.


@property_test
@given(c=vectors, d_t=sizes, d_n=sizes, mu=frictions, guess=vectors, law=st.sampled_from(LAWS))
def test_answers_with_compliance_obey_the_law_and_do_not_depend_on_the_guess(c, d_t, d_n, mu, guess, law):
    r = pair(d_t, d_n)
    solution = inverse_contact(c, r, mu, guess, law, tolerance=1e-10)
    assert solution.solved
    assert solution.velocity == pytest.approx(r * solution.impulse + c, abs=1e-15 * max(1.0, np.abs(c).max()))
    scale = np.sqrt(max(d_t, d_n) / min(d_t, d_n))
    assert obeys(
        mu,
        solution.impulse / max(1e-300, np.abs(solution.impulse).max()),
        solution.velocity / max(1e-300, np.abs(c).max() * scale),
        law,
        1e-9,
    )
    other = inverse_contact(c, r, mu, None, law)
    assert solution.impulse == pytest.approx(other.impulse, rel=1e-12, abs=1e-12 * np.abs(other.impulse).max())


@property_test
@given(c=vectors, d_t=sizes, d_n=sizes, mu=frictions)
def test_the_relaxation_is_the_minimum_of_its_energy(c, d_t, d_n, mu):
    # Over (r, n), |x_T| = r opposite to c_T: the corner, the edge r = mu n, the inside.
    speed = np.hypot(*c[:2])

    def energy(r, n):
        return 0.5 * d_t * r * r - speed * r + 0.5 * d_n * n * n + c[2] * n

    edge = max(0.0, (mu * speed - c[2]) / (d_t * mu**2 + d_n))
    found = [(0.0, 0.0), (mu * edge, edge)]
    if c[2] <= 0.0 and speed / d_t <= mu * -c[2] / d_n:
        found.append((speed / d_t, -c[2] / d_n))
    r, n = min(found, key=lambda x: energy(*x))
    expected = np.append(-r * c[:2] / speed if speed > 0 else np.zeros(2), n)
    solution = inverse_contact(c, pair(d_t, d_n), mu, law="ccp")
    assert solution.impulse == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(r, n))


@property_test
@given(
    speed=st.one_of(st.just(0.0), sizes),
    angle=angles,
    lift=st.one_of(st.just(0.0), sizes),
    mu=frictions,
    guess=vectors,
    law=st.sampled_from(LAWS),
)
def test_rigid_contacts_that_can_be_obey_the_law(speed, angle, lift, mu, guess, law):
    c = np.array([speed * np.cos(angle), speed * np.sin(angle), lift + (mu * speed if law == "ccp" else 0.0)])
    solution = inverse_contact(c, None, mu, guess, law, tolerance=1e-9)
    assert solution.solved
    size = np.abs(solution.impulse).max()
    assert obeys(mu, solution.impulse / (size or 1.0), c / (np.abs(c).max() or 1.0), law, 1e-8)
    again = inverse_contact(c, None, mu, solution.impulse, law, tolerance=1e-9)
    assert again.impulse == pytest.approx(solution.impulse, rel=1e-13, abs=1e-13 * size)
    if size > 0.0 and law == "ncp":  # closed: next to the guess means its normal impulse
        assert solution.impulse[2] == pytest.approx(project_cone([mu], guess[None])[0, 2], rel=1e-9)


def algorithm_2(c, r, mu, guess, law, rho=1e-8, steps=3000):
    """As the paper writes it: s of the last iterate, one projection in the metric of D = R + rho; None: no limit."""
    d = r + rho
    x = np.array(guess, dtype=float)
    for _ in range(steps):
        s = corrected(mu, r * x + c, law) - (r * x + c)
        root = np.sqrt(d)
        y = project_cone([mu * root[0] / root[2]], (root * (-(c + s - rho * x) / d))[None])[0] / root
        done = np.abs(y - x).max() <= 1e-14 * np.abs(y).max()
        x = y
        if done:
            return x
    return None


@pytest.mark.parametrize("law", LAWS)
def test_algorithm_2_as_the_paper_writes_it_agrees_where_it_converges(law):
    rng = np.random.default_rng(5)
    converged = 0
    for _ in range(60):
        r = pair(*(10.0 ** rng.uniform(-3, 0, 2)))
        c, mu, guess = rng.normal(size=3) * [1, 1, 0.7], rng.uniform(0.1, 1.0), rng.normal(size=3)
        theirs = algorithm_2(c, r, mu, guess, law)
        if theirs is None:
            continue
        converged += 1
        ours = inverse_contact(c, r, mu, guess, law)
        assert ours.impulse == pytest.approx(theirs, rel=1e-6, abs=1e-6 * np.abs(theirs).max())
    assert converged > 40
    for c, guess in (((0.0, 0.0, 0.0), (0.2, 0.1, 1.0)), ((3.0, 4.0, 0.0), (-0.6, -0.8, 2.0))):  # rigid
        if law == "ccp" and c[0] > 0.0:
            continue
        theirs = algorithm_2(np.array(c), np.zeros(3), 0.5, guess, law, 1e-2)
        assert theirs == pytest.approx(guess)
        assert inverse_contact(c, None, 0.5, guess, law).impulse == pytest.approx(theirs, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_contacts_do_not_feel_each_other(law):
    open_one, mu = [0.0, 0.0, 50.0], 0.5  # sets the scale of speed, wants nothing
    rng = np.random.default_rng(8)
    found = []
    for _ in range(12):
        c = rng.normal(size=3) * (rng.uniform() < 0.7)
        c[2] = abs(c[2]) * (rng.uniform() < 0.5) + mu * np.hypot(*c[:2]) * (law == "ccp")
        c += [0.0, 0.0, 1e-8 * rng.uniform()]  # opens so slowly that it counts as closed: the guess stays
        r, guess = pair(0.1, 0.1) * (rng.uniform() < 0.3), rng.normal(size=3)
        alone = inverse_contact([*c, *open_one], [*r, 0.0, 0.0, 0.0], mu, [*guess, 0.0, 0.0, 0.0], law)
        assert alone.solved
        found.append((c, r, guess, alone.impulse[:3]))
    c, r, guess, impulse = [np.concatenate(x) for x in zip(*found, strict=True)]
    zero = np.zeros(3)
    together = inverse_contact([*c, *open_one], [*r, *zero], mu, [*guess, *zero], law)
    assert together.solved
    assert (together.impulse[:-3] == impulse).all()


# The certificate.

KINDS = [FrictionCone(0.6), HalfLine(), Interval(-0.5, 1.0), Equality(), FrictionCone(0.0), Interval(1.0, 1.0)]
KINDS += [FrictionCone(2.0), Interval(-np.inf, 0.3), Interval(0.2, 0.9)]
ROWS = sum(3 if isinstance(one, FrictionCone) else 1 for one in KINDS)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("max_iterations", [1, 2, 100])
def test_residuals_are_the_distance_to_the_normal_cone_whatever_came_out(max_iterations, rigid, law):
    statuses = set()
    for seed in range(40):
        rng = np.random.default_rng(seed)
        c, guess, r = rng.normal(size=ROWS), rng.normal(size=ROWS), 10.0 ** rng.uniform(-2, 1, ROWS) * (not rigid)
        tangents = np.cumsum([0] + [3 if isinstance(one, FrictionCone) else 1 for one in KINDS])[:-1]
        for i, one in zip(tangents, KINDS, strict=True):
            if isinstance(one, FrictionCone):
                r[i + 1] = r[i]
                if seed // 3 % 2:  # something that rigid contact can do
                    c[i + 2] = abs(c[i + 2]) + 2.5 * np.hypot(c[i], c[i + 1])
        weight = (1e5, 0.5, 1e-8)[seed % 3]  # the impulse stays near the guess; gets there slowly; at once
        solution = inverse_contact(
            c, r, None, guess, law, constraints=KINDS, max_iterations=max_iterations, proximal_weight=weight
        )
        statuses.add(solution.status)
        assert solution.velocity == pytest.approx(r * solution.impulse + c, rel=1e-14, abs=1e-15)
        expected = distances(KINDS, solution.impulse, solution.velocity, law)
        rounding = 1e-13 * np.abs(r * solution.impulse).max() + 1e-14
        assert solution.residual == pytest.approx(expected.max(), rel=1e-9, abs=rounding)
        assert expected[solution.worst] == pytest.approx(expected.max(), rel=1e-9, abs=rounding)
        bounds = [*tangents, ROWS]
        largest = max(np.linalg.norm(c[a:b]) for a, b in itertools.pairwise(bounds))
        assert solution.relative == pytest.approx(solution.residual / largest, rel=1e-12)
        assert solution.solved == (solution.relative <= 1e-6)
        assert solution.iterations <= max_iterations
    if rigid:
        assert "solved" not in statuses or max_iterations > 2
        assert statuses & {"infeasible", "max iterations"}
    elif max_iterations > 2:
        assert statuses == {"solved"}


@property_test
@given(c=vectors, mu=frictions, guess=vectors, law=st.sampled_from(LAWS))
def test_the_residual_of_a_contact_wherever_its_impulse_is(c, mu, guess, law):
    # At this weight it stays near the guess, which may be anywhere.
    solution = inverse_contact(c, None, mu, guess, law, max_iterations=1, proximal_weight=1e6)
    expected = cone_distance(mu, solution.impulse, corrected(mu, c, law))
    assert solution.residual == pytest.approx(expected, rel=1e-9, abs=1e-14 * np.abs(c).max())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("rigid", [slice(0, None), slice(0, 9), slice(0, 0)], ids=["all", "some", "none"])
def test_units_do_not_matter(rigid, law):
    speed, mass = 3e-4, 7e5  # a velocity of 1 m/s becomes 3e-4, an impulse of 1 N s 7e5
    unit = speed / mass
    for seed in range(10):
        c, r, mu, _ = plant(seed, law)
        guess = np.random.default_rng(seed).normal(size=c.size)
        r[rigid] = 0.0
        few = {"law": law, "max_iterations": 3}
        one = inverse_contact(c, r, mu, guess, proximal_weight=1e-3, **few)
        other = inverse_contact(speed * c, r * unit, mu, mass * guess, proximal_weight=1e-3 * unit, **few)
        assert other.status == one.status
        if one.relative > 1e-9:  # else it is rounding
            assert other.worst == one.worst
        assert other.relative == pytest.approx(one.relative, rel=1e-7, abs=1e-13)
        assert other.residual == pytest.approx(speed * one.residual, rel=1e-7, abs=1e-13 * speed)
        assert other.impulse == pytest.approx(mass * one.impulse, rel=1e-9, abs=1e-9 * mass)


@pytest.mark.parametrize("factor", [1e-160, 1e-200, 1e-300])
@pytest.mark.parametrize("r", [[0.1, 0.1, 0.1], [0.1, 0.1, 0.0], None])
@pytest.mark.parametrize("c", [[0.1, 0.0, -0.05], [0.1, 0.0, 0.0]])
def test_velocities_whose_squares_are_no_numbers(r, c, factor):
    guess = np.array([0.0, 0.0, 1.0])
    plain = inverse_contact(c, r, [0.5], guess)
    small = inverse_contact(factor * np.array(c), r, [0.5], factor * guess)
    assert small.status == plain.status
    assert small.relative == pytest.approx(plain.relative, abs=1e-9)
    np.testing.assert_allclose(small.impulse / factor, plain.impulse, rtol=1e-9, atol=1e-12)


def test_a_tolerance_is_kept_and_steps_are_counted():
    c, guess = [0.0, 0.0, 1e-3], [0.0, 0.0, 1.0]  # at this weight the impulse falls by 0.1 a step
    slow = {"proximal_weight": 1e-2, "impulse_guess": guess}
    cut = inverse_contact(c, None, 0.5, max_iterations=4, **slow)
    assert (cut.status, cut.iterations) == ("max iterations", 4)
    assert cut.impulse == pytest.approx([0.0, 0.0, 0.6])
    assert cut.residual == pytest.approx(1e-3)
    assert cut.relative == pytest.approx(1.0)
    done = inverse_contact(c, None, 0.5, **slow)
    assert done.solved
    assert done.iterations in (10, 11)
    loose = inverse_contact([0.0, 0.0, 1.0, 0.0, 0.0, 1e-3], None, 0.5, [*np.zeros(3), *guess], tolerance=2e-3)
    assert (loose.status, loose.iterations, loose.worst) == ("solved", 0, 1)
    assert loose.relative == pytest.approx(1e-3)


# Velocities that no impulse allows.


@pytest.mark.parametrize("mu", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("speed", [1e-3, 1.0, 30.0])
def test_the_relaxation_cannot_slide_without_lifting(speed, mu):
    for guess in (None, [0.0, 0.0, 1.0], [-mu, 0.0, 1.0]):
        c = np.array([speed, 0.0, 0.3 * mu * speed])
        solution = inverse_contact(c, None, mu, guess, "ccp")
        least = np.linalg.norm(project_cone([mu], -c[None])[0])  # to K*
        assert least == pytest.approx(0.7 * mu * speed / np.hypot(1.0, mu))
        assert solution.status == "infeasible"
        assert solution.residual == pytest.approx(least, rel=1e-6)
        soft = inverse_contact(c, [0.0, 0.0, 1e-4], mu, guess, "ccp", tolerance=1e-9)
        assert soft.solved
        assert soft.velocity[2] == pytest.approx(mu * speed)
        assert inverse_contact([speed, 0.0, mu * speed], None, mu, guess, "ccp").solved


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu", [0.0, 0.2, 1.0])
def test_what_is_rigid_cannot_be_run_into(mu, law):
    for slip, compliance in itertools.product((0.0, 0.4), (None, [1e-3, 1e-3, 0.0])):
        c = np.array([slip, 0.0, -0.3])
        solution = inverse_contact(c, compliance, mu, None, law)
        assert solution.status == "infeasible"
        assert not solution.solved
        # The velocity as it is, and with the De Saxce term.
        sigma = solution.velocity
        assert solution.residual >= 0.3 / np.hypot(1.0, mu) * (1.0 - 1e-9)
        assert solution.residual == pytest.approx(
            cone_distance(mu, solution.impulse, corrected(mu, sigma, law)), rel=1e-9
        )
        if slip == 0.0:
            assert solution.residual == pytest.approx(0.3)
        assert inverse_contact(c, [1e-3] * 3, mu, None, law).solved
        assert inverse_contact(c, [0.0, 0.0, 1e-3], mu, None, law).solved


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu", [0.2, 1.0, 3.0])
def test_a_normal_that_points_the_wrong_way_is_none(mu, law):
    # On the border of the cone, the velocity along its normal, but against what would push there.
    s = np.array([1.0, 0.0, -mu])
    c = s - [0.0, 0.0, mu if law == "ncp" else 0.0]
    solution = inverse_contact(c, None, mu, [mu, 0.0, 1.0], law)
    assert solution.status == "infeasible"
    assert solution.residual == pytest.approx(cone_distance(mu, solution.impulse, s), rel=1e-9)
    assert inverse_contact(c, pair(1e-2, 1e-2), mu, [mu, 0.0, 1.0], law).solved


@pytest.mark.parametrize(
    ("constraint", "c"),
    [
        (HalfLine(), -0.2),
        (Equality(), 0.2),
        (Equality(), -0.2),
        (Interval(-np.inf, 1.0), 0.2),
        (Interval(-1.0, np.inf), -0.2),
        (Interval(-np.inf, np.inf), 0.2),
    ],
)
def test_lines_without_an_answer(constraint, c):
    rest = [FrictionCone(0.5), Interval(-1.0, 1.0)]  # these have one
    velocity = [0.5, 0.0, 0.1, 5.0, c]
    solution = inverse_contact(velocity, constraints=[*rest, constraint])
    assert solution.status == "infeasible"
    assert solution.residual == pytest.approx(0.2)
    assert solution.relative == pytest.approx(0.04)
    assert solution.worst == 2
    soft = inverse_contact(velocity, [0.0, 0.0, 0.0, 0.0, 1e-2], constraints=[*rest, constraint])
    assert soft.solved
    assert soft.velocity[4] == pytest.approx(0.0, abs=1e-12)
    assert soft.impulse[4] == pytest.approx(-c / 1e-2)


# There and back.


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(8))
def test_forward_then_inverse(seed, law):
    rng = np.random.default_rng(seed)
    n = 5
    a = rng.normal(size=(3 * n, 3 * n + 4))
    delassus, g, mu = a @ a.T / 10.0, rng.normal(size=3 * n) * 2.0, rng.uniform(0.1, 1.0, n)
    r = (10.0 ** rng.uniform(-2, 0, (n, 2)) @ [[1, 1, 0], [0, 0, 1]]).ravel()
    problem = ContactProblem(delassus, g, mu, r)
    there = signorini.solve(problem, law=law, tolerance=1e-12)
    assert there.solved
    back = inverse_contact(delassus @ there.impulse + g, r, mu, law=law)
    assert back.solved
    assert back.impulse == pytest.approx(there.impulse, rel=1e-8, abs=1e-8 * np.abs(there.impulse).max())
    assert signorini.residual(problem, back.impulse, law).relative < 1e-8


# Repetition, and what is refused.


def test_same_input_same_bits():
    c, r, mu, _ = plant(1, "ncp")
    first = inverse_contact(c, 0.0 * r, mu, np.ones(c.size))
    inverse_contact(c[:3], r[:3], mu[:1])
    again = inverse_contact(c, 0.0 * r, mu, np.ones(c.size))
    assert again.impulse.tobytes() == first.impulse.tobytes()
    assert again.residual == first.residual


@pytest.mark.parametrize("given", [{"friction": []}, {"friction": 0.5}, {"constraints": []}])
def test_nothing_to_do(given):
    solution = inverse_contact([], **given)
    assert solution.solved
    assert solution.impulse.shape == solution.velocity.shape == (0,)
    assert (solution.residual, solution.relative, solution.worst, solution.iterations) == (0.0, 0.0, -1, 0)


def test_friction_may_be_one_number_for_all():
    c = [0.3, 0.4, -0.1] * 2
    assert (
        inverse_contact(c, [0.0, 0.0, 1e-3] * 2, 0.5).impulse
        == inverse_contact(c, [0.0, 0.0, 1e-3] * 2, [0.5, 0.5]).impulse
    ).all()
    for one in (np.float64(0.5), np.array(0.5)):
        assert inverse_contact(c, [0.0, 0.0, 1e-3] * 2, one).solved


def with_entry(value, at):
    x = np.full(6, 0.1)
    x[at] = value
    return x


BAD = {
    "velocity not three a contact": ({"contact_velocity": np.zeros(5)}, r"contact_velocity.*5"),
    "velocity a matrix": ({"contact_velocity": np.zeros((2, 3))}, r"contact_velocity.*\(2, 3\)"),
    "velocity of text": ({"contact_velocity": "fast"}, "contact_velocity"),
    "velocity complex": ({"contact_velocity": np.zeros(6) * 1j}, "contact_velocity.*complex"),
    "velocity none": ({"contact_velocity": None}, "contact_velocity"),
    "velocity nan": ({"contact_velocity": with_entry(np.nan, 4)}, r"velocity\[4\].*nan"),
    "velocity inf": ({"contact_velocity": with_entry(-np.inf, 0)}, r"velocity\[0\].*-inf"),
    "velocity 1e300": ({"contact_velocity": with_entry(1e300, 2)}, r"velocity\[2\].*1e\+300"),
    "compliance short": ({"compliance": np.zeros(2)}, r"compliance.*2.*6"),
    "compliance nan": ({"compliance": with_entry(np.nan, 4)}, r"compliance\[4\].*nan"),
    "compliance inf": ({"compliance": with_entry(np.inf, 5)}, r"compliance\[5\].*inf"),
    "compliance 1e300": ({"compliance": with_entry(1e300, 5)}, r"compliance\[5\].*1e\+300"),
    "compliance negative": ({"compliance": with_entry(-1e-3, 2)}, r"compliance\[2\].*-0\.001"),
    "tangents unequal": ({"compliance": with_entry(0.2, 4)}, r"compliance\[4\].*0\.2.*tangent"),
    "one tangent rigid": ({"compliance": with_entry(0.0, 3)}, r"compliance\[4\].*0\.1.*tangent"),
    "friction negative": ({"friction": [0.5, -0.1]}, r"friction.*-0\.1"),
    "one negative friction": ({"friction": -0.1}, r"friction.*-0\.1"),
    "friction nan": ({"friction": [np.nan, 0.5]}, r"friction.*nan"),
    "friction inf": ({"friction": [np.inf, 0.5]}, r"friction.*inf"),
    "friction of every row": ({"friction": np.ones(6)}, r"friction.*6.*2"),
    "friction of text": ({"friction": "steel"}, "friction"),
    "friction a bool": ({"friction": True}, "friction"),
    "neither": ({"friction": None}, "friction.*neither"),
    "both": ({"constraints": [FrictionCone(0.5)] * 2}, "friction.*both"),
    "too few rows": ({"friction": None, "constraints": [FrictionCone(0.5)]}, "constraints.*3 rows.*6"),
    "not constraints": ({"friction": None, "constraints": [1, 2]}, r"constraints\[0\]"),
    "no sequence": ({"friction": None, "constraints": 3}, "constraints"),
    "cone negative": ({"friction": None, "constraints": [FrictionCone(-1.0)] * 2}, "friction.*-1"),
    "interval upside down": ({"friction": None, "constraints": [Interval(1.0, 0.0)] * 6}, "(?i)lower|interval"),
    "guess short": ({"impulse_guess": np.zeros(5)}, r"guess.*5.*6"),
    "guess a matrix": ({"impulse_guess": np.zeros((2, 3))}, r"guess.*\(2, 3\)"),
    "guess nan": ({"impulse_guess": with_entry(np.nan, 1)}, r"guess\[1\].*nan"),
    "guess 1e300": ({"impulse_guess": with_entry(1e300, 1)}, r"guess\[1\].*1e\+300"),
    "law": ({"law": "lcp"}, "law.*lcp.*ncp"),
    "law of another type": ({"law": 3}, "law.*3"),
    "tolerance zero": ({"tolerance": 0.0}, "tolerance.*0"),
    "tolerance one": ({"tolerance": 1.0}, "tolerance.*1"),
    "tolerance nan": ({"tolerance": np.nan}, "tolerance.*nan"),
    "tolerance text": ({"tolerance": "small"}, "tolerance.*small"),
    "weight zero": ({"proximal_weight": 0.0}, "proximal_weight.*0"),
    "weight negative": ({"proximal_weight": -1e-8}, "proximal_weight.*-1e-08"),
    "weight large": ({"proximal_weight": 1e7}, r"proximal_weight.*1e\+07"),
    "weight nan": ({"proximal_weight": np.nan}, "proximal_weight.*nan"),
    "weight none": ({"proximal_weight": None}, "proximal_weight.*None"),
    "no iterations": ({"max_iterations": 0}, "max_iterations.*0"),
    "half an iteration": ({"max_iterations": 1.5}, r"max_iterations.*1\.5"),
    "many iterations": ({"max_iterations": 2**31}, "max_iterations"),
    "bool iterations": ({"max_iterations": True}, "max_iterations"),
}


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD.keys())
def test_inverse_contact_refuses(changes, message):
    good = {"contact_velocity": np.full(6, 0.1), "compliance": np.full(6, 0.1), "friction": [0.5, 0.5]}
    assert inverse_contact(**good).solved
    with pytest.raises(InvalidInputError, match=message) as caught:
        inverse_contact(**(good | changes))
    assert isinstance(caught.value, ValueError)


@given(
    c=st.lists(st.floats(-1e100, 1e100), min_size=3, max_size=3),
    guess=st.lists(st.floats(-1e100, 1e100), min_size=3, max_size=3),
    d=st.tuples(st.floats(0.0, 1e100), st.floats(0.0, 1e100)),
    mu=st.floats(0.0, 1e6),
    law=st.sampled_from(LAWS),
)
@example(c=[0.0, 0.0, -1e99], guess=[0.0] * 3, d=(1e-300, 1e-300), mu=0.5, law="ncp")  # 1e399 N s
@example(c=[1e99, 0.0, 0.0], guess=[0.0] * 3, d=(0.0, 0.0), mu=0.5, law="ccp")
@settings(max_examples=200, deadline=None, derandomize=True)
def test_any_number_has_a_status_and_solved_is_only_said_of_what_is(c, guess, d, mu, law):
    solution = inverse_contact(c, pair(*d), mu, guess, law)
    assert solution.status in {"solved", "infeasible", "max iterations", "invalid"}
    if solution.solved:
        assert np.isfinite(solution.impulse).all()
        assert solution.relative <= 1e-6
        x = solution.impulse
        assert np.hypot(*x[:2]) <= mu * x[2] * (1.0 + 1e-9)


def test_an_impulse_just_off_the_border_is_put_there_and_not_moved_far():
    slope = np.array([0.6, -0.8])
    for law, normal in (("ncp", 1e-9), ("ccp", 0.5 * 3.0 + 1e-9)):  # slides at 3 m/s; rounding in the normal velocity
        c = np.array([*(-3.0 * slope), normal])
        guess = np.array([*(0.5 * (1 - 1e-6) * slope), 1.0])
        solution = inverse_contact(c, None, [0.5], guess, law)
        assert solution.solved
        np.testing.assert_allclose(solution.impulse, [*(0.5 * slope), 1.0], atol=2e-6)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
def test_without_a_solution_the_impulse_stays_near_the_guess(law):
    solution = inverse_contact([0.1, 0.0, -0.05], None, [0.5], [0.0, 0.0, 1.0], law)
    assert solution.status == "infeasible"
    assert np.abs(solution.impulse).max() < 2.0
