"""Models that are wrong in one way each: a built-in one, with a fault put before or behind it."""

from __future__ import annotations

import dataclasses
from types import MappingProxyType, SimpleNamespace
from typing import ClassVar

import numpy as np

from clothbench import ClothbenchError, ParameterSpace
from clothbench.plugins.discovery import catalogue
from clothbench.testing import scenes


def reference():
    """The first installed model that can do everything the faults are put into."""
    for name in catalogue().names("models"):
        make = catalogue().load("models", name)
        if {"dynamic", "static", "effects"} <= set(make().capabilities):
            return make
    raise LookupError("no installed model is dynamic, static and takes effects")


class Faulty:
    """A sound model with places for a fault; as it stands it has none."""

    name = "faulty"
    version = 1

    def __init__(self, step_scale=1.0, dt=None):
        self.step_scale, self.dt = step_scale, dt
        self.inner = reference()(step_scale=step_scale, dt=dt)
        self.parameters, self.capabilities = self.inner.parameters, self.inner.capabilities

    def prepare(self, scene, effects=()):
        return FaultySimulation(self, scene, tuple(effects))

    def scene(self, scene):
        return scene

    def effects(self, effects):
        return effects

    def before(self, theta):
        return theta

    def behind(self, scene, theta, effects, rollout):
        return rollout


class FaultySimulation:
    def __init__(self, model, scene, effects):
        self.model, self.asked, self.effects = model, scene, effects
        self.inner = model.inner.prepare(model.scene(scene), model.effects(effects))
        self.parameters = self.inner.parameters if effects else model.parameters

    def run(self, theta):
        rollout = self.inner.run(self.model.before(theta))
        return self.model.behind(self.asked, np.atleast_2d(theta), self.effects, rollout)


def shifted(rollout, shift):
    """The rollout with something added to its positions, which broadcasts to (B, T, N, 3) m."""
    return dataclasses.replace(rollout, position=rollout.position + shift)


class Static(Faulty):
    """Only finds states of rest, in scenes where nothing moves; sound."""

    def __init__(self):
        super().__init__()
        self.parameters = ParameterSpace(self.parameters.parameters[:2])
        self.capabilities = frozenset({"static"})

    def before(self, theta):
        rest = np.tile(self.inner.parameters.defaults, (len(theta), 1))
        rest[:, :2] = self.parameters.check(theta)
        return rest


class Refinable(Faulty):
    """Takes smaller steps when told so by a method instead of an option; sound."""

    def __init__(self, scale=1.0):
        super().__init__(step_scale=scale)

    def refined(self, factor):
        return type(self)(1 / factor)


class Nameless(Faulty):
    name = "not a name"


class HalfPrecise(Faulty):
    def behind(self, scene, theta, effects, rollout):
        return dataclasses.replace(rollout, position=rollout.position.astype(np.float32))


class Concealing(Faulty):
    def behind(self, scene, theta, effects, rollout):
        lost = np.where(np.arange(len(rollout.time)) >= 4, np.nan, 0.0)
        return shifted(rollout, lost[:, None, None])


class Restless(Faulty):
    """Not deterministic: every run differs from the one before by a hair."""

    count = 0

    def behind(self, scene, theta, effects, rollout):
        type(self).count += 1
        return shifted(rollout, 1e-13 * self.count)


class Sociable(Faulty):
    """What a member does depends on how many others there are."""

    def behind(self, scene, theta, effects, rollout):
        return shifted(rollout, 1e-10 * len(theta))


class Lenient(Faulty):
    def before(self, theta):
        wanted = len(self.parameters)
        theta = np.nan_to_num(np.atleast_2d(theta))
        return np.hstack([theta, np.ones((len(theta), wanted))])[:, :wanted]


class Meddling(Faulty):
    def before(self, theta):
        theta *= 1.01
        return np.minimum(theta, self.parameters.high)


class TouchyAboutEffects(Faulty):
    def behind(self, scene, theta, effects, rollout):
        return shifted(rollout, 1e-12 if effects else 0.0)


class DeafToEffects(Faulty):
    def effects(self, effects):
        return ()

    def before(self, theta):
        return np.atleast_2d(theta)[:, : len(self.parameters)]


class Explosive(Faulty):
    def behind(self, scene, theta, effects, rollout):
        if "diverged" in rollout.status:
            raise FloatingPointError("the sheet blew up")
        return rollout


class Infectious(Faulty):
    """Where one member diverges, all do."""

    def behind(self, scene, theta, effects, rollout):
        if "diverged" not in rollout.status:
            return rollout
        status = ("diverged", "ok", *rollout.status[2:])
        position = np.where(np.isfinite(rollout.position), rollout.position, np.nan)
        position[0], position[1] = np.nan, 0.0
        return dataclasses.replace(rollout, status=status, position=position)


class LettingGo(Faulty):
    """Does not follow the grips: holds on to where they were first."""

    def scene(self, scene):
        return scenes.still(scene)


class Homesick(Faulty):
    """Drifts eastwards, wherever the scene is turned to."""

    def behind(self, scene, theta, effects, rollout):
        return shifted(rollout, 1e-3 * scene.times[:, None, None] * [1.0, 0.0, 0.0])


class Stubborn(Faulty):
    """Knows only one direction in which things fall."""

    def scene(self, scene):
        return dataclasses.replace(scene, gravity=(0.0, 0.0, -9.81))


class UpsideDown(Faulty):
    def scene(self, scene):
        return dataclasses.replace(scene, gravity=tuple(-g for g in scene.gravity))


class Forgetful(Faulty):
    """Has a parameter that it does not use."""

    def before(self, theta):
        theta = np.array(theta)
        theta[:, 1] = self.parameters.defaults[1]
        return theta


class Unsteady(Faulty):
    """Smaller steps lead it elsewhere, but not closer."""

    def behind(self, scene, theta, effects, rollout):
        return shifted(rollout, 1e-3 * np.log2(self.step_scale))


class Metronome(Faulty):
    """Takes the frames to be evenly spaced."""

    def scene(self, scene):
        return scenes.with_times(scene, np.linspace(scene.times[0], scene.times[-1], len(scene.times)))

    def behind(self, scene, theta, effects, rollout):
        return dataclasses.replace(rollout, time=scene.times)


class Standing(Faulty):
    """Begins at rest, whatever the scene says."""

    def scene(self, scene):
        return dataclasses.replace(scene, velocity=None)


class Worn(Faulty):
    """Says of a textile what it has no parameter for."""

    textiles: ClassVar = {"soft": {"threadbare": 1.0}}


class Uncut(Faulty):
    """Simulates the whole rectangle, whatever has been cut off."""

    def scene(self, scene):
        return dataclasses.replace(scene, outline=None)


class Unclamped(Faulty):
    """Lets the cloth slide on its plate."""

    def behind(self, scene, theta, effects, rollout):
        return shifted(rollout, 0.01 * bool(scene.obstacles))


class Rooted(Faulty):
    """Takes every obstacle for one that stands still."""

    def scene(self, scene):
        return dataclasses.replace(scene, obstacles=[dataclasses.replace(o, carried=False) for o in scene.obstacles])


class Sleepwalking(Faulty):
    """Goes on sinking where it should rest."""

    def behind(self, scene, theta, effects, rollout):
        return shifted(rollout, -0.05 * scene.times[:, None, None] * [0.0, 0.0, 1.0])


class Light(Faulty):
    """Knows only one areal density."""

    def scene(self, scene):
        return dataclasses.replace(scene, areal_density=0.12)


class Earthly(Faulty):
    """Takes all gravity to be as strong as the earth's."""

    def scene(self, scene):
        gravity = np.array(scene.gravity)
        return dataclasses.replace(scene, gravity=tuple(9.81 * gravity / np.linalg.norm(gravity)))


class EarthlyAtRest(Earthly, Static):
    """The same, of which only rests are seen."""


class Heavy(Faulty):
    """Weighs twice what the scene says, which only a material tells."""

    def scene(self, scene):
        return dataclasses.replace(scene, areal_density=2 * scene.areal_density)

    def of_material(self, material, scene):
        return self.inner.of_material(material, scene)


class Ghostly(Faulty):
    """Goes through whatever stands in its way, and says that it does not."""

    def scene(self, scene):
        return dataclasses.replace(scene, obstacles=())


class Permeable(Faulty):
    def scene(self, scene):
        return dataclasses.replace(scene, thickness=0.0)


class Nothing(Faulty):
    """Has no parameters, and no scene that it can do."""

    def __init__(self):
        super().__init__()
        self.parameters = ParameterSpace()

    def prepare(self, scene, effects=()):
        raise ClothbenchError("not this scene")


class Overstretched(Faulty):
    """Has no answer beyond twice the length."""

    def __init__(self):
        super().__init__()
        self.capabilities = self.capabilities | {"curve"}

    def curve(self, stretch, theta):
        with np.errstate(invalid="ignore"):
            return theta[0] * np.sqrt(2 - stretch)


class Undecided(Faulty):
    kind = "sometimes"


class Unrepeatable(Faulty):
    repeatability = -1.0


class Untimed(Faulty):
    bench_options = ({"nonsense": 1},)


class Idle(Faulty):
    work_per_node_step = MappingProxyType({"operations": 10.0, "roots": -1.0, "numbers": 3.0})


class Moody(Faulty):
    def skip(self, scene):
        return True


class Vague(Faulty):
    def of_material(self, material, scene):
        return np.array([material.bending])


class Woolly(Faulty):
    def material_of(self, theta, scene):
        return "cotton"


class Forgetting(Faulty):
    """Says of the parameters of a material that they are another one's."""

    def of_material(self, material, scene):
        return self.inner.of_material(material, scene)

    def material_of(self, theta, scene):
        return dataclasses.replace(self.inner.material_of(theta, scene), stretch=7.0)


class Undocumented(Faulty):
    documented = 17


class Limp(Faulty):
    """Its strip can be lifted, but what comes of that is no state."""

    def __init__(self, step_scale=1.0, dt=None):
        super().__init__(step_scale, dt)
        self.capabilities = self.capabilities | {"fold"}

    def strip(self, length):
        return SimpleNamespace(lift=lambda height, theta: None, hold=None)


class Loose(Faulty):
    threads = "many"

    def prepare(self, scene, effects=()):
        simulation = super().prepare(scene, effects)
        simulation.threads = self.threads
        return simulation


class Renamed(Faulty):
    def refined(self, factor):
        other = Faulty()
        other.parameters = ParameterSpace(other.parameters.parameters[:1])
        return other


class Foldless(Faulty):
    def __init__(self, step_scale=1.0, dt=None):
        super().__init__(step_scale, dt)
        self.capabilities = self.capabilities | {"fold"}


CASES = [
    (Undecided, "keeps what it offers", "kind 'sometimes'"),
    (Unrepeatable, "keeps what it offers", "repeatability -1.0"),
    (Untimed, "keeps what it offers", "options {'nonsense': 1} to be measured with"),
    (Idle, "keeps what it offers", "work_per_node_step"),
    (Moody, "keeps what it offers", "→ True"),
    (Vague, "keeps what it offers", "of_material in scene"),
    (Woolly, "keeps what it offers", "→ 'cotton'"),
    (Forgetting, "keeps what it offers", "stretch=7.0"),
    (Undocumented, "keeps what it offers", "documented 17"),
    (Limp, "keeps what it offers", "lift() → NoneType"),
    (Loose, "keeps what it offers", "threads 'many'"),
    (Renamed, "keeps what it offers", "other parameters of refined(2)"),
    (Foldless, "keeps what it offers", "no strip(length)"),
    (Nameless, "has all members", "name 'not a name'"),
    (Nothing, "has all members", "no parameter"),
    (Nothing, "gives whole rollouts", "none of the scenes hanging"),
    (HalfPrecise, "gives whole rollouts", "positions of type float32"),
    (Concealing, "gives whole rollouts", "status 'ok' but positions not finite"),
    (Restless, "gives the same bits twice", "another result of the same simulation"),
    (Sociable, "gives a batch as one by one", "member 0 of a batch"),
    (Lenient, "refuses wrong parameters", "no complaint about one parameter too few"),
    (Meddling, "leaves its input alone", "parameter sets that the run has changed"),
    (TouchyAboutEffects, "is untouched by null effects", "at its null values"),
    (DeafToEffects, "lets effects act", "nothing changed by effect"),
    (Explosive, "reports divergence", "FloatingPointError: the sheet blew up"),
    (Overstretched, "answers curves if it says so", "forces that are not finite"),
    (Infectious, "reports divergence", "dt ="),
    (LettingGo, "follows the grips", "from their grips in scene swinging"),
    (Homesick, "moves along with the room", "off after turning and shifting scene"),
    (Stubborn, "turns along with gravity", "off after turning and shifting scene"),
    (UpsideDown, "is pulled down", "above its highest grip"),
    (Forgetful, "lets every parameter matter", "goes from low to high"),
    (Unsteady, "converges with smaller steps", "on halving the step twice"),
    (Metronome, "respects uneven time stamps", "at the same moment of scene"),
    (Standing, "goes on from a motion", "a sheet thrown at 1.4 m/s that is"),
    (Worn, "keeps what it offers", "textile 'soft' with parameters"),
    (Uncut, "cuts along the outline", "a sheet cut to 60 %"),
    (Unclamped, "cuts along the outline", "clamped cloth 17"),
    (Rooted, "is carried along", "from where the table carries it"),
    (Light, "heeds density and gravity", "a change of 0 mm by 1.5 times the areal density"),
    (Earthly, "heeds density and gravity", "under 0.4 of the gravity of"),
    (EarthlyAtRest, "heeds density and gravity", "a change of 0 mm by 1.5 times the gravity"),
    (Heavy, "hangs as its material says", "a curtain that its weight lengthens by 3."),
    (Ghostly, "keeps out of a plane", "deep in a plane"),
    (Permeable, "keeps its layers apart", "an upper layer -31"),
    (Sleepwalking, "rests when held still", "a sheet that moves by"),
]
IDS = [f"{make.__name__}-{rule}" for make, rule, _ in CASES]
