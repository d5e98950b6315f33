"""The built-in cloth models: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_models():
    return [
        Registration(
            "mass_spring",
            "clothbench_models.mass_spring:MassSpring",
            "Provot grid of structural, shear and flexion springs with dampers, explicit",
        ),
        Registration(
            "mass_spring_verlet",
            "clothbench_models.mass_spring_verlet:MassSpringVerlet",
            "particle grid with springs to the four nearest in each direction, position Verlet",
        ),
        Registration(
            "baraff_witkin",
            "clothbench_models.baraff_witkin:BaraffWitkin",
            "triangles with stretch, shear and bend conditions; implicit Euler, BDF2 or adaptive Runge-Kutta",
        ),
        Registration(
            "inextensible",
            "clothbench_models.inextensible:Inextensible",
            "inextensible quadrilaterals, isometric bending, Rayleigh damping; implicit with fast projection",
        ),
        Registration(
            "kirchhoff_love",
            "clothbench_models.kirchhoff_love:KirchhoffLove",
            "isogeometric Kirchhoff-Love shell at rest, with contact; strips that are folded on a desk",
        ),
        Registration(
            "linear_stretch",
            "clothbench_models.linear_stretch:LinearStretch",
            "tension in proportion to strain, for force-extension curves only",
        ),
        Registration(
            "mujoco",
            "clothbench_models.peers.mujoco_model:Mujoco",
            "MuJoCo flex: Saint Venant-Kirchhoff membrane and quadratic bending, explicit or implicit",
        ),
        Registration(
            "newton",
            "clothbench_models.peers.newton_model:Newton",
            "Newton cloth: neo-Hookean membrane and hinges, explicit or vertex block descent, single precision",
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
