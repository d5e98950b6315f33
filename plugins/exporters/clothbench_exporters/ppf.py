"""`ppf`: a material profile of ppf-contact-solver (its add-on's TOML), for a group of the type SHELL.

What its numbers are worth is read in its source (github.com/st-tech/ppf-contact-solver, commit f23b3565), not measured.
With ρ the areal density, E its `young modulus` (over density, m²/s²) and ν its Poisson's ratio, the model BARAFF_WITKIN
resists stretch along each thread with ρμ and shear with ρλ, where μ = E/2(1 + ν) and λ = Eν/(1 + ν)(1 − 2ν)
(`builder.rs`, `energy/model/baraffwitkin.hpp`): with ν = K_s/2(K + K_s) and E = 2(1 + ν)K/ρ they are the material's.
A hinge of length l between two triangles of the area A together has ½ k θ² with k = 1.28e-5 · bend · ρ l²/A
(`energy/energy.cu`): a rigidity of 1.28e-5 · bend · ρ on a mesh along the threads, or of equilateral triangles.
"""

from __future__ import annotations

import dataclasses
import json

from clothbench import Export, Material, Twin

suffix = ".toml"
BEND_SCALE = 1.28e-5  # m⁴/s² for each unit of `bend`
NAME = "ppf-contact-solver"
units = {
    "bending": f"{BEND_SCALE} m⁴/s² · bend [1] · shell_density [kg/m²]",
    "stretch": "shell_density [kg/m²] · shell_young_modulus [m²/s²] / 2(1 + ν)",
    "shear": "shell_density [kg/m²] · shell_young_modulus [m²/s²] · ν / (1 + ν)(1 − 2ν)",
    "inertia": "shell_density [kg/m²] × area",
    "stretch_damping": "no part of a profile; deformation_damping [s] times stretch in the panel",
    "bending_damping": "no part of a profile; bending_damping [s] times bending in the panel",
}
documentation = "github.com/st-tech/ppf-contact-solver at f23b3565: builder.rs, baraffwitkin.hpp and energy.cu"
unmeasured = "not measured: the solver has to be built with CUDA; what is here was read in its source"


def skip_reason() -> str | None:
    return None


def export(twin: Twin) -> Export:
    """One entry, named after the twin."""
    material, lines = twin.isotropic(f"a profile of {NAME}", shears=True)
    density = twin.scene.areal_density
    poisson = material.shear / 2 / (material.stretch + material.shear)
    lines += _by_hand(twin.material, material, density) + twin.unheld(NAME)
    values = {
        "object_type": '"SHELL"', "shell_model": '"BARAFF_WITKIN"', "shell_density": repr(density),
        "shell_young_modulus": repr(2 * (1 + poisson) * material.stretch / density),
        "young_mod_density_normalized": "true", "shell_poisson_ratio": repr(poisson),
        "bend": repr(material.bending / BEND_SCALE / density), "bend_rest_angle_source": '"FLAT"',
    }  # fmt: skip
    head = [f"# {line}" for line in (*twin.about(), *lines)]
    body = [f"{name} = {value}" for name, value in values.items()]
    held = dataclasses.replace(material, bending_damping=0.0, stretch_damping=0.0)
    return Export(
        "\n".join([*head, f"[{json.dumps(twin.name, ensure_ascii=False)}]", *body]) + "\n", tuple(lines), held
    )


def _by_hand(whole: Material, alike: Material, density: float) -> list[str]:
    """A line on each thing that the solver has and a profile does not, with what to set in the panel."""
    lines = []
    warp, weft = (rigidity / BEND_SCALE / density for rigidity in whole.along("bending"))
    if warp != weft:
        least = min(warp, weft)
        lines.append(
            f"bend_warp, bend_weft: no part of a profile; set bend = {least:.4g}, bend_warp = {warp - least:.4g} and "
            f"bend_weft = {weft - least:.4g} by hand, on a mesh with UV coordinates along the threads"
        )
    for name, late in (
        ("deformation_damping", whole.stretch_damping / alike.stretch),
        ("bending_damping", whole.bending_damping / alike.bending),
    ):
        if late > 0:
            lines.append(f"{name}: no part of a profile; set {late:.4g} s by hand")
    return lines
