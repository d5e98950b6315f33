"""Bullet's deformable cloth as a model of clothbench: registration only, PyBullet is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_models():
    return [
        Registration(
            "pybullet_cloth",
            "clothbench_pybullet.model:PybulletCloth",
            "PyBullet's deformable world: springs along the edges of triangles, explicit, with implicit dashpots",
        ),
    ]
