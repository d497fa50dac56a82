"""Every public entry refuses what it cannot take, with the field and the value in the message."""

import numpy as np
import pytest
import scipy.sparse as sp

import signorini
from signorini import ContactProblem, Equality, FrictionCone, HalfLine, Interval, InvalidInputError


def build(**changes):
    arguments = {"delassus": np.eye(6), "free_velocity": np.zeros(6), "friction": np.full(2, 0.5)} | changes
    return ContactProblem(**arguments)


def with_entry(value, shape, at=0):
    a = np.eye(6) if shape == 2 else np.zeros(6)
    a.flat[at] = value
    return a


def damaged(**parts):
    """A csc_array of the identity with its arrays overwritten behind scipy's back."""
    a = sp.csc_array(np.eye(6))
    for name, values in parts.items():
        setattr(a, name, np.asarray(values))
    return a


def damaged_coo(**parts):
    a = sp.coo_matrix(np.eye(6))
    for name, at in parts.items():
        getattr(a, name)[2] = at
    return a


def damaged_lil(columns):
    a = sp.lil_array(np.eye(6))
    a.rows[2] = columns
    return a


BAD = {
    # shapes
    "not square": ({"delassus": np.ones((6, 5))}, "delassus"),
    "one dimension": ({"delassus": np.ones(36)}, "delassus"),
    "three dimensions": ({"delassus": np.ones((6, 6, 1))}, "delassus"),
    "a number": ({"delassus": 3.0}, "delassus"),
    "rows not three a contact": ({"delassus": np.eye(7), "free_velocity": np.zeros(7)}, "delassus"),
    "sparse not square": ({"delassus": sp.csc_array(np.ones((6, 5)))}, "delassus"),
    "sparse of one dimension": ({"delassus": sp.coo_array(np.ones(6))}, "delassus"),
    "free velocity short": ({"free_velocity": np.zeros(5)}, "free_velocity"),
    "free velocity a column": ({"free_velocity": np.zeros((6, 1))}, "free_velocity"),
    "friction of wrong size": ({"friction": np.ones(3)}, "friction"),
    "friction of every row": ({"friction": np.ones(6)}, "friction"),
    "compliance of wrong size": ({"compliance": np.zeros(2)}, "compliance"),
    # types
    "complex": ({"delassus": np.eye(6) * 1j}, "delassus"),
    "objects": ({"free_velocity": np.array([None] * 6)}, "free_velocity"),
    "text": ({"friction": ["a", "b"]}, "friction"),
    "booleans": ({"friction": [True, False]}, "friction"),
    "ragged": ({"delassus": [[1.0], [1.0, 2.0]]}, "delassus"),
    "ragged vector": ({"free_velocity": [[1.0], 2.0]}, "free_velocity"),
    "huge integer": ({"free_velocity": [10**400] * 6}, "free_velocity"),
    "none": ({"delassus": None}, "delassus"),
    "masked": ({"delassus": np.ma.array(np.eye(6), mask=np.eye(6))}, "delassus.*masked"),
    "masked vector": ({"free_velocity": np.ma.array(np.zeros(6), mask=[0, 0, 1, 0, 0, 0])}, "free_velocity.*masked"),
    "sparse complex": ({"delassus": sp.csc_array(np.eye(6) * 1j)}, "delassus"),
    # values
    "nan in G": ({"delassus": with_entry(np.nan, 2, 1)}, "delassus"),
    "inf in G": ({"delassus": with_entry(np.inf, 2, 1)}, "delassus"),
    "nan in sparse G": ({"delassus": sp.csc_array(with_entry(np.nan, 2, 1))}, "delassus"),
    "1e300 in G": ({"delassus": with_entry(1e300, 2, 0)}, "delassus"),
    "1e300 off the diagonal": ({"delassus": with_entry(1e300, 2, 1)}, "delassus"),
    "nan in g": ({"free_velocity": with_entry(np.nan, 1)}, r"free_velocity\[0\].*nan"),
    "inf in g": ({"free_velocity": with_entry(-np.inf, 1, 3)}, r"free_velocity\[3\].*-inf"),
    "1e300 in g": ({"free_velocity": with_entry(1e300, 1, 2)}, r"free_velocity\[2\].*1e\+300"),
    "negative friction": ({"friction": [0.5, -0.1]}, r"friction.*1.*-0\.1"),
    "slightly negative friction": ({"friction": [0.5, -1e-9]}, r"friction\[1\]: is -1e-09, must be in \[0, 1e6\]"),
    "1e300 for friction": ({"friction": [1e300, 0.5]}, r"friction\[0\]: is 1e\+300, must be"),
    "nan friction": ({"friction": [np.nan, 0.1]}, "friction.*nan"),
    "infinite friction": ({"friction": [0.5, np.inf]}, "friction.*inf"),
    "negative compliance": ({"compliance": with_entry(-1e-3, 1, 4)}, r"compliance\[4\].*-0\.001"),
    "nan compliance": ({"compliance": with_entry(np.nan, 1, 4)}, r"compliance\[4\].*nan"),
    "negative diagonal": ({"delassus": -np.eye(6)}, "delassus"),
    "indefinite": ({"delassus": np.eye(6) + np.kron(np.eye(2), 2 * (np.ones((3, 3)) - np.eye(3)))}, "delassus"),
    "indefinite and unsymmetric": (
        {"delassus": np.eye(6) + 1.8 * np.eye(6, k=3) + 1.2 * np.eye(6, k=-3)},
        "delassus.*semidefinite",
    ),
    "indefinite, sparse": (
        {"delassus": sp.csc_array(np.kron(np.eye(2), np.ones((3, 3)) * -2 + 3 * np.eye(3)))},
        "delassus",
    ),
    # damaged sparse matrices
    "index out of range": ({"delassus": damaged(indices=[0, 1, 2, 3, 4, 99])}, "delassus"),
    "negative index": ({"delassus": damaged(indices=[0, 1, 2, 3, 4, -1])}, "delassus"),
    "pointers beyond the data": ({"delassus": damaged(indptr=[0, 1, 2, 3, 4, 5, 600])}, "delassus"),
    "decreasing pointers": ({"delassus": damaged(indptr=[0, 5, 2, 3, 4, 5, 6])}, "delassus"),
    "coo row out of range": ({"delassus": damaged_coo(row=10**7)}, "delassus.*damaged.*row"),
    "coo negative column": ({"delassus": damaged_coo(col=-1)}, "delassus.*damaged.*column"),
    "lil column out of range": ({"delassus": damaged_lil([10**7])}, "delassus.*damaged.*column"),
    "lil row longer than its data": ({"delassus": damaged_lil([0, 1])}, "delassus.*damaged.*lengths"),
    "too few pointers": ({"delassus": damaged(indptr=[0, 1, 6])}, "delassus"),
    # constraints
    "both": ({"constraints": [FrictionCone(0.5)] * 2}, "friction.*both"),
    "neither": ({"friction": None}, "friction.*neither"),
    "too few rows": ({"friction": None, "constraints": [FrictionCone(0.5)]}, "constraints.*3 rows.*6"),
    "not constraints": ({"friction": None, "constraints": [1, 2]}, r"constraints\[0\]"),
    "the class itself": ({"friction": None, "constraints": [Equality] * 6}, r"constraints\[0\]"),
    "text for constraints": ({"friction": None, "constraints": "abcdef"}, "constraints"),
    "not a sequence": ({"friction": None, "constraints": 3}, "constraints"),
    "negative cone": ({"friction": None, "constraints": [FrictionCone(-1.0), FrictionCone(1.0)]}, "friction.*-1"),
    "cone of text": ({"friction": None, "constraints": [FrictionCone("x")] * 2}, r"constraints\[0\]\.friction"),
    "interval upside down": (
        {"friction": None, "constraints": [HalfLine()] * 5 + [Interval(1e-9, 0.0)]},
        r"constraints\[5\]: is the interval \[1e-09, 0\], must have lower <= upper",
    ),
    "interval of nan": ({"friction": None, "constraints": [Interval(np.nan, 0.0)] * 6}, r"constraints\[0\].*nan"),
}


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD.keys())
def test_problem_refuses(changes, message):
    with pytest.raises(InvalidInputError, match=message) as caught:
        build(**changes)
    assert isinstance(caught.value, ValueError)


MASS_BAD = {
    "mass not square": ({"mass": np.ones((4, 3))}, "mass"),
    "mass of another size": ({"mass": np.eye(5)}, "jacobian"),
    "mass singular": ({"mass": np.diag([1.0, 1, 1, 0])}, "mass"),
    "mass negative": ({"mass": -np.eye(4)}, "mass"),
    "mass of one triangle": ({"mass": np.tri(4) + 4 * np.eye(4)}, r"mass: has M\[1, 0\] = 1"),
    "mass unsymmetric where it is small": (
        {"mass": [[1e6, 0, 0, 0], [0, 1, 0.5, 0], [0, -0.3, 1, 0], [0, 0, 0, 1]]},
        r"M\[1, 2\] = 0.5 and M\[2, 1\] = -0.3|M\[2, 1\] = -0.3 and M\[1, 2\] = 0.5",
    ),
    "mass unsymmetric": ({"mass": 9 * np.eye(4) + np.arange(16).reshape(4, 4)}, r"mass: has M\["),
    "mass singular but for rounding": (
        {"mass": np.ones((4, 4)) + 1e-16 * np.diag([1.0, 2, 3, 4]) + 2e-16 * np.eye(4)},
        "mass",
    ),
    "mass nearly singular": ({"mass": np.kron(np.eye(2), [[1.0, 1.0], [1.0, 1.0 + 4e-16]])}, "reciprocal condition"),
    "mass nan": ({"mass": np.diag([1.0, 1, 1, np.nan])}, "mass"),
    "jacobian inf": ({"jacobian": np.full((3, 4), np.inf)}, "jacobian"),
    "jacobian of text": ({"jacobian": [["a"] * 4] * 3}, "jacobian"),
    "jacobian ragged": ({"jacobian": [[1.0], [1.0, 2.0]]}, "jacobian"),
    "friction": ({"friction": [-1.0]}, "friction"),
    "free velocity": ({"free_velocity": np.zeros(4)}, "free_velocity"),
}


@pytest.mark.parametrize(("changes", "message"), MASS_BAD.values(), ids=MASS_BAD.keys())
def test_from_mass_refuses(changes, message):
    good = {"mass": np.eye(4), "jacobian": np.ones((3, 4)), "free_velocity": np.zeros(3), "friction": [0.5]}
    ContactProblem.from_mass(**good)
    with pytest.raises(InvalidInputError, match=message):
        ContactProblem.from_mass(**(good | changes))


SOLVE_BAD = {
    "solver": ({"solver": "lemke"}, "solver.*lemke.*interior-point"),
    "solver of another type": ({"solver": 3}, "solver"),
    "law": ({"law": "lcp"}, "law.*lcp.*ncp"),
    "tolerance zero": ({"tolerance": 0.0}, "tolerance"),
    "tolerance one": ({"tolerance": 1.0}, "tolerance"),
    "tolerance negative": ({"tolerance": -1e-6}, "tolerance"),
    "tolerance nan": ({"tolerance": np.nan}, "tolerance"),
    "tolerance text": ({"tolerance": "small"}, "tolerance"),
    "tolerance an array": ({"tolerance": np.array([1e-6])}, "tolerance"),
    "no iterations": ({"max_iterations": 0}, "max_iterations"),
    "negative iterations": ({"max_iterations": -1}, "max_iterations"),
    "half an iteration": ({"max_iterations": 1.5}, "max_iterations"),
    "too many iterations": ({"max_iterations": 2**31}, "max_iterations"),
    "penalty rule": ({"penalty_rule": "magic"}, "penalty_rule.*magic.*spectral"),
    "penalty": ({"penalty": -1.0}, "penalty"),
    "penalty zero": ({"penalty": 0.0}, "penalty"),
    "penalty nan": ({"penalty": np.nan}, "penalty"),
    "proximal weight": ({"proximal_weight": -1.0}, "proximal_weight"),
    "proximal weight nan": ({"proximal_weight": np.nan}, "proximal_weight"),
    "linear factor": ({"linear_factor": 0.5}, "linear_factor"),
    "ratio": ({"ratio": 0.0}, "ratio"),
    "exponent": ({"spectral_exponent": np.inf}, "spectral_exponent"),
    "increment": ({"spectral_increment": -0.1}, "spectral_increment"),
    "anderson": ({"anderson_memory": -1}, r"anderson_memory.*\[0, 50\]"),
    "facets": ({"facets": 3}, r"facets.*\[4, 64\]"),
    "facets, odd": ({"facets": 5}, r"facets.*\[4, 64\]"),
    "paper tolerance": ({"paper_tolerance": -1.0}, "paper_tolerance"),
    "over-relaxation": ({"over_relaxation": 2.0}, "over_relaxation"),
    "over-relaxation nan": ({"over_relaxation": np.nan}, "over_relaxation"),
    "guess of another size": ({"guess": np.zeros(5)}, "guess.*5.*6"),
    "guess nan": ({"guess": np.full(6, np.nan)}, "guess"),
    "guess 1e300": ({"guess": np.full(6, 1e300)}, "guess"),
    "guess text": ({"guess": "zero"}, "guess"),
    "workspace": ({"workspace": 3}, "workspace"),
}


@pytest.mark.parametrize(("changes", "message"), SOLVE_BAD.values(), ids=SOLVE_BAD.keys())
def test_solve_refuses(changes, message):
    with pytest.raises(InvalidInputError, match=message):
        signorini.solve(build(), **changes)


def test_problem_argument_must_be_a_problem():
    with pytest.raises(InvalidInputError, match=r"problem.*ndarray"):
        signorini.solve(np.eye(3))
    with pytest.raises(InvalidInputError, match=r"problem.*int"):
        signorini.residual(3, np.zeros(3))


@pytest.mark.parametrize("impulse", [np.zeros(5), np.zeros((6, 1)), "x", [1j] * 6, None])
def test_residual_refuses(impulse):
    with pytest.raises(InvalidInputError, match="impulse"):
        signorini.residual(build(), impulse)
    with pytest.raises(InvalidInputError, match="law"):
        signorini.residual(build(), np.zeros(6), "lcp")


def test_unchecked_indefinite_problem_is_a_status_or_an_answer():
    problem = build(
        delassus=np.eye(6) - 0.9 * np.ones((6, 6)) + np.diag([0.5] * 6), free_velocity=-np.ones(6), check=False
    )
    solution = signorini.solve(problem, max_iterations=200)
    assert solution.status in {"solved", "max iterations", "stalled", "invalid"}
    assert np.isfinite(solution.impulse).all()
    assert solution.solved == (signorini.residual(problem, solution.impulse).relative <= 1e-6)


@pytest.mark.parametrize("value", [1e6 + 1e-3, 1e6 + 1, 16777217.0, 1e8 / 3.0, np.nextafter(1e6, 2e6), -1.0 / 3.0])
def test_a_value_that_is_refused_is_said_in_full(value):
    with pytest.raises(InvalidInputError) as refused:
        build(friction=[0.5, value])
    assert float(str(refused.value).split("is ")[1].split(",")[0]) == value


def test_a_value_just_outside_is_not_said_to_be_the_limit():
    for name, value in (("tolerance", 1.0 + 1e-9), ("over_relaxation", 2.0 + 1e-9), ("linear_factor", 1.0 - 1e-9)):
        with pytest.raises(InvalidInputError, match=rf"^{name}: is {value!r}, must be "):
            signorini.solve(build(), **{name: value})


@pytest.mark.parametrize(
    ("field", "right", "wrong"),
    [("max_iterations", 1, True), ("facets", 4, 4.0), ("anderson_memory", 0, False), ("penalty", 1.0, True)],
)
def test_arguments_seen_before_do_not_let_pass_what_equals_them(field, right, wrong):
    for _ in range(2):
        signorini.solve(build(), **{field: right})
        with pytest.raises(InvalidInputError, match=rf"^{field}: is {wrong!r}, must be "):
            signorini.solve(build(), **{field: wrong})
    for unhashable in ([right], {}, np.ones(2)):
        with pytest.raises(InvalidInputError, match=rf"^{field}: is "):
            signorini.solve(build(), **{field: unhashable})
