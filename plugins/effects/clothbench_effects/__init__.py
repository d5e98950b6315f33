"""The built-in effects: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl

# Module (which is the name), class and one line, in the order of the physics: air, material, mass, grips, sensor.
EFFECTS = (
    ("linear_drag", "LinearDrag", "air drag, linear in velocity"),
    ("quadratic_drag", "QuadraticDrag", "air drag, quadratic in velocity"),
    ("drag_crisis", "DragCrisis", "air drag, quadratic when slow, that levels off with speed"),
    ("added_mass", "AddedMass", "air carried along by the normal acceleration"),
    ("air_memory", "AirMemory", "air that follows the sheet late: added mass to slow motion, drag to fast"),
    ("steady_wind", "SteadyWind", "a steady, uniform wind"),
    ("local_jet", "LocalJet", "a draught along a horizontal line"),
    ("lift", "Lift", "lift of a sheet that moves at an angle through the air"),
    ("stretch_stiffening", "StretchStiffening", "tension that grows with the square of the strain"),
    ("strain_locking", "StrainLocking", "tension that grows exponentially as the yarns lock (curves)"),
    ("limited_extension", "LimitedExtension", "a stretch that cannot be passed (curves)"),
    ("start_friction", "StartFriction", "yarns that stick before they slide (curves)"),
    ("poisson_coupling", "PoissonCoupling", "cross contraction between warp and weft"),
    ("bending_anisotropy", "BendingAnisotropy", "bending rigidity of warp and weft beyond the model's own"),
    ("bending_hysteresis", "BendingHysteresis", "internal friction in bending"),
    ("plastic_bending", "PlasticBending", "bending that yields, so that folds stay"),
    ("viscoelasticity", "Viscoelasticity", "stress relaxation in bending and stretch"),
    ("rest_curvature", "RestCurvature", "cloth that curls by itself"),
    ("crease", "Crease", "a line along which the cloth was folded, and rests bent"),
    ("heavy_hem", "HeavyHem", "a hem along the lower edge, with its weight"),
    ("point_mass", "PointMass", "a small mass on the cloth, such as a marker"),
    ("total_mass", "TotalMass", "cloth heavier or lighter than stated"),
    ("gravity_tilt", "GravityTilt", "a recording whose vertical is not quite vertical"),
    ("grip_offset", "GripOffset", "grips shifted against their recorded positions"),
    ("grip_rotation", "GripRotation", "grips turned against their recorded pose"),
    ("grip_slip", "GripSlip", "cloth that slips down in its grips, once"),
    ("grip_compliance", "GripCompliance", "grips that follow their path like a damped spring mount"),
    ("grip_patch", "GripPatch", "grips that hold a square patch each, not a point"),
    ("clamp_slack", "ClampSlack", "a sample loose or already drawn at the start (curves)"),
    ("clamp_slip", "ClampSlip", "cloth that slips out of its clamps (curves)"),
    ("clock_offset", "ClockOffset", "positions are stamped late or early"),
    ("frame_rotation", "FrameRotation", "the camera's frame turned against the grips'"),
    ("frame_translation", "FrameTranslation", "the camera's frame shifted against the grips'"),
    ("frame_scale", "FrameScale", "lengths seen too long or too short"),
    ("tracker_lowpass", "TrackerLowpass", "positions smoothed by a first-order filter"),
    ("marker_standoff", "MarkerStandoff", "markers that stand off the cloth"),
    ("lens_distortion", "LensDistortion", "a lens that bends the picture otherwise than is known (pictures)"),
    ("frame_rate", "FrameRate", "a video that runs too fast or too slow (pictures)"),
    ("rolling_shutter", "RollingShutter", "rows of a picture that are read one after the other (pictures)"),
    ("load_offset", "LoadOffset", "a load cell whose zero is off (curves)"),
)


@hookimpl
def clothbench_effects():
    return [Registration(name, f"clothbench_effects.{name}:{kind}", line) for name, kind, line in EFFECTS]
