import numpy as np
import pytest

import signorini
from signorini import ContactProblem, Equality, FrictionCone, InvalidInputError, peers, scenes
from signorini.experiments._runs import record, solves
from signorini.peers import scs, siconos
from signorini.peers._common import judged

TOLERANCE = 1e-6


@pytest.fixture(params=[peer.name for peer in peers.PEERS])
def peer(request):
    entry = peers.named(request.param)
    try:
        entry.version()
    except peers.PeerUnavailableError as error:
        pytest.skip(str(error))
    return entry


def point_masses(free_velocity, friction, mass=2.0):
    """Contacts that do not know of each other, each on a mass of its own: solved by hand."""
    g = np.asarray(free_velocity, dtype=float).ravel()
    return ContactProblem(np.eye(len(g)) / mass, g, np.asarray(friction, dtype=float))


# Sticking, sliding, separating: with m = 2 kg and mu = 1/2.
FREE = [[0.01, 0.0, -0.1], [1.0, 0.0, -0.1], [0.1, 0.2, 0.3]]
NCP = [[-0.02, 0.0, 0.2], [-0.1, 0.0, 0.2], [0.0, 0.0, 0.0]]
CCP = [[-0.02, 0.0, 0.2], [-0.48, 0.0, 0.96], [0.0, 0.0, 0.0]]  # sliding lifts: the projection of -m g on the cone


@pytest.mark.parametrize(("law", "expected"), [("ncp", NCP), ("ccp", CCP)])
def test_closed_form(peer, law, expected):
    if law not in peer.laws:
        pytest.skip(f"{peer.name} does not solve the {law}")
    solution = peer.solve(point_masses(FREE, [0.5] * 3), law=law, tolerance=TOLERANCE)
    assert solution.status == "solved"
    assert solution.solved
    assert solution.residual.relative <= TOLERANCE
    np.testing.assert_allclose(solution.impulse.reshape(-1, 3), expected, atol=1e-5)
    assert solution.seconds >= 0.0


def test_friction_of_zero(peer):
    if peer.name == "pinocchio-pgs":
        pytest.skip("Pinocchio's PGS claims success at once when all friction is 0 (seen in 4.1.0)")
    problem = point_masses(FREE, [0.5, 0.0, 0.0])
    solution = peer.solve(problem, tolerance=TOLERANCE)
    if peer.name == "siconos-nsn-fb":
        assert solution.solved == (solution.residual.relative <= TOLERANCE)  # it may fail, it may not pretend
        return
    assert solution.solved
    np.testing.assert_allclose(solution.impulse[3:6], [0.0, 0.0, 0.2], atol=1e-5)


def test_compliance(peer):
    rigid = point_masses(FREE, [0.5] * 3)
    soft = ContactProblem(rigid.delassus, rigid.free_velocity, rigid.friction, np.full(9, 0.5))
    solution = peer.solve(soft, tolerance=TOLERANCE)
    assert solution.solved
    np.testing.assert_allclose(solution.impulse.reshape(-1, 3), 0.5 * np.array(NCP), atol=1e-5)  # G + R = 2 G


def test_the_certificate_is_ours(peer):
    problem = scenes.chain(6, 2)
    solution = peer.solve(problem, tolerance=TOLERANCE)
    again = signorini.residual(problem, solution.impulse)
    assert solution.residual == again
    assert solution.solved == (again.relative <= TOLERANCE)
    assert solution.impulse.shape == (problem.size,)


def test_limits_are_kept(peer):
    solution = peer.solve(scenes.cube_stack(4, 1e4, 0.5), tolerance=1e-10, max_iterations=2)
    assert not solution.solved
    assert solution.status in ("max iterations", "stalled", "crashed")


def test_what_a_peer_does_not_take_is_refused(peer):
    problem = ContactProblem(np.eye(4), np.zeros(4), constraints=[FrictionCone(0.5), Equality()])
    with pytest.raises(InvalidInputError, match="friction cones"):
        peer.solve(problem)
    with pytest.raises(InvalidInputError, match="no contacts"):  # Clarabel panics, Pinocchio ends the process
        peer.solve(ContactProblem(np.zeros((0, 0)), [], []))
    with pytest.raises(InvalidInputError, match="law"):
        peer.solve(point_masses(FREE, [0.5] * 3), law="lcp")
    for tolerance in (np.nan, 0.0, -1e-6, 1.0, "a", True):
        with pytest.raises(InvalidInputError, match="tolerance"):
            peer.solve(point_masses(FREE, [0.5] * 3), tolerance=tolerance)
    for count in (0, -1, 2**31, 10.0, True, "a"):
        with pytest.raises(InvalidInputError, match="max_iterations"):
            peer.solve(point_masses(FREE, [0.5] * 3), max_iterations=count)
    with pytest.raises(InvalidInputError, match="problem: is a ndarray"):
        peer.solve(np.eye(3))


def test_scs_alone_refuses_the_same_limits():
    pytest.importorskip("scs")
    for limits, field in (((0.0, 10), "tolerance"), ((1e-6, 0), "max_iterations")):
        with pytest.raises(InvalidInputError, match=field):
            scs.solve_ccp(point_masses(FREE, [0.5] * 3), *limits)


def test_a_wrong_claim_is_not_believed():
    problem = point_masses(FREE, [0.5] * 3)
    solution = judged(
        "someone", problem, np.zeros(9), "ncp", 1e-6, claimed=True, iterations=1, seconds=0.0, limited=False
    )
    assert solution.claimed
    assert not solution.solved
    assert solution.status == "stalled"
    nothing = judged(
        "someone", problem, np.full(9, np.nan), "ncp", 1e-6, claimed=True, iterations=1, seconds=0.0, limited=True
    )
    assert nothing.status == "max iterations"
    np.testing.assert_array_equal(nothing.impulse, 0.0)


def test_impulses_that_grow_without_bound_are_not_believed(peer):
    # No impulse moves the second contact, which closes: nothing solves this.
    problem = ContactProblem(np.diag([1.0, 1, 1, 0, 0, 0]), [0.0, 0, -1, 0, 0, -1], [0.5, 0.5])
    huge = np.array([0.0, 0, 1, 0, 0, 1e12])
    options = {"iterations": 1, "seconds": 0.0, "limited": False}
    answer = judged("someone", problem, huge, "ncp", 1e-6, claimed=True, **options)
    assert answer.residual.relative <= 1e-6
    assert answer.status == "stalled"
    assert not solves(record(answer), 1e-6)
    assert not peer.solve(problem, tolerance=1e-6, max_iterations=100).solved


def test_names():
    assert len({peer.name for peer in peers.PEERS}) == len(peers.PEERS)
    assert set(peers.available()) <= set(peers.PEERS)
    with pytest.raises(KeyError, match="bullet"):
        peers.named("bullet")


@pytest.fixture
def with_siconos():
    try:
        siconos.version()
    except peers.PeerUnavailableError as error:
        pytest.skip(str(error))


def test_siconos_is_killed_when_it_takes_too_long(with_siconos):
    problem = scenes.cube_stack(15, 1e4, 0.5)
    late = siconos.solve(problem, tolerance=1e-12, max_iterations=10**8, method="nsgs", timeout=0.5)
    assert late.status == "timeout"
    assert not late.solved
    np.testing.assert_array_equal(late.impulse, 0.0)
    after = siconos.solve(point_masses(FREE, [0.5] * 3), method="nsgs")  # the next one has a new process
    assert after.solved


def test_siconos_absent(monkeypatch):
    siconos._worker.cache_clear()
    monkeypatch.setenv("SIGNORINI_SICONOS_PYTHON", "no-such-python")
    try:
        with pytest.raises(peers.PeerUnavailableError, match="no-such-python"):
            siconos.version()
        assert not [peer for peer in peers.available() if peer.name.startswith("siconos")]
    finally:
        siconos._worker.cache_clear()


def test_siconos_refuses_other_methods(with_siconos):
    with pytest.raises(InvalidInputError, match="method"):
        siconos.solve(point_masses(FREE, [0.5] * 3), method="path")
    with pytest.raises(InvalidInputError, match="ncp"):
        siconos.solve(point_masses(FREE, [0.5] * 3), law="ccp")


def test_a_law_that_a_peer_does_not_know(peer):
    if "ccp" in peer.laws:
        pytest.skip(f"{peer.name} solves both laws")
    with pytest.raises(InvalidInputError, match="ncp"):
        peer.solve(point_masses(FREE, [0.5] * 3), law="ccp")
