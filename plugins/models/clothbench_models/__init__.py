"""The built-in cloth models: registration only, each is imported when it is used."""

from clothbench.hookspecs import Registration, hookimpl


@hookimpl
def clothbench_models():
    return [
        Registration(
            "mass_spring",
            "clothbench_models.mass_spring:MassSpring",
            "Provot grid of structural, shear and flexion springs with dampers, explicit",
        ),
    ]


@hookimpl
def clothbench_peers():
    return [
        Registration("mujoco", "clothbench_models.peers.mujoco_flex", "MuJoCo flex sheet, explicit Euler"),
        Registration("newton", "clothbench_models.peers.newton_cloth", "Newton sheet, semi-implicit, on the CPU"),
    ]
