"""`ppf`: a material profile of ppf-contact-solver (its add-on's TOML), for a group of the type SHELL.

Its Young's modulus is divided by the density (documented as Pa/ρ; of a shell the density is areal, so K/ρ, in m²/s²).
Its bend is stated without a unit and found by trial against drapes; it takes a GPU to measure, so none is written.
"""

from __future__ import annotations

import json

from clothbench import Export, Twin

suffix = ".toml"


def skip_reason() -> str | None:
    return None


def export(twin: Twin) -> Export:
    """One entry, named after the twin."""
    material, lines = twin.isotropic("ppf-contact-solver")
    lines += [
        f"bend: ppf-contact-solver states no unit; {material.bending:.4g} N·m is left out, set it by its drape test",
        "units: young modulus as documented (stretch over areal density), not measured: the solver needs a GPU",
        *twin.unheld("ppf-contact-solver"),
    ]
    values = {
        "object_type": '"SHELL"', "shell_model": '"BARAFF_WITKIN"', "shell_density": repr(twin.scene.areal_density),
        "shell_young_modulus": repr(material.stretch / twin.scene.areal_density),
        "young_mod_density_normalized": "true",
        "shell_poisson_ratio": "0.0", "deformation_damping": repr(material.stretch_damping / material.stretch),
        "bending_damping": repr(material.bending_damping / material.bending),
    }  # fmt: skip
    head = [f"# {line}" for line in (*twin.about(), *lines)]
    body = [f"{name} = {value}" for name, value in values.items()]
    return Export("\n".join([*head, f"[{json.dumps(twin.name)}]", *body]) + "\n", tuple(lines))
