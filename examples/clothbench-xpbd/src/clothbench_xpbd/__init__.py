"""A model, an effect and a suite for clothbench: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_models():
    return [
        Registration("xpbd", "clothbench_xpbd.sheet:Xpbd", "spring grid by extended position-based dynamics, implicit"),
    ]


@hookimpl
def clothbench_effects():
    return [
        Registration("hem", "clothbench_xpbd.hem:Hem", "a seam along the border makes it heavier"),
    ]


@hookimpl
def clothbench_configs():
    return ["pkg://clothbench_xpbd.conf"]
