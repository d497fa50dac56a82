"""Worlds that come ready made: the same ones for the same seed, and what they say they are."""

import inspect
import math

import numpy as np
import pytest

import signorini
from signorini import InvalidInputError
from signorini.scenes import worlds

BUILT_IN = ("cube-stack", "cube-wall", "spheres", "boxes", "capsules-box", "chain", "cable")
ROBOTS = ("cassie", "humanoid", "solo-terrain", "talos-fall", "talos-wall", "ur5", "ur5-wall", "allegro-cubes")


def started(name, **options):
    try:
        return worlds()[name](**options)
    except FileNotFoundError as error:
        pytest.skip(str(error))


def test_registry():
    assert set(worlds()) == {*BUILT_IN, *ROBOTS}
    for name, scene in worlds().items():
        assert scene.name == name
        assert scene.description
        assert scene.source
        assert scene.duration > 0


@pytest.mark.parametrize("name", [*BUILT_IN, *ROBOTS])
def test_a_scene_starts_within_its_limits_and_apart(name):
    world, q, v = started(name)
    assert q.shape == (world.num_q,)
    assert v.shape == (world.num_v,)
    assert np.isfinite(q).all()
    for joint in world.joints:
        if joint.num_q == 1:
            assert joint.lower <= q[joint.q_index] <= joint.upper
    for a, b, distance in world.touching_pairs(q, 0.0):
        assert distance > -1e-9, (world.geometry_names[a], world.geometry_names[b])


def test_cube_stack():
    world, q, v = started("cube-stack", slip=0.3)
    masses = [body.mass for body in world.bodies[1:]]
    np.testing.assert_allclose(masses, np.geomspace(1.0, 1e4, 15))
    np.testing.assert_allclose(q.reshape(15, 7)[:, 2], 0.2 * (np.arange(15) + 0.5))
    np.testing.assert_allclose(np.diff(v.reshape(15, 6)[:, 0])[-1], 0.3)
    pairs = world.touching_pairs(q, 1e-6)
    assert len(pairs) == 15
    np.testing.assert_allclose([distance for _, _, distance in pairs], 0.0, atol=1e-12)
    offsets = np.diff(started("cube-stack", misalignment=0.005).q.reshape(15, 7)[:, :2], axis=0)
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), 0.005)


@pytest.mark.parametrize("name", ["spheres", "boxes", "capsules-box"])
def test_granular_scenes_follow_seed_and_size(name):
    a, b, c = started(name, size=40), started(name, size=40), started(name, size=40, seed=1)
    np.testing.assert_array_equal(a.q, b.q)
    assert (a.q != c.q).any()
    assert len(a.world.bodies) == 41
    assert started(name, size=1).world.num_v == 6


def test_a_jammed_heap_comes_to_rest_solved():
    """More rows than degrees of freedom, all but sticking: the steps on which most methods stay above 1e-5."""
    world, q, v = worlds()["spheres"](size=36)
    simulator = signorini.Simulator(world)
    simulator.state.q, simulator.state.v = q, v
    before = simulator.energy.total
    trace = simulator.run(1600)
    assert np.all(trace.solved)
    assert simulator.report.residual.relative <= 1e-6
    assert simulator.report.num_constraints > 2 * 36
    assert np.max(trace.penetration) < 1e-8
    assert simulator.energy.kinetic < 1e-3 * (before - simulator.energy.total)  # a ball still rolls


def test_options_are_checked():
    for name, options in (
        ("cube-stack", {"num_cubes": 0}),
        ("cube-stack", {"mass_ratio": float("nan")}),
        ("cube-stack", {"misalignment": 1.0}),
        ("spheres", {"size": 0}),
        ("boxes", {"friction": -1.0}),
        ("spheres", {"radius": -1.0}),
        ("capsules-box", {"length": 0.0}),
        ("ur5", {"q": [0.0]}),
        ("ur5", {"q": "x"}),
    ):
        with pytest.raises(InvalidInputError, match=rf"^{next(iter(options))}\b"):
            worlds()[name](**options)


@pytest.mark.parametrize("name", sorted(worlds()))
def test_options_of_another_type_are_refused(name):
    scene = worlds()[name]
    for option, parameter in inspect.signature(scene.make).parameters.items():
        bad = ["x", [1], math.nan, -(2**40), *([] if parameter.default is None else [None])]
        for value in bad if option != "q" else ["x", [[1.0]], [math.nan] * 6]:
            with pytest.raises(InvalidInputError, match=rf"\b{option}: "):
                scene(**{option: value})


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        *(("humanoid", {"height": height}, "height: is .*, must be in .1.2929, 1") for height in (-1, 0.0, 1.29, 1e4)),
        *(("talos-fall", {"height": height}, "height: is .*, must be in") for height in (-1.0, 0.0, 1e4)),
        *(("ur5", {"q": [0.0, q, 0, 0, 0, 0]}, r"q: is .* at 'shoulder_lift_joint', must be in") for q in (7, -1e90)),
        ("ur5", {"q": [0, -1.6, 2.9, 0, 0, 0]}, "q: .* overlap by 86 mm, must"),
        ("ur5", {"q": [0.0] * 6, "ground": 1}, "q: .*'ground'.* overlap by 48.5 mm, must"),
        *(("ur5-wall", {"stiffness": k}, "stiffness: is .*, must be in") for k in (-1.0, 0, 1e-300)),
        *(("ur5-wall", {"damping": d}, "damping: is .*, must be in") for d in (-1.0, math.inf, 1e300)),
        *(("cube-wall", {"ball_mass": m}, "ball_mass: is .*, must be 0, or in") for m in (-1.0, 1e-100, 1e10)),
        ("cube-wall", {"edge": 1e3, "mass_ratio": 1e12}, "edge"),
        ("cube-stack", {"edge": 1e3, "mass_ratio": 1e12}, "edge"),
        ("boxes", {"edge": 100.0}, "edge"),
        ("boxes", {"density": 1e6}, "density"),
        ("chain", {"wire": 100.0}, "wire"),
    ],
)
def test_options_out_of_range_are_named(name, options, message):
    with pytest.raises(InvalidInputError, match=f"^{message}"):
        started(name, **options)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("humanoid", {"height": 1.2929}),
        ("talos-fall", {"height": 5e-4}),
        ("cube-stack", {"edge": 40.0, "mass_ratio": 1e12}),
        ("cube-wall", {"edge": 40.0, "mass_ratio": 1e12, "ball_mass": 1e-9}),
        ("spheres", {"size": 8, "radius": 50.0, "density": 1e5}),
        ("boxes", {"size": 8, "edge": 50.0, "density": 1e5}),
        ("capsules-box", {"size": 8, "radius": 50.0, "length": 50.0, "density": 1e5}),
        ("capsules-box", {"size": 8, "radius": 1e-4, "length": 1e-4, "density": 1e-3}),
        ("chain", {"size": 3, "wire": 10.0, "mass_ratio": 1e12}),
        ("cable", {"size": 2, "pitch": 1e3, "mass_ratio": 1e12, "angle": math.pi}),
    ],
)
def test_options_at_the_ends_of_their_ranges_start_apart(name, options):
    world, q, v = started(name, **options)
    assert min((distance for _, _, distance in world.touching_pairs(q)), default=0.0) > -1e-6
    simulator = signorini.Simulator(world)
    simulator.state.q, simulator.state.v = q, v
    simulator.step()


def test_the_arm_stands_on_its_ground_or_has_none():
    """0 and 1, as the command line hands them over, are no heights."""
    assert "ground" not in worlds()["ur5"](ground=0).world.geometry_names
    start = worlds()["ur5"](ground=1)
    ground = start.world.geometry_index("ground")
    assert all(d > -1e-9 for a, b, d in start.world.touching_pairs(start.q, 0.1) if ground in (a, b))


def test_talos_stands_above_the_ground_without_overlaps():
    world, q, _ = started("talos-fall", height=0.02)
    assert world.num_v == 38
    assert any("velocity limits" in warning for warning in world.warnings)
    ground = world.geometry_index("ground")
    distances = [d for a, b, d in world.touching_pairs(q, 0.1) if ground in (a, b)]
    assert 0.005 < min(distances) < 0.04


def test_a_fall_takes_few_factorisations():
    """Contacts come and go at nearly every step, and the last one's impulses are a poor start where they do."""
    counts = []
    for height in (0.018, 0.0195, 0.021):
        start = started("talos-fall", height=height)
        simulator = signorini.Simulator(start.world, time_step=1e-3, tolerance=1e-6)
        simulator.state.q, simulator.state.v = start.q, start.v
        trace = simulator.run(1000)
        assert trace.solved.all()
        counts.append(np.mean(trace.factorizations))
    assert np.mean(counts) < 7.2  # 6.1; without sweeps between Newton's attempts 8.2


def test_missing_packages_are_named(monkeypatch, tmp_path):
    monkeypatch.setattr("sysconfig.get_path", lambda key: str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FileNotFoundError, match=r"signorini\[robots\]"):
        signorini.scenes.robots_folder()
    with pytest.raises(FileNotFoundError, match=r"signorini\[robots\]"):
        worlds()["humanoid"]()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"foo": 1}, "option: there is no 'foo'; cube-stack has num_cubes"),
        ({"num_cubes": 2.5}, "num_cubes: is 2.5, must be an integer"),
    ],
)
def test_options_of_scenes_that_cannot_be(options, message):
    with pytest.raises(InvalidInputError, match=message):
        worlds()["cube-stack"](**options)
