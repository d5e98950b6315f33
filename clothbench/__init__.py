"""clothbench: which cloth model to trust, with which parameters, and what it still gets wrong.

Importing the package costs nothing: the public names below are loaded when they are first used.
"""

import importlib

__version__ = "0.1.0"

_HOME = {
    "ClothbenchError": "core.errors",
    "Parameter": "core.parameters",
    "ParameterSpace": "core.parameters",
    "Recording": "recordings.nodes",
    "read_recording": "recordings.nodes",
    "write_recording": "recordings.nodes",
    "Curve": "recordings.curve",
    "read_curve": "recordings.curve",
    "write_curve": "recordings.curve",
    "LaserImages": "recordings.laser",
    "read_laser": "recordings.laser",
    "write_laser": "recordings.laser",
    "DepthImages": "recordings.depth",
    "read_depth": "recordings.depth",
    "write_depth": "recordings.depth",
    "Observation": "core.observation",
    "Camera": "core.camera",
    "Projector": "core.camera",
    "Video": "core.camera",
    "View": "core.camera",
    "Scene": "core.scene",
    "Obstacle": "core.scene",
    "scene_of": "recordings.scenes",
    "Material": "core.protocols",
    "Rollout": "core.rollout",
    "Interpolator": "core.rollout",
    "Score": "core.protocols",
    "Evaluation": "core.protocols",
    "Model": "core.protocols",
    "Simulation": "core.protocols",
    "Effect": "core.protocols",
    "Metric": "core.protocols",
    "Optimizer": "core.protocols",
    "Tracker": "core.protocols",
    "AnswersCurves": "core.optional",
    "BuiltOn": "core.optional",
    "FoldsStrips": "core.optional",
    "HasBenchOptions": "core.optional",
    "HasEqualErrorOptions": "core.optional",
    "HasKind": "core.optional",
    "HasStart": "core.optional",
    "KnowsMaterials": "core.optional",
    "MayBeAbsent": "core.optional",
    "ReadsKinds": "core.optional",
    "Refinable": "core.optional",
    "RefusesScenes": "core.optional",
    "Remembers": "core.optional",
    "Renewable": "core.optional",
    "Repeatable": "core.optional",
    "RunsInThreads": "core.optional",
    "SaysNormals": "core.optional",
    "ShiftsPositions": "core.optional",
    "ShiftsTimes": "core.optional",
    "ShowsSteps": "core.optional",
    "Stiffens": "core.optional",
    "takes_option": "core.optional",
    "FoldState": "core.folding",
    "for_each": "core.parallel",
    "Surface": "vision.surface",
    "surface_of": "vision.surface",
    "silhouettes": "vision.render",
    "striped": "vision.render",
    "angle_map": "vision.orientation",
    "fold_mask": "vision.orientation",
    "seen_points": "vision.depth_camera",
    "to_world": "vision.depth_camera",
    "Registration": "plugins.hookspecs",
    "hookimpl": "plugins.hookspecs",
    "catalogue": "plugins.discovery",
    "effect_kernel": "modelling.kernels",
    "Sheet": "modelling.sheet",
    "sheet_of": "modelling.sheet",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'clothbench' has no attribute {name!r}")
    return getattr(importlib.import_module(f"clothbench.{_HOME[name]}"), name)
