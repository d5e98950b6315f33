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
        Registration("mujoco", "clothbench_models.peers.mujoco_flex", "MuJoCo membrane, explicit Euler"),
        Registration(
            "newton",
            "clothbench_models.peers.newton_cloth",
            "Newton cloth: membrane and bending, semi-implicit Euler, single precision, on the CPU",
        ),
        Registration(
            "newton_springs",
            "clothbench_models.peers.newton_springs",
            "Newton net of six springs a node, semi-implicit Euler, single precision, on the CPU",
        ),
    ]
