"""How sheets come to rest before a run: apart from what acts in motion only, once for all who rest alike."""

import dataclasses

import numpy as np
import pytest
from clothbench_effects.gravity_tilt import GravityTilt
from clothbench_effects.grip_offset import GripOffset
from clothbench_effects.quadratic_drag import QuadraticDrag
from clothbench_effects.rest_curvature import RestCurvature
from clothbench_effects.steady_wind import SteadyWind
from clothbench_effects.total_mass import TotalMass
from clothbench_effects.viscoelasticity import Viscoelasticity
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.inextensible import Inextensible
from clothbench_models.mass_spring import MassSpring
from clothbench_models.mass_spring_verlet import MassSpringVerlet

from clothbench import Scene
from clothbench.core.resting import RestShapes, remember_rest, rest_shapes
from clothbench.modelling import GridSimulation
from clothbench.testing import scenes

MODELS = (MassSpring, MassSpringVerlet, BaraffWitkin, Inextensible)
IN_MOTION = {"mass_spring": 2, "mass_spring_verlet": 12, "baraff_witkin": 3, "inextensible": 2}  # a damping of each
each_model = pytest.mark.parametrize("make", MODELS, ids=lambda make: make.name)


def scene() -> Scene:
    """A sheet of 7 × 7 nodes, held by two corners that sway for 0.2 s."""
    held = np.array([[0.0, 0.0], [0.2, 0.0]])
    time = np.linspace(0.0, 0.2, 11)
    at = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]) + 0.02 * np.sin(8 * time)[:, None, None] ** 2 * [0, 1, 0]
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.2, 5)))
    points = np.stack([u, v], axis=1)
    return Scene(0.2, 0.2, 0.2, time, held, at, time, points, resolution=(7, 7))


def prepared(make: type, effects=(), where: Scene | None = None) -> GridSimulation:
    return make().prepare(scene() if where is None else where, effects)


def other_damping(simulation: GridSimulation, name: str) -> np.ndarray:
    """The defaults, and beside them ten times (of one share: twice) one damping."""
    theta = np.tile(simulation.parameters.defaults, (2, 1))
    theta[1, IN_MOTION[name]] *= 2
    return theta


def finished(simulation: GridSimulation, theta: np.ndarray) -> np.ndarray:
    """Positions (B, T, N, 3) m of members that all run to their end."""
    rollout = simulation.run(theta)
    assert set(rollout.status) == {"ok"}
    return rollout.position


@pytest.mark.parametrize("make", [BaraffWitkin, Inextensible], ids=lambda make: make.name)
def test_between_grips_inset_from_either_hem_a_sheet_hangs_even(make):
    """Their lines are the outermost, and each stands for the cloth beyond it: on one side it had been left out."""
    held = np.array([[0.012, 0.0], [0.288, 0.0]])
    at = np.array([[[-0.138, 0.0, 1.0], [0.138, 0.0, 1.0]]] * 2)
    u, v = np.meshgrid(np.linspace(0.02, 0.28, 7), np.linspace(0.0, 0.25, 6))
    points = np.stack([u.ravel(), v.ravel()], axis=1)
    where = Scene(0.3, 0.25, 0.2, np.array([0.0, 1.0]), held, at, np.array([0.0]), points, resolution=(13, 11))
    simulation = prepared(make, (), where)
    height = finished(simulation, simulation.parameters.defaults[None])[0, 0, :, 2].reshape(6, 7)
    np.testing.assert_allclose(height, height[:, ::-1], atol=5e-5)


@each_model
def test_dampings_and_drag_leave_the_rest_alone(make):
    simulation = prepared(make, [QuadraticDrag()])
    theta = np.vstack([other_damping(simulation, make.name), simulation.parameters.defaults])
    theta[2, -2] = 4.0  # much drag
    moved = finished(simulation, theta)
    np.testing.assert_allclose(moved[0, 0], moved[1, 0], atol=1e-5)
    assert np.array_equal(moved[0, 0], moved[2, 0])
    assert not np.array_equal(moved[0, -1], moved[1, -1])
    assert not np.array_equal(moved[0, -1], moved[2, -1])


@each_model
@pytest.mark.parametrize("effects", [(), (QuadraticDrag(),), (GripOffset(),)], ids=lambda effects: len(effects))
def test_what_is_remembered_is_what_is_found(make, effects):
    where = scene()
    remember_rest(where)
    theta = prepared(make, effects).parameters.defaults[None]
    anew, first = prepared(make, effects).run(theta), prepared(make, effects, where).run(theta)
    again = prepared(make, effects, where).run(theta)
    assert anew.status == ("ok",)
    assert np.array_equal(anew.position, first.position)
    assert np.array_equal(anew.position, again.position)
    assert again.steps[0] <= first.steps[0] == anew.steps[0]


def test_a_rest_is_sought_once_for_all_that_rest_alike():
    simulation = prepared(MassSpring)
    alone = simulation.run(simulation.parameters.defaults[None])
    both = simulation.run(other_damping(simulation, "mass_spring"))
    assert both.steps[0] == alone.steps[0]
    settling = simulation.hanging.run(simulation.parameters.defaults[None])
    assert settling.steps[0] < alone.steps[0]
    assert both.steps[1] < simulation.run(other_damping(simulation, "mass_spring")[1:]).steps[0]


@each_model
@pytest.mark.parametrize("effect", [RestCurvature(), SteadyWind()], ids=lambda effect: effect.name)
def test_what_acts_at_rest_is_part_of_it(make, effect):
    bare, acted_on = prepared(make), prepared(make, [effect])
    assert bare.hanging is not None
    assert acted_on.hanging is None
    theta = acted_on.parameters.defaults
    theta[-3:-1] = [0.5, 0.5] if effect.name == "steady_wind" else theta[-3:-1]
    at_first = [finished(s, t[None])[0, 0] for s, t in ((bare, bare.parameters.defaults), (acted_on, theta))]
    assert np.abs(at_first[1] - at_first[0]).max() > 1e-4


@each_model
def test_drag_is_no_part_of_it_beside_what_is(make):
    curl, drag = RestCurvature(), QuadraticDrag()
    one, two = prepared(make, [curl]), prepared(make, [curl, drag])
    at_first = [finished(s, s.parameters.defaults[None])[0, 0] for s in (one, two)]
    assert np.array_equal(*at_first)


def test_grips_that_begin_elsewhere_make_another_rest():
    simulation = prepared(BaraffWitkin, [GripOffset()])
    theta = np.tile(simulation.parameters.defaults, (2, 1))
    theta[1, -3:] = 0.01
    moved = finished(simulation, theta)
    assert np.abs(moved[1, 0] - moved[0, 0]).max() > 5e-3


def test_rest_that_diverges_is_said_of_its_member_only():
    simulation = MassSpring(dt=8e-4).prepare(scene())
    theta = np.tile(simulation.parameters.defaults, (3, 1))
    theta[1, 0] = 1000.0  # too stiff for the step
    rollout = simulation.run(theta)
    assert rollout.status == ("ok", "diverged", "ok")
    assert np.isnan(rollout.position[1]).all()
    assert np.array_equal(rollout.position[0], simulation.run(theta[:1]).position[0])


def test_nobody_comes_to_rest_who_moves_or_lies():
    assert prepared(MassSpring).hanging is not None
    still = dataclasses.replace(scene(), times=np.array([0.0]))
    assert prepared(MassSpring, where=still).hanging is None
    assert prepared(MassSpring, where=dataclasses.replace(scene(), thickness=1e-3)).hanging is None
    moving = dataclasses.replace(scene(), start=np.zeros((25, 3)), velocity=np.zeros((25, 3)))
    assert prepared(MassSpring, where=moving).hanging is None


def test_shapes_are_kept_as_long_as_there_is_room(monkeypatch):
    monkeypatch.setattr("clothbench.core.resting.MOST", 3 * 9 * 8)
    kept, shapes = RestShapes(), [np.full((3, 3), float(k)) for k in range(4)]
    for k in range(3):
        kept.keep(bytes([k]), shapes[k])
    assert kept.get(b"\0") is shapes[0]
    kept.keep(b"\3", shapes[3])
    assert [kept.get(bytes([k])) is not None for k in range(4)] == [True, False, True, True]


def test_nothing_is_kept_of_a_scene_unless_asked():
    where = scene()
    assert rest_shapes(where) is None
    remember_rest(where)
    first = rest_shapes(where)
    remember_rest(where)
    assert rest_shapes(where) is first


@pytest.mark.parametrize("slack", [0.02, 0.06])
def test_slack_cloth_hangs_in_an_arc_and_is_not_squeezed_in_its_plane(slack):
    """Held by corners that are nearer than the cloth is wide, and nobody saw how: all models find
    much the same fold."""
    held = np.array([[0.0, 0.0], [0.2, 0.0]])
    at = np.tile([[slack / 2, 0.0, 0.0], [0.2 - slack / 2, 0.0, 0.0]], (3, 1, 1))
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 0.2, 9), np.linspace(0, 0.2, 9)))
    time = np.linspace(0.0, 0.2, 3)
    hung = Scene(0.2, 0.2, 0.2, time, held, at, time, np.stack([u, v], axis=1), resolution=(13, 13))
    shapes = []
    for make in MODELS:
        simulation = prepared(make, where=hung)
        shapes.append(finished(simulation, simulation.parameters.defaults[None])[0, 0].reshape(9, 9, 3))
        for row in (shapes[-1][0], shapes[-1][-1]):
            assert np.linalg.norm(np.diff(row, axis=0), axis=1).sum() == pytest.approx(0.2, rel=0.03)
    assert np.abs(shapes[0][..., 1]).max() > 0.5 * np.sqrt(0.2 * slack) / 2
    apart = [np.sqrt(np.square(one - shapes[-1]).sum(axis=-1).mean()) for one in shapes[:-1]]

    assert max(apart) < 0.015  # m, of a sheet 20 cm wide: springs bend more readily
    assert apart[2] < 0.004  # two models of one material


@pytest.mark.parametrize("make", [MassSpring, MassSpringVerlet], ids=lambda make: make.name)
def test_a_strip_clamped_at_its_side_comes_to_rest_as_one_clamped_at_its_top(make):
    """Level at its end it turns down by its whole length, whichever of its sides is called the height."""
    length, width = 0.6, 0.1
    held = np.array([[0.0, 0.0], [0.0, width], [0.05, 0.0], [0.05, width]])
    place, time = np.pad(held, ((0, 0), (0, 1))), np.array([0.0, 1.0])
    tips = []
    for across in (False, True):
        way = slice(None, None, -1) if across else slice(None)
        strip = Scene(
            *(length, width)[way], 0.2, time, held[:, way], np.stack([place, place]), np.array([0.0]),
            np.array([[length, width / 2]])[:, way], resolution=(25, 5)[way],
        )  # fmt: skip
        simulation = make().prepare(strip)
        tips.append(finished(simulation, simulation.parameters.defaults)[0, 0, 0])
    assert np.linalg.norm(tips[0] - tips[1]) < 2e-3


def test_gravity_that_leans_keeps_nothing_moving():
    """A limp sheet may go to and fro between two wrinkles, which is no rest; with a dead load as without."""
    swinging, tilts = scenes.swinging(), np.random.default_rng(3).uniform(-0.2, 0.2, (12, 2))
    simulation = Inextensible().prepare(swinging, [GravityTilt()])
    theta = np.array([[*Inextensible.parameters.defaults, *tilt] for tilt in tilts])
    rollout = simulation.run(theta)
    assert rollout.status == ("ok",) * 12
    heavier = Inextensible().prepare(swinging, [GravityTilt(), TotalMass()])
    assert heavier.effects.only_weighs
    assert not Inextensible().prepare(swinging, [GravityTilt(), SteadyWind()]).effects.only_weighs


def test_a_sheet_that_a_wind_keeps_moving_is_lost_and_says_so():
    """It would else begin anywhere, as if that were rest; in a light wind it hangs still."""
    hanging = scenes.hanging()
    simulation = BaraffWitkin().prepare(hanging, [SteadyWind()])
    strong, light = ([3.6, 0.45, 1.6, 1.6, 1.6], [1.0, 0.02, 0.0, 0.2, 0.0])
    theta = np.array([[*BaraffWitkin.parameters.defaults, *wind] for wind in (strong, light)])
    rollout = simulation.run(theta)
    assert rollout.status == ("diverged", "ok")
    assert rollout.reasons == ("the sheet did not come to rest before the run: these effects keep it moving", "")
    assert np.isnan(rollout.position[0]).all()


@each_model
def test_stress_that_relaxes_has_relaxed_where_a_sheet_rests(make):
    """However stiff it is at once: it has no say in where that is, nor in how soon it is found."""
    swinging = scenes.with_times(scenes.swinging(), np.array([0.0]))
    bare = make().prepare(swinging)
    beside = make().prepare(swinging, [Viscoelasticity()])
    theta = make.parameters.defaults
    rest = finished(beside, np.array([[*theta, 1e-3, 500.0, 0.2]]))
    np.testing.assert_allclose(rest, finished(bare, theta[None]), atol=1e-5)
