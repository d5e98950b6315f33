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
    "FoldState": "core.folding",
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
