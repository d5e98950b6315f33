"""A cloth of springs in Taichi as a model of clothbench: registration only, Taichi is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_models():
    return [
        Registration(
            "taichi_springs",
            "clothbench_taichi.model:TaichiSprings",
            "springs and dashpots to all neighbours within two cells, compiled by Taichi, explicit",
        ),
    ]
