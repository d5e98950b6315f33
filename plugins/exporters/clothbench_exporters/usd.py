"""`usd`: a mesh with the schema that is proposed to OpenUSD for surface deformables, written by usd-core.

usd-core has no such schema yet, so schemas and attributes are written by name, as the importer of Newton 1.8 reads
them: stretch and shear stiffness N/m, bending stiffness N·m, thickness m on the mesh, density kg/m³, mass kg. Units of
the stage: metres, kilograms, z up.
"""

from __future__ import annotations

import math

import numpy as np

from clothbench import Export, Twin
from clothbench_exporters.mesh import grip_nodes, sheet_of_twin

suffix = ".usda"
SCHEMA = "AOUSD proposal of surface deformables, attributes as Newton 1.8 reads them"


def skip_reason() -> str | None:
    import importlib.util

    return None if importlib.util.find_spec("pxr") else "pip install clothbench[usd]"


def export(twin: Twin) -> Export:
    """The stage as text: /Cloth, its material /Cloth/Material, and which nodes grips hold."""
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

    material, lines = twin.isotropic("a USD reader")
    shear = twin.material.shear
    if math.isfinite(shear):  # the schema has shear; its readers may not
        lines = [line for line in lines if not line.startswith("shear")]
        if abs(shear / material.shear - 1) > 0.02:
            lines.append(f"shear: the schema holds {shear:.4g} N/m, but Newton 1.8 reads it and makes no use of it")
    else:
        shear = material.shear
    lines += [
        f"bending: {material.bending:.4g} N·m is stated; Newton 1.8 takes it for a hinge's stiffness on any mesh, "
        "see clothbench units newton",
        "damping: the schema has none",
        *twin.unheld("the schema"),
    ]
    thickness = math.sqrt(12 * material.bending / material.stretch)
    sheet, start = sheet_of_twin(twin)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = "\n".join((*twin.about(), f"schema: {SCHEMA}", *lines))
    mesh = UsdGeom.Mesh.Define(stage, "/Cloth")
    stage.SetDefaultPrim(mesh.GetPrim())
    mesh.CreatePointsAttr(start.tolist())
    mesh.CreateFaceVertexCountsAttr([3] * len(sheet.triangles))
    mesh.CreateFaceVertexIndicesAttr(sheet.triangles.ravel().tolist())
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    prim, types = mesh.GetPrim(), Sdf.ValueTypeNames
    prim.AddAppliedSchema("PhysicsDeformableBodyAPI")
    prim.AddAppliedSchema("PhysicsSurfaceDeformableSimAPI")
    prim.AddAppliedSchema("PhysicsCollisionAPI")
    flat = np.hstack([sheet.uv, np.zeros((len(sheet.uv), 1))])
    for name, kind, value in (
        ("restShapePoints", types.Point3fArray, flat.tolist()),
        ("restTriVertexIndices", types.Int3Array, sheet.triangles.tolist()),
        ("restBendAnglesDefault", types.Token, "flat"),
        ("thicknesses", types.FloatArray, [thickness]),
        ("thicknesses:elementType", types.Token, "constant"),
        ("mass", types.Float, float(sheet.mass.sum())),
    ):
        prim.CreateAttribute(f"physics:{name}", kind).Set(value)
    prim.CreateAttribute("clothbench:grips", types.IntArray).Set(grip_nodes(twin, sheet).tolist())
    cloth = UsdShade.Material.Define(stage, "/Cloth/Material").GetPrim()
    cloth.AddAppliedSchema("PhysicsSurfaceDeformableMaterialAPI")
    for name, value in (
        ("density", twin.scene.areal_density / thickness), ("youngsModulus", material.stretch / thickness),
        ("poissonsRatio", 0.0), ("surfaceStretchStiffness", material.stretch), ("surfaceShearStiffness", shear),
        ("surfaceBendStiffness", material.bending),
    ):  # fmt: skip
        cloth.CreateAttribute(f"physics:{name}", types.Float).Set(value)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(UsdShade.Material(cloth), materialPurpose="physics")
    return Export(stage.GetRootLayer().ExportToString(), tuple(lines))
