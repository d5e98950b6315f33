"""clothbench: which cloth model to trust, with which parameters, and what it still gets wrong.

Importing the package costs nothing: the public names below are loaded when they are first used.
"""

import importlib

__version__ = "0.1.0"

_HOME = {
    "ClothbenchError": "errors",
    "Parameter": "parameters",
    "ParameterSpace": "parameters",
    "Recording": "recording",
    "read_recording": "recording",
    "write_recording": "recording",
    "Curve": "curve",
    "read_curve": "curve",
    "write_curve": "curve",
    "LaserImages": "laser",
    "read_laser": "laser",
    "write_laser": "laser",
    "Observation": "observation",
    "Camera": "camera",
    "Projector": "camera",
    "Video": "camera",
    "View": "camera",
    "Scene": "scene",
    "Obstacle": "scene",
    "Material": "protocols",
    "Rollout": "rollout",
    "Interpolator": "rollout",
    "Score": "protocols",
    "Evaluation": "protocols",
    "Model": "protocols",
    "Simulation": "protocols",
    "Effect": "protocols",
    "Metric": "protocols",
    "Optimizer": "protocols",
    "Tracker": "protocols",
    "FoldState": "folding",
    "Registration": "hookspecs",
    "hookimpl": "hookspecs",
    "effect_kernel": "kernels",
    "Sheet": "kernels",
    "sheet_of": "kernels",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'clothbench' has no attribute {name!r}")
    return getattr(importlib.import_module(f"clothbench.{_HOME[name]}"), name)
