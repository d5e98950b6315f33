"""`usd`: a mesh with the schema that is proposed to OpenUSD for surface deformables, written by usd-core.

The proposal is `proposals/physics_deformables` of github.com/PixarAnimationStudios/OpenUSD-proposals (pull request 111,
read at its commit 5d89c0ed). usd-core has no such schema yet, so schemas and attributes are written by name. Names and
units of the material, and the thicknesses on the mesh, are those of a later revision of the proposal, as Newton 1.8
reads them: stretch and shear stiffness N/m, bending stiffness N·m, thickness m, density kg/m³, mass kg.
Grips are kinematic rigid bodies to which held points are attached. Units of the stage: metres, kilograms, z up.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from clothbench import Export, Material, Sheet, Twin
from clothbench_exporters.mesh import clamped_nodes, grip_nodes, margin, sheet_of_twin

suffix = ".usda"
SCHEMA = (
    "proposals/physics_deformables of PixarAnimationStudios/OpenUSD-proposals, pull request 111 at 5d89c0ed; material "
    "and thicknesses as Newton 1.8 reads them, of a later revision"
)
WORLD = "/World"
units = {
    "bending": "surfaceBendStiffness [N·m]",
    "stretch": "surfaceStretchStiffness [N/m]",
    "shear": "surfaceShearStiffness [N/m]",
    "inertia": "mass [kg], or density [kg/m³] · thicknesses [m] × area",
    "stretch_damping": "none",
    "bending_damping": "none",
}
documentation = SCHEMA
unmeasured = "not measured: a schema moves nothing; what a reader makes of it is the reader's (Newton's: docs/twins.md)"


def skip_reason() -> str | None:
    import importlib.util

    return None if importlib.util.find_spec("pxr") else "pip install clothbench[usd]"


def export(twin: Twin) -> Export:
    """The stage as text: below /World the cloth, its material, gravity, grips and what attaches the cloth to them."""
    from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

    material, lines = twin.isotropic("the schema", shears=True)
    if abs(material.shear / (material.stretch / 2) - 1) > 0.02:
        shear = f"{material.shear:.4g} N/m"
        lines.append(f"shear: the schema holds {shear}, but Newton 1.8 reads it and makes no use of it")
    lines += _unread(material) + twin.unheld("the schema", ("outline",)) + margin(twin)
    thickness = math.sqrt(12 * material.bending / material.stretch)
    sheet, start = sheet_of_twin(twin)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = "\n".join((*twin.about(), f"schema: {SCHEMA}", *lines))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, WORLD).GetPrim())
    _gravity(stage, np.array(twin.scene.gravity))
    mesh = _mesh(stage, sheet, start, thickness)
    cloth = UsdShade.Material.Define(stage, f"{WORLD}/Material")
    cloth.GetPrim().AddAppliedSchema("PhysicsSurfaceDeformableMaterialAPI")
    for name, value in (
        ("density", twin.scene.areal_density / thickness), ("youngsModulus", material.stretch / thickness),
        ("poissonsRatio", 0.0), ("surfaceStretchStiffness", material.stretch),
        ("surfaceShearStiffness", material.shear), ("surfaceBendStiffness", material.bending),
    ):  # fmt: skip
        _set(cloth.GetPrim(), name, "Float", value)
    UsdShade.MaterialBindingAPI.Apply(mesh).Bind(cloth, materialPurpose="physics")
    for g, node in enumerate(grip_nodes(twin, sheet).tolist()):
        _hold(stage, f"grip_{g}", [node], start[node], np.zeros((1, 3)))
    if len(clamped := clamped_nodes(twin, sheet)):
        _hold(stage, "clamp", clamped.tolist(), np.zeros(3), start[clamped])
    held = dataclasses.replace(material, bending_damping=0.0, stretch_damping=0.0)
    return Export(stage.GetRootLayer().ExportToString(), tuple(lines), held)


def _unread(material: Material) -> list[str]:
    """A line on what the schema, or its reader, makes nothing or something else of."""
    lines = [
        f"modulus: Newton 1.8 takes {material.stretch:.4g} N/m for μ, which makes its cloth twice as stiff",
        f"hinges: Newton 1.8 takes {material.bending:.4g} N·m for the stiffness of a hinge on any mesh, see clothbench "
        "units newton",
    ]
    for name, value, unit in (
        ("bending", material.bending_damping, "N·m·s"), ("stretch", material.stretch_damping, "N·s/m")
    ):  # fmt: skip
        if value > 0:
            lines.append(f"{name} damping: the schema has none; {value:.4g} {unit} is left out")
    return lines


def _gravity(stage: Any, gravity: np.ndarray) -> None:
    from pxr import Gf, UsdPhysics

    scene, size = UsdPhysics.Scene.Define(stage, f"{WORLD}/PhysicsScene"), float(np.linalg.norm(gravity))
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*(gravity / size if size else np.array([0.0, 0.0, -1.0])).tolist()))
    scene.CreateGravityMagnitudeAttr(size)


def _mesh(stage: Any, sheet: Sheet, start: np.ndarray, thickness: float) -> Any:
    """The prim of the cloth as it begins, with its flat shape at rest."""
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, f"{WORLD}/Cloth")
    mesh.CreatePointsAttr(start.tolist())
    mesh.CreateFaceVertexCountsAttr([3] * len(sheet.triangles))
    mesh.CreateFaceVertexIndicesAttr(sheet.triangles.ravel().tolist())
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)  # or viewers leave out the side of the cloth that faces away
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    prim = mesh.GetPrim()
    for schema in ("PhysicsDeformableBodyAPI", "PhysicsSurfaceDeformableSimAPI", "PhysicsCollisionAPI"):
        prim.AddAppliedSchema(schema)
    _set(prim, "restShapePoints", "Point3fArray", np.hstack([sheet.uv, np.zeros((len(sheet.uv), 1))]).tolist())
    _set(prim, "restTriVertexIndices", "Int3Array", sheet.triangles.tolist())
    _set(prim, "restBendAnglesDefault", "Token", "flat", uniform=True)
    _set(prim, "thicknesses", "FloatArray", [thickness])
    _set(prim, "thicknesses:elementType", "Token", "constant", uniform=True)
    _set(prim, "mass", "Float", float(sheet.mass.sum()))
    return prim


def _hold(stage: Any, name: str, nodes: list[int], place: np.ndarray, at: np.ndarray) -> None:
    """A kinematic rigid body at `place` (3,) m, to which nodes are attached at `at` (K, 3) m from it."""
    from pxr import Gf, UsdGeom, UsdPhysics

    body = UsdGeom.Xform.Define(stage, f"{WORLD}/{name}")
    body.AddTranslateOp().Set(Gf.Vec3d(*place.tolist()))
    UsdPhysics.RigidBodyAPI.Apply(body.GetPrim()).CreateKinematicEnabledAttr(True)
    tie = stage.DefinePrim(f"{WORLD}/{name}_attachment", "PhysicsAttachment")
    tie.CreateRelationship("physics:src0", custom=False).SetTargets([f"{WORLD}/Cloth"])
    tie.CreateRelationship("physics:src1", custom=False).SetTargets([f"{WORLD}/{name}"])
    _set(tie, "type0", "Token", "point", uniform=True)
    _set(tie, "type1", "Token", "xform", uniform=True)
    _set(tie, "indices0", "IntArray", nodes)
    _set(tie, "coords1", "Vector3fArray", at.tolist())


def _set(prim: Any, name: str, kind: str, value: Any, uniform: bool = False) -> None:
    """An attribute of the physics schemas; uniform: one that does not change over time."""
    from pxr import Sdf

    variability = Sdf.VariabilityUniform if uniform else Sdf.VariabilityVarying
    prim.CreateAttribute(f"physics:{name}", getattr(Sdf.ValueTypeNames, kind), False, variability).Set(value)
