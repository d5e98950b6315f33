"""What is written of a suggestion: `suggest.json` (schema 1), and of an experiment a motion for a robot, where a camera
is to stand (if one is to see it), and a recording of what the fitted model expects.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import LENSES
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_name, json_text, whole_files
from clothbench.engine.tables import finite
from clothbench.recordings.nodes import Recording, write_recording
from clothbench.suggest.cameras import Placed
from clothbench.suggest.information import BEFOREHAND
from clothbench.suggest.ranking import LeftOut, Promise, rank_of
from clothbench.suggest.settings import Sensor, Wanted
from clothbench.suggest.subject import Known, Subject

SCHEMA = 1
DOCUMENT = "suggest.json"
MOTION, EXPECTED, CAMERA = "motion.csv", "expected.nc", "camera.json"
OLD = (DOCUMENT, "experiments/*/*")  # of an earlier run
DETERMINED = BEFOREHAND / 2  # half of an interval, in scaled ranges, below which a parameter counts as determined


def suggestion(subject: Subject, found: Sequence[Promise], left: Sequence[LeftOut], wanted: Wanted) -> dict[str, Any]:
    """The document. found: ranked, the best first."""
    known, problem = subject.known, subject.problem
    return {
        "schema": SCHEMA, "model": problem.model, "base": list(problem.base), "effects": list(known.fitted.effects),
        "rank": rank_of(subject, wanted.rank), "settings": asdict(wanted),
        "recordings": {split: [c.name for c in problem.of_split(split)] for split in ("fit", "held_out")},
        "left_mm": 1e3 * known.fitted.rms, "noise_mm": finite(1e3 * known.noise), "counted_mm": 1e3 * known.usual,
        "parameters": parameters(known),
        "ties": [
            {"one": tie.one, "other": tie.other, "sigma_now": tie.now, "sigma_other_better": tie.behind}
            for tie in subject.ties
        ],
        "experiments": [entry(subject, number, promise, wanted) for number, promise in enumerate(found, 1)],
        "left_out": [asdict(one) for one in left],
    }  # fmt: skip


def parameters(known: Known) -> dict[str, Any]:
    """Each parameter with its interval by what the recordings tell. On a bound it is the bound that chose the value."""
    half, at_bound = known.half, known.fitted.at_bound
    return {
        p.name: {
            "value": float(known.fitted.theta[k]), **ends(known, half)[p.name], "unit": p.unit, "meaning": p.meaning,
            "determined": bool(half[k] < DETERMINED and not at_bound[k]), "at_bound": bool(at_bound[k]),
        }
        for k, p in enumerate(known.fitted.space)
    }  # fmt: skip


def ends(known: Known, half: np.ndarray) -> dict[str, dict[str, float]]:
    """Ends of intervals of half-widths (P,) in scaled ranges about the fit, in each parameter's unit."""
    space = known.fitted.space
    low, high = space.from_unit(known.unit - half), space.from_unit(known.unit + half)
    return {name: {"low": float(a), "high": float(b)} for name, a, b in zip(space.names, low, high, strict=True)}


def entry(subject: Subject, number: int, promise: Promise, wanted: Wanted) -> dict[str, Any]:
    """One experiment with what it promises; factors are of the intervals' widths, now over then."""
    known, experiment = subject.known, promise.experiment
    speed, acceleration = experiment.fastest(promise.duration)
    now, expected = known.half, ends(known, promise.after)
    return {
        "rank": number, "name": name_of(promise), "grips": experiment.grips, "motion": experiment.motion,
        "duration_s": promise.duration, "frames_per_s": subject.rate, "points": len(experiment.scene.points),
        "max_speed_m_s": speed, "max_acceleration_m_s2": acceleration,
        "information_nats": promise.gain, "widens": promise.widens(now), "counted_mm": 1e3 * promise.counted,
        "doubt_mm": 1e3 * promise.doubt, "parameters": {
            name: {
                "factor": float(now[k] / promise.after[k]), "factor_least": float(now[k] / promise.worst[k]),
                "factor_most": float(now[k] / promise.best[k]), **expected[name],
            }
            for k, name in enumerate(known.fitted.space.names)
        },
        "ties": [
            {
                "one": a.tie.one, "other": a.tie.other, "sigma": a.sigma, "sigma_least": a.least,
                "rms_mm": 1e3 * a.rms,
            }
            for a in promise.apart
        ],
        "camera": promise.view.name if promise.view else None, "cameras": [seen(known, view) for view in promise.views],
        "folder": f"experiments/{number}" if number <= wanted.best else None,
    }  # fmt: skip


def seen(known: Known, promise: Promise) -> dict[str, Any]:
    """What the experiment promises as one of the cameras sees it."""
    view = promise.view
    assert view is not None  # as of all that are to choose from
    frames = len(promise.experiment.lasting(promise.duration).times)
    factors = (known.half / promise.after).tolist()
    return {
        **place_of(view), "points_seen": float(view.seen[:frames].mean()), "information_nats": promise.gain,
        "factors": dict(zip(known.fitted.space.names, factors, strict=True)),
        "ties": [
            {"one": a.tie.one, "other": a.tie.other, "sigma": a.sigma, "sigma_least": a.least} for a in promise.apart
        ],
    }  # fmt: skip


def place_of(view: Placed) -> dict[str, Any]:
    """Where it stands, in the axes of the motion."""
    return {
        "name": view.name, "position_m": view.camera.place.tolist(), "target_m": view.target.tolist(),
        "up": view.up.tolist(),
    }  # fmt: skip


def camera_text(view: Placed, sensor: Sensor) -> str:
    """A camera as JSON: where to put it, and as `clothbench import … camera=FILE` reads it."""
    camera = view.camera
    lens = {name: getattr(camera, name).tolist() for name in LENSES}
    told = {"kind": sensor.kind, "field_of_view_deg": sensor.field_of_view, "size": list(camera.size)}
    return json_text({**place_of(view), **told, **lens})


def name_of(promise: Promise) -> str:
    experiment = promise.experiment
    return f"{experiment.grips}: {experiment.motion}, {promise.duration:g} s"


def write_all(
    out: Path, subject: Subject, found: Sequence[Promise], document: Mapping[str, Any], sensor: Sensor
) -> None:
    """The document, and the folders of the best experiments, all or nothing; other files in `out` stay."""
    with whole_files(out, instead_of=OLD) as part:
        (part / DOCUMENT).write_text(json_text(document) + "\n", encoding="utf-8")
        for promise, one in zip(found, document["experiments"], strict=True):
            if one["folder"]:
                (folder := part / one["folder"]).mkdir(parents=True)
                write_motion(folder / MOTION, promise)
                write_recording(expected(subject, promise), folder / EXPECTED)
                if promise.view:
                    text = camera_text(promise.view, sensor)
                    (folder / CAMERA).write_text(text + "\n", encoding="utf-8")


def write_motion(path: Path, promise: Promise) -> None:
    """The grips' paths as CSV: `t [s]`, then x, y, z [m] of every grip, named by its place (u, v) on the cloth."""
    scene = promise.experiment.lasting(promise.duration)
    head = ["t [s]"]
    for u, v in scene.grip_material:
        head += [f"u={1e3 * u:.1f} mm v={1e3 * v:.1f} mm {axis} [m]" for axis in "xyz"]
    last = promise.duration + (scene.grip_time[-1] - promise.experiment.durations[-1])  # when the grips are back
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(head)
        for time, place in zip(scene.grip_time, scene.grip_position, strict=True):
            if time <= last + 1e-9:
                rows.writerow([f"{time:.3f}", *(f"{x:.6f}" for x in place.ravel())])


def expected(subject: Subject, promise: Promise) -> Recording:
    """The experiment as a recording whose positions are the fitted model's own."""
    scene, known = promise.experiment.lasting(promise.duration), subject.known
    rollout = subject.trial(scene, known.fitted.effects).simulation.run(known.fitted.theta[None])
    if not np.isfinite(rollout.position).all():
        raise ClothbenchError(f"{name_of(promise)}: the fitted model cannot be simulated to its end")
    like = subject.like.recording
    return Recording(
        name=f"expected/{file_name(name_of(promise))}", time=scene.times, material=scene.points,
        position=rollout.position[0], grip_time=scene.grip_time, grip_material=scene.grip_material,
        grip_position=scene.grip_position, cloth_width=scene.width, cloth_height=scene.height,
        areal_density=scene.areal_density, gravity=scene.gravity, noise_sigma=0.0, fabric=like.fabric,
        sensor="none: simulated by the fitted model", source="clothbench suggest", licence=like.licence,
        motion=name_of(promise), outline=scene.outline, obstacles=scene.obstacles or None,
        thickness=scene.thickness or None,
    )  # fmt: skip
